"""``ssdr.levels``: models with different numbers of bones of one skeleton, for levels of detail."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from .checks import check_callback, check_rng, check_whole, names_arguments
from .errors import InputError
from .frames.error import rmse
from .frames.normals import with_fitted_normals
from .metrics.normal_angles import errors_of_model
from .problem.answer import finished
from .problem.check import check_problem
from .problem.problem import Effort
from .progress import Callback, Monitor
from .result import Decomposition
from .search.nested_levels import nested_models
from .search.solve import solve
from .sequence import MeshSequence, as_sequences, labels_of, without_copies
from .skinning import Skinning
from .solver.alternation import vertex_step
from .solver.model import Constraints, Model
from .solver.rest_surface import RestSurface
from .solver.trajectories import gather
from .solver.vertex_newton import optimise_vertices

_TRIALS: dict[Effort, int] = {"fast": 4, "balanced": 48, "best": 160}


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class LevelsOfDetail(Decomposition):
    """Models with decreasing numbers of bones, where each has the first bones of the finer ones.

    It is a :class:`Decomposition` whose `skinning` and `rmse` are those of the finest level.

    Attributes
    ----------
    levels : tuple of Skinning
        Models, the finest first.  A model of B bones has the first B bones of the finest, with the
        same transforms and names, but weights and a rest pose of its own.
    errors : tuple of float
        Root mean square error of each level.
    alone : tuple of float
        Root mean square error of an independent decomposition with as many bones as each level.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.levels(dancer, bones=(8, 4), effort="fast")
    >>> fine, coarse = result.levels
    >>> np.array_equal(fine.transforms[:, :4], coarse.transforms)
    True
    """

    levels: tuple[Skinning, ...] = ()
    errors: tuple[float, ...] = ()
    alone: tuple[float, ...] = ()


@names_arguments
def levels(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    bones: Sequence[int],
    influences: int = 4,
    effort: Effort = "balanced",
    rng: int | np.random.Generator = 0,
    callback: Callback | None = None,
) -> LevelsOfDetail:
    """Find models with several numbers of rigid bones, all taken from one skeleton.

    The mesh is first decomposed once for each number of bones, which shows how small the error of
    each level can be.  From the finest model, the bones whose removal adds least to the error are
    removed one by one.  Then the transforms, which all levels share, are optimised so that the
    error of each level is about the same multiple of that of its independent decomposition.

    Parameters
    ----------
    sequence, faces, influences, effort, rng
        As in :func:`decompose`.
    bones : sequence of int
        Number of bones of each level, in decreasing order.
    callback : callable, optional
        As in :func:`decompose`; if it stops the run, there is no result.

    Returns
    -------
    LevelsOfDetail

    Raises
    ------
    InputError
        If an argument is not usable, before anything is computed.
    Cancelled
        If the callback stopped the run.

    References
    ----------
    Steps on all bones: variable projection, Golub and Pereyra 1973.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.levels(dancer, bones=(8, 4), effort="fast")
    >>> [level.n_bones for level in result.levels]
    [8, 4]
    >>> max(result.errors) < 0.05 * dancer.diagonal()
    True
    """
    sequences, counts = as_sequences(sequence, faces), _check_counts(bones)
    rng, monitor = check_rng(rng), Monitor(check_callback(callback), all_or_nothing=True)
    n, alone = len(counts) + 1, []
    for k, count in enumerate(counts):
        problem = check_problem(
            sequences, None, bones=count, influences=influences, effort=effort, rng=rng
        )
        with monitor.part(k / n, (k + 1) / n):
            alone.append(finished(dataclasses.replace(problem, monitor=monitor), solve))
    with monitor.part((n - 1) / n, 1.0):
        return _nest(sequences, alone, influences, effort, rng, monitor)


def _nest(
    sequences: list[MeshSequence],
    alone: list[Decomposition],
    influences: int,
    effort: Effort,
    rng: np.random.Generator,
    monitor: Monitor,
) -> LevelsOfDetail:
    """Make nested levels of detail from the decompositions `alone`, with the finest first."""
    best = alone[0]
    counts = [one.skinning.n_bones for one in alone]
    merged, copies, kept, row = without_copies(sequences, labels_of(sequences))
    data = gather(merged, bones=counts[0], vertex_importance=copies, compress=False)
    rest, transforms = data.from_world(best.skinning.rest[kept], best.skinning.transforms)
    # each level has a rest pose of its own, which resembles that of the finest
    data = dataclasses.replace(data, surface=RestSurface.build(data, rest)).compressed(counts[0])
    weights = best.skinning.weights[kept].astype(np.float64)
    skin = best.skinning.indices[kept], weights
    finest = Model.with_weights(transforms, rest, *skin, min(influences, counts[0]))
    every = np.ones(data.n_vertices, dtype=bool)
    vertex_step(data, finest, constraints=Constraints(rest=True, weights=every))  # sets the errors
    optimise_vertices(data, finest)

    def report(fraction: float) -> None:
        monitor.report("levels", iteration=0, rmse=best.rmse, fraction=fraction)

    unit = data.n_frames * data.n_vertices / data.scale**2
    models = nested_models(
        data,
        finest,
        counts,
        np.array([max(one.rmse**2 * unit, 1e-12) for one in alone]),
        influences=influences,
        trials=_TRIALS[effort],
        rng=rng,
        report=report,
    )
    found, errors = [], []
    _, transforms = data.to_world(models[0].rest, models[0].transforms)
    for model in models:
        padded = model.with_influences(influences)
        level = dataclasses.replace(
            best.skinning,
            rest=data.points_to_world(model.rest)[row],
            indices=padded.indices[row],
            weights=padded.weights[row],
            transforms=transforms[:, : model.n_bones].copy(),
        )
        level = with_fitted_normals(sequences, level)
        found.append(level)
        arrays = level.rest, level.indices, level.weights, level.transforms
        errors.append(rmse(sequences, *arrays))
    normals = errors_of_model(sequences, found[0])
    same = {f.name: getattr(best, f.name) for f in dataclasses.fields(Decomposition)}
    return LevelsOfDetail(
        **same | {"skinning": found[0], "rmse": errors[0], "normals": normals},
        levels=tuple(found),
        errors=tuple(errors),
        alone=tuple(one.rmse for one in alone),
    )


def _check_counts(bones: Any) -> list[int]:
    """Check that numbers of bones decrease, and return them as a list."""
    if isinstance(bones, (str, bytes)) or not np.iterable(bones):
        raise InputError("bones", "several numbers of bones, as (60, 30, 12)", repr(bones))
    counts = [check_whole(count, "bones", 1) for count in bones]
    if len(counts) < 2 or any(a <= b for a, b in itertools.pairwise(counts)):
        raise InputError("bones", "two or more numbers, each smaller than the last", counts)
    return counts
