"""Ways out of a poor minimum: merge, re-seed, regrow, relax, and the changes of a search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..parallel import chunk_bounds, run_chunks, serial_blas
from ..solver.alternation import alternate, bone_costs, bone_step, vertex_step
from ..solver.gauge import normalise_gauge
from ..solver.gauss_newton import GaussNewton
from ..solver.initialization import fit_patches
from ..solver.model import CHUNK, Fixed, Model
from ..solver.moments import transform_sums
from ..solver.trajectories import Array, Trajectories
from ..solver.vertex_newton import newton_rows

__all__ = [
    "drop_influence",
    "entering_at",
    "grow_and_shed",
    "grow_bone",
    "kick",
    "loosen",
    "merge_step",
    "polish_steps",
    "regrow_step",
    "relax",
    "reseed_step",
    "shed_influence",
    "thin",
    "worst_patch",
]

# Vertices, drawn by their error, around which a new bone may come: comparing their neighbourhoods
# by error alone costs next to nothing beside one alternation.
_CANDIDATES = 32
# Bones, cheapest first, of which one is drawn to be moved: always the cheapest would try the same
# move again after each failure.
_CHEAPEST = 3
# Alternations of a kick, bones more of a growth, influences more of a loosening: drawn from 1 to
# these.  More of each leads further away than the steps that judge a try come back from.
_MOST_KICKS, _MOST_GROWN, _MOST_LOOSENED = 5, 2, 2
_REGROWN = (2, 6)  # bones more at once, a quarter of the model's at most
# Polish steps at each number of influences, drawn from this to twice as many: a step that lets
# bones enter, and two that settle them.
_FEWEST_STEPS = 3
# Of the vertices that a bone has on average: where a re-seeded bone begins, and, drawn, a bone that
# grows, for motions have parts of all sizes.
_PATCH_SIZE, _PATCH_SIZES = 0.5, (0.25, 0.5, 1.0)
_FEWEST_VERTICES = 4  # of a patch: a rotation needs three that are not on a line
# Of Gauss–Newton on a vertex that tries to do without a bone: nine of ten vertices end within
# 0.1 % of their least error (as the tests of this file hold it to).
_ROUNDS = 2
# Every third polish step tries bones that could enter: every step costs more than it brings.
_ENTERING_EVERY, _ENTERING_BONES = 3, 3


def merge_step(
    data: Trajectories, model: Model, bones: int, alternations: int, fixed: Fixed
) -> Model:
    """Give up the cheapest third of the bones beyond `bones`, then alternate."""
    excess = model.n_bones - bones
    cost = _costs(data, model, fixed)
    drop = np.argsort(cost, kind="stable")[: max(1, -(-excess // 3))]
    smaller = model.without(drop)
    vertex_step(data, smaller, fixed=fixed)
    alternate(data, smaller, alternations, fixed)
    return smaller


def reseed_step(
    data: Trajectories,
    model: Model,
    rng: np.random.Generator,
    alternations: int,
    fixed: Fixed,
) -> Model | None:
    """Move one of the cheapest bones to where the error is; None if nothing could move.

    The new bone is the Kabsch fit of the neighbourhood, of V/2B vertices, that
    holds the most error.  The caller keeps the outcome only if it is better.
    """
    if not float(data.importance @ model.error) > 0:
        return None
    cost = _costs(data, model, fixed)
    order = np.argsort(cost, kind="stable")
    free = order[np.isfinite(cost[order])]
    if len(free) == 0:
        return None
    drop = free[int(rng.integers(min(_CHEAPEST, len(free))))]
    members = worst_patch(data, model, rng, _PATCH_SIZE)
    smaller = model.without(np.array([drop]))
    grown = _with_patch(data, smaller, members, fixed)
    vertex_step(data, grown, fixed=fixed)
    alternate(data, grown, alternations, fixed)
    return grown


def regrow_step(
    data: Trajectories, model: Model, rng: np.random.Generator, alternations: int, fixed: Fixed
) -> Model:
    """A copy that got two to six bones more where the error is and was merged down again.

    Alternations alone, `alternations` after each change: a tenth of the time of a change
    that polishes.  Several bones at once find new places that none would keep by itself.
    """
    least, most = _REGROWN
    most = max(least + 1, min(most, model.n_bones // 4))
    count = int(rng.integers(least, most + 1))
    regrown = _with_bones(data, model.with_restarted_support(), count, rng, fixed)
    alternate(data, regrown, alternations, fixed)
    while regrown.n_bones > model.n_bones:
        regrown = merge_step(data, regrown, model.n_bones, alternations, fixed)
    return regrown


def kick(data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed) -> Model:
    """A copy after a few alternations, which keep the largest weights whether that pays or not."""
    moved = model.with_restarted_support()
    for _ in range(int(rng.integers(1, _MOST_KICKS + 1))):
        bone_step(data, moved, fixed=fixed)
        vertex_step(data, moved, fixed=fixed)
        normalise_gauge(moved, data.importance, fixed)
    return moved


def grow_and_shed(
    data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed
) -> Model:
    """A copy that got one or two bones more, settled, and gave up as many again.

    Bones change places so that a single exchange would not find: the new ones
    have taken over what they can before it is asked which can go.  With an influence
    more all the while, vertices are not torn between the old bones and the new.
    """
    k, _, steps = _loosening(model, rng)
    count = int(rng.integers(1, _MOST_GROWN + 1))
    wide = model.with_influences(min(k + 1, model.n_bones))
    grown = _with_bones(data, wide, count, rng, fixed)
    polish_steps(data, grown, steps, fixed)
    for _ in range(count):
        grown.restart_support()
        cost = _costs(data, grown, fixed)
        grown = grown.without(np.argsort(cost, kind="stable")[:1])
        polish_steps(data, grown, _FEWEST_STEPS, fixed)
    return _thinned(data, grown, fixed, influences=k, steps=steps)


def relax(data: Trajectories, model: Model, fixed: Fixed, *, extra: int, steps: int) -> Model:
    """A copy that got `extra` influences more, settled, and gave them up one by one.

    Which bones move a vertex matters more than how, and with few influences each choice
    bars the others: the objective has many poor minima.  It has fewer with more
    influences, and the bones that serve those are most of the way to good ones.
    `steps` of the polish are taken at each number of influences above the model's.
    """
    most = min(model.n_influences + extra, model.n_bones)
    relaxed = model.with_influences(most)
    for _ in range(most - model.n_influences):
        relaxed = shed_influence(data, relaxed, fixed, steps=steps)
    return relaxed


def shed_influence(data: Trajectories, model: Model, fixed: Fixed, *, steps: int) -> Model:
    """`steps` of the polish (in place), then a copy with one influence a vertex less."""
    polish_steps(data, model, steps, fixed)
    smaller = model.with_influences(model.n_influences - 1)
    # solved on all bones, of which the largest weights stay
    vertex_step(data, smaller, fixed=fixed)
    return smaller


def drop_influence(data: Trajectories, model: Model, fixed: Fixed) -> None:
    """Take from every vertex that has all its influences the one it misses least (in place).

    Each is tried, with the other weights and the rest position solved anew: the smallest
    weight is often not the one without which the error rises least.
    """
    k, keep = model.n_influences, fixed.keep_weights(data.n_vertices)
    full = (model.weights > 0).all(axis=1) & ~keep
    if k < 2 or not full.any():
        return
    rows = np.flatnonzero(full)
    with serial_blas():
        _, gram, gram4, reduced = transform_sums(data, model.transforms)

        def work(_: int, i: int, j: int) -> None:
            some = rows[i:j]
            y, x2 = data.z[some] @ reduced, data.x2[some]
            least = np.full(len(some), np.inf)
            indices, weights, rest = model.indices[some], model.weights[some], model.rest[some]
            for q in range(k):
                t_joints, t_weights, t_rest = indices.copy(), weights.copy(), rest.copy()
                t_weights[:, q] = 0.0
                t_weights /= t_weights.sum(axis=1, keepdims=True)
                error = np.empty(len(some))
                newton_rows(
                    y,
                    x2,
                    (gram, gram4),
                    (t_rest, t_joints, t_weights, error),
                    keep[some],
                    move_rest=not fixed.rest,
                    entering=0,
                    rounds=_ROUNDS,
                )
                better = error < least
                least[better], at = error[better], some[better]
                model.indices[at], model.weights[at] = t_joints[better], t_weights[better]
                model.rest[at] = t_rest[better]
            model.error[some] = np.maximum(least, 0.0)

        run_chunks(work, chunk_bounds(len(rows), CHUNK))


def loosen(data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed) -> Model:
    """A copy that had one or two influences more for a while."""
    _, extra, steps = _loosening(model, rng)
    return relax(data, model, fixed, extra=extra, steps=steps)


def thin(data: Trajectories, model: Model, rng: np.random.Generator, fixed: Fixed) -> Model:
    """As :func:`loosen`, but each vertex gives up the influence that it misses least.

    It stays close to where it came from and is rarely in vain there; where much is
    still wrong, choosing anew from all bones goes further.
    """
    k, extra, steps = _loosening(model, rng)
    return _thinned(data, model.with_influences(k + extra), fixed, influences=k, steps=steps)


def _loosening(model: Model, rng: np.random.Generator) -> tuple[int, int, int]:
    """Influences of a model, how many more for a while, and polish steps at each number."""
    k, n_bones = model.n_influences, model.n_bones
    extra = min(int(rng.integers(1, _MOST_LOOSENED + 1)), max(0, n_bones - k))
    return k, extra, int(rng.integers(_FEWEST_STEPS, 2 * _FEWEST_STEPS + 1))


def _thinned(
    data: Trajectories, model: Model, fixed: Fixed, *, influences: int, steps: int
) -> Model:
    while model.n_influences > influences:
        polish_steps(data, model, steps, fixed)
        drop_influence(data, model, fixed)
        model = model.with_influences(model.n_influences - 1)
    return model


def entering_at(step: int) -> int:
    """Bones that may enter a vertex's support in this step of a polish, counted from 0."""
    return _ENTERING_BONES if step % _ENTERING_EVERY == 0 else 0


