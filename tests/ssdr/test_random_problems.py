"""Any motion with any options: models are valid, errors true, and none gets worse."""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import Ticks, broken, largest_of, rmse_of, size_of


@dataclasses.dataclass(frozen=True, eq=False)
class Drawn:
    """A call: frames of shots, options of ``decompose`` or ``smallest``, fields of a Kept.

    `stop` is the fraction of the work after which the call is made again from its model.
    """

    frames: np.ndarray
    faces: np.ndarray | None
    shots: list[int]
    options: dict[str, Any]
    parts: dict[str, Any]
    stop: float
    threads: int
    motion: str = ""

    def solve(self, **more: Any) -> ssdr.Decomposition:
        cuts = itertools.pairwise(self.shots)
        shots = [ssdr.MeshSequence(self.frames[a:b], self.faces) for a, b in cuts]
        call = ssdr.smallest if "tolerance" in self.options else ssdr.decompose
        start = {"start": ssdr.Kept(**self.parts)} if self.parts else {}
        with warnings.catch_warnings(), pytest.MonkeyPatch.context() as patch:
            warnings.simplefilter("ignore", ssdr.SsdrWarning)  # fewer bones would often do
            Ticks(patch, 1e-3)  # a time limit is one of steps
            return call(shots, **(self.options | start | more))


def check(seed: int) -> tuple[str, list[str]]:
    """Kind of motion of a problem, and all faults of its results."""
    drawn = draw(seed)
    try:
        ssdr.set_threads(drawn.threads)
        result = drawn.solve()
        wrong = faults(result, drawn)
        if drawn.stop and not drawn.parts and "tolerance" not in drawn.options:
            wrong += [f"taken up: {fault}" for fault in taken_up(drawn)]
    finally:
        ssdr.set_threads(None)
    return drawn.motion, [f"{seed}: {fault}" for fault in wrong]


def taken_up(drawn: Drawn) -> list[str]:
    """Faults of a run that is stopped and of another that starts from its model."""
    enough = {"callback": lambda p: p.fraction >= drawn.stop and np.isfinite(p.rmse)}
    part = drawn.solve(**enough)
    again = drawn.solve(start=part.skinning, bones=None, rest_frame=None)
    wrong = faults(part, drawn, ended=False) + faults(again, drawn, ended=False)
    plain = not {"vertex_importance", "frame_importance", "smoothness"} & set(drawn.options)
    if plain and again.rmse > part.rmse * (1 + 1e-12) + 1e-13 * size_of(
        part.skinning, drawn.frames
    ):
        wrong.append(f"rmse {again.rmse:.6g} after {part.rmse:.6g}")
    return wrong


def faults(result: ssdr.Decomposition, drawn: Drawn, *, ended: bool = True) -> list[str]:
    """Faults of a result, found by plain NumPy; its error is judged only if the run ended."""
    options, parts, s = drawn.options, drawn.parts, result.skinning
    frames = np.array(drawn.frames, dtype=np.float64)
    searched = "tolerance" in options
    bones = s.n_bones if searched else options["bones"]
    influences = min(s.n_influences, options["influences"]) if searched else options["influences"]
    # a search tells of models of several sizes; with smoothness the penalty may fall instead
    falls = "smoothness" not in options and not searched
    if fault := broken(result, frames, bones, influences, falls=falls):
        return [fault]
    wrong, rmse, size = [], rmse_of(s, frames), size_of(s, frames)
    if searched:
        if not 1 <= bones <= options["bones"]:
            wrong.append(f"{bones} bones, at most {options['bones']} were asked for")
        found = result.parsimony
        worst = largest_of(s, frames) if options["measure"] == "max" else rmse
        if found.held and worst > found.tolerance * (1 + 1e-6) + 1e-12 * size:
            wrong.append("the tolerance is not held")
        return wrong
    if ended and rmse > 1.001 * (bound := one_motion(frames, drawn)) + 1e-7 * size:
        wrong.append(f"rmse {rmse:.6g}, one motion for all has {bound:.6g}")
    if "rest" in parts and np.abs(s.rest - parts["rest"]).max() > 1e-9 * size:
        wrong.append("the given rest pose moved")
    if "weights" in parts:
        given = motions.model(s.rest, parts["indices"], parts["weights"], bones=bones)
        if np.abs(s.dense_weights() - given.dense_weights()).max() > 1e-9:
            wrong.append("the given weights changed")
    return wrong


def one_motion(frames: np.ndarray, drawn: Drawn) -> float:
    """RMSE of the best rigid motion of the whole mesh, which every model contains.

    Where importances or a penalty weigh the two differently they are not compared; an affine bone
    that must not turn inside out may stop at a wall that a rigid one never meets.
    """
    weighed = {"vertex_importance", "frame_importance", "smoothness", "time_limit"}
    if weighed & set(drawn.options) or drawn.options["bone_model"] == "affine":
        return np.inf
    rest = drawn.parts.get("rest", frames[drawn.options.get("rest_frame", 0)])
    found = ssdr.kabsch(np.broadcast_to(rest, frames.shape), frames)
    every = np.zeros((len(rest), 1), dtype=int)
    return rmse_of(motions.model(rest, every, np.ones((len(rest), 1)), found[:, None]), frames)


