"""Laplacians and mass matrices of a triangle mesh.

Sign convention: L = D − W, with weights W of the edges and their row sums D, is positive
semi-definite, so that −M⁻¹L with the masses M is the discrete Laplace–Beltrami operator.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csr_array, dia_array

from ..common.checks import LARGEST, check_faces, check_floats, check_squarable, check_whole
from ..common.errors import check_choice
from ..mesh.edges import triangle_edges

MassKind = Literal["barycentric", "voronoi"]

REGULAR = 1 / math.sqrt(3)  # both cotangents opposite to an edge of a regular triangulation
_SLIVER = 1e-6  # least twice the area of a triangle, relative to its squared longest edge
_MASS_FLOOR = 1e-6  # least mass of a vertex, relative to the mean, for a stable factor
_MODERATE = 1e50  # largest coordinates for which squared areas can be summed


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

    Examples
    --------
    >>> ssdr.laplacian.uniform_laplacian([[0, 1, 2]], 3).toarray().astype(int)
    array([[ 2, -1, -1],
           [-1,  2, -1],
           [-1, -1,  2]])
    """
    n = check_whole(n_vertices, "n_vertices", 1, np.iinfo(np.int32).max)
    triangles = check_faces(faces, n)
    ends = triangle_edges(triangles, n).astype(triangles.dtype)
    return _assemble(ends[:, 0], ends[:, 1], np.ones(len(ends)), n)


def cotangent_laplacian(vertices: ArrayLike, faces: ArrayLike) -> csr_array:
    """Cotangent Laplacian, the stiffness matrix of linear finite elements.

    (L x)_i = Σ_j w_ij (x_i − x_j), where w_ij is half the sum of the cotangents of the angles
    opposite to the edge, over all of its triangles (one at a boundary, more than two where the mesh
    is not manifold).  The matrix has no unit: scaling the mesh does not change it.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (T, 3) int array

    Returns
    -------
    (V, V) float64 csr_array
        Symmetric, positive semi-definite; exact on linear functions of a flat
        patch.  The off-diagonal entry of an edge that is not Delaunay is positive.

    Raises
    ------
    InputError
        If a shape, a number or a face index is not usable.

    Notes
    -----
    A cotangent is a dot product divided by twice the area.  Twice the area is taken as at least
    1e-6 of the squared longest edge.  This scales the three cotangents of a degenerate triangle
    alike, so that the matrix stays positive semi-definite (clamping each by itself would not ensure
    that).  A triangle whose corners coincide contributes nothing.

    References
    ----------
    Pinkall and Polthier, "Computing discrete minimal surfaces and their
    conjugates", 1993.

    Examples
    --------
    >>> vertices, faces = np.eye(3), [[0, 1, 2]]
    >>> stiffness = ssdr.laplacian.cotangent_laplacian(vertices, faces)
    >>> stiffness.shape, np.allclose(stiffness @ np.ones(3), 0)
    ((3, 3), True)
    """
    points, triangles = check_mesh(vertices, faces)
    points, _ = _moderate(points)
    cot, _ = _cotangents(points, triangles)
    a = triangles[:, [1, 2, 0]].ravel()
    b = triangles[:, [2, 0, 1]].ravel()
    return _assemble(a, b, 0.5 * cot.ravel(), len(points))


