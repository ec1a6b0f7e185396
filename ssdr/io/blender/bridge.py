"""Alembic and FBX through Blender, which runs in a process of its own.

``bpy`` prints, keeps one global scene and pins an old NumPy; none of that
reaches the user's process or environment.  `finder` says where Blender is.
"""

from __future__ import annotations

import json
import logging
import math
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError, InputError, MissingDependencyError, SsdrError
from ...sequence import Material, MeshSequence, Surface
from ...skinning import Skinning
from ..atomic import atomic_path
from ..gltf import reader as gltf
from ..registry import SaveReport, describe, reading
from ..rig import MAX_BYTES, Up, check_up, turn_up
from .finder import command

__all__ = ["read", "run", "write_skinning"]

_log = logging.getLogger(__name__)
_SCRIPT = Path(__file__).with_name("script.py")
_TOO_OLD = "Blender 4.2 or newer is needed"  # in the words of script.py
_MAGIC = {".fbx": (b"Kaydara FBX", b"; FBX"), ".abc": (b"Ogawa", b"\x89HDF")}


def read(
    path: Path,
    *,
    fps: float | None = None,
    up: Up = "y",
    time_limit: float = 600.0,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read all meshes of an Alembic or FBX file, baked to vertices.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Where to sample; FBX says itself, Alembic holds seconds alone and gets
        24 by default.
    up : {"y", "z"}
        Axes of the result: y up as most such files have it, or Blender's own.
    time_limit : float
        Seconds after which Blender is stopped.
    max_bytes : int, optional
        Largest size of the vertices; 16 GiB by default.

    Returns
    -------
    MeshSequence
        float32, in metres (FBX stores centimetres or a unit of its own).

    Raises
    ------
    FormatError
        If Blender cannot read the file.
    MissingDependencyError
        If there is no Blender, or one that is too old.
    """
    check_up(up)
    _check_limit(time_limit)
    command(_SCRIPT)  # whether there is a Blender comes before what may be wrong with the file
    suffix = path.suffix.lower()
    with path.open("rb") as stream:
        head = stream.read(64)
    if suffix in _MAGIC and not head.startswith(_MAGIC[suffix]):
        raise FormatError(f"{path}: not an {suffix} file: {describe(head)}")
    job = {
        "action": "read",
        "path": str(path.resolve()),
        "fps": 24.0 if fps is None else fps,
        "resample": fps is not None,
        "max_bytes": MAX_BYTES if max_bytes is None else max_bytes,
    }
    try:
        arrays = run(job, time_limit=time_limit)
    except MissingDependencyError:
        raise
    except SsdrError as error:
        raise FormatError(f"{path}: {error}") from error
    if fps is None and suffix == ".abc":
        _log.info("%s: sampled at 24 frames per second; fps= says otherwise", path)
    with reading(path):
        surface = _surface(arrays)
        if surface is not None and surface.normals is not None:
            surface = Surface(
                uv=surface.uv,
                normals=turn_up(surface.normals, "z", up),
                material_index=surface.material_index,
                materials=surface.materials,
            )
        return MeshSequence(
            turn_up(arrays["vertices"], "z", up),
            arrays["faces"],
            float(arrays["fps"]),
            name=path.stem,
            surface=surface,
        )


def write_skinning(
    skinning: Skinning,
    path: Path,
    *,
    influences: int | None = None,
    up: Up = "y",
    name: str | None = None,
    time_limit: float = 600.0,
) -> SaveReport:
    """Write a skinned ``.fbx``: the glTF of the model, imported and exported by Blender.

    What was written is read back and compared, so that `error` and `max_error`
    of the report are those of the whole way; `between_frames` is that of the
    glTF (engines that interpolate FBX's Euler angles differ a little).

    Parameters
    ----------
    skinning : Skinning
    path : Path
    influences, up, name
        As for glTF.
    time_limit : float
        Seconds after which Blender is stopped.

    Raises
    ------
    InputError, MissingDependencyError
    SsdrError
        If Blender fails.
    """
    _check_limit(time_limit)
    command(_SCRIPT)
    with tempfile.TemporaryDirectory(prefix="ssdr-") as folder:
        source = Path(folder) / "model.glb"
        stored = gltf.write_skinning(
            skinning, source, influences=influences, up=up, name=name or skinning.name or path.stem
        )
        with atomic_path(path) as temporary:
            job = {
                "action": "write",
                "source": str(source),
                "path": str(temporary.resolve()),
                "fps": skinning.fps,
            }
            numbers = run(job, time_limit=time_limit)["vertex"]
            if not temporary.is_file():
                raise SsdrError("Blender wrote no FBX file")
    back = read(path, up=up, time_limit=time_limit)
    error, largest = _compare(skinning, back, numbers)
    return SaveReport(
        path=path,
        bytes=path.stat().st_size,
        influences=stored.influences,
        error=error,
        max_error=largest,
        between_frames=stored.between_frames,
        note=stored.note.replace("glTF takes the unit for metres", "the unit is taken for metres"),
    )


def _compare(
    skinning: Skinning, back: MeshSequence, numbers: NDArray[np.int64]
) -> tuple[float, float]:
    if back.n_frames != skinning.n_frames or back.n_vertices != len(numbers):
        raise SsdrError(
            f"Blender's FBX holds {back.n_frames} frames of {back.n_vertices} vertices, "
            f"not {skinning.n_frames} of {len(numbers)}"
        )
    total, largest = 0.0, 0.0
    for first, block in back.chunks():
        truth = skinning.skin(slice(first, first + len(block)), dtype=np.float64)
        squares = ((block - truth[:, numbers]) ** 2).sum(axis=2)
        total, largest = total + float(squares.sum()), max(largest, float(squares.max()))
    return math.sqrt(total / (back.n_frames * back.n_vertices)), math.sqrt(largest)


def _check_limit(time_limit: float) -> None:
    if not (math.isfinite(time_limit) and time_limit > 0):
        raise InputError("time_limit", "seconds > 0", time_limit)


def run(job: dict[str, Any], *, time_limit: float = 600.0) -> dict[str, NDArray[Any]]:
    """Do one job of ``script.py`` in a process of its own.

    Raises
    ------
    InputError, MissingDependencyError
        If Blender is not found, cannot be started or is too old.
    SsdrError
        If Blender fails or needs too long; the message holds what it said.
    """
    with tempfile.TemporaryDirectory(prefix="ssdr-") as folder:
        out, order = Path(folder) / "out.npz", Path(folder) / "job.json"
        order.write_text(json.dumps({**job, "out": str(out)}), encoding="utf-8")
        words = command(_SCRIPT, str(order))
        # Blender's Python must see its own packages, not those of this process.
        hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
        environment = {k: v for k, v in os.environ.items() if k not in hidden}
        try:
            done = subprocess.run(
                words,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=time_limit,
                cwd=folder,
                env=environment,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise SsdrError(f"Blender needed more than {time_limit:g} s") from error
        except OSError as error:
            raise MissingDependencyError(f"{words[0]} could not be started: {error}") from error
        _log.debug("blender: %s", done.stdout)
        if done.returncode != 0 or not out.is_file():
            lines = [line for line in done.stderr.splitlines() if line.strip()]
            reason = " | ".join(lines[-3:])[-600:]
            if _TOO_OLD in reason or "No module named 'bpy'" in reason:
                raise MissingDependencyError(f"{words[0]}: {lines[-1]}")
            raise SsdrError(f"Blender failed ({done.returncode}): {reason}")
        with np.load(out, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}


def _surface(arrays: dict[str, NDArray[Any]]) -> Surface | None:
    uv, normals = arrays.get("uv"), arrays.get("normals")
    materials = []
    for record in json.loads(str(arrays["materials"])) if "materials" in arrays else []:
        texture = record.pop("texture", None)
        if "base_color" in record:
            record["base_color"] = tuple(record["base_color"])
        materials.append(
            Material(**record, texture=None if texture is None else arrays[texture].tobytes())
        )
    if uv is None and normals is None and not materials:
        return None
    return Surface(
        uv=None if uv is None else uv.astype(np.float32),
        normals=None if normals is None else normals.astype(np.float32),
        material_index=arrays["material_index"].astype(np.int32) if materials else None,
        materials=tuple(materials),
    )
