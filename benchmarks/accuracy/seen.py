"""What is seen of a model and was never fitted: largest errors, time between frames, the rest pose.

    python benchmarks/accuracy/seen.py
    python benchmarks/accuracy/seen.py --only "samba ssdr" --again

Each sequence is decomposed with `balanced`, also with a free rest pose, and by Dem Bones (frame 0
is its rest pose, 60 iterations, the better of its settings).  Errors are in % of the diagonal.
"between" is the error in frames that were left out: every second one is fitted, and the others are
played from the written .glb as engines do, translations interpolated linearly and rotations on the
shortest arc; "between, cache" is that of vertices halfway between those of the two frames.  "flips"
counts neighbouring keys of a rotation with opposite signs.  "box" is the diagonal of the rest pose
over that of the frames in the mean.  "crossings" counts pairs of triangles without a common vertex
that intersect in the rest pose, "new" those that do so in no frame; beside them stand those of the
frame whose edges have lengths most like its own, and of frame 0.  "turned over" counts triangles
that point against the normals of their vertices in the rest pose and in no frame.  "bent" is the
mean angle in degrees from the stored normals to the rest mesh's own.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.accuracy import fitted
from benchmarks.common import Row
from helpers.drawn import mean_angle, vertex_normals
from helpers.glb import opened, values_of

SEQUENCES = ("horse_gallop", "samba", "cow_elastic", "ea_bone", "mannequin_rumba")
MODELS: dict[str, Callable[..., ssdr.Skinning]] = {
    "ssdr": fitted.ours,
    "free": lambda name, step=1: fitted.ours(name, step=step, **fitted.FREE),
    "Dem Bones": fitted.theirs,
}
COLUMNS = (
    "rmse", "99.9 %", "largest", "largest / rmse", "fitted", "between", "between, cache", "flips",
    "box", "crossings", "crossings, new", "crossings, frame like it", "crossings, frame 0",
    "turned over", "bent",
)  # fmt: skip


def measure(sequence: str, model: str) -> Row:
    frames, faces = fitted.load(sequence)
    whole, half = MODELS[model](sequence), MODELS[model](sequence, step=2)
    diagonal = ssdr.MeshSequence(frames, faces).diagonal()
    off = 100 * np.linalg.norm(common.skinned(whole) - frames, axis=-1) / diagonal
    like = most_alike(whole.rest, frames, faces)
    rest, alike, first = (
        crossings(p, faces, frames) for p in (whole.rest, frames[like], frames[0])
    )
    new = rest - alike - first
    for points in frames:
        new -= crossings(points, faces, frames) if new else set()
    own = vertex_normals(whole.rest[None], faces)
    over = turned_over(whole.rest, faces)
    for points in frames:
        over &= ~turned_over(points, faces)
    played, flips = between(half)
    n = len(played)
    even, odd = frames[::2], frames[1 : 2 * n : 2]

    def rmse(a: np.ndarray, b: np.ndarray) -> float:
        return 100 * float(np.sqrt(((a - b) ** 2).sum(axis=-1).mean())) / diagonal

    sizes = np.linalg.norm(np.ptp(frames, axis=1), axis=1)
    return {
        "rmse": float(np.sqrt((off**2).mean())),
        "99.9 %": float(np.percentile(off, 99.9)),
        "largest": float(off.max()),
        "largest / rmse": float(off.max() / np.sqrt((off**2).mean())),
        "fitted": rmse(common.skinned(half), even),
        "between": rmse(played, odd),
        "between, cache": rmse((even[:n] + even[1 : n + 1]) / 2, odd),
        "flips": flips,
        "box": float(np.linalg.norm(np.ptp(whole.rest, axis=0)) / sizes.mean()),
        "like": like,
        "crossings": len(rest),
        "crossings, new": len(new),
        "crossings, frame like it": len(alike),
        "crossings, frame 0": len(first),
        "turned over": int(over.sum()),
        "bent": mean_angle(whole.surface.normals, own[0]) if whole.surface else 0.0,
    }


def between(model: ssdr.Skinning) -> tuple[np.ndarray, int]:
    """Vertices midway between the keys of the written file, and its changes of sign."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.glb")
        ssdr.save(model, path)
        document, binary = opened(path)
    skin, animation = document["skins"][0], document["animations"][0]
    binds = values_of(document, binary, skin["inverseBindMatrices"]).astype(np.float64)
    binds = binds.reshape(-1, 4, 4).swapaxes(1, 2)
    tracks = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        assert sampler.get("interpolation", "LINEAR") == "LINEAR"
        values = values_of(document, binary, sampler["output"]).astype(np.float64)
        tracks[channel["target"]["node"], channel["target"]["path"]] = values
    moves, flips = np.empty((model.n_frames - 1, model.n_bones, 3, 4)), 0
    for k, joint in enumerate(skin["joints"]):
        turns, places = tracks[joint, "rotation"], tracks[joint, "translation"]
        flips += int(((turns[1:] * turns[:-1]).sum(axis=1) < 0).sum())
        first, last = Rotation.from_quat(turns[:-1]), Rotation.from_quat(turns[1:])
        arc = (first.inv() * last).as_rotvec() / 2  # the shortest
        turn = (first * Rotation.from_rotvec(arc)).as_matrix()
        place = (places[1:] + places[:-1]) / 2
        moves[:, k] = np.concatenate([turn, place[..., None]], axis=-1) @ binds[k]
    return common.reskin(model.rest, model.indices, model.weights, moves), flips


