"""Cutting of garments around the body at rest: dresses, shirts, trousers and skirts.

A garment is made of rings.  A yoke widens from the neck over the shoulders, divides at the armpits
into trunk and sleeves, and the trunk ends in a skirt or divides at the crotch into legs.  The
garment's :class:`Cut` says which of these parts it has.  One half is built and reflected, so that
the permutation that swaps left and right is exact.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError

from .body import Body
from .garments import Garment, arm_weight, follow
from .limits import check_numbers
from .outline import LEVEL, Outline, find_outline, section
from .rings import ROW, Half, divide, evenly, points_at, some_of

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

# Angles of a ring before it is divided into edges; 0 is the front and a quarter the left side.
_ANGLES = np.linspace(0, np.pi, 721)
# Distance below the crotch, metres, from which on trousers follow each leg by itself.
_CROTCH = 0.06


@dataclasses.dataclass(frozen=True)
class Cut:
    """Cut of a garment, by default a flared, pleated dress; heights are fractions of the body's.

    Parameters
    ----------
    vertices : int
        Approximate number of vertices; the garment has this many within a few per cent.
    top, waist, hem : float
        Heights of the upper edge, of the end of the trunk, which follows the body, and of the
        lower edge of the skirt or the legs that begin there.
    flare : float
        Growth of the radius of the skirt or a leg per metre of height, metres.
    pleats : int
        Number of folds around the skirt.
    pleat_depth : float
        Depth of the pleats at the hem, as a fraction of the radius; at the waist it is 0.
    clearance : float
        Distance between the garment and the body, metres.
    pinned : float
        Height above which vertices follow the body; 0: the waist.
    armpit : float
        Height where sleeves leave the trunk; 0: no sleeves.
    sleeves : float
        Length of the sleeves, as a fraction of the upper arm; longer ones need a mesh.
    legs : bool
        Whether the garment has legs instead of a skirt; `waist` is then the height of the crotch.

    Raises
    ------
    InputError
        If a number is out of its range.

    Examples
    --------
    >>> Cut(vertices=500, pleats=12).hem
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
    pinned: float = 0.0
    armpit: float = 0.0
    sleeves: float = 0.0
    legs: bool = False

    def __post_init__(self) -> None:
        highest = 0.87 if self.armpit else 0.8
        if not 0.02 <= self.hem < self.waist - 0.02 < self.top - 0.04 < highest:
            raise InputError(
                "hem, waist, top",
                f"rising fractions of the height from 0.02 to {highest}",
                (self.hem, self.waist, self.top),
            )
        check_numbers(
            self,
            vertices=(200, 200_000),
            flare=(0, 2),
            pleats=(0, 40),
            pleat_depth=(0, 0.4),
            clearance=(0.003, 0.1),
            pinned=(0, self.top),
            sleeves=(0.5 * bool(self.armpit), bool(self.armpit)),
        )
        if self.armpit and not self.waist + 0.02 < self.armpit < self.top - 0.04:
            raise InputError("armpit", "a height between waist and top, or 0", self.armpit)


def cut_garment(body: Body, cut: Cut | None = None) -> Garment:
    """Cut a garment for a body; by default the flared dress.

    The trunk follows the convex hull of the body's cross sections at a distance of `clearance`.
    Below the waist the radius of a skirt grows by `flare` and is multiplied by
    ``1 + pleat_depth t cos(pleats θ)``, with t from 0 at the waist to 1 at the hem.

    Raises
    ------
    InputError
        If the cut cannot have that many vertices.

    Examples
    --------
    >>> from benchmarks.garment.scenes.body import default_body
    >>> garment = cut_garment(default_body(), Cut(vertices=300))
    >>> abs(garment.n_vertices - 300) < 30, garment.mirror is not None
    (True, True)
    """
    cut = cut or Cut()
    pattern = _Pattern(body, cut)
    low, high = 0.002, 0.2  # metres: the spacings of the largest and the smallest lie between
    # The number of vertices falls with the spacing in steps: bisect, and take the closest.
    tried: list[tuple[int, Half]] = []
    for _ in range(40):  # halves the range of spacings on a logarithmic scale
        spacing = np.sqrt(low * high)
        half = pattern.half(spacing)
        tried.append((abs(half.n_vertices() - cut.vertices), half))
        if tried[-1][0] == 0:
            break
        if half.n_vertices() > cut.vertices:
            low = spacing
        else:
            high = spacing
    off, half = min(tried, key=lambda t: t[0])
    if off > 0.1 * cut.vertices:
        raise InputError("vertices", "a number that this cut can have", cut.vertices)
    rest, faces, mirror, sides = half.reflect()
    pinned = rest[:, 1] >= (cut.pinned or cut.waist) * body.height() - 1e-9
    indices, weights = follow(body, rest, mirror, shoulders=cut.armpit > 0)
    small = np.float32
    return Garment(rest.astype(small), faces, pinned, indices, weights.astype(small), mirror, sides)


