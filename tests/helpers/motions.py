"""Synthetic animations whose skinning is known, built without the package's own code."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr


@dataclasses.dataclass(frozen=True, eq=False)
class Rig:
    """An exact linear blend skinning and the frames that it makes."""

    rest: np.ndarray
    indices: np.ndarray
    weights: np.ndarray
    transforms: np.ndarray
    faces: np.ndarray

    @property
    def frames(self) -> np.ndarray:
        return blend(self.rest, self.indices, self.weights, self.transforms)

    @property
    def skinning(self) -> ssdr.Skinning:
        return model(self.rest, self.indices, self.weights, self.transforms, faces=self.faces)


def model(rest, indices=None, weights=None, transforms=None, *, bones=None, **options):
    """Model of these parts; by default bone 0 moves all vertices and all bones are at rest."""
    if indices is None:
        indices, weights = np.zeros((len(rest), 1), dtype=int), np.ones((len(rest), 1))
    if transforms is None:
        count = int(indices.max()) + 1 if bones is None else bones
        transforms = np.tile(np.eye(3, 4), (1, count, 1, 1))
    return ssdr.Skinning(rest, indices, weights, transforms, **options)


def blend(rest, indices, weights, transforms):
    """Linear blend skinning by blending whole matrices."""
    dense = np.zeros((len(rest), transforms.shape[1]))
    np.add.at(dense, (np.arange(len(rest))[:, None], indices), weights)
    matrices = np.einsum("ij,tjab->tiab", dense, transforms)
    return np.einsum("tiab,ib->tia", matrices[..., :3], rest) + matrices[..., 3]


def in_solver(data, rest, transforms):
    """A rest pose and transforms in the solver's space of `data`."""
    align = data.alignment
    return align.points_from_world(rest, "rest"), align.moves_from_world(transforms, "transforms")


def rotation(*vector):
    """Rotation matrix of a rotation vector (radians)."""
    return Rotation.from_rotvec(vector).as_matrix()


def motions(rng, n_frames, n_bones, turn=0.6, shift=0.5):
    """Unrelated rigid transforms (F, B, 3, 4)."""
    r = Rotation.from_rotvec(turn * rng.standard_normal((n_frames * n_bones, 3))).as_matrix()
    t = shift * rng.standard_normal((n_frames, n_bones, 3, 1))
    return np.concatenate([r.reshape(n_frames, n_bones, 3, 3), t], axis=-1)


def weights_of(rng, n_vertices, n_bones, influences):
    """Random joints and weights, descending, some vertices with fewer influences."""
    k = min(influences, n_bones)
    indices = np.argsort(rng.random((n_vertices, n_bones)), axis=1)[:, :k]
    weights = rng.random((n_vertices, k)) ** 2
    weights[:, 1:][rng.random((n_vertices, k - 1)) < 0.3] = 0
    weights[:, 0] += 0.1
    weights /= weights.sum(axis=1, keepdims=True)
    order = np.argsort(-weights, axis=1, kind="stable")
    weights = np.take_along_axis(weights, order, axis=1)
    indices = np.take_along_axis(indices, order, axis=1)
    indices[weights == 0] = 0
    return indices.astype(np.int32), weights


def random_skinning(rng, rest, n_frames, n_bones, influences):
    """Frames (F, V, 3) of random weights under unrelated bones."""
    indices, weights = weights_of(rng, len(rest), n_bones, influences)
    return blend(rest, indices, weights, motions(rng, n_frames, n_bones))


def still(array):
    """Make an array read-only, since cached arrays are shared by tests."""
    array.setflags(write=False)
    return array


