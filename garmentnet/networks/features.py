"""Pose features: a network's input, and the moving frame of its output.

Features depend only on past frames, through a state that each call returns for the next.  So a
motion has the same features whether it is read at once, in parts or frame by frame.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError

from ..configs.config import FeatureOptions
from ..data.skeleton import Skeleton, check_joints
from .pose_kernels import pose_features

Array = NDArray[np.float64]
# Moving frames of the output, in the order of their numbers in the kernels.
FRAMES = ("world", "root", "heading")


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
        self.skeleton, self.options, self.fps, o = skeleton, options, float(fps), options
        self.read = np.array(skeleton.read(o.joints), np.int64)
        self._parents = skeleton.parents.astype(np.int64)
        self._code = len(self.read) * (3 if o.rotation == "vector" else 6)
        self._options = (
            o.rotation == "sixd", o.heading_free, o.translation, o.velocities, o.root_motion
        )  # fmt: skip
        self._frame = FRAMES.index(o.frame)

    @property
    def size(self) -> int:
        """Number of features."""
        o = self.options
        return self._code * (1 + o.velocities) + 3 * o.translation + 12 * o.root_motion

    @property
    def state_size(self) -> int:
        """Numbers of a state, as :mod:`garmentnet.networks.pose_kernels` describes it."""
        return 18 + self._code

    def __call__(self, joints: Any, state: Array | None = None) -> tuple[Array, Array, Array]:
        """Features of consecutive frames.

        Parameters
        ----------
        joints : (F, J, 3, 4) array
            World transforms from the body's rest pose.
        state : (n,) array, optional
            State after the frame before; None if the motion starts here, from rest.

        Returns
        -------
        features : (F, D) float64
        frame : (F, 3, 4) float64
            Transforms from the moving frame to the world.
        state : (n,) float64
            State after the last frame.

        Raises
        ------
        InputError
            If a shape does not fit, a number is not finite or a joint not rigid.
        """
        return self.of(check_joints(joints, self.skeleton.n_joints), state)

    def of(self, joints: Array, state: Array | None) -> tuple[Array, Array, Array]:
        """As a call, for joints that are known to be those of the body and rigid."""
        n, begins = len(joints), state is None
        states, out = np.empty((n, self.state_size)), np.empty((n, self.size))
        frames, before = np.empty((n, 3, 4)), states[0] if state is None else state
        pose_features(
            np.ascontiguousarray(joints), self.skeleton.rest, self._parents, self.read,
            self._options, self._frame, self.fps, begins, before, states, out, frames,
        )  # fmt: skip
        return out, frames, states[-1].copy()


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

    def inputs(self, features: Array, parameters: Any = None) -> NDArray[np.float32]:
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
        x = self.normaliser(features)
        if not self.condition:
            return x
        if parameters is None:
            raise InputError("parameters", "the simulation's, which this network reads", None)
        row = np.asarray(parameters, np.float32)
        return np.concatenate([x, np.broadcast_to(row, (len(x), len(row)))], axis=1)


def transforms_in_frame(transforms: Any, frame: Array) -> Array:
    """World transforms ``(F, J, 3, 4)`` relative to a moving frame ``(F, 3, 4)``.

    Examples
    --------
    >>> frame = np.eye(3, 4)[None] + [0, 0, 0, 1]
    >>> transforms_in_frame(np.eye(3, 4)[None, None], frame)[0, 0, :, 3].tolist()
    [-1.0, -1.0, -1.0]
    """
    return relative(transforms, frame[:, None])


def relative(transforms: Any, base: Array) -> Array:
    """Transforms M ``(..., 3, 4)`` relative to rigid ones J, which broadcast: N with M = J N."""
    m = np.array(transforms, np.float64)
    m[..., 3] -= base[..., 3]
    moved: Array = base[..., :3].swapaxes(-1, -2) @ m
    return moved