def mass_matrix(
    vertices: ArrayLike, faces: ArrayLike, *, kind: MassKind = "barycentric"
) -> dia_array:
    """Lumped mass matrix, with the area that belongs to each vertex on the diagonal.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (T, 3) int array
    kind : {"barycentric", "voronoi"}
        A corner gets a third of its triangle, or its mixed Voronoi cell (Meyer et al. 2003): in a
        triangle without an obtuse angle its Voronoi cell; in an obtuse triangle half of the area at
        the obtuse corner and a quarter at the others.

    Returns
    -------
    (V, V) float64 dia_array
        Diagonal, in squared units of the mesh.  The entries add up to the area of the mesh.  In
        addition, vertices without area (unreferenced, or only corners of degenerate triangles) get
        1e-6 of the mean entry, so that M + ℓ²L is definite.  If the whole mesh has no area, the
        mean squared edge takes the place of the mean entry, or 1 if that is zero.

    Raises
    ------
    InputError
        If a shape, a number (1e100 and more), a face index or `kind` is not usable.

    References
    ----------
    Meyer et al., "Discrete differential-geometry operators for triangulated
    2-manifolds", 2003, section 3.3.

    Examples
    --------
    >>> vertices, faces = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
    >>> mass = ssdr.laplacian.mass_matrix(vertices, faces)
    >>> np.allclose(mass.diagonal().sum(), 0.5)
    True
    """
    points, triangles = check_mesh(vertices, faces)
    check_choice(kind, "kind", MassKind)
    check_squarable(points, "vertices", f"numbers of less than {LARGEST:g}, for areas")
    points, power = _moderate(points)
    n = len(points)
    edges = points[triangles[:, [2, 0, 1]]] - points[triangles[:, [1, 2, 0]]]
    squares = (edges**2).sum(axis=2)
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)[:, None]
    share = np.repeat(area / 3, 3, axis=1)
    if kind == "voronoi":
        cot, obtuse = _cotangents(points, triangles)
        halves = squares * cot / 8  # of edge k, to each of its two ends
        cells = halves[:, [1, 2, 0]] + halves[:, [2, 0, 1]]
        mixed = np.where(obtuse, area / 2, area / 4)
        share = np.where(obtuse.any(axis=1, keepdims=True), mixed, cells)
    mass = np.bincount(triangles.ravel(), weights=share.ravel(), minlength=n)
    owners = mass[mass > 0] if mass.any() else squares.ravel()
    unit = owners.mean() if owners.size else 0.0
    # A subnormal unit would vanish when multiplied by the floor.
    unit = unit if unit > 1e-290 else 1.0
    mass = np.ldexp(np.maximum(mass, _MASS_FLOOR * unit), 2 * power)
    return dia_array((mass[None], [0]), shape=(n, n))


def _moderate(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Points / 2^n, so that fourth powers do not overflow, and n (0 if they are small enough)."""
    largest = float(np.abs(points).max())
    power = int(np.frexp(largest)[1]) if largest > _MODERATE else 0
    return np.ldexp(points, -power), power


def _cotangents(
    points: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Cotangent of the angle at each corner (0 if undefined), and whether the angle is obtuse."""
    # Edge k is opposite to corner k, so the angle at k lies between edges k+1 and k+2.
    edges = points[triangles[:, [2, 0, 1]]] - points[triangles[:, [1, 2, 0]]]
    dots = -np.einsum("tkc,tkc->tk", edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
    double_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = (edges**2).sum(axis=2).max(axis=1, initial=0.0)
    safe = np.maximum(double_area, _SLIVER * longest)[:, None]
    return np.divide(dots, safe, out=np.zeros_like(dots), where=safe > 0), dots < 0


def _assemble(a: Any, b: Any, weights: NDArray[np.float64], n: int) -> csr_array:
    # The upper triangle is summed and mirrored, so that the matrix is symmetric to the last bit.
    keep = a != b
    ends = np.minimum(a, b)[keep], np.maximum(a, b)[keep]
    upper = coo_array((weights[keep], ends), shape=(n, n)).tocsr()
    both = upper + upper.T
    degree = dia_array((both.sum(axis=1)[None], [0]), shape=(n, n))
    return csr_array(degree - both)


def check_mesh(
    vertices: ArrayLike, faces: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Check a mesh; return vertices ``(V, 3)`` as float64 and triangles ``(T, 3)`` as int32."""
    points = check_floats(vertices, "vertices", ("V", 3)).astype(np.float64)
    return points, check_faces(faces, len(points))