def most_alike(rest: np.ndarray, frames: np.ndarray, faces: np.ndarray) -> int:
    """Number of the frame whose edges are as long as those of the rest pose."""
    i, j = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0).T
    long = np.linalg.norm(rest[i] - rest[j], axis=-1)
    off = [((np.linalg.norm(p[i] - p[j], axis=-1) - long) ** 2).sum() for p in frames]
    return int(np.argmin(off))


def turned_over(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mask (T,) of triangles that point against the normals of their vertices."""
    a, b, c = points[faces].transpose(1, 0, 2)
    normals = np.nan_to_num(vertex_normals(points[None], faces)[0]).sum(axis=1)
    return (np.cross(b - a, c - a) * normals).sum(axis=1) < 0


def crossings(points: np.ndarray, faces: np.ndarray, frames: np.ndarray) -> set[tuple[int, int]]:
    """Pairs of triangles that have no vertex in common and intersect.

    Vertices that lie at one place in every frame are one.  Triangles in one plane do not count.
    """
    one = np.unique(frames.swapaxes(0, 1).reshape(points.shape[0], -1), axis=0, return_inverse=True)
    label = one[1].reshape(-1)[faces]
    corners = points[faces]
    axis = int(np.argmax(np.ptp(points, axis=0)))
    low, high = corners.min(axis=1), corners.max(axis=1)
    order = np.argsort(low[:, axis], kind="stable")
    corners, label, low, high = (x[order] for x in (corners, label, low, high))
    stop = np.searchsorted(low[:, axis], high[:, axis], side="right")
    found: set[tuple[int, int]] = set()
    for begin in range(0, len(faces), 2000):
        i = np.arange(begin, min(begin + 2000, len(faces)))
        count = stop[i] - i - 1
        first = np.repeat(i, count)
        second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
        near = ((low[first] <= high[second]) & (low[second] <= high[first])).all(axis=1)
        first, second = first[near], second[near]
        apart = (label[first][:, :, None] != label[second][:, None]).all(axis=(1, 2))
        pairs = np.stack([first[apart], second[apart]], axis=1)
        a, b = corners[pairs[:, 0]], corners[pairs[:, 1]]
        crossed = np.sort(order[pairs[pierced(a, b) | pierced(b, a)]], axis=1)
        found |= {(int(i), int(j)) for i, j in crossed}
    return found


def pierced(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mask (N,) of triangles (N, 3, 3) `b` through which a side of `a` passes.

    Möller and Trumbore, "Fast, minimum storage ray-triangle intersection", 1997.
    """
    one, two = b[:, 1] - b[:, 0], b[:, 2] - b[:, 0]
    out = np.zeros(len(a), dtype=bool)
    for k in range(3):
        start, along = a[:, k], a[:, (k + 1) % 3] - a[:, k]
        p = np.cross(along, two)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / (one * p).sum(axis=1)
            s = start - b[:, 0]
            u = scale * (s * p).sum(axis=1)
            q = np.cross(s, one)
            v = scale * (along * q).sum(axis=1)
            t = scale * (two * q).sum(axis=1)
            out |= (u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1)
    return out


if __name__ == "__main__":
    cases = {f"{name} {m}": {"sequence": name, "model": m} for name in SEQUENCES for m in MODELS}
    common.run(__file__, __doc__, cases, measure, COLUMNS)
