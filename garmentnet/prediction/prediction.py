"""Prediction of the garment for a motion by a checkpoint."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.common.errors import InputError

from ..collision.outward import PushedOut, push_of
from ..data.parameters import SimulationParameters, warn_beyond
from ..io.tables import from_table
from ..networks.checkpoint import Checkpoint


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """A predicted garment on its body.

    Attributes
    ----------
    cloth, body : MeshSequence
    skinning : Skinning
        The low-frequency part: the body's joints with their hierarchy, which move the vertices
        bound to them, followed by the virtual bones as children of the first joint.
    joints : (F, J, 3, 4) array
    root : (F, 3) array
        Positions of the root joint, metres.
    pushed : PushedOut or None
        What the push-out did; None without it.

    The push-out changes `cloth` alone, not `skinning`.
    """

    cloth: MeshSequence
    body: MeshSequence
    skinning: Skinning
    joints: NDArray[np.float64]
    root: NDArray[np.float64]
    pushed: PushedOut | None = None


def chosen_parameters(
    checkpoint: Checkpoint, entered: Mapping[str, Any]
) -> SimulationParameters | None:
    """Parameters for :func:`predict`; None if none is entered and the checkpoint needs none.

    Parameters that are not entered are those of the training, or the defaults for a checkpoint that
    reads parameters.

    Raises
    ------
    InputError
        If one is not positive.
    FormatError
        If one has another name or is no number.
    """
    reads = checkpoint.reads_parameters
    if not entered and not reads:
        return None
    trained_on = None if reads else checkpoint.parameters[0]
    values = dataclasses.asdict(trained_on or SimulationParameters()) | dict(entered)
    return from_table(SimulationParameters, values, file="parameters")


def check_set(checkpoint: Checkpoint, parameters: SimulationParameters | None) -> None:
    """Raise an error if a network of one parameter set is asked for another."""
    trained_on = None if checkpoint.reads_parameters else checkpoint.parameters[0]
    if None not in (parameters, trained_on) and parameters != trained_on:
        expected = f"those of this single network, {trained_on} (an ensemble takes any)"
        raise InputError("parameters", expected, parameters)


def predict(
    checkpoint: Checkpoint,
    joints: Any,
    parameters: SimulationParameters | None = None,
    *,
    detail: bool = True,
    push_out: bool = True,
    name: str = "prediction",
) -> Prediction:
    """Prediction of the garment by a checkpoint, for a motion of its body.

    Parameters
    ----------
    checkpoint : Checkpoint
    joints : (F, J, 3, 4) array
        World transforms from the body's rest pose, at the checkpoint's frame rate.
    parameters : SimulationParameters, optional
        Needed by an ensemble and by a network that reads them; any other network accepts only those
        of its training.
    detail : bool
        Whether to run the high-frequency module.
    push_out : bool
        Whether to move vertices that lie inside the body out of it; see
        :class:`~garmentnet.collision.outward.OutwardPush`.  Without a closed mesh of the body
        none is moved.

    Raises
    ------
    InputError
        If the joints do not fit the body or are not rigid, or the parameters are missing or not
        those of a single network.

    Warns
    -----
    SsdrWarning
        If the parameters lie outside the trained range.
    """
    check_set(checkpoint, parameters)
    motions = checkpoint.motions(joints, parameters, detail=detail)
    if checkpoint.reads_parameters and parameters is not None:
        warn_beyond(parameters, checkpoint.parameters)
    cloth = np.concatenate([part.vertices() for part in motions])
    transforms = np.concatenate([part.world_transforms() for part in motions])
    subject, m = checkpoint.subject, np.asarray(joints, np.float64)
    garment, rig = subject.garment, subject.body
    push, count = push_of(subject) if push_out else None, garment.n_bones
    pushed = push(cloth, m) if push else None
    cloth = pushed.vertices if pushed else cloth
    body = np.asarray(ssdr.skin(rig.rest, rig.indices, rig.weights, m), np.float32)
    rest, bones, weights = subject.skin(smooth=True)
    tree, virtual = subject.skeleton, [f"virtual_{b:02d}" for b in range(count)]
    skinning = Skinning(
        rest,
        np.where(bones < count, bones + tree.n_joints, bones - count),
        weights,
        np.concatenate([m, transforms], axis=1),
        faces=garment.faces,
        fps=subject.fps,
        bone_model="rigid" if checkpoint.kernel is None else "affine",
        bone_names=(*tree.names, *virtual),
        name=name,
        parents=np.concatenate([tree.parents, np.zeros(count, np.int32)]),
        joint_positions=np.concatenate([tree.rest, garment.centroids()]),
    )
    return Prediction(
        cloth=MeshSequence(cloth, garment.faces, subject.fps, name=name),
        body=MeshSequence(body, rig.faces, subject.fps, name="body"),
        skinning=skinning,
        joints=m,
        root=tree.positions(m)[:, 0],
        pushed=pushed,
    )
