"""Settings of the cloth simulator and its arrays for one garment on one body."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from garmentnet.collision.body_tree import tree_of
from garmentnet.data.parameters import SimulationParameters
from ssdr.common.checks import LARGEST
from ssdr.common.errors import InputError

from .body import Body
from .garments import Garment
from .limits import check_numbers
from .motion import interpolate
from .xpbd.chunks import colour, pack
from .xpbd.contact import CLUSTER
from .xpbd.loop import BodyArrays, ClothArrays, Step, simulate_frames
from .xpbd.policy import INDEX, REAL

# Density at which `drag` is stated, kg/m².
_DENSITY = 0.2
# Joints of one side that move the trunk, so that their triangles do not count as a limb.
_TRUNK = ("collar_l", "collar_r")


@dataclasses.dataclass(frozen=True)
class Solver:
    """Settings of the simulator; the defaults are measured, see docs/garment-scenes.md.

    Parameters
    ----------
    substeps, blocks : int
        Substeps in a frame, and blocks of them: in each block the body is posed and the nearest
        triangles are searched once.
    stretch : float
        Stiffness of every edge, N/m; on an equilateral mesh Young's modulus of the sheet is
        2 / √3 times as large.
    bending : float
        Flexural rigidity of the sheet where `bending` of the parameters is 1, N·m.
    bending_damping : float
        Time constant of the hinges' damping, seconds.
    friction : float
        Coulomb's coefficient between cloth and skin.
    drag : float
        Decay rate of velocity in the cloth's time, 1/s, at 0.2 kg/m²; inversely proportional to
        the density.
    distance : float
        Distance that the cloth keeps from the skin, metres.
    reach : float
        Distance from the skin within which contact is searched, metres.
    push : float
        Farthest that a vertex is pushed out of the body in one substep, metres.
    approach, settle : int
        Frames in which the body moves from rest to its first pose, and in which it then waits.

    Raises
    ------
    InputError
        If a number is negative, not finite, 0 for `substeps` and `blocks`, or `blocks` does not
        divide `substeps`.

    Examples
    --------
    >>> Solver(substeps=20).blocks
    5
    """

    substeps: int = 40
    blocks: int = 5
    stretch: float = 7e3
    bending: float = 1e-3
    bending_damping: float = 0.05
    friction: float = 0.1
    drag: float = 3.5
    distance: float = 0.01
    reach: float = 0.06
    push: float = 0.004
    approach: int = 15
    settle: int = 40

    def __post_init__(self) -> None:
        check_numbers(self, substeps=(1, LARGEST), blocks=(1, LARGEST))
        if self.substeps % self.blocks:
            raise InputError("blocks", f"a divisor of substeps, {self.substeps}", self.blocks)


class Cloth:
    """Cloth simulation of a garment on a body, for any motion and parameters.

    Parameters
    ----------
    body : Body
    garment : Garment
        The garment, whose rest pose is also the shape without strain.
    solver : Solver, optional
    """

    def __init__(self, body: Body, garment: Garment, solver: Solver | None = None) -> None:
        self.body, self.garment, self.solver = body, garment, solver or Solver()
        self._body = _body_arrays(body)
        rest, pinned = garment.rest.astype(np.float64), garment.pinned
        self._area = _vertex_areas(rest, garment.faces)
        edges = garment.edges()
        self._edges = edges[~pinned[edges].all(axis=1)]
        a, b = rest[self._edges].swapaxes(0, 1)
        self._lengths = np.linalg.norm(b - a, axis=1)
        hinges = _hinges(garment.faces)
        self._hinges = hinges[~pinned[hinges].all(axis=1)]
        self._angles, self._hinge_lengths = _rest_angles(rest, self._hinges)
        self._colours = colour(self._edges, pinned), colour(self._hinges, pinned)
        self._clusters = _clusters(rest, np.flatnonzero(~pinned))

    def simulate(
        self,
        joints: NDArray[np.float64],
        fps: float,
        parameters: SimulationParameters,
        *,
        first: int = 0,
        moved: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Simulated vertices ``(F - first, V, 3)`` for a motion ``(F, J, 3, 4)`` of the body.

        The cloth starts at rest in its rest shape, placed by the root of the first frame.  Frames
        before `first` are not returned; `moved` (V, 3) is added to the positions just before it.
        """
        s, n = self.solver, self.garment.n_vertices
        h = parameters.time_scale / fps / s.substeps
        step = Step(
            substeps=s.substeps,
            blocks=s.blocks,
            h=REAL(h),
            damping=REAL(s.bending_damping / h),
            decay=REAL(math.exp(-s.drag * h * _DENSITY / parameters.density)),
            distance=REAL(s.distance),
            friction=REAL(s.friction),
            push=REAL(s.push),
            reach=REAL(s.reach),
        )
        shift = np.zeros((n, 3), REAL) if moved is None else np.asarray(moved, REAL)
        out = np.empty((len(joints) - first, n, 3), np.float32)
        skeleton = self.body.skeleton
        at = np.arange((len(joints) - 1) * s.blocks + 1) / s.blocks
        poses = interpolate(skeleton, joints, at).reshape(len(at), -1, 12)
        roots = np.ascontiguousarray(skeleton.positions(joints)[:, 0])
        arrays = self._cloth_arrays(parameters, h)
        simulate_frames(self._body, arrays, poses, roots, step, first, shift, out)
        return out

    def _cloth_arrays(self, parameters: SimulationParameters, h: float) -> ClothArrays:
        g, s = self.garment, self.solver
        weights = np.where(g.pinned, 0.0, 1 / np.maximum(parameters.density * self._area, 1e-9))
        compliance = np.full(len(self._lengths), 1 / max(s.stretch * h * h, 1e-30))
        edges = np.stack([self._lengths, compliance], axis=1)
        # A sheet of equilateral triangles whose hinges have the stiffness k has the flexural
        # rigidity √3 / 2 k (Seung & Nelson 1988), whatever the length of its edges.
        mean = 2 / math.sqrt(3) * s.bending * parameters.bending
        stiffness = mean * self._hinge_lengths / g.edge_length()
        softness = 1 / np.maximum(stiffness * h * h, 1e-30)
        hinges = np.stack([np.cos(self._angles), np.sin(self._angles), softness], axis=1)
        free, pinned = (np.flatnonzero(x).astype(INDEX) for x in (~g.pinned, g.pinned))
        return ClothArrays(
            rest=g.rest.astype(REAL),
            sides=np.zeros(g.n_vertices, np.int8) if g.sides is None else g.sides,
            free=free,
            clusters=self._clusters,
            pinned=pinned,
            pins=_skin(g.rest[pinned], g.indices[pinned], g.weights[pinned]),
            weights=weights.astype(REAL),
            edges=pack(self._edges, weights[self._edges], edges, self._colours[0]),
            hinges=pack(self._hinges, weights[self._hinges], hinges, self._colours[1]),
        )