def polish_steps(data: Trajectories, model: Model, count: int, fixed: Fixed) -> None:
    """`count` steps of the polish (in place), every third of which lets bones enter."""
    polish = GaussNewton(data, model, fixed=fixed)
    for k in range(count):
        polish.step(entering=entering_at(k))
    normalise_gauge(model, data.importance, fixed)


def _with_bones(
    data: Trajectories, model: Model, count: int, rng: np.random.Generator, fixed: Fixed
) -> Model:
    """A copy with so many bones more, one after the other where the error is."""
    for _ in range(count):
        members = worst_patch(data, model, rng, float(rng.choice(_PATCH_SIZES)))
        model = _with_patch(data, model, members, fixed)
        vertex_step(data, model, fixed=fixed)
    return model


def worst_patch(
    data: Trajectories,
    model: Model,
    rng: np.random.Generator,
    fraction: float,
    *,
    among: NDArray[np.bool_] | None = None,
) -> NDArray[np.intp]:
    """Of some neighbourhoods of `fraction`·V/B vertices, drawn by error, the one with most.

    `among`: vertices of which it is, where there are any.
    """
    n = data.n_vertices
    # drawn by their place in the order of motion, so that numbering plays no part
    order = np.argsort(data.x2, kind="stable")
    error = model.error * data.importance
    there = np.arange(n)
    if among is not None and among.any():
        there, order = np.flatnonzero(among), order[among[order]]
    total = float(error[there].sum())
    chance = None if not total > 0 else error[order] / total
    seeds = order[rng.choice(len(order), size=min(_CANDIDATES, len(order)), p=chance)]
    size = int(fraction * n / model.n_bones)
    return there[_heaviest(model.rest[there], error[there], np.searchsorted(there, seeds), size)]


