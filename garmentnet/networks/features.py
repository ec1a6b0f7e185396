"""Pose features: a network's input, and the moving frame of its output.

Features depend only on past frames, through a state that each call returns for the next.  So a
motion has the same features whether it is read at once, in parts or frame by frame.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from ssdr.errors import InputError
from ssdr.rigid import sixd_from_matrix

from ..configs.config import FeatureOptions
from ..data.skeleton import Skeleton, check_joints

__all__ = ["Normaliser", "PoseFeatures", "PoseReader", "PoseState", "transforms_in_frame"]

Array = NDArray[np.float64]
# Length of the twist's sine and cosine, at most 2, below which the body is upside down.
_UPSIDE_DOWN = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class PoseState:
    """State of earlier frames from which the next features are computed; positions in metres."""

    first: Array
    position: Array
    velocity: Array
    rotation: Array  # of the root, in the world
    pose: Array  # features of the rotations, for their velocities


class PoseFeatures:
    """Features of a pose, and the moving frame in which the network predicts.

    Parameters
    ----------
    skeleton : Skeleton
    options : FeatureOptions
    fps : float

    Raises
    ------
    InputError
        If the options name a joint that the skeleton does not have.

    Examples
    --------
    >>> body = Skeleton(("root",), [-1], [[0, 1, 0]])
    >>> features = PoseFeatures(body, FeatureOptions(), fps=30)
    >>> x, frame, state = features(np.tile(np.eye(3, 4), (5, 1, 1, 1)))
    >>> x.shape, features.size, frame.shape
    ((5, 6), 6, (5, 3, 4))
    """

    def __init__(self, skeleton: Skeleton, options: FeatureOptions, fps: float) -> None:
        self.skeleton, self.options, self.fps = skeleton, options, float(fps)
        self._read = skeleton.read(options.joints)

    @property
    def size(self) -> int:
        """Number of features."""
        o, n = self.options, len(self._read)
        each = 3 if o.rotation == "vector" else 6
        pose = n * each
        return pose + (pose if o.velocities else 0) + 3 * o.translation + 12 * o.root_motion

    def __call__(
        self, joints: Any, state: PoseState | None = None
    ) -> tuple[Array, Array, PoseState]:
        """Features of consecutive frames.

        Parameters
        ----------
        joints : (F, J, 3, 4) array
            World transforms from the body's rest pose.
        state : PoseState, optional
            State after the frame before; None if the motion starts here, from rest.

        Returns
        -------
        features : (F, D) float64
        frame : (F, 3, 4) float64
            Transforms from the moving frame to the world.
        state : PoseState
            State after the last frame.

        Raises
        ------
        InputError
            If a shape does not fit or a number is not finite.
        """
        o = self.options
        m = check_joints(joints, self.skeleton.n_joints)
        position, relative = self.skeleton.pose(m)
        root = relative[:, 0].copy()
        heading = _heading(root)
        if o.heading_free:
            relative[:, 0] = np.einsum("fba,fbc->fac", heading, root)
        pose = _code(relative[:, self._read], o.rotation)
        if state is None:
            zero = np.zeros(3)
            state = PoseState(position[0], position[0], zero, root[0], pose[0])
        parts = [pose]
        if o.translation:
            parts.insert(0, position - state.first)
        if o.velocities:
            parts.append((pose - np.concatenate([state.pose[None], pose[:-1]])) * self.fps)
        before = np.concatenate([state.position[None], position[:-1]])
        velocity = (position - before) * self.fps
        if o.root_motion:
            change = velocity - np.concatenate([state.velocity[None], velocity[:-1]])
            turn = root @ np.concatenate([state.rotation[None], root[:-1]]).transpose(0, 2, 1)
            spin = Rotation.from_matrix(turn).as_rotvec() * self.fps
            local = [np.einsum("fba,fb->fa", heading, x) for x in (velocity, change, spin)]
            parts += [local[0], local[1] * self.fps, local[2], local[2] ** 2]
        frame = np.zeros((len(m), 3, 4))
        frame[:, :, :3] = np.eye(3)
        if o.frame != "world":
            frame[:, :, :3] = root if o.frame == "root" else heading
            frame[:, :, 3] = position
        new = PoseState(state.first, position[-1], velocity[-1], root[-1], pose[-1])
        return np.concatenate(parts, axis=1), frame, new


@dataclasses.dataclass(frozen=True, eq=False)
class Normaliser:
    """Scaling of features to zero mean and unit deviation.

    Attributes
    ----------
    mean, deviation : (D,) float64
    clamp : float
        Bound of the absolute value of a scaled feature; 0: no bound.

    Examples
    --------
    >>> normaliser = Normaliser.fit([np.array([[0.0], [2.0]])], floor=0.1, clamp=5.0)
    >>> normaliser(np.array([[2.0], [90.0]])).tolist()
    [[1.0], [5.0]]
    """

    mean: Array
    deviation: Array
    clamp: float

    @classmethod
    def fit(cls, features: Iterable[Array], *, floor: float, clamp: float) -> Normaliser:
        """Scaling by the mean and deviation over all frames; deviations are at least `floor`.

        A feature that hardly changes in training would otherwise become huge on a motion where
        it does.
        """
        count = 0
        first: Any = 0.0
        total: Any = 0.0
        square: Any = 0.0
        for f in features:
            # Relative to the first frame: the difference of large sums would lose digits.
            first = f[0] if count == 0 else first
            count, total = count + len(f), total + (f - first).sum(axis=0)
            square = square + ((f - first) ** 2).sum(axis=0)
        mean = total / count
        square, mean = square / count - mean**2, first + mean
        deviation = np.sqrt(np.maximum(square, 0.0))
        deviation = np.maximum(deviation, floor)
        return cls(mean, np.where(deviation > 0, deviation, 1.0), clamp)

    def __call__(self, features: Array) -> NDArray[np.float32]:
        z = (features - self.mean) / self.deviation
        return (z if self.clamp <= 0 else z.clip(-self.clamp, self.clamp)).astype(np.float32)


class PoseReader:
    """Input of a network: normalised pose features and, if it reads them, simulation parameters.

    Parameters
    ----------
    features : PoseFeatures
    normaliser : Normaliser
    condition : int
        Number of simulation parameters that the network reads, which may be 0.
    """

    def __init__(self, features: PoseFeatures, normaliser: Normaliser, condition: int = 0) -> None:
        self.features, self.normaliser, self.condition = features, normaliser, condition

    @property
    def size(self) -> int:
        """Number of inputs per frame."""
        return self.features.size + self.condition

    def inputs(self, features: Array, parameters: Any = None) -> Tensor:
        """Normalised features ``(F, D)``, with the parameters for a network that reads them.

        Parameters
        ----------
        features : (F, D)
        parameters : (3,) array, optional
            Normalised simulation parameters.

        Raises
        ------
        InputError
            If the network reads parameters and there are none.
        """
        x = torch.from_numpy(self.normaliser(features))
        if self.condition:
            if parameters is None:
                raise InputError("parameters", "the simulation's, which this network reads", None)
            row = torch.as_tensor(np.asarray(parameters, np.float32))
            x = torch.cat([x, row.expand(len(x), -1)], dim=1)
        return x


def transforms_in_frame(transforms: Any, frame: Array) -> Array:
    """World transforms ``(F, J, 3, 4)`` relative to a moving frame ``(F, 3, 4)``.

    Examples
    --------
    >>> frame = np.eye(3, 4)[None] + [0, 0, 0, 1]
    >>> transforms_in_frame(np.eye(3, 4)[None, None], frame)[0, 0, :, 3].tolist()
    [-1.0, -1.0, -1.0]
    """
    m = np.array(transforms, np.float64)
    m[..., 3] -= frame[:, None, :, 3]
    moved: Array = frame[:, None, :, :3].swapaxes(-1, -2) @ m
    return moved


def _heading(root: Array) -> Array:
    # The twist about y of the swing–twist decomposition: unlike the direction of the z axis seen
    # from above it is defined until the body is upside down.
    s, c = root[:, 0, 2] - root[:, 2, 0], root[:, 0, 0] + root[:, 2, 2]
    size = np.hypot(s, c)
    s = np.divide(s, size, out=np.zeros_like(s), where=size > _UPSIDE_DOWN)
    c = np.divide(c, size, out=np.ones_like(c), where=size > _UPSIDE_DOWN)
    o = np.zeros_like(s)
    return np.stack([c, o, s, o, o + 1, o, -s, o, c], axis=-1).reshape(-1, 3, 3)


def _code(rotation: Array, kind: str) -> Array:
    n = len(rotation)
    if kind == "vector":
        return Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec().reshape(n, -1)
    return np.asarray(sixd_from_matrix(rotation)).reshape(n, -1)
