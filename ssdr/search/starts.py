"""Stages that make a first model: from motion, from parts of a model, or from a whole model."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..solver.alternation import alternate, bone_step, vertex_step
from ..solver.gauss_newton import fit_motion
from ..solver.initialization import fit_patches, single_bone_errors, start_model
from ..solver.model import Model
from ..solver.rest_normals import with_rest_normals
from ..solver.trajectories import Array
from .run import Run, Stage

__all__ = ["QuickStart", "Spread", "StartFromModel", "StartFromMotion"]

# Number of frames that a quick start uses if there are at least twice as many, and of alternations
# on them: 64 frames tell which bones there are, and 16 alternations place them.
_FEW_FRAMES, _FEW_ALTERNATIONS = 64, 16
# Gauss–Seidel sweeps, and leaps of all bones together, for bones that start with the transforms of
# another frame.  Without leaps, it would take many sweeps to move a bone far.
_FIRST_SWEEPS, _FIRST_LEAPS = 6, 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class StartFromMotion(Stage):
    """Make bones from motion, or take those that the caller gave, and solve their first weights.

    Attributes
    ----------
    factor : float
        Number of bones to start with, relative to the number asked for; a merge removes the excess.
        If it is above 1, all bones are made from motion, unless the caller locked some.
    influences : int or None
        Influences per vertex at the start; None for as many as asked for.
    """

    phase: ClassVar[str] = "start"
    cost: float = 8
    factor: float = 1.0
    influences: int | None = None

    def apply(self, run: Run) -> Iterator[None]:
        run.model = self._model(run)
        vertex_step(run.data, run.model, locked=run.locked)
        yield

    def _model(self, run: Run, *, quick: bool = False) -> Model:
        data, given = run.data, run.present_parts
        influences = self.influences or run.influences
        rest, bones = given.first_pose(data), given.transforms
        if self.factor > 1 and run.locked.bones is None:
            bones = None  # given bones that are not locked have served as a start already
        if given.indices is not None and given.weights is not None:
            if bones is None:
                bones = _patches_of_weights(run, rest, given.indices)
            return Model.with_weights(bones.copy(), rest, given.indices, given.weights, influences)
        if bones is not None and bones.shape[1] == run.bones:
            every = np.arange(data.n_vertices)
            cost, positions = single_bone_errors(data, given.rest, bones, every)
            label = cost.argmin(axis=1)
            if positions is not None:
                rest = np.ascontiguousarray(positions[every, :, label])
            return Model.start(bones.copy(), rest, label, influences)
        count = min(data.n_vertices, max(run.bones, round(run.bones * self.factor)))
        kind = run.locked.bone_model
        return start_model(data, rest, count, influences, run.rng, bones, kind, quick=quick)


@dataclasses.dataclass(frozen=True, kw_only=True)
class QuickStart(StartFromMotion):
    """Make a first model quickly: on 64 frames if there are many more, then fitted to all."""

    phase: ClassVar[str] = "quick"

    def apply(self, run: Run) -> Iterator[None]:
        data, given = run.data, run.present_parts
        if data.n_frames < 2 * _FEW_FRAMES or given.transforms is not None:
            run.model = self._model(run, quick=True)
            vertex_step(data, run.model, locked=run.locked)
            yield
            return
        chosen = np.linspace(0, data.n_frames - 1, _FEW_FRAMES).round().astype(np.intp)
        few = data.select_frames(chosen)
        rest = given.first_pose(data)
        influences, kind = self.influences or run.influences, run.locked.bone_model
        model = start_model(few, rest, run.bones, influences, run.rng, None, kind, quick=True)
        vertex_step(few, model, locked=run.locked)
        alternate(few, model, _FEW_ALTERNATIONS, run.locked)
        between = 0.5 * (chosen[1:] + chosen[:-1])
        nearest = np.searchsorted(between, np.arange(data.n_frames))
        model.transforms = np.ascontiguousarray(model.transforms[nearest])
        bone_step(data, model, sweeps=_FIRST_SWEEPS, locked=run.locked)
        vertex_step(data, model, locked=run.locked)
        run.model = model
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class StartFromModel(Stage):
    """Start from a whole model that the caller gave.

    Its transforms are taken to be of other frames if the bones have less error when each is fitted
    to the vertices that it moves most.  In that case the bones are fitted anew to the weights, and
    a later stage attaches them to their joints again.
    """

    phase: ClassVar[str] = "start"
    cost: float = 8

    def apply(self, run: Run) -> Iterator[None]:
        data, given = run.data, run.given
        own = self._model(run, None)
        model = own if given.transforms is None else self._model(run, given.transforms.copy())
        tree = given.tree if run.rigid_joints else None
        if own is model or own.weighted_error(data) < model.weighted_error(data):
            model = own
            fit_motion(data, model, locked=run.locked, sweeps=_FIRST_SWEEPS, leaps=_FIRST_LEAPS)
            _measure_error(run, model)
            tree = None if tree is None else dataclasses.replace(tree, rigid=False)
            run.given = dataclasses.replace(given, transforms=None)
        if data.normals is not None:
            model = with_rest_normals(data, model)
        model.tree = tree
        run.model = model
        yield

    def _model(self, run: Run, bones: Array | None) -> Model:
        given = run.given
        assert given.rest is not None
        assert given.indices is not None
        assert given.weights is not None
        if bones is None:
            bones = _patches_of_weights(run, given.rest, given.indices)
        parts = (given.rest, given.indices, given.weights)
        model = Model.with_weights(bones, *parts, run.influences)
        _measure_error(run, model)
        return model


@dataclasses.dataclass(frozen=True, kw_only=True)
class Spread(Stage):
    """Fit bones whose transforms were copied from other frames, and measure the error."""

    phase: ClassVar[str] = "spread"
    cost: float = 12

    def apply(self, run: Run) -> Iterator[None]:
        model = run.present
        fit_motion(run.data, model, locked=run.locked, sweeps=_FIRST_SWEEPS, leaps=_FIRST_LEAPS)
        _measure_error(run, model)
        yield


def _patches_of_weights(run: Run, rest: Array, indices: NDArray[np.int32]) -> Array:
    """Transforms (F, B, 3, 4) of bones that are each fitted to the vertices that they move most."""
    label, kind = indices[:, 0].astype(np.intp), run.locked.bone_model
    return fit_patches(run.data, rest, label, run.bones, kind)


def _measure_error(run: Run, model: Model) -> None:
    """Compute the error of every vertex (in place), without moving anything."""
    every = np.ones(run.data.n_vertices, dtype=bool)
    vertex_step(run.data, model, locked=dataclasses.replace(run.locked, rest=True, weights=every))
