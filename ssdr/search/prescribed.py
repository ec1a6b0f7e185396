"""Parts of a model that a caller hands over: checked, then brought to the solver's space."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import check_mask, check_rest, check_transforms, check_weights
from ..errors import InputError
from ..hierarchy.tree import Tree
from ..joints.matching import limb_distances
from ..skinning import BoneModel, Skinning
from ..solver.trajectories import Alignment, Array

__all__ = ["Prescribed", "check_prescribed", "single_joint"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Prescribed:
    """Parts of a model that the caller hands over, to be kept or to start from.

    Attributes
    ----------
    rest : (V, 3) array or None
        To be kept.
    rest_frame : int
        Frame at which the rest pose starts where none is handed over.
    indices, weights : (V, K) arrays or None
        Kept at `locked_vertices`.
    transforms : (F, B0, 3, 4) array or None
        Kept for `locked_bones`.
    locked_vertices : (V,) mask or None
    locked_bones : (B0,) mask or None
    skeleton : Tree or None
        Parents and joints of the first bones.
    start : (V, 3) array or None
        Rest pose in which the joints of the skeleton lie, where `rest` is None.
    label : (V,) array or None
        The bone of a skeleton of another mesh that moves each vertex, to start from.
    skin : ((V, K) array, (V, K) array) or None
        Joints and weights of a skeleton of the same mesh, to start from.
    sprouts : tuple of int
        Parents of the bones that it gets more; −1: where the error is.
    turns : (F, B0, 3, 3) array or None
        Rotations of its joints relative to their parents that stay; NaN: free.
    """

    rest: Array | None = None
    rest_frame: int = 0
    indices: NDArray[np.int32] | None = None
    weights: Array | None = None
    transforms: Array | None = None
    locked_vertices: NDArray[np.bool_] | None = None
    locked_bones: NDArray[np.bool_] | None = None
    skeleton: Tree | None = None
    start: Array | None = None
    label: NDArray[np.intp] | None = None
    skin: tuple[NDArray[np.int32], Array] | None = None
    sprouts: tuple[int, ...] = ()
    turns: Array | None = None

    @property
    def fixed_bones(self) -> NDArray[np.bool_] | None:
        """`locked_bones` up to the last that is locked; None where none is."""
        if self.locked_bones is None or not self.locked_bones.any():
            return None
        return self.locked_bones[: int(np.flatnonzero(self.locked_bones)[-1]) + 1]

    def of_frames(self, chosen: NDArray[np.int64]) -> Prescribed:
        """The same of the named frames alone, ascending; the rest frame is one of them."""
        transforms = self.transforms
        return dataclasses.replace(
            self,
            rest_frame=int(np.searchsorted(chosen, self.rest_frame)),
            transforms=None if transforms is None else np.ascontiguousarray(transforms[chosen]),
        )

    def inside(self, alignment: Alignment) -> Prescribed:
        """The same in the solver's space."""

        def inward(points: Array) -> Array:
            return np.ascontiguousarray(alignment.from_world(points, None)[0])

        tree = self.skeleton
        if tree is not None:
            tree = dataclasses.replace(tree, points=inward(tree.points))
        transforms = self.transforms
        if transforms is not None:
            _, transforms = alignment.from_world(alignment.centre[:1], transforms)
        return dataclasses.replace(
            self,
            rest=None if self.rest is None else inward(self.rest),
            start=None if self.start is None else inward(self.start),
            transforms=transforms,
            skeleton=tree,
        )


