"""The plane of symmetry of a rest pose, and pairs of bones that mirror each other."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ..errors import InputError
from ..hierarchy.transforms import rest_diagonal
from ..representation import short_repr
from ..skinning import Skinning

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
_ASIDE = 0.01  # distance from the plane, in diagonals, from which a bone is on one side


@dataclasses.dataclass(frozen=True, eq=False)
class Mirror:
    """A plane of symmetry of a rest pose, with partners and sides of the bones.

    Attributes
    ----------
    normal : (3,) array
        Unit normal, its largest component positive.
    offset : float
        Points of the plane have ``x @ normal == offset``.
    gap : float
        Mean distance between a vertex's image and the vertex nearest to it.
    partners : (B,) int array
        Index of the bone that mirrors each bone: its own index if it lies in the middle, -1 if no
        bone mirrors it.
    sides : (B,) int array
        1 for bones on the side to which `normal` points, -1 on the other side, 0 in the middle.

    Examples
    --------
    >>> one = np.zeros(1, int)
    >>> mirror = ssdr.Mirror(np.array([1.0, 0, 0]), 0.0, gap=0.0, partners=one, sides=one)
    >>> mirror.image([0.5, 1, 2]).tolist()
    [-0.5, 1.0, 2.0]
    """

    normal: Array
    offset: float
    gap: float
    partners: NDArray[np.int64]
    sides: NDArray[np.int64]

    __repr__ = short_repr

    def image(self, points: ArrayLike) -> Array:
        """Mirror images of points (..., 3)."""
        return _reflected(np.asarray(points, dtype=np.float64), self.normal, self.offset)


def find_mirror(skinning: Skinning) -> Mirror | None:
    """Find the plane of symmetry of the rest pose; None if there is none.

    The mirror images of half of the vertices must lie at most 0.5 % of the diagonal away from some
    vertex, and those of 95 % at most 2 %.  Candidates are the planes through the centroid normal to
    x, y, z and the principal axes.  Each is refined in turns: vertices are paired with the vertices
    nearest to their images, and the plane is fitted to the pairs.

    Parameters
    ----------
    skinning : Skinning

    Returns
    -------
    Mirror or None

    Raises
    ------
    InputError
        If there is only one vertex.

    Examples
    --------
    >>> rest = np.array([[-1, 0, 0], [1, 0, 0], [-1, 1, 0], [1, 1, 0], [0, 3, 1.0]])
    >>> indices = np.array([[0], [1], [0], [1], [2]])
    >>> still = np.broadcast_to(np.eye(3, 4), (2, 3, 3, 4))
    >>> mirror = ssdr.find_mirror(ssdr.Skinning(rest, indices, np.ones((5, 1)), still))
    >>> mirror.normal.tolist(), mirror.partners.tolist(), mirror.sides.tolist()
    ([1.0, 0.0, 0.0], [1, 0, 2], [-1, 1, 0])
    """
    if skinning.n_vertices < 2:
        raise InputError("rest", "2 vertices or more", str(skinning.n_vertices))
    return mirror_of(skinning.rest, skinning.indices, skinning.weights, skinning.n_bones)


def mirror_of(
    rest: ArrayLike, indices: NDArray[np.integer], weights: NDArray[np.floating], n_bones: int
) -> Mirror | None:
    """As :func:`find_mirror`, given a model's arrays; None also for a single vertex."""
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
    gap, near = map(np.asarray, every.query(_reflected(points, normal, offset)))
    dense = np.zeros((len(points), n_bones))
    np.add.at(dense, (np.arange(len(points))[:, None], indices), weights)
    partners = _partners(dense, near)
    mass = dense.sum(axis=0)
    where = (dense.T @ (points @ normal - offset)) / np.where(mass > 0, mass, 1.0)
    sides = np.where(np.abs(where) > _ASIDE * size, np.sign(where), 0).astype(np.int64)
    sides[partners == np.arange(n_bones)] = 0
    return Mirror(normal, offset, float(gap.mean()), partners, sides)


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


def mirrored_edges(mirror: Mirror, parents: NDArray[np.integer]) -> tuple[int, int]:
    """Number of edges whose mirror image is an edge, and number of edges that have a mirror image.

    An edge has a mirror image if both of its bones have partners.
    """
    there = edges_with_image(mirror, parents)
    return sum(there.values()), len(there)


def side_names(mirror: Mirror | None, n_bones: int, stem: str = "joint") -> tuple[str, ...]:
    """Names of joints; two that mirror each other share a number and end in ``_L`` and ``_R``.

    ``_L`` is the side to which the mirror's normal points.  For the plane x = 0 that is the side of
    positive x, the left of a character that faces +z with y up (glTF) or -y with z up (Blender).
    """
    digits = len(str(n_bones - 1))
    names = [f"{stem}_{k:0{digits}d}" for k in range(n_bones)]
    if mirror is not None:
        for b, other in enumerate(mirror.partners.tolist()):
            if other > b and mirror.sides[b] * mirror.sides[other] < 0:
                left, right = (b, other) if mirror.sides[b] > 0 else (other, b)
                names[left], names[right] = f"{names[b]}_L", f"{names[b]}_R"
    return tuple(names)


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
