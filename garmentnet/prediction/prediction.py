"""The garment that a checkpoint predicts for a motion."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.errors import InputError, SsdrWarning
from ssdr.skinning import BoneModel

from ..collision.push_out import PushOut
from ..data.parameters import RANGES, SimulationParameters
from ..data.subject import Subject
from ..networks.checkpoint import Checkpoint

__all__ = ["Prediction", "predict", "trained_range"]

# Relative; parameters that are read from a file may be rounded.
_ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """A predicted garment on its body.

    Attributes
    ----------
    cloth, body : MeshSequence
    skinning : Skinning
        The low-frequency part: the virtual bones with their transforms in the world, and behind
        them the joints of the body that carry vertices.
    joints : (F, J, 3, 4) array
    root : (F, 3) array
        Positions of the root joint, metres.
    extrapolated : tuple of str
        A sentence for every parameter outside the trained range.
    moved : float
        Fraction of the cloth's vertices that were moved out of the body or along with those that
        were, over all frames.
    farthest : float
        The longest way that one was moved, metres.

    The push-out changes `cloth` alone, not `skinning`.
    """

    cloth: MeshSequence
    body: MeshSequence
    skinning: Skinning
    joints: NDArray[np.float64]
    root: NDArray[np.float64]
    extrapolated: tuple[str, ...]
    moved: float = 0.0
    farthest: float = 0.0


def predict(
    checkpoint: Checkpoint,
    joints: Any,
    parameters: SimulationParameters | None = None,
    *,
    detail: bool = True,
    push_out: bool = True,
    name: str = "prediction",
) -> Prediction:
    """The garment that a checkpoint predicts for a motion of its body.

    Parameters
    ----------
    checkpoint : Checkpoint
    joints : (F, J, 3, 4) array
        World transforms from the body's rest pose, at the checkpoint's frame rate.
    parameters : SimulationParameters, optional
        Needed by an ensemble and by a network that reads them; any other network has its own
        and accepts no others.
    detail : bool
        Whether to run the high-frequency module.
    push_out : bool
        Whether to move vertices that lie inside the body out of it; see
        :class:`~garmentnet.collision.push_out.PushOut`.

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
    several = checkpoint.kernel is not None or checkpoint.networks[0].condition
    trained_on = checkpoint.parameters[0]
    if not several and None not in (parameters, trained_on) and parameters != trained_on:
        expected = f"those of this single network, {trained_on} (an ensemble takes any)"
        raise InputError("parameters", expected, parameters)
    beyond: tuple[str, ...] = ()
    if several and parameters is not None:
        beyond = _beyond(checkpoint, parameters)
        if beyond:
            text = "; ".join(beyond)
            warnings.warn(f"extrapolated: {text}", SsdrWarning, stacklevel=2)
    motions = checkpoint.motions(joints, parameters, detail=detail)
    subject, m = checkpoint.subject, np.asarray(joints, np.float64)
    garment, rig = subject.garment, subject.body
    cloth = np.concatenate([part.vertices() for part in motions])
    transforms = np.concatenate([part.world_transforms() for part in motions])
    moved, farthest = 0.0, 0.0
    if push_out:
        held = np.zeros(garment.n_vertices, bool)
        if subject.bound is not None:
            held[subject.bound.index] = True
        push = PushOut(rig, garment.faces, pinned=held, n_vertices=garment.n_vertices)
        pushed = push(cloth, m)
        cloth, moved, farthest = pushed.vertices, pushed.moved, pushed.farthest
    body = np.asarray(ssdr.skin(rig.rest, rig.indices, rig.weights, m), np.float32)
    return Prediction(
        cloth=MeshSequence(cloth, garment.faces, subject.fps, name=name),
        body=MeshSequence(body, rig.faces, subject.fps, name="body"),
        skinning=_skinning(subject, transforms, m, "affine" if several else "rigid", name),
        joints=m,
        root=subject.skeleton.positions(m)[:, 0],
        extrapolated=beyond,
        moved=moved,
        farthest=farthest,
    )


def _skinning(
    subject: Subject,
    transforms: NDArray[np.float64],
    joints: NDArray[np.float64],
    bone_model: BoneModel,
    name: str,
) -> Skinning:
    garment, bound = subject.garment, subject.bound
    rest, bones, weights = garment.rest, garment.indices, garment.weights
    names = [f"virtual_{b:02d}" for b in range(garment.n_bones)]
    if bound is not None:
        used = np.unique(bound.indices)
        width = max(bones.shape[1], bound.indices.shape[1])
        bones, weights, rest = (np.array(x) for x in (bones, weights, rest))
        pad = ((0, 0), (0, width - bones.shape[1]))
        bones, weights = np.pad(bones, pad), np.pad(weights, pad)
        bones[bound.index] = weights[bound.index] = 0
        columns = slice(0, bound.indices.shape[1])
        bones[bound.index, columns] = garment.n_bones + np.searchsorted(used, bound.indices)
        weights[bound.index, columns] = bound.weights
        rest[bound.index] = bound.smooth
        transforms = np.concatenate([transforms, joints[:, used]], axis=1)
        names += [subject.skeleton.names[j] for j in used]
    return Skinning(
        rest,
        bones,
        weights,
        transforms,
        faces=garment.faces,
        fps=subject.fps,
        bone_model=bone_model,
        bone_names=tuple(names),
        name=name,
    )


def trained_range(checkpoint: Checkpoint) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of every parameter among the networks; empty if unknown."""
    known = [dataclasses.asdict(p) for p in checkpoint.parameters if p is not None]
    if not known:
        return {}
    return {k: (min(p[k] for p in known), max(p[k] for p in known)) for k in known[0]}


def _beyond(checkpoint: Checkpoint, parameters: SimulationParameters) -> tuple[str, ...]:
    limits = trained_range(checkpoint)
    messages = []
    if not limits:  # a network that reads parameters does not know its training sets
        for key in parameters.outside():
            low, high = RANGES[key]
            messages.append(f"{key} {getattr(parameters, key):g}, meant for {low:g} to {high:g}")
        return tuple(messages)
    for key, value in dataclasses.asdict(parameters).items():
        low, high = limits[key]
        if not low * (1 - _ROUNDING) <= value <= high * (1 + _ROUNDING):
            messages.append(f"{key} {value:g}, trained from {low:g} to {high:g}")
    return tuple(messages)
