"""Bone transforms of given weights, usable alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..checks import (
    BoneModel,
    check_bone_model,
    check_importance,
    check_mask,
    check_nonnegative,
    check_transforms,
    check_whole,
)
from ..clips import names_of
from ..errors import check_flag
from ..frames.error import squared_error
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.alternation import bone_step
from ..solver.gauss_newton import GaussNewton
from ..solver.initialization import fit_patches
from ..solver.model import Locked, Model
from ..solver.moments import bone_sums, stack_blocks
from ..solver.trajectories import Array, Trajectories, gather
from .fit import NAMES, Fit, checked, rmse_of

__all__ = ["BoneFit", "fit_bones"]

_SWEEPS = 5  # between two steps of all bones together
_STUCK = 0.9  # ratio of a frame's squared errors below which another start is taken
_ROUNDS = 16  # a run of stuck frames is freed from both ends, two frames a round


@dataclasses.dataclass(frozen=True, eq=False)
class BoneFit(Fit):
    """A model whose transforms were solved for.

    Attributes
    ----------
    skinning, squared_error, rmse
        As in :class:`Fit`.
    sweeps : int
        Gauss–Seidel sweeps over the bones.
    converged : bool
        True if the last ones moved no entry by more than the tolerance.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> fit = ssdr.fit_bones(dancer, ssdr.initialize(dancer, bones=4), max_sweeps=2)
    >>> fit.sweeps
    2
    """

    sweeps: int
    converged: bool


def fit_bones(
    sequence: MeshSequence | Any,
    skinning: Skinning,
    *,
    bone_model: BoneModel | None = None,
    from_transforms: bool = False,
    locked_bones: Any = None,
    vertex_importance: Any = None,
    tolerance: float = 1e-6,
    max_sweeps: int = 200,
) -> BoneFit:
    """Transforms that reproduce a sequence under the rest pose and weights of a model.

    Each sweep solves one weighted Kabsch a bone and frame with the others held
    (Gauss–Seidel), for similarity bones with Umeyama's scale; after every five, all
    bones take a Gauss–Newton step together.  For affine ones a single linear solve
    finds all of them, from rigid ones on.  Frames whose error is far higher than
    from the bones of a neighbouring frame start again from those.  Also the way to carry a
    model over to new motion of the same mesh.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    skinning : Skinning
        Its rest pose, weights and number of bones are used; its frames may be others.
    bone_model : {"rigid", "similarity", "affine"}, optional
        That of the model by default.
    from_transforms : bool
        Start from the model's transforms, which then are of these frames; by default from
        each bone's own fit.
    locked_bones : mask or indices, optional
        Bones that keep the model's transforms.
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
    >>> fit = ssdr.fit_bones(dancer, start, max_sweeps=2)
    >>> fit.skinning.transforms.shape
    (24, 4, 3, 4)
    """
    sequences, rest, weights = checked(sequence, skinning)
    n, n_frames = len(rest), sum(len(s) for s in sequences)
    kind = check_bone_model(skinning.bone_model if bone_model is None else bone_model)
    locked_bones = check_mask(locked_bones, "locked_bones", skinning.n_bones)
    world = None
    if check_flag(from_transforms, "from_transforms") or (
        locked_bones is not None and locked_bones.any()
    ):
        world = check_transforms(skinning.transforms, n_frames, kind, "skinning.")
    max_sweeps = check_whole(max_sweeps, "max_sweeps", 1)
    tolerance = check_nonnegative(tolerance, "tolerance", "a number >= 0")
    data = gather(
        sequences,
        bones=skinning.n_bones,
        vertex_importance=check_importance(vertex_importance, "vertex_importance", n),
    )
    inner, start = data.from_world(rest, world, NAMES)
    locked = Locked(rest=True, weights=np.ones(n, dtype=bool), bones=locked_bones, bone_model=kind)
    # a bone may not turn inside out on its way, which bars affine ones some ways from their
    # own fit that are open from rigid ones
    kinds: list[BoneModel] = [kind]
    indices = skinning.indices
    if start is None:
        if kind == "affine":
            kinds = ["rigid", "affine"]
        largest = indices[np.arange(n), weights.argmax(axis=1)].astype(np.intp)
        start = fit_patches(data, inner, largest, skinning.n_bones, kinds[0])
    model = Model.start(start, inner, indices[:, 0], indices.shape[1])
    model.indices, model.weights = indices.copy(), weights
    sweeps = 0
    for one in kinds:
        of_kind = dataclasses.replace(locked, bone_model=one)
        more, moved = _settle(data, model, of_kind, tolerance, max_sweeps)
        sweeps += more
    if world is None and _from_neighbours(data, model, locked, max_sweeps):
        more, moved = _settle(data, model, locked, tolerance, max_sweeps)
        sweeps += more
    out_rest, out = data.to_world(model.rest, model.transforms)
    squared = squared_error(sequences, out_rest, indices, weights, out)
    return BoneFit(
        skinning=dataclasses.replace(
            skinning, transforms=out, keyframes=None, bone_model=kind, **names_of(sequences)
        ),
        squared_error=squared,
        rmse=rmse_of(squared, n_frames),
        sweeps=sweeps,
        converged=moved <= tolerance,
    )


def _settle(
    data: Trajectories, model: Model, locked: Locked, tolerance: float, most: int
) -> tuple[int, float]:
    """Sweep until no entry moves more than `tolerance` (in place).

    Returns the number of sweeps and the last move.
    """
    sweeps, moved = 0, np.inf
    damping: float | None = None
    while sweeps < most and moved > tolerance:
        before = model.transforms.copy()
        if sweeps and locked.bone_model != "affine":
            damping = _step_together(data, model, locked, damping)
        step = min(_SWEEPS, most - sweeps)
        bone_step(data, model, sweeps=step, locked=locked)
        moved = float(np.abs(model.transforms - before).max())
        sweeps += step
    return sweeps, moved


def _from_neighbours(data: Trajectories, model: Model, locked: Locked, most: int) -> bool:
    """Restart frames that are stuck from the frames beside them (in place); whether any was.

    Where bones overlap widely, a frame's own start may end in a poor minimum.
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

    frame, mask = np.arange(data.n_frames), locked.bone_mask(model.n_bones)
    for done in range(_ROUNDS):
        bound = _STUCK * error(model.transforms) - 1e-12 * energy
        best, freed = model.transforms.copy(), np.zeros(len(frame), dtype=bool)
        for shift in (1, -1):
            trial = model.copy()
            trial.transforms = model.transforms[np.clip(frame + shift, 0, frame[-1])]
            trial.transforms[:, mask] = model.transforms[:, mask]
            _settle(data, trial, locked, 0.0, min(most, 4 * _SWEEPS))
            value = error(trial.transforms)
            better = value < bound
            best[better], bound = trial.transforms[better], np.minimum(value, bound)
            freed |= better
        if not freed.any():
            return done > 0
        model.transforms = best
    return True


def _step_together(
    data: Trajectories, model: Model, locked: Locked, damping: float | None
) -> float:
    """One Gauss–Newton step of all bones (in place); returns the damping for the next.

    Sweeps alone take hundreds of rounds where bones overlap widely.
    """
    polish = GaussNewton(data, model, locked=locked, damping=damping)
    polish.step()
    return polish.damping
