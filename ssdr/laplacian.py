"""Laplacians of a triangle mesh, implicit smoothing and the low/high-frequency split.

Sign convention: L = D − W, positive semi-definite, so that −M⁻¹L is the
discrete Laplace–Beltrami operator and (M + ℓ²L) x = M x₀ smooths.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csc_matrix, csr_array, dia_array

from .errors import InputError, check_choice
from .factor import Backend, factor_spd
from .sequence import MeshSequence, _check_faces

__all__ = [
    "Backend",
    "FrequencySplit",
    "LaplacianKind",
    "LaplacianSmoother",
    "MassKind",
    "cotangent_laplacian",
    "implicit_smooth",
    "mass_matrix",
    "split_frequencies",
    "uniform_laplacian",
]

LaplacianKind = Literal["cotangent", "uniform"]
MassKind = Literal["barycentric", "voronoi"]

# A doubled area below this share of the squared longest edge is a degenerate triangle.
_SLIVER = 1e-6
# Mass of a vertex without area, relative to the mean: enough for a stable factor, no weight.
_MASS_FLOOR = 1e-6
# Both cotangents opposite to an edge of a regular triangulation are 1/sqrt(3).
_REGULAR = 1 / math.sqrt(3)
_BATCH_BYTES = 64 << 20


def uniform_laplacian(faces: ArrayLike, n_vertices: int) -> csr_array:
    """Graph Laplacian of the mesh's edges: (L x)_i = Σ_{j ~ i} (x_i − x_j).

    Parameters
    ----------
    faces : (T, 3) int array
        An edge counts once, however many triangles share it.
    n_vertices : int

    Returns
    -------
    (V, V) float64 csr_array
        Symmetric, positive semi-definite; an unreferenced vertex has a zero row.

    Raises
    ------
    InputError
        If `n_vertices` is below 1 or a face index is out of range.
    """
    n = _check_count(n_vertices)
    triangles = _check_faces(faces, n, "faces")
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    ends = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0)
    return _assemble(ends[:, 0], ends[:, 1], np.ones(len(ends)), n)


def cotangent_laplacian(vertices: ArrayLike, faces: ArrayLike) -> csr_array:
    """Cotangent Laplacian, the stiffness matrix of linear finite elements.

    (L x)_i = Σ_j w_ij (x_i − x_j) with w_ij = ½ Σ cot of the angles opposite to
    the edge, over all of its triangles (one at a boundary, more than two where
    the mesh is not manifold).  Units: none; the matrix does not change with the
    scale of the mesh.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (T, 3) int array

    Returns
    -------
    (V, V) float64 csr_array
        Symmetric, positive semi-definite; exact on linear functions of a flat
        patch.  Off-diagonal entries are positive across edges that are not
        Delaunay.

    Raises
    ------
    InputError
        If a shape, a number or a face index is not usable.

    Notes
    -----
    A cotangent is a dot product over the doubled area.  The doubled area is
    taken as at least 1e-6 of the triangle's squared longest edge, which scales
    the three cotangents of a degenerate triangle alike and so keeps the matrix
    positive semi-definite (clamping them one by one would not).  A triangle
    that is a point contributes nothing.

    References
    ----------
    Pinkall and Polthier, "Computing discrete minimal surfaces and their
    conjugates", 1993.
    """
    points, triangles = _check_mesh(vertices, faces)
    dots, double_area = _corners(points, triangles)
    cot = np.divide(
        dots, double_area[:, None], out=np.zeros_like(dots), where=double_area[:, None] > 0
    )
    a = triangles[:, [1, 2, 0]].ravel()
    b = triangles[:, [2, 0, 1]].ravel()
    return _assemble(a, b, 0.5 * cot.ravel(), len(points))


def mass_matrix(
    vertices: ArrayLike, faces: ArrayLike, *, kind: MassKind = "barycentric"
) -> dia_array:
    """Lumped mass matrix: the area that belongs to each vertex.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (T, 3) int array
    kind : {"barycentric", "voronoi"}
        A third of each triangle, or its mixed Voronoi cells (Meyer et al. 2003):
        the Voronoi cells of an acute triangle; half of an obtuse triangle to
        its obtuse corner and a quarter to each other.

    Returns
    -------
    (V, V) float64 dia_array
        Diagonal, in squared units of the mesh.  The entries add up to the area
        of the mesh, but for vertices that have none (unreferenced, or only
        corners of degenerate triangles): they get 1e-6 of the mean, so that
        M + ℓ²L is definite.  Where the whole mesh has no area, its mean squared
        edge (1 if that is zero too) stands for the mean.

    Raises
    ------
    InputError
        If a shape, a number, a face index or `kind` is not usable.

    References
    ----------
    Meyer et al., "Discrete differential-geometry operators for triangulated
    2-manifolds", 2003, section 3.3.
    """
    points, triangles = _check_mesh(vertices, faces)
    check_choice(kind, "kind", MassKind)
    edges = points[triangles[:, [2, 0, 1]]] - points[triangles[:, [1, 2, 0]]]
    squares = (edges**2).sum(axis=2)
    double_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    area = 0.5 * double_area
    if kind == "barycentric":
        share = np.repeat(area[:, None] / 3, 3, axis=1)
    else:
        share = _voronoi_cells(points, triangles, squares, area)
    n = len(points)
    mass = np.bincount(triangles.ravel(), weights=share.ravel(), minlength=n)
    owners = mass[mass > 0] if mass.any() else squares.ravel()
    unit = owners.mean() if owners.size else 0.0
    # A subnormal unit would vanish when multiplied by the floor.
    unit = unit if unit > 1e-290 else 1.0
    mass = np.maximum(mass, _MASS_FLOOR * unit)
    return dia_array((mass[None], [0]), shape=(n, n))


class LaplacianSmoother:
    """Implicit smoothing (M + ℓ²L) x = M x₀ with a factor that is kept.

    One backward Euler step of the heat equation over the time ℓ².  A pattern on
    the surface with wavelength λ is damped by 1 / (1 + (2πℓ/λ)²): what is much
    longer than 2πℓ stays, what is much shorter goes, whatever the resolution of
    the mesh.  Constants, and so translations, are kept; the operator belongs to
    one pose and its use on the x, y and z of others is linear and commutes with
    rotations and translations.

    Parameters
    ----------
    vertices : (V, 3) array
        The pose whose metric is used, in the mesh's units.
    faces : (T, 3) int array
        Without any, nothing is smoothed.
    length : float
        ℓ in the mesh's units; 0 changes nothing.
    kind : {"cotangent", "uniform"}
        "uniform" uses the graph Laplacian over √3, which on a regular
        triangulation is the cotangent one; elsewhere it also pulls vertices
        along the surface, and it has no negative weights.
    mass : {"barycentric", "voronoi"}
    backend : {"cholmod", "scipy"}, optional
        CHOLMOD (scikit-sparse) where installed, SciPy's SuperLU otherwise.

    Attributes
    ----------
    backend : {"cholmod", "scipy"}
        Which one made the factor.
    length, kind, mass
        As given.
    n_vertices : int

    Raises
    ------
    InputError
        If an argument is not usable, or `length` is so large beside the edges
        that the masses are lost in rounding.
    MissingDependencyError
        If CHOLMOD is asked for and scikit-sparse is not installed.

    Notes
    -----
    Degenerate triangles, boundaries, non-manifold edges and several components
    are fine; a vertex of no triangle stays where it is.  Cost: one sparse
    Cholesky factor, then two triangular solves for a coordinate of a frame.

    References
    ----------
    Desbrun et al., "Implicit fairing of irregular meshes using diffusion and
    curvature flow", 1999.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        length: float,
        *,
        kind: LaplacianKind = "cotangent",
        mass: MassKind = "barycentric",
        backend: Backend | None = None,
    ) -> None:
        points, triangles = _check_mesh(vertices, faces)
        check_choice(kind, "kind", LaplacianKind)
        number = isinstance(length, (int, float, np.number)) and not isinstance(length, bool)
        if not (number and math.isfinite(length) and length >= 0):
            raise InputError("length", "a number >= 0, in the mesh's units", repr(length))
        self.length = float(length)
        self.kind: LaplacianKind = kind
        self.mass: MassKind = mass
        self.n_vertices = len(points)
        diagonal = mass_matrix(points, triangles, kind=mass)
        if kind == "cotangent":
            laplacian = cotangent_laplacian(points, triangles)
        else:
            laplacian = uniform_laplacian(triangles, len(points)) * _REGULAR
        self._mass = diagonal.diagonal()
        # Scaled to masses around 1: areas of a tiny mesh would meet absolute thresholds.
        scale = 1.0 / self._mass.max()
        system = csc_matrix(diagonal * scale + laplacian * (scale * self.length**2))
        try:
            self._factor = factor_spd(system, backend=backend)
        except ArithmeticError as error:
            raise InputError("length", "a length comparable to the mesh", length) from error
        self.backend = self._factor.backend
        self._mass = self._mass * scale

    def __repr__(self) -> str:
        return (
            f"LaplacianSmoother(V={self.n_vertices}, length={self.length:g}, "
            f"{self.kind}, {self.backend})"
        )

    def smooth(self, values: ArrayLike) -> NDArray[np.floating]:
        """Smooth values per vertex.

        Parameters
        ----------
        values : (V,), (V, C) or (..., V, C) array
            For instance frames ``(F, V, 3)``; all columns are solved in batches
            of bounded memory.

        Returns
        -------
        array of the shape of `values`, float32 if that is float32, else float64;
        solved in float64.

        Raises
        ------
        InputError
            If the shape does not fit the mesh or a number is not finite.
        """
        x = np.asarray(values)
        axis = 0 if x.ndim <= 2 else x.ndim - 2
        if x.ndim == 0 or x.shape[axis] != self.n_vertices:
            wanted = f"({self.n_vertices},), ({self.n_vertices}, C) or (F, {self.n_vertices}, C)"
            raise InputError("values", f"shape {wanted}", f"shape {x.shape}")
        if x.dtype.kind not in "fiub":
            raise InputError("values", "real numbers", f"dtype {x.dtype}")
        dtype = np.float32 if x.dtype == np.float32 else np.float64
        blocks = x.reshape((-1, self.n_vertices, x.shape[-1] if x.ndim > 1 else 1))
        out = np.empty(blocks.shape, dtype=dtype)
        columns = max(1, blocks.shape[2])
        step = max(1, _BATCH_BYTES // (8 * self.n_vertices * columns))
        for start in range(0, len(blocks), step):
            part = blocks[start : start + step].astype(np.float64)
            if not np.isfinite(part).all():
                raise InputError("values", "finite numbers", "NaN or Inf")
            if part.size:
                out[start : start + step] = self._smooth_block(part)
        return out.reshape(x.shape)

    def _smooth_block(self, block: NDArray[np.float64]) -> NDArray[np.float64]:
        # Constants pass unchanged, so that a far origin need not cost digits.
        centre = block.mean(axis=1, keepdims=True)
        rows = np.ascontiguousarray((block - centre).transpose(0, 2, 1))
        rows *= self._mass
        # Rows of a C array are columns of the Fortran array that the solvers want.
        solved = self._factor.solve(rows.reshape(-1, self.n_vertices).T)
        moved = solved.T.reshape(rows.shape).transpose(0, 2, 1)
        return np.asarray(moved + centre)


def implicit_smooth(
    values: ArrayLike,
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    length: float,
    kind: LaplacianKind = "cotangent",
    mass: MassKind = "barycentric",
    backend: Backend | None = None,
) -> NDArray[np.floating]:
    """Smooth once; :class:`LaplacianSmoother` keeps the factor for the next time.

    Parameters and result are those of :class:`LaplacianSmoother` and its
    :meth:`~LaplacianSmoother.smooth`.
    """
    smoother = LaplacianSmoother(vertices, faces, length, kind=kind, mass=mass, backend=backend)
    return smoother.smooth(values)


@dataclasses.dataclass(frozen=True, eq=False)
class FrequencySplit:
    """A sequence as the sum of a smooth part and the detail on it.

    Attributes
    ----------
    low : (F, V, 3) array
        The smoothed frames, in the input's dtype.
    high : (F, V, 3) array
        ``frames - low``, in the input's dtype.
    smoother : LaplacianSmoother
        The operator, for more frames of the same mesh.
    """

    low: NDArray[np.floating]
    high: NDArray[np.floating]
    smoother: LaplacianSmoother

    @property
    def length(self) -> float:
        """ℓ in the mesh's units."""
        return self.smoother.length

    @property
    def backend(self) -> Backend:
        return self.smoother.backend


def split_frequencies(
    frames: MeshSequence | ArrayLike,
    faces: ArrayLike | None = None,
    *,
    length: float,
    rest: int | ArrayLike = 0,
    kind: LaplacianKind = "cotangent",
    mass: MassKind = "barycentric",
    backend: Backend | None = None,
) -> FrequencySplit:
    """Split every frame into a smooth part and the detail that adds up to it.

    Parameters
    ----------
    frames : MeshSequence or (F, V, 3) array
    faces : (T, 3) int array, optional
        Those of the sequence by default.
    length : float
        ℓ of :class:`LaplacianSmoother`, in the mesh's units.
    rest : int or (V, 3) array
        The frame, or the pose, whose metric the operator uses for all frames:
        the first frame by default.
    kind, mass, backend
        As in :class:`LaplacianSmoother`.

    Returns
    -------
    FrequencySplit
        ``low + high`` is the input within half a unit in the last place of the
        larger of the input and ``high``, in the input's own precision; exactly
        the input where ``low`` is within a factor of two of it (Sterbenz).

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    if not isinstance(frames, MeshSequence):
        frames = MeshSequence(frames, faces)
    triangles = frames.faces if faces is None else faces
    if isinstance(rest, (int, np.integer)) and not isinstance(rest, bool):
        if not -frames.n_frames <= rest < frames.n_frames:
            raise InputError("rest", f"a frame below {frames.n_frames} or a (V, 3) pose", rest)
        pose = frames.frames(int(rest) % frames.n_frames)
    else:
        pose = np.asarray(rest)
        if pose.shape != (frames.n_vertices, 3):
            raise InputError("rest", f"shape ({frames.n_vertices}, 3)", f"shape {pose.shape}")
    smoother = LaplacianSmoother(pose, triangles, length, kind=kind, mass=mass, backend=backend)
    low = np.empty(frames.vertices.shape, dtype=frames.vertices.dtype)
    high = np.empty_like(low)
    for start, block in frames.chunks():
        stop = start + len(block)
        low[start:stop] = smoother.smooth(block)
        np.subtract(block, low[start:stop], out=high[start:stop])
    return FrequencySplit(low=low, high=high, smoother=smoother)


def _corners(
    points: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Edge k is opposite to corner k, so the angle at k lies between edges k+1 and k+2.
    edges = points[triangles[:, [2, 0, 1]]] - points[triangles[:, [1, 2, 0]]]
    dots = -np.einsum("tkc,tkc->tk", edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
    double_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = (edges**2).sum(axis=2).max(axis=1, initial=0.0)
    return dots, np.maximum(double_area, _SLIVER * longest)


def _voronoi_cells(
    points: NDArray[np.float64],
    triangles: NDArray[np.int32],
    squares: NDArray[np.float64],
    area: NDArray[np.float64],
) -> NDArray[np.float64]:
    dots, double_area = _corners(points, triangles)
    cot = np.divide(
        dots, double_area[:, None], out=np.zeros_like(dots), where=double_area[:, None] > 0
    )
    halves = squares * cot / 8  # of edge k, to each of its two ends
    cells = halves[:, [1, 2, 0]] + halves[:, [2, 0, 1]]
    obtuse = dots < 0
    mixed = np.where(obtuse, area[:, None] / 2, area[:, None] / 4)
    return np.where(obtuse.any(axis=1, keepdims=True), mixed, cells)


def _assemble(a: Any, b: Any, weights: NDArray[np.float64], n: int) -> csr_array:
    # Summed once and mirrored, so that the matrix is symmetric to the last bit.
    keep = a != b
    ends = np.minimum(a, b)[keep], np.maximum(a, b)[keep]
    upper = coo_array((weights[keep], ends), shape=(n, n)).tocsr()
    both = upper + upper.T
    degree = dia_array((both.sum(axis=1)[None], [0]), shape=(n, n))
    return csr_array(degree - both)


def _check_mesh(
    vertices: ArrayLike, faces: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    points = np.asarray(vertices)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 1:
        raise InputError("vertices", "shape (V, 3) with V >= 1", f"shape {points.shape}")
    if points.dtype.kind not in "fiu":
        raise InputError("vertices", "real numbers", f"dtype {points.dtype}")
    points = points.astype(np.float64)
    if not np.isfinite(points).all():
        raise InputError("vertices", "finite numbers", "NaN or Inf")
    return points, _check_faces(faces, len(points), "faces")


def _check_count(n_vertices: int) -> int:
    whole = isinstance(n_vertices, (int, np.integer)) and not isinstance(n_vertices, bool)
    if not whole or n_vertices < 1:
        raise InputError("n_vertices", "an integer >= 1", repr(n_vertices))
    return int(n_vertices)
