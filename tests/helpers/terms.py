"""Strain of the rest pose and error of normals in the objective: naive twins and small problems."""

from __future__ import annotations

import dataclasses

import numpy as np

import ssdr
from helpers import motions, naive
from ssdr.solver import objective, rest_surface
from ssdr.solver.alternation import bone_step, vertex_step
from ssdr.solver.initialization import with_rest_normals
from ssdr.solver.model import FREE, Constraints, Model
from ssdr.solver.rest_surface import RestSurface
from ssdr.solver.trajectories import Trajectories, gather

# The numbers that are chosen, not derived.
STRENGTH = rest_surface._STRENGTH
UNSEEN = objective._UNSEEN


def edges_of(faces):
    """Pairs (i, j), i < j, of the vertices that an edge joins."""
    found = {(min(i, j), max(i, j)) for a, b, c in faces for i, j in ((a, b), (b, c), (c, a))}
    return sorted((int(i), int(j)) for i, j in found if i != j)


def strain(rest, pose, faces):
    """Change of the edges of a mesh without seams, relative to the edges of the pose."""
    edges = edges_of(faces)
    squares = [float(((pose[i] - pose[j]) ** 2).sum()) for i, j in edges]
    mean = sum(squares) / len(squares)
    changed = whole = 0.0
    for (i, j), square in zip(edges, squares, strict=True):
        weight = 1.0 / (square + 0.1 * mean)
        changed += weight * float((((rest[i] - rest[j]) - (pose[i] - pose[j])) ** 2).sum())
        whole += weight * square
    return changed / whole


def frame_normals(frames, faces):
    """Unit normals (F, V, 3) of the vertices; 0 where there is none."""
    out = np.zeros(frames.shape)
    for t, points in enumerate(frames):
        corners = naive.corner_normals(points, faces)
        for face, normals in zip(faces, corners, strict=True):
            out[t, face] = normals
    return out


def turned_normals(normals, indices, weights, transforms):
    """Rest normals (V, 3) as an engine turns them, before they get unit length, (F, V, 3)."""
    still = np.array(transforms)
    still[..., 3] = 0.0
    return naive.skin(normals, indices, weights, still)


def value(data: Trajectories, model: Model, pose=None) -> float:
    """Objective of a model by loops, for data that are not compressed; no penalties."""
    frames = np.stack([data.frame(t) for t in range(data.n_frames)])
    parts = model.indices, model.weights, model.transforms
    counts = data.frame_scale[:, None, None] ** 2 * data.importance[None, :, None]
    out = data.slack + float((counts * (naive.skin(model.rest, *parts) - frames) ** 2).sum())
    if pose is not None:
        out *= 1.0 + STRENGTH * strain(model.rest, pose, data.faces)
    if model.normals.shape[1]:
        gap = turned_normals(model.normals[:, 0], *parts) - frame_normals(frames, data.faces)
        mean = float((counts * gap**2).sum()) / (data.n_frames * data.n_vertices)
        out *= 1.0 + mean / UNSEEN
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """What a problem has beyond positions."""

    surface: bool = True
    normals: bool = True
    compressed: bool = False
    counts: str = "equal"
    slack: float = 0.0  # relative to the error of the model
    constraints: Constraints = FREE


def problem(
    case: Case, seed: int = 0, *, n: int = 80, frames: int = 24, bones: int = 3
) -> tuple[Trajectories, Model]:
    """A closed crumpled mesh under blended bones, with noise, and a model after two alternations.

    Each vertex may follow every bone, so that no step has to drop an influence.
    """
    rng = np.random.default_rng(seed)
    rest = rng.standard_normal((n, 3))
    ring = np.arange(n)
    faces = np.stack([ring, (ring + 1) % n, (ring + 2) % n], axis=1)
    x = motions.random_skinning(rng, rest, frames, bones + 1, 3)
    x += (1e-4 if case.compressed else 0.1) * rng.standard_normal(x.shape)
    importance = {"equal": None, "some": 0.2 + rng.random(n), "few": (rng.random(n) < 0.6) * 1.0}
    data = gather(
        [ssdr.MeshSequence(x, faces)],
        bones=bones,
        vertex_importance=importance[case.counts],
        frame_importance=None if case.counts == "equal" else 0.3 + rng.random(frames),
        compress=False,
    )
    pose = data.frame(0)
    if case.surface:
        data = dataclasses.replace(data, surface=RestSurface.build(data.faces, pose))
    if case.compressed:
        data = data.compressed(bones)
        assert data.q is not None
    moves = motions.motions(rng, frames, bones, turn=0.2, shift=0.1)
    model = Model.start(moves, pose, rng.integers(0, bones, n), bones)
    for _ in range(2):
        vertex_step(data, model)
        bone_step(data, model)
    vertex_step(data, model)
    if case.normals:
        data = data.with_normals()
        model = with_rest_normals(data, model)
    data = dataclasses.replace(data, slack=case.slack * model.weighted_error(data))
    return data, model
