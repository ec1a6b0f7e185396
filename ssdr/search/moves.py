"""Changes of a model that lead out of a poor minimum: bones and influences added, moved, removed.

A change returns a changed copy of the model; the caller keeps it if its objective is lower.  The
cheapest bones are those whose removal raises the squared error least.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..kernels.influence_choice import choose_influences
from ..kernels.vertex_polish import polish_vertices
from ..solver.alternation import bone_costs, free_gauge, repeat_alternation, vertex_step
from ..solver.gauss_newton import GaussNewton
from ..solver.initialization import by_motion, fit_patches
from ..solver.model import CHUNK, SOLVED, Constraints, Model
from ..solver.moments import transform_sums
from ..solver.objective import normal_length, rest_pulls
from ..solver.trajectories import Array, Trajectories

# Alternations after a bone is moved, and after bones are added and at each merge of these.
AFTER_A_MOVE, AFTER_AN_ADDITION = 4, 3
# Number of vertices, drawn by their error, around which a new bone may be placed: to compare the
# error of so many neighbourhoods costs next to nothing beside one alternation.
_CANDIDATES = 32
# Number of cheapest bones among which the one to move is drawn: if it were always the cheapest,
# a failed change would be repeated.
_CHEAPEST = 3
# Upper bounds of the numbers that a search draws: alternations, bones to exchange, and influences
# to exchange.  With larger bounds, too few polish steps would follow to make up for the change
# before the trial is judged.
_MOST_ALTERNATIONS, _MOST_EXCHANGED, _MOST_WIDER = 5, 2, 2
# Least and most bones added at once; more than three only up to a quarter of the model's bones.
_ADDED = (2, 6)
# Polish steps at each number of influences: drawn between this and twice as many.  Three are one
# step that lets bones enter supports and two that settle them.
_FEWEST_STEPS = 3
# Vertex count of a new bone's patch, relative to V/B: for a moved bone, and the values among which
# that of an added bone is drawn, because motions have parts of all sizes.
_PATCH_SIZE, _PATCH_SIZES = 0.5, (0.25, 0.5, 1.0)
_FEWEST_VERTICES = 4  # in a patch: a rotation needs three that are not on a line
# Gauss–Newton rounds on a vertex from which a bone is removed on trial: after these, nine of ten
# vertices are within 0.1 % of their least error (a test checks this).
_ROUNDS = 2


# --- bones -------------------------------------------------------------------------------------


def merge_bones(
    data: Trajectories, model: Model, bones: int, alternations: int, constraints: Constraints
) -> Model:
    """Remove the cheapest third of the bones in excess of `bones` from a copy, then alternate.

    The cheapest bones are those whose removal raises the squared error least.
    """
    excess = model.n_bones - bones
    cost = _removal_costs(data, model, constraints)
    drop = np.argsort(cost, kind="stable")[: max(1, -(-excess // 3))]
    smaller = model.without(drop)
    vertex_step(data, smaller, constraints=constraints)
    repeat_alternation(data, smaller, alternations, constraints)
    return smaller


def move_cheapest_bone(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model | None:
    """Move one of the cheapest bones to the patch with most error.

    The cheapest bones are those whose removal raises the squared error least.  The moved bone is
    fitted by Kabsch to a patch of V/(2B) vertices, for V vertices and B bones.  Returns None if no
    bone can move or no error is left.
    """
    if not float(data.importance @ model.error) > 0:
        return None
    cost = _removal_costs(data, model, constraints)
    order = np.argsort(cost, kind="stable")
    free = order[np.isfinite(cost[order])]
    if len(free) == 0:
        return None
    drop = free[int(rng.integers(min(_CHEAPEST, len(free))))]
    members = patch_of_most_error(data, model, rng, _PATCH_SIZE)
    moved = _with_patch(data, model.without(np.array([drop])), members, constraints)
    vertex_step(data, moved, constraints=constraints)
    repeat_alternation(data, moved, AFTER_A_MOVE, constraints)
    return moved


def add_and_merge_bones(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """Add two to six bones where the error is largest, then merge down to the previous number.

    A few alternations follow the addition and each merge: a tenth of the time of a change that
    polishes.  Several bones added at once find places that a single bone would not keep.
    """
    least, most = _ADDED
    most = max(least + 1, min(most, model.n_bones // 4))
    count = int(rng.integers(least, most + 1))
    changed = _with_more_bones(data, model.with_restarted_support(), count, rng, constraints)
    repeat_alternation(data, changed, AFTER_AN_ADDITION, constraints)
    while changed.n_bones > model.n_bones:
        changed = merge_bones(data, changed, model.n_bones, AFTER_AN_ADDITION, constraints)
    return changed


def exchange_bones(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """Add one or two bones, polish, then remove the same number of the cheapest bones.

    The cheapest bones, whose removal raises the squared error least, are chosen only after the
    polish, when the new bones have taken over vertices from the old ones.  Until then each vertex
    has one more influence, so that it can follow both an old and a new bone.
    """
    k, _, steps = _draw_influences(model, rng)
    count = int(rng.integers(1, _MOST_EXCHANGED + 1))
    wide = model.with_influences(min(k + 1, model.n_bones))
    grown = _with_more_bones(data, wide, count, rng, constraints)
    polish_steps(data, grown, steps, constraints)
    for _ in range(count):
        grown.restart_support()
        cost = _removal_costs(data, grown, constraints)
        grown = grown.without(np.argsort(cost, kind="stable")[:1])
        polish_steps(data, grown, _FEWEST_STEPS, constraints)
    return _with_fewer_influences(data, grown, constraints, influences=k, steps=steps)


# --- influences --------------------------------------------------------------------------------


def exchange_influences(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """Polish with one or two more influences per vertex, then drop the same number.

    Each vertex drops the influences whose removal raises its error least.  Since the model changes
    little, its objective is usually lower afterwards.
    """
    k, extra, steps = _draw_influences(model, rng)
    wide = model.with_influences(k + extra)
    return _with_fewer_influences(data, wide, constraints, influences=k, steps=steps)


def polish_then_drop_influence(
    data: Trajectories, model: Model, constraints: Constraints, *, steps: int
) -> Model:
    """Polish `steps` times (in place); return a copy with one influence fewer per vertex.

    With few influences the choice of bones for each vertex leads to many poor minima.  With more
    influences there are fewer poor minima, and the bones at these minima are close to those of a
    good model.
    """
    polish_steps(data, model, steps, constraints)
    smaller = model.with_influences(model.n_influences - 1)
    # the weights are solved on all bones, then the largest are kept
    vertex_step(data, smaller, constraints=constraints)
    return smaller


def drop_influence(data: Trajectories, model: Model, constraints: Constraints) -> None:
    """Remove from each vertex with K influences the one that it needs least (in place).

    Each removal is tried, with the other weights and the rest position solved again, and the one of
    least error is made.  Often this is not the removal of the smallest weight.
    """
    k, keep = model.n_influences, constraints.vertex_mask(data.n_vertices)
    length, hold = normal_length(data, model), rest_pulls(data, model, constraints)
    full = (model.weights > 0).all(axis=1) & ~keep
    if k < 2 or not full.any():
        return
    rows = np.flatnonzero(full)
    with serial_blas():
        _, gram, gram4, reduced = transform_sums(data, model.transforms)

        def work(_: int, i: int, j: int) -> None:
            some = rows[i:j]
            n = len(some)
            squares = data.squares(some, length)
            sums = data.products(some, reduced, length), squares
            given = {name: getattr(model, name)[some] for name in SOLVED}
            least = np.full(n, np.inf)
            flags = length, keep[some]
            size = k - 1 + 3 * squares.shape[1]
            unread = np.empty((n, size, size)), np.empty((n, size))
            for q in range(k):
                trial = {name: values.copy() for name, values in given.items()}
                weights = trial["weights"]
                weights[:, q] = 0.0
                weights /= weights.sum(axis=1, keepdims=True)
                rest, indices, _, _, normals, _ = trial.values()
                choose_influences(*sums, gram, rest, indices, weights, normals, *flags, 0)
                found = *trial.values(), hold[some], *flags, not constraints.lock_rest
                arrays: Any = *sums, gram4, *found, _ROUNDS, *unread
                polish_vertices(*arrays)
                off = hold[some, 0] * ((trial["rest"] - hold[some, 1:]) ** 2).sum(axis=1)
                error = trial["error"] + length**2 * trial["normal_error"] + off
                better = error < least
                least[better] = error[better]
                for name, values in trial.items():
                    getattr(model, name)[some[better]] = values[better]

        run_chunks(work, chunk_bounds(len(rows), CHUNK))


def _draw_influences(model: Model, rng: np.random.Generator) -> tuple[int, int, int]:
    """Influences per vertex, and random numbers of influences to add and of polish steps."""
    k, n_bones = model.n_influences, model.n_bones
    extra = min(int(rng.integers(1, _MOST_WIDER + 1)), max(0, n_bones - k))
    return k, extra, int(rng.integers(_FEWEST_STEPS, 2 * _FEWEST_STEPS + 1))


def _with_fewer_influences(
    data: Trajectories, model: Model, constraints: Constraints, *, influences: int, steps: int
) -> Model:
    """Polish (in place) and drop one influence per vertex, in turns, until `influences` are left.

    Returns the model with fewer influence slots.
    """
    while model.n_influences > influences:
        polish_steps(data, model, steps, constraints)
        drop_influence(data, model, constraints)
        model = model.with_influences(model.n_influences - 1)
    return model


# --- alternation and polish --------------------------------------------------------------------


def alternate_some(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """A copy after one to five alternations of weights and bones, their number chosen at random.

    Each vertex keeps its K largest weights; the other weights are dropped even if that raises the
    error.
    """
    moved = model.with_restarted_support()
    for _ in range(int(rng.integers(1, _MOST_ALTERNATIONS + 1))):
        repeat_alternation(data, moved, 1, constraints)
        free_gauge(data, moved, constraints)
    return moved


def polish_steps(
    data: Trajectories, model: Model, count: int, constraints: Constraints, *, entering: bool = True
) -> None:
    """Make `count` Gauss–Newton steps (in place); bones may enter a vertex's influences or not."""
    GaussNewton(data, model, constraints=constraints).run(count, entering=entering)
    free_gauge(data, model, constraints)


