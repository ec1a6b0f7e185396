"""Problems of the soak: shape, motion, what is wrong with them, what is asked; from a seed."""

from __future__ import annotations

from typing import Any

import numpy as np

from helpers import motions


def draw(seed: int) -> dict[str, Any]:
    """Arguments of a call, and what else is done with it, from a seed."""
    rng = np.random.default_rng(seed)
    v = (
        int(np.exp(rng.uniform(0, np.log(90))))
        if rng.random() < 0.9
        else int(rng.integers(90, 1100))
    )
    f = int(np.exp(rng.uniform(0, np.log(40))))
    rest, shape = draw_shape(rng, v)
    frames, motion = draw_motion(rng, rest, f)
    frames, changes = disturb(rng, frames)
    kind = {"V": v, "F": f, "shape": shape, "motion": motion, "changes": changes}
    faces = draw_faces(rng, v)
    options = draw_options(rng, frames, faces)
    shots = sorted({0, f, *(rng.integers(0, f, 2).tolist() if rng.random() < 0.1 else [])})
    return {
        "seed": seed,
        "kind": kind,
        "frames": frames,
        "faces": faces,
        "options": options,
        "shots": shots,
        "stops": [float(x) for x in rng.random(int(rng.integers(1, 3)))] * (rng.random() < 0.25),
        "threads": 2 if rng.random() < 0.1 else 1,
    }


