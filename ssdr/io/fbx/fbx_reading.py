"""Reading of FBX by ufbx, in a process of its own."""

from __future__ import annotations

import dataclasses
import functools
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mesh.clips import Clip, readable, unique_names
from ...mesh.normals import unit
from ...mesh.surface import METRES_Y_UP, Material
from ...model.shapes import Shapes
from ..file_errors import SceneBudget, check
from ..frame_rates import Frames, frame_rate, frames_between
from ..mesh_names import choose, mesh_names
from ..meshes.polygons import cut
from ..optional import check_installed
from ..own_process import run_reader
from ..references import HINT, OUTSIDE, folders_of
from ..sampling import Sample
from ..scene import Bones, Shape, facing, file_weights, nearest_joints
from ..scene_file import SceneFile
from ..signatures import describe

_log = logging.getLogger(__name__)
_SCRIPT = Path(__file__).with_name("fbx_script.py")
Nodes = Sequence[tuple[str, int]]  # name and parent of each
Moment = tuple[int, NDArray[np.int64]]  # a clip, and rows of the frames that were evaluated of it
Skeleton = dict[int, NDArray[np.float64]]


class FbxFile(SceneFile):
    """An FBX file, in metres with y up; each stack of animation with keys is a clip.

    A clip runs over the range that its stack states or, if keys lie outside, over its keys. By
    default it has the frame rate of the file or, if keys lie between the file's frames, that of the
    keys. Of materials only the names are read.
    """

    space = METRES_Y_UP

    def __init__(self, path: Path, max_bytes: int | None = None, meshes: Any = None) -> None:
        check_installed("fbx", "reading FBX")
        with path.open("rb") as stream:
            head = stream.read(64)
        known = b"FBX" in head.upper() or head.lstrip()[:1] == b";"
        check(known, f"not an .fbx file: {describe(head)}")
        self.budget = SceneBudget(path, path.stat().st_size, max_bytes)
        self._wanted = None if meshes is None else mesh_names(meshes)
        self._found, _ = self._run([])
        held: Any = self._found["stacks"] or [("", [0.0, 0.0], [])]
        cached, number = self._found["cached"], -1 if not self._found["stacks"] else 0
        stacks = [(k + number, span, [*keys, *cached]) for k, (_, span, keys) in enumerate(held)]
        self._stacks = [one for one in stacks if one[2]] or stacks[:1]
        names = [readable(held[k - number][0]) or path.stem for k, *_ in self._stacks]
        self.clip_names = unique_names(names)
        for name in self._found["hidden"]:
            _log.info("%s: %s is not shown and left out", path, readable(name))
        shown = self.mesh_names()
        self.name = shown[0] if len(self._found["names"]) == 1 else path.stem

    def _run(self, moments: Sequence[tuple[int, list[float]]], joints_alone: bool = False) -> Any:
        """Run ``fbx_script.py``; return what it found, and arrays for the `moments` of stacks."""
        path = self.budget.path
        job: dict[str, Any] = {"moments": moments, "meshes": self._wanted}
        job |= {"joints_alone": joints_alone, "max_bytes": self.budget.most}
        job |= {"folders": folders_of(path), "outside": f"{OUTSIDE}; {HINT}"}
        found, arrays = run_reader(_SCRIPT, job, "ufbx", path)
        finite = all(np.isfinite(one).all() for one in arrays.values() if one.dtype.kind == "f")
        check(finite, "truncated or damaged: a number that is not finite")
        return found, arrays

    def mesh_names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(readable(names[-2]) for names in self._found["names"]))

    def left_out(self) -> list[str]:
        hidden = [f"{readable(name)} (hidden)" for name in self._found["hidden"]]
        others = self._found["others"].items()
        return hidden + [f"{kind.replace('_', ' ')}: {count}" for kind, count in others if count]

    def materials(self, _parts: Sequence[Any]) -> list[Material]:
        return [Material(name=readable(one) or "material") for one in self._found["materials"]]

    def _frames(self, index: int, fps: float | None) -> Frames:
        """Frames of a clip, in seconds; one if it has keys at one time alone."""
        _, (first, last), times = self._stacks[index]
        keys, stated = np.unique(np.array(times, dtype=np.float64)), float(self._found["fps"])
        check(np.isfinite([first, last, *keys]).all(), "a time that is not finite")
        check(0 < stated < math.inf, f"{stated} frames a second")
        if len(keys) < 2:
            first = float(keys[0]) if len(keys) else first
            return Frames(first, fps or stated, 1, keys[:0], stated).within(self.asked)
        if not first <= keys[0] <= keys[-1] <= last:  # a range of the timeline, not of the stack
            first, last = float(keys[0]), float(keys[-1])
        rate = fps or frame_rate(np.union1d(first, keys), stated) or stated
        frames = frames_between(keys, first, last, rate, asked=fps is not None)
        return dataclasses.replace(frames, tempo=stated).within(self.asked)

    def clips(self, fps: float | None) -> list[Clip]:
        found = [self._frames(k, fps) for k in range(len(self._stacks))]
        named = zip(self.clip_names, found, strict=True)
        return [Clip(name, 0, one.count, one.rate) for name, one in named]

    def sample(self, index: int, fps: float | None, joints_alone: bool = False) -> Sample:
        return self.samples([index], fps, joints_alone)[0]

    def samples(
        self, indices: Sequence[int], fps: float | None, joints_alone: bool = False
    ) -> list[Sample]:
        """Samples of several clips, which are evaluated together, with the keys between frames."""
        choose(self._wanted, [{*map(readable, names)} - {""} for names in self._found["names"]])
        frames = [self._frames(k, fps) for k in indices]
        count = sum(one.count for one in frames)
        self.budget.spend(float(count) * self._found["bytes"], f"{count} frames")
        stamps = [np.union1d(one.times, one.missed if fps is None else one.times) for one in frames]
        moments = [(self._stacks[k][0], t.tolist()) for k, t in zip(indices, stamps, strict=True)]
        found, arrays = self._run(moments, joints_alone)
        check(found["meshes"], "the scene holds no mesh that is shown")
        skeletons: list[Skeleton] = []
        parts = []
        for k, one in enumerate(found["meshes"]):
            n_shapes, n_vertices = len(one["shapes"]), len(arrays[f"points_{k}"])
            what = f"{n_shapes} shapes of {n_vertices} vertices"
            self.budget.spend(24.0 * n_shapes * n_vertices, what)
            parts.append(FbxMesh(k, one, arrays, found["nodes"], skeletons))
        known = (self.clip_names[k] for k in indices)
        return [
            Sample(
                clip=Clip(name, 0, one.count, one.rate),
                parts=parts,
                time=_rows(k, times, one.times),
                at=functools.partial(_rows, k, times),
                frames=one,
            )
            for k, (name, one, times) in enumerate(zip(known, frames, stamps, strict=True))
        ]


