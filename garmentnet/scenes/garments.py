"""Garments: a flared, pleated dress at any resolution, or a mesh from a file.

The dress is cut around the body in its rest pose.  One half is built ring by ring and reflected, so
that the permutation that swaps left and right is exact.
"""

from __future__ import annotations

import dataclasses
import itertools
import os
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import ConvexHull, cKDTree

import ssdr
from ssdr.errors import InputError

from ..data.skin_weights import strongest
from .body import Body

__all__ = ["Dress", "Garment", "cut_dress", "garment_from_mesh", "mirror_permutation"]

_ARMS = ("collar_l", "collar_r", "arm_l", "arm_r", "forearm_l", "forearm_r", "hand_l", "hand_r")
# Joints that a pinned vertex follows: those of the body vertices around it.
_INFLUENCES = 6
# Body vertices from which the skin weights of a vertex are interpolated.
_NEAREST = 4
# Metres; added to distances, so that a vertex on the skin has no infinite weight.
_CLOSEST = 1e-3
# Twice the area of a triangle, metres², that counts as none.
_NO_AREA = 1e-12
# Height of an equilateral triangle of side 1, the distance between rings of vertices.
_ROW = np.sqrt(3) / 2


@dataclasses.dataclass(frozen=True)
class Dress:
    """Cut of the dress; heights are fractions of the body's height.

    Parameters
    ----------
    vertices : int
        Approximate number; the cut comes within a few per cent.
    top, waist, hem : float
        Heights of the upper edge, of the start of the skirt (vertices above are pinned to the
        body) and of the lower edge.
    flare : float
        Growth of the skirt's radius for a metre of height, metres.
    pleats : int
        Folds around the skirt.
    pleat_depth : float
        Their depth at the hem, a fraction of the radius; 0 at the waist.
    clearance : float
        Distance between the bodice and the body, metres.

    Raises
    ------
    InputError
        If a number is out of its range.

    Examples
    --------
    >>> Dress(vertices=500, pleats=12).hem
    0.275
    """

    vertices: int = 1900
    top: float = 0.745
    waist: float = 0.575
    hem: float = 0.275
    flare: float = 0.42
    pleats: int = 8
    pleat_depth: float = 0.12
    clearance: float = 0.012

    def __post_init__(self) -> None:
        if not 200 <= self.vertices <= 200_000:
            raise InputError("vertices", "200 to 200000", self.vertices)
        if not 0.05 <= self.hem < self.waist - 0.02 < self.top - 0.04 < 0.8:
            raise InputError(
                "hem, waist, top",
                "rising fractions of the height from 0.05 to 0.8",
                (self.hem, self.waist, self.top),
            )
        for name, low, high in (
            ("flare", 0, 2),
            ("pleats", 0, 40),
            ("pleat_depth", 0, 0.4),
            ("clearance", 0.003, 0.1),
        ):
            if not low <= getattr(self, name) <= high:
                raise InputError(name, f"{low} to {high}", getattr(self, name))


@dataclasses.dataclass(frozen=True, eq=False)
class Garment:
    """A garment on the body at rest.

    Attributes
    ----------
    rest : (V, 3) float32
        Metres; also the shape without strain, so that pleats stay.
    faces : (T, 3) int32
        Normals point outward.
    pinned : (V,) bool
        Vertices that follow the body.
    joints, weights : (V, K) int32 and float32
        Skin weights on the body's joints; pinned vertices move by them.
    mirror : (V,) int32 or None
        The vertex on the other side of each.
    """

    rest: NDArray[np.float32]
    faces: NDArray[np.int32]
    pinned: NDArray[np.bool_]
    indices: NDArray[np.int32]
    weights: NDArray[np.float32]
    mirror: NDArray[np.int32] | None

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


