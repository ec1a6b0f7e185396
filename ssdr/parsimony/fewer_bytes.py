"""Fewer bytes than the fewest rigid bones take: more bones, affine bones, or shapes beside bones.

Each is estimated before it is solved in full:

    more bones     do with fewer influences, which pays where weights take more bytes than keys
    affine bones   a key takes twice the bytes, so that about half as many bones have to suffice
    shapes         replace bones whose keys take more bytes; their number is that of the principal
                   components which the error of the other bones requires
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from ..fit.shapes import components, shapes_within
from ..problem.problem import Effort
from ..search.steps import polish
from ..skinning import Skinning
from ..solver.model import Model
from ..storage.keyframes import Tracks
from ..storage.size import influence_bytes, key_bytes
from .fewest_bones import Bounds, fewest_bones, merge_and_polish, polish_fewest, start_and_polish
from .models_by_bones import PRUNING, ModelsByBones
from .pruning import estimated_bytes, prune, record
from .report import Pruning
from .solved_frames import SolvedFrames

__all__ = ["fewer_bytes"]

# What more bones may save: so much of the influences beyond one a vertex and, where the motion is
# so smooth that a tenth of the keys could go, of the keys.
_SAVED, _SMOOTH = 0.7, 0.9
_GROWTH = 1.4  # next number of rigid bones, relative to the previous one
_LESS = 0.97  # estimated bytes, relative to the fewest so far, up to which a series continues
_POLISH = 12  # steps before bytes are estimated
_SPARE = 0.05  # share of the bytes that affine bones may take beyond those of the rigid ones
_SHAPED = 0.97  # share of the tolerance that shapes hold: keys that are dropped use the rest
_MATRICES = 1 << 29  # most bytes of a matrix for each vertex and frame, of which shapes take some

Changed = tuple[Skinning, list[Pruning]]


def fewer_bytes(
    models: ModelsByBones,
    bounds: Bounds,
    effort: Effort,
    tolerance: float,
    rigid: Skinning,
    skinning_of_all: Callable[..., Skinning],
) -> Iterator[Changed]:
    """Yield models that hold the tolerance in ever fewer bytes, with their prunings.

    Parameters
    ----------
    models : ModelsByBones
        Models of a search that found the fewest bones.
    bounds : Bounds
        Its `least` is proven.
    effort : {"fast", "balanced", "best"}
    tolerance : float
    rigid : Skinning
        The pruned model of the fewest bones, whose bytes are to be fewer.
    skinning_of_all : callable
        As in :func:`~ssdr.parsimony.pruning.prune`; also takes the `frames` of a model.
    """
    frames, model = models.frames, models.best[models.held_bones].model
    fewest, kept = estimated_bytes(frames, model, tolerance), None
    bone = float(key_bytes(frames.skinning(model)).mean()) * frames.problem.n_frames
    spare, size = int(_SPARE * fewest / bone), frames.size(rigid)
    smooth = size.keys < _SMOOTH * bone * model.n_bones
    needed = rigid.n_vertices * (1 + influence_bytes(rigid.n_bones, frames.problem.storage))
    saved = _SAVED * (size.weights - needed + smooth * size.keys)
    most = min(bounds.most, model.n_bones + int(max(saved, 0) / size.keys * model.n_bones))
    found = {
        "more bones": _more_bones(models, most),
        "affine bones": _affine(models, bounds, effort, spare),
    }
    for what, others in found.items():
        for one in others:
            estimated = estimated_bytes(*one, tolerance)
            if estimated > _LESS * fewest:
                break
            fewest, kept = estimated, (what, *one)

    def stored(skinning: Skinning) -> float:
        size, error = frames.kept(skinning, frames.error_of_all(skinning), tolerance)
        return size if error <= tolerance else math.inf

    def changed(what: str, bones: int, size: int, error: float) -> Pruning:
        before = frames.bytes(model), frames.error(model)
        return Pruning(what, model.n_bones, bones, before[0], size, before[1], error)

    def solved() -> Iterator[Changed]:
        models.fraction = PRUNING
        if kept is not None:
            what, others, one = kept
            of_all = partial(skinning_of_all, frames=others)
            pruned, prunings = prune(others, one, tolerance, of_all(one), of_all)
            change = changed(what, one.n_bones, others.bytes(one), others.error(one))
            yield pruned, [change, *prunings]
        for shaped, keyed in _with_shapes(models, tolerance, bone, skinning_of_all):
            size, error = frames.size(shaped).total, frames.error_of_all(shaped)
            last = record(frames, "keyframes", shaped, keyed, error, frames.error_of_all(keyed))
            yield keyed, [changed("shapes", shaped.n_bones, size, error), last]

    least = stored(rigid)
    for skinning, prunings in solved():
        if (taken := stored(skinning)) < least:
            least = taken
            yield skinning, prunings


def _more_bones(models: ModelsByBones, most: int) -> Iterator[tuple[SolvedFrames, Model]]:
    """Yield models with more and more rigid bones, up to `most`, until one misses the tolerance."""
    bones = models.held_bones
    while bones < most:
        bones = min(most, max(bones + 1, math.ceil(_GROWTH * bones)))
        if bones not in models.best:
            models.attempt(bones, start_and_polish, "more bones")
        last, start = partial(polish, steps=_POLISH, gain=0.005), models.best[bones].model
        models.attempt(bones, last, "polished", start=start, until=0.0)
        if models.best[bones].value > models.tolerance:
            return
        yield models.frames, models.best[bones].model


def _affine(
    models: ModelsByBones, bounds: Bounds, effort: Effort, spare: int
) -> Iterator[tuple[SolvedFrames, Model]]:
    """Yield a model of the fewest affine bones, if about half as many as rigid ones suffice."""
    frames, problem = copy.copy(models.frames), models.frames.problem
    most = min(models.held_bones, (models.held_bones + spare) // 2)
    if problem.rig != "none" or problem.constraints.bone_model != "rigid" or most < bounds.least:
        return
    constraints = dataclasses.replace(problem.constraints, bone_model="affine")
    frames.problem = dataclasses.replace(problem, bones=most, constraints=constraints)

    def report(phase: str, ready: bool) -> None:
        models.iteration, models.fraction = found.iteration, found.fraction
        models.report(f"affine, {phase}", ready)

    found = ModelsByBones(frames, report, tolerance=models.tolerance)
    found.attempts, found.iteration = models.attempts, models.iteration
    found.fraction = models.fraction
    start = models.best[models.held_bones].model.with_restarted_support()
    schedule = partial(merge_and_polish, steps=_POLISH)
    found.attempt(most, schedule, "affine", start=start, until=0.0)
    if found.fewest is not None:
        fewest_bones(found, Bounds(bounds.least, most, 0), effort)
        polish_fewest(found, effort)
        yield frames, found.best[found.held_bones].model


def _with_shapes(
    models: ModelsByBones,
    tolerance: float,
    bone: float,
    skinning_of_all: Callable[..., Skinning],
) -> Iterator[tuple[Skinning, Skinning]]:
    """Yield a model with shapes in the place of bones whose keys take more bytes.

    Yields it with all keys and with fewer; nothing if shapes do not pay or it misses the tolerance.
    """
    frames, problem, rigid = models.frames, models.frames.problem, models.held_bones
    n_vertices = problem.inputs[0].n_vertices
    # bones, each of so many bytes, that a shape has to replace; one alone is not worth the trial
    each = (12 * n_vertices + 4 * problem.n_frames) / bone
    if (
        rigid - 1 < 2 * each
        or frames.measure == "max"
        or problem.rig != "none"
        or problem.constraints.rest
        or 72 * n_vertices * problem.n_frames > _MATRICES
    ):
        return

    def holds(skinning: Skinning) -> bool:
        models.report("shapes", True)
        return frames.kept(skinning, frames.error_of_all(skinning), tolerance)[1] <= tolerance

    if 1 not in models.best:
        models.attempt(1, start_and_polish, "a bone for shapes")
    fewer = sorted(b for b in models.best if rigid - b >= each)
    truth = np.concatenate([s.frames(slice(None)) for s in problem.inputs]).astype(np.float64)
    # the search's own tolerance, which leaves room for what a file rounds
    limit, needed = _SHAPED * models.tolerance, {}
    for bones in (1, fewer[len(fewer) // 2], fewer[-1]):
        models.report("shapes", True)
        skinning = frames.skinning(models.best[bones].model)
        errors = components(skinning, truth - skinning.skin(dtype=np.float64))[1]
        needed[bones] = bones + each * (1 + int((errors > limit).sum()))
    bones = min(needed, key=lambda b: needed[b])
    if needed[bones] > rigid:
        return
    shaped = shapes_within(truth, skinning_of_all(models.best[bones].model), limit).skinning
    if holds(shaped):
        tracks = Tracks(shaped, problem.offsets)
        yield shaped, tracks.sparsest(tolerance, holds) or shaped
