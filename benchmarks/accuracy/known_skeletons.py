"""Animations whose skeleton is known, and a score of the skeleton that was found."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

import ssdr
from benchmarks.common import data_folder, skinned

ANIMALS = {"fox": "Fox.glb", "llama": "Llama.gltf", "pig": "Pig.gltf"}
RANDOM = {"tree-8": (8, 0), "tree-18": (18, 1), "tree-30": (30, 2)}  # bones, seed
INFLUENCES = 4
SAME = 1e-5  # of the diagonal: a known joint whose gap is larger is not counted


@dataclasses.dataclass(frozen=True, eq=False)
class KnownSkeleton:
    """A skinned model, and its animation with the vertices at seams welded."""

    skinning: ssdr.Skinning
    frames: np.ndarray
    rest: np.ndarray
    weights: np.ndarray  # (V, B)

    @property
    def diagonal(self) -> float:
        return ssdr.MeshSequence(self.frames).diagonal()

    def groups(self) -> np.ndarray:
        """Group number (B,) of each bone; bones that never turn against each other share one.

        No method can tell them apart.  −1 for a bone without weights.
        """
        model, gaps = self.skinning, self.gaps()
        freedom, group = model.joint_freedom(0.2), np.arange(model.n_bones)
        for b in np.argsort([_depth(model.parents, b) for b in group], kind="stable"):
            a = model.parents[b]
            if a >= 0 and freedom[b] == "nothing" and gaps[b] < SAME:
                group[b] = group[a]
        used = np.zeros(model.n_bones)
        np.add.at(used, group, (self.weights**2).sum(axis=0))
        return np.where(used[group] > 0, group, -1)

    def gaps(self) -> np.ndarray:
        """Largest gap (B,) of each joint over the diagonal."""
        return np.asarray(self.skinning.joint_gaps().max(axis=0)) / self.diagonal

    def bones(self) -> int:
        """Number of groups."""
        group = self.groups()
        return len(np.unique(group[group >= 0]))


def _depth(parents: np.ndarray, bone: int) -> int:
    count = 0
    while parents[bone] >= 0:
        bone, count = parents[bone], count + 1
    return count


def known(name: str) -> KnownSkeleton:
    if name in ANIMALS:
        skinning = ssdr.load_skinning(data_folder() / "gltf" / ANIMALS[name])
    elif name == "body":
        skinning = dancing_body()
    else:
        skinning = random_tree(*RANDOM[name])
    weights = np.asarray(skinning.dense_weights(), dtype=np.float64)
    frames = skinned(skinning)
    # copies of a vertex at a seam move alike in every frame
    paths = np.round(frames.transpose(1, 0, 2).reshape(frames.shape[1], -1) / np.ptp(frames), 6)
    keep = np.sort(np.unique(paths, axis=0, return_index=True)[1])
    return KnownSkeleton(
        skinning, np.ascontiguousarray(frames[:, keep]), skinning.rest[keep], weights[keep]
    )


def dancing_body() -> ssdr.Skinning:
    from garmentnet.scenes.body import default_body
    from garmentnet.scenes.dance.choreography import dance

    body = default_body()
    motion = dance(body.skeleton, seed=5, frames=300)
    return dataclasses.replace(
        body.skinning,
        transforms=np.asarray(motion.joints, dtype=np.float64),
        clips=None,
        parents=np.asarray(body.skeleton.parents),
        joint_positions=np.asarray(body.skeleton.rest, dtype=np.float64),
    )


def random_tree(bones: int, seed: int, frames: int = 120) -> ssdr.Skinning:
    """Sticks with skin around them on a random tree; a vertex has up to four near bones."""
    rng = np.random.default_rng(seed)
    parents = np.array([-1, *[int(rng.integers(max(0, b - 3), b)) for b in range(1, bones)]])
    way, points = np.zeros((bones, 3)), np.zeros((bones, 3))
    for b in range(bones):
        direction = rng.normal(size=3) + (1.5 * way[parents[b]] if b else 0.0)
        way[b] = direction / np.linalg.norm(direction)
        if b:
            # siblings get joints apart: at the same point the motion could not tell them from
            # children of each other
            points[b] = points[parents[b]] + rng.uniform(0.6, 1.0) * way[parents[b]]
            points[b] += 0.1 * rng.normal(size=3)
    along, angle = np.linspace(0, 1, 12, endpoint=False), np.linspace(0, 2 * np.pi, 10)[:-1]
    rest = []
    for b in range(bones):
        side = np.linalg.svd(way[b][None])[2][1:]
        ring = 0.18 * (np.cos(angle)[:, None] * side[0] + np.sin(angle)[:, None] * side[1])
        rest.append((points[b] + along[:, None] * way[b])[:, None] + ring)
    vertices = np.concatenate([part.reshape(-1, 3) for part in rest])
    across = np.clip(np.einsum("vbd,bd->vb", vertices[:, None] - points, way), 0.15, 0.85)
    from_stick = np.linalg.norm(vertices[:, None] - points - across[..., None] * way, axis=-1)
    own = np.repeat(np.arange(bones), len(along) * len(angle))
    near = np.eye(bones, dtype=bool)
    near[np.arange(1, bones), parents[1:]] = near[parents[1:], np.arange(1, bones)] = True
    dense = np.where(near[own], np.exp(-((from_stick / 0.25) ** 2)), 0.0)
    indices = np.argsort(-dense, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(dense, indices, axis=1)
    weights[weights < 0.02 * weights[:, :1]] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    clock = np.linspace(0, 4 * np.pi, frames)[:, None, None]
    pace, phase = rng.uniform(0.5, 2.5, (bones, 3)), rng.uniform(0, 6, (bones, 3))
    turns = 0.6 * np.sin(pace * clock + phase) * rng.uniform(0.2, 1, (bones, 3))
    still = np.broadcast_to(np.eye(3, 4), (1, bones, 3, 4))
    model = ssdr.Skinning(
        vertices, indices, weights, still, parents=parents, joint_positions=points
    )
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(frames, bones, 3, 3)
    return model.pose(local, 0.5 * np.sin(0.5 * clock + phase[0]))


def judge(truth: KnownSkeleton, found: ssdr.Skinning) -> dict[str, Any]:
    """Number of true edges that were found, and distances of their joints from the true ones."""
    model, group, gaps = truth.skinning, truth.groups(), truth.gaps()
    names = np.unique(group[group >= 0])
    merged = np.stack([truth.weights[:, group == g].sum(axis=1) for g in names], axis=1)
    rows, columns = linear_sum_assignment(-(merged.T @ found.dense_weights()))
    place = dict(zip(names[rows].tolist(), columns.tolist(), strict=True))
    freedom = model.joint_freedom(0.2)
    joints, wrong, away = 0, [], []
    for b, a in enumerate(model.parents):
        if a < 0 or -1 in (group[a], group[b]) or group[a] == group[b] or gaps[b] > SAME:
            continue
        joints += 1
        x, y = place.get(int(group[b]), -1), place.get(int(group[a]), -1)
        child = x if found.parents[x] == y else y if found.parents[y] == x else -1
        if -1 in (x, y, child):
            wrong.append(model.joint_names[b])
            continue
        there = carried(found.transforms[:, child], found.joint_positions[child])
        off = there - carried(model.transforms[:, b], model.joint_positions[b])
        if freedom[b] == "line":  # the motion does not say where along the axis
            parent, own = (model.transforms[:, bone, :, :3] for bone in (a, b))
            relative = np.swapaxes(parent, 1, 2) @ own
            spread = relative - relative.mean(axis=0)
            _, vectors = np.linalg.eigh(np.einsum("tca,tcd->ad", spread, spread))
            axis = own @ vectors[:, 0]
            off -= np.einsum("ta,ta->t", off, axis)[:, None] * axis
        away.append(float(np.linalg.norm(off, axis=1).mean()) / truth.diagonal)
    return {
        "joints": joints,
        "right": joints - len(wrong),
        "wrong": sorted(wrong),
        "joint error, median": float(np.median(away)) if away else None,
        "joint error, largest": max(away, default=None),
    }


def carried(transforms: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Positions (F, 3) of a point of the rest pose under transforms (F, 3, 4)."""
    return transforms[..., :3] @ point + transforms[..., 3]


def agreement(one: ssdr.Skinning, other: ssdr.Skinning) -> float:
    """Share of the edges of `one` that `other` has; bones are matched by their weights."""
    rows, columns = linear_sum_assignment(-(one.dense_weights().T @ other.dense_weights()))
    place = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    theirs = {frozenset((b, int(a))) for b, a in enumerate(other.parents) if a >= 0}
    mine = [(b, int(a)) for b, a in enumerate(one.parents) if a >= 0]
    return float(np.mean([frozenset((place[b], place[a])) in theirs for b, a in mine]))
