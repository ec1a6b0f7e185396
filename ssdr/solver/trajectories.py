"""The animation in the solver's space: aligned, scaled, and compressed.

Each frame is centred and rotated onto the first, which removes the common motion and changes no
error, and all frames are scaled to unit size.  If the trajectories X (V, 3F) have nearly the rank
r, they are written as X ≈ Z Qᵀ, where Q has r orthonormal columns.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..common.checks import LARGEST
from ..common.errors import InputError
from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..kernels.normals import normals_range
from ..mesh.sequence import MeshSequence
from .alignment import Alignment, centred, rotations_onto
from .rest_surface import RestSurface

Array = NDArray[np.float64]

_TAIL = 1e-4  # squared error that compression may add, relative to a lower bound of B bones' error
_MOST_COLUMNS = 0.8  # share of all columns above which a basis costs more time than it saves
_NOISE = 1e-15  # rounding, relative to the sum of squares
_AT_ONCE = 64  # frames that are aligned together
_LOST_NORMALS = 0.01  # share of the squares of the normals that a basis may lose
_GRAM_LIMIT = 2000  # largest Gram matrix whose eigenvectors are all computed
_FEWEST_OF_PART = 3  # vertices that determine a rigid motion
# Squared deformation up to which a part is rigid, relative to its motion; and the square of that of
# rounding, relative to its squared positions.
_RIGID, _ROUNDING = 1e-6, 1e-13


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trajectories:
    """Trajectories of all vertices, each frame multiplied by the root of its importance.

    Attributes
    ----------
    alignment : Alignment
        How they were aligned and scaled.
    z : (V, r) float64
        Coefficients of the trajectories in the basis.
    q : (3F, r) float64 or None
        Orthonormal basis; None if the trajectories are not compressed, so that r = 3F.
    x2 : (V,) float64
        Squared norm of each vertex's uncompressed trajectory.
    importance : (V,) float64
        Importance of the vertices, whose mean is 1.
    frame_scale : (F,) float64
        Root of the importance of the frames.  The mean importance is 1.
    faces : (T, 3) int32
    normals : (V, r) float64 or None
        Coefficients, in the same basis, of the unit normals of the vertices in every frame; None
        while normals are not solved.
    n2 : (V,) float64 or None
        Sum of the squares of each vertex's normals before compression.
    surface : RestSurface or None
        Surface that the rest pose is to resemble; None if it is free.
    parts : (V,) int array or None
        Part of the mesh of each vertex, as :func:`find_parts` returns it.
    slack : float
        Squared error that counts for nothing against the objective's other terms.
    """

    alignment: Alignment
    z: Array
    q: Array | None
    x2: Array
    importance: Array
    frame_scale: Array
    faces: NDArray[np.int32]
    normals: Array | None = None
    n2: Array | None = None
    surface: RestSurface | None = None
    parts: NDArray[np.intp] | None = None
    slack: float = 0.0

    @property
    def n_frames(self) -> int:
        return len(self.frame_scale)

    @property
    def n_vertices(self) -> int:
        return len(self.z)

    def stack(self, transforms: Array) -> Array:
        """Matrix (3F, 4B) of transforms (F, B, 3, 4), multiplied by `frame_scale`."""
        return stack_transforms(transforms * self.frame_scale[:, None, None, None])

    def reduce(self, stacked: Array) -> Array:
        """Product of Qᵀ and a matrix (3F, n)."""
        return stacked if self.q is None else self.q.T @ stacked

    def expand(self, az: Array) -> Array:
        """Sums (F, 3, 4, B) over vertices for each frame, given the sums (4, B, r) of rows of z."""
        four, b, r = az.shape
        flat = az.reshape(four * b, r)
        full = flat.T if self.q is None else self.q @ flat.T
        out = full.reshape(self.n_frames, 3, four, b)
        return np.ascontiguousarray(out / self.frame_scale[:, None, None, None])

    def squares(self, rows: Any, length: float) -> Array:
        """Squared norms (n, P), over all frames, of the P points of each vertex in `rows`.

        The points are its position and, where normals are solved, its normal scaled to `length`.
        """
        if self.n2 is None:
            return self.x2[rows, None]
        return np.stack([self.x2[rows], length**2 * self.n2[rows]], axis=1)

    def products(self, rows: Any, reduced: Array, length: float) -> Array:
        """Sums Y (n, P, 4, B) of the vertices `rows`; `reduced` is that of ``transform_sums``."""
        z = self.z[rows]
        if self.normals is None:
            return np.asarray((z @ reduced).reshape(len(z), 1, 4, -1))
        y = np.empty((len(z), 2, reduced.shape[1]))
        np.matmul(z, reduced, out=y[:, 0])
        np.matmul(length * self.normals[rows], reduced, out=y[:, 1])
        return y.reshape(len(z), 2, 4, -1)

    def select_frames(self, frames: NDArray[np.intp]) -> Trajectories:
        """A copy with the chosen frames, for uncompressed trajectories without normals only."""
        assert self.q is None
        assert self.normals is None
        z = np.ascontiguousarray(self.z.reshape(self.n_vertices, -1, 3)[:, frames])
        flat = z.reshape(self.n_vertices, -1)
        return dataclasses.replace(
            self,
            z=flat,
            x2=np.einsum("ij,ij->i", flat, flat),
            alignment=self.alignment.select_frames(frames),
            frame_scale=self.frame_scale[frames],
        )

    def select_vertices(self, chosen: NDArray[np.intp]) -> Trajectories:
        """A copy of the chosen vertices in the same basis: no triangles, surface or normals."""
        return dataclasses.replace(
            self,
            z=np.ascontiguousarray(self.z[chosen]),
            x2=self.x2[chosen],
            importance=self.importance[chosen],
            faces=self.faces[:0],
            normals=None,
            n2=None,
            surface=None,
            parts=None if self.parts is None else self.parts[chosen],
        )

    @serial_blas()
    def with_normals(self, bones: int = 0) -> Trajectories:
        """A copy with the normals of all frames, computed from the positions that it holds.

        They are the means of the normals of the triangles around a vertex, weighted by the angles
        at the vertex (Thürmer and Wüthrich 1998).  Where the basis of the positions loses more than
        a hundredth of their squares, it gets 4 `bones` more columns by a randomised range finder
        (Halko et al. 2011): a sheet's waves may be sums of few translations, a basis without turns.
        """
        n, n_frames = self.n_vertices, self.n_frames
        normals, n2 = np.zeros((n, 3 * n_frames)), np.zeros(n)
        # triangles near each other one after the other, so that their vertices are in the cache
        faces = self.faces[np.argsort(self.faces.min(axis=1, initial=n), kind="stable")]
        for first, last in chunk_bounds(n_frames, _AT_ONCE):
            columns = slice(3 * first, 3 * last)
            x = self.z[:, columns] if self.q is None else self.z @ self.q[columns].T
            # a copy even of a single frame, for which the transpose makes none
            points = np.array(x.reshape(n, -1, 3).transpose(1, 0, 2), order="C")
            here = np.empty_like(points)

            def work(_: int, i: int, k: int, points: Array = points, here: Array = here) -> None:
                normals_range(points, faces, faces, here, i, k)

            run_chunks(work, chunk_bounds(last - first, 8))
            # the scale of a frame does not change the directions of its normals
            flat = normals[:, columns]
            scale = self.frame_scale[first:last, None]
            np.multiply(here.transpose(1, 0, 2), scale, out=flat.reshape(n, -1, 3))
            n2 += np.einsum("ij,ij->i", flat, flat)
        if self.q is None:
            return dataclasses.replace(self, normals=normals, n2=n2)
        z, q = self.z, self.q
        inside = normals @ q
        if (inside**2).sum() < (1 - _LOST_NORMALS) * n2.sum():
            count = min(4 * bones, 3 * n_frames - q.shape[1])
            more = normals.T @ np.random.default_rng(0).standard_normal((n, count))
            for _ in range(2):  # what is left may be small beside what is taken away
                more = np.linalg.qr(more - q @ (q.T @ more))[0]
            z, q = np.pad(z, ((0, 0), (0, count))), np.concatenate([q, more], axis=1)
            inside = np.concatenate([inside, normals @ more], axis=1)
        return dataclasses.replace(self, z=z, q=q, normals=inside, n2=n2)

    @serial_blas()
    def compressed(self, bones: int) -> Trajectories:
        """A copy with the fewest columns that lose next to nothing for a model of `bones` bones.

        The best matrix of rank 4B (Eckart–Young) has at most the squared error of any model with B
        bones.  Compression adds at most a ten-thousandth of that matrix's squared error.  If this
        needs nearly all columns, the trajectories stay uncompressed.
        """
        x = self.z
        if self.q is not None:
            return self
        if (self.importance == self.importance[0]).all():
            z, q = _reduce(x, float(self.x2.sum()), 4 * bones)
        else:
            # vertices without importance must not decide what the basis holds
            root = np.sqrt(self.importance)
            _, q = _reduce(x * root[:, None], float(self.importance @ self.x2), 4 * bones)
            z = x if q is None else np.ascontiguousarray(x @ q)
        if q is None:
            return self
        return dataclasses.replace(self, z=z, q=q)

    def rmse(self, squared: float) -> float:
        """RMSE, in the input's units, of a squared error in the solver's."""
        return self.alignment.scale * math.sqrt(squared / (self.n_frames * self.n_vertices))

    def frame(self, t: int) -> Array:
        """Positions (V, 3) of one frame."""
        columns = slice(3 * t, 3 * t + 3)
        x = self.z[:, columns] if self.q is None else self.z @ self.q[columns].T
        return np.ascontiguousarray(x / self.frame_scale[t])


@serial_blas()
def gather(
    sequences: Sequence[MeshSequence],
    *,
    bones: int,
    vertex_importance: Array | None = None,
    frame_importance: Array | None = None,
    compress: bool = True,
) -> Trajectories:
    """Read, align and scale all frames of all shots; if `compress`, compress for `bones` bones."""
    n_vertices = sequences[0].n_vertices
    n_frames = sum(map(len, sequences))
    importance = np.ones(n_vertices)
    if vertex_importance is not None:
        importance = vertex_importance / vertex_importance.mean()
    frame_scale = frame_scale_of(frame_importance, n_frames)
    # vertices without importance must not decide where the origin is
    share = None if vertex_importance is None else importance / n_vertices
    x = np.empty((n_vertices, n_frames, 3))
    centre = np.empty((n_frames, 3))
    rotation = np.empty((n_frames, 3, 3))
    first = None
    t = 0
    for sequence in sequences:
        for _, chunk in sequence.chunks():
            for start in range(0, len(chunk), _AT_ONCE):
                block = chunk[start : start + _AT_ONCE]
                last = t + len(block)
                here, centre[t:last] = centred(block, share)
                if first is None:
                    first = here[0]
                rotation[t:last] = rotations_onto(here, first, share)
                if t == 0:
                    rotation[0] = np.eye(3)
                x[:, t:last] = np.matmul(here, rotation[t:last]).transpose(1, 0, 2)
                t = last
    size = float(np.sqrt(np.vdot(x, x) / (n_vertices * n_frames)))
    if size <= 1 / LARGEST and 0 < float(np.abs(x).max()) < 1 / LARGEST:
        # squares would underflow to 0, and so would all errors
        raise InputError("vertices", f"an extent of 0, or above {1 / LARGEST:g}", "a smaller one")
    scale = size or 1.0
    parts = find_parts(sequences[0].faces, x)
    x *= (frame_scale / scale)[None, :, None]
    flat = x.reshape(n_vertices, 3 * n_frames)
    x2 = np.einsum("ij,ij->i", flat, flat)
    data = Trajectories(
        alignment=Alignment(centre=centre, rotation=rotation, scale=scale),
        z=flat,
        q=None,
        x2=x2,
        importance=importance,
        frame_scale=frame_scale,
        faces=sequences[0].faces,
        parts=parts,
    )
    return data.compressed(bones) if compress else data


def find_parts(faces: NDArray[np.int32], x: Array) -> NDArray[np.intp] | None:
    """Connected part of the mesh of each vertex (V,), for trajectories x (V, F, 3).

    Parts are counted from 0 if they move rigidly, and from −2 downward if they deform.  Those of
    one or two vertices, which do not determine the motion of a bone, are the part −1 together.
    None if no more than one part has three vertices.
    """
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    links = coo_array((np.ones(len(ends), dtype=bool), ends.T), shape=(len(x), len(x)))
    count, part = connected_components(links, directed=False)
    sizes = np.bincount(part, minlength=count)
    small = sizes < _FEWEST_OF_PART
    if count - small.sum() < 2:
        return None
    out = np.where(small[part], -1, -2 - part.astype(np.intp))
    order, ends_at = np.argsort(part, kind="stable"), np.cumsum(sizes)
    for k in np.flatnonzero(~small):
        rows = order[ends_at[k] - sizes[k] : ends_at[k]]
        frames = np.ascontiguousarray(x[rows].swapaxes(0, 1))
        here, _ = centred(frames, None)
        here = here @ rotations_onto(here, here[0], None)
        motion, square = ((frames - frames[0]) ** 2).sum(), (frames**2).sum()
        if ((here - here[0]) ** 2).sum() <= _RIGID * motion + _ROUNDING * square:
            out[rows] = k
    return out


def _reduce(x: Array, energy: float, rank: int) -> tuple[Array, Array | None]:
    n_rows, n_columns = x.shape
    if rank >= min(n_rows, n_columns):
        return x, None
    if min(n_rows, n_columns) > _GRAM_LIMIT:
        return _sketch(x, energy, rank)
    q = truncated_basis(x, lambda tail: max(_TAIL * tail[rank], _NOISE * energy))
    return (x, None) if q is None else (np.ascontiguousarray(x @ q), q)


def frame_scale_of(importance: Array | None, n_frames: int) -> Array:
    """Square roots (F,) of frames' importance, scaled to mean 1; all 1 if `importance` is None."""
    return np.ones(n_frames) if importance is None else np.sqrt(importance / importance.mean())