def _heaviest(rest: Array, error: Array, seeds: NDArray[np.intp], size: int) -> NDArray[np.intp]:
    """Of the neighbourhoods of `size` vertices around the seeds the one that holds the most error.

    Four vertices at least, where there are as many.
    """
    size = min(len(error), max(_FEWEST_VERTICES, size))
    _, near = cKDTree(rest).query(rest[seeds], k=size)
    near = np.asarray(near).reshape(len(seeds), size)
    return np.asarray(near[error[near].sum(axis=1).argmax()])


def _with_patch(data: Trajectories, model: Model, members: NDArray[np.intp], fixed: Fixed) -> Model:
    """A copy with one bone more, that moves `members` as they move themselves."""
    label = np.full(data.n_vertices, -1, dtype=np.intp)
    label[members] = 0
    grown = model.with_bone(fit_patches(data, model.rest, label, 1, fixed.bone_model)[:, 0])
    members = members[~fixed.keep_weights(data.n_vertices)[members]]
    grown.support[members] = 0
    grown.support_weights[members] = 0.0
    grown.support[members, 0] = grown.n_bones - 1
    grown.support_weights[members, 0] = 1.0
    grown.count[members] = 1
    return grown


def grow_bone(data: Trajectories, model: Model, *, alternations: int, fixed: Fixed) -> Model:
    """A copy with one bone more that never fits worse.

    The bone comes where a neighbourhood has the most error; where that does not
    pay, it is a bone that nothing uses.
    """
    before = model.weighted_error(data)
    error = np.maximum(model.error, 0.0) * data.importance
    seeds = np.argsort(-error, kind="stable")[:_CANDIDATES]
    members = _heaviest(model.rest, error, seeds, data.n_vertices // (2 * model.n_bones))
    grown = _with_patch(data, model.with_restarted_support(), members, fixed)
    vertex_step(data, grown, fixed=fixed)
    alternate(data, grown, alternations, fixed)
    if grown.weighted_error(data) <= before:
        return grown
    return model.with_bone(model.transforms[:, -1])


def _costs(data: Trajectories, model: Model, fixed: Fixed) -> Array:
    cost = bone_costs(data, model)
    if fixed.bones is not None:
        # all bones that the caller gave: locked ones are known by their place among them
        cost[: len(fixed.bones)] = np.inf
    keep = fixed.keep_weights(data.n_vertices)
    cost[model.indices[keep][model.weights[keep] > 0]] = np.inf
    return cost
