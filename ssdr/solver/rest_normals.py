"""The best rest normals for a model's bones and weights, from which a solve of normals starts."""

from __future__ import annotations

import numpy as np

from ..parallel import chunk_bounds, run_chunks, serial_blas
from .model import CHUNK, Model
from .moments import transform_sums
from .trajectories import Array, Trajectories

_LEAST = 1e-9  # added to a system's diagonal, relative to its trace


@serial_blas()
def with_rest_normals(data: Trajectories, model: Model) -> Model:
    """A copy with the rest normals n_i that minimise Σ_t |Σ_j w_ij R_j^t n_i − n_i^t|²."""
    assert data.normals is not None
    assert data.n2 is not None
    out = model.copy()
    out.normals = np.zeros((data.n_vertices, 1, 3))
    _, _, gram, reduced = transform_sums(data, model.transforms)
    turns = np.ascontiguousarray(gram[..., :3, :3])
    normals, n2 = data.normals, data.n2

    def work(_: int, i: int, k: int) -> None:
        ids, w = model.indices[i:k], model.weights[i:k]
        y = (normals[i:k] @ reduced).reshape(k - i, 4, -1)[:, :3]
        right = np.einsum("vk,vck->vc", w, np.take_along_axis(y, ids[:, None].astype(int), axis=2))
        left = np.zeros((k - i, 3, 3))
        for q in range(w.shape[1]):
            for s in range(w.shape[1]):
                left += (w[:, q] * w[:, s])[:, None, None] * turns[ids[:, q], ids[:, s]]
        trace = np.einsum("vcc->v", left)
        held = left + (_LEAST * trace + 1e-300)[:, None, None] * np.eye(3)
        n: Array = np.linalg.solve(held, right[..., None])[..., 0]
        error = n2[i:k] - 2.0 * (right * n).sum(axis=1) + np.einsum("va,vab,vb->v", n, left, n)
        out.normals[i:k, 0], out.normal_error[i:k] = n, np.maximum(error, 0.0)

    run_chunks(work, chunk_bounds(data.n_vertices, CHUNK))
    return out
