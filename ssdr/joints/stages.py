"""Stages of a run that attach bones to joints and look for a better tree."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from ..search.moves import exchange_influences, polish_steps
from ..search.run import Run, Schedule, Stage
from ..search.stages import STEPS_OF_A_TRIAL, Change, Search
from ..solver.alternation import vertex_step
from ..solver.initialization import fit_patches
from ..solver.model import Model
from .changes import (
    add_edge_between_skin_neighbours,
    mirror_edge,
    move_bone_to_error,
    remove_cheapest_bone,
    reparent,
    replace_bone,
    split_bone,
)
from .limb_matching import match_by_motion
from .placement import snap_to_joints, spanning_tree, step_with_joint_penalty

__all__ = [
    "AddBones",
    "AttachToJoints",
    "AttachUnattached",
    "FreeBones",
    "RemoveBones",
    "SearchTrees",
    "SearchWeights",
    "StartOnSkeleton",
]

# Stiffness of the joints, relative to the lighter bone's mass, from the first step to the last.
_STIFFNESS = (1e-2, 100.0)
_MOST_POLISH = 48  # most steps of a trial that still approaches the objective it has to beat
_PROMISING = 4.0  # ratio of a tree's objective to the best one up to which the tree is improved
# A trial goes on if this many more blocks of steps, as good as the last one, would beat that
# objective.
_AHEAD = 4


@dataclasses.dataclass(frozen=True, kw_only=True)
class AttachToJoints(Stage):
    """Pull free bones to the joints of a tree with growing stiffness, and finally attach them.

    The tree is the model's own or, if it has none, the spanning tree of smallest gaps.

    Attributes
    ----------
    steps : int
        Number of steps in which the stiffness grows.
    """

    phase: ClassVar[str] = "attach"
    steps: int = 20
    cost: float = 1.5

    def apply(self, run: Run) -> Iterator[None]:
        model = run.model = run.present.with_influences(run.influences)
        if model.tree is None:
            model.tree = spanning_tree(model)
        for k, stiffness in enumerate(np.geomspace(*_STIFFNESS, self.steps)):
            step_with_joint_penalty(run.data, model, float(stiffness), run.locked)
            run.iteration += 1
            if k == self.steps - 1:
                snap_to_joints(run.data, model, run.locked)
            yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class FreeBones(Stage):
    """Improve a model with a tree, then drop the tree and improve the freed bones.

    If the objective with the tree is more than four times the best one so far, the run returns to
    the best model at once.  If the tree becomes the best model, the animation probably comes from a
    skeleton, and better trees are searched before the tree is dropped.

    Attributes
    ----------
    attached, searched, freed : Schedule
        Stages that improve the tree, that search better trees, and that improve the freed bones.
    """

    phase: ClassVar[str] = "free bones"
    cost: float = 0.0
    attached: Schedule
    searched: Schedule
    freed: Schedule

    @property
    def work(self) -> float:
        return sum(stage.work for stage in (*self.attached, *self.freed))

    def apply(self, run: Run) -> Iterator[None]:
        best = run.best_value
        if run.value(run.present) > _PROMISING * best:
            run.model = run.best_model.with_restarted_support()
            return
        for stage in self.attached:
            yield from run.steps_of(stage)
        if run.value(run.present) < best:
            for stage in self.searched:
                yield from run.steps_of(stage)
        run.model = dataclasses.replace(run.present.copy(), tree=None)
        for stage in self.freed:
            yield from run.steps_of(stage)


@dataclasses.dataclass(frozen=True, kw_only=True)
class AttachUnattached(AttachToJoints):
    """Attach the bones of a model to joints, unless they are attached already."""

    def apply(self, run: Run) -> Iterator[None]:
        tree = run.present.tree
        if tree is None or not tree.rigid:
            yield from super().apply(run)


@dataclasses.dataclass(frozen=True, kw_only=True)
class StartOnSkeleton(Stage):
    """Start with the bones of a given skeleton, each fitted to the vertices assigned to it.

    Attributes
    ----------
    by_motion : bool
        Whether to assign vertices by matching the present model's free bones with the skeleton's
        bones.  If not, each vertex starts with the skeleton's weights or, if it has none, with the
        nearest limb.
    """

    phase: ClassVar[str] = "start"
    cost: float = 8
    by_motion: bool = False

    def apply(self, run: Run) -> Iterator[None]:
        run.model = self._model(run)
        vertex_step(run.data, run.model, locked=run.locked)
        yield

    def _model(self, run: Run) -> Model:
        data, given = run.data, run.given
        tree, label = given.tree, given.nearest_bone
        assert tree is not None
        rest = given.tree_pose if given.rest is None else given.rest
        assert rest is not None
        indices, weights = given.indices, given.weights
        if indices is None and given.skeleton_skin is not None:
            indices, weights = given.skeleton_skin
        if indices is not None:
            label = indices[:, 0].astype(np.intp)
        assert label is not None
        if self.by_motion:
            free = run.present
            label = match_by_motion(
                data, rest, free.indices[:, 0].astype(np.intp), free.n_bones, tree
            )
        count = len(tree.parents)
        bones = fit_patches(data, rest, label, count)
        used = np.bincount(label, minlength=count)
        for k in tree.order:  # a bone that moves nothing goes with its parent
            if not used[k] and tree.parents[k] >= 0:
                bones[:, k] = bones[:, tree.parents[k]]
        if indices is None or weights is None:
            model = Model.start(bones, rest, label, 1)
        else:
            model = Model.with_weights(bones, rest, indices, weights, run.influences)
        model.tree = tree if run.rigid_joints else None
        return model


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChangeCount(Stage):
    """Add or remove bones of a tree one by one, with polish, until the wanted number is reached.

    Attributes
    ----------
    polish_steps : int
        Number of polish steps after each bone.
    """

    polish_steps: int = 6

    def apply(self, run: Run) -> Iterator[None]:
        while run.present.n_bones != run.bones:
            model = self.changed(run, run.present.with_restarted_support())
            polish_steps(run.data, model, self.polish_steps, run.locked)
            run.iteration += self.polish_steps
            run.model = model
            yield

    @abstractmethod
    def changed(self, run: Run, model: Model) -> Model:
        """A copy of the model with one bone more or one bone less."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class AddBones(ChangeCount):
    """Add bones to a skeleton where the error is largest, as children of the bones they split.

    If the caller named parents, these are the bones that are split.
    """

    phase: ClassVar[str] = "add bones"
    steps: int = 4  # expected
    cost: float = 40

    def changed(self, run: Run, model: Model) -> Model:
        parents = run.given.extra_parents
        parent = parents[model.n_bones - (run.bones - len(parents))]
        return split_bone(run.data, model, run.rng, leaf=True, parent=parent)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RemoveBones(ChangeCount):
    """Remove the cheapest bone of a tree again and again until the wanted number is left."""

    phase: ClassVar[str] = "remove bones"
    steps: int = 3  # expected
    cost: float = 30

    def changed(self, run: Run, model: Model) -> Model:
        return remove_cheapest_bone(run.data, model, run.locked)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchTrees(Search):
    """A search that changes the tree.

    A better tree shows only after many steps.  Therefore a trial is polished as long as the gain of
    its last steps suggests that it will beat the objective it is compared with.
    """

    changes: ClassVar[tuple[Change, ...]] = (
        add_edge_between_skin_neighbours,
        move_bone_to_error,
        reparent,
        exchange_influences,
        replace_bone,
        mirror_edge,
    )

    def polished_value(self, run: Run, trial: Model, base: float) -> float:
        value = np.inf
        for steps in range(0, _MOST_POLISH, STEPS_OF_A_TRIAL):
            before = value
            polish_steps(run.data, trial, STEPS_OF_A_TRIAL, run.locked)
            value = run.value(trial)
            if value < base or (steps and value - _AHEAD * (before - value) > base):
                break
        return value


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchWeights(SearchTrees):
    """A search that keeps the edges of the tree."""

    changes: ClassVar[tuple[Change, ...]] = (move_bone_to_error, exchange_influences)
