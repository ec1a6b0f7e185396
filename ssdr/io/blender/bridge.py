"""FBX through Blender, which runs in a process of its own.

A separate process is used because ``bpy`` prints messages, keeps one global scene and requires an
old NumPy.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip, in_order, readable
from ...errors import FormatError, InputError, MissingDependencyError, SsdrError
from ...sequence import MeshSequence
from ...skinning import Skinning, refuse_shapes
from ...space import METRES_Y_UP, Space
from ..arrays.npz import surface_from
from ..atomic import atomic_path
from ..budget import MOST_BYTES
from ..gltf.writer import write_along_bones
from ..mesh_names import choose, mesh_names
from ..registry import SaveReport, check_one_rate, pick_clip, reading
from ..sampling import tell
from ..scene import Bones, make_skinning
from ..signatures import describe
from ..spaces import in_space, transformed
from ..storage_error import StorageError, frame_blocks
from .finder import command
from .process import SCRIPT, run

_log = logging.getLogger(__name__)
_BLENDER = Space(1.0, "z")
_IMPORT_FPS = 24.0
_LONGEST_NAME = 63  # bytes in the name of anything in Blender
_listed: dict[Any, dict[str, NDArray[Any]]] = {}
_MAGIC = {".fbx": (b"Kaydara FBX", b"; FBX"), ".abc": (b"Ogawa",)}


def read(
    path: Path,
    *,
    clip: str | int | None = None,
    fps: float | None = None,
    meshes: str | Sequence[str] | None = None,
    time_limit: float = 600.0,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read all meshes of an FBX file, baked to vertices.

    Parameters
    ----------
    path : Path
    clip : str or int, optional
        Name or index of the take; the first by default.
    fps : float, optional
        Frames per second at which to sample, as in :func:`read_skinning`.
    meshes : str or several of them, optional
        Names of the objects or meshes to read, or of objects above them; all by default.
    time_limit : float
        Seconds after which Blender is stopped.
    max_bytes : int, optional
        Most memory that the vertices of all frames may take; 16 GiB by default.

    Returns
    -------
    MeshSequence
        Vertices in float32, in metres with y up.

    Raises
    ------
    FormatError
        If Blender cannot read the file.
    InputError
        If the file has no such take or mesh.
    MissingDependencyError
        If Blender is not found or is older than 4.2.
    """
    take = clip if isinstance(clip, (str, int)) and not isinstance(clip, bool) else None
    job = {"take": take, "meshes": meshes}
    arrays = ask_blender("read", path, fps, time_limit, max_bytes, **job)
    with reading(path, "clip"):
        names = _names(arrays, path)
        return sequence_of(arrays, path, names[pick_clip(names, clip, path)], fps)


def sequence_of(
    arrays: dict[str, NDArray[Any]], path: Path, clip: str, fps: float | None
) -> MeshSequence:
    """Make a sequence, with y up, of the arrays that ``script.py`` has read.

    A warning tells of keys between frames. `fps` is the requested rate, or None.
    """
    sequence = MeshSequence(
        arrays["vertices"],
        arrays["faces"],
        float(arrays["fps"].item()),
        name=_title(arrays, path),
        clip=clip,
        surface=surface_from(arrays),
        space=_BLENDER,
    )
    _tell_missed(arrays, [Clip(clip, 0, len(sequence), sequence.fps)], path, fps)
    return in_space(sequence, METRES_Y_UP)


def list_clips(
    path: Path, *, fps: float | None = None, time_limit: float = 600.0
) -> tuple[Clip, ...]:
    """Clips of a file, which are its takes, with frames numbered as in :func:`read_skinning`."""
    arrays = _list(path, fps, time_limit)
    with reading(path):
        return _clips(arrays, path)


def list_meshes(path: Path, *, time_limit: float = 600.0) -> tuple[str, ...]:
    """Names of the objects that hold meshes."""
    arrays = _list(path, None, time_limit)
    return tuple(names[0] for names in json.loads(str(arrays["meshes"])))


def _list(path: Path, fps: float | None, time_limit: float) -> dict[str, NDArray[Any]]:
    """Run the action "list", or return its arrays from the last call if the file is the same."""
    state = path.stat()
    key = str(path.resolve()), state.st_mtime_ns, state.st_size, fps
    if key not in _listed:
        arrays = ask_blender("list", path, fps, time_limit)
        _listed.clear()
        _listed[key] = arrays
    return _listed[key]


