"""What errors are seen against: the chaos floor."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..data.motion import CLASSES
from ..data.virtual_bones import VirtualBones

__all__ = ["chaos_floor"]

_MM = 1e3  # from metres to millimetres


def chaos_floor(
    bones: VirtualBones, pairs: Iterable[tuple[str, str]] | None = None
) -> dict[str, dict[str, float]]:
    """RMSE / √2, mm, between clips and the same clips from a perturbed first frame.

    Two such runs differ by √2 times their distance from the mean of all runs, and no function of
    the motion can be expected to do better than that mean.

    Parameters
    ----------
    bones : VirtualBones
    pairs : pairs of names, optional
        :meth:`ClipStore.pairs` by default.

    Returns
    -------
    dict
        For each class of motion and for "all": RMSE / √2 ``low`` and ``overall``, over free
        vertices ``low_free`` and ``overall_free``, and the number of ``frames``; empty without
        pairs.
    """
    keys = ("low", "overall", "low_free", "overall_free")
    free = ~np.asarray(bones.store.pinned, bool)
    sums: dict[str, NDArray[np.float64]] = {}
    smoother = bones.smoother
    for first, second in bones.store.pairs() if pairs is None else pairs:
        a, b = bones.store.clip(first), bones.store.clip(second)
        frames = min(a.n_frames, b.n_frames)
        gap = a.sequence.frames(slice(0, frames)) - b.sequence.frames(slice(0, frames))
        # Smoothing is linear: the difference of the low parts is the smoothed difference.
        low = np.asarray(smoother.smooth(gap))
        of_vertices = [(x.astype(np.float64) ** 2).sum(-1) for x in (low, gap)]
        means = [x[:, part].mean(-1) for part in (slice(None), free) for x in of_vertices]
        squares = np.stack([*means, np.ones(frames)])
        for label in [-1, *np.unique(a.classes[:frames])]:
            chosen = a.classes[:frames] == label if label >= 0 else slice(None)
            key = CLASSES[int(label)] if label >= 0 else "all"
            sums[key] = sums.get(key, np.zeros(5)) + squares[:, chosen].sum(axis=1)
    return {
        name: {k: _MM * math.sqrt(x / s[4] / 2) for k, x in zip(keys, s[:4], strict=True)}
        | {"frames": float(s[4])}
        for name, s in sums.items()
    }
