"""Implicit smoothing of values on a mesh, and the split into low and high frequencies."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_matrix

from ..common.checks import LARGEST, as_array
from ..common.errors import InputError, check_choice, is_real, is_whole
from ..common.short_repr import short_repr
from ..mesh.sequence import MeshSequence
from .factor import Backend, factor_spd
from .operators import (
    REGULAR,
    MassKind,
    check_mesh,
    cotangent_laplacian,
    mass_matrix,
    uniform_laplacian,
)

LaplacianKind = Literal["cotangent", "uniform"]

_BATCH_BYTES = 64 << 20  # bytes of right-hand sides solved at a time, to bound memory


class LaplacianSmoother:
    """Implicit smoothing: x from (M + ℓ²L) x = M x₀, with a matrix that is factored once.

    Here x₀ are the given values, M is the mass matrix and L the Laplacian.
    This is one backward Euler step of the heat equation over the time ℓ².  A pattern of
    wavelength λ on the surface is multiplied by 1 / (1 + (2πℓ/λ)²): patterns much longer than 2πℓ
    stay and much shorter ones vanish, whatever the resolution of the mesh.  Constants stay.  The
    operator is built from one pose and can be applied to the coordinates of any other; it is linear
    and commutes with rotations and translations of the coordinates.

    Parameters
    ----------
    vertices : (V, 3) array
        Pose whose metric is used, in the mesh's units.
    faces : (T, 3) int array
        Without triangles values stay as they are.
    length : float
        ℓ in the mesh's units; 0 changes nothing.
    kind : {"cotangent", "uniform"}
        "uniform" is the graph Laplacian divided by √3, which equals the cotangent Laplacian on a
        regular triangulation.  On other meshes it also moves vertices along the surface.  It has no
        negative weights.
    mass : {"barycentric", "voronoi"}
    backend : {"cholmod", "scipy"}, optional
        CHOLMOD (scikit-sparse) where installed, SciPy's SuperLU otherwise.

    Attributes
    ----------
    backend : {"cholmod", "scipy"}
        The library that made the factor.
    length, kind, mass
        Parameters of the call.
    n_vertices : int

    Raises
    ------
    InputError
        If an argument is not usable, or `length` is so much larger than the edges that rounding
        loses the masses.
    MissingDependencyError
        If `backend` is "cholmod" and scikit-sparse is not installed.

    Notes
    -----
    Degenerate triangles, boundaries, non-manifold edges and several components are allowed.  A
    vertex without triangles stays where it is.  Cost: one sparse Cholesky factorisation, then two
    triangular solves for each coordinate of each frame.

    References
    ----------
    Desbrun et al., "Implicit fairing of irregular meshes using diffusion and
    curvature flow", 1999.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> smoother = ssdr.laplacian.LaplacianSmoother(dancer.frames(0), dancer.faces, 0.05)
    >>> smoother.smooth(dancer.frames(0)).shape
    (799, 3)
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
        points, triangles = check_mesh(vertices, faces)
        check_choice(kind, "kind", LaplacianKind)
        if not (is_real(length) and 0 <= float(length) < LARGEST):
            raise InputError("length", "a number >= 0, in the mesh's units", repr(length))
        self.length = float(length)
        self.kind: LaplacianKind = kind
        self.mass: MassKind = mass
        self.n_vertices = len(points)
        diagonal = mass_matrix(points, triangles, kind=mass)
        if kind == "cotangent":
            laplacian = cotangent_laplacian(points, triangles)
        else:
            laplacian = uniform_laplacian(triangles, len(points)) * REGULAR
        self._mass = diagonal.diagonal()
        # Scaled to masses around 1, since the solvers have absolute thresholds.
        scale = 1.0 / self._mass.max()
        self._system = csc_matrix(diagonal * scale + laplacian * (scale * self.length**2))
        try:
            self._solve, self.backend = factor_spd(self._system, backend=backend)
        except ArithmeticError as error:
            raise InputError("length", "a length comparable to the mesh", length) from error
        self._mass = self._mass * scale

    def __getstate__(self) -> dict[str, Any]:
        """All but the factor, which no library can pickle or copy: it is made again."""
        return {name: value for name, value in vars(self).items() if name != "_solve"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._solve, self.backend = factor_spd(self._system, backend=self.backend)

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
        x = as_array(values, "values", "numbers")
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
                with np.errstate(over="ignore", invalid="ignore"):
                    smoothed = self._smooth_block(part).astype(dtype)
                if not np.isfinite(smoothed).all():
                    raise InputError("values", "numbers whose sums are numbers", "larger ones")
                out[start : start + step] = smoothed
        return out.reshape(x.shape)

    def _smooth_block(self, block: NDArray[np.float64]) -> NDArray[np.float64]:
        # Smoothing keeps the mean.  Without it no digits are lost where the origin is far away.
        centre = block.mean(axis=1, keepdims=True)
        rows = np.ascontiguousarray((block - centre).transpose(0, 2, 1))
        rows *= self._mass
        # Rows of a C array are columns of the Fortran array that the solvers want.
        solved = self._solve(rows.reshape(-1, self.n_vertices).T)
        moved = solved.T.reshape(rows.shape).transpose(0, 2, 1)
        return np.asarray(moved + centre)


@dataclasses.dataclass(frozen=True, eq=False)
class FrequencySplit:
    """Smooth part and detail of a sequence; their sum is the sequence.

    Attributes
    ----------
    low : (F, V, 3) array
        The smoothed frames, in the input's dtype.
    high : (F, V, 3) array
        ``frames - low``, in the input's dtype.
    smoother : LaplacianSmoother
        The smoother, for further frames of the same mesh.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> split = ssdr.laplacian.split_frequencies(dancer, length=0.05)
    >>> split.smoother.length, split.high.shape
    (0.05, (24, 799, 3))
    """

    low: NDArray[np.floating]
    high: NDArray[np.floating]
    smoother: LaplacianSmoother

    __repr__ = short_repr


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
    """Split every frame into a smooth part and a detail, whose sum is the frame.

    Parameters
    ----------
    frames : MeshSequence or (F, V, 3) array
    faces : (T, 3) int array, optional
        By default those of the sequence.
    length : float
        ℓ of :class:`LaplacianSmoother`, in the mesh's units.
    rest : int or (V, 3) array
        Index of a frame, or a pose, from which the operator is built.
    kind, mass, backend
        As in :class:`LaplacianSmoother`.

    Returns
    -------
    FrequencySplit
        ``low + high`` equals the input to half a unit in the last place of the larger of the input
        and ``high``, in the input's precision.  It is exactly the input where ``low`` is within a
        factor of two of it (Sterbenz's lemma).

    Raises
    ------
    InputError
        If an argument is not usable.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> split = ssdr.laplacian.split_frequencies(dancer, length=0.05)
    >>> np.allclose(split.low + split.high, dancer.vertices, atol=1e-5)
    True
    """
    if not isinstance(frames, MeshSequence):
        frames = MeshSequence(frames, faces)
    triangles = frames.faces if faces is None else faces
    if is_whole(rest):
        if not -frames.n_frames <= rest < frames.n_frames:
            raise InputError("rest", f"a frame below {frames.n_frames} or a (V, 3) pose", rest)
        pose = frames.frames(int(rest) % frames.n_frames)
    else:
        pose = as_array(rest, "rest", "a frame or a (V, 3) pose")
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
