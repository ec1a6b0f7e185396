"""Reading of FBX by ufbx, in a process of its own."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mesh.clips import Clip, readable, unique_names
from ...mesh.surface import METRES_Y_UP, Material
from ..file_errors import SceneBudget, check
from ..frame_rates import Frames, frame_rate, frames_between
from ..mesh_names import choose
from ..optional import check_installed
from ..own_process import run_reader
from ..references import HINT, OUTSIDE, folders_of
from ..sampling import Sample
from ..scene_file import SceneFile
from ..signatures import describe
from .fbx_mesh import FbxMesh, JointPoints, Motion, Skeleton

_log = logging.getLogger(__name__)
_SCRIPT = Path(__file__).with_name("fbx_script.py")


class FbxFile(SceneFile):
    """An FBX file, in metres with y up; each stack of animation with keys is a clip.

    A clip runs over the range that its stack states and all its keys. By default it has the frame
    rate of the file or, if keys lie between the file's frames, that of the keys. Of materials only
    the names are read.
    """

    space = METRES_Y_UP

    def __init__(self, path: Path, max_bytes: int | None = None, meshes: Any = None) -> None:
        check_installed("fbx", "reading FBX")
        with path.open("rb") as stream:
            head = stream.read(64)
        known = head.startswith(b"Kaydara FBX") or b"FBX" in head.upper()
        check(known or head.lstrip()[:1] == b";", f"not an .fbx file: {describe(head)}")
        self.budget = SceneBudget(path, path.stat().st_size, max_bytes)
        arrays = self._run()
        self._found = json.loads(str(arrays.pop("found")))
        self._arrays, self._wanted = arrays, meshes
        self._nodes = self._found["nodes"]
        for node in self._nodes:
            node["name"] = readable(node["name"])
        self._stacks = self._find_stacks(path.stem)
        self.clip_names = unique_names([one["name"] for one in self._stacks])
        self._shown = self._find_shown()
        alone = len(self._shown) == 1
        self.name = self._nodes[self._shown[0]["node"]]["name"] if alone else path.stem
        self._parts: Sequence[Any] = ()
        self._nodes_read: list[int] = []
        self._waiting: list[Motion] = []

    def _run(self, **job: Any) -> dict[str, NDArray[Any]]:
        path = self.budget.path
        job = {"moments": [], "nodes": [], "meshes": [], **job, "max_bytes": self.budget.most}
        job |= {"folders": folders_of(path), "outside": f"{OUTSIDE}; {HINT}"}
        return run_reader(_SCRIPT, job, "ufbx", path)

    def _find_stacks(self, title: str) -> list[dict[str, Any]]:
        """Stacks with keys, or else the first one or the scene itself."""
        cached = self._arrays[self._found["caches"]]
        still = {"name": title, "span": [0.0, 0.0], "keys": None, "number": -1}
        stacks = [{**one, "number": k} for k, one in enumerate(self._found["stacks"])] or [still]
        for one in stacks:
            own = cached[:0] if one["keys"] is None else self._arrays[one["keys"]]
            one |= {"name": readable(one["name"]) or title, "keys": np.union1d(cached, own)}
        return [one for one in stacks if len(one["keys"])] or stacks[:1]

    def _find_shown(self) -> list[dict[str, Any]]:
        """Records of the meshes that are shown and have vertices, in the order of an outliner."""
        order = {node: k for k, node in enumerate(self._found["order"])}
        nodes, path = self._nodes, self.budget.path
        held = [one for one in self._found["meshes"] if len(self._arrays[one["points"]])]
        for one in held:
            if nodes[one["node"]]["hidden"]:
                _log.info("%s: %s is not shown and left out", path, nodes[one["node"]]["name"])
        shown = [one for one in held if not nodes[one["node"]]["hidden"]]
        return sorted(shown, key=lambda one: order.get(one["node"], len(order)))

    def _chain(self, node: int) -> list[int]:
        """A node and those above it."""
        found = [node]
        while (node := self._nodes[node]["parent"]) >= 0:
            found.append(node)
        return found

    def mesh_names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(self._nodes[one["node"]]["name"] for one in self._shown))

    def frames(self, stack: dict[str, Any], fps: float | None) -> Frames:
        """Frames of a stack, in seconds; one if it has keys at one time alone."""
        keys, stated = stack["keys"], float(self._found["fps"])
        first, last = stack["span"]
        check(np.isfinite([first, last, *keys]).all(), "a time that is not finite")
        check(0 < stated < math.inf, f"{stated} frames a second")
        if len(keys) < 2:
            return Frames(float(keys[0]) if len(keys) else first, fps or stated, 1, keys[:0])
        first, last = (first, last) if first < last else (keys[0], keys[-1])
        first, last = min(first, float(keys[0])), max(last, float(keys[-1]))
        rate = fps or frame_rate(np.union1d(first, keys), stated) or stated
        return frames_between(keys, first, last, rate, asked=fps is not None)

    def clips(self, fps: float | None) -> list[Clip]:
        found = [self.frames(one, fps) for one in self._stacks]
        return [
            Clip(name, 0, one.count, one.rate)
            for name, one in zip(self.clip_names, found, strict=True)
        ]

    def sample(self, index: int, fps: float | None, joints_alone: bool = False) -> Sample:
        frames = self.frames(self._stacks[index], fps)
        motion = self._motion(index, frames.times)
        if not self._parts:
            self._parts = self._read_parts(joints_alone)
            for part in self._parts:
                part.motion = motion
        parts, nodes = self._parts, len(self._nodes_read)
        each = 128.0 * nodes + sum(part.bytes_per_frame for part in parts)
        what = f"{frames.count} frames of {len(parts)} meshes and {nodes} nodes"
        self.budget.spend(each * frames.count, what)
        return Sample(
            clip=Clip(self.clip_names[index], 0, frames.count, frames.rate),
            parts=parts,
            time=motion,
            at=lambda times: self._motion(index, times),
            frames=frames,
            budget=self.budget,
            own=fps is None,
        )

    def _motion(self, index: int, times: NDArray[np.float64]) -> Motion:
        number = self._stacks[index]["number"]
        self._waiting.append(Motion(number, times, self._evaluate, self._nodes_read))
        return self._waiting[-1]

    def _evaluate(self) -> None:
        """Evaluate the frames of all motions that wait for it, in one run."""
        waiting, self._waiting = self._waiting, []
        arrays = self._run(
            moments=[(one.stack, one.times.tolist()) for one in waiting],
            nodes=self._nodes_read,
            meshes=[part.evaluated for part in self._parts if part.evaluated],
        )
        check(all(np.isfinite(one).all() for one in arrays.values()), "motion that is not finite")
        for number, one in enumerate(waiting):
            one.arrays, one.number = arrays, number

    def _read_parts(self, joints_alone: bool) -> list[FbxMesh]:
        """Meshes to show; if there are none and `joints_alone`, the joints in their place."""
        nodes, shown = self._nodes, self._shown
        above = [[nodes[k]["name"] for k in self._chain(one["node"])] for one in shown]
        names = [{readable(one["name"]), *of} - {""} for one, of in zip(shown, above, strict=True)]
        records = [shown[k] for k in choose(self._wanted, names)]
        skeletons: list[Skeleton] = []
        if not records and joints_alone:
            bones = [k for k in self._found["order"] if nodes[k]["bone"]]
            bones = bones or [k for k in self._found["order"] if k]
            check(bones, "the scene holds no mesh and no joint")
            skeletons = [Skeleton(nodes)]
            skeletons[0].add(bones, list(np.linalg.inv(self._arrays[self._found["binds"]][bones])))
            parts: list[FbxMesh] = [JointPoints(skeletons[0])]
        else:
            check(records, "the scene holds no mesh that is shown")
            for one in records:
                count, points = len(one["shapes"]), len(self._arrays[one["points"]])
                self.budget.spend(24.0 * count * points, f"{count} shapes of {points} vertices")
            parts = [FbxMesh(one, self._arrays, nodes, skeletons) for one in records]
        self._nodes_read += sorted({node for part in parts for node in part.nodes})
        return parts

    def materials(self, _parts: Sequence[Any]) -> list[Material]:
        return [Material(name=readable(one) or "material") for one in self._found["materials"]]
