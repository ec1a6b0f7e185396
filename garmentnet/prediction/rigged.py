"""Conversion of a prediction to a skinned model of body joints, virtual bones and morph targets."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr import Shapes, Skinning
from ssdr.errors import InputError

from ..data.skeleton import Skeleton
from ..io.files import writing
from .output import rigid
from .prediction import Prediction

# Singular values of a blended transform below this fraction of the largest are not inverted, so
# that morph targets do not move vertices far whose bones turn against each other.
_FLAT = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class Rigged:
    """A skinned garment with morph targets.

    Attributes
    ----------
    skinning : Skinning
        The body's joints with their hierarchy, followed by the virtual bones as children of the
        first joint.  Its shapes are principal components of the difference between the prediction
        and the skinned mesh, with amounts from 0 to 1.
    error, still : float
        RMSE of the vertices, metres; and the same if the morph targets keep their mean amounts.
    """

    skinning: Skinning
    error: float
    still: float


def rigged(prediction: Prediction, skeleton: Skeleton, *, shapes: int = 8) -> Rigged:
    """Skinned model of a prediction with a few morph targets.

    In each frame, the difference between the prediction and the skinned mesh is transformed back
    through the blended transform of each vertex, so that adding it to the rest pose before skinning
    gives the prediction.  Its mean over the frames is added to the rest pose.  Its principal
    components become the morph targets, with amounts shifted so that the smallest is 0.

    Parameters
    ----------
    prediction : Prediction
    skeleton : Skeleton
        Skeleton of the body.
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
    both = (found, dataclasses.replace(found, amounts=still))
    models = [dataclasses.replace(model, shapes=some) for some in both]
    return Rigged(models[0], *(ssdr.metrics.distances(truth, one).rmse for one in models))


def save_rigged(model: Rigged, path: Path | str) -> str:
    """Write a ``.glb`` or ``.gltf``, and return a text for the user that says what was written.

    Raises
    ------
    SsdrError
        If the file cannot be written.
    """
    file = Path(path)
    with writing(file):
        report = ssdr.save(model.skinning, file)
    return (
        f"{model.skinning.n_bones} joints, {model.skinning.n_shapes} morph targets, "
        f"{model.skinning.n_frames} frames, {report.bytes / 1e6:.1f} MB; RMSE to the prediction "
        f"{1e3 * model.error:.2f} mm, with the targets still {1e3 * model.still:.2f} mm"
    )


def _on_skeleton(model: Skinning, joints: NDArray[np.float64], skeleton: Skeleton) -> Skinning:
    # Given: virtual bones, then joints with bound vertices; result: all joints, then virtual bones
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
    # Principal components (M, N) of rows (F, N) whose mean is 0, and amounts (F, M).  They come
    # from the Gram matrix of the rows, since F is much smaller than N.
    vectors = np.linalg.eigh((rows @ rows.T).astype(np.float64))[1][:, ::-1]
    amounts = vectors[:, :count].astype(np.float32)
    return amounts.T @ rows, amounts
