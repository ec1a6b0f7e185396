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
from ..storage.size import key_bytes
from .fewest_bones import Bounds, fewest_bones, merge_and_polish, polish_fewest, start_and_polish
from .models_by_bones import ModelsByBones
from .pruning import estimated_bytes, prune
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

Pruned = tuple[Skinning, list[Pruning]]


def fewer_bytes(
    models: ModelsByBones,
    bounds: Bounds,
    effort: Effort,
    tolerance: float,
    rigid: Pruned,
    skinning_of_all: Callable[..., Skinning],
) -> Pruned:
    """Find the model of fewest bytes that holds the tolerance; return it and its prunings.

    Parameters
    ----------
    models : ModelsByBones
        Models of a search that found the fewest bones.
    bounds : Bounds
    effort : {"fast", "balanced", "best"}
    tolerance : float
    rigid : Skinning and list of Pruning
        The pruned model of the fewest bones, which is the result if no other takes fewer bytes.
    skinning_of_all : callable
        As in :func:`~ssdr.parsimony.pruning.prune`; also takes the `frames` of a model.
    """
    frames, held = models.frames, models.best[models.held_bones].model
    fewest, kept, best = estimated_bytes(frames, held, tolerance), None, rigid
    bone = float(key_bytes(frames.skinning(held)).mean()) * frames.problem.n_frames
    spare, size = int(_SPARE * fewest / bone), frames.size(rigid[0])
    smooth = size.keys < _SMOOTH * bone * held.n_bones
    saved = _SAVED * (size.weights - 4 * rigid[0].n_vertices + smooth * size.keys)
    most = min(bounds.most, held.n_bones + int(max(saved, 0) / size.keys * held.n_bones))
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

    def stored(pruned: Pruned) -> float:
        size, error = frames.kept(pruned[0], frames.error_of_all(pruned[0]), tolerance)
        return size if error <= tolerance else math.inf

    def changed(what: str, others: SolvedFrames, model: Model, pruned: Pruned) -> Pruned:
        counts, sizes = (held.n_bones, model.n_bones), (frames.bytes(held), others.bytes(model))
        errors = frames.error(held), others.error(model)
        return pruned[0], [Pruning(what, *counts, *sizes, *errors), *pruned[1]]

    if kept is not None:
        of_all = partial(skinning_of_all, frames=kept[1])
        pruned = prune(*kept[1:], tolerance, of_all(kept[2]), of_all)
        best = min(best, changed(*kept, pruned), key=stored)
    shaped = _with_shapes(models, tolerance, bone)
    if shaped is not None:
        best = min(best, changed("shapes", *shaped), key=stored)
    return best


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
    """Yield a model with about half as many affine bones as the fewest rigid bones found.

    A model with the fewest affine bones that suffice follows.
    """
    frames, problem = copy.copy(models.frames), models.frames.problem
    most = min(models.held_bones, (models.held_bones + spare) // 2)
    if problem.rig != "none" or problem.constraints.bone_model != "rigid" or most < bounds.least:
        return
    constraints = dataclasses.replace(problem.constraints, bone_model="affine")
    frames.problem = dataclasses.replace(problem, bones=most, constraints=constraints)
    found = ModelsByBones(frames, models.report, tolerance=models.tolerance)
    start = models.best[models.held_bones].model.with_restarted_support()
    schedule = partial(merge_and_polish, steps=_POLISH)
    found.attempt(most, schedule, "affine", start=start, until=0.0)
    if found.fewest is not None:
        yield frames, found.best[most].model
        fewest_bones(found, Bounds(bounds.least, most, 0), effort)
        polish_fewest(found, effort)
        yield frames, found.best[found.held_bones].model


def _with_shapes(
    models: ModelsByBones, tolerance: float, bone: float
) -> tuple[SolvedFrames, Model, Pruned] | None:
    """Replace bones by shapes, if these take fewer bytes than the bones' keys, and drop keys.

    Returns the frames, the model before it gets shapes, and the result with its prunings; or None
    if shapes do not pay or the result misses the tolerance.
    """
    frames, problem, held = models.frames, models.frames.problem, models.held_bones
    # bones, each of so many bytes, that a shape has to replace; one alone is not worth the trial
    each = (12 * problem.inputs[0].n_vertices + 4 * problem.n_frames) / bone
    if (
        held - 1 < 2 * each
        or frames.measure == "max"
        or problem.rig != "none"
        or problem.constraints.rest
    ):
        return None
    if 1 not in models.best:
        models.attempt(1, start_and_polish, "a bone for shapes")
    fewer = sorted(b for b in models.best if held - b >= each)
    truth = np.concatenate([s.frames(slice(None)) for s in problem.inputs]).astype(np.float64)
    limit, needed = _SHAPED * tolerance, {}
    for bones in (1, fewer[len(fewer) // 2], fewer[-1]):
        skinning = frames.skinning(models.best[bones].model)
        errors = components(skinning, truth - skinning.skin(dtype=np.float64))[1]
        needed[bones] = bones + each * (1 + int((errors > limit).sum()))
    bones = min(needed, key=lambda b: needed[b])
    if needed[bones] > held:
        return None
    found = shapes_within(truth, frames.skinning(models.best[bones].model), limit)
    if frames.error_of_all(found.skinning) > tolerance:
        return None
    tracks = Tracks(found.skinning, problem.offsets)
    fewer_keys = tracks.sparsest(tolerance, lambda s: frames.error_of_all(s) <= tolerance)
    return frames, models.best[bones].model, (fewer_keys or found.skinning, [])
