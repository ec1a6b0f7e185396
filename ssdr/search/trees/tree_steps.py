"""Steps of a descent that attach bones to joints and look for a better tree."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...solver.alternation import vertex_step
from ...solver.initialization import fit_patches, nearest_bones
from ...solver.model import Model
from ...solver.rest_surface import RestSurface
from ...solver.trajectories import Array, Trajectories
from ...solver.vertex_newton import optimise_vertices
from ..descent import Descent, step
from ..moves import exchange_influences, polish_steps
from ..steps import STEPS_OF_A_TRIAL, Change, tried
from .limb_matching import match_by_motion
from .placement import snap_to_joints, spanning_tree, step_with_joint_penalty
from .tree_moves import (
    add_edge_between_skin_neighbours,
    mirror_edge,
    move_bone_to_error,
    remove_cheapest_bone,
    reparent,
    replace_bone,
    split_bone,
)

# Stiffness of the joints, relative to the lighter bone's mass, from the first step to the last.
_STIFFNESS = (1e-2, 100.0)
_MOST_POLISH = 48  # most steps of a trial that still approaches the objective it has to beat
# A trial goes on if this many more blocks of steps, as good as the last one, would beat that
# objective.
_AHEAD = 4
_POLISH_STEPS = 6  # after a bone is added or removed
_FREE_STEPS = 40  # of weights and rest pose that nothing holds, under a given motion of joints

_WEIGHTS: tuple[Change, ...] = (move_bone_to_error, exchange_influences)
_TREES: tuple[Change, ...] = (
    add_edge_between_skin_neighbours,
    move_bone_to_error,
    reparent,
    exchange_influences,
    replace_bone,
    mirror_edge,
)


@step("attach", cost=1.5)
def attach(d: Descent, *, steps: int = 20) -> Iterator[None]:
    """Pull free bones to the joints of a tree with growing stiffness, and finally attach them.

    The tree is the model's own or, if it has none, the spanning tree of smallest gaps.
    """
    model = d.model = d.model.with_influences(d.influences)
    if model.tree is None:
        model.tree = spanning_tree(model, parts=d.data.parts)
    for k, stiffness in enumerate(np.geomspace(*_STIFFNESS, steps)):
        step_with_joint_penalty(d.data, model, float(stiffness), d.constraints)
        d.work.iteration += 1
        if k == steps - 1:
            snap_to_joints(d.data, model, d.constraints)
        yield


def attach_unattached(d: Descent) -> None:
    """Attach the bones at joints, unless those of the present model are attached."""
    if d.planning or d.model.tree is None or not d.model.tree.rigid:
        attach(d)


@step("start", cost=8)
def start_on_skeleton(d: Descent, *, by_motion: bool = False) -> Iterator[None]:
    """Start with the bones of a given skeleton, each fitted to the vertices assigned to it.

    A vertex is assigned to the bone of its largest weight or, if the skeleton has no weights, to
    the nearest limb.  If `by_motion`, it is assigned to the skeleton's bone that matches the free
    bone that moves it most in the present model.
    """
    data, initial = d.data, d.initial
    tree, label = initial.tree, initial.nearest_bone
    assert tree is not None
    rest = initial.tree_pose if initial.rest is None else initial.rest
    assert rest is not None
    skin = initial.skin or initial.skeleton_skin
    if skin is not None:
        label = skin.indices[:, 0].astype(np.intp)
    assert label is not None
    if by_motion:
        largest = d.model.indices[:, 0].astype(np.intp)
        label = match_by_motion(data, rest, largest, d.model.n_bones, tree)
    count = len(tree.parents)
    bones = fit_patches(data, rest, label, count)
    used = np.bincount(label, minlength=count)
    for k in tree.order:  # a bone that moves nothing goes with its parent
        if not used[k] and tree.parents[k] >= 0:
            bones[:, k] = bones[:, tree.parents[k]]
    if skin is None:
        d.model = Model.start(bones, rest, label, 1)
    else:
        d.model = Model.with_weights(bones, rest, *skin, d.influences)
    d.model.tree = tree if d.rigid_joints else None
    vertex_step(data, d.model, constraints=d.constraints)
    yield


@step("start", cost=_FREE_STEPS)
def start_on_joints(d: Descent) -> Iterator[None]:
    """Start with the given motion of joints; a vertex without weights follows its best bone.

    Where the pose in which the joints rest is that of no frame and of no known mesh, each vertex is
    taken back to it from the rest frame, first by one bone, then by free solves of weights and rest
    pose.  The surface of the result is the one that holds the rest pose from then on.
    """
    data, initial, bones, surface = d.data, d.initial, d.initial.transforms, d.data.surface
    assert bones is not None
    rest = initial.tree_pose if initial.rest is None else initial.rest
    skin, known = initial.skin or initial.skeleton_skin, rest is not None
    if rest is None:
        d.data = dataclasses.replace(data, surface=None)
        label, rest = _unposed(data, bones, initial.rest_frame or 0)
    elif skin is None:
        label = nearest_bones(data, rest, bones)
    if skin is None:
        d.model = Model.start(bones, rest, label, d.influences)
    else:
        d.model = Model.with_weights(bones, rest, *skin, d.influences)
    vertex_step(d.data, d.model, constraints=d.constraints)
    if not known:
        for _ in range(_FREE_STEPS):
            optimise_vertices(d.data, d.model, constraints=d.constraints)
        if surface is not None:
            surface = RestSurface.build(data.faces, d.model.rest)
        d.data = dataclasses.replace(data, surface=surface)
    yield


def _unposed(data: Trajectories, bones: Array, frame: int) -> tuple[NDArray[np.intp], Array]:
    """Bone (V,) that alone moves each vertex best from a frame, and its place (V, 3) at rest."""
    back, shift = np.linalg.inv(bones[frame, :, :, :3]), bones[frame, :, :, 3]
    points = data.frame(frame)
    turned = bones[..., :3] @ back
    moved = bones[..., 3] - np.einsum("tbij,bj->tbi", turned, shift)
    label = nearest_bones(data, points, np.concatenate([turned, moved[..., None]], axis=-1))
    return label, np.einsum("vij,vj->vi", back[label], points - shift[label])


@step("skin")
def solve_skin(d: Descent, *, steps: int = 60, gain: float = 1e-4) -> Iterator[None]:
    """Solve weights and rest pose together, until a step gains less than the fraction `gain`."""
    for _ in range(steps):
        before = d.value(d.model)
        optimise_vertices(d.data, d.model, constraints=d.constraints)
        d.work.iteration += 1
        d.converged = not d.value(d.model) < (1 - gain) * before
        yield
        if d.converged:
            return


@step("add bones", cost=40)
def add_bones(d: Descent, *, steps: int = 4) -> Iterator[None]:
    """Add bones to a skeleton where the error is largest, as children of the bones they split.

    If the caller named parents, these are the bones that are split.
    """
    parents = d.initial.extra_parents
    while d.model.n_bones < d.bones:
        parent = parents[d.model.n_bones - (d.bones - len(parents))]
        model = d.model.with_restarted_support()
        _polish_changed(d, split_bone(d.data, model, d.rng, leaf=True, parent=parent))
        yield


@step("remove bones", cost=30)
def remove_bones(d: Descent, *, steps: int = 3) -> Iterator[None]:
    """Remove the bone whose removal costs least, repeatedly, until `d.bones` are left."""
    while d.model.n_bones > d.bones:
        model = d.model.with_restarted_support()
        _polish_changed(d, remove_cheapest_bone(d.data, model, d.constraints))
        yield


def _polish_changed(d: Descent, model: Model) -> None:
    polish_steps(d.data, model, _POLISH_STEPS, d.constraints)
    d.work.iteration += _POLISH_STEPS
    d.model = model


@step("search", cost=60)
def search_trees(d: Descent, *, steps: int) -> Iterator[None]:
    """Try `steps` changes of tree, bones or influences, polish each, and keep improvements."""
    return tried(d, _TREES, _polished_value, steps=steps, success=1e-3)


@step("search", cost=60)
def search_weights(d: Descent, *, steps: int) -> Iterator[None]:
    """Try `steps` changes of bones or influences, not of the tree's edges; keep improvements."""
    return tried(d, _WEIGHTS, _polished_value, steps=steps, success=1e-3)


def _polished_value(d: Descent, trial: Model, base: float) -> float:
    """Polish a trial (in place) as long as it may beat `base`; return its objective.

    A better tree shows only after many steps.  Therefore a trial is polished as long as the gain of
    its last steps suggests that its objective will fall below `base`.
    """
    value = np.inf
    for steps in range(0, _MOST_POLISH, STEPS_OF_A_TRIAL):
        before = value
        polish_steps(d.data, trial, STEPS_OF_A_TRIAL, d.constraints)
        value = d.value(trial)
        if value < base or (steps and value - _AHEAD * (before - value) > base):
            break
    return value