def chain(seed=0, *, bones=5, frames=20, rows=20, ring=6, bend=0.6):
    """A tube around a chain of hinges; neighbouring bones overlap, up to two a vertex."""
    rng = np.random.default_rng(seed)
    height, angle = np.meshgrid(
        np.linspace(0, bones, rows), np.linspace(0, 2 * np.pi, ring, endpoint=False), indexing="ij"
    )
    rest = np.stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), height], axis=-1).reshape(-1, 3)
    r, c = (a.ravel() for a in np.meshgrid(np.arange(rows - 1), np.arange(ring), indexing="ij"))
    i, j = r * ring + c, r * ring + (c + 1) % ring
    faces = np.concatenate([np.stack([i, j, i + ring], 1), np.stack([j, j + ring, i + ring], 1)])
    dense = np.maximum(0, 1 - np.abs(rest[:, 2:] - (np.arange(bones) + 0.5)))
    dense /= dense.sum(axis=1, keepdims=True)
    indices = np.argsort(-dense, axis=1, kind="stable")[:, : min(4, bones)]
    weights = np.take_along_axis(dense, indices, axis=1)
    indices[weights == 0] = 0
    axis, phase = rng.standard_normal((bones, 3)), rng.uniform(0, 6, (bones, 3))
    transforms = np.zeros((frames, bones, 3, 4))
    for t in range(frames):
        r, shift = np.eye(3), np.zeros(3)
        for b in range(bones):
            swing = bend * np.sin(0.35 * t + phase[b]) * axis[b] if t else np.zeros(3)
            hinge = rotation(*swing)
            pivot = np.array([0.0, 0.0, b])
            shift = shift + r @ (pivot - hinge @ pivot)
            r = r @ hinge
            transforms[t, b, :, :3], transforms[t, b, :, 3] = r, shift
    return Rig(rest, indices.astype(np.int32), weights, transforms, faces.astype(np.int32))


def wobble(rig, amount=0.02, seed=1):
    """Frames of a rig with a smooth motion on top that no rigid bones can make."""
    rng = np.random.default_rng(seed)
    frames = rig.frames
    t = np.arange(len(frames))[:, None, None]
    phase = rig.rest @ rng.standard_normal((3, 3))
    return frames + amount * np.sin(0.7 * t + phase[None])


def rippled(n_frames: int = 120) -> np.ndarray:
    """Frames of a bending chain with ripples that no bone can follow."""
    frames = chain(3, bones=4, frames=n_frames).frames
    t = np.arange(n_frames)[:, None, None]
    return frames + 0.01 * np.sin(7 * frames[..., [1, 2, 0]] + 0.2 * t)


def boxes(n_boxes=2, frames=12, points=30, seed=0):
    """Separate clouds of points, each moving rigidly by itself."""
    rng = np.random.default_rng(seed)
    rest = rng.standard_normal((n_boxes, points, 3)) + 6 * np.arange(n_boxes)[:, None, None]
    axis, way = rng.standard_normal((2, n_boxes, 3))
    transforms = np.zeros((frames, n_boxes, 3, 4))
    for t in range(frames):
        for b in range(n_boxes):
            centre = rest[b].mean(axis=0)
            transforms[t, b, :, :3] = r = rotation(*(0.2 * t * axis[b]))
            transforms[t, b, :, 3] = centre - r @ centre + 0.1 * t * way[b]
    indices = np.repeat(np.arange(n_boxes), points)[:, None]
    return Rig(
        rest.reshape(-1, 3),
        indices.astype(np.int32),
        np.ones((n_boxes * points, 1)),
        transforms,
        np.zeros((0, 3), dtype=np.int32),
    )


def pieces(count, frames=12, seed=0):
    """Separate strips of eight vertices, each moving rigidly by itself."""
    strip = np.arange(6)[:, None] + np.arange(3)
    faces = (8 * np.arange(count)[:, None, None] + strip).reshape(-1, 3)
    return dataclasses.replace(boxes(count, frames, 8, seed), faces=faces.astype(np.int32))


def grid(rows, columns):
    """Triangles of a sheet whose vertices lie row by row."""
    i = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def wings(frames=30, rows=31, columns=9):
    """A thin sheet that flaps and bends about its middle: frames and faces."""
    x, y = np.meshgrid(np.linspace(-3, 3, rows), np.linspace(-0.5, 0.5, columns), indexing="ij")
    y = y * (1 - 0.2 * np.abs(x) / 3)
    out = []
    for t in 2 * np.pi * np.arange(frames) / frames:
        a = 0.4 * np.sin(t - 0.6 * np.abs(x)) * np.abs(x)
        z = np.abs(x) * np.sin(a) + 0.2 * np.cos(t) + 0.3 * y * np.cos(t - np.abs(x))
        out.append(np.stack([x * np.cos(0.6 * a), y, z], axis=-1).reshape(-1, 3))
    return np.array(out), grid(rows, columns)


def cloth(frames=30, side=18):
    """A sheet with two waves: frames and faces."""
    x, y = np.meshgrid(*2 * [np.linspace(0, 2, side)], indexing="ij")
    out = []
    for t in 2 * np.pi * np.arange(frames) / frames:
        z = 0.25 * np.sin(3 * x - t) + 0.15 * np.cos(2 * y + 2 * t) * x
        out.append(np.stack([x + 0.05 * np.sin(3 * y + t), y, z], axis=-1).reshape(-1, 3))
    return np.array(out), grid(side, side)