def read_skinning(
    path: Path,
    *,
    fps: float | None = None,
    meshes: str | Sequence[str] | None = None,
    joints_alone: bool = False,
    time_limit: float = 600.0,
    max_bytes: int | None = None,
) -> Skinning:
    """Read the skins of an FBX file without baking them; a mesh without a skin gets one bone.

    The rest pose is the mesh without its skin, at its place in the first frame. Bones are those
    that a skin names, even without weights, and the parent of a bone is the nearest such bone above
    it. If no bone has a parent, the skinning has no hierarchy.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Frames per second at which to sample; by default, for each take, the rate of the file or, if
        keys of the take lie between the file's frames, the rate of these keys.
    meshes, time_limit
        As in :func:`read`.
    joints_alone : bool
        Read the armatures of a file without a mesh, with a vertex at each joint. Such a file states
        no bind pose; the rest pose is that in which it was exported.
    max_bytes : int, optional
        Most memory that the transforms of all frames may take; 16 GiB by default.

    Returns
    -------
    Skinning
        Rest pose and transforms in float64, in metres with y up; weights in float32; a clip for
        each take.

    Raises
    ------
    FormatError
        If Blender cannot read the file, shape keys move a mesh, or a mesh has several armatures.
    MissingDependencyError
        If Blender is not found or is older than 4.2.
    """
    job: dict[str, Any] = {"joints_alone": joints_alone, "meshes": meshes}
    arrays = ask_blender("read skinning", path, fps, time_limit, max_bytes, **job)
    with reading(path):
        clips = _clips(arrays, path)
        if len(clips) > 1:
            _log.info("%s: clips %s", path, [clip.name for clip in clips])
        _tell_missed(arrays, clips, path, fps)
        parents, positions = arrays["parents"], arrays["joint_positions"]
        model = make_skinning(
            arrays["rest"],
            arrays["indices"],
            arrays["weights"],
            Bones(json.loads(str(arrays["bones"])), parents, positions, arrays["transforms"]),
            faces=arrays["faces"],
            surface=surface_from(arrays),
            name=_title(arrays, path),
            clips=clips,
            space=_BLENDER,
        )
        return in_space(model, METRES_Y_UP)


def _clips(arrays: dict[str, NDArray[Any]], path: Path) -> tuple[Clip, ...]:
    rows = zip(_names(arrays, path), arrays["frames"], arrays["fps"], strict=True)
    return in_order(Clip(name, 0, int(count), float(rate)) for name, count, rate in rows)


def _tell_missed(
    arrays: dict[str, NDArray[Any]], clips: Sequence[Clip], path: Path, fps: float | None
) -> None:
    """Warn of keys that lie between the sampled frames of clips."""
    for clip, (count, distance, diagonal) in zip(clips, arrays["missed"], strict=False):
        tell(path, clip, int(count), distance, diagonal, own=fps is None)


def _title(arrays: dict[str, NDArray[Any]], path: Path) -> str:
    """Name of the mesh if the file has exactly one, else the file's name without its suffix."""
    return readable(arrays["title"]) if "title" in arrays else path.stem


def _names(arrays: dict[str, NDArray[Any]], path: Path) -> list[str]:
    return [readable(name) for name in json.loads(str(arrays["names"]))] or [path.stem]


def ask_blender(
    action: str,
    path: Path,
    fps: float | None,
    time_limit: float,
    max_bytes: int | None = None,
    **job: Any,
) -> dict[str, NDArray[Any]]:
    """Run an action of ``script.py`` that reads a file, and return the arrays that it writes.

    `job` holds further settings of the action. An error in the script becomes a FormatError, and
    the name of a mesh that does not exist becomes an InputError.
    """
    command(SCRIPT)  # a missing Blender is reported before a damaged file
    suffix = path.suffix.lower()
    with path.open("rb") as stream:
        head = stream.read(64)
    if not head.startswith(_MAGIC[suffix]):
        raise FormatError(f"{path}: not an {suffix} file: {describe(head)}")
    meshes = job.get("meshes")
    if meshes is not None:
        job["meshes"] = mesh_names(meshes)
    job |= {"action": action, "path": str(path.resolve()), "fps": fps or _IMPORT_FPS}
    job |= {"resample": fps is not None, "max_bytes": max_bytes or MOST_BYTES}
    try:
        arrays = run(job, time_limit=time_limit)
    except (InputError, MissingDependencyError):
        raise
    except SsdrError as error:
        raise FormatError(f"{path}: {error}") from error
    choose(meshes, json.loads(str(arrays["meshes"])))
    for name in arrays.get("outside", ()):
        _log.warning("%s: texture %s lies outside its folder and is left out", path, name)
    return arrays


