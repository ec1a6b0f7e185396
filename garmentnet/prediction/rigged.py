"""Conversion of a prediction to a skinned model of body joints, virtual bones and morph targets."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr import ShapedSkinning, Skinning
from ssdr.common.errors import InputError

from ..data.skeleton import Skeleton
from ..io.files import writing
from .morph_targets import with_morph_targets
from .output import rigid
from .prediction import Prediction


@dataclasses.dataclass(frozen=True, eq=False)
class Rigged:
    """A skinned garment with morph targets.

    Attributes
    ----------
    skinning : ShapedSkinning
        The body's joints with their hierarchy, followed by the virtual bones as children of the
        first joint.  Its shapes, with amounts from 0 to 1, are what the skinned mesh lacks.
    error, still : float
        RMSE of the vertices, metres; and the same if the morph targets keep their mean amounts.
    """

    skinning: ShapedSkinning
    error: float
    still: float


def rigged(prediction: Prediction, skeleton: Skeleton, *, shapes: int = 8) -> Rigged:
    """Skinned model of a prediction with a few morph targets.

    They are principal components of what the skinned mesh lacks, mapped back to the rest pose and
    improved in turns with their amounts.  The rest pose may move.

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
    bones = _on_skeleton(rigid(prediction.skinning), prediction.joints, skeleton)
    truth = np.asarray(prediction.cloth.vertices, np.float64)
    model = with_morph_targets(bones, truth, shapes)
    moved = model.shapes
    still = np.broadcast_to(moved.amounts.mean(axis=0), moved.amounts.shape)
    stiff = dataclasses.replace(model, shapes=dataclasses.replace(moved, amounts=still))
    both = (ssdr.metrics.distances(truth, x).rmse for x in (model, stiff))
    return Rigged(model, *both)


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
        f"{model.skinning.skinning.n_bones} joints, {len(model.skinning.shapes)} morph targets, "
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