def _rows(clip: int, known: NDArray[np.float64], times: NDArray[np.float64]) -> Any:
    """Moment of `times`, which are among the `known` ones of a clip."""
    return clip, np.searchsorted(known, times)


class FbxMesh:
    """A mesh of a node, as a `ScenePart`; polygons are cut into triangles.

    In its rest pose a skinned mesh lies where it was bound, and any other where it is in the first
    frame. A node moves what none of its mesh's bones do. A mesh with a geometry cache, with dual
    quaternion skinning or with several skins has points for every frame, which cannot be read as a
    skinning.

    Parameters
    ----------
    number : int
        Index of the mesh among those that were read.
    record, arrays
        As ``fbx_script.py`` writes them.
    nodes : list of (name, parent)
        All nodes of the file.
    skeletons : list of dict
        Those that are known so far: by nodes, the inverse of each one's matrix in the rest pose.
        The mesh shares one, to which its bones are added, or a new one is appended.
    """

    def __init__(
        self,
        number: int,
        record: Mapping[str, Any],
        arrays: Mapping[str, NDArray[Any]],
        nodes: Nodes,
        skeletons: list[Skeleton],
    ) -> None:
        def own(key: str) -> Any:
            return arrays.get(f"{key}_{number}")

        self._arrays, self._number, self._nodes = arrays, number, nodes
        self._baked, self.name = bool(record["baked"]), readable(nodes[record["node"]][0])
        self._columns = {int(node): k for k, node in enumerate(arrays["used"])}
        bones, to_bone, bind = record["bones"], own("to_bone"), own("bind")
        places = bind @ to_bone[: len(bind)]
        if not len(bind):
            places = arrays["worlds_0"][:, self._columns[bones[-1]]] @ to_bone[-1]
        frame, mirrored = facing(places[:, :3, :3])
        place = places[frame] if _usable(places[frame]) else np.eye(4)
        # the points of a baked mesh lie in the world
        inverses = np.eye(4)[None] if self._baked else to_bone @ np.linalg.inv(place)
        check(all(map(_usable, inverses)), f"{self.name}: a bone of size 0 in the bind pose")
        found = dict(zip(bones, inverses, strict=True))
        same = all(np.allclose(found[node], one) for node, one in zip(bones, inverses, strict=True))
        check(same, f"{self.name}: a bone is bound twice")
        self.skeleton = next((k for k, one in enumerate(skeletons) if _agree(one, found)), -1)
        if self.skeleton < 0:
            self.skeleton = len(skeletons)
            skeletons.append({})
        self._bones = skeletons[self.skeleton]
        self._bones |= {node: one for node, one in found.items() if node not in self._bones}
        order = list(self._bones)
        joint = np.array([order.index(node) for node in bones])[own("joint")]
        self.indices, self.weights = file_weights(joint, own("weights"), len(order), self.name)
        points, index, turn = own("points"), own("indices"), place[:3, :3]
        check(index.max(initial=-1) < len(points), f"{self.name}: a corner at no vertex")
        corners, polygon = cut(own("counts"), index, points)
        corners = corners[:, ::-1] if mirrored else corners  # turned inside out by the matrix
        self.faces, self.material = index[corners], own("material")[polygon]
        uv, normals = own("uv"), own("normals")
        self.uv = None if uv is None else uv[corners].astype(np.float32)
        turned = None if normals is None else unit(normals[corners] @ np.linalg.inv(turn))
        self.normals = None if turned is None else turned.astype(np.float32)
        self.colors = None if own("colors") is None else own("colors")[corners].astype(np.float32)
        self._rest, self._names = points @ turn.T + place[:3, 3], record["shapes"]
        self._moved = np.zeros((len(self._names), *points.shape))
        for k, into in enumerate(self._moved):
            np.add.at(into, own(f"rows_{k}"), own(f"moved_{k}") @ turn.T)

    def shape(self, moment: Moment) -> Shape:
        """Vertices before skinning or, if they change, a function from frame to vertices."""
        if self._baked:
            points = self._values("frames", moment)
            fits = points.shape[1] == len(self._rest)
            check(fits, f"{self.name}: {points.shape[1]} points for {len(self._rest)} vertices")
            return lambda frame: points[frame].astype(np.float64)
        if not self._names:
            return np.asarray(self._rest)
        amounts = self._values("amounts", moment)
        return lambda frame: self._rest + np.tensordot(amounts[frame], self._moved, 1)

    def at_rest(self, moment: Moment) -> tuple[NDArray[np.float64], Shapes | None]:
        """Vertices of the rest pose, and the shapes with their amounts."""
        problem = "a geometry cache, dual quaternions or several skins move it; ssdr.load bakes it"
        check(not self._baked, f"{self.name}: {problem}")
        if not self._names:
            return self._rest, None
        names = [readable(name) for name in self._names]
        return self._rest, Shapes(self._moved, self._values("amounts", moment), names=names)

    def shown(self, moment: Moment) -> NDArray[np.bool_]:
        """Mask (F,) of the frames in which the mesh is visible."""
        return np.asarray(self._arrays[f"shown_{moment[0]}"][moment[1], self._number])

    def _values(self, kind: str, moment: Moment) -> NDArray[Any]:
        return self._arrays[f"{kind}_{moment[0]}_{self._number}"][moment[1]]

    def transforms(self, moment: Moment) -> NDArray[np.float64]:
        """Transforms (F, B, 3, 4) of the bones from the rest pose to world space."""
        columns = [self._columns[node] for node in self._bones]
        worlds = self._arrays[f"worlds_{moment[0]}"][moment[1]][:, columns]
        return np.asarray((worlds @ np.array([*self._bones.values()]))[:, :, :3])

    def bones(self, transforms: NDArray[np.float64]) -> Bones:
        """Bones of the skeleton; the parent of one is the nearest bone above its node."""
        names = [readable(self._nodes[node][0]) for node in self._bones]
        at = np.linalg.inv(np.array([*self._bones.values()]))[:, :3, 3]
        return Bones(names, nearest_joints([*self._bones], self._above), at, transforms)

    def _above(self, node: int) -> Iterator[int]:
        while (node := self._nodes[node][1]) >= 0:
            yield node


def _usable(matrix: NDArray[np.float64]) -> bool:
    """Whether a matrix (4, 4) can be inverted without much loss."""
    return bool(np.linalg.cond(matrix[:3, :3]) < 1e9)


def _agree(known: Skeleton, new: Skeleton) -> bool:
    """Whether two skeletons have the same inverses of the nodes that both have."""
    both = ((known[node], new[node]) for node in known.keys() & new.keys())
    return all(np.abs(a - b).max() <= 1e-6 * np.abs(a).max() for a, b in both)
