"""Models that are posed by weights of their expressions."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .checks import check_floats
from .clips import Clip
from .errors import InputError
from .skinning import Skinning, check_skinning

_AT_REST = 1e-5  # largest deviation from the identity of a bone at rest


def drive(skinning: Any, weights: Any) -> Skinning:
    """Pose a model by weights c of its expressions.

    Bone j becomes I + Σ_k c_k N_kj, where I + N_kj is its transform in expression k. The amounts of
    the shapes are summed with the same weights.

    Parameters
    ----------
    skinning : Skinning, or a result that has one
        A model with a clip of two frames for each expression, the first of them at rest.
    weights : (F, S) array
        Weight of each of the S expressions, in the order of the clips, in every frame.

    Returns
    -------
    Skinning
        One clip of F frames, whose bones are affine.

    Raises
    ------
    InputError
        If the model has no such clips, or the weights do not match.

    Examples
    --------
    >>> rest = ssdr.samples.load("dancer_small").vertices[0]
    >>> face = ssdr.decompose_expressions(rest, [rest + 1, rest - 1], bones=1)
    >>> still = ssdr.drive(face, [[1, 1], [0, 0]]).skin()
    >>> np.allclose(still[0], rest, atol=1e-5), np.array_equal(still[1], rest)
    (True, True)
    """
    model = check_skinning(skinning)
    if not is_driven(model):
        wanted = "a clip of two frames for each expression, the first of them the rest pose"
        raise InputError("skinning", wanted, f"{len(model.clips)} clips of {model.n_frames} frames")
    factors = check_floats(weights, "weights", ("F", len(model.clips)))
    moves = np.asarray(model.transforms, dtype=np.float64)
    identity = np.eye(3, 4)
    moves = identity + np.tensordot(factors, moves[1::2] - identity, 1)
    shapes = model.shapes
    if shapes is not None:
        shapes = dataclasses.replace(shapes, amounts=factors @ shapes.amounts[1::2])
    return dataclasses.replace(
        model,
        transforms=moves,
        shapes=shapes,
        keyframes=None,
        bone_model="affine",
        clips=(Clip("driven", 0, len(moves), model.fps),),
    )


def is_driven(model: Skinning) -> bool:
    """Whether each clip of a model has two frames, of which the first is the rest pose."""
    still = all(clip.n_frames == 2 for clip in model.clips)
    still = still and bool(np.abs(model.transforms[::2] - np.eye(3, 4)).max() <= _AT_REST)
    return still and (model.shapes is None or not model.shapes.amounts[::2].any())