# --- where a new bone is placed ----------------------------------------------------------------


def patch_of_most_error(
    data: Trajectories,
    model: Model,
    rng: np.random.Generator,
    fraction: float,
    *,
    among: NDArray[np.bool_] | None = None,
) -> NDArray[np.intp]:
    """Find the patch with most error among patches of `fraction`·V/B vertices around drawn seeds.

    A vertex is drawn as a seed with a probability proportional to its error.  If the mask `among`
    (V,) selects any vertices, seeds and patches consist of these alone.
    """
    n = data.n_vertices
    order = by_motion(data)
    error = model.error * data.importance
    rows = np.arange(n)
    if among is not None and among.any():
        rows, order = np.flatnonzero(among), order[among[order]]
    total = float(error[rows].sum())
    chance = None if not total > 0 else error[order] / total
    seeds = order[rng.choice(len(order), size=min(_CANDIDATES, len(order)), p=chance)]
    size = min(len(rows), max(_FEWEST_VERTICES, int(fraction * n / model.n_bones)))
    _, neighbours = cKDTree(model.rest[rows]).query(model.rest[seeds], k=size)
    neighbours = np.asarray(neighbours).reshape(len(seeds), size)
    most = int(error[rows][neighbours].sum(axis=1).argmax())
    return np.asarray(rows[neighbours[most]])


