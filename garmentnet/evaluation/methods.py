"""Methods to evaluate: their interface, trained networks, and two bounds on the error."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

import ssdr

from ..data.clip import Clip
from ..data.store import ClipStore
from ..networks.checkpoint import Checkpoint
from ..paper.bones import VirtualBones

Array = NDArray[np.float32]


class Method(ABC):
    """Method that predicts a garment's low and high frequencies from the body's motion.

    Of a clip, it may read only the motion ``joints`` and the ``parameters``.
    """

    name: str

    @abstractmethod
    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """Low- and high-frequency part of the prediction, each ``(F, V, 3)``, metres, float32."""


class VertexMethod(Method):
    """A method that predicts vertices, which are split like the data.

    A further baseline is a subclass with a ``name`` and :meth:`predict`, and a line in
    :func:`garmentnet.evaluation.baselines.fit_baselines`.
    """

    @abstractmethod
    def predict(self, clip: Clip) -> Array:
        """Vertices ``(F, V, 3)`` in the world, metres, float32."""

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """Smoothed vertices, and what they leave.

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

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """The outputs of the two modules."""
        motions = self.checkpoint.motions(clip.joints, clip.parameters)
        low = np.concatenate([m.to_world(m.low) for m in motions])
        return low, np.concatenate([m.vertices() for m in motions]) - low


class BonesThemselves(Method):
    """The bound for every network: skinning with the fitted bones, plus the simulated detail."""

    name = "bones themselves"

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """The skinned bones and the clip's own high part."""
        s, m = bones.skinning, bones.transforms(clip.name)
        low = np.asarray(ssdr.skin(s.rest, s.indices, s.weights, m), np.float32)
        true_low, high = bones.split(clip.name)
        if bones.bound is not None:
            # Where a network has them, too.
            low[:, bones.bound.index] = true_low[:, bones.bound.index]
        return low, high


class Chaos(VertexMethod):
    """Floor of every network's error: how far two simulations drift apart that start nearly alike.

    Its RMSE is that floor, other figures are not.  Two such runs differ by √2 times their distance
    from the mean of all runs, and no function of the motion can be expected to do better than that
    mean.  So the prediction lies 1 / √2 of the way to the clip's repetition from a perturbed start.

    Parameters
    ----------
    store : ClipStore
        Clips, some of which have such a repetition.

    Attributes
    ----------
    twins : dict
        Name of the repetition, by that of the clip.
    """

    name = "chaos of the cloth"

    def __init__(self, store: ClipStore) -> None:
        self.store, self.twins = store, dict(store.pairs())

    def predict(self, clip: Clip) -> Array:
        own = np.asarray(clip.sequence.frames(slice(None)))
        other = self.store.clip(self.twins[clip.name]).sequence.frames(slice(None))
        return np.asarray(own + (other - own) / math.sqrt(2), np.float32)
