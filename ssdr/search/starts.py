"""Steps of a descent that make a model: from motion, from given parts, from a complete model."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from ..model.transforms import rest_diagonal
from ..solver.alternation import bone_step, repeat_alternation, vertex_step
from ..solver.gauss_newton import fit_motion
from ..solver.initialization import fit_patches, nearest_bones, start_model, with_rest_normals
from ..solver.model import Model, Skin
from ..solver.objective import mean_normal_error
from ..solver.trajectories import Array
from .descent import Descent, step
from .moves import polish_steps
from .problem import Effort
from .steps import alternate, compress, merge, polish

# A quick start uses 64 frames if there are at least twice as many, and alternates 16 times on them:
# that is enough to find the bones and to place them.
_FEW_FRAMES, _FEW_ALTERNATIONS = 64, 16
# Gauss–Seidel sweeps, and leaps of all bones together, for bones that start with the transforms of
# another frame.  Without leaps, it would take many sweeps to move a bone far.
_FIRST_SWEEPS, _FIRST_LEAPS = 6, 2
_WHOLE_ROUNDS, _WHOLE_POLISH = 16, 8  # to assign parts as a whole, and polish steps after them
_WITHOUT_NORMALS = 12  # alternations of a start with normals before these are solved
# RMSE, relative to the diagonal, that nobody sees, and mean squared error of normals that all see.
_NOT_SEEN, _SEEN = 1e-4, math.radians(10.0) ** 2


@step("start", cost=8)
def start(d: Descent, *, factor: float = 1.0, influences: int | None = None) -> Iterator[None]:
    """Make bones from motion, or take those that the caller gave, and solve their first weights.

    There are `factor` · `d.bones` bones; a later merge removes the excess.  Given bones are used
    only if the factor is 1.
    """
    d.model = _first_model(d, factor, influences)
    vertex_step(d.data, d.model, constraints=d.constraints)
    yield


@step("quick", cost=8)
def quick_start(d: Descent, *, influences: int | None = None) -> Iterator[None]:
    """Make a first model.

    If there are 128 frames or more, not compressed, and the caller gave no bones, the model is made
    from 64 frames and then fitted to all.
    """
    data, initial = d.data, d.initial.beside_model()
    few = data.n_frames < 2 * _FEW_FRAMES
    if few or data.q is not None or initial.transforms is not None:
        d.model = _first_model(d, 1.0, influences, quick=True)
        vertex_step(data, d.model, constraints=d.constraints)
        yield
        return
    chosen = np.linspace(0, data.n_frames - 1, _FEW_FRAMES).round().astype(np.intp)
    sample, rest = data.select_frames(chosen), initial.first_pose(data)
    k, kind = influences or d.influences, d.constraints.bone_model
    model = start_model(sample, rest, d.bones, k, d.rng, kind, quick=True)
    vertex_step(sample, model, constraints=d.constraints)
    repeat_alternation(sample, model, _FEW_ALTERNATIONS, d.constraints)
    between = 0.5 * (chosen[1:] + chosen[:-1])
    nearest = np.searchsorted(between, np.arange(data.n_frames))
    model.transforms = np.ascontiguousarray(model.transforms[nearest])
    bone_step(data, model, sweeps=_FIRST_SWEEPS, constraints=d.constraints)
    vertex_step(data, model, constraints=d.constraints)
    d.model = model
    yield


def _first_model(
    d: Descent, factor: float, influences: int | None, *, quick: bool = False
) -> Model:
    data, initial, k = d.data, d.initial.beside_model(), influences or d.influences
    rest = initial.first_pose(data)
    if initial.skin is not None:
        if initial.transforms is None or factor > 1:  # they have served as a start already
            bones = _patches_of_weights(d, rest, initial.skin)
        else:
            bones = initial.transforms.copy()
        return Model.with_weights(bones, rest, *initial.skin, k)
    count = min(data.n_vertices, max(d.bones, round(d.bones * factor)))
    return start_model(data, rest, count, k, d.rng, d.constraints.bone_model, quick=quick)


def normals_need_a_start(d: Descent) -> bool:
    """Whether to start anew with normals: if `normals` is a length, or if only normals are poor.

    If it is not, the RMSE must not be seen, while normals are more than 10° off: the waves of a
    thin, smooth sheet can be sums of few translations, and bones that translate then fit positions
    but not light.
    """
    if d.planning or d.data.slack or d.data.normals is None:
        wanted = bool(d.normals) and d.constraints.bone_model == "rigid"
        return wanted and len(d.data.faces) > 0
    model = d.best.model
    unseen = model.weighted_error(d.data) <= _not_seen(d)
    return unseen and mean_normal_error(d.data, model) >= _SEEN


def _not_seen(d: Descent) -> float:
    """Squared error of an RMSE that nobody sees."""
    count = d.data.n_frames * d.data.n_vertices
    return count * (_NOT_SEEN * rest_diagonal(d.best.model.rest)) ** 2


@step("start", cost=8)
def start_with_normals(d: Descent) -> Iterator[None]:
    """Make bones from motion and alternate a little; solve normals from now on.

    Without such a length from the caller, an RMSE below 0.01 % of the diagonal counts for nothing
    from now on.  More alternations would lead to bones that translate, and alternations with
    normals to ones that only turn.
    """
    if not d.data.slack:
        d.data = dataclasses.replace(d.data, slack=_not_seen(d))
        d.set_best(d.best.model)
    data = d.data
    d.data = dataclasses.replace(data, normals=None, n2=None)
    model = _first_model(d, 1.0, None, quick=True)
    vertex_step(d.data, model, constraints=d.constraints)
    repeat_alternation(d.data, model, _WITHOUT_NORMALS, d.constraints)
    d.data, d.model = data, with_rest_normals(data, model)
    yield


@step("start", cost=8)
def start_from_model(d: Descent) -> Iterator[None]:
    """Start from a complete model that the caller gave.

    If its error is lower when each bone is fitted to the vertices that it moves most, its
    transforms are taken to belong to other frames.  They are then fitted anew, with weights and
    rest pose held, and a later step attaches the bones to their joints again.
    """
    data, initial = d.data, d.initial
    own = _initial_model(d, None)
    model = own if initial.transforms is None else _initial_model(d, initial.transforms.copy())
    tree = initial.tree if d.rigid_joints else None
    if own is model or own.weighted_error(data) < model.weighted_error(data):
        model = own
        fit_motion(data, model, constraints=d.constraints, sweeps=_FIRST_SWEEPS, leaps=_FIRST_LEAPS)
        _measure_error(d, model)
        tree = None if tree is None else dataclasses.replace(tree, rigid=False)
        d.initial = dataclasses.replace(initial, transforms=None)
    if data.normals is not None:
        model = with_rest_normals(data, model)
    model.tree = tree
    d.model = model
    yield


def _initial_model(d: Descent, bones: Array | None) -> Model:
    initial = d.initial
    assert initial.rest is not None
    assert initial.skin is not None
    if bones is None:
        bones = _patches_of_weights(d, initial.rest, initial.skin)
    model = Model.with_weights(bones, initial.rest, *initial.skin, d.influences)
    _measure_error(d, model)
    return model


def _patches_of_weights(d: Descent, rest: Array, skin: Skin) -> Array:
    """Transforms (F, B, 3, 4) of bones, each fitted to the vertices where its weight is largest."""
    label, kind = skin.indices[:, 0].astype(np.intp), d.constraints.bone_model
    return fit_patches(d.data, rest, label, d.bones, kind)


def _measure_error(d: Descent, model: Model) -> None:
    """Recompute the error of every vertex (in place); the rest of the model does not change."""
    every = np.ones(d.data.n_vertices, dtype=bool)
    held = dataclasses.replace(d.constraints, lock_rest=True, weights=every)
    vertex_step(d.data, model, constraints=held)


def first_model(d: Descent, *, influences: int | None = None) -> None:
    """Make a usable first model, without excess bones, and then compress the frames."""
    quick_start(d, influences=influences)
    alternate(d, steps=20, gain=0.01)
    compress(d)


def merged_start(
    d: Descent,
    before: int = 12,
    after: int = 6,
    *,
    factor: float = 1.6,
    influences: int | None = None,
) -> None:
    """Start with `factor` · `d.bones` bones and merge them down to `d.bones`.

    At most `before` alternations precede the merge, and at most `after` follow it.
    """
    start(d, factor=factor, influences=influences)
    alternate(d, steps=before)
    merge(d)
    alternate(d, steps=after)


def polish_model(d: Descent, effort: Effort) -> None:
    """Start from the given model and polish it."""
    start_from_model(d)
    compress(d)
    polish(d, steps=6 if effort == "fast" else 20, gain=0.01)


@step("whole parts", cost=3)
def whole_parts(d: Descent, *, steps: int = _WHOLE_ROUNDS) -> Iterator[None]:
    """Assign each rigid part of the mesh to one bone, for vertices with one influence.

    A part that two bones move would come apart, so that the result becomes the best model even if
    its error is higher.  With several influences, weights hold such a part together.
    """
    data, parts = d.data, d.data.parts
    if parts is None or d.influences > 1:
        return
    model, rigid = d.best.model.with_restarted_support(), parts >= 0
    owner = np.unique(np.stack([parts, model.indices[:, 0]])[:, rigid], axis=1)
    if (np.diff(owner[0]) > 0).all():
        return
    constraints = dataclasses.replace(d.constraints, weights=rigid)
    for _ in range(steps):
        model.indices[rigid, 0] = nearest_bones(data, model.rest, model.transforms)[rigid]
        error = np.where(rigid, model.error * data.importance, 0.0)
        for idle in np.setdiff1d(np.arange(d.bones), model.indices):  # takes the worst part
            k = np.bincount(parts[rigid], weights=error[rigid]).argmax()
            label = np.where(parts == k, 0, -1)
            model.transforms[:, idle] = fit_patches(data, model.rest, label, 1)[:, 0]
            model.indices[label == 0], error[label == 0] = idle, 0.0
        model.restart_support()
        repeat_alternation(data, model, 2, constraints)
        yield
    polish_steps(data, model, _WHOLE_POLISH, constraints)
    d.model = model
    d.set_best(model)
    yield
