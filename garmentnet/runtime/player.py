"""Playback of a garment at any frame rate, with teleports and pauses of the body."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssdr.common.errors import InputError

from ..data.parameters import SimulationParameters
from .garment import LiveGarment, LiveState

# Fraction of a network's frame; times that differ by less count as equal.
_SAME = 1e-6


class Player:
    """Player of a garment at another frame rate than that of its network.

    The network runs at its own frame rate, on poses interpolated between the given ones.  For a
    pose between two frames of the network, the next frame is predicted from the pose that the body
    would have then if it kept its speed.  Bones and detail are interpolated linearly between the
    last frame and this predicted one, which is then discarded.  Vertices are placed on the given
    pose, without delay.  At the network's own frame rate they are those of
    :meth:`LiveGarment.step`.

    The garment starts anew, from rest, if the root moves faster than `fastest` or turns faster than
    `spin` (a teleport), or if more than `longest` has passed since the last pose (a pause).

    Parameters
    ----------
    garment : LiveGarment
    dt : float
        Seconds from one pose to the next, unless a call states its own.
    fastest : float
        Largest speed of the root, m/s.
    spin : float
        Largest angular speed of the root, rad/s.
    longest : float
        Longest time between two poses, seconds.

    Raises
    ------
    InputError
        If one of the numbers is not positive and finite.
    """

    def __init__(
        self,
        garment: LiveGarment,
        dt: float = 1 / 60,
        *,
        fastest: float = 15.0,
        spin: float = 40.0,
        longest: float = 0.5,
    ) -> None:
        for name, value in (("dt", dt), ("fastest", fastest), ("spin", spin), ("longest", longest)):
            _check_positive(name, value)
        self.garment, self.dt = garment, dt
        self.fastest, self.spin, self.longest = fastest, spin, longest
        self.reset()

    def reset(self) -> None:
        """Forget all earlier poses: the next pose starts a motion from rest."""
        self._state: Any = None
        self._pose: Any = None
        self._phase = 0.0  # time since the network's last frame, in frames of the network

    def __call__(
        self, pose: Any, parameters: SimulationParameters | None = None, *, dt: float | None = None
    ) -> NDArray[np.float32]:
        """World positions ``(V, 3)``, metres, of the garment on the next pose.

        Parameters
        ----------
        pose : (J, 3, 4) array
            World transforms of the body's joints from its rest pose, metres.
        parameters : SimulationParameters, optional
            Simulation parameters, for a garment that reads them; they may change at any time.
        dt : float, optional
            Seconds since the pose before.

        Raises
        ------
        InputError
            If the pose or `dt` is not valid; such a call has no effect on later ones.
        """
        dt = self.dt if dt is None else dt
        _check_positive("dt", dt)
        g, before, m = self.garment, self._pose, self.garment.checked(pose)
        if before is None or dt > self.longest or self._jumped(m, dt):
            self._state, self._pose, self._phase = g.advance(None, m, parameters), m, 0.0
            return g.vertices(self._state, m)
        step = dt * g.subject.fps
        state, end = self._state, self._phase + step
        for frame in range(1, int(end + _SAME) + 1):
            state = g.advance(state, self._between(m, (frame - self._phase) / step), parameters)
        phase = max(0.0, end - int(end + _SAME))
        shown = state
        if phase > _SAME:
            ahead = self._between(m, 1 + (1 - phase) / step)
            shown = _mixed(state, g.advance(state, ahead, parameters), phase)
        self._state, self._pose, self._phase = state, m, phase
        return g.vertices(shown, m)

    def _jumped(self, m: NDArray[np.float64], dt: float) -> bool:
        a, b, root = self._pose[0], m[0], self.garment.subject.skeleton.rest[0]
        way = (b[:, :3] - a[:, :3]) @ root + b[:, 3] - a[:, 3]
        cosine = (np.trace(a[:, :3].T @ b[:, :3]) - 1) / 2
        turn = np.arccos(np.clip(cosine, -1, 1))
        return bool(np.linalg.norm(way) > self.fastest * dt or turn > self.spin * dt)

    def _between(self, m: NDArray[np.float64], u: float) -> NDArray[np.float64]:
        """Pose at the fraction u of the way from the last pose to `m`; u > 1 extrapolates."""
        if abs(u - 1) < _SAME:
            return m
        a, rest = self._pose, self.garment.subject.skeleton.rest
        turn = Rotation.from_matrix(a[:, :, :3].swapaxes(1, 2) @ m[:, :, :3]).as_rotvec()
        r = a[:, :, :3] @ Rotation.from_rotvec(u * turn).as_matrix()
        heads = [(x[:, :, :3] @ rest[..., None])[..., 0] + x[:, :, 3] for x in (a, m)]
        shift = heads[0] + u * (heads[1] - heads[0]) - (r @ rest[..., None])[..., 0]
        return np.concatenate([r, shift[..., None]], axis=2)


def _mixed(a: LiveState, b: LiveState, u: float) -> LiveState:
    w = np.float32(u)
    detail = tuple(x + w * (y - x) for x, y in zip(a.detail, b.detail, strict=True))
    return dataclasses.replace(b, bones=a.bones + w * (b.bones - a.bones), detail=detail)


def _check_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise InputError(name, "a positive, finite number", value)
