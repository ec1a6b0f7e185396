"""A garment on the body at rest, with its skin weights and mirror permutation, or from a file."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

import ssdr
from garmentnet.data.outfit import is_mirror
from ssdr.common.errors import InputError

from .body import Body

_ARMS = ("collar_l", "collar_r", "arm_l", "arm_r", "forearm_l", "forearm_r", "hand_l", "hand_r")
# Most joints that a pinned vertex follows.
_INFLUENCES = 6
# Body vertices from which the skin weights of a vertex are interpolated.
_NEAREST = 4
# Added to distances, metres, so that a vertex on the skin has no infinite weight.
_CLOSEST = 1e-3
# Largest distance, metres, of a vertex from the mirror image of its partner.
_MIRRORED = 1e-5
# Area of a triangle, metres², up to which it counts as 0.
_NO_AREA = 5e-13


@dataclasses.dataclass(frozen=True, eq=False)
class Garment:
    """A garment on the body at rest.

    Attributes
    ----------
    rest : (V, 3) float32
        Positions in metres; also the shape without strain, so that pleats stay.
    faces : (T, 3) int32
        Normals point outward.
    pinned : (V,) bool
        Vertices that follow the body.
    indices, weights : (V, K) int32 and float32
        Skin weights on the body's joints; pinned vertices move by them.
    mirror : (V,) int32 or None
        Mirror image of each vertex; None if the garment is not symmetric.
    sides : (V,) int8 or None
        1 on a left sleeve or leg, -1 on a right one, 0 elsewhere.  Vertices of one side have no
        contact with limbs of the other.  None stands for 0 everywhere.
    """

    rest: NDArray[np.float32]
    faces: NDArray[np.int32]
    pinned: NDArray[np.bool_]
    indices: NDArray[np.int32]
    weights: NDArray[np.float32]
    mirror: NDArray[np.int32] | None
    sides: NDArray[np.int8] | None = None

    @property
    def n_vertices(self) -> int:
        return len(self.rest)

    def edges(self) -> NDArray[np.int32]:
        """Unique edges ``(E, 2)``."""
        pairs = np.sort(self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        return np.asarray(np.unique(pairs, axis=0), dtype=np.int32)

    def edge_length(self) -> float:
        """Mean length of an edge, metres."""
        a, b = self.rest[self.edges()].astype(np.float64).swapaxes(0, 1)
        return float(np.linalg.norm(a - b, axis=1).mean())


def garment_from_mesh(body: Body, path: str | os.PathLike[str], *, pinned_above: float) -> Garment:
    """Garment from the first frame of a mesh file, in metres, y up, placed on the body at rest.

    Parameters
    ----------
    body : Body
    path : path
        Any file that :func:`ssdr.load` reads.
    pinned_above : float
        Vertices at or above this height follow the body.

    Raises
    ------
    InputError
        If the mesh has no triangles or one without area, or no vertex or every vertex is pinned.
    """
    mesh = ssdr.load(path)
    if len(mesh.faces) == 0:
        raise InputError("path", "a mesh with triangles", str(path))
    mesh, _ = mesh.weld()
    rest = np.asarray(mesh.frames(0), dtype=np.float64)
    faces = mesh.faces
    pinned = rest[:, 1] >= pinned_above
    if not pinned.any() or pinned.all():
        raise InputError(
            "pinned_above",
            f"a height between {rest[:, 1].min():.3f} and {rest[:, 1].max():.3f}",
            pinned_above,
        )
    flat = int((trimesh.triangles.area(rest[faces]) <= _NO_AREA).sum())
    if flat:
        raise InputError("path", "triangles with an area", f"{flat} without")
    mirror = mirror_permutation(rest, faces)
    indices, weights = follow(body, rest, mirror)
    return Garment(
        rest.astype(np.float32), faces, pinned, indices, weights.astype(np.float32), mirror
    )


def mirror_permutation(rest: ArrayLike, faces: ArrayLike) -> NDArray[np.int32] | None:
    """Image ``(V,)`` of each vertex in the plane x = 0; None if the mesh is not symmetric.

    Examples
    --------
    >>> mirror_permutation([[1, 0, 0], [-1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).tolist()
    [1, 0, 2]
    """
    points, triangles = np.asarray(rest, dtype=np.float64), np.asarray(faces)
    tree: Any = cKDTree(points)
    distance, nearest = tree.query(points * [-1, 1, 1])
    if distance.max() > _MIRRORED or not is_mirror(nearest, triangles, len(points)):
        return None
    return np.asarray(nearest, dtype=np.int32)


def arm_weight(body: Body) -> NDArray[np.float64]:
    """Sum ``(V,)`` of the weights of the arms' joints at every body vertex."""
    dense = body.skinning.dense_weights()
    arms = [body.skinning.names().index(n) for n in _ARMS]
    return np.asarray(dense[:, arms].sum(axis=1), dtype=np.float64)


def follow(
    body: Body,
    rest: NDArray[np.float64],
    mirror: NDArray[np.int32] | None,
    *,
    shoulders: bool = False,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Joints and weights of points near the body, interpolated from the nearest body vertices.

    Vertices of the arms are used only with `shoulders`.
    """
    rig = body.skinning
    dense = rig.dense_weights().astype(np.float64)
    usable = np.flatnonzero((arm_weight(body) < 0.5) | shoulders)
    tree: Any = cKDTree(rig.rest[usable].astype(np.float64))
    distance, nearest = tree.query(rest, k=_NEAREST)
    near = 1 / (distance + _CLOSEST)
    weights = (dense[usable][nearest] * near[..., None]).sum(axis=1) / near.sum(axis=1)[:, None]
    if mirror is not None:
        weights = (weights + weights[mirror][:, body.skeleton.mirror()]) / 2
    order = np.argsort(-weights, axis=1, kind="stable")[:, :_INFLUENCES]
    largest = np.take_along_axis(weights, order, axis=1)
    largest /= largest.sum(axis=1, keepdims=True)
    return np.where(largest > 0, order, 0).astype(np.int32), largest
