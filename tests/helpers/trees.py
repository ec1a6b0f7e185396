"""Made skeletons: random trees of joints, skin around their bones, motion by rotations alone."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

import ssdr
from helpers import motions
from ssdr.model.transforms import from_local


@dataclasses.dataclass(frozen=True, eq=False)
class Skeleton:
    """A model whose answer is known."""

    parents: np.ndarray
    points: np.ndarray
    rest: np.ndarray
    indices: np.ndarray
    weights: np.ndarray
    transforms: np.ndarray
    frames: np.ndarray

    @property
    def wavy(self) -> np.ndarray:
        """The frames with waves that the bones cannot follow."""
        return self.frames + 0.02 * np.sin(4 * self.frames[..., [1, 2, 0]])

    def skinning(self, **changes) -> ssdr.Skinning:
        """The model with its hierarchy, in the rest pose unless `transforms` are given."""
        parts = {"transforms": np.eye(3, 4) + np.zeros((1, len(self.parents), 1, 1))} | changes
        return ssdr.Skinning(
            self.rest,
            self.indices,
            self.weights,
            **parts,
            parents=self.parents,
            joint_positions=self.points,
        )


def skeleton(
    bones: int = 8, frames: int = 40, *, seed: int = 0, around: int = 24, turn: float = 0.7
) -> Skeleton:
    """A random tree in which each joint but the first has its bone, a stick with skin around it.

    Vertices near a joint share its bones; rotations swing smoothly, each joint about all axes.
    """
    rng = np.random.default_rng(seed)
    parents = np.array([-1, *[int(rng.integers(max(0, b - 3), b)) for b in range(1, bones)]])
    way = np.zeros((bones, 3))
    points = np.zeros((bones, 3))
    for b in range(bones):
        direction = rng.normal(size=3) + (2.0 * way[parents[b]] if b else 0.0)
        way[b] = direction / np.linalg.norm(direction)
        if b:
            points[b] = points[parents[b]] + way[parents[b]] + 0.3 * rng.normal(size=3)
    rest, indices, weights = [], [], []
    for b in range(bones):
        along = rng.uniform(0.05, 0.95, around)
        off = 0.15 * rng.normal(size=(around, 3))
        rest.append(points[b] + along[:, None] * way[b] + off)
        other = np.full(around, parents[b] if b else b)
        share = np.clip(0.5 - 1.5 * along, 0.0, 1.0) if b else np.zeros(around)
        indices.append(np.stack([np.full(around, b), other], axis=1))
        weights.append(np.stack([1.0 - share, share], axis=1))
    time = np.linspace(0, 2 * np.pi, frames)
    phase, pace = rng.uniform(0, 6, (2, bones, 3)), rng.integers(1, 4, (bones, 3))
    turns = turn * np.sin(pace * time[:, None, None] + phase[0]) * rng.uniform(0.3, 1, (bones, 3))
    local = np.zeros((frames, bones, 3, 4))
    local[..., :3] = (
        Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(frames, bones, 3, 3)
    )
    local[..., 3] = points - np.where((parents >= 0)[:, None], points[parents], 0.0)
    local[:, 0, :, 3] += 0.5 * np.sin(time[:, None] + phase[1][0])
    transforms = from_local(local, parents, points)
    rest, indices, weights = (np.concatenate(part) for part in (rest, indices, weights))
    posed = motions.blend(rest, indices, weights, transforms)
    return Skeleton(parents, points, rest, indices, weights, transforms, posed)


@functools.cache
def six_bones() -> Skeleton:
    """The skeleton of most tests, made once."""
    return skeleton(6, 40, seed=3)


def edges(parents) -> set[frozenset[int]]:
    """The joints of a tree, whichever bone is its root."""
    return {frozenset((b, int(a))) for b, a in enumerate(parents) if a >= 0}


def matched(found, truth: Skeleton) -> np.ndarray:
    """For each bone of the truth the one that moves most of what it moves, each once."""
    shared = truth.skinning().dense_weights().T @ found.dense_weights()
    rows, columns = linear_sum_assignment(-shared)
    place = np.empty(len(truth.parents), dtype=int)
    place[rows] = columns
    return place
