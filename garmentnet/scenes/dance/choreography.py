"""Generator of dances: moves are chosen, timed and blended at random, from a seed.

A move gives curves for some control channels (:data:`~garmentnet.scenes.dance.puppet.CHANNELS`).
Consecutive moves are blended; arm motion and small random motion are added throughout.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ssdr.errors import InputError, check_choice

from ...data.motion import CLASSES, Motion
from ...data.skeleton import Skeleton
from .moves import MOVES, Controls, Float, Move, State, smooth
from .puppet import CHANNELS, RATE, pose_joints
from .wide_moves import TEMPI, WIDE_MOVES

__all__ = ["DANCE_CLASSES", "Repertoire", "dance"]

Repertoire = Literal["basic", "wide"]


@dataclasses.dataclass(frozen=True)
class _Moves:
    """Moves of a repertoire, and the ranges from which a dance is drawn."""

    moves: dict[str, tuple[float, float, Move]]
    tempi: dict[str, tuple[float, float]]
    fast: tuple[str, ...]
    slow: tuple[str, ...]
    # Numbers of classes in a dance, and of fast ones, as half-open ranges.
    classes: tuple[int, int]
    fast_classes: tuple[int, int]
    # Probability that a fast move ends in a sudden stop, beside the stops of its classes.
    sudden: float
    # Swing and middle of the random raising of the arms, and how high they are raised; radians.
    arms: tuple[float, float, float]


_MOVES: dict[str, _Moves] = {
    "basic": _Moves(
        moves=MOVES,
        tempi={},
        fast=("spin", "kick", "squat", "jump"),
        slow=("stand", "walk", "sway"),
        classes=(4, 7),
        fast_classes=(2, 4),
        sudden=0.0,
        arms=(0.6, 0.45, 2.0),
    ),
    "wide": _Moves(
        moves=WIDE_MOVES,
        tempi=TEMPI,
        fast=("spin", "kick", "squat", "jump", "turn"),
        slow=("stand", "walk", "sway", "shift"),
        classes=(6, 9),
        fast_classes=(3, 6),
        sudden=0.25,
        arms=(1.1, 0.7, 2.35),
    ),
}
DANCE_CLASSES = tuple(WIDE_MOVES)


def dance(
    skeleton: Skeleton,
    *,
    seed: int,
    frames: int = 300,
    fps: float = 30.0,
    classes: Sequence[str] | None = None,
    repertoire: Repertoire = "basic",
) -> Motion:
    """Generate a dance.

    Parameters
    ----------
    skeleton : Skeleton
        Skeleton of :mod:`garmentnet.scenes.body`.
    seed : int
        Seed of the random numbers; with the same number of frames and frame rate, it gives the
        same dance.
    frames : int
    fps : float
    classes : sequence of str, optional
        Classes of motion, danced once in this order and then at random.  By default four to six are
        drawn, at least two of them fast; for "wide" six to eight, at least three of them fast.
    repertoire : {"basic", "wide"}
        ``"wide"`` adds walking turns and weight shifts, varies the tempo, raises the arms up to
        vertical, turns in jumps and stops suddenly after fast moves.

    Returns
    -------
    Motion

    Raises
    ------
    InputError
        If a class has no move or a number is out of its range.

    Examples
    --------
    >>> from garmentnet.scenes.body import default_body
    >>> spin = dance(default_body().skeleton, seed=1, frames=20, classes=["spin"])
    >>> spin.n_frames, CLASSES[spin.classes[10]]
    (20, 'spin')
    """
    if frames < 1:
        raise InputError("frames", "at least 1", frames)
    if not (math.isfinite(fps) and 1 <= fps <= RATE):
        raise InputError("fps", f"1 to {RATE}", fps)
    check_choice(repertoire, "repertoire", Repertoire)
    made_of = _MOVES[repertoire]
    rng = np.random.default_rng([int(seed), 0xDA9CE])
    chosen = _chosen(rng, made_of) if classes is None else list(classes)
    for c in chosen:
        if c not in made_of.moves:
            raise InputError("classes", f"some of {', '.join(made_of.moves)}", c)
    if not chosen:
        raise InputError("classes", "at least one", chosen)
    heading = float(rng.uniform(-math.pi, math.pi))
    seconds = frames / fps
    controls, label = _choreograph(rng, made_of, chosen, seconds, heading)
    _add_arms(rng, made_of, controls)
    _add_noise(rng, controls)
    joints = pose_joints(skeleton, controls, heading)
    at = np.minimum(np.round(np.arange(frames) * RATE / fps).astype(int), len(joints) - 1)
    return Motion(joints[at], label[at], fps)


def _chosen(rng: np.random.Generator, made_of: _Moves) -> list[str]:
    count = int(rng.integers(*made_of.classes))
    n_fast = min(int(rng.integers(*made_of.fast_classes)), count - 2)
    fast, slow = list(made_of.fast), list(made_of.slow)
    picked = [*rng.permutation(fast)[:n_fast], *rng.permutation(slow)[: count - n_fast]]
    if len(picked) < count:
        picked.append("stop")
    return [str(p) for p in rng.permutation(picked)]


def _choreograph(
    rng: np.random.Generator,
    made_of: _Moves,
    chosen: list[str],
    seconds: float,
    heading: float,
) -> tuple[Controls, NDArray[np.int8]]:
    count = math.ceil(seconds * RATE) + 1
    time = np.arange(count) / RATE
    total = {name: np.zeros(count) for name in CHANNELS}
    weight_sum = np.zeros(count)
    best, label = np.zeros(count), np.zeros(count, dtype=np.int8)
    order, start, state = list(chosen), -float(rng.uniform(0, 0.5)), State(0.0, 0.0, heading)
    fade_in, last = 0.3, ""
    while start < seconds:
        if not order:
            order = [str(c) for c in rng.permutation(chosen)]
            if len(order) > 1 and order[0] == last:
                order = order[1:] + order[:1]
        if made_of.sudden and last in made_of.fast and rng.random() < made_of.sudden:
            order.insert(0, "stop")
        kind = order.pop(0)
        low, high, move = made_of.moves[kind]
        tempo = _tempo(rng, made_of, kind)
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
            wants = move(rng, tempo * local, tempo * length, state)
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
            state = _after(state, wants, weight)
        start, fade_in, last = end, fade_out, kind
    weight_sum = np.maximum(weight_sum, 1e-3)
    return {name: values / weight_sum for name, values in total.items()}, label


def _tempo(rng: np.random.Generator, made_of: _Moves, kind: str) -> float:
    """Random tempo of a move within its range, uniform on a logarithmic scale."""
    if kind not in made_of.tempi:
        return 1.0
    return math.exp(rng.uniform(*np.log(made_of.tempi[kind])))


def _after(state: State, wants: Controls, weight: Float) -> State:
    """Approximate position and heading after a move."""
    zero = np.zeros(len(weight))
    yaw = state.yaw + np.cumsum(wants.get("turn", zero) * weight) / RATE
    side, forward = wants.get("side", zero) * weight, wants.get("forward", zero) * weight
    x = state.x + float((np.cos(yaw) * side + np.sin(yaw) * forward).sum()) / RATE
    z = state.z + float((np.cos(yaw) * forward - np.sin(yaw) * side).sum()) / RATE
    return State(x, z, float(yaw[-1]))


def _add_arms(rng: np.random.Generator, made_of: _Moves, controls: Controls) -> None:
    """Add slow random arm motion; at times both arms move alike."""
    count = len(controls["turn"])
    swing, middle, highest = made_of.arms
    together = _noise(rng, count, 0.25) > 0.2
    mix = uniform_filter1d(together.astype(np.float64), RATE // 2, mode="nearest")
    wander = {
        side: {
            "reach": middle + swing * _noise(rng, count, 0.5),
            "sweep": 0.5 + 0.6 * _noise(rng, count, 0.5),
            "elbow": 0.5 + 0.5 * _noise(rng, count, 0.6),
        }
        for side in "lr"
    }
    for name, (low, high) in (
        ("reach", (-0.25, highest)),
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
