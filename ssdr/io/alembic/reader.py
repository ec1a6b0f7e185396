"""Reading of Alembic: by alembic3d in a process of its own or, without it, by Blender."""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...clips import Clip, readable
from ...errors import FormatError, InputError, MissingDependencyError, SsdrError
from ...sequence import MeshSequence
from ...space import UNKNOWN
from ...surface import Material
from ..mesh_names import choose, mesh_names
from ..process import run_script
from ..registry import check, reading
from ..sampling import Missed, Sample
from ..scene import SceneBudget, join_sequence
from ..spaces import with_space
from .clock import archive_clocks, check_kind, choose_frames
from .parts import CacheMesh, Transforms, object_name

_log = logging.getLogger(__name__)
_SCRIPT = Path(__file__).with_name("archive.py")


def read(
    path: Path,
    *,
    fps: float | None = None,
    meshes: str | Sequence[str] | None = None,
    time_limit: float = 600.0,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read all meshes that are shown, in world space, at the times that the file states.

    Without alembic3d, Blender reads the file. Between two samples, vertices and transforms are
    interpolated linearly.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Frames per second at which to sample. By default each sample is a frame. If the samples
        have no common rate, the median rate is used, but at least 24, and a warning states the
        largest distance between the missed samples and what is read.
    meshes : str or several of them, optional
        Names of the meshes to read, or of objects above them; all by default.
    time_limit : float
        Seconds after which reading is stopped.
    max_bytes : int, optional
        Most memory that reading may take; by default 1000 times the size of the file, but at
        least 1 GiB and at most 16 GiB. With Blender, the limit applies to the vertices of all
        frames, and is 16 GiB by default.

    Returns
    -------
    MeshSequence
        Vertices in float32, as in the file, which states neither unit nor up axis; meshes are
        sorted by the names of the objects above them. Each polygon is cut into a fan of triangles.
        Materials are the file's sets of faces, which have nothing but names.

    Raises
    ------
    FormatError
        If the file is damaged or holds no mesh that is shown, or the topology of a mesh changes.
    InputError
        If the file has no mesh of such a name.
    MissingDependencyError
        If there is neither alembic3d nor Blender.
    """
    with reading(path, "meshes", "time_limit"):
        _check_file(path)
        if not _installed():
            return _through_blender(path, fps, meshes, time_limit, max_bytes)
        budget = SceneBudget(path, path.stat().st_size, max_bytes)
        wanted = None if meshes is None else mesh_names(meshes)
        found, arrays = _read_archive(path, wanted, time_limit, budget.most)
        choose(meshes, found["names"])
        for hidden in found["hidden"]:
            _log.info("%s: %s is not shown and left out", path, readable(hidden))
        materials: list[str] = []
        nodes = Transforms(found["transforms"], arrays)
        parts = [CacheMesh(one, arrays, nodes, materials) for one in found["meshes"]]
        # as Blender names and sorts objects
        parts = sorted((p for p in parts if p.n_points), key=lambda part: object_name(part.names))
        check(parts, "no mesh with vertices")
        frames = choose_frames([times for part in parts for times in part.clocks], fps)
        n_vertices = sum(part.n_points for part in parts)
        budget.spend(
            frames.count * (12.0 * n_vertices + 256.0 * len(parts)),
            f"{frames.count} frames of {n_vertices} vertices",
        )
        name = object_name(parts[0].names) if len(parts) == 1 else path.stem
        surfaces = [Material(name=one) for one in materials]
        missed = Missed(
            path=path,
            times=frames.missed,
            first=frames.first,
            rate=frames.rate,
            own=fps is None,
            at=lambda times: times,
        )
        clip = Clip(path.stem, 0, frames.count, frames.rate)
        sample = Sample(clip, parts, frames.times, missed)
        return join_sequence(sample, surfaces, name, UNKNOWN)


def list_meshes(path: Path, *, time_limit: float = 600.0) -> tuple[str, ...]:
    """Sorted names of the objects whose meshes are visible."""
    with reading(path, "time_limit"):
        _check_file(path)
        if not _installed():
            from ..blender.bridge import list_meshes as list_by_blender

            return list_by_blender(path, time_limit=time_limit)
        most = SceneBudget(path, path.stat().st_size).most
        found, _ = _read_archive(path, [], time_limit, most)
        return tuple(sorted(object_name(names) for names in found["names"]))


def _check_file(path: Path) -> None:
    with path.open("rb") as stream:
        check_kind(stream.read(16))


def _installed() -> bool:
    return importlib.util.find_spec("alembic3d") is not None


def _read_archive(
    path: Path, wanted: list[str] | None, time_limit: float, max_bytes: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run ``archive.py`` on a file; return records and arrays of the meshes `wanted`.

    If `wanted` is None, these are all meshes.
    """
    job = {"path": str(path.resolve()), "meshes": wanted, "max_bytes": max_bytes}
    # what can be imported here can be imported there
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}

    def words(order: str) -> list[str]:
        return [sys.executable, "-P", str(_SCRIPT), order]

    try:
        arrays = run_script(
            words, job, who="alembic3d", environment=environment, time_limit=time_limit
        )
    except (InputError, MissingDependencyError):
        raise
    except SsdrError as error:
        crashed = str(error).startswith("alembic3d failed")
        raise FormatError(f"{'truncated or damaged: ' * crashed}{error}") from error
    found = json.loads(str(arrays.pop("found")))
    check(found["names"], "no mesh that is shown")
    found["names"] = [[readable(name) for name in one] for one in found["names"]]
    return found, arrays


def _through_blender(
    path: Path,
    fps: float | None,
    meshes: str | Sequence[str] | None,
    time_limit: float,
    max_bytes: int | None,
) -> MeshSequence:
    from ..blender.bridge import ask_blender, sequence_of

    frames = choose_frames(archive_clocks(path), fps)
    clock = (frames.first, frames.rate, frames.count, frames.missed.tolist())
    job: dict[str, Any] = {"meshes": meshes, "clock": clock}
    try:
        arrays = ask_blender("read", path, frames.rate, time_limit, max_bytes, **job)
    except MissingDependencyError as error:
        raise MissingDependencyError(
            f"{path}: Alembic needs the package alembic3d (pip install alembic3d) or Blender. "
            f"{error}"
        ) from error
    return with_space(sequence_of(arrays, path, path.stem, fps), UNKNOWN)
