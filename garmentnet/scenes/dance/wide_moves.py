"""Moves over wider ranges than :mod:`.moves`, with two further kinds: walking turns, weight shifts.

The basic moves stay on a stage of 1.2 m and have one tempo.  These walk anywhere, turn while
walking, jump with turns and leaps, and vary in tempo.  A data set names the repertoire of its
dances, so that the dances of older data sets do not change.
"""

from __future__ import annotations

import math

import numpy as np

from .moves import MOVES, Controls, Float, Move, State, bump

__all__ = ["TEMPI", "WIDE_MOVES"]

# Fastest turns, radians per second: in a leap, about half a circle in the longest flight; and in a
# walk, half a circle in 0.8 s.
_LEAP_TURN = 9.0
_TURN = 8.0


def _walk(rng: np.random.Generator, t: Float, length: float, state: State) -> Controls:
    """A nearly straight walk in any direction, at 0.3 to 1.8 m/s."""
    way = rng.choice([0.0, 0.0, 0.0, math.pi / 2, -math.pi / 2, math.pi]) + rng.uniform(-0.4, 0.4)
    back = 0.7 if abs(math.remainder(way, math.tau)) > 2 else 1.0
    speed = back * rng.uniform(0.3, 1.8)
    return _gait(rng, t, speed, way) | {"turn": np.full(len(t), rng.uniform(-0.5, 0.5))}


def _turn(rng: np.random.Generator, t: Float, length: float, state: State) -> Controls:
    """A walk that turns steadily at 0.8 to 2.6 rad/s, or by 90° to 180° one to three times."""
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


def _shift(rng: np.random.Generator, t: Float, length: float, state: State) -> Controls:
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


def _jump(rng: np.random.Generator, t: Float, length: float, state: State) -> Controls:
    """The basic jumps, most of them with a turn of up to half a circle, some of them leaps."""
    out = MOVES["jump"][2](rng, t, length, state)
    flown = np.minimum(out["air"] / 0.05, 1.0)
    # All jumps of the move have the same turn and direction: single flights are not known here.
    if rng.random() < 0.7:
        turn = rng.choice([-1.0, 1.0]) * rng.uniform(2.0, _LEAP_TURN)
        out["turn"] = np.clip(out["turn"] + turn * flown, -_LEAP_TURN, _LEAP_TURN)
    leap, way = rng.uniform(0.0, 1.2) * rng.integers(0, 2), rng.uniform(-0.8, 0.8)
    out["forward"] = leap * math.cos(way) * flown
    out["side"] = leap * math.sin(way) * flown
    return out


def _spin(rng: np.random.Generator, t: Float, length: float, state: State) -> Controls:
    """The basic spins, half of them up to twice as slow; some move across the floor."""
    out = MOVES["spin"][2](rng, t, length, state)
    slow = rng.choice([1.0, rng.uniform(0.5, 1.0)])
    travel = rng.uniform(0.0, 0.6) * bump(t, 0, length, 0.4)
    return out | {"turn": slow * out["turn"], "forward": out["forward"] + travel}


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


# Shortest and longest duration, seconds at tempo 1, and the function of the move.
WIDE_MOVES: dict[str, tuple[float, float, Move]] = {
    **MOVES,
    "walk": (1.0, 3.0, _walk),
    "spin": (1.0, 2.6, _spin),
    "jump": (1.2, 2.6, _jump),
    "turn": (1.4, 3.2, _turn),
    "shift": (1.4, 3.2, _shift),
}

# Slowest and fastest tempo of a move; moves that are not listed have tempo 1.  A jump must fall as
# gravity demands, and the fastest basic kicks are as fast as a dancer can be.
TEMPI: dict[str, tuple[float, float]] = {
    "walk": (0.7, 1.25),
    "turn": (0.7, 1.25),
    "sway": (0.6, 1.4),
    "shift": (0.6, 1.4),
    "squat": (0.6, 1.3),
    "kick": (0.6, 1.05),
}
