"""Reading of FBX through Blender, which runs in a process of its own.

A separate process is used because ``bpy`` prints messages, keeps one global scene and requires an
old NumPy.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.clips import Clip, in_order, readable
from ...mesh.sequence import MeshSequence
from ...mesh.surface import METRES_Y_UP, Space
from ...model.skinning import Skinning
from ..arrays.npz import surface_from
from ..file_clips import pick_clip
from ..file_errors import MOST_BYTES, reading
from ..mesh_names import choose, mesh_names
from ..sampling import tell
from ..scene import Bones, make_skinning, vertices_at_joints
from ..signatures import describe
from ..spaces import in_space
from .finder import command, run

SCRIPT = Path(__file__).with_name("read_script.py")
_log = logging.getLogger(__name__)
_BLENDER = Space(1.0, "z")
_listed: dict[Any, dict[str, NDArray[Any]]] = {}


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
    arrays = _ask_blender("read", path, fps, time_limit, max_bytes, **job)
    with reading(path, "clip"):
        names = _names(arrays, path)
        sequence = MeshSequence(
            arrays["vertices"],
            arrays["faces"],
            float(arrays["fps"].item()),
            name=_title(arrays, path),
            clip=names[pick_clip(names, clip, path)],
            surface=surface_from(arrays),
            space=_BLENDER,
        )
        _tell_missed(arrays, [Clip(sequence.clip, 0, len(sequence), sequence.fps)], path, fps)
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
        arrays = _ask_blender("list", path, fps, time_limit)
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
    arrays = _ask_blender("read skinning", path, fps, time_limit, max_bytes, **job)
    with reading(path):
        clips = _clips(arrays, path)
        if len(clips) > 1:
            _log.info("%s: clips %s", path, [clip.name for clip in clips])
        _tell_missed(arrays, clips, path, fps)
        parents, positions = arrays["parents"], arrays["joint_positions"]
        if "rest" not in arrays:
            vertices = positions, *vertices_at_joints(len(positions))
            arrays |= dict(zip(("rest", "indices", "weights", "faces"), vertices, strict=True))
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
    """Warn of keys that lie between the sampled frames of clips, unless the caller chose `fps`."""
    missed = arrays["missed"] if fps is None else ()
    for clip, (count, distance, diagonal) in zip(clips, missed, strict=False):
        tell(path, clip, int(count), distance, diagonal)


def _title(arrays: dict[str, NDArray[Any]], path: Path) -> str:
    """Name of the mesh if the file has exactly one, else the file's name without its suffix."""
    return readable(arrays["title"]) if "title" in arrays else path.stem


def _names(arrays: dict[str, NDArray[Any]], path: Path) -> list[str]:
    return [readable(name) for name in json.loads(str(arrays["names"]))] or [path.stem]


def _ask_blender(
    action: str,
    path: Path,
    fps: float | None,
    time_limit: float,
    max_bytes: int | None = None,
    **job: Any,
) -> dict[str, NDArray[Any]]:
    """Run an action of ``read_script.py`` that reads a file, and return the arrays that it writes.

    `job` holds further settings of the action. The name of a mesh that does not exist raises an
    InputError.
    """
    command(SCRIPT)  # a missing Blender is reported before a damaged file
    with path.open("rb") as stream:
        head = stream.read(64)
    if not head.startswith((b"Kaydara FBX", b"; FBX")):
        raise FormatError(f"{path}: not an .fbx file: {describe(head)}")
    meshes = job.get("meshes")
    if meshes is not None:
        job["meshes"] = mesh_names(meshes)
    job |= {"action": action, "path": str(path.resolve()), "fps": fps or 24.0}
    job |= {"resample": fps is not None, "max_bytes": max_bytes or MOST_BYTES}
    arrays = run(SCRIPT, job, time_limit=time_limit, path=path)
    choose(meshes, json.loads(str(arrays["meshes"])))
    for name in arrays.get("outside", ()):
        _log.warning("%s: texture %s lies outside its folder and is left out", path, name)
    return arrays