def cut_dress(body: Body, dress: Dress | None = None) -> Garment:
    """Cut the flared dress for a body.

    The bodice follows the convex hull of the body's cross sections at a distance of `clearance`.
    Below the waist the radius grows by `flare` and is multiplied by
    ``1 + pleat_depth t cos(pleats θ)``, with t from 0 at the waist to 1 at the hem.

    Raises
    ------
    InputError
        If the cut cannot have that many vertices.

    Examples
    --------
    >>> from garmentnet.scenes.body import default_body
    >>> garment = cut_dress(default_body(), Dress(vertices=300))
    >>> abs(garment.n_vertices - 300) < 30, garment.mirror is not None
    (True, True)
    """
    cut = dress or Dress()
    outline = _outline(body, cut)
    low, high = 0.002, 0.2  # metres: the spacings of the largest and the smallest dress lie between
    halves: list[NDArray[np.float64]] = []
    # The number of vertices falls with the spacing in steps: bisect, and take the closest.
    best = None
    for _ in range(40):  # halves the range of spacings on a logarithmic scale
        spacing = np.sqrt(low * high)
        halves = _rings(body, cut, outline, spacing)
        count = sum(2 * len(r) - 2 for r in halves)
        if best is None or abs(count - cut.vertices) < best[0]:
            best = (abs(count - cut.vertices), halves)
        if count > cut.vertices:
            low = spacing
        else:
            high = spacing
    assert best is not None
    if best[0] > 0.1 * cut.vertices:
        raise InputError("vertices", "a number that this cut can have", cut.vertices)
    halves = best[1]
    rest, faces, mirror = _reflect(halves)
    pinned = rest[:, 1] >= cut.waist * body.height() - 1e-9
    indices, weights = _follow(body, rest, mirror)
    return Garment(
        rest.astype(np.float32), faces, pinned, indices, weights.astype(np.float32), mirror
    )


