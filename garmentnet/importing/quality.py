"""The quality gate: measurements of a clip, and limits beyond which it is refused.

Cloth is refused that is caught (an edge stays long for a second), that stays folded, that crosses
the body, or that has lost its pins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from ssdr.mesh.edges import triangle_edges

from ..collision.body_tree import INSIDE, BodyTree, is_closed
from ..collision.crossings import find_crossings
from ..data.outfit import Outfit
from ..data.skin_weights import BodyBound

# The largest values with which a clip is accepted.
LIMITS = {
    "stretch_p99": 1.5,  # length of an edge over that at rest, of edges with a free end
    "stretch_max": 4.0,
    "stretch_held": 2.0,  # of the edge that is longest for a whole second
    "folded": 180.0,  # degrees that an edge is folded farther than at rest, for three seconds
    "inside_fraction": 0.02,  # of the vertices, more than half a millimetre below the skin
    "depth_max": 0.05,  # metres below the skin
    "speed_max": 40.0,  # metres a second
    "crossed": 0.02,  # metres that a triangle of the body crosses one of the cloth, for a second
    "pins_off": 0.01,  # metres that a pinned vertex is from where the body carries it
}
# Distance from the skin, metres, up to which vertices outside are measured.
_LOOK = 1e-3
# Frames from one search for crossings or folds to the next; seconds that a fold lasts.
_EVERY, _FOLDED = 3, 3
_AT_ONCE = 10_000_000  # stretches that are computed at once
_SHORT = 0.05  # of the mean length: shorter edges, as slivers at seams have, count as so long


def judge(
    outfit: Outfit,
    joints: NDArray[np.floating],
    vertices: NDArray[np.float32],
    *,
    bound: BodyBound | None = None,
    limits: Mapping[str, float] = LIMITS,
) -> dict[str, Any]:
    """Measurements of a clip by name, with ``accepted`` and, if it is refused, the ``reason``.

    Without a closed mesh of the body nothing counts as inside.

    Parameters
    ----------
    outfit : Outfit
    joints : (F, J, 3, 4) array
    vertices : (F, V, 3) float32
    bound : BodyBound, optional
        Vertices that follow the body; by default those that the outfit says are pinned, whose
        places are not tested.
    limits : mapping, optional
        Largest values by name.
    """
    bad = ~np.isfinite(vertices).all(axis=(1, 2))
    if bad.any():
        return {"accepted": False, "reason": f"NaN from frame {bad.argmax()} on"}
    body, m = outfit.body, np.asarray(joints, np.float64)
    held, off = outfit.pinned, np.zeros(1)
    if bound is not None:
        held = np.isin(np.arange(outfit.n_vertices), bound.index)
        off = np.linalg.norm(bound.place(vertices, m) - vertices, axis=2)
    edges = triangle_edges(outfit.faces, outfit.n_vertices)
    rest = _lengths(outfit.rest[None], edges)[0]
    free = ~held[edges].all(axis=1)
    edges, rest = edges[free], np.maximum(rest, _SHORT * rest.mean())[free]
    beside = outfit.faces[trimesh.graph.face_adjacency(outfit.faces)]
    beside = beside[~held[beside].all(axis=(1, 2))]
    second, count = min(len(vertices), round(outfit.fps)), len(vertices) * len(edges)
    longest = lasting = folded = 0.0
    sample: list[NDArray[Any]] = [np.ones(1)]
    for part in np.array_split(np.arange(len(edges)), 1 + count // _AT_ONCE):
        stretch = _lengths(vertices, edges[part]) / rest[part]
        longest = max(longest, stretch.max(initial=0.0))
        lasting = max(lasting, _held(stretch, second))
        sample.append(stretch.ravel()[:: 1 + count // _AT_ONCE])
    depth, crossed = np.zeros(vertices.shape[:2]), 0.0
    if is_closed(body.faces):
        depth = -BodyTree(body).signed_distance(vertices, m, limit=_LOOK)
    if len(body.faces):
        found = find_crossings(body, outfit.faces, vertices[::_EVERY], m[::_EVERY], pinned=held)
        crossed = _held(found.depth[:, None], min(len(found.depth), math.ceil(second / _EVERY)))
    for part in np.array_split(beside, 1 + count // _AT_ONCE):
        fold = _folds(part, vertices[::_EVERY]) - _folds(part, outfit.rest[None])
        folded = max(folded, _held(fold, round(_FOLDED * outfit.fps / _EVERY)))
    measured = {
        "stretch_p99": np.percentile(np.concatenate(sample), 99),
        "stretch_max": longest,
        "stretch_held": lasting,
        "folded": folded,
        "inside_fraction": (depth[:, ~held] > INSIDE).sum() / depth.size,
        "depth_max": depth[:, ~held].max(initial=0.0),
        "speed_max": np.linalg.norm(np.diff(vertices, axis=0), axis=2).max(initial=0) * outfit.fps,
        "crossed": crossed,
        "pins_off": off.max(),
    }
    over = [f"{k} {measured[k]:.4g} > {most:g}" for k, most in limits.items() if measured[k] > most]
    # Six digits, so that the stored numbers do not depend on the order of a sum.
    rounded = {k: float(f"{v:.6g}") for k, v in measured.items()}
    return {"accepted": not over, "reason": "; ".join(over), **rounded}


def _lengths(vertices: NDArray[np.float32], edges: NDArray[np.integer]) -> NDArray[np.float32]:
    return np.asarray(np.linalg.norm(vertices[:, edges[:, 0]] - vertices[:, edges[:, 1]], axis=2))


def _held(values: NDArray[np.floating], frames: int) -> float:
    """The largest value that is reached or exceeded in so many frames on end."""
    least = minimum_filter1d(values, frames, axis=0, mode="constant", cval=-np.inf)
    return float(least.max(initial=0.0))


def _folds(corners: NDArray[np.integer], v: NDArray[np.float32]) -> NDArray[Any]:
    """Fold angles (F, n), degrees, 0 if flat, of pairs of triangles with corners (n, 2, 3)."""
    a, b, c = np.moveaxis(v[:, corners], 3, 0)
    p, q = np.moveaxis(np.cross(b - a, c - a), 2, 0)
    angle = np.arctan2(np.linalg.norm(np.cross(p, q), axis=2), (p * q).sum(axis=2))
    return np.asarray(np.degrees(angle))
