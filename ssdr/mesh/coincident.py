"""Vertices that coincide in every frame, as at seams or in a triangle soup.

Solved separately they would drift apart, and the mesh would crack: they are solved as one vertex.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.intp]


def coincident(blocks: Iterable[NDArray[np.floating]], n_vertices: int) -> Rows:
    """Labels ``(V,)``, equal for vertices whose positions are equal in all blocks ``(n, V, 3)``.

    Reading stops when no two vertices coincide in all the blocks read so far.
    """
    label = np.zeros(n_vertices, dtype=np.intp)
    for block in blocks:
        some = np.flatnonzero(np.bincount(label)[label] > 1)
        if not len(some):
            break
        # adding 0.0 makes -0.0 equal to 0.0 in its bytes, too
        paths = np.ascontiguousarray(block[:, some].transpose(1, 0, 2)).reshape(len(some), -1) + 0.0
        rows = paths.view(np.dtype((np.void, paths.dtype.itemsize * paths.shape[1]))).ravel()
        here = np.zeros(n_vertices, dtype=np.intp)
        here[some] = np.unique(rows, return_inverse=True)[1].ravel()
        label = np.unique(label * n_vertices + here, return_inverse=True)[1].ravel()
    return label


def distinct(label: Rows) -> tuple[Rows, Rows]:
    """First vertex of each label (U,), ascending, and each vertex's row in that array (V,)."""
    _, kept, row = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(kept)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return kept[order], rank[row.ravel()]


def told_apart(label: Rows, *arrays: NDArray[Any] | None) -> Rows:
    """Labels ``(V,)``, equal for vertices with the same `label` and equal rows of all `arrays`."""
    parts = [np.reshape(a, (len(label), -1)) for a in arrays if a is not None]
    if not parts or label.max() + 1 == len(label):
        return label
    every = np.concatenate([label[:, None], *parts], axis=1)
    return np.unique(every, axis=0, return_inverse=True)[1].ravel()


@dataclasses.dataclass(frozen=True, eq=False)
class Selected:
    """Lazy view of some vertices of an array (F, V, 3) that is read on demand."""

    source: Any
    kept: Rows

    @property
    def shape(self) -> tuple[int, int, int]:
        return (int(self.source.shape[0]), len(self.kept), 3)

    @property
    def dtype(self) -> np.dtype[Any]:
        dtype: np.dtype[Any] = np.dtype(self.source.dtype)
        return dtype

    def __getitem__(self, frames: Any) -> NDArray[np.floating]:
        return np.asarray(self.source[frames])[..., self.kept, :]