def garment_from_mesh(body: Body, path: str | os.PathLike[str], *, pinned_above: float) -> Garment:
    """A garment from a mesh file: its first frame, metres, y up, on the body at rest.

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
        If it has no triangles or one without area, or nothing or everything is pinned.
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
    area = np.linalg.norm(
        np.cross(rest[faces[:, 1]] - rest[faces[:, 0]], rest[faces[:, 2]] - rest[faces[:, 0]]),
        axis=1,
    )
    if not (area > _NO_AREA).all():
        raise InputError(
            "path", "triangles with an area", f"{int((area <= _NO_AREA).sum())} without"
        )
    mirror = mirror_permutation(rest, faces)
    indices, weights = _follow(body, rest, mirror)
    return Garment(
        rest.astype(np.float32), faces, pinned, indices, weights.astype(np.float32), mirror
    )


def mirror_permutation(
    rest: ArrayLike, faces: ArrayLike, *, tolerance: float = 1e-5
) -> NDArray[np.int32] | None:
    """The vertex ``(V,)`` on the other side of each, or None where the mesh is not symmetric.

    Parameters
    ----------
    rest : (V, 3) array
    faces : (T, 3) int array
    tolerance : float
        Distance in metres that a vertex may have from the mirror image of its partner in the
        plane x = 0.

    Examples
    --------
    >>> mirror_permutation([[1, 0, 0], [-1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).tolist()
    [1, 0, 2]
    """
    points, triangles = np.asarray(rest, dtype=np.float64), np.asarray(faces)
    distance, nearest = _nearest(points, points * [-1, 1, 1], 1)
    distance, nearest = distance[:, 0], nearest[:, 0]
    order = np.arange(len(points))
    if distance.max() > tolerance or not np.array_equal(nearest[nearest], order):
        return None
    turned = {tuple(sorted(f)) for f in nearest[triangles].tolist()}
    if turned != {tuple(sorted(f)) for f in triangles.tolist()}:
        return None
    return np.asarray(nearest, dtype=np.int32)


def _outline(body: Body, cut: Dress) -> Callable[[float, NDArray[np.float64]], NDArray[np.float64]]:
    """Points ``(n, 2)`` x and z of the bodice at a height, at angles from the front."""
    rig = body.skinning
    arms = _arm_weight(body) > 0.5
    torso = ~arms[rig.faces].any(axis=1)
    rest, faces = rig.rest.astype(np.float64), rig.faces[torso]
    height = body.height()
    # Sections every 10 mm, from 20 mm below the waist to 20 mm above the upper edge.
    levels = np.arange(cut.waist * height - 0.02, cut.top * height + 0.021, 0.01)
    angle = np.linspace(0, np.pi, 65)
    direction = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    centre, radius = np.empty(len(levels)), np.empty((len(levels), len(angle)))
    for k, y in enumerate(levels):
        points = _section(rest, faces, float(y))
        points = np.concatenate([points, points * [-1, 1]])
        centre[k] = (points[:, 1].min() + points[:, 1].max()) / 2
        hull = ConvexHull(points - [0, centre[k]]).equations
        toward = direction @ hull[:, :2].T
        with np.errstate(divide="ignore"):
            hit = np.where(toward > 1e-9, -hull[:, 2] / toward, np.inf)
        radius[k] = hit.min(axis=1)
    # Smoothed over about 30 mm of height and 2.5 sections, and over 2 of the 64 angles.
    centre = gaussian_filter1d(centre, 3, mode="nearest")
    # An even function of the angle, so that both halves meet without a kink.
    even = np.concatenate([radius[:, :0:-1], radius[:, :-1]], axis=1)
    even = gaussian_filter1d(gaussian_filter1d(even, 2.5, axis=0, mode="nearest"), 2, mode="wrap")
    radius = np.maximum(even[:, 64:], radius[:, :-1]) + cut.clearance
    radius = np.concatenate([radius, even[:, :1] + cut.clearance], axis=1)

    def at(y: float, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        middle = float(np.interp(y, levels, centre))
        row = np.array([np.interp(y, levels, radius[:, i]) for i in range(len(angle))])
        r = np.interp(theta, angle, row)
        return np.stack([r * np.sin(theta), middle + r * np.cos(theta)], axis=1)

    return at


def _arm_weight(body: Body) -> NDArray[np.float64]:
    """Weight ``(V,)`` of the arms' joints on every body vertex."""
    dense = body.skinning.dense_weights()
    arms = [body.skinning.names().index(n) for n in _ARMS]
    return np.asarray(dense[:, arms].sum(axis=1), dtype=np.float64)


def _section(rest: NDArray[np.float64], faces: NDArray[np.int32], y: float) -> NDArray[np.float64]:
    """Points ``(n, 2)`` x and z in which the mesh's edges cross a height."""
    pairs = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    a, b = rest[pairs[:, 0]], rest[pairs[:, 1]]
    cut = (a[:, 1] < y) != (b[:, 1] < y)
    a, b = a[cut], b[cut]
    t = ((y - a[:, 1]) / (b[:, 1] - a[:, 1]))[:, None]
    return np.asarray((a + t * (b - a))[:, [0, 2]])


def _rings(
    body: Body,
    cut: Dress,
    outline: Callable[[float, NDArray[np.float64]], NDArray[np.float64]],
    spacing: float,
) -> list[NDArray[np.float64]]:
    """Half rings ``(m, 3)`` from the top down, from the front (x = 0) to the back (x = 0)."""
    height = body.height()
    top, waist, hem = (s * height for s in (cut.top, cut.waist, cut.hem))
    step = spacing * _ROW
    upper = max(1, round((top - waist) / step))
    slant = (waist - hem) * np.hypot(1, cut.flare)
    lower = max(2, round(slant / step))
    levels = np.concatenate(
        [np.linspace(top, waist, upper + 1)[:-1], np.linspace(waist, hem, lower + 1)]
    )
    theta = np.linspace(0, np.pi, 721)
    rings = []
    for y in levels:
        xz = outline(max(y, waist), theta)
        if y < waist:
            t = (waist - y) / (waist - hem)
            middle = np.array([0.0, (xz[0, 1] + xz[-1, 1]) / 2])
            arm = xz - middle
            r = np.linalg.norm(arm, axis=1, keepdims=True)
            wave = 1 + cut.pleat_depth * t * np.cos(cut.pleats * theta)[:, None]
            xz = middle + arm / r * (r + cut.flare * (waist - y)) * wave
        length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(xz, axis=0), axis=1))])
        count = max(4, round(length[-1] / spacing))
        at = np.linspace(0, length[-1], count + 1)
        x, z = np.interp(at, length, xz[:, 0]), np.interp(at, length, xz[:, 1])
        x[[0, -1]] = 0.0
        rings.append(np.stack([x, np.full(count + 1, y), z], axis=1))
    return rings


