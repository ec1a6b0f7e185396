"""Search for nested levels: models of several bone counts, the coarser with bones of the finer.

The levels share the transforms: the bones are sorted so that a level of B bones uses the first B.
Each level has weights and a rest pose of its own.  With E_l the squared error of level l, and E*_l
that of an independent model with as many bones, the objective is Σ_l (E_l / E*_l)^(p/2), which a
large p makes depend mostly on the largest ratio.

To move the bones of all levels at once, the vertices of all levels are stacked into one mesh.  The
importance of each vertex is multiplied by the derivative of the objective with respect to its
level's E_l.  A Gauss–Newton step on this mesh keeps the influences; each level chooses them between
such steps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..solver.alternation import bone_costs, vertex_step
from ..solver.gauss_newton import GaussNewton
from ..solver.model import ARRAYS, FREE, Model
from ..solver.trajectories import Array, Trajectories
from ..solver.vertex_newton import optimise_vertices
from .moves import drop_influence
from .vertex_sample import model_of_all, motion_sample, sample_size

_POWER = 6  # p of the objective
_WIDER = 4  # influences beyond the requested number, with which the search begins
_STEPS = 3  # Gauss–Newton steps between two choices of influences
_ROUNDS, _ROUNDS_OF_A_TRIAL = 3, 2  # rounds of steps and choice at each number of influences
_MOST_WIDER = 3  # most influences that a trial adds
_SWAPS = 0.2  # share of the trials that exchange two bones
_CHEAPEST = 3  # number of cheapest bones among which a swap draws


@dataclasses.dataclass(frozen=True, eq=False)
class Nested:
    """Search for nested levels: its data, the errors to compare with, and its random generator.

    Attributes
    ----------
    data : Trajectories
    targets : (L,) array
        Squared error E*_l of an independent model with as many bones as each level.
    influences : int
    rng : numpy.random.Generator
    """

    data: Trajectories
    targets: Array
    influences: int
    rng: np.random.Generator

    def ratios(self, levels: Sequence[Model]) -> Array:
        """E_l / E*_l of each level."""
        errors = [level.weighted_error(self.data) for level in levels]
        return np.maximum(errors, 1e-300) / self.targets

    def value(self, levels: Sequence[Model]) -> float:
        return float((self.ratios(levels) ** (_POWER / 2)).sum())

    def polish(self, levels: list[Model], rounds: int) -> list[Model]:
        """Choose the influences of each level (in place), then move all bones; `rounds` times.

        Returns the moved levels.
        """
        n, damping = self.data.n_vertices, 1e-3
        stacked = self.data.select_vertices(np.tile(np.arange(n), len(levels)))
        if self.data.surface is not None:
            surface = self.data.surface.repeated(len(levels))
            stacked = dataclasses.replace(stacked, surface=surface)
        for _ in range(rounds):
            for level in levels:
                level.restart_support()
                optimise_vertices(self.data, level)
            share = self.ratios(levels) ** (_POWER / 2 - 1) / self.targets
            importance = np.repeat(share, n) * np.tile(self.data.importance, len(levels))
            data = dataclasses.replace(stacked, importance=importance / importance.mean())
            widths = [level.n_influences for level in levels]
            padded = [level.with_influences(max(widths)) for level in levels]
            parts: dict[str, Any] = {
                k: np.concatenate([getattr(x, k) for x in padded]) for k in ARRAYS[1:]
            }
            joined = Model(transforms=levels[0].transforms, **parts)
            # with a damping, it keeps the influences
            damping = GaussNewton(data, joined, damping=damping).run(_STEPS, entering=False)
            blocks = [
                joined.select_vertices(np.arange(k * n, k * n + n)) for k in range(len(levels))
            ]
            levels = [
                _with_transforms(block.with_influences(k), joined.transforms[:, : level.n_bones])
                for block, level, k in zip(blocks, levels, widths, strict=True)
            ]
        return levels

    def narrowed(self, levels: list[Model], rounds: int) -> list[Model]:
        """Polish and drop an influence in turn until no vertex has more than `influences`.

        Returns the changed levels.
        """
        while True:
            levels = self.polish(levels, rounds)
            count = max(level.n_influences for level in levels)
            if count <= self.influences:
                return levels
            for level in levels:
                if level.n_influences == count:
                    drop_influence(self.data, level, FREE)
            levels = [x.with_influences(min(count - 1, x.n_influences)) for x in levels]

    def search(
        self, levels: list[Model], trials: int, report: Callable[[float], None]
    ) -> list[Model]:
        """Try `trials` changes, keep each that lowers the objective, and return the levels."""
        value = self.value(levels)
        for k in range(trials):
            if self.rng.random() < _SWAPS:
                trial = self.swapped(levels)
            else:
                trial = self.widened(levels, 1 + k % _MOST_WIDER)
            trial = self.narrowed(trial, _ROUNDS_OF_A_TRIAL)
            lower = self.value(trial)
            if lower < value:
                levels, value = trial, lower
            report((k + 1) / trials)
        return levels

    def widened(self, levels: list[Model], more: int) -> list[Model]:
        """Copies with `influences` + `more` influences per vertex, at most one per bone."""
        return [x.with_influences(min(self.influences + more, x.n_bones)) for x in levels]

    def swapped(self, levels: list[Model]) -> list[Model]:
        """Copies in which two bones change places.

        One is a bone of a random level whose removal costs little; the other is a bone that only
        finer levels have.
        """
        k = int(self.rng.integers(1, len(levels)))
        least = levels[k + 1].n_bones if k + 1 < len(levels) else 0
        cost = bone_costs(self.data, levels[k].with_restarted_support())[least:]
        cheap = np.argsort(cost, kind="stable")[:_CHEAPEST]
        order = np.arange(levels[0].n_bones)
        a = least + int(self.rng.choice(cheap))
        b = int(self.rng.integers(levels[k].n_bones, levels[k - 1].n_bones))
        order[[a, b]] = order[[b, a]]
        return self.reordered(levels, order)

    def reordered(self, levels: Sequence[Model], order: NDArray[np.intp]) -> list[Model]:
        """Copies whose bone j is the present bone ``order[j]``.

        A level with vertices that lose a bone is solved again.
        """
        transforms, place = levels[0].transforms[:, order], np.argsort(order)
        out = []
        for level in levels:
            changed = _with_transforms(level.copy(), transforms[:, : level.n_bones])
            there = place[level.indices]
            lost = ((there >= level.n_bones) & (level.weights > 0)).any()
            changed.indices[:] = np.where((level.weights > 0) & (there < level.n_bones), there, 0)
            changed.restart_support()
            if lost:
                vertex_step(self.data, changed)
            out.append(changed)
        return out


def nested_models(
    data: Trajectories,
    finest: Model,
    counts: Sequence[int],
    targets: Array,
    *,
    influences: int,
    trials: int,
    rng: np.random.Generator,
    report: Callable[[float], None],
) -> list[Model]:
    """Models with `counts` bones, each with the first bones of the previous, finer one.

    Parameters
    ----------
    data : Trajectories
    finest : Model
        A model of ``counts[0]`` bones.
    counts : sequence of int
        Bone counts, descending.
    targets : (L,) array
        Squared errors of independent models with `counts` bones.
    influences : int
    trials : int
        Number of changes that are tried; each is kept if it lowers the objective.
    rng : numpy.random.Generator
    report : callable
        Called with the fraction of the work that is done.
    """
    n = data.n_vertices
    size = min(n, sample_size(n, counts[0]))
    chosen = motion_sample(data, size)
    # a sample spread evenly over the motion has about its share of the error
    few = Nested(data.select_vertices(chosen), targets * (size / n), influences, rng)
    levels = _removed(few, finest.select_vertices(chosen), counts)
    levels = few.narrowed(few.widened(levels, _WIDER), _ROUNDS)
    levels = few.search(levels, 2 * trials // 3, lambda done: report((1 + done) / 4))
    full = Nested(data, targets, influences, rng)
    levels = full.polish([_solved_for_all(data, x, finest.rest, chosen) for x in levels], _ROUNDS)
    return full.search(levels, trials - 2 * trials // 3, lambda done: report((2 + 2 * done) / 4))


def _removed(search: Nested, finest: Model, counts: Sequence[int]) -> list[Model]:
    """Make levels by removing bones one by one, always the bone that raises the error least."""
    data, model = search.data, finest.with_restarted_support()
    optimise_vertices(data, model)
    left, gone, kept = list(range(counts[0])), [], {counts[0]: model}
    while model.n_bones > counts[-1]:
        cheapest = int(bone_costs(data, model.with_restarted_support()).argmin())
        gone.append(left.pop(cheapest))
        model = model.without(np.array([cheapest]))
        vertex_step(data, model)
        optimise_vertices(data, model)
        if model.n_bones in counts:
            kept[model.n_bones] = model
    order = np.array(left + gone[::-1])
    place, levels = np.argsort(order), []
    for count in counts:
        level = _with_transforms(kept[count].copy(), finest.transforms[:, order[:count]])
        level.indices[:] = place[np.sort(order[:count])][level.indices]
        level.restart_support()
        levels.append(level)
    return levels


def _solved_for_all(data: Trajectories, few: Model, rest: Array, chosen: NDArray[np.intp]) -> Model:
    """Model of all vertices, solved from `few`, a model of the vertices `chosen`."""
    model = model_of_all(few, rest, chosen)
    vertex_step(data, model)
    for _ in range(2):
        optimise_vertices(data, model, rounds=4)
    return model


def _with_transforms(model: Model, transforms: Array) -> Model:
    return dataclasses.replace(model, transforms=np.ascontiguousarray(transforms))
