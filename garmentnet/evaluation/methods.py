"""Interface of methods to evaluate; trained networks, and the fitted bones as their bounds."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import ssdr

from ..data.clip import Clip
from ..networks.checkpoint import Checkpoint
from ..networks.network import NetworkOutput
from ..paper.bones import TorchSkinning, VirtualBones, turn, turn_back

# Number of training frames, evenly spread, of which the mean detail is taken.
_MEAN_FRAMES = 1000

Array = NDArray[np.float32]


class Method(ABC):
    """A prediction of the garment's vertices from the body's motion.

    A further baseline is a subclass with a ``name`` and :meth:`predict`, and a line in
    :func:`garmentnet.evaluation.baselines.fit_baselines`.
    """

    name: str

    @abstractmethod
    def predict(self, clip: Clip) -> Array:
        """Vertices ``(F, V, 3)`` in the world, metres, float32.

        Of the clip, a method may read only the motion ``joints`` and the ``parameters``.
        """

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """Low- and high-frequency part of the prediction, each ``(F, V, 3)``.

        By default the prediction is split like the data: its smoothed vertices are the low part.
        Vertices bound to the body are placed by the body, since every method knows them.
        """
        vertices = self.predict(clip)
        if bones.bound is not None:
            vertices = bones.bound.place(vertices, clip.joints)
        low = np.asarray(bones.smoother.smooth(vertices), np.float32)
        return low, vertices - low


class Network(Method):
    """Prediction by a checkpoint.

    An ensemble, or a network that reads parameters, is given those of the clip.
    """

    def __init__(self, name: str, checkpoint: Checkpoint) -> None:
        self.name, self.checkpoint = name, checkpoint

    def predict(self, clip: Clip) -> Array:
        return self.checkpoint.predict(clip.joints, clip.parameters)

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """The outputs of the two modules."""
        motions = self.checkpoint.motions(clip.joints, clip.parameters)
        low = np.concatenate([m.to_world(m.low) for m in motions])
        return low, np.concatenate([_detail(m) for m in motions])


class BonesThemselves(Method):
    """The bound for every network: skinning with the fitted bones, plus the simulated detail."""

    name = "bones themselves"

    def __init__(self, bones: VirtualBones) -> None:
        self.bones = bones

    def predict(self, clip: Clip) -> Array:
        low, high = self.split(clip, self.bones)
        return low + high

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """The skinned bones and the clip's own high part."""
        s, m = bones.skinning, bones.transforms(clip.name)
        low = np.asarray(ssdr.skin(s.rest, s.indices, s.weights, m), np.float32)
        true_low, high = bones.split(clip.name)
        if bones.bound is not None:
            # Where a network has them, too.
            low[:, bones.bound.index] = true_low[:, bones.bound.index]
        return low, high


class MeanDetail(BonesThemselves):
    """The bones themselves with one constant vector for each vertex as detail.

    The vectors turn with the skinned surface and are means over the clips of which the bones were
    found: what a network has of the detail that learns nothing of the motion.

    Parameters
    ----------
    bones : VirtualBones
    """

    name = "mean detail alone"

    def __init__(self, bones: VirtualBones) -> None:
        super().__init__(bones)
        self.lbs = TorchSkinning.of(bones.skinning)
        total, frames = np.zeros((bones.skinning.n_vertices, 3)), 0
        for clip, some in bones.store.sample(bones.report["clips"], _MEAN_FRAMES):
            low, high = bones.split(clip.name, some)
            total += turn_back(self._blend(bones.fit(low)), torch.from_numpy(high)).sum(0).numpy()
            frames += len(some)
        self.mean: Array = np.asarray(total / frames, np.float32)

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """The skinned bones and the mean detail, turned with them."""
        low, _ = super().split(clip, bones)
        blend = self._blend(bones.transforms(clip.name))
        return low, np.asarray(turn(blend, torch.from_numpy(self.mean)).numpy())

    def _blend(self, transforms: Array) -> Tensor:
        return self.lbs.blend(torch.from_numpy(transforms))


def _detail(motion: NetworkOutput) -> Array:
    if motion.high is None:
        return np.zeros(motion.low.shape, np.float32)
    turned = motion.high.double().cpu().numpy() @ motion.frame[..., :3].transpose(0, 2, 1)
    return np.asarray(turned, np.float32)