def _reflect(
    halves: list[NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
    """Close half rings to rings: vertices, triangles and the mirror permutation."""
    rest, mirror, index = [], [], []
    start = 0
    for half in halves:
        m = len(half) - 1
        # Front, left side, back, right side from back to front.
        ring = np.concatenate([half, half[m - 1 : 0 : -1] * [-1, 1, 1]])
        rest.append(ring)
        mirror.append(start + (-np.arange(2 * m)) % (2 * m))
        index.append(start + np.arange(m + 1))
        start += 2 * m
    image = np.concatenate(mirror)
    points = np.concatenate(rest)
    half_faces = np.concatenate(
        [_zip(points, a, b, k) for k, (a, b) in enumerate(itertools.pairwise(index))]
    )
    faces = np.concatenate([half_faces, image[half_faces][:, ::-1]])
    return points, faces.astype(np.int32), image.astype(np.int32)


def _zip(
    points: NDArray[np.float64], above: NDArray[np.int64], below: NDArray[np.int64], row: int
) -> NDArray[np.int64]:
    """Triangles between two half rings, the shorter diagonal first."""
    i, j, faces = 0, 0, []
    while i < len(above) - 1 or j < len(below) - 1:
        if j == len(below) - 1:
            down = False
        elif i == len(above) - 1:
            down = True
        else:
            longer = np.linalg.norm(points[above[i]] - points[below[j + 1]]) - np.linalg.norm(
                points[above[i + 1]] - points[below[j]]
            )
            # Between rings of equal size both diagonals are equal (to 1e-3 of an edge): they
            # alternate, so that the cloth has no preferred direction.
            even = abs(longer) < 1e-3 * np.linalg.norm(points[below[j + 1]] - points[below[j]])
            down = (i + row) % 2 == 0 if even else bool(longer < 0)
        if down:
            faces.append((above[i], below[j], below[j + 1]))
            j += 1
        else:
            faces.append((above[i], below[j], above[i + 1]))
            i += 1
    return np.array(faces)


def _nearest(
    points: NDArray[np.float64], at: NDArray[np.float64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    distance, index = cKDTree(points).query(at, k=np.arange(1, count + 1))
    return np.asarray(distance, dtype=np.float64), np.asarray(index, dtype=np.int64)


def _follow(
    body: Body, rest: NDArray[np.float64], mirror: NDArray[np.int32] | None
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Skin weights from the nearest body vertices, without those of the arms."""
    rig = body.skinning
    dense = rig.dense_weights().astype(np.float64)
    usable = np.flatnonzero(_arm_weight(body) < 0.5)
    distance, nearest = _nearest(rig.rest[usable].astype(np.float64), rest, _NEAREST)
    near = 1 / (distance + _CLOSEST)
    weights = (dense[usable][nearest] * near[..., None]).sum(axis=1) / near.sum(axis=1)[:, None]
    if mirror is not None:
        weights = (weights + weights[mirror][:, body.skeleton.mirror()]) / 2
    return strongest(weights, _INFLUENCES)