class _Pattern:
    """Surfaces of a cut on a body, from which half garments of any edge length are made."""

    def __init__(self, body: Body, cut: Cut) -> None:
        self.cut = cut
        self.rest = body.skinning.rest.astype(np.float64)
        height = body.height()
        self.top, self.waist, self.hem = height * cut.top, height * cut.waist, height * cut.hem
        self.start = height * cut.armpit if cut.armpit else self.top
        faces = body.skinning.faces
        is_arm = (arm_weight(body) > 0.5)[faces].any(axis=1)
        torso, arm, left = faces[~is_arm], faces[is_arm], (self.rest[faces, 0] > 0).all(axis=1)
        self.trunk = self._outline(torso, self.waist, self.start)
        if cut.armpit:
            shoulder, elbow = (
                body.skeleton.rest[body.skeleton.names.index(n)] for n in ("arm_l", "forearm_l")
            )
            frame = _axes(shoulder - elbow)
            self.yoke, self.armpits = self._yoke(faces, torso, arm, frame[1])
            a, b = self.armpits
            stop = shoulder @ frame[1] - cut.sleeves * float(np.linalg.norm(shoulder - elbow))
            ring = self.yoke[-1, a : b + 1]
            self.sleeve = self._tube(faces[is_arm & left], frame, ring, LEVEL, stop, 0.0)
        if cut.legs:
            ring = self.trunk.at(self.waist, _ANGLES)
            limb = faces[~is_arm & left]
            self.leg = self._tube(limb, np.eye(3), ring, _CROTCH, self.hem, cut.flare)

    def half(self, spacing: float) -> Half:
        """Half of the garment, with edges about `spacing` long."""
        half, cut, step = Half(), self.cut, spacing * ROW
        trunk = []
        if cut.armpit:
            *rows, last = some_of(self.yoke, spacing)
            a, b = self.armpits
            front, arm, back = (
                divide(p, spacing) for p in (last[: a + 1], last[a : b + 1], last[b:])
            )
            yoke = [half.add(divide(r, spacing)) for r in rows]
            yoke.append(half.add(np.concatenate([front, arm[1:], back[1:]])))
            half.join(yoke)
            i, j = len(front) - 1, len(front) + len(arm) - 2
            seam = half.add(divide(last[[a, b]], spacing)[1:-1])
            ring = yoke[-1]
            trunk = [np.concatenate([ring[: i + 1], seam, ring[j:]])]
            half.hang(np.concatenate([ring[i : j + 1], seam[::-1]]), self.sleeve, spacing)
        upper = max(1, round((self.start - self.waist) / step))
        levels = np.linspace(self.start, self.waist, upper + 1)
        if not cut.legs:
            lower = max(2, round((self.waist - self.hem) * np.hypot(1, cut.flare) / step))
            levels = np.append(levels[:-1], np.linspace(self.waist, self.hem, lower + 1))
        trunk += [half.add(divide(self._ring(y), spacing)) for y in levels[len(trunk) :]]
        half.join(trunk)
        if cut.legs:
            seam = half.add(divide(self._ring(self.waist)[[-1, 0]], spacing)[1:-1])
            half.hang(np.append(trunk[-1], seam), self.leg, spacing)
        return half

    def _ring(self, y: float) -> Floats:
        """Half a ring of the trunk or the skirt, from the front (x = 0) to the back (x = 0)."""
        ring = self.trunk.at(max(y, self.waist), _ANGLES)
        if y < self.waist:
            t = (self.waist - y) / (self.waist - self.hem)
            middle = np.array([0.0, (ring[0, 2] + ring[-1, 2]) / 2])
            arm = ring[:, [0, 2]] - middle
            r = np.linalg.norm(arm, axis=1, keepdims=True)
            wave = 1 + self.cut.pleat_depth * t * np.cos(self.cut.pleats * _ANGLES)[:, None]
            ring[:, [0, 2]] = middle + arm / r * (r + self.cut.flare * (self.waist - y)) * wave
            ring[:, 1] = y
        return ring

    def _yoke(
        self, faces: Faces, torso: Faces, arm: Faces, up: Floats
    ) -> tuple[Floats, tuple[int, int]]:
        """Half rings ``(n, m, 3)`` of the yoke from the neck down, and the armpits' indices.

        The yoke ends at the height of the armpits and, over an arm, in the plane across it.  The
        indices are those of points in the last ring.
        """
        clearance, top = self.cut.clearance, self.top - self.cut.clearance
        shoulders = self._outline(faces, self.start, top)
        levels = np.linspace(top, self.start, round((top - self.start) / LEVEL) + 1)
        rings = np.stack([shoulders.at(y, _ANGLES) for y in levels])
        # The outline keeps its distance from the body sideways only; shoulders are nearly level.
        rings[..., 1] += clearance * np.linspace(1, 0, len(levels))[:, None]
        inner, outer = (section(self.rest, f, self.start)[:, 0] for f in (torso, arm))
        beside = np.flatnonzero(rings[-1, :, 0] >= (inner.max() + outer[outer > 0].min()) / 2)
        a, b = int(beside[0]), int(beside[-1])
        index = np.arange(len(levels))
        ends = np.linspace(rings[-1, a] @ up, rings[-1, b] @ up, b + 1 - a)
        for k, end in enumerate(ends, start=a):
            at = np.linspace(0, np.interp(-end, -(rings[:, k] @ up), index), len(index))
            rings[:, k] = points_at(at, index, rings[:, k])
        return evenly(rings), (a, b)

    def _tube(
        self, faces: Faces, frame: Floats, ring: Floats, gap: float, stop: float, flare: float
    ) -> Floats:
        """Rings ``(n, m, 3)`` of a sleeve or a leg along the axis y of `frame`.

        The first is the given part of a ring, closed by a straight seam.  From `gap` metres below
        it, down to the place `stop` on the axis, they follow the limb.
        """
        closed = np.concatenate([ring, np.linspace(ring[-1], ring[0], 200)[1:]]) @ frame.T
        end = float(closed[:, 1].min())
        start = end - gap
        limb = self._outline(faces, stop, end, frame)
        x, z = (np.interp(start, limb.levels, c) for c in limb.centre.T)
        angle = np.unwrap(np.arctan2(closed[:, 0] - x, closed[:, 2] - z))
        angles = angle[0] + 2 * _ANGLES
        rings = [points_at(angles, angle, closed) @ frame]
        for y in np.linspace(start, stop, max(2, round((start - stop) / LEVEL) + 1)):
            rings.append(limb.at(y, angles, flare * (start - y)))
        return evenly(np.stack(rings))

    def _outline(
        self, faces: Faces, low: float, high: float, frame: Floats | None = None
    ) -> Outline:
        return find_outline(self.rest, faces, low, high, self.cut.clearance, frame)


def _axes(up: Floats) -> Floats:
    """Axes ``(3, 3)`` as rows: y along `up`, z as near to the front as can be, x normal to both."""
    y = up / np.linalg.norm(up)
    x = np.cross(y, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)])