def check_prescribed(
    shape: tuple[int, int, int, int],
    bone_model: BoneModel,
    *,
    rest: Any,
    rest_frame: int,
    indices: Any,
    weights: Any,
    transforms: Any,
    locked_vertices: Any,
    locked_bones: Any,
    skeleton: Skinning | None = None,
    start: Array | None = None,
    sprouts: tuple[int, ...] = (),
    locked_joints: Any = None,
) -> Prescribed:
    """Check the parts that a caller hands over; `shape` is (F, V, B, K)."""
    n_frames, n, bones, influences = shape
    if (indices is None) != (weights is None):
        missing = "indices" if indices is None else "weights"
        raise InputError(missing, "an array beside the other of indices and weights", "None")
    rest = None if rest is None else check_rest(rest, n)
    vertex_mask = check_mask(locked_vertices, "locked_vertices", n)
    if weights is not None:
        indices, weights = _check_skin(indices, weights, n, bones, influences)
        if vertex_mask is None:
            vertex_mask = np.ones(n, dtype=bool)
    elif vertex_mask is not None:
        raise InputError("locked_vertices", "None without indices and weights", "a mask")
    bone_mask = None
    if transforms is not None:
        transforms = check_transforms(transforms, n_frames, bone_model)
        count = transforms.shape[1]
        if count > bones:
            raise InputError("transforms", f"at most {bones} bones, as asked for", count)
        if weights is not None and count != bones:
            raise InputError("transforms", f"{bones} bones beside given weights", count)
        bone_mask = check_mask(locked_bones, "locked_bones", count)
        if bone_mask is None:
            bone_mask = np.ones(count, dtype=bool)
    elif locked_bones is not None:
        raise InputError("locked_bones", "None without transforms", "a mask")
    tree = label = turns = skin = None
    if skeleton is None and locked_joints is not None:
        raise InputError("locked_joints", "None without a skeleton", repr(locked_joints))
    if skeleton is not None:
        if skeleton.parents is None:
            raise InputError("skeleton", "a skinning with a hierarchy", "one without parents")
        if transforms is not None:
            raise InputError("transforms", "None beside a skeleton", "an array")
        points = np.asarray(skeleton.joint_positions, dtype=np.float64)
        tree = Tree(skeleton.parents.astype(np.int64), points, rigid=False)
        if skeleton.n_vertices == n:
            skin = _largest(skeleton, influences)
            start = np.asarray(skeleton.rest, dtype=np.float64)
        elif start is not None:
            label = limb_distances(start if rest is None else rest, tree).argmin(axis=1)
        turns = _kept_turns(skeleton, locked_joints, n_frames)
    return Prescribed(
        skeleton=tree,
        start=start,
        label=label,
        skin=skin,
        sprouts=sprouts,
        turns=turns,
        rest=rest,
        rest_frame=rest_frame,
        indices=indices,
        weights=weights,
        transforms=transforms,
        locked_vertices=vertex_mask,
        locked_bones=bone_mask,
    )


def _largest(skeleton: Skinning, influences: int) -> tuple[NDArray[np.int32], Array]:
    """Joints and weights of the largest influences of every vertex, largest first."""
    weights = np.asarray(skeleton.weights, dtype=np.float64)
    order = np.argsort(-weights, axis=1, kind="stable")[:, :influences]
    weights = np.take_along_axis(weights, order, axis=1)
    indices = np.take_along_axis(np.asarray(skeleton.indices, dtype=np.int32), order, axis=1)
    indices = np.where(weights > 0, indices, 0).astype(np.int32)
    total = weights.sum(axis=1, keepdims=True)
    return np.ascontiguousarray(indices), np.ascontiguousarray(weights / total)


def _kept_turns(skeleton: Skinning, names: Any, n_frames: int) -> Array | None:
    """Local rotations of the named joints in every frame, NaN of the others."""
    if names is None:
        return None
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise InputError("locked_joints", "names of joints of the skeleton", repr(names))
    if skeleton.n_frames not in (1, n_frames):
        expected = f"one pose of the skeleton, or {n_frames} as the sequence has"
        raise InputError("locked_joints", expected, f"{skeleton.n_frames}")
    local = np.asarray(skeleton.local_transforms()[..., :3], dtype=np.float64)
    turns = np.full((n_frames, *local.shape[1:]), np.nan)
    for name in dict.fromkeys(names):
        joint = single_joint(skeleton, name, "locked_joints")
        if skeleton.parents[joint] < 0:
            raise InputError("locked_joints", "joints that have a parent", f"{name!r}, a root")
        turns[:, joint] = local[:, joint]
    return turns


def single_joint(skeleton: Skinning, name: Any, argument: str) -> int:
    """The one joint of a name.

    Raises
    ------
    InputError
        Of `argument`, if there is none or more than one.
    """
    there = [k for k, known in enumerate(skeleton.joint_names) if known == name]
    if len(there) != 1:
        some = ", ".join(skeleton.joint_names[:8])
        expected = f"names of single joints of the skeleton ({some}, ...)"
        raise InputError(argument, expected, f"{name!r}, {len(there)} joints of that name")
    return there[0]


def _check_skin(
    indices: Any, weights: Any, n: int, bones: int, influences: int
) -> tuple[NDArray[np.int32], Array]:
    """Joints and weights, the largest weights first, no bone twice at a vertex."""
    indices, weights = check_weights(indices, weights, n)
    if indices.max() >= bones:
        raise InputError("indices", f"indices from 0 to {bones - 1}", int(indices.max()))
    used = int((weights > 0).sum(axis=1).max())
    if used > influences:
        raise InputError("weights", f"at most {influences} influences a vertex", used)
    order = np.argsort(-weights, axis=1, kind="stable")
    weights = np.ascontiguousarray(np.take_along_axis(weights, order, axis=1))
    indices = np.ascontiguousarray(np.take_along_axis(indices, order, axis=1))
    named = np.sort(np.where(weights > 0, indices, -1 - np.arange(indices.shape[1])), axis=1)
    twice = (named[:, 1:] == named[:, :-1]).any(axis=1)
    if twice.any():
        raise InputError(
            "indices", "no bone twice at a vertex", f"one twice at vertex {int(twice.argmax())}"
        )
    indices[weights == 0] = 0
    return indices, weights