def _with_more_bones(
    data: Trajectories, model: Model, count: int, rng: np.random.Generator, constraints: Constraints
) -> Model:
    """A copy with `count` more bones, each in turn placed where the error is largest."""
    for _ in range(count):
        members = patch_of_most_error(data, model, rng, float(rng.choice(_PATCH_SIZES)))
        model = _with_patch(data, model, members, constraints)
        vertex_step(data, model, constraints=constraints)
    return model


def _with_patch(
    data: Trajectories, model: Model, members: NDArray[np.intp], constraints: Constraints
) -> Model:
    """Copy of a model with one more bone, fitted to the vertices `members`.

    It is the only bone of those whose weights are free.
    """
    label = np.full(data.n_vertices, -1, dtype=np.intp)
    label[members] = 0
    grown = model.with_bone(fit_patches(data, model.rest, label, 1, constraints.bone_model)[:, 0])
    members = members[~constraints.vertex_mask(data.n_vertices)[members]]
    grown.assign_to_bone(members, grown.n_bones - 1)
    return grown


def _removal_costs(data: Trajectories, model: Model, constraints: Constraints) -> Array:
    """Rise (B,) of the squared error if one bone alone is removed; inf if the bone has to stay."""
    cost = bone_costs(data, model)
    keep = constraints.vertex_mask(data.n_vertices)
    cost[model.indices[keep][model.weights[keep] > 0]] = np.inf
    return cost
