"""Generator of dances: moves are chosen, timed and blended at random, from a seed.

A move gives curves for some control channels (:data:`.puppet.CHANNELS`).
Consecutive moves are blended; arm motion and small random motion are added throughout.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from garmentnet.data.clip import CLASSES
from garmentnet.data.skeleton import Skeleton
from ssdr.common.errors import InputError

from ..motion import Motion
from .moves import MOVES, TEMPI, Controls, Float, smooth
from .puppet import CHANNELS, RATE, pose_joints

DANCE_CLASSES = tuple(MOVES)
_FAST = ("spin", "kick", "squat", "jump", "turn")
_SLOW = ("stand", "walk", "sway", "shift")
# Numbers of classes in a dance, and of fast ones, as half-open ranges.
_COUNT, _FAST_COUNT = (6, 9), (3, 6)
# Probability that a fast move ends in a sudden stop, beside the stops of its classes.
_SUDDEN = 0.25


def dance(
    skeleton: Skeleton,
    *,
    seed: int,
    frames: int = 300,
    fps: float = 30.0,
    classes: Sequence[str] | None = None,
) -> Motion:
    """Generate a dance.

    Parameters
    ----------
    skeleton : Skeleton
        Skeleton of :mod:`benchmarks.garment.scenes.body`.
    seed : int
        Seed of the random numbers; with the same number of frames and frame rate, it gives the
        same dance.
    frames : int
    fps : float
    classes : sequence of str, optional
        Classes of motion, danced once in this order and then at random.  By default six to eight
        are drawn, at least three of them fast.

    Returns
    -------
    Motion

    Raises
    ------
    InputError
        If a class has no move or a number is out of its range.

    Examples
    --------
    >>> from benchmarks.garment.scenes.body import default_body
    >>> spin = dance(default_body().skeleton, seed=1, frames=20, classes=["spin"])
    >>> spin.n_frames, CLASSES[spin.classes[10]]
    (20, 'spin')
    """
    if frames < 1:
        raise InputError("frames", "at least 1", frames)
    if not (math.isfinite(fps) and 1 <= fps <= RATE):
        raise InputError("fps", f"1 to {RATE}", fps)
    rng = np.random.default_rng([int(seed), 0xDA9CE])
    chosen = _chosen(rng) if classes is None else list(classes)
    for c in chosen:
        if c not in MOVES:
            raise InputError("classes", f"some of {', '.join(MOVES)}", c)
    if not chosen:
        raise InputError("classes", "at least one", chosen)
    heading = float(rng.uniform(-math.pi, math.pi))
    seconds = frames / fps
    controls, label = _choreograph(rng, chosen, seconds)
    _add_arms(rng, controls)
    _add_noise(rng, controls)
    joints = pose_joints(skeleton, controls, heading)
    at = np.minimum(np.round(np.arange(frames) * RATE / fps).astype(int), len(joints) - 1)
    return Motion(joints[at], label[at], fps)


def _chosen(rng: np.random.Generator) -> list[str]:
    count = int(rng.integers(*_COUNT))
    n_fast = min(int(rng.integers(*_FAST_COUNT)), count - 2)
    picked = [*rng.permutation(_FAST)[:n_fast], *rng.permutation(_SLOW)[: count - n_fast]]
    if len(picked) < count:
        picked.append("stop")
    return [str(p) for p in rng.permutation(picked)]


def _choreograph(
    rng: np.random.Generator, chosen: list[str], seconds: float
) -> tuple[Controls, NDArray[np.int8]]:
    count = math.ceil(seconds * RATE) + 1
    time = np.arange(count) / RATE
    total = {name: np.zeros(count) for name in CHANNELS}
    weight_sum = np.zeros(count)
    best, label = np.zeros(count), np.zeros(count, dtype=np.int8)
    order, start = list(chosen), -float(rng.uniform(0, 0.5))
    fade_in, last = 0.3, ""
    while start < seconds:
        if not order:
            order = [str(c) for c in rng.permutation(chosen)]
            if len(order) > 1 and order[0] == last:
                order = order[1:] + order[:1]
        if last in _FAST and rng.random() < _SUDDEN:
            order.insert(0, "stop")
        kind = order.pop(0)
        low, high, move = MOVES[kind]
        # Within the move's range, uniform on a logarithmic scale.
        tempo = math.exp(rng.uniform(*np.log(TEMPI[kind]))) if kind in TEMPI else 1.0
        length = float(rng.uniform(low, high)) / tempo
        abrupt = bool(order) and order[0] == "stop"
        # Seconds; a stop must come suddenly.
        fade_out = 0.06 if abrupt else float(rng.uniform(0.15, 0.4))
        end = start + length
        part = (time >= start - fade_in) & (time <= end + fade_out)
        if part.any():
            local = time[part] - start
            rise = smooth((local + fade_in) / (2 * fade_in))
            fall = smooth((length + fade_out - local) / (2 * fade_out))
            weight = rise * fall
            wants = move(rng, tempo * local, tempo * length)
            for name in ("forward", "side", "turn"):
                if name in wants:
                    wants[name] = tempo * wants[name]
            for name, values in wants.items():
                total[name][part] += weight * values
            weight_sum[part] += weight
            inside = np.flatnonzero(part)
            wins = weight > best[inside]
            best[inside[wins]] = weight[wins]
            label[inside[wins]] = CLASSES.index(kind)
        start, fade_in, last = end, fade_out, kind
    weight_sum = np.maximum(weight_sum, 1e-3)
    return {name: values / weight_sum for name, values in total.items()}, label


def _add_arms(rng: np.random.Generator, controls: Controls) -> None:
    """Add slow random arm motion; at times both arms move alike."""
    count = len(controls["turn"])
    together = _noise(rng, count, 0.25) > 0.2
    mix = uniform_filter1d(together.astype(np.float64), RATE // 2, mode="nearest")
    wander = {
        side: {
            "reach": 0.7 + 1.1 * _noise(rng, count, 0.5),
            "sweep": 0.5 + 0.6 * _noise(rng, count, 0.5),
            "elbow": 0.5 + 0.5 * _noise(rng, count, 0.6),
        }
        for side in "lr"
    }
    for name, (low, high) in (
        ("reach", (-0.25, 2.35)),
        ("sweep", (-0.5, 1.6)),
        ("elbow", (-0.3, 1.7)),
    ):
        left, right = wander["l"][name], wander["r"][name]
        right = (1 - mix) * right + mix * left
        for side, curve in (("l", left), ("r", right)):
            channel = controls[f"{name}_{side}"]
            controls[f"{name}_{side}"] = low + (high - low) * _ease(
                (channel + curve - low) / (high - low)
            )


def _add_noise(rng: np.random.Generator, controls: Controls) -> None:
    """Add small random motion to some channels."""
    count = len(controls["turn"])
    for name, size, rate in (
        ("shift_x", 0.012, 0.5),
        ("shift_z", 0.012, 0.5),
        ("lift", 0.006, 0.6),
        ("pitch", 0.04, 0.5),
        ("roll", 0.03, 0.5),
        ("bend", 0.12, 0.4),
        ("lean", 0.1, 0.4),
        ("wring", 0.15, 0.4),
        ("look", 0.3, 0.4),
        ("nod", 0.12, 0.4),
        ("width", 0.03, 0.2),
    ):
        controls[name] = controls[name] + size * _noise(rng, count, rate)
    controls["width"] = np.maximum(controls["width"], -0.06)
    controls["lift"] = np.clip(controls["lift"], -0.45, 0.04)


def _noise(rng: np.random.Generator, count: int, rate: float) -> Float:
    """Smooth noise ``(count,)`` of variance about 1; `rate` is its number of swings a second."""
    knots = math.ceil(count / RATE * rate * 2) + 4
    values = rng.normal(size=knots)
    at = np.arange(count) / RATE * rate * 2 + rng.uniform(0, 1)
    k = at.astype(int)
    u = at - k
    weights = ((1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3)
    # A cubic B-spline through random knots of variance 1 has a variance of about 0.48 = 0.69².
    return sum((w * values[k + i] for i, w in enumerate(weights)), np.zeros(count)) / 6 / 0.69


def _ease(x: Float) -> Float:
    """Values clamped to [0, 1] by a smooth curve."""
    return np.asarray(0.5 + 0.5 * np.tanh(2 * (x - 0.5)))
