"""One mesh of an FBX file: polygons as triangles, skin, shapes and its motion in a clip."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mesh.clips import readable
from ...mesh.normals import unit
from ...model.shapes import Shapes
from ..file_errors import check
from ..meshes.polygons import cut
from ..scene import Bones, Shape, facing, file_weights, nearest_joints, vertices_at_joints

Arrays = Mapping[str, NDArray[Any]]
Records = Sequence[Mapping[str, Any]]


class Motion:
    """Frames of a clip, evaluated when they are first looked at.

    Parameters
    ----------
    stack : int
        Index of the stack of animation in the file; -1 for the scene as it is.
    times : (F,) float
        In seconds.
    evaluate : callable
        Sets `arrays` and `number`, by which the arrays of these frames are named.
    nodes : list of int
        Nodes whose matrices are evaluated.
    """

    arrays: Arrays | None = None
    number = 0

    def __init__(
        self,
        stack: int,
        times: NDArray[np.float64],
        evaluate: Callable[[], None],
        nodes: Sequence[int],
    ) -> None:
        self.stack, self.times, self._evaluate, self._nodes = stack, times, evaluate, nodes

    def values(self, kind: str, *key: int) -> NDArray[Any]:
        if self.arrays is None:
            self._evaluate()
        assert self.arrays is not None
        return self.arrays["_".join([kind, str(self.number), *map(str, key)])]

    def worlds(self, nodes: Sequence[int]) -> NDArray[np.float64]:
        """Matrices (F, N, 4, 4) from the spaces of nodes to world space."""
        place = {node: k for k, node in enumerate(self._nodes)}
        return self.values("worlds")[:, [place[node] for node in nodes]]


class Skeleton:
    """Nodes that move vertices, and the inverse of each one's matrix in the rest pose.

    Parameters
    ----------
    records : list of dicts
        All nodes of the file.
    """

    def __init__(self, records: Records) -> None:
        self.nodes: list[int] = []
        self.inverses: list[NDArray[np.float64]] = []
        self._records = records

    def add(
        self, nodes: Sequence[int], inverses: Sequence[NDArray[np.float64]]
    ) -> list[int] | None:
        """Indices of bones, which are added where they are new.

        They are None, and nothing is added, if the skeleton has one of the nodes in another rest
        pose.
        """
        known: dict[int, int] = {node: k for k, node in enumerate(self.nodes)}
        for node, inverse in zip(nodes, inverses, strict=True):
            if node in known:
                own = self.inverses[known[node]]
                if np.abs(own - inverse).max() > 1e-6 * np.abs(own).max():
                    return None
        start = len(self.nodes)
        found = [known.get(node, -1) for node in nodes]
        new = [k for k, index in enumerate(found) if index < 0]
        self.nodes += [nodes[k] for k in new]
        self.inverses += [inverses[k] for k in new]
        for place, k in enumerate(new):
            found[k] = start + place
        return found

    def transforms(self, motion: Motion) -> NDArray[np.float64]:
        """Transforms (F, B, 3, 4) from the rest pose to world space."""
        return np.asarray((motion.worlds(self.nodes) @ np.array(self.inverses))[:, :, :3])

    def ancestors(self, node: int) -> Iterable[int]:
        while (node := int(self._records[node]["parent"])) >= 0:
            yield node

    def bones(self, transforms: NDArray[np.float64]) -> Bones:
        names = [str(self._records[node]["name"]) for node in self.nodes]
        at = np.linalg.inv(np.array(self.inverses))[:, :3, 3]
        return Bones(names, nearest_joints(self.nodes, self.ancestors), at, transforms)


class FbxMesh:
    """A mesh of a node, as a `ScenePart`; polygons are cut into triangles.

    In its rest pose a skinned mesh lies where it was bound, and any other where it is in the first
    frame. A mesh with a geometry cache, with dual quaternion skinning or with several skins has
    points for every frame, which cannot be read as a skinning.

    Parameters
    ----------
    record, arrays
        As ``fbx_script.py`` writes them.
    records : list of dicts
        All nodes of the file.
    skeletons : list of Skeleton
        Those that are known so far; a skinned mesh shares one, or a new one is appended.

    Attributes
    ----------
    motion : Motion
        Frames of the first clip.
    """

    motion: Motion

    def __init__(
        self, record: Mapping[str, Any], arrays: Arrays, records: Records, skeletons: list[Skeleton]
    ) -> None:
        self._node, self.name = int(record["node"]), str(records[record["node"]]["name"])
        self._record, self._arrays = record, arrays
        self._points: NDArray[np.float64] = arrays[record["points"]]
        self._geometry = np.array(record["geometry"])
        index, count = arrays[record["indices"]], len(self._points)
        self.corners, polygon = cut(arrays[record["counts"]], index, self._points)
        self._check(index.max(initial=-1) < count, "a corner at a vertex that is not there")
        self._check(np.isfinite(self._points).all(), "a vertex that is not finite")
        self.material: NDArray[np.int64] = arrays[record["material"]][polygon]
        self.indices, self.weights = np.zeros((count, 1), dtype=np.int32), np.ones((count, 1))
        self.skeleton: Any = ("node", self._node)
        self.nodes: Sequence[int] = [self._node]
        if record["skin"] is not None:
            self._read_skin(record["skin"], records, skeletons)

    def _check(self, valid: Any, problem: str) -> None:
        """Raise a FormatError with the text `problem` unless `valid` is true."""
        check(valid, f"{self.name}: {problem}")

    @property
    def evaluated(self) -> tuple[int, int, bool] | None:
        """Node, mesh and whether points are wanted, if more than the node's matrix is evaluated."""
        record = self._record
        wanted = record["baked"] or record["shapes"]
        return (self._node, record["mesh"], bool(record["baked"])) if wanted else None

    @property
    def bytes_per_frame(self) -> float:
        """Memory for an evaluated frame, beside the matrices of nodes."""
        baked = 12.0 * len(self._points) if self._record["baked"] else 0.0
        return baked + 8.0 * len(self._record["shapes"])

    def _read_skin(
        self, skin: Mapping[str, Any], records: Records, skeletons: list[Skeleton]
    ) -> None:
        to_bone, bind = self._arrays[skin["to_bone"]], self._arrays[skin["bind"]]
        bones = np.array(skin["bones"], dtype=np.int64)
        spans, stored = self._arrays[skin["spans"]], self._arrays[skin["weights"]]
        self._check(len(spans) == len(self._points), f"skin weights of {len(spans)} vertices")
        place = np.arange(spans[:, 1].max(initial=0))
        used = place < spans[:, 1:]
        entry = np.where(used, spans[:, :1] + place, len(stored))
        table = np.vstack([stored, [0, 0]])[np.minimum(entry, len(stored))]
        cluster, weights = table[..., 0].astype(np.int64), table[..., 1]
        weights = np.where(bones[cluster] >= 0, weights, 0.0) if len(bones) else weights[:, :0]
        binds = bind[bones >= 0] @ to_bone[bones >= 0]
        usable = [one for one in binds if _is_usable(one)]
        if not usable or not weights.any():
            return  # a skin without bones: the node moves the mesh
        self._place = usable[0], bool(np.linalg.det(usable[0]) < 0)
        back = np.linalg.inv(usable[0])
        nodes, inverses = bones[bones >= 0].tolist(), list(to_bone[bones >= 0] @ back)
        number = np.cumsum(bones >= 0) - 1
        joint = number[cluster]
        bare = weights.sum(axis=1) <= 0
        if bare.any():  # the node moves what no bone does
            nodes, inverses = [*nodes, self._node], [*inverses, self._geometry @ back]
            weights = np.where(bare[:, None] & (np.arange(weights.shape[1]) == 0), 1.0, weights)
            joint = np.where(bare[:, None], len(nodes) - 1, joint)
        regular = all(_is_usable(one) for one in inverses)
        self._check(regular, "a bone of size 0 in the bind pose")
        for skeleton in [*skeletons, Skeleton(records)]:
            found = skeleton.add(nodes, inverses)
            if found is not None:
                break
        if skeleton not in skeletons:
            skeletons.append(skeleton)
        joint = np.array(found)[joint]
        self.indices, self.weights = file_weights(joint, weights, len(skeleton.nodes), self.name)
        self.skeleton, self.nodes = skeleton, skeleton.nodes

    @functools.cached_property
    def _place(self) -> tuple[NDArray[np.float64], bool]:
        """Matrix (4, 4) of the mesh in its rest pose, and whether it mirrors."""
        worlds = self.motion.worlds([self._node])[:, 0] @ self._geometry
        frame, mirrored = facing(worlds[:, :3, :3])
        usable = _is_usable(worlds[frame])
        return (worlds[frame] if usable else np.eye(4)), mirrored

    @property
    def faces(self) -> NDArray[np.int64]:
        return np.asarray(self._arrays[self._record["indices"]][self._turned])

    @property
    def _turned(self) -> NDArray[np.int64]:
        # a mirroring matrix turns triangles inside out
        return np.asarray(self.corners[:, ::-1] if self._place[1] else self.corners)

    @property
    def uv(self) -> NDArray[np.float32] | None:
        return self._at_corners("uv")

    @property
    def normals(self) -> NDArray[np.float32] | None:
        found = self._at_corners("normals")
        if found is None:
            return None
        return unit(found @ np.linalg.inv(self._place[0][:3, :3])).astype(np.float32)

    def _at_corners(self, what: str) -> NDArray[np.float32] | None:
        if self._record[what] is None:
            return None
        found = self._arrays[self._record[what]][self._turned].astype(np.float32)
        self._check(np.isfinite(found).all(), f"{what} that are not finite")
        return found

    @property
    def _rest(self) -> NDArray[np.float64]:
        place = self._place[0]
        return np.asarray(self._points @ place[:3, :3].T + place[:3, 3])

    def _shapes(self, motion: Motion) -> Shapes | None:
        records = self._record["shapes"]
        if not records:
            return None
        moved = np.zeros((len(records), *self._points.shape))
        for into, one in zip(moved, records, strict=True):
            rows, by = self._arrays[one["rows"]], self._arrays[one["moved"]]
            self._check(rows.max(initial=-1) < len(into), "a shape of other vertices")
            np.add.at(into, rows, by @ self._place[0][:3, :3].T)
        amounts = motion.values("amounts", self._record["mesh"])
        return Shapes(moved, amounts, names=[readable(one["name"]) for one in records])

    def shape(self, motion: Motion) -> Shape:
        """Vertices before skinning or, if they change, a function from frame to vertices."""
        if self._record["baked"]:
            points = motion.values("points", self._node)
            count = len(self._points)
            self._check(points.shape[1] == count, f"{points.shape[1]} points for {count} vertices")
            return lambda frame: points[frame].astype(np.float64)
        shapes = self._shapes(motion)
        if shapes is None:
            return self._rest
        return lambda frame: self._rest + shapes.added([frame])[0]

    def at_rest(self, motion: Motion) -> tuple[NDArray[np.float64], Shapes | None]:
        """Vertices of the rest pose, and the shapes with their amounts."""
        problem = (
            "a geometry cache, dual quaternions or several skins move it; ssdr.load bakes them"
        )
        self._check(not self._record["baked"], problem)
        return self._rest, self._shapes(motion)

    def transforms(self, motion: Motion) -> NDArray[np.float64]:
        """Transforms (F, B, 3, 4) of the bones from the rest pose to world space."""
        if isinstance(self.skeleton, Skeleton):
            return self.skeleton.transforms(motion)
        if self._record["baked"]:
            return np.broadcast_to(np.eye(3, 4), (len(motion.times), 1, 3, 4))
        back = self._geometry @ np.linalg.inv(self._place[0])
        return np.asarray((motion.worlds(self.nodes) @ back)[:, :, :3])

    def bones(self, transforms: NDArray[np.float64]) -> Bones:
        """Bones of the skeleton; without a skin, one without a parent."""
        if isinstance(self.skeleton, Skeleton):
            return self.skeleton.bones(transforms)
        return Bones([self.name], np.full(1, -1), self._place[0][None, :3, 3], transforms)


class JointPoints(FbxMesh):
    """The joints of a file without a mesh, with a vertex at each, as a `ScenePart`."""

    evaluated = None

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton, self.nodes, self.name = skeleton, skeleton.nodes, "joints"
        self.indices, self.weights, faces = vertices_at_joints(len(self.nodes))
        self._record, self._arrays = (
            {"baked": False, "shapes": [], "indices": "none"},
            {"none": faces},
        )
        self.corners, self.material = faces, np.zeros(0, dtype=np.int64)
        self._points = np.linalg.inv(np.array(skeleton.inverses))[:, :3, 3]
        self._place = np.eye(4), False


def _is_usable(matrix: NDArray[np.float64]) -> bool:
    """Whether a matrix can be inverted without much loss."""
    return bool(np.isfinite(matrix).all() and np.linalg.cond(matrix[:3, :3]) < 1e9)
