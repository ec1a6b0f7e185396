"""Reading of Alembic by alembic3d, in a process of its own."""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.clips import Clip, readable
from ...mesh.sequence import MeshSequence
from ...mesh.surface import UNKNOWN, Material
from ..file_errors import check, reading
from ..frame_rates import sample_frames
from ..mesh_names import choose, mesh_names
from ..optional import check_installed
from ..own_process import run_script
from ..sampling import Sample
from ..scene import SceneBudget, join_sequence
from ..signatures import describe
from .cache_mesh import CacheMesh, Transforms, object_name

_log = logging.getLogger(__name__)
_SCRIPT = Path(__file__).with_name("alembic_script.py")


def read(
    path: Path,
    *,
    fps: float | None = None,
    meshes: str | Sequence[str] | None = None,
    time_limit: float = 600.0,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read all meshes that are shown, in world space, at the times that the file states.

    Between two samples, vertices and transforms are interpolated linearly.

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
        least 1 GiB and at most 16 GiB.

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
        If alembic3d is not installed.
    """
    with reading(path, "meshes", "time_limit"):
        _check_file(path)
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
        frames = sample_frames(_stamps([times for part in parts for times in part.clocks]), fps)
        n_vertices = sum(part.n_points for part in parts)
        budget.spend(
            frames.count * (12.0 * n_vertices + 256.0 * len(parts)),
            f"{frames.count} frames of {n_vertices} vertices",
        )
        name = object_name(parts[0].names) if len(parts) == 1 else path.stem
        surfaces = [Material(name=one) for one in materials]
        sample = Sample(
            clip=Clip(path.stem, 0, frames.count, frames.rate),
            parts=parts,
            time=frames.times,
            at=np.asarray,
            frames=frames,
            path=path,
            own=fps is None,
        )
        return join_sequence(sample, surfaces, name, UNKNOWN)


def list_meshes(path: Path, *, time_limit: float = 600.0) -> tuple[str, ...]:
    """Sorted names of the objects whose meshes are visible."""
    with reading(path, "time_limit"):
        _check_file(path)
        most = SceneBudget(path, path.stat().st_size).most
        found, _ = _read_archive(path, [], time_limit, most)
        return tuple(sorted(object_name(names) for names in found["names"]))


def _check_file(path: Path) -> None:
    """Raise an error unless the file is Alembic of the kind Ogawa and alembic3d is installed."""
    with path.open("rb") as stream:
        head = stream.read(16)
    if head.startswith(b"\x89HDF"):
        raise FormatError(
            "an Alembic file of the old kind HDF5, which alembic3d does not read; "
            "abcconvert -toOgawa OLD NEW of the Alembic library converts it"
        )
    check(head.startswith(b"Ogawa"), f"not an .abc file: {describe(head)}")
    check_installed("alembic", "reading Alembic")


def _stamps(clocks: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Ascending times of the samples of all objects that move."""
    stamps = np.unique(np.concatenate([one for one in clocks if len(one) > 1] or clocks[:1]))
    # equal times of two objects may differ by their rounding
    return np.asarray(stamps[np.diff(stamps, prepend=-np.inf) > 1e-6])


def _read_archive(
    path: Path, wanted: list[str] | None, time_limit: float, max_bytes: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run ``alembic_script.py`` on a file; return records and arrays of the meshes `wanted`.

    If `wanted` is None, these are all meshes.
    """
    arrays = run_script(
        [sys.executable, "-P", str(_SCRIPT)],
        {"path": str(path.resolve()), "meshes": wanted, "max_bytes": max_bytes},
        who="alembic3d",
        # what can be imported here can be imported there
        environment={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        time_limit=time_limit,
        path=path,
    )
    found = json.loads(str(arrays.pop("found")))
    check(found["names"], "no mesh that is shown")
    found["names"] = [[readable(name) for name in one] for one in found["names"]]
    return found, arrays