def truncated_basis(x: Array, allowed: Callable[[Array], float]) -> Array | None:
    """The fewest orthonormal columns that span the rows of x up to an allowed squared error.

    Parameters
    ----------
    x : (n, m) array
    allowed : callable
        Returns the allowed squared error for the array ``tail``, where ``tail[k]`` is the squared
        error with k columns.

    Returns
    -------
    (m, k) array or None
        None if nearly all columns would be needed.
    """
    wide = x.shape[1] > x.shape[0]
    values, vectors = np.linalg.eigh(x @ x.T if wide else x.T @ x)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    tail = np.append(np.cumsum(values[::-1])[::-1], 0.0)
    keep = max(1, int(np.argmax(tail <= allowed(tail))))
    if keep > _MOST_COLUMNS * x.shape[1]:
        return None
    basis = np.ascontiguousarray(vectors[:, :keep])
    if wide:
        scaled = basis / np.sqrt(np.maximum(values[:keep], 1e-300))
        basis = np.ascontiguousarray(np.linalg.qr(x.T @ scaled)[0])
    return basis


def _sketch(x: Array, energy: float, rank: int) -> tuple[Array, Array | None]:
    """As :func:`_reduce`, by a randomised range finder of growing size (Halko et al. 2011)."""
    rng = np.random.default_rng(0)
    keep = rank + 64
    while keep < _MOST_COLUMNS * min(x.shape):
        q, _ = np.linalg.qr(x.T @ (x @ (x.T @ rng.standard_normal((len(x), keep)))))
        z = x @ q
        values, vectors = np.linalg.eigh(z.T @ z)
        values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
        lost = max(0.0, energy - float(values.sum()))
        beyond = lost + float(values[rank:].sum())
        if lost <= max(_TAIL * beyond, _NOISE * energy) or lost <= 1e-13 * energy:
            return np.ascontiguousarray(z @ vectors), np.ascontiguousarray(q @ vectors)
        keep *= 2
    return x, None


def stack_transforms(transforms: Array) -> Array:
    """Matrix (3F, 4B) of transforms (F, B, 3, 4), with a row per frame and axis."""
    f, b = transforms.shape[:2]
    return np.ascontiguousarray(transforms.transpose(0, 2, 3, 1)).reshape(3 * f, 4 * b)


def unstack_transforms(stacked: Array, n_bones: int) -> Array:
    """Transforms (F, B, 3, 4), a view of stacked transforms (3F, 4B)."""
    return stacked.reshape(-1, 3, 4, n_bones).transpose(0, 3, 1, 2)
