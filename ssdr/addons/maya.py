"""Maya: the selected animated mesh becomes joints and a skin cluster on a duplicate.  Untested.

In the script editor: ``import maya_bones; maya_bones.to_bones("PYTHON", "--bones", "24")``, with
this file as ``maya_bones.py`` in the scripts folder, the Python of an environment in which ssdr is
installed, and options of ``ssdr decompose``.  Maya's own Python needs NumPy.
"""

import json
import os
import subprocess
import tempfile
from pathlib import Path

import maya.api.OpenMaya as om
import maya.cmds as cmds
import numpy as np


def _mesh(name):
    return om.MFnMesh(om.MSelectionList().add(name).getDagPath(0))


def _variables():
    """Environment for another Python: Maya's, without the variables that lead to its packages."""
    left_out = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    return {name: value for name, value in os.environ.items() if name not in left_out}


def to_bones(python, *options):
    """Decompose the selected mesh over the playback range, and return the name of its duplicate."""
    names = cmds.ls(selection=True, long=True)
    if not names or not cmds.listRelatives(names[0], shapes=True, type="mesh"):
        raise RuntimeError("select an animated mesh")
    ends = [int(cmds.playbackOptions(query=True, **{end: True})) for end in ("min", "max")]
    numbers, frames = range(ends[0], ends[1] + 1), []
    for number in numbers:
        cmds.currentTime(number)
        frames.append(np.array(_mesh(names[0]).getPoints(om.MSpace.kWorld))[:, :3])
    faces = np.array(_mesh(names[0]).getTriangles()[1]).reshape(-1, 3)
    with tempfile.TemporaryDirectory() as folder:
        source, result = str(Path(folder) / "input.npz"), str(Path(folder) / "model.npz")
        np.savez(source, vertices=np.array(frames), faces=faces)
        words = [python, "-m", "ssdr", "decompose", source, "-o", result, "--json", *options]
        done = subprocess.run(words, env=_variables(), capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(json.loads(done.stdout)["error"] if done.stdout else done.stderr)
        with np.load(result, allow_pickle=False) as archive:
            model = {key: archive[key] for key in archive.files}
    return _build(names[0], numbers, model)


def _build(name, numbers, model):
    rest, transforms = model["rest"], model["transforms"]
    count = transforms.shape[1]
    copy = cmds.duplicate(name, name=name.split("|")[-1] + "_bones")[0]
    if cmds.listRelatives(copy, parent=True):
        copy = cmds.parent(copy, world=True)[0]
    cmds.xform(copy, matrix=np.eye(4).ravel().tolist(), worldSpace=True)
    _mesh(copy).setPoints(om.MPointArray(rest.tolist()), om.MSpace.kObject)
    heads = model.get("joint_positions", np.tile(rest.mean(axis=0), (count, 1)))
    parents, joints = model.get("parents", np.full(count, -1)), []
    for k in range(count):
        cmds.select(clear=True)
        joints.append(cmds.joint(name=f"{copy}_{k}", position=heads[k].tolist()))
    for k in np.flatnonzero(parents >= 0):
        cmds.parent(joints[k], joints[parents[k]])
    skin = cmds.skinCluster(joints, copy, toSelectedBones=True)[0]
    for vertex in range(len(rest)):
        who, what = model["indices"][vertex], model["weights"][vertex]
        values = [(joints[who[k]], float(what[k])) for k in np.flatnonzero(what)]
        where = f"{copy}.vtx[{vertex}]"
        cmds.skinPercent(skin, where, transformValue=values, zeroRemainingInfluences=True)
    depth = [len((cmds.listRelatives(j, fullPath=True, parent=True) or [""])[0]) for j in joints]
    for number, moved in zip(numbers, transforms, strict=True):
        cmds.currentTime(number)
        for k in np.argsort(depth, kind="stable"):  # parents first
            world = np.eye(4)
            world[:3, :3], world[:3, 3] = moved[k, :, :3], moved[k] @ np.append(heads[k], 1)
            cmds.xform(joints[k], matrix=world.T.ravel().tolist(), worldSpace=True)
            cmds.setKeyframe(joints[k], attribute=["translate", "rotate"])
    return copy