def draw_shape(rng: np.random.Generator, v: int) -> tuple[np.ndarray, str]:
    shape = rng.choice(
        ["ball", "ball", "ball", "plane", "line", "nearly a line", "point", "copies", "clusters"]
    )
    p = rng.standard_normal((v, 3))
    if shape == "plane":
        p[:, rng.integers(3)] = 0
    elif shape == "line":
        p = p[:, :1] * rng.standard_normal(3)
    elif shape == "nearly a line":
        p = p[:, :1] * rng.standard_normal(3) + 1e-9 * rng.standard_normal((v, 3))
    elif shape == "point":
        p[:] = p[0]
    elif shape == "copies":
        p = p[rng.integers(0, max(1, v // 5), v)]
    elif shape == "clusters":
        p += 30 * rng.standard_normal((4, 3))[rng.integers(0, 4, v)]
    return p, str(shape)


def draw_motion(rng: np.random.Generator, rest: np.ndarray, f: int) -> tuple[np.ndarray, str]:
    v = len(rest)
    motion = str(
        rng.choice(
            ["bodies", "blend", "blend and noise", "waves", "noise", "one body", "still"],
            p=[0.2, 0.25, 0.2, 0.15, 0.1, 0.05, 0.05],
        )
    )
    if motion == "noise":
        return rng.standard_normal((f, v, 3)), motion
    if motion == "still":
        return np.repeat(rest[None], f, axis=0), motion
    b = 1 if motion == "one body" else int(rng.integers(1, 9))
    moves = motions.motions(rng, f, b, turn=float(rng.choice([1e-4, 0.3, 1.0, 3.0])))
    indices, weights = motions.weights_of(rng, v, b, 1 if motion == "bodies" else 4)
    frames = motions.blend(rest, indices, weights, moves)
    if motion == "waves":
        t = np.arange(f)[:, None, None]
        frames = rest + np.sin(0.5 * t + rest @ rng.standard_normal((3, 3)))
    if motion == "blend and noise":
        frames = frames + 10 ** rng.uniform(-6, -0.5) * rng.standard_normal(frames.shape)
    return frames, motion


def disturb(rng: np.random.Generator, frames: np.ndarray) -> tuple[np.ndarray, list[str]]:
    f, v = frames.shape[:2]
    done = []

    def also(name: str, probability: float) -> bool:
        if rng.random() < probability:
            done.append(name)
            return True
        return False

    t, i = int(rng.integers(f)), int(rng.integers(v))
    if also("mirrored from a frame on", 0.08):
        frames[t:] *= [-1, 1, 1]
    if also("a frame far away", 0.06):
        frames[t] += 10 ** rng.uniform(2, 6) * rng.standard_normal(3)
    if also("a frame in a point", 0.05):
        frames[t] = frames[t, i]
    if also("a vertex far away", 0.06):
        frames[:, i] += 10 ** rng.uniform(1, 5)
    if also("a vertex that jumps", 0.05):
        frames[t, i] += 10 ** rng.uniform(0, 4)
    if also("frames repeated", 0.06):
        frames[t:] = frames[t]
    if also("from the origin", 0.1):
        frames += 10 ** rng.uniform(0, 6) * rng.standard_normal(3)
    if also("scaled", 0.12):
        frames *= 10.0 ** rng.uniform(-9, 9)
    kind = rng.choice(
        ["f8", "f4", "f2", ">f8", "column order", "every other"],
        p=[0.5, 0.3, 0.03, 0.05, 0.06, 0.06],
    )
    if kind == "f2" and np.abs(frames).max() > 6e4:
        kind = "f4"
    if kind == "column order":
        frames = np.asfortranarray(frames)
    elif kind == "every other":
        frames = np.repeat(frames, 2, axis=1)[:, ::2]
    else:
        frames = frames.astype(kind)
    return frames, [*done, str(kind)]


def draw_faces(rng: np.random.Generator, v: int) -> np.ndarray | None:
    if rng.random() < 0.4:
        return None
    if rng.random() < 0.5:
        return rng.integers(0, v, (int(rng.integers(1, 2 * v + 2)), 3)).astype(np.int32)
    i = np.arange(max(v - 2, 0), dtype=np.int32)
    return np.stack([i, i + 1, i + 2], axis=1) if v > 2 else np.zeros((1, 3), dtype=np.int32)


def draw_options(
    rng: np.random.Generator, frames: np.ndarray, faces: np.ndarray | None
) -> dict[str, Any]:
    f, v = frames.shape[:2]
    most = min(v, 14)
    bones = (
        int(rng.integers(1, most + 1)) if rng.random() < 0.9 else max(1, v - int(rng.integers(3)))
    )
    bones = min(bones, 40)
    out: dict[str, Any] = {
        "bones": bones,
        "influences": int(rng.choice([1, 2, 3, 4, 4, 4, 4, 5, 8, 13, 20])),
        "bone_model": str(rng.choice(["rigid", "similarity", "affine"], p=[0.6, 0.2, 0.2])),
        "effort": str(rng.choice(["fast", "balanced", "best"], p=[0.6, 0.3, 0.1])),
        "rng": int(rng.integers(1000)),
        "rest_frame": int(rng.integers(f)),
    }
    if out["effort"] == "best" or rng.random() < 0.2:
        out["max_iterations"] = int(rng.integers(1, 120))
    if rng.random() < 0.04:
        out["time_limit"] = float(10 ** rng.uniform(-3, 0))
    if rng.random() < 0.15:
        out["vertex_importance"] = rng.random(v) * (rng.random(v) < rng.choice([0.5, 1.0]))
        out["vertex_importance"][rng.integers(v)] = 1.0
    if rng.random() < 0.1:
        out["frame_importance"] = 10 ** rng.uniform(-2, 2, f)
    size = float(np.abs(np.asarray(frames, dtype=np.float64)).max()) or 1.0
    if rng.random() < 0.15:
        first = np.array(frames[int(rng.integers(f))], dtype=np.float64)
        out["rest"] = first if rng.random() < 0.7 else size * rng.standard_normal((v, 3))
    if rng.random() < 0.08:
        out["tolerance"] = str(rng.choice(["0.01%", "0.3%", "2%", "30%"]))
        if "vertex_importance" in out:  # what counts for less is refused there
            out["vertex_importance"] = np.maximum(out["vertex_importance"], 1e-3)
        out["tolerance_of"] = str(rng.choice(["rmse", "max"]))
        out["bones"] = min(bones, 8)
        if out["effort"] == "best":
            out["effort"] = "fast"
        return out
    if rng.random() < 0.1:
        indices, weights = motions.weights_of(rng, v, bones, min(out["influences"], 4))
        out["indices"], out["weights"] = indices, weights
        if rng.random() < 0.5:
            out["locked_vertices"] = rng.random(v) < 0.4
    if rng.random() < 0.1:
        count = bones if "weights" in out else int(rng.integers(1, bones + 1))
        given = motions.motions(rng, f, count)
        given[..., 3] *= size
        out["transforms"] = given
        if rng.random() < 0.5:
            out["locked_bones"] = np.flatnonzero(rng.random(count) < 0.5)
    if faces is not None and rng.random() < 0.12:
        out["smoothness"] = size * float(10 ** rng.uniform(-6, 0))
    return out
