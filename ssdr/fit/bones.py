"""Bone transforms of given weights, usable alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import (
    as_sequences,
    check_bone_model,
    check_count,
    check_importance,
    check_mask,
    check_nonnegative,
    check_rest,
    check_transforms,
    check_weights,
)
from ..errors import InputError
from ..frames.error import squared_error
from ..sequence import MeshSequence
from ..skinning import BoneModel
from ..solver.alternation import bone_step
from ..solver.gauss_newton import GaussNewton
from ..solver.initialization import fit_patches
from ..solver.model import Fixed, Model
from ..solver.moments import bone_sums, stack_blocks
from ..solver.trajectories import Array, Trajectories, gather

__all__ = ["BoneFit", "fit_bones"]

_SWEEPS = 5  # between two steps of all bones together
_STUCK = 0.9  # of a frame's squared error, to which another start takes it
_ROUNDS = 16  # frames in a row that are stuck get free from both ends, two a round


@dataclasses.dataclass(frozen=True, eq=False)
class BoneFit:
    """Transforms and what they reach.

    Attributes
    ----------
    transforms : (F, B, 3, 4) float64
    rmse : float
        sqrt(Σ|d|² / (F V)).
    sweeps : int
        Gauss–Seidel sweeps that were made.
    converged : bool
        Whether the last sweep moved no bone by more than `tolerance`.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.initialize(dancer, bones=4)
    >>> fit = ssdr.fit_bones(
    ...     dancer, rest=start.rest, indices=start.indices, weights=start.weights, max_sweeps=2
    ... )
    >>> fit.sweeps >= 1, fit.rmse < 0.1 * dancer.diagonal()
    (True, True)
    """

    transforms: NDArray[np.float64]
    rmse: float
    sweeps: int
    converged: bool


def fit_bones(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    rest: Any,
    indices: Any,
    weights: Any,
    bones: int | None = None,
    bone_model: BoneModel = "rigid",
    transforms: Any = None,
    locked_bones: Any = None,
    vertex_importance: Any = None,
    tolerance: float = 1e-6,
    max_sweeps: int = 200,
) -> BoneFit:
    """Transforms that reproduce a sequence under given rest pose and weights.

    Each sweep solves one weighted Kabsch a bone and frame with the others held
    (Gauss–Seidel), for similarity bones with Umeyama's scale; after every five, all
    bones take a Gauss–Newton step together.  For affine ones a single linear solve
    finds all of them, from rigid ones on.  Frames that end far above what the bones of
    the frames beside them lead to start again from those.  Also the way to carry a
    model over to new motion of the same mesh.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    faces : (T, 3) int array, optional
    rest : (V, 3) array
    indices, weights : (V, K) arrays
    bones : int, optional
        Number of bones; by default as many as `indices` or `transforms` name.
    bone_model : {"rigid", "similarity", "affine"}
    transforms : (F, B, 3, 4) array, optional
        Where to start; by default each bone's own fit.
    locked_bones : mask or indices, optional
        Bones that keep the given transforms.
    vertex_importance : (V,) array, optional
    tolerance : float
        Largest change of a transform's entry (translations relative to the
        mesh's size) at which to stop.
    max_sweeps : int
        From each start.

    Returns
    -------
    BoneFit

    Raises
    ------
    InputError
        If an argument is not usable.

    References
    ----------
    Le and Deng 2012, section 3.3; Kabsch 1976; Umeyama 1991.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.initialize(dancer, bones=4)
    >>> fit = ssdr.fit_bones(
    ...     dancer, rest=start.rest, indices=start.indices, weights=start.weights, max_sweeps=2
    ... )
    >>> fit.transforms.shape
    (24, 4, 3, 4)
    """
    sequences = as_sequences(sequence, faces)
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    rest = check_rest(rest, n)
    indices, weights = check_weights(indices, weights, n)
    bone_model = check_bone_model(bone_model)
    world = None if transforms is None else check_transforms(transforms, n_frames, bone_model)
    count = int(indices.max()) + 1 if world is None else world.shape[1]
    if bones is not None:
        expected = f"an integer >= {count}, as joints and transforms name"
        asked = check_count(bones, "bones", expected)
        if not count <= asked <= np.iinfo(np.int32).max:
            raise InputError("bones", expected, asked)
        count = asked
    if indices.max() >= count:
        raise InputError("indices", f"indices from 0 to {count - 1}", int(indices.max()))
    if world is not None and world.shape[1] != count:
        raise InputError("transforms", f"{count} bones", f"{world.shape[1]}")
    locked = check_mask(locked_bones, "locked_bones", count)
    if locked is not None and world is None:
        raise InputError("transforms", "the transforms of the locked bones", "None")
    max_sweeps = check_count(max_sweeps, "max_sweeps")
    tolerance = check_nonnegative(tolerance, "tolerance", "a number >= 0")
    data = gather(
        sequences,
        bones=count,
        vertex_importance=check_importance(vertex_importance, "vertex_importance", n),
    )
    inner, start = data.from_world(rest, world)
    fixed = Fixed(rest=True, weights=np.ones(n, dtype=bool), bones=locked, bone_model=bone_model)
    # a bone may not turn inside out on its way, which bars affine ones some ways from their
    # own fit that are open from rigid ones
    kinds: list[BoneModel] = [bone_model]
    if start is None:
        if bone_model == "affine":
            kinds = ["rigid", "affine"]
        start = fit_patches(data, inner, indices[:, 0].astype(np.intp), count, kinds[0])
    model = Model.start(start, inner, indices[:, 0], indices.shape[1])
    model.indices, model.weights = indices.copy(), weights.copy()
    sweeps = 0
    for kind in kinds:
        of_kind = dataclasses.replace(fixed, bone_model=kind)
        more, moved = _settle(data, model, of_kind, tolerance, max_sweeps)
        sweeps += more
    if world is None and _from_neighbours(data, model, fixed, max_sweeps):
        more, moved = _settle(data, model, fixed, tolerance, max_sweeps)
        sweeps += more
    out_rest, out = data.to_world(model.rest, model.transforms)
    squared = squared_error(sequences, out_rest, indices, weights, out)
    return BoneFit(
        transforms=out,
        rmse=float(np.sqrt(squared.sum() / (n_frames * n))),
        sweeps=sweeps,
        converged=moved <= tolerance,
    )


def _settle(
    data: Trajectories, model: Model, fixed: Fixed, tolerance: float, most: int
) -> tuple[int, float]:
    """Sweeps (in place) until no entry moves by more; how many, and the last move."""
    sweeps, moved = 0, np.inf
    damping: float | None = None
    while sweeps < most and moved > tolerance:
        before = model.transforms.copy()
        if sweeps and fixed.bone_model != "affine":
            damping = _step_together(data, model, fixed, damping)
        step = min(_SWEEPS, most - sweeps)
        bone_step(data, model, sweeps=step, fixed=fixed)
        moved = float(np.abs(model.transforms - before).max())
        sweeps += step
    return sweeps, moved


def _from_neighbours(data: Trajectories, model: Model, fixed: Fixed, most: int) -> bool:
    """Start frames that are stuck again from those beside them (in place); whether any was.

    Where bones overlap widely, a frame's own start now and then leads nowhere.
    """
    u, c = bone_sums(data, model.indices, model.weights, model.rest, model.n_bones)
    flat = stack_blocks(u)
    energy = np.array(
        [
            float((data.importance * (data.frame(t) ** 2).sum(axis=1)).sum())
            for t in range(data.n_frames)
        ]
    )

    def error(transforms: Array) -> Array:
        """(F,) squared error."""
        hat = data.stack(transforms).reshape(data.n_frames, 3, -1)
        told: Array = (hat * (hat @ flat - 2 * c.reshape(hat.shape))).sum(axis=(1, 2))
        return energy + told

    frame, locked = np.arange(data.n_frames), fixed.locked(model.n_bones)
    for done in range(_ROUNDS):
        bound = _STUCK * error(model.transforms) - 1e-12 * energy
        best, freed = model.transforms.copy(), np.zeros(len(frame), dtype=bool)
        for shift in (1, -1):
            trial = model.copy()
            trial.transforms = model.transforms[np.clip(frame + shift, 0, frame[-1])]
            trial.transforms[:, locked] = model.transforms[:, locked]
            _settle(data, trial, fixed, 0.0, min(most, 4 * _SWEEPS))
            value = error(trial.transforms)
            better = value < bound
            best[better], bound = trial.transforms[better], np.minimum(value, bound)
            freed |= better
        if not freed.any():
            return done > 0
        model.transforms = best
    return True


def _step_together(data: Trajectories, model: Model, fixed: Fixed, damping: float | None) -> float:
    """One Gauss–Newton step of all bones (in place); returns the damping for the next.

    Sweeps alone take hundreds of rounds where bones overlap widely.
    """
    polish = GaussNewton(data, model, fixed=fixed, damping=damping)
    polish.step()
    return polish.damping
