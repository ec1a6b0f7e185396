"""A garment played at any frame rate, through teleports and pauses."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssdr.errors import InputError

from ..data.parameters import SimulationParameters
from .garment import LiveGarment, LiveState

__all__ = ["Player"]

# Of a network's frame; times that differ by less are the same.
_SAME = 1e-6


class Player:
    """Plays a garment at frames of another length than the network's.

    The rule: the network runs at its own rate, on poses between the two given ones about each of
    its frames.  Between its frames it also looks ahead, on the pose that the body would have in
    its next frame if it kept its speed, and bones and detail go evenly from the one to the other;
    what is looked ahead is forgotten.  Vertices stand on the pose that is given, without delay,
    and at the network's own rate they are those of :meth:`LiveGarment.step`.

    The garment starts anew, from rest, where the root is faster than `fastest` or turns faster
    than `spin` (a teleport), or a frame is longer than `longest` (a pause).

    Parameters
    ----------
    garment : LiveGarment
    dt : float
        Seconds from pose to pose, unless a call states its own.
    fastest : float
        m/s.
    spin : float
        rad/s.
    longest : float
        Seconds.

    Raises
    ------
    InputError
        If one is not positive and finite.
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
        """Forget the past: the next pose starts a motion."""
        self._state: LiveState | None = None
        self._pose: Any = None
        self._phase = 0.0  # since the network's last frame, in its frames

    def __call__(
        self, pose: Any, parameters: SimulationParameters | None = None, *, dt: float | None = None
    ) -> NDArray[np.float32]:
        """World positions ``(V, 3)``, metres, of the garment on the next pose.

        Parameters
        ----------
        pose : (J, 3, 4) array
            World transforms of the body's joints from its rest pose, metres.
        parameters : SimulationParameters, optional
            For a garment that reads them; they may change at any time.
        dt : float, optional
            Seconds since the pose before.

        Raises
        ------
        InputError
            If the pose or dt is not as it should be; the player goes on as if it had not come.
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
        assert shown is not None
        return g.vertices(shown, m)

    def _jumped(self, m: NDArray[np.float64], dt: float) -> bool:
        a, b, root = self._pose[0], m[0], self.garment.subject.skeleton.rest[0]
        way = (b[:, :3] - a[:, :3]) @ root + b[:, 3] - a[:, 3]
        cosine = (np.trace(a[:, :3].T @ b[:, :3]) - 1) / 2
        turn = np.arccos(np.clip(cosine, -1, 1))
        return bool(np.linalg.norm(way) > self.fastest * dt or turn > self.spin * dt)

    def _between(self, m: NDArray[np.float64], u: float) -> NDArray[np.float64]:
        """The pose at u from the last one, 0, to this one, 1, or beyond it."""
        if abs(u - 1) < _SAME:
            return m
        a, rest = self._pose, self.garment.subject.skeleton.rest
        turn = Rotation.from_matrix(a[:, :, :3].swapaxes(1, 2) @ m[:, :, :3]).as_rotvec()
        r = a[:, :, :3] @ Rotation.from_rotvec(u * turn).as_matrix()
        heads = [(x[:, :, :3] @ rest[..., None])[..., 0] + x[:, :, 3] for x in (a, m)]
        shift = heads[0] + u * (heads[1] - heads[0]) - (r @ rest[..., None])[..., 0]
        return np.concatenate([r, shift[..., None]], axis=2)


def _mixed(a: LiveState | None, b: LiveState, u: float) -> LiveState:
    assert a is not None
    w = np.float32(u)
    detail = tuple(x + w * (y - x) for x, y in zip(a.detail, b.detail, strict=True))
    return dataclasses.replace(b, bones=a.bones + w * (b.bones - a.bones), detail=detail)


def _check_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise InputError(name, "a positive, finite number", value)
