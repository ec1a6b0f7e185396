"""Principal components of meshes: a frame as some two hundred numbers instead of its vertices."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Variances below this part of the largest are rounding.
_NOTHING = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class ShapeBasis:
    """Mean and principal components of meshes.

    Attributes
    ----------
    mean : (V, 3) float32
    components : (r, V, 3) float32
        Orthonormal, those of largest variance first; 0 where the meshes have no more.
    deviation : (r,) float32
        Standard deviation of each component's coefficient; 1 where the component is 0.
    sign : (r,) float32
        Factors that turn the coefficients of a mesh into those of its mirror image: 1 for a
        symmetric component, −1 for an antisymmetric one.  All 1 if no symmetry is known.

    Examples
    --------
    >>> line = np.linspace(-1, 1, 9)[:, None, None] * np.ones((1, 2, 3)) + 5
    >>> basis = ShapeBasis.fit(line, rank=1)
    >>> bool(np.allclose(basis.decode(basis.encode(line)), line, atol=1e-5))
    True
    """

    mean: NDArray[np.float32]
    components: NDArray[np.float32]
    deviation: NDArray[np.float32]
    sign: NDArray[np.float32]

    @classmethod
    def fit(cls, meshes: Any, rank: int, mirror: NDArray[np.integer] | None = None) -> ShapeBasis:
        """Basis of meshes ``(F, V, 3)`` and, if `mirror` is given, of their mirror images.

        Parameters
        ----------
        meshes : (F, V, 3) array
        rank : int
            Number of components.
        mirror : (V,) int array, optional
            Mirror image of each vertex in the plane x = 0.
        """
        x = np.asarray(meshes, np.float64)
        parts, signs = [x], [1.0]
        if mirror is not None:
            # The covariance of meshes and mirror images has no term that mixes the two kinds.
            image = x[:, mirror] * (-1, 1, 1)
            parts, signs = [(x + image) / 2, (x - image) / 2], [1.0, -1.0]
        mean = parts[0].mean(axis=0)
        parts[0] = parts[0] - mean
        found = [_principal(part.reshape(len(x), -1), rank) for part in parts]
        variance = np.concatenate([v for v, _ in found])
        order = np.argsort(-variance, kind="stable")[:rank]
        rows = np.concatenate([c for _, c in found])[order]
        sign = np.repeat(signs, [len(v) for v, _ in found])[order]
        deviation = np.sqrt(variance[order])
        lack = rank - len(order)
        return cls(
            mean.astype(np.float32),
            np.pad(rows, ((0, lack), (0, 0))).reshape(rank, *mean.shape).astype(np.float32),
            np.pad(deviation, (0, lack), constant_values=1).astype(np.float32),
            np.pad(sign, (0, lack), constant_values=1).astype(np.float32),
        )

    @property
    def rank(self) -> int:
        return len(self.components)

    def encode(self, meshes: Any) -> NDArray[np.float32]:
        """Coefficients ``(F, r)`` of meshes ``(F, V, 3)``."""
        flat = (np.asarray(meshes, np.float32) - self.mean).reshape(len(meshes), -1)
        return np.asarray(flat @ self.components.reshape(self.rank, -1).T, np.float32)

    def decode(self, coefficients: Any) -> NDArray[np.float32]:
        """Meshes ``(F, V, 3)`` with coefficients ``(F, r)``."""
        flat = np.asarray(coefficients, np.float32) @ self.components.reshape(self.rank, -1)
        return np.asarray(self.mean + flat.reshape(-1, *self.mean.shape), np.float32)


def _principal(
    rows: NDArray[np.float64], rank: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Variances, largest first, and orthonormal components of rows whose mean is 0."""
    values, vectors = np.linalg.eigh(rows @ rows.T)
    values, vectors = values[::-1][:rank], vectors[:, ::-1][:, :rank]
    there = values > _NOTHING * max(values[0], 1e-30)
    values, vectors = values[there], vectors[:, there]
    return values / len(rows), (rows.T @ (vectors / np.sqrt(values))).T
