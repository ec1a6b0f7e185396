"""Houdini: an animated geometry node becomes a character with bones.  Untested.

In the Python shell: ``import houdini_bones; houdini_bones.to_bones(hou.selectedNodes()[0],
"/path/to/python", "--bones", "24")``, with this file as ``houdini_bones.py`` on Houdini's Python
path, the Python of an environment with ``ssdr[usd]``, and options of ``ssdr decompose``.  The bones
go into ``NODE_bones.usdc`` beside the scene; ``"--force"`` overwrites an existing file.
"""

import json
import os
import subprocess
import tempfile
from pathlib import Path

import hou
import numpy as np


def _variables():
    """Environment variables with which another Python finds its own packages, not Houdini's."""
    left_out = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    return {name: value for name, value in os.environ.items() if name not in left_out}


def to_bones(node, python, *options):
    """Decompose a node's triangles or polygons over the playback range, and return the new node."""
    first, last = (int(end) for end in hou.playbar.playbackRange())
    frames, faces = [], []
    for number in range(first, last + 1):
        points = np.array(node.geometryAtFrame(number).pointFloatAttribValues("P"))
        frames.append(points.reshape(-1, 3))
        if frames[0].shape != frames[-1].shape:
            raise hou.NodeError(f"the number of points changes at frame {number}")
    for prim in node.geometryAtFrame(first).prims():
        corners = [vertex.point().number() for vertex in prim.vertices()]
        faces += [[corners[0], *corners[k : k + 2]] for k in range(1, len(corners) - 1)]
    path = hou.text.expandString("$HIP/") + node.name() + "_bones.usdc"
    with tempfile.TemporaryDirectory() as folder:
        source = str(Path(folder) / "input.npz")
        np.savez(source, vertices=np.array(frames), faces=np.array(faces), fps=hou.fps())
        words = [python, "-m", "ssdr", "decompose", source, "-o", path, "--json"]
        done = subprocess.run(
            [*words, *options], env=_variables(), capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise hou.NodeError(json.loads(done.stdout)["error"] if done.stdout else done.stderr)
    character = node.parent().createNode("kinefx::usdcharacterimport")
    character.parmTuple("usdsource").set((1,))  # a file
    character.parm("usdfile").set(path)
    deform = node.parent().createNode("bonedeform", node.name() + "_bones")
    for k in range(3):  # rest geometry, capture pose, animated pose
        deform.setInput(k, character, k)
    deform.moveToGoodPosition()
    return deform
