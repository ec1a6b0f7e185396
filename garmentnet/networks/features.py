"""Pose features of the body motion M_b (paper, section 4.2), and the moving frame of the output.

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
from torch import Tensor

from ssdr.common.errors import InputError

from ..configs.config import FeatureOptions
from ..data.skeleton import Skeleton, check_joints

Array = NDArray[np.float64]
# Features of one frame, without memory, of a body seen from its root and heading.
HEADING = FeatureOptions(
    rotation="sixd", heading_free=True, translation=False, floor=0.01, clamp=5.0, frame="heading"
)
# Length of the twist's sine and cosine, at most 2, below which the body is upside down.
_UPSIDE_DOWN = 1e-12
_TINY = 1e-30  # against a division by 0
# Of a matrix's nine numbers: sine and cosine of its turn about y, and how these make one of nine.
_SINE_COSINE = torch.tensor([[0, 0, 1, 0, 0, 0, -1, 0, 0], [1, 0, 0, 0, 0, 0, 0, 0, 1.0]]).T


class PoseFeatures:
    """Features of a pose, and the moving frame in which the network predicts.

    A state is one row: the root's position in the first frame (3); then of the frame before,
    position and velocity (3 each) of the root, or of all joints whose motion is read, the root's
    rotation (9), and the features of the rotations.

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
        self.read = skeleton.read(options.joints)
        self._above = skeleton.parents[self.read[1:]].tolist()
        self._code = len(self.read) * (3 if options.rotation == "vector" else 6)
        # Joints whose motion is read, the root first.
        self.tracked = self.read if options.joint_motion else self.read[:1]

    @property
    def size(self) -> int:
        """Number of features."""
        o = self.options
        size = self._code * (1 + o.velocities) + 3 * o.translation + 12 * o.root_motion
        return size + 15 * (len(self.tracked) - 1)

    @property
    def state_size(self) -> int:
        """Numbers of a state."""
        return 12 + 6 * len(self.tracked) + self._code

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
        m = torch.tensor(check_joints(joints, self.skeleton.n_joints))
        x, frame, new = self.of(m, None if state is None else torch.tensor(state))
        return x.numpy(), frame.numpy(), new.numpy().copy()

    def of(
        self, m: Tensor, state: Tensor | None, begins: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """As a call, for tensors of rigid joints; where the mask `begins` holds, from rest."""
        o, turns, count = self.options, m[..., :3], len(m)
        root, tracked = turns[:, 0], turns[:, self.tracked]
        heads = torch.as_tensor(self.skeleton.rest[self.tracked], dtype=m.dtype)[..., None]
        places = (tracked @ heads)[..., 0] + m[:, self.tracked, :, 3]
        place = places[:, 0]
        heading, upright = _heading(root), torch.eye(3, dtype=m.dtype).expand(count, 3, 3)
        base = heading if o.heading_free else upright
        above = torch.cat([base[:, None], turns[:, self._above]], dim=1)
        local = above.transpose(-1, -2) @ turns[:, self.read]
        columns = local[..., :2].transpose(-1, -2)
        code = (columns if o.rotation == "sixd" else rotation_vector(local)).flatten(1)
        flat = root.flatten(1)
        # A motion that starts has been at rest in its first pose.
        own = torch.cat([place, places.flatten(1), 0 * places.flatten(1), flat, code], dim=1)
        before = own[0] if state is None else state
        if begins is not None:
            before = torch.where(begins, own[0], before)
        past = torch.cat([before[None], own[:-1]])
        width = 3 * len(self.tracked)
        _, was, _, turned, coded = past.split([3, width, width, 9, self._code], dim=1)
        velocity = (places - was.reshape(places.shape)) * self.fps
        slower = before[3 + width : 3 + 2 * width].reshape(1, *places.shape[1:])
        change = (velocity - torch.cat([slower, velocity[:-1]])) * self.fps
        start = before[None, :3].expand(count, 3)
        last = places.flatten(1), velocity.flatten(1)
        states = torch.cat([start, *last, flat, code], dim=1)
        parts = [place - start] * o.translation + [code]
        if o.velocities:
            parts.append((code - coded) * self.fps)
        if o.root_motion:
            spin = root @ turned.reshape(-1, 3, 3).transpose(-1, -2)
            turning = rotation_vector(spin) * self.fps
            roots = velocity[:, 0], change[:, 0], turning
            seen = [(v[:, None] @ heading)[:, 0] for v in roots]
            parts += [*seen, seen[2] ** 2]
        if o.joint_motion:
            moves = places - place[:, None], velocity, change
            parts += [(v[:, 1:] @ heading).flatten(1) for v in moves]
            columns = (heading.transpose(-1, -2)[:, None] @ tracked[:, 1:])[..., :2]
            parts.append(columns.transpose(-1, -2).flatten(1))
        turn = {"world": upright, "root": root, "heading": heading}[o.frame]
        origin = torch.zeros_like(place) if o.frame == "world" else place
        frame = torch.cat([turn, origin[..., None]], dim=-1)
        return torch.cat(parts, dim=1), frame, states[-1]


def _heading(root: Tensor) -> Tensor:
    """Rotations ``(F, 3, 3)`` about y that are nearest to the root's; none if upside down."""
    sums = root.flatten(1) @ _SINE_COSINE.to(root)
    size = sums.square().sum(1, keepdim=True).sqrt()
    upright = torch.tensor([0.0, 1.0]).to(root)
    about = torch.where(size > _UPSIDE_DOWN, sums / size.clamp(min=_TINY), upright)
    y = torch.tensor([0.0, 0, 0, 0, 1, 0, 0, 0, 0]).to(root)
    return (about @ _SINE_COSINE.T.to(root) + y).reshape(-1, 3, 3)


def _quaternions(r: Tensor) -> Tensor:
    """Products 4 q qᵀ of the quaternions q of rotations, less the identity: ``(..., 16)``."""
    a, b, c = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    trace = a + b + c
    x, y, z = (r[..., i, j] - r[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    xy, xz, yz = (r[..., i, j] + r[..., j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    rows = [trace, x, y, z, x, 2 * a - trace, xy, xz, y, xy, 2 * b - trace, yz]
    return torch.stack([*rows, z, xz, yz, 2 * c - trace], dim=-1)


# It is linear: one product in place of fifty small steps.
_QUATERNIONS = _quaternions(torch.eye(9).reshape(9, 3, 3))


def rotation_vector(r: Tensor) -> Tensor:
    """Axis times angle ``(..., 3)``, 0 to π, of matrices, by way of the quaternion's largest part.

    Examples
    --------
    >>> rotation_vector(torch.tensor([[[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]])).round(decimals=3)
    tensor([[0.0000, 1.5710, 0.0000]])
    """
    every = r.flatten(-2) @ _QUATERNIONS.to(r) + torch.eye(4).flatten().to(r)
    largest, parts = every[..., ::5].argmax(-1), every.unflatten(-1, (4, 4))
    q = parts.gather(-2, largest[..., None, None].expand(*largest.shape, 1, 4))[..., 0, :]
    w, v = q[..., :1], q[..., 1:]
    sine = v.square().sum(-1, keepdim=True).sqrt()
    angle = 2 * torch.atan(sine / w.abs().clamp(min=_TINY))
    return v * (angle / sine.clamp(min=_TINY)) * torch.where(w < 0, -1.0, 1.0).to(w)


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
        known = [(len(f), f.mean(axis=0), f.var(axis=0)) for f in features]
        count, means, variances = (np.array(column) for column in zip(*known, strict=True))
        mean = np.average(means, axis=0, weights=count)
        spread = np.average(variances + (means - mean) ** 2, axis=0, weights=count)
        deviation = np.maximum(np.sqrt(spread), floor)
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
