"""The moves of a dance: each gives curves for some control channels, at random.

The channels are :data:`.puppet.CHANNELS`, in radians, metres and seconds; a
channel that a move leaves out is 0.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Controls = dict[str, Float]
_GRAVITY = 9.81  # m/s²
# Fastest turns, radians per second: in a leap, about half a circle in the longest flight; and in a
# walk, half a circle in 0.8 s.
_LEAP_TURN = 9.0
_TURN = 8.0

# Curves of some channels at times t, seconds, of a move of some length.
Move = Callable[[np.random.Generator, Float, float], Controls]


def _stand(rng: np.random.Generator, t: Float, length: float) -> Controls:
    return {
        "shift_x": np.full(len(t), rng.uniform(-0.05, 0.05)),
        "roll": np.full(len(t), rng.uniform(-0.05, 0.05)),
        "width": np.full(len(t), rng.uniform(0, 0.15)),
        "look": np.full(len(t), rng.uniform(-0.4, 0.4)),
    }


def _walk(rng: np.random.Generator, t: Float, length: float) -> Controls:
    """A nearly straight walk in any direction, at 0.3 to 1.8 m/s."""
    way = rng.choice([0.0, 0.0, 0.0, math.pi / 2, -math.pi / 2, math.pi]) + rng.uniform(-0.4, 0.4)
    back = 0.7 if abs(math.remainder(way, math.tau)) > 2 else 1.0
    speed = back * rng.uniform(0.3, 1.8)
    return _gait(rng, t, speed, way) | {"turn": np.full(len(t), rng.uniform(-0.5, 0.5))}


def _turn(rng: np.random.Generator, t: Float, length: float) -> Controls:
    """A walk that turns steadily at 0.8 to 2.6 rad/s, or by 45° to 180° one to three times."""
    speed = rng.uniform(0.4, 1.4)
    side = rng.choice([-1.0, 1.0])
    if rng.random() < 0.4:
        rate = side * rng.uniform(0.8, 2.6) * bump(t, 0, length, 0.3)
    else:
        rate = np.zeros(len(t))
        count = int(rng.integers(1, 4))
        for k in range(count):
            begin, end = k * length / count, (k + 1) * length / count
            angle = side * rng.uniform(math.pi / 4, math.pi)
            lasts = min(rng.uniform(1.0, 1.8) * 2 * abs(angle) / _TURN, end - begin)
            at = rng.uniform(begin, end - lasts)
            # A bump with ramps of half its duration has half its duration as area.
            rate = rate + 2 * angle / lasts * bump(t, at, at + lasts, lasts / 2)
            side = side * rng.choice([-1.0, 1.0])
    return _gait(rng, t, speed, rng.choice([0.0, 0.0, math.pi])) | {"turn": rate}


def _gait(rng: np.random.Generator, t: Float, speed: float, way: float) -> Controls:
    """Channels of a walk at `speed`, m/s, in the direction `way`, radians from the heading."""
    pace = rng.uniform(0.9, 1.1) * 2 * math.pi * (0.9 + 0.5 * speed)
    hip = rng.uniform(0.02, 0.14)
    return {
        "forward": np.full(len(t), speed * math.cos(way)),
        "side": np.full(len(t), speed * math.sin(way)),
        "twist": hip * np.sin(pace * t),
        "roll": 0.5 * hip * np.cos(pace * t),
        "wring": -1.6 * hip * np.sin(pace * t),
        "bend": np.full(len(t), 0.06 * speed * math.cos(way)),
        "lift": 0.012 * np.cos(2 * pace * t),
    }


def _sway(rng: np.random.Generator, t: Float, length: float) -> Controls:
    beat = 2 * math.pi * rng.uniform(0.45, 1.3)
    phase = rng.uniform(0, 2 * math.pi)
    calm = min(1.0, 5.0 / beat)
    wide, twist = rng.uniform(0.02, 0.09) * calm, rng.uniform(0, 0.55) * calm
    roll, drop = rng.uniform(0.03, 0.16) * calm, rng.uniform(0, 0.05) * calm
    round_ = rng.uniform(0, 0.05) * calm * rng.choice([-1, 1])
    wave = beat * t + phase
    return {
        "shift_x": wide * np.sin(wave),
        "shift_z": round_ * np.cos(wave),
        "roll": -roll * np.sin(wave),
        "lean": roll * 1.2 * np.sin(wave),
        "twist": twist * np.sin(wave + rng.uniform(-0.6, 0.6)),
        "wring": -0.9 * twist * np.sin(wave),
        "lift": -drop * (1 - np.cos(2 * wave)) / 2,
        "width": np.full(len(t), rng.uniform(0.05, 0.25)),
        "turn": np.full(len(t), rng.uniform(-0.5, 0.5)),
    }


def _shift(rng: np.random.Generator, t: Float, length: float) -> Controls:
    """Weight shifts between the legs by 4 to 15 cm, soft or sharp; or a lunge forward and back."""
    wave = 2 * math.pi * rng.uniform(0.35, 1.0) * t + rng.uniform(0, 2 * math.pi)
    sharp = rng.uniform(0.5, 4.0)
    course = np.tanh(sharp * np.sin(wave)) / math.tanh(sharp)
    wide = rng.uniform(0.04, 0.15)
    lunge = rng.random() < 0.35
    roll, twist = rng.uniform(0.0, 0.14), rng.uniform(-0.35, 0.35)
    drop = rng.uniform(0.0, 0.08)
    return {
        "shift_z" if lunge else "shift_x": wide * course,
        "roll": (0.3 if lunge else -1.0) * roll * course,
        "lean": roll * course,
        "pitch": (0.1 if lunge else 0.0) * course,
        "twist": twist * course,
        "wring": -1.2 * twist * course,
        "lift": -drop * course**2,
        "width": np.full(len(t), rng.uniform(0.1, 0.4)),
        "turnout": np.full(len(t), rng.uniform(0.0, 0.35)),
    }


def _spin(rng: np.random.Generator, t: Float, length: float) -> Controls:
    way = rng.choice([-1.0, 1.0])
    envelope = bump(t, 0, length, rng.uniform(0.2, 0.45))
    top = rng.uniform(0.8, 2.0) * 2 * math.pi
    rate = way * top * envelope
    if rng.random() < 0.25:
        # There and back.
        rate = rate * np.tanh(8 * (0.5 - t / length))
    raised = rng.uniform(-0.2, 1.5)
    arm = envelope * raised
    out = {
        "turn": rate,
        "pivot": np.clip(np.abs(rate) / 4, 0, 1),
        "lift": 0.03 * envelope,
        "width": -0.04 * envelope,
        "lean": rng.uniform(-0.15, 0.15) * envelope,
        "bend": rng.uniform(-0.15, 0.1) * envelope,
        "forward": rng.uniform(-0.3, 0.3) * envelope,
        "reach_l": arm + rng.uniform(-0.1, 0.2),
        "reach_r": arm + rng.uniform(-0.1, 0.2),
    }
    # Half of the spins are up to twice as slow; some move across the floor.
    slow = rng.choice([1.0, rng.uniform(0.5, 1.0)])
    travel = rng.uniform(0.0, 0.6) * bump(t, 0, length, 0.4)
    return out | {"turn": slow * rate, "forward": out["forward"] + travel}


def _kick(rng: np.random.Generator, t: Float, length: float) -> Controls:
    out: Controls = defaultdict(lambda: np.zeros(len(t)))
    count = max(1, round(length / rng.uniform(0.75, 1.2)))
    side = str(rng.choice(["l", "r"]))
    for k in range(count):
        begin, end = k * length / count, (k + 1) * length / count
        up = bump(t, begin, end, 0.22 * (end - begin) + 0.08)
        peak = bump(t, begin + 0.05, end - 0.05, 0.45 * (end - begin))
        kind = rng.choice(["front", "front", "side", "back"])
        flex, spread = {
            "front": (rng.uniform(0.8, 1.75), rng.uniform(-0.1, 0.5)),
            "side": (rng.uniform(0.1, 0.5), rng.uniform(0.6, 1.1)),
            "back": (-rng.uniform(0.3, 0.8), rng.uniform(0, 0.2)),
        }[str(kind)]
        bent = rng.uniform(0.1, 1.5) * (1 - 0.8 * peak) if kind != "back" else 0.3 + 0.5 * peak
        lean = 0.18 * min(1.0, abs(flex) + spread)
        other = 1.0 if side == "l" else -1.0
        for name, values in (
            (f"free_{side}", up),
            (f"flex_{side}", flex * peak),
            (f"open_{side}", spread * peak),
            (f"knee_{side}", bent * up),
            ("shift_x", -other * 0.07 * up),
            ("bend", -lean * np.sign(flex) * peak),
            ("lean", other * 0.35 * spread * peak),
            ("pitch", -0.12 * np.sign(flex) * peak),
            ("lift", -0.02 * up),
            ("reach_l", 0.5 * peak),
            ("reach_r", 0.5 * peak),
        ):
            out[name] += values
        if rng.random() < 0.75:
            side = "r" if side == "l" else "l"
    return out


def _squat(rng: np.random.Generator, t: Float, length: float) -> Controls:
    depth, hold = rng.uniform(0.13, 0.4), rng.uniform(0.25, 0.45)
    down = bump(t, 0, length, hold * length)
    pulse = 0.15 * np.sin(2 * math.pi * rng.uniform(1, 2) * t) * down
    deep = depth * (down + pulse * rng.choice([0, 1]))
    wide = rng.uniform(0.0, 0.35)
    return {
        "lift": -deep,
        "shift_z": -0.35 * deep,
        "pitch": 0.5 * deep,
        "bend": 1.2 * deep,
        "width": wide * np.ones(len(t)),
        "turnout": np.full(len(t), 0.2 + wide),
        "reach_l": 0.7 * down,
        "reach_r": 0.7 * down,
        "sweep_l": rng.uniform(0, 1.2) * down,
        "sweep_r": rng.uniform(0, 1.2) * down,
        "nod": -0.8 * deep,
    }


def _jump(rng: np.random.Generator, t: Float, length: float) -> Controls:
    out: Controls = defaultdict(lambda: np.zeros(len(t)))
    count = max(1, round(length / rng.uniform(1.0, 1.5)))
    for k in range(count):
        begin, end = k * length / count, (k + 1) * length / count
        height = rng.uniform(0.07, 0.22)
        flight = 2 * math.sqrt(2 * height / _GRAVITY)
        off = begin + 0.45 * (end - begin - flight) + 0.05
        s = t - off
        rise = np.clip(s * (flight - s), 0, None) * _GRAVITY / 2
        out["air"] += rise
        crouch = rng.uniform(0.1, 0.22)
        load = bump(t, off - 0.42, off + 0.02, 0.2) + bump(
            t, off + flight - 0.02, off + flight + 0.45, 0.16
        )
        out["lift"] -= crouch * load
        out["bend"] += 1.2 * crouch * load
        flown = bump(t, off, off + flight, 0.35 * flight)
        out["turn"] += flown * rng.choice([0.0, 0.0, 1.0, -1.0]) * rng.uniform(1.5, 6)
        split, tuck = rng.uniform(0, 0.7) * rng.integers(0, 2), rng.uniform(0, 0.9)
        stride = rng.uniform(-0.7, 0.7) * rng.integers(0, 2)
        for side, sign in (("l", 1), ("r", -1)):
            out[f"free_{side}"] += 0.9 * flown
            out[f"flex_{side}"] += (0.5 * tuck + sign * stride) * flown
            out[f"open_{side}"] += split * flown
            out[f"knee_{side}"] += (tuck + 0.2) * flown
            out[f"reach_{side}"] += rng.uniform(0.2, 1.4) * flown
    # Most have a turn of up to half a circle, some are leaps.  All jumps of the move have the same
    # turn and direction.
    flown = np.minimum(out["air"] / 0.05, 1.0)
    if rng.random() < 0.7:
        turn = rng.choice([-1.0, 1.0]) * rng.uniform(2.0, _LEAP_TURN)
        out["turn"] = np.clip(out["turn"] + turn * flown, -_LEAP_TURN, _LEAP_TURN)
    leap, way = rng.uniform(0.0, 1.2) * rng.integers(0, 2), rng.uniform(-0.8, 0.8)
    out["forward"] = leap * math.cos(way) * flown
    out["side"] = leap * math.sin(way) * flown
    return out


def _stop(rng: np.random.Generator, t: Float, length: float) -> Controls:
    # Momentum goes on through the upper body and dies away.
    ring = np.exp(-5 * np.clip(t, 0, None)) * np.cos(9 * np.clip(t, 0, None))
    return {
        "bend": rng.uniform(-0.25, 0.25) * ring,
        "wring": rng.uniform(-0.4, 0.4) * ring,
        "shift_x": rng.uniform(-0.04, 0.04) * ring,
        "shift_z": rng.uniform(-0.04, 0.04) * ring,
        "lift": -0.04 * np.exp(-3 * np.clip(t, 0, None)),
        "width": np.full(len(t), 0.12),
    }


# Shortest and longest duration, seconds at tempo 1, and the function of the move.
MOVES: dict[str, tuple[float, float, Move]] = {
    "stand": (0.6, 1.4, _stand),
    "walk": (1.0, 3.0, _walk),
    "sway": (1.6, 3.2, _sway),
    "spin": (1.0, 2.6, _spin),
    "kick": (1.0, 2.4, _kick),
    "squat": (1.0, 2.2, _squat),
    "jump": (1.2, 2.6, _jump),
    "stop": (0.8, 1.5, _stop),
    "turn": (1.4, 3.2, _turn),
    "shift": (1.4, 3.2, _shift),
}

# Slowest and fastest tempo of a move; moves that are not listed have tempo 1.  A jump must fall as
# gravity demands, and the fastest kicks are as fast as a dancer can be.
TEMPI: dict[str, tuple[float, float]] = {
    "walk": (0.7, 1.25),
    "turn": (0.7, 1.25),
    "sway": (0.6, 1.4),
    "shift": (0.6, 1.4),
    "squat": (0.6, 1.3),
    "kick": (0.6, 1.05),
}


def smooth(x: Float) -> Float:
    """Smooth step from 0 at 0 to 1 at 1, with two continuous derivatives.

    Examples
    --------
    >>> smooth(np.array([-1.0, 0.5, 2.0])).tolist()
    [0.0, 0.5, 1.0]
    """
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * x * (x * (6 * x - 15) + 10))


def bump(t: Float, begin: float, end: float, ramp: float) -> Float:
    """1 between `begin` and `end`, 0 outside, with smooth ramps inside; seconds.

    Examples
    --------
    >>> bump(np.array([0.0, 0.5, 1.0, 2.0]), 0.0, 2.0, 0.5).tolist()
    [0.0, 1.0, 1.0, 0.0]
    """
    ramp = min(ramp, (end - begin) / 2)
    return smooth((t - begin) / ramp) * smooth((end - t) / ramp)
