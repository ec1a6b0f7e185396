"""Reading of Alembic by alembic3d, in a process of its own."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.clips import Clip, readable
from ...mesh.surface import UNKNOWN, Material
from ..file_errors import SceneBudget, check
from ..frame_rates import sample_frames
from ..mesh_names import choose, mesh_names
from ..optional import check_installed
from ..own_process import run_reader
from ..sampling import Sample
from ..scene_file import SceneFile
from ..signatures import describe
from .cache_mesh import CacheMesh, Transforms, object_name

_log = logging.getLogger(__name__)
_SCRIPT = Path(__file__).with_name("alembic_script.py")


class AlembicFile(SceneFile):
    """A cache, which states neither unit nor up axis, and of materials only their names.

    Its meshes are sorted by the names of the objects above them. By default each sample is a frame.
    If the samples have no common rate, the median rate is used, but at least 24. Between two
    samples, vertices and transforms are interpolated linearly.
    """

    space = UNKNOWN

    def __init__(self, path: Path, max_bytes: int | None = None, meshes: Any = None) -> None:
        _check_file(path)
        self._wanted = None if meshes is None else mesh_names(meshes)
        self.budget = SceneBudget(path, path.stat().st_size, max_bytes)
        self.name, self.clip_names = path.stem, [path.stem]
        self._materials: list[str] = []

    def mesh_names(self) -> list[str]:
        found, _ = self._read([])
        return sorted(object_name(names) for names in found["names"])

    def left_out(self) -> list[str]:
        found, _ = self._read([])
        hidden = [f"{readable(name).rsplit('/', 1)[-1]} (hidden)" for name in found["hidden"]]
        return hidden + [f"{count} {readable(kind)}" for kind, count in found["others"].items()]

    def materials(self, _parts: Sequence[Any]) -> list[Material]:
        return [Material(name=one) for one in self._materials]

    def sample(self, _index: int, fps: float | None, _joints_alone: bool = False) -> Sample:
        found, arrays = self._read(self._wanted)
        choose(self._wanted, found["names"])
        for hidden in found["hidden"]:
            _log.info("%s: %s is not shown and left out", self.budget.path, readable(hidden))
        nodes = Transforms(found["transforms"], arrays)
        parts = [CacheMesh(one, arrays, nodes, self._materials) for one in found["meshes"]]
        # as Blender names and sorts objects
        parts = sorted((p for p in parts if p.n_points), key=lambda part: object_name(part.names))
        check(parts, "no mesh with vertices")
        if len(parts) == 1:
            self.name = object_name(parts[0].names)
        stamps = _stamps([times for part in parts for times in part.clocks])
        frames = sample_frames(stamps, fps)
        own = frames.rate if fps is None else sample_frames(stamps, None).rate
        frames = dataclasses.replace(frames, tempo=own).within(self.asked)
        n_vertices = sum(part.n_points for part in parts)
        what = f"{frames.count} frames of {n_vertices} vertices"
        self.budget.spend(256.0 * frames.count * (len(parts) + len(nodes.clocks)), what)
        clip = Clip(self.clip_names[0], 0, frames.count, frames.rate)
        return Sample(clip=clip, parts=parts, time=frames.times, at=np.asarray, frames=frames)

    def _read(self, wanted: list[str] | None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Run ``alembic_script.py``; return records and arrays of the meshes `wanted`, or all."""
        job = {"meshes": wanted, "max_bytes": self.budget.most}
        found, arrays = run_reader(_SCRIPT, job, "alembic3d", self.budget.path)
        check(found["names"], "no mesh that is shown")
        found["names"] = [[readable(name) for name in one] for one in found["names"]]
        return found, arrays


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
