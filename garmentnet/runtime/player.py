"""Playback of a garment at any frame rate, with teleports and pauses of the body."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssdr.common.errors import InputError

from ..data.parameters import SimulationParameters
from ..data.skeleton import check_joints
from .garment import LiveGarment

# Fraction of a network's frame; times that differ by less count as equal.
_SAME = 1e-6
Array = NDArray[np.float64]


class Player:
    """Player of a garment at another frame rate than that of its network.

    The network runs at its own frame rate, on poses interpolated between the given ones.  For a
    pose between two frames of the network, the next frame is predicted from the pose that the body
    would have then if it kept its speed, and discarded.  Vertices lie between those of the two
    frames, seen from the root and its heading, and are placed on the given pose, without delay.  At
    the network's own frame rate they are those of :meth:`LiveGarment.step`.

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
        self._pose: Any = None
        self._frame: Any = None  # state, vertices and pose of the network's last frame
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
        g, frame = self.garment, self._frame
        m = check_joints(np.asarray(pose)[None], g.skeleton.n_joints)[0]
        if frame is None or dt > self.longest or self._jumped(m, dt):
            frame = (*g.step(None, m, parameters), m)
            self._frame, self._pose, self._phase = frame, m, 0.0
            return frame[1]
        step = dt * g.fps
        end = self._phase + step
        for k in range(1, int(end + _SAME) + 1):
            between = self._between(m, (k - self._phase) / step)
            frame = (*g.step(frame[0], between, parameters), between)
        phase, vertices = max(0.0, end - int(end + _SAME)), frame[1]
        if phase > _SAME:
            ahead = self._between(m, 1 + (1 - phase) / step)
            _, other = g.step(frame[0], ahead, parameters)
            seen = self._seen(frame[1], frame[2]), self._seen(other, ahead)
            turn, origin = self._root(m)
            vertices = ((1 - phase) * seen[0] + phase * seen[1]) @ turn.T + origin
        self._frame, self._pose, self._phase = frame, m, phase
        return np.asarray(vertices, np.float32)

    def _jumped(self, m: Array, dt: float) -> bool:
        a, b, root = self._pose[0], m[0], self.garment.skeleton.rest[0]
        way = (b[:, :3] - a[:, :3]) @ root + b[:, 3] - a[:, 3]
        cosine = (np.trace(a[:, :3].T @ b[:, :3]) - 1) / 2
        turn = np.arccos(np.clip(cosine, -1, 1))
        return bool(np.linalg.norm(way) > self.fastest * dt or turn > self.spin * dt)

    def _between(self, m: Array, u: float) -> Array:
        """Pose at the fraction u of the way from the last pose to `m`; u > 1 extrapolates."""
        if abs(u - 1) < _SAME:
            return m
        a, rest = self._pose, self.garment.skeleton.rest
        turn = Rotation.from_matrix(a[:, :, :3].swapaxes(1, 2) @ m[:, :, :3]).as_rotvec()
        r = a[:, :, :3] @ Rotation.from_rotvec(u * turn).as_matrix()
        heads = [(x[:, :, :3] @ rest[..., None])[..., 0] + x[:, :, 3] for x in (a, m)]
        shift = heads[0] + u * (heads[1] - heads[0]) - (r @ rest[..., None])[..., 0]
        return np.concatenate([r, shift[..., None]], axis=2)

    def _root(self, pose: Array) -> tuple[Array, Array]:
        """Heading (3, 3) and place (3,) of the root."""
        r = pose[0, :, :3]
        turn = Rotation.from_euler("y", np.arctan2(r[0, 2] - r[2, 0], r[0, 0] + r[2, 2]))
        return turn.as_matrix(), r @ self.garment.skeleton.rest[0] + pose[0, :, 3]

    def _seen(self, vertices: Any, pose: Array) -> Array:
        turn, origin = self._root(pose)
        return np.asarray((vertices - origin) @ turn)


def _check_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise InputError(name, "a positive, finite number", value)
