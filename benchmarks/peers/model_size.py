"""Bytes of a model as an engine keeps it, its error at that precision, and PCA at equal bytes."""

from __future__ import annotations

from typing import Any

import numpy as np

POSITION = 12  # bytes: three float32
# a bone in a frame: quaternion and translation; a scale as well; a matrix, all float32
KEY = {"rigid": 28, "similarity": 32, "affine": 48}


def model_bytes(
    vertices: int, frames: int, bones: int, used: int, weight_bits: int, bone_model: str = "rigid"
) -> int:
    """Bytes of a model with a key at every frame; `used` weights are not zero.

    A position and a count of influences a vertex, a bone number and a weight for each of them, a
    position and its keys a bone: the formula of ``ssdr.parsimony.size``, which keeps 16 bits.
    """
    index = 1 if bones <= 256 else 2
    skin = vertices + used * (index + weight_bits // 8)
    return POSITION * (vertices + bones) + skin + KEY[bone_model] * frames * bones


def stored_weights(weights: np.ndarray, bits: int) -> np.ndarray:
    """Weights (V, K) as unsigned integers of so many bits hold them; rows sum to 1 exactly.

    Rounded down, what is missing to the sum goes to the largest remainders.
    """
    top = 2**bits - 1
    scaled = np.asarray(weights, dtype=np.float64) * top
    whole = np.floor(scaled + 1e-9)
    missing = np.rint(top - whole.sum(axis=1)).astype(int)
    rank = np.argsort(np.argsort(whole - scaled, axis=1, kind="stable"), axis=1, kind="stable")
    return (whole + (rank < missing[:, None])) / top


def dense(indices: np.ndarray, weights: np.ndarray, bones: int) -> np.ndarray:
    """Weights (V, B)."""
    out = np.zeros((len(indices), bones))
    np.add.at(out, (np.arange(len(indices))[:, None], indices), weights)
    return out


def sparse(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices and weights (V, K), largest first, of weights (V, B); K as large as needed."""
    k = max(1, int((weights > 0).sum(axis=1).max()))
    indices = np.argsort(-weights, axis=1, kind="stable")[:, :k]
    return indices, np.take_along_axis(weights, indices, axis=1)


def skinned_errors(
    frames: np.ndarray, rest: np.ndarray, weights: np.ndarray, transforms: np.ndarray
) -> tuple[float, float]:
    """E and the largest distance of a vertex, of weights (V, B), in float64.

    One matrix product a block of frames.
    """
    homogeneous = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    a = (weights[:, :, None] * homogeneous[:, None, :]).reshape(len(rest), -1)
    squared, largest = 0.0, 0.0
    for first in range(0, len(frames), 64):
        block = np.asarray(frames[first : first + 64], dtype=np.float64)
        m = np.asarray(transforms[first : first + 64], dtype=np.float64)
        columns = m.transpose(1, 3, 0, 2).reshape(-1, 3 * len(m))  # (4B, 3f)
        skinned = (a @ columns).reshape(len(rest), len(m), 3).transpose(1, 0, 2)
        off = ((block - skinned) ** 2).sum(axis=2)
        squared, largest = squared + float(off.sum()), max(largest, float(off.max()))
    return 1000.0 * float(np.sqrt(squared / frames.size)), float(np.sqrt(largest))


def skinned_e(*model: np.ndarray) -> float:
    """E alone of `skinned_errors`."""
    return skinned_errors(*model)[0]


def stored(
    frames: np.ndarray,
    rest: np.ndarray,
    indices: np.ndarray,
    weights: np.ndarray,
    transforms: np.ndarray,
    bone_model: str = "rigid",
) -> dict[str, Any]:
    """Bytes and E with weights of 8 and of 16 bits."""
    n_frames, bones = transforms.shape[:2]
    out: dict[str, Any] = {}
    for bits in (8, 16):
        w = dense(indices, stored_weights(weights, bits), bones)
        used = int(np.count_nonzero(w))
        out[f"bytes{bits}"] = model_bytes(len(rest), n_frames, bones, used, bits, bone_model)
        out[f"E{bits}"] = skinned_e(frames, rest, w, transforms)
    return out


def pca_curve(frames: np.ndarray, points: int = 24) -> list[tuple[int, int, float]]:
    """Rank, bytes and E of the best linear models of the trajectories (Eckart and Young).

    The mean trajectory and r basis trajectories in float32, r coefficients a vertex in 16 bits.
    """
    n_frames, n = frames.shape[:2]
    x = np.asarray(frames, dtype=np.float64).transpose(1, 0, 2).reshape(n, 3 * n_frames)
    x = x - x.mean(axis=0)
    _, values, basis = np.linalg.svd(x, full_matrices=False)
    basis = basis[values > 1e-7 * values[0]]
    coefficients = x @ basis.T
    step = np.maximum(np.abs(coefficients).max(axis=0), 1e-300) / (2**15 - 1)
    coefficients = np.rint(coefficients / step) * step
    curve = []
    for r in np.unique(np.geomspace(1, len(basis), points).round().astype(int)):
        left = x - coefficients[:, :r] @ basis[:r]
        e = 1000.0 * float(np.linalg.norm(left)) / float(np.sqrt(x.size))
        curve.append((int(r), int(12 * n_frames + r * (2 * n + 12 * n_frames)), e))
    return curve
