"""Fit of bone transforms to given weights, usable alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..common.checks import BoneModel, check_importance, check_nonnegative, check_whole
from ..common.errors import InputError, check_flag
from ..common.short_repr import short_repr
from ..mesh.clips import names_of
from ..mesh.sequence import MeshSequence
from ..model.skinning import Skinning
from ..solver.alternation import bone_step
from ..solver.gauss_newton import GaussNewton
from ..solver.initialization import fit_patches
from ..solver.model import Constraints, Model
from ..solver.moments import bone_sums, stack_blocks
from ..solver.trajectories import Array, Trajectories, gather
from .fit import Fit, checked, fit_of

# Sweeps, and steps of all bones together after them.  With one such step, bones that overlap widely
# take hundreds of sweeps; two cost a third more where one would do.
_SWEEPS, _STEPS = 5, 2
# A frame's transforms are replaced if another start reaches less than this fraction of its squared
# error.
_STUCK = 0.9
# Rounds of restarts; each frees the first and the last of a row of stuck frames.
_ROUNDS = 16


@dataclasses.dataclass(frozen=True, eq=False)
class BoneFit(Fit):
    """A model whose transforms were fitted, and its error.

    Attributes
    ----------
    skinning, squared_error, rmse
        As in :class:`Fit`.
    sweeps : int
        Number of Gauss–Seidel sweeps over the bones.
    converged : bool
        Whether the last sweeps changed no entry of a transform by more than the tolerance.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> fit = ssdr.fit_bones(dancer, ssdr.initialize(dancer, bones=4), max_sweeps=2)
    >>> fit.sweeps
    2
    """

    sweeps: int
    converged: bool

    __repr__ = short_repr


def fit_bones(
    sequence: MeshSequence | Any,
    rest: Skinning | Any,
    indices: Any = None,
    weights: Any = None,
    *,
    bone_model: BoneModel | None = None,
    from_transforms: bool = False,
    vertex_importance: Any = None,
    tolerance: float = 1e-6,
    max_sweeps: int = 200,
) -> BoneFit:
    """Fit transforms that reproduce a sequence with a given rest pose and weights.

    A sweep solves a weighted Kabsch problem for each bone in each frame while the other bones are
    held (Gauss–Seidel); for similarity bones, the solution includes Umeyama's scale.  After every
    five sweeps, all bones take two Gauss–Newton steps together.  Affine bones start from rigid
    ones, and a linear solve then finds all bones of a frame at once.  A frame starts again from the
    bones of a neighbouring frame if these lead to far less error.  The function also serves to
    carry a model over to new motion of the same mesh.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    rest : (V, 3) array or Skinning
        Rest pose.  A skinning brings the weights and the number of bones, too; it need not have the
        same frames.
    indices, weights : (V, K) int and float arrays, optional
        Skin weights; the largest index determines the number of bones.  Without `indices`, weights
        are those of all bones, (V, B) and possibly sparse.
    bone_model : {"rigid", "similarity", "affine"}, optional
        By default that of the skinning, or rigid without one.
    from_transforms : bool
        Whether to start from the transforms of a skinning, which must then be of these frames.  By
        default each bone starts from a fit to the vertices that it moves most.
    vertex_importance : (V,) array, optional
    tolerance : float
        The sweeps end when no entry of a transform changes by more than this; translations are
        relative to the mesh's size.
    max_sweeps : int
        Most sweeps from each start.

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
    >>> fit = ssdr.fit_bones(dancer, start, max_sweeps=2)
    >>> fit.skinning.transforms.shape
    (24, 4, 3, 4)
    >>> alike = ssdr.fit_bones(dancer, start.rest, start.indices, start.weights, max_sweeps=2)
    >>> np.array_equal(alike.skinning.transforms, fit.skinning.transforms)
    True
    """
    given = checked(sequence, rest, bone_model, indices=indices, weights=weights)
    sequences, skinning, n = given.sequences, given.skinning, len(given.rest)
    kind = skinning.bone_model
    world = None
    if check_flag(from_transforms, "from_transforms"):
        if not given.prefix:
            wanted = "a Skinning as `rest`, whose transforms are started from"
            raise InputError("from_transforms", wanted, "arrays")
        world = given.transforms()
    max_sweeps = check_whole(max_sweeps, "max_sweeps", 1)
    tolerance = check_nonnegative(tolerance, "tolerance", "a number >= 0")
    data = gather(
        sequences,
        bones=skinning.n_bones,
        vertex_importance=check_importance(vertex_importance, "vertex_importance", n),
    )
    inner = data.alignment.points_from_world(given.rest, f"{given.prefix}rest")
    start = None if world is None else data.alignment.moves_from_world(world, "skinning.transforms")
    constraints = Constraints(lock_rest=True, weights=np.ones(n, dtype=bool), bone_model=kind)
    # no step may turn a bone inside out, which blocks some paths of affine bones from their own
    # fit; from rigid bones these paths are open
    kinds: list[BoneModel] = [kind]
    used, amounts = given.indices, given.weights
    if start is None:
        if kind == "affine":
            kinds = ["rigid", "affine"]
        largest = used[np.arange(n), amounts.argmax(axis=1)].astype(np.intp)
        start = fit_patches(data, inner, largest, skinning.n_bones, kinds[0])
    model = Model.start(start, inner, used[:, 0], used.shape[1])
    model.indices, model.weights = used.copy(), amounts
    sweeps = 0
    for one in kinds:
        of_kind = dataclasses.replace(constraints, bone_model=one)
        more, moved = _sweep_until_still(data, model, of_kind, tolerance, max_sweeps)
        sweeps += more
    if world is None and _from_neighbours(data, model, constraints, max_sweeps):
        more, moved = _sweep_until_still(data, model, constraints, tolerance, max_sweeps)
        sweeps += more
    _, out = data.alignment.to_world(model.rest, model.transforms)
    fitted = dataclasses.replace(skinning, transforms=out, keyframes=None, **names_of(sequences))
    found = fit_of(sequences, fitted)
    return BoneFit(**vars(found), sweeps=sweeps, converged=moved <= tolerance)


def _sweep_until_still(
    data: Trajectories, model: Model, constraints: Constraints, tolerance: float, most: int
) -> tuple[int, float]:
    """Sweep until no entry of a transform changes by more than `tolerance` (in place).

    Returns the number of sweeps, which is at most `most`, and the largest change in the last round.
    """
    sweeps, moved = 0, np.inf
    damping: float | None = None
    while sweeps < most and moved > tolerance:
        before = model.transforms.copy()
        if sweeps and constraints.bone_model != "affine":
            # if bones overlap widely, sweeps alone would need hundreds of rounds
            newton = GaussNewton(data, model, constraints=constraints, damping=damping)
            damping = newton.run(_STEPS, entering=False)
        step = min(_SWEEPS, most - sweeps)
        bone_step(data, model, sweeps=step, constraints=constraints)
        moved = float(np.abs(model.transforms - before).max())
        sweeps += step
    return sweeps, moved


def _from_neighbours(data: Trajectories, model: Model, constraints: Constraints, most: int) -> bool:
    """Solve each frame again, starting from the next and the previous frame (in place).

    If bones overlap widely, a frame's own start may end in a poor minimum.  A new solution is taken
    if its error is far lower.  Returns whether any frame was improved.
    """
    u, c = bone_sums(data, model)
    flat = stack_blocks(u)
    energy = np.array(
        [
            float((data.importance * (data.frame(t) ** 2).sum(axis=1)).sum())
            for t in range(data.n_frames)
        ]
    )

    def error(transforms: Array) -> Array:
        """Squared error (F,) of each frame under `transforms`."""
        hat = data.stack(transforms).reshape(data.n_frames, 3, -1)
        change: Array = (hat * (hat @ flat - 2 * c.reshape(hat.shape))).sum(axis=(1, 2))
        return energy + change

    frame = np.arange(data.n_frames)
    for done in range(_ROUNDS):
        bound = _STUCK * error(model.transforms) - 1e-12 * energy
        best, freed = model.transforms.copy(), np.zeros(len(frame), dtype=bool)
        for shift in (1, -1):
            trial = model.copy()
            near = np.clip(frame + shift, 0, frame[-1])
            # the alignment may have rotated the neighbouring frame differently
            turn = data.alignment.rotation.swapaxes(1, 2) @ data.alignment.rotation[near]
            trial.transforms = np.einsum("tab,tjbc->tjac", turn, model.transforms[near])
            _sweep_until_still(data, trial, constraints, 0.0, min(most, 4 * _SWEEPS))
            value = error(trial.transforms)
            better = value < bound
            best[better], bound = trial.transforms[better], np.minimum(value, bound)
            freed |= better
        if not freed.any():
            return done > 0
        model.transforms = best
    return True
