"""Motion matching: the cloth of the training frames before which the body moved most alike.

After Clavet 2016, "Motion matching and the road to next-gen animation", with a garment in place of
a body: a database of windows of the body's motion, each with the virtual bones and the detail that
the simulation had at its end.  Nothing is trained.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

import ssdr
from garmentnet.configs.config import FeatureOptions
from garmentnet.data.clip import Clip
from garmentnet.evaluation.methods import Method
from garmentnet.networks.features import Normaliser, PoseFeatures, transforms_in_frame
from garmentnet.paper.bones import TorchSkinning, VirtualBones, turn, turn_back

__all__ = ["MotionMatching", "Windows"]

Array = np.ndarray
# Frames of a window, counted back from its end: two thirds of a second at 30 a second.
LAGS = (0, 2, 5, 10, 20)
# Normalised distance below which a window counts as the same.
_SAME = 1e-9


class Windows:
    """Windows of motions ``(F, D)``, one for each of their frames, and a search among them.

    A window that begins before its motion repeats the first frame.

    Parameters
    ----------
    motions : sequence of (F, D) array
        Normalised features; windows are numbered over all motions.
    lags : sequence of int
        Frames of a window, counted back from its end.
    chosen : sequence of int arrays, optional
        Frames of each motion at which windows end; all by default.
    """

    def __init__(
        self,
        motions: Sequence[Array],
        lags: Sequence[int] = LAGS,
        chosen: Sequence[Any] | None = None,
    ) -> None:
        self.lags = np.asarray(lags)
        some = [slice(None)] * len(motions) if chosen is None else chosen
        rows = [self.of(m)[c] for m, c in zip(motions, some, strict=True)]
        self.tree = cKDTree(np.concatenate(rows))

    def of(self, motion: Array) -> Array:
        """Windows ``(F, L D)`` of a motion."""
        index = np.maximum(np.arange(len(motion))[:, None] - self.lags, 0)
        return np.asarray(motion[index].reshape(len(motion), -1))

    def nearest(self, motion: Array, count: int) -> tuple[Array, Array]:
        """Numbers and weights ``(F, count)`` of the nearest, by inverse squared distance."""
        gap, index = self.tree.query(self.of(motion), np.arange(1, count + 1))
        weight = 1 / np.maximum(gap, _SAME) ** 2
        return index, weight / weight.sum(axis=1, keepdims=True)


class MotionMatching(Method):
    """Baseline that blends bones and detail of the nearest training windows.

    Parameters
    ----------
    bones : VirtualBones
    names : sequence of str
        Training clips.
    features : FeatureOptions
        Features of the body's motion that are compared.
    frames : int
        Training frames, evenly spread, in the database.
    count : int
        Windows that are blended.
    """

    name = "motion matching"

    def __init__(
        self,
        bones: VirtualBones,
        names: Sequence[str],
        features: FeatureOptions,
        *,
        frames: int = 1000,
        count: int = 4,
    ) -> None:
        s, store = bones.skinning, bones.store
        self.bones, self.count = bones, count
        self.features = PoseFeatures(store.skeleton, features, store.fps)
        self.lbs = TorchSkinning.of(s)
        read, chosen, local, detail = [], [], [], []
        for clip, some in store.sample(names, frames):
            x, frame, _ = self.features(clip.joints)
            low, high = bones.split(clip.name, some)
            m = bones.fit(low)
            read.append(x)
            chosen.append(some)
            local.append(transforms_in_frame(m, frame[some]))
            detail.append(turn_back(self._blend(m), torch.from_numpy(high)).numpy())
        self.scale = Normaliser.fit(read, floor=features.floor, clamp=features.clamp)
        self.windows = Windows([self.scale(x) for x in read], chosen=chosen)
        self.local, self.detail = np.concatenate(local), np.concatenate(detail)

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """The skinned bones, and the detail that turns with them."""
        x, frame, _ = self.features(clip.joints)
        index, weight = self.windows.nearest(self.scale(x), self.count)
        m = np.einsum("fk,fkbij->fbij", weight, self.local[index])
        r, t = frame[:, None, :, :3], frame[:, None, :, 3:]
        world = r @ m
        world[..., 3:] += t
        s = bones.skinning
        low = np.asarray(ssdr.skin(s.rest, s.indices, s.weights, world), np.float32)
        mixed = np.stack(
            [np.tensordot(w, self.detail[k], 1) for w, k in zip(weight, index, strict=True)]
        )
        high = turn(self._blend(world), torch.from_numpy(mixed).float()).numpy()
        if bones.bound is not None:
            high = bones.bound.place(low + high, clip.joints) - low
        return low, high

    def predict(self, clip: Clip) -> Array:
        low, high = self.split(clip, self.bones)
        return low + high

    def _blend(self, transforms: Any) -> torch.Tensor:
        return self.lbs.blend(torch.from_numpy(np.asarray(transforms, np.float32)))
