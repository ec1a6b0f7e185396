"""Baselines that need no iterative training: mean shape, body skinning, ridge regression."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.linalg import solve
from scipy.spatial import cKDTree

import ssdr
from ssdr import Skinning

from ..data.clip import Clip
from ..data.store import ClipStore
from ..networks.features import HEADING, Normaliser, PoseFeatures, transforms_in_frame
from ..paper.bones import TorchSkinning, VirtualBones, apply_frame, remove_frame
from ..paper.low import BoneCode
from .methods import Method, VertexMethod

_INFLUENCES = 8  # joints per vertex, as many as engines support
_NEIGHBOURS = 8  # body vertices from which a weight is interpolated
# Least distance, metres, of a body vertex in its weight, so that no weight is infinite.
_CLOSEST = 1e-4
# Approximate number of frames to which the ridge is fitted, in evenly spread clips: 200 per input.
_FRAMES = 24000
# Number of training frames, evenly spread, of which the mean is taken.
_MEAN_FRAMES = 4000

# Penalties per frame that are tried, from a negligible to a dominant one.
_PENALTIES = 10.0 ** np.arange(-6, 2)


class MeanShape(VertexMethod):
    """Baseline whose garment is the mean of the training frames, moved with the root and heading.

    Parameters
    ----------
    bones : VirtualBones
    names : sequence of str
        Training clips.
    """

    name = "mean shape"

    def __init__(self, bones: VirtualBones, names: Sequence[str]) -> None:
        self.features = PoseFeatures(bones.store.skeleton, HEADING, bones.store.fps)
        total, high = (np.zeros((bones.store.n_vertices, 3)) for _ in range(2))
        frames = 0
        for clip, some in bones.store.sample(names, _MEAN_FRAMES):
            frame = self.features(clip.joints)[1][some]
            low, detail = bones.split(clip.name, some)
            total += remove_frame(frame, low).sum(axis=0)
            high += (detail @ frame[..., :3]).sum(axis=0)
            frames += len(some)
        self.high: NDArray[np.float64] = np.asarray(high / frames)
        self.shape: NDArray[np.float64] = total / frames + self.high

    def predict(self, clip: Clip) -> NDArray[np.float32]:
        _, frame, _ = self.features(clip.joints)
        return np.asarray(apply_frame(frame, self.shape), np.float32)


def body_skinning(store: ClipStore) -> Skinning:
    """Skinning of the garment's rest pose by the body's joints.

    Weights are interpolated from the closest body vertices in the rest pose, by inverse squared
    distance, which is how riggers start.
    """
    body = store.body
    count = min(_NEIGHBOURS, body.n_vertices)
    distance, index = cKDTree(body.rest).query(store.rest, k=np.arange(1, count + 1))
    near = 1 / np.maximum(distance, _CLOSEST) ** 2
    near /= near.sum(axis=1, keepdims=True)
    weights = np.einsum("vk,vkj->vj", near, body.dense_weights()[index])
    options: dict[str, Any] = {"faces": store.faces, "fps": store.fps}
    return Skinning.from_dense(
        store.rest, weights, body.transforms, influences=_INFLUENCES, **options
    )


class BodySkinned(VertexMethod):
    """Baseline that skins the garment's rest pose by the body's joints."""

    name = "body-skinned"

    def __init__(self, store: ClipStore) -> None:
        self.skinning = body_skinning(store)

    def predict(self, clip: Clip) -> NDArray[np.float32]:
        s = self.skinning
        m = np.asarray(clip.joints, np.float64)
        return np.asarray(ssdr.skin(s.rest, s.indices, s.weights, m), np.float32)


class Ridge(VertexMethod):
    """Baseline that predicts the bones from the pose of a single frame by ridge regression.

    The input is the pose relative to the root as 6D rotations, the output the rotations and centres
    of the bones.  Of several penalties the one with the least error on the validation clips is
    taken; without these on the last training clip, which is then not learned unless it is the only
    one.  A mean detail is added.

    Parameters
    ----------
    bones : VirtualBones
    names, validation : sequence of str
        Clips.
    high : (V, 3) array
        Mean detail of the training clips.
    """

    name = "ridge"

    def __init__(
        self,
        bones: VirtualBones,
        names: Sequence[str],
        validation: Sequence[str],
        high: NDArray[np.float64],
    ) -> None:
        self.features = PoseFeatures(bones.store.skeleton, HEADING, bones.store.fps)
        garment = bones.skinning
        self.code = BoneCode(garment.centroids(), "sixd")
        self.lbs = TorchSkinning.of(garment)
        self.high = high
        # Fitting the bones of a clip takes most of the time.
        length = sum(bones.store.clip(n).n_frames for n in names)
        every = max(1, round(length / _FRAMES))
        if not validation:
            names, validation = names[:-1] or names, names[-1:]
        learned = names[::every]
        known, held = ([self._pair(bones, n) for n in c] for c in (learned, validation))
        o, least = HEADING, math.inf
        self.normaliser = Normaliser.fit([x for x, _ in known], floor=o.floor, clamp=o.clamp)
        x = np.concatenate([self.normaliser(x) for x, _ in known]).astype(float)
        y = np.concatenate([y for _, y in known])
        self.mean = y.mean(axis=0)
        for penalty in len(x) * _PENALTIES:
            gram = x.T @ x + penalty * np.eye(x.shape[1])
            matrix = solve(gram, x.T @ (y - self.mean), assume_a="pos")
            gaps = [self.normaliser(a) @ matrix + self.mean - b for a, b in held]
            error = sum(float(np.square(g).sum()) for g in gaps)
            if error < least:
                self.matrix, least = matrix, error

    def _pair(self, bones: VirtualBones, name: str) -> tuple[Any, Any]:
        x, frame, _ = self.features(bones.store.clip(name).joints)
        local = transforms_in_frame(bones.transforms(name), frame)
        return x, self.code.numbers(local).reshape(len(x), -1)

    def predict(self, clip: Clip) -> NDArray[np.float32]:
        x, frame, _ = self.features(clip.joints)
        y = (self.normaliser(x) @ self.matrix + self.mean).reshape(len(x), *self.code.shape)
        low = self.lbs(self.code(torch.from_numpy(y).float())).double().numpy()
        return np.asarray(apply_frame(frame, low + self.high), np.float32)


def fit_baselines(
    bones: VirtualBones, names: Sequence[str], validation: Sequence[str]
) -> list[Method]:
    """The mean shape, skinning by the body and the ridge, fitted to the named clips."""
    mean = MeanShape(bones, names)
    return [mean, BodySkinned(bones.store), Ridge(bones, names, validation, mean.high)]