def _clusters(rest: NDArray[np.float64], free: NDArray[np.intp]) -> NDArray[np.int64]:
    """Clusters ``(C, CLUSTER)`` of free vertices that are near each other at rest."""
    tree, depth = tree_of(rest, free[:, None].astype(np.int32), CLUSTER)
    ordered = tree[:, 0]
    ends = len(free) * np.arange(2**depth + 1) >> depth
    parts = [ordered[a:b] for a, b in itertools.pairwise(ends) if b > a]
    filled = [np.append(p, np.full(CLUSTER - len(p), p[0])) for p in parts]
    return np.array(filled, np.int64).reshape(-1, CLUSTER)


def _skin(rest: ArrayLike, indices: ArrayLike, weights: ArrayLike) -> tuple[NDArray[Any], ...]:
    # Copies: a kernel is compiled once more for arrays that cannot be written.
    kinds = (rest, REAL), (indices, np.int32), (weights, REAL)
    return tuple(np.array(x, kind, order="C") for x, kind in kinds)


def _body_arrays(body: Body) -> BodyArrays:
    rig = body.skinning
    triangles, depth = tree_of(rig.rest, rig.faces)
    opposite = {
        (int(f[k]), int(f[(k + 1) % 3])): t for t, f in enumerate(triangles) for k in range(3)
    }
    beside = [
        [opposite.get((int(f[(k + 1) % 3]), int(f[k])), -1) for k in range(3)] for f in triangles
    ]
    return BodyArrays(
        skin=_skin(rig.rest, rig.indices, rig.weights),
        triangles=triangles,
        corners=3 * triangles.astype(INDEX),
        beside=np.array(beside, np.int32),
        sides=_sides(body, triangles),
        depth=depth,
    )


def _sides(body: Body, triangles: NDArray[np.int32]) -> NDArray[np.int8]:
    """Side of every triangle: 1 for the left arm and leg, -1 for the right ones, 0 elsewhere."""
    dense = body.skinning.dense_weights()
    names = body.skinning.names()
    limbs = [
        (dense[:, [n.endswith(end) and n not in _TRUNK for n in names]].sum(axis=1) > 0.5)[
            triangles
        ].all(axis=1)
        for end in ("_l", "_r")
    ]
    return np.asarray(limbs[0].astype(np.int8) - limbs[1].astype(np.int8))


def _vertex_areas(rest: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Area ``(V,)`` of each vertex: a third of the areas of its triangles."""
    a, b, c = rest[faces].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    total = np.bincount(faces.ravel(), np.repeat(area / 3, 3), minlength=len(rest))
    return np.asarray(total, np.float64)


def _hinges(faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Inner edges ``(n, 4)``: both ends, then the opposite corners of the two triangles.

    The first triangle is the one that has the ends in this order.
    """
    corner = {}
    for f in faces.tolist():
        for k in range(3):
            corner[f[k], f[(k + 1) % 3]] = f[(k + 2) % 3]
    found = [(i, j, c, corner[j, i]) for (i, j), c in corner.items() if i < j and (j, i) in corner]
    return np.array(found, np.int64).reshape(-1, 4)


def _rest_angles(
    rest: NDArray[np.float64], hinges: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Dihedral angle of every hinge, 0 where it is flat, and the length of its edge."""
    i, j, k, m = rest[hinges].swapaxes(0, 1)
    e = j - i
    length = np.linalg.norm(e, axis=1)
    p, q = np.cross(e, k - i), np.cross(m - i, e)
    sine = (np.cross(p, q) * e).sum(axis=1) / length
    return np.arctan2(sine, (p * q).sum(axis=1)), length
