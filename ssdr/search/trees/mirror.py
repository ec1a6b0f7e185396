"""The plane of symmetry of a rest pose, and pairs of bones that mirror each other."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ...model.transforms import rest_diagonal

Array = NDArray[np.float64]
_MOST_POINTS = 4000  # most vertices by which planes are compared
_ROUNDS = 12  # most rounds of pairing vertices with their images and fitting the plane to the pairs
# Share of the pairs, the closest, to which a plane is fitted: a bent arm must not tilt the plane.
_KEPT = 0.8
# Largest distances of an image from the nearest vertex, in diagonals: the median, and the quantile
# _NEARLY_ALL.
_MOST_GAP, _MOST_OUTSIDE = 0.005, 0.02
_NEARLY_ALL = 0.95
_ALIKE = 0.5  # least cosine between a bone's weights and the mirror image of its partner's


@dataclasses.dataclass(frozen=True, eq=False)
class Mirror:
    """A plane of symmetry of a rest pose, and the partners of the bones.

    Attributes
    ----------
    normal : (3,) array
        Unit normal, its largest component positive.
    offset : float
        Points of the plane have ``x @ normal == offset``.
    partners : (B,) int array
        Index of the bone that mirrors each bone: its own index if it lies in the middle, -1 if no
        bone mirrors it.
    """

    normal: Array
    offset: float
    partners: NDArray[np.int64]

    def image(self, points: ArrayLike) -> Array:
        """Mirror images of points (..., 3)."""
        return _reflected(np.asarray(points, dtype=np.float64), self.normal, self.offset)


def find_mirror(
    rest: ArrayLike, indices: NDArray[np.integer], weights: NDArray[np.floating], n_bones: int
) -> Mirror | None:
    """Find the plane of symmetry of a model's rest pose; None if there is none.

    The mirror images of half of the vertices must lie at most 0.5 % of the diagonal away from some
    vertex, and those of 95 % at most 2 %.  Candidates are the planes through the centroid normal to
    x, y, z and the principal axes.  Each is refined in turns: vertices are paired with the vertices
    nearest to their images, and the plane is fitted to the pairs.
    """
    points = np.asarray(rest, dtype=np.float64)
    size = rest_diagonal(points)
    if not size > 0:
        return None
    every = cKDTree(points)
    some = points[np.linspace(0, len(points) - 1, min(len(points), _MOST_POINTS)).astype(int)]
    middle = points.mean(axis=0)
    axes = np.vstack([np.eye(3), np.linalg.eigh(np.cov((points - middle).T))[1].T])
    found = [_fitted(some, every, axis, float(axis @ middle)) for axis in axes]
    good = [f for f in found if f[2] <= _MOST_GAP * size and f[3] <= _MOST_OUTSIDE * size]
    if not good:
        return None
    normal, offset, _, _ = min(good, key=lambda f: f[2])
    normal = np.where(np.abs(normal) < 1e-12, 0.0, normal)
    if normal[np.abs(normal).argmax()] < 0:
        normal, offset = -normal, -offset
    near = np.asarray(every.query(_reflected(points, normal, offset))[1])
    dense = np.zeros((len(points), n_bones))
    np.add.at(dense, (np.arange(len(points))[:, None], indices), weights)
    return Mirror(normal, offset, _partners(dense, near))


def edges_with_image(mirror: Mirror, parents: NDArray[np.integer]) -> dict[int, bool]:
    """Dict that tells of a bone whether the mirror image of the edge to its parent is an edge, too.

    Keys are the bones that have a partner and whose parent has one.
    """
    edges = {b: frozenset((b, int(a))) for b, a in enumerate(parents) if a >= 0}
    there = set(edges.values())
    return {
        b: frozenset(int(mirror.partners[k]) for k in edge) in there
        for b, edge in edges.items()
        if all(mirror.partners[k] >= 0 for k in edge)
    }


def _reflected(points: Array, normal: Array, offset: float) -> Array:
    distance = points @ normal - offset
    return np.asarray(points - 2 * distance[..., None] * normal)


def _fitted(
    points: Array, every: cKDTree, normal: Array, offset: float
) -> tuple[Array, float, float, float]:
    """Refine the plane x · `normal` = `offset`; return normal, offset, and two quantiles of gaps.

    The gaps are the distances of the mirrored points from the nearest point of `every`.  The
    quantiles are their median and that of 95 %.
    """
    best = (normal, offset, np.inf, np.inf)
    for _ in range(_ROUNDS):
        gap, near = map(np.asarray, every.query(_reflected(points, normal, offset)))
        median, most = (float(q) for q in np.quantile(gap, (0.5, _NEARLY_ALL)))
        if not median < best[2]:
            break
        best = (normal, offset, median, most)
        keep = gap <= np.quantile(gap, _KEPT)
        p, q = points[keep], every.data[near[keep]]
        # Σ |H (p − m) − (q − m)|² with m on the plane is least for the eigenvector of the
        # smallest eigenvalue of Σ (p − m) (q − m)ᵀ + its transpose.
        m = 0.5 * (p.mean(axis=0) + q.mean(axis=0))
        cross = (p - m).T @ (q - m)
        normal = np.linalg.eigh(cross + cross.T)[1][:, 0]
        offset = float(normal @ m)
    return best


def _partners(dense: Array, near: NDArray[np.intp]) -> NDArray[np.int64]:
    """Index (B,) of each bone's partner, or -1, found by comparing weights with mirrored weights.

    `dense` (V, B) are the weights; `near` (V,) is the index of the vertex nearest to each image.
    """
    from scipy.optimize import linear_sum_assignment

    image = dense[near]
    length = np.linalg.norm(dense, axis=0)
    other = np.linalg.norm(image, axis=0)
    product = length[:, None] * other
    alike = (dense.T @ image) / np.where(product > 0, product, 1.0)
    alike = 0.5 * (alike + alike.T)
    _, chosen = linear_sum_assignment(-alike)
    bones = np.arange(len(chosen))
    mutual = (chosen[chosen] == bones) & (alike[bones, chosen] > _ALIKE)
    return np.where(mutual, chosen, -1).astype(np.int64)
