"""The stages that bring bones onto joints and look for a better tree."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from ..search.moves import loosen, polish_steps, thin
from ..search.run import Run, Stage
from ..search.stages import POLISH_STEPS_OF_A_TRY, Change, Search, Start
from ..solver.initialization import fit_patches
from ..solver.model import Model
from .changes import (
    give_up_bone,
    join_touching,
    mirror_edge,
    reparent,
    replace_bone,
    seize,
    split_bone,
)
from .matching import moved_like
from .placement import snap_to_joints, spanning_tree, step_with_joint_penalty

__all__ = ["Contend", "GiveUp", "Hang", "SearchTrees", "SearchWeights", "Sprout", "StartOnSkeleton"]

# Stiffness of the joints, of the lighter bone's mass, from the first step of a ramp to the last.
_RAMP = (1e-2, 100.0)
_MOST_POLISH = 48  # steps of a try that is still on its way below the model that it has to beat
_AHEAD = 4  # as many more blocks of steps as good as the last have to lead below it


@dataclasses.dataclass(frozen=True, kw_only=True)
class Hang(Stage):
    """A tree over free bones, to which they are brought by degrees; on the last step they hang.

    The tree is the model's where it has one.

    Attributes
    ----------
    steps : int
        Of the ramp of stiffness.
    """

    phase: ClassVar[str] = "hang"
    steps: int = 20
    cost: float = 1.5

    def step(self, run: Run) -> bool:
        at = run.memory.count
        if at == 0:
            run.model = run.present.with_influences(run.influences)
            if run.model.tree is None:
                run.model.tree = spanning_tree(run.model)
        model = run.present
        stiffness = np.geomspace(*_RAMP, self.steps)[at]
        step_with_joint_penalty(run.data, model, float(stiffness), run.fixed)
        run.iteration += 1
        if at == self.steps - 1:
            snap_to_joints(run.data, model, run.fixed)
        return at == self.steps - 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class Contend(Stage):
    """Of several starts the lowest is set aside; the run goes on from it after the last.

    Attributes
    ----------
    last : bool
    """

    phase: ClassVar[str] = "contend"
    cost: float = 0
    last: bool = False

    def step(self, run: Run) -> bool:
        if run.aside is None or run.value(run.present) < run.value(run.aside):
            run.aside = run.present.copy()
        if self.last:
            run.model, run.aside = run.aside, None
        return True


@dataclasses.dataclass(frozen=True, kw_only=True)
class StartOnSkeleton(Start):
    """Bones of a skeleton that was handed over, as the vertices move that are theirs.

    Attributes
    ----------
    matched : bool
        Whether the free bones of the model so far say which, else the nearest limb does.
    """

    matched: bool = False

    def _model(self, run: Run) -> Model:
        data, prescribed = run.data, run.prescribed
        tree, label = prescribed.skeleton, prescribed.label
        assert tree is not None
        rest = prescribed.start if prescribed.rest is None else prescribed.rest
        assert rest is not None
        indices, weights = prescribed.indices, prescribed.weights
        if indices is None and prescribed.skin is not None:
            indices, weights = prescribed.skin
        if indices is not None:
            label = indices[:, 0].astype(np.intp)
        assert label is not None
        if self.matched:
            free = run.present
            label = moved_like(data, rest, free.indices[:, 0].astype(np.intp), free.n_bones, tree)
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
class Sprout(Stage):
    """One bone more where the error is, a child of the bone that moved its vertices.

    Until there are as many as asked for; below the bones that were named, where some were.

    Attributes
    ----------
    polish_steps : int
        After each.
    """

    phase: ClassVar[str] = "sprout"
    steps: int = 1000
    cost: float = 40
    polish_steps: int = 6

    @property
    def expected_steps(self) -> int:
        return 4

    def step(self, run: Run) -> bool:
        model = run.present
        if model.n_bones < run.bones:
            wide = model.with_restarted_support()
            start = run.bones - len(run.prescribed.sprouts)
            parent = run.prescribed.sprouts[model.n_bones - start]
            model = split_bone(run.data, wide, run.generator, leaf=True, parent=parent)
            polish_steps(run.data, model, self.polish_steps, run.fixed)
            run.iteration += self.polish_steps
        run.model = model
        return model.n_bones >= run.bones


@dataclasses.dataclass(frozen=True, kw_only=True)
class GiveUp(Stage):
    """The cheapest bone of a tree goes, one by one, until there are as many as asked for.

    Attributes
    ----------
    polish_steps : int
        After each.
    """

    phase: ClassVar[str] = "give up"
    steps: int = 1000
    cost: float = 30
    polish_steps: int = 6

    @property
    def expected_steps(self) -> int:
        return 3

    def step(self, run: Run) -> bool:
        model = run.present
        if model.n_bones > run.bones:
            model = give_up_bone(run.data, model.with_restarted_support(), run.fixed)
            polish_steps(run.data, model, self.polish_steps, run.fixed)
            run.iteration += self.polish_steps
        run.model = model
        return model.n_bones <= run.bones


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchTrees(Search):
    """A search whose changes are those of trees.

    A better tree shows only after many steps: a try is polished on for as long as its last
    steps promise to lead below the model that it has to beat.
    """

    kinds: ClassVar[tuple[Change, ...]] = (
        join_touching,
        seize,
        loosen,
        reparent,
        thin,
        replace_bone,
        mirror_edge,
    )
    changes: ClassVar[int] = len(kinds)

    def settle(self, run: Run, trial: Model, base: float) -> float:
        value = np.inf
        for steps in range(0, _MOST_POLISH, POLISH_STEPS_OF_A_TRY):
            before = value
            polish_steps(run.data, trial, POLISH_STEPS_OF_A_TRY, run.fixed)
            value = run.value(trial)
            if value < base or (steps and value - _AHEAD * (before - value) > base):
                break
        return value


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchWeights(SearchTrees):
    """A search that leaves the tree as it is."""

    kinds: ClassVar[tuple[Change, ...]] = (seize, loosen, thin)
    changes: ClassVar[int] = len(kinds)
