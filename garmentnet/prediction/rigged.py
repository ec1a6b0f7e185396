"""A predicted garment as a skinned model of body joints, virtual bones and morph targets."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr import Skinning
from ssdr.errors import InputError
from ssdr.io.gltf.shapes import Shapes

from ..data.skeleton import Skeleton
from ..io.files import writing
from .output import rigid
from .prediction import Prediction

__all__ = ["Rigged", "rigged", "save_rigged"]

# Singular values of a blended transform below this part of its largest are not inverted: a vertex
# whose bones turn against each other is then moved less.
_FLAT = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class Rigged:
    """A skinned garment with morph targets.

    Attributes
    ----------
    skinning : Skinning
        Its first bones are the body's joints, with their hierarchy; the virtual bones hang on the
        first of them.
    shapes : Shapes
        Principal components of what skinning leaves of the prediction; each goes from 0 to 1.
    error, still : float
        RMSE of the vertices, metres, and where the morph targets keep their mean.
    """

    skinning: Skinning
    shapes: Shapes
    error: float
    still: float


def rigged(prediction: Prediction, skeleton: Skeleton, *, shapes: int = 8) -> Rigged:
    """A prediction as skin weights, joints and a few morph targets.

    What the virtual bones leave of each frame is taken back through the blended transform of each
    vertex, so that adding it before skinning gives the prediction; its mean goes into the rest
    pose, and its principal components over the frames become the targets, whose least amounts are
    in the rest pose, too.

    Parameters
    ----------
    prediction : Prediction
    skeleton : Skeleton
        Of the body.
    shapes : int
        Largest number of morph targets.

    Raises
    ------
    InputError
        If `shapes` is below 1.
    """
    if shapes < 1:
        raise InputError("shapes", "1 or more", shapes)
    model = _on_skeleton(rigid(prediction.skinning), prediction.joints, skeleton)
    truth = np.asarray(prediction.cloth.vertices)
    left = np.empty(truth.shape, np.float32)
    weights = model.sparse_weights()
    for f, transforms in enumerate(model.transforms):
        blend = (weights @ transforms.reshape(-1, 12)).reshape(-1, 3, 4)
        back = np.linalg.pinv(blend[..., :3], rcond=_FLAT)
        gap = truth[f] - blend[..., 3] - (blend[..., :3] @ model.rest[..., None])[..., 0]
        left[f] = (back @ gap[..., None])[..., 0]
    mean = left.mean(axis=0)
    moved, amounts = _components((left - mean).reshape(len(left), -1), shapes)
    low, span = amounts.min(axis=0), np.maximum(np.ptp(amounts, axis=0), 1e-12)
    model = dataclasses.replace(model, rest=model.rest + mean + (low @ moved).reshape(mean.shape))
    amounts = (amounts - low) / span
    found = Shapes((span[:, None] * moved).reshape(-1, *mean.shape), amounts)
    still = np.broadcast_to(amounts.mean(axis=0), amounts.shape)
    errors = (_error(model, found.displacements, a, truth) for a in (amounts, still))
    return Rigged(model, found, *errors)


def save_rigged(model: Rigged, path: Path | str) -> str:
    """Write a ``.glb`` or ``.gltf`` and return what was written, for the user.

    Raises
    ------
    SsdrError
        If the file cannot be written.
    """
    file = Path(path)
    with writing(file):
        report = ssdr.save(model.skinning, file, shapes=model.shapes)
    return (
        f"{model.skinning.n_bones} joints, {len(model.shapes.displacements)} morph targets, "
        f"{model.skinning.n_frames} frames, {report.bytes / 1e6:.1f} MB; RMSE to the prediction "
        f"{1e3 * model.error:.2f} mm, with the targets still {1e3 * model.still:.2f} mm"
    )


def _on_skeleton(model: Skinning, joints: NDArray[np.float64], skeleton: Skeleton) -> Skinning:
    # Before: virtual bones and those joints that carry vertices.  After: all joints first.
    names = model.names()
    virtual = [k for k, name in enumerate(names) if name not in skeleton.names]
    order = {name: k for k, name in enumerate((*skeleton.names, *(names[k] for k in virtual)))}
    number = np.array([order[name] for name in names])
    return dataclasses.replace(
        model,
        indices=number[model.indices],
        transforms=np.concatenate([joints, model.transforms[:, virtual]], axis=1),
        bone_names=tuple(order),
        parents=np.concatenate([skeleton.parents, np.zeros(len(virtual), np.int32)]),
        joint_positions=np.concatenate([skeleton.rest, model.centroids()[virtual]]),
    )


def _components(
    rows: NDArray[np.float32], count: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    # Principal components (M, N) of rows (F, N) whose mean is 0, and amounts (F, M).  By the rows'
    # products, since they are longer than many.
    vectors = np.linalg.eigh((rows @ rows.T).astype(np.float64))[1][:, ::-1]
    amounts = vectors[:, :count].astype(np.float32)
    return amounts.T @ rows, amounts


def _error(
    model: Skinning,
    moved: NDArray[np.floating],
    amounts: NDArray[np.floating],
    truth: NDArray[np.float32],
) -> float:
    total = 0.0
    for f, transforms in enumerate(model.transforms):
        rest = model.rest + np.tensordot(amounts[f], moved, 1)
        v = ssdr.skin(rest, model.indices, model.weights, transforms[None])[0]
        total += float(((v - truth[f]) ** 2).sum(-1).mean())
    return float(np.sqrt(total / len(truth)))
