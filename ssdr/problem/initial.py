"""Parts of a model that a caller hands over to begin from, or to attach bones to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..hierarchy.tree import Tree
from ..solver.alignment import Alignment
from ..solver.model import Skin
from ..solver.trajectories import Array, Trajectories

__all__ = ["Initial"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Initial:
    """Parts of a model that a caller hands over.

    Attributes
    ----------
    rest : (V, 3) array or None
        Rest pose.
    rest_frame : int or None
        Frame from which the rest pose is solved if `rest` is None; None until it is chosen.
    skin : Skin or None
    transforms : (F, B0, 3, 4) array or None
        Transforms of the first B0 bones.
    is_model : bool
        Whether the parts are a whole model to improve, of which nothing is locked.
    tree : Tree or None
        Parents and joints of the given bones; bones that are added come after these.
    keeps_tree : bool
        Whether the tree is that of a skeleton, so that its parents are kept.
    tree_pose : (V, 3) array or None
        Rest pose that fits the joints of `tree`; it is used if `rest` is None.
    nearest_bone : (V,) array or None
        For a skeleton of another mesh, the bone nearest each vertex, which moves it at the start.
    skeleton_skin : Skin or None
        For a skeleton of the same mesh, its weights, used as a start.
    extra_parents : tuple of int
        Parents of the bones that are added to a skeleton; −1 if a bone goes where the error is
        largest.
    """

    rest: Array | None = None
    rest_frame: int | None = None
    skin: Skin | None = None
    transforms: Array | None = None
    is_model: bool = False
    tree: Tree | None = None
    keeps_tree: bool = False
    tree_pose: Array | None = None
    nearest_bone: NDArray[np.intp] | None = None
    skeleton_skin: Skin | None = None
    extra_parents: tuple[int, ...] = ()

    def first_pose(self, data: Trajectories) -> Array:
        """Rest pose (V, 3) with which a solve starts, in the space of `data`."""
        return data.frame(self.rest_frame or 0) if self.rest is None else self.rest.copy()

    def beside_model(self) -> Initial:
        """Parts for starts that are tried beside a whole model; without one, these parts."""
        return Initial(rest_frame=self.rest_frame) if self.is_model else self

    def of_vertices(self, kept: NDArray[np.intp]) -> Initial:
        """A copy for the vertices `kept` alone."""

        def some(part: Any) -> Any:
            if isinstance(part, Skin):
                return Skin(*map(some, part))
            return None if part is None else np.ascontiguousarray(part[kept])

        names = ("rest", "skin", "tree_pose", "nearest_bone", "skeleton_skin")
        return replace(self, **{name: some(getattr(self, name)) for name in names})

    def of_frames(self, chosen: NDArray[np.int64]) -> Initial:
        """A copy for the frames `chosen` alone, ascending; `rest_frame` must be one of them."""
        transforms = self.transforms
        return replace(
            self,
            rest_frame=self.rest_frame and int(np.searchsorted(chosen, self.rest_frame)),
            transforms=None if transforms is None else np.ascontiguousarray(transforms[chosen]),
        )

    def inside(self, alignment: Alignment) -> Initial:
        """A copy with rest pose, joints and transforms mapped to the solver's space."""
        inward, inside, tree = alignment.points_from_world, self, self.tree
        if tree is not None:
            owner = "rig.skinning" if self.keeps_tree else "start"
            points = inward(tree.points, f"{owner}.joint_positions")
            inside = replace(inside, tree=replace(tree, points=points))
        if self.transforms is not None:
            moves = alignment.moves_from_world(self.transforms, "start.transforms")
            inside = replace(inside, transforms=moves)
        if self.rest is not None:
            inside = replace(inside, rest=inward(self.rest, "start.rest"))
        if self.tree_pose is not None:
            inside = replace(inside, tree_pose=inward(self.tree_pose, "rig.skinning.rest"))
        return inside
