"""What the scripts that read or write a file in Blender share.

A script runs as ``python script.py job.json`` or ``blender --python script.py -- job.json``. It
needs only NumPy and Blender, not the package. It writes its results to an archive of arrays and
errors to stderr.
"""

import fractions
import json
import os
import sys
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

_LARGEST_RATE = 32767  # of Blender's integer for the frame rate


def run(act: Callable[[dict[str, Any]], None]) -> None:
    """Run a script's function on its job, and end the process."""
    if bpy.app.version < (4, 2, 0):
        raise RuntimeError(f"Blender 4.2 or newer is needed, this is {bpy.app.version_string}")
    with open(sys.argv[-1], encoding="utf-8") as stream:
        job = json.load(stream)
    try:
        act(job)
    except (ValueError, RuntimeError) as error:  # a problem of the file, found here or by Blender
        said = (str(error).strip().splitlines() or [""])[-1]  # the end of a traceback
        if isinstance(error, RuntimeError):
            said = f"Blender says: {said.removeprefix('Error: ')}"
        np.savez(job["out"], error=np.array(" ".join(said.split())))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # some releases of bpy crash at exit, after all work is done


def set_rate(fps: float) -> None:
    """Set the scene's frame rate, which Blender stores as an integer divided by a float32."""
    render, ratio = bpy.context.scene.render, fractions.Fraction(fps).limit_denominator(1001)
    if 0 < ratio.numerator <= _LARGEST_RATE and float(ratio) == fps:
        render.fps, render.fps_base = ratio.numerator, ratio.denominator
    else:
        render.fps = max(1, min(round(fps), _LARGEST_RATE))
        render.fps_base = render.fps / fps


def values(data: Any, name: str, dtype: Any, width: int = 1) -> Any:
    """Values of the attribute `name` of all elements of a Blender collection, in rows of `width`.

    If `width` is 1, the array has one dimension.
    """
    size = len(data) * (np.size(getattr(data[0], name)) if len(data) else 1)
    flat = np.empty(size, dtype=dtype)
    data.foreach_get(name, flat)
    return flat if width == 1 else flat.reshape(-1, width)


def vertex_numbers(items: list[Any]) -> Any:
    """Model vertex index (n,) of each vertex of all meshes, one mesh after the other.

    It is read from the mesh attribute ``_VERTEX``, which ssdr writes to its glTF files.
    """
    attributes = [item.data.attributes["_VERTEX"].data for item in items]
    found = [values(data, "value", np.float32) for data in attributes]
    return np.concatenate(found).astype(np.int64)