def draw(seed: int) -> Drawn:
    rng = np.random.default_rng(seed)
    small = rng.random() < 0.9
    v = int(np.exp(rng.uniform(0, np.log(90)))) if small else int(rng.integers(90, 1100))
    f = int(np.exp(rng.uniform(0, np.log(40))))
    frames, motion = _move(rng, _shape(rng, v), f)
    frames = _disturbed(rng, frames)
    faces = None
    if rng.random() < 0.6:
        faces = rng.integers(0, v, (int(rng.integers(1, 2 * v + 2)), 3)).astype(np.int32)
    options, parts = _options(rng, frames, faces)
    cuts = rng.integers(0, f, 2).tolist() if rng.random() < 0.1 else []
    return Drawn(
        frames,
        faces,
        sorted({0, f, *cuts}),
        options,
        parts,
        stop=float(rng.random()) if rng.random() < 0.3 else 0.0,
        threads=2 if rng.random() < 0.1 else 1,
        motion=motion,
    )


def _shape(rng: np.random.Generator, v: int) -> np.ndarray:
    kinds = ("plane", "line", "nearly a line", "point", "copies", "clusters", "ball", "ball")
    shape, p = rng.choice(kinds), rng.standard_normal((v, 3))
    if shape == "plane":
        p[:, rng.integers(3)] = 0
    elif shape in ("line", "nearly a line"):
        p = p[:, :1] * rng.standard_normal(3)
        p += 1e-9 * (shape != "line") * rng.standard_normal((v, 3))
    elif shape == "point":
        p[:] = p[0]
    elif shape == "copies":
        p = p[rng.integers(0, max(1, v // 5), v)]
    elif shape == "clusters":
        p += 30 * rng.standard_normal((4, 3))[rng.integers(0, 4, v)]
    return p


def _move(rng: np.random.Generator, rest: np.ndarray, f: int) -> tuple[np.ndarray, str]:
    kinds = ("bodies", "blend", "blend and noise", "waves", "noise", "one body", "still")
    motion = str(rng.choice(kinds, p=[0.2, 0.25, 0.2, 0.15, 0.1, 0.05, 0.05]))
    if motion == "noise":
        return rng.standard_normal((f, len(rest), 3)), motion
    if motion == "still":
        return np.repeat(rest[None], f, axis=0), motion
    if motion == "waves":
        t = np.arange(f)[:, None, None]
        return rest + np.sin(0.5 * t + rest @ rng.standard_normal((3, 3))), motion
    b = 1 if motion == "one body" else int(rng.integers(1, 9))
    moves = motions.motions(rng, f, b, turn=float(rng.choice([1e-4, 0.3, 1.0, 3.0])))
    indices, weights = motions.weights_of(rng, len(rest), b, 1 if motion == "bodies" else 4)
    frames = motions.blend(rest, indices, weights, moves)
    if motion == "blend and noise":
        frames += 10 ** rng.uniform(-6, -0.5) * rng.standard_normal(frames.shape)
    return frames, motion


def _disturbed(rng: np.random.Generator, frames: np.ndarray) -> np.ndarray:
    f, v = frames.shape[:2]
    t, i = int(rng.integers(f)), int(rng.integers(v))
    if rng.random() < 0.08:
        frames[t:] *= [-1, 1, 1]
    if rng.random() < 0.06:  # a frame far away
        frames[t] += 10 ** rng.uniform(2, 6) * rng.standard_normal(3)
    if rng.random() < 0.05:
        frames[t] = frames[t, i]
    if rng.random() < 0.06:  # a vertex far away
        frames[:, i] += 10 ** rng.uniform(1, 5)
    if rng.random() < 0.05:  # a vertex that jumps
        frames[t, i] += 10 ** rng.uniform(0, 4)
    if rng.random() < 0.06:
        frames[t:] = frames[t]
    if rng.random() < 0.1:
        frames += 10 ** rng.uniform(0, 6) * rng.standard_normal(3)
    if rng.random() < 0.12:
        frames *= 10.0 ** rng.uniform(-9, 9)
    kinds = ("f8", "f4", "f2", ">f8", "column order", "every other")
    kind = rng.choice(kinds, p=[0.5, 0.3, 0.03, 0.05, 0.06, 0.06])
    if kind == "column order":
        return np.asfortranarray(frames)
    if kind == "every other":
        return np.repeat(frames, 2, axis=1)[:, ::2]
    return frames.astype("f4" if kind == "f2" and np.abs(frames).max() > 6e4 else kind)


def _options(
    rng: np.random.Generator, frames: np.ndarray, faces: np.ndarray | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    f, v = frames.shape[:2]
    bones = min(v, int(rng.integers(1, 15)) if rng.random() < 0.9 else 40)
    options: dict[str, Any] = {
        "bones": bones,
        "influences": int(rng.choice([1, 2, 3, 4, 4, 4, 4, 5, 8, 13, 20])),
        "bone_model": str(rng.choice(["rigid", "similarity", "affine"], p=[0.6, 0.2, 0.2])),
        "effort": str(rng.choice(["fast", "balanced"], p=[0.7, 0.3])),
        "rng": int(rng.integers(1000)),
    }
    parts: dict[str, Any] = {}
    if rng.random() < 0.5:
        options["rest_frame"] = int(rng.integers(f))
    if rng.random() < 0.1:
        options |= {"effort": "best", "time_limit": float(10 ** rng.uniform(-3, 0))}
    if rng.random() < 0.15:
        counts = rng.random(v) * (rng.random(v) < rng.choice([0.5, 1.0]))
        counts[rng.integers(v)] = 1.0
        options["vertex_importance"] = counts
    if rng.random() < 0.1:
        options["frame_importance"] = 10 ** rng.uniform(-2, 2, f)
    size = float(np.abs(frames.astype(np.float64)).max()) or 1.0
    if rng.random() < 0.15:
        options.pop("rest_frame", None)
        first = np.array(frames[int(rng.integers(f))], dtype=np.float64)
        parts["rest"] = first if rng.random() < 0.7 else size * rng.standard_normal((v, 3))
    if rng.random() < 0.08:
        if "vertex_importance" in options:  # what counts for less is refused there
            options["vertex_importance"] = np.maximum(options["vertex_importance"], 1e-3)
        share = str(rng.choice(["0.01%", "0.3%", "2%", "30%"]))
        options |= {"tolerance": share, "measure": str(rng.choice(["rmse", "max"]))}
        return options | {"bones": min(bones, 8), "effort": "fast"}, parts
    if rng.random() < 0.1:
        most = min(options["influences"], 4)
        parts["indices"], parts["weights"] = motions.weights_of(rng, v, bones, most)
    if faces is not None and rng.random() < 0.12:
        options["smoothness"] = size * float(10 ** rng.uniform(-6, 0))
    return options, parts


@pytest.mark.parametrize(
    "first", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (20, 40, 60))]
)
def test_random_problems(first: int) -> None:
    """Valid weights and rotations, true errors, falling histories, kept parts, continued runs."""
    cases = [check(seed) for seed in range(first, first + 20)]
    assert [fault for _, wrong in cases for fault in wrong] == []
    assert len({motion for motion, _ in cases}) > 3


def add_bone(result: ssdr.Decomposition) -> None:
    m = result.skinning.transforms
    object.__setattr__(result.skinning, "transforms", np.concatenate([m, m[:, :1]], axis=1))


def add_influence(result: ssdr.Decomposition) -> None:
    s = result.skinning
    third = np.full((len(s.rest), 1), 0.1)
    object.__setattr__(s, "weights", np.concatenate([0.9 * s.weights, third], axis=1))
    object.__setattr__(s, "indices", np.concatenate([s.indices, s.indices[:, :1]], axis=1))


def add_to(name: str, at: Any, amount: float) -> Callable[[ssdr.Decomposition], None]:
    def change(result: ssdr.Decomposition) -> None:
        getattr(result.skinning, name)[at] += amount

    return change


def with_history(*numbers: int) -> Callable[[ssdr.Decomposition], None]:
    def change(result: ssdr.Decomposition) -> None:
        records = [result.history[k] for k in numbers]
        object.__setattr__(result, "history", tuple(records))

    return change


SPOILED: dict[str, Callable[[ssdr.Decomposition], None]] = {
    "s.weights.sum(axis=1) - 1": add_to("weights", (0, 0), 1e-3),
    "size - 1": add_to("transforms", (1, 0, 0, slice(3)), 1e-5),
    "np.linalg.det": lambda result: result.skinning.transforms.__imul__([1, 1, -1, 1.0]),
    "s.indices.max() < bones": add_to("indices", (2, 0), 2),
    "result.rmse ==": add_to("transforms", (1, slice(None), 0, 3), 0.1),
    "isfinite(s.rest)": add_to("rest", (0, 0), np.nan),
    "s.transforms.shape": add_bone,
    "s.weights.shape": add_influence,
    "np.diff(errors) <= 0": with_history(-1, 0, -1),
    "errors[-1] == result.rmse": with_history(0),
}


@pytest.mark.parametrize("assertion", SPOILED)
def test_the_checks_can_fail(assertion: str) -> None:
    frames = motions.wobble(motions.chain(bones=3, rows=8, frames=6), 0.1)
    options = {"bones": 2, "influences": 2, "bone_model": "rigid"}
    drawn = Drawn(frames, None, [0, 6], options, {}, stop=0.0, threads=1)
    result = drawn.solve()
    assert faults(result, drawn) == []
    for name in ("weights", "transforms", "rest", "indices"):
        getattr(result.skinning, name).setflags(write=True)
    SPOILED[assertion](result)
    (fault,) = faults(result, drawn)
    assert assertion in fault
