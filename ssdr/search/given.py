"""Parts of a model that a caller hands over: to begin from, to keep, or to attach bones to."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..hierarchy.tree import Tree
from ..solver.trajectories import Alignment, Array

__all__ = ["Given"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Given:
    """Parts of a model that a caller hands over.

    Attributes
    ----------
    rest : (V, 3) array or None
        Rest pose; stays unless `free`.
    rest_frame : int
        Frame at which the rest pose starts where none is given.
    indices, weights : (V, K) arrays or None
        Skin weights; stay at `locked_vertices`.
    transforms : (F, B0, 3, 4) array or None
        Bones; `locked_bones` of them stay.
    free : bool
        The parts are those of a whole model to improve; nothing of it is locked.
    locked_vertices : (V,) mask or None
    locked_bones : (B0,) mask or None
    tree : Tree or None
        Parents and joints of the first bones.
    keeps_tree : bool
        The tree is that of a skeleton, whose parents stay.
    tree_pose : (V, 3) array or None
        Rest pose in which these joints lie, where `rest` is None.
    nearest_bone : (V,) array or None
        The bone of a skeleton of another mesh that moves each vertex, to start from.
    skeleton_skin : ((V, K) array, (V, K) array) or None
        Indices and weights of a skeleton of the same mesh, to start from.
    extra_parents : tuple of int
        Parents of the bones that a skeleton gets more; −1: where the error is.
    rotations : (F, B0, 3, 3) array or None
        Rotations of its joints relative to their parents that stay; NaN where they are free.
    """

    rest: Array | None = None
    rest_frame: int = 0
    indices: NDArray[np.int32] | None = None
    weights: Array | None = None
    transforms: Array | None = None
    free: bool = False
    locked_vertices: NDArray[np.bool_] | None = None
    locked_bones: NDArray[np.bool_] | None = None
    tree: Tree | None = None
    keeps_tree: bool = False
    tree_pose: Array | None = None
    nearest_bone: NDArray[np.intp] | None = None
    skeleton_skin: tuple[NDArray[np.int32], Array] | None = None
    extra_parents: tuple[int, ...] = ()
    rotations: Array | None = None

    @property
    def leading_locked_bones(self) -> NDArray[np.bool_] | None:
        """`locked_bones` up to the last that is locked; None where none is."""
        if self.locked_bones is None or not self.locked_bones.any():
            return None
        return self.locked_bones[: int(np.flatnonzero(self.locked_bones)[-1]) + 1]

    def of_frames(self, chosen: NDArray[np.int64]) -> Given:
        """The same for the named frames alone, ascending; the rest frame is one of them."""
        transforms = self.transforms
        return dataclasses.replace(
            self,
            rest_frame=int(np.searchsorted(chosen, self.rest_frame)),
            transforms=None if transforms is None else np.ascontiguousarray(transforms[chosen]),
        )

    def inside(self, alignment: Alignment) -> Given:
        """The same in the solver's space."""

        def inward(points: Array | None, name: str) -> Array | None:
            if points is None:
                return None
            return np.ascontiguousarray(alignment.from_world(points, None, (name, ""))[0])

        tree, transforms = self.tree, self.transforms
        if tree is not None:
            owner = "rig.skinning" if self.keeps_tree else "start"
            points = inward(tree.points, f"{owner}.joint_positions")
            assert points is not None
            tree = dataclasses.replace(tree, points=points)
        if transforms is not None:
            names = ("", "start.transforms")
            _, transforms = alignment.from_world(alignment.centre[:1], transforms, names)
        return dataclasses.replace(
            self,
            rest=inward(self.rest, "start.rest"),
            tree_pose=inward(self.tree_pose, "rig.skinning.rest"),
            transforms=transforms,
            tree=tree,
        )