def write_skinning(
    skinning: Skinning,
    path: Path,
    *,
    influences: int | None = None,
    centimetres: bool = False,
    name: str | None = None,
    time_limit: float = 600.0,
) -> SaveReport:
    """Write a skinned ``.fbx``: Blender imports the model as glTF and exports it as FBX.

    The FBX file is read back and compared with the model, so that `error` and `max_error` of the
    report include all that Blender changes. `between_frames` of the report is that of the glTF;
    engines that interpolate FBX's Euler angles differ from it a little.

    Parameters
    ----------
    skinning : Skinning
        In metres with y up.
    path : Path
    influences, name
        As in :func:`ssdr.io.gltf.writer.write_skinning`.
    centimetres : bool
        Whether to store numbers in centimetres, the unit that the file states in any case. By
        default they are metres, below nodes that Blender gives a scale of 100.
    time_limit : float
        Seconds after which Blender is stopped.

    Raises
    ------
    InputError
        If clips have names that are too long for Blender or different frame rates, or the model
        does not fit glTF.
    MissingDependencyError
        If Blender is not found or is older than 4.2.
    SsdrError
        If Blender stops with an error or takes too long, or its file does not hold the model.
    """
    refuse_shapes(skinning, "thing", "FBX; glTF and USD hold them")
    title = name or skinning.name or path.stem
    names = [clip.name or title for clip in skinning.clips]
    long = [one for one in names if len(one.encode()) > _LONGEST_NAME]
    if long:
        raise InputError("thing", f"clip names of at most {_LONGEST_NAME} bytes", long[0])
    check_one_rate(skinning.clips, "as all takes of an FBX file have")
    command(SCRIPT)
    with tempfile.TemporaryDirectory(prefix="ssdr-") as folder, atomic_path(path) as temporary:
        source = Path(folder) / "model.glb"
        # In Blender, clips get short names, because it would change some names, and a whole frame
        # rate, because only then its glTF importer puts keys on frames.
        numbered = [
            dataclasses.replace(c, name=f"c{k}", fps=_IMPORT_FPS)
            for k, c in enumerate(skinning.clips)
        ]
        model = dataclasses.replace(skinning, fps=_IMPORT_FPS, clips=tuple(numbered))
        unit = 0.01 if centimetres else 1.0
        model = transformed(model, 1 / unit)
        stored, lengths = write_along_bones(model, source, influences=influences, name=title)
        job = {
            "action": "write",
            "source": str(source),
            "path": str(temporary.resolve()),
            "fps": skinning.fps,
            "import_fps": _IMPORT_FPS,
            "lengths": lengths,
            "unit": unit,
            "clips": [
                {"name": one, "action": f"c{k}", "frames": clip.n_frames}
                for k, (one, clip) in enumerate(zip(names, skinning.clips, strict=True))
            ],
        }
        written = run(job, time_limit=time_limit)
        if not temporary.is_file():
            raise SsdrError("Blender wrote no FBX file")
    back = read_skinning(path, time_limit=time_limit)
    vertex = written["vertex"]
    if (back.n_frames, back.n_vertices) != (skinning.n_frames, len(vertex)):
        raise SsdrError(
            f"Blender's FBX holds {back.n_frames} frames of {back.n_vertices} vertices, "
            f"not {skinning.n_frames} of {len(vertex)}"
        )
    error = StorageError()
    for block in frame_blocks(0, skinning.n_frames, len(vertex)):
        truth = skinning.skin(block, dtype=np.float64)[:, vertex]
        error.add(back.skin(block, dtype=np.float64), truth)
    dropped = len(skinning.faces) - int(written["triangles"])
    lost = f"{dropped} triangles, which Blender drops: without area, or on the vertices of another"
    return dataclasses.replace(
        stored,
        path=path,
        bytes=path.stat().st_size,
        error=error.rmse,
        max_error=error.largest,
        between_frames=unit * (stored.between_frames or 0.0),
        lost=(lost,) if dropped else (),
    )
