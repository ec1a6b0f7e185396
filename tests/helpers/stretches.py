"""Bones that stretch: motions of them, and what each kind may do."""

from __future__ import annotations

from typing import Any

import numpy as np

from helpers import motions

KINDS = ("similarity", "affine")
MODELS = ("rigid", *KINDS)


def stretched(transforms: np.ndarray, kind: str, seed: int = 0, amount: float = 0.3) -> np.ndarray:
    """Rigid transforms with a stretch before them, smooth in time, none in frame 0."""
    rng = np.random.default_rng(seed)
    n_frames, n_bones = transforms.shape[:2]
    wave = np.sin(np.arange(n_frames)[:, None, None, None] * rng.uniform(0.2, 0.7, (n_bones, 3, 3)))
    if kind == "similarity":
        stretch = np.exp(amount * wave[..., :1, :1]) * np.eye(3)
    else:
        stretch = np.eye(3) + amount * wave * np.array([[1, 0.5, 0], [0.5, 1, 0.5], [0, 0.5, 1]])
    out = transforms.copy()
    out[..., :3] = transforms[..., :3] @ stretch
    assert np.linalg.det(out[..., :3]).min() > 0.05
    return out


def rig(kind: str, bones: int = 4, **options: Any) -> motions.Rig:
    """The chain with bones that stretch about their middle."""
    base = motions.chain(bones=bones, **options)
    middle = np.array([[0.0, 0.0, b + 0.5] for b in range(bones)])
    m = stretched(base.transforms, kind)
    m[..., 3] += np.einsum("tjab,jb->tja", base.transforms[..., :3] - m[..., :3], middle)
    return motions.Rig(base.rest, base.indices, base.weights, m, base.faces)


def check_kind(transforms: np.ndarray, kind: str) -> None:
    linear = transforms[..., :3]
    assert (np.linalg.det(linear) > 0).all()
    assert np.isfinite(transforms).all()
    if kind == "affine":
        return
    gram = np.einsum("tjca,tjcb->tjab", linear, linear)
    size = np.trace(gram, axis1=2, axis2=3) / 3
    if kind == "rigid":
        assert np.abs(size - 1).max() < 1e-9
    assert np.abs(gram / size[..., None, None] - np.eye(3)).max() < 1e-9
