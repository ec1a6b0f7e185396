"""What is evaluated: the interface of a method, networks, the push-out and the bound."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

import ssdr

from ..collision.push_out import PushOut
from ..data.clip import Clip
from ..data.outfit import Outfit
from ..data.virtual_bones import VirtualBones
from ..networks.checkpoint import Checkpoint
from ..networks.network import Motion

__all__ = ["BonesThemselves", "Method", "Network", "PushedMethod"]

Array = NDArray[np.float32]


class Method(ABC):
    """A prediction of the garment's vertices from the body's motion.

    A further baseline is a subclass with a ``name`` and :meth:`predict`, and a line in
    :func:`garmentnet.evaluation.reporting.report`, which fits it.
    """

    name: str

    @abstractmethod
    def predict(self, clip: Clip) -> Array:
        """Vertices ``(F, V, 3)`` in the world, metres, float32.

        What may be read of the clip is its motion, ``joints``, and its ``parameters``.
        """

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """The prediction as low and high part, each ``(F, V, 3)``.

        A method without two modules is split like the data: its smoothed vertices are the low
        part.  Vertices that the body carries are placed by it, since every method knows them.
        """
        vertices = self.predict(clip)
        if bones.bound is not None:
            vertices = bones.bound.place(vertices, clip.joints)
        low = np.asarray(bones.smoother.smooth(vertices), np.float32)
        return low, vertices - low


class Network(Method):
    """A checkpoint; an ensemble, or a network that reads parameters, is given the clip's."""

    def __init__(self, name: str, checkpoint: Checkpoint) -> None:
        self.name, self.checkpoint = name, checkpoint

    def predict(self, clip: Clip) -> Array:
        return self.checkpoint.predict(clip.joints, clip.parameters)

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """The outputs of the two modules."""
        motions = self.checkpoint.motions(clip.joints, clip.parameters)
        low = np.concatenate([m.to_world(m.low) for m in motions])
        return low, np.concatenate([_detail(m) for m in motions])


class PushedMethod(Method):
    """Another method with its vertices moved out of the body; pinned vertices stay.

    What is moved counts as detail: the low part is the other method's.

    Parameters
    ----------
    method : Method
    outfit : Outfit
        Garment and body, such as a store.

    Raises
    ------
    InputError
        If the body is not closed.
    """

    def __init__(self, method: Method, outfit: Outfit) -> None:
        self.name, self.method = f"{method.name}, pushed out", method
        self.push = PushOut(
            outfit.body, outfit.faces, pinned=outfit.pinned, n_vertices=outfit.n_vertices
        )

    def predict(self, clip: Clip) -> Array:
        return self.push(self.method.predict(clip), clip.joints).vertices

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        low, high = self.method.split(clip, bones)
        return low, self.push(low + high, clip.joints).vertices - low


class BonesThemselves(Method):
    """LBS with the fitted transforms, and the simulated detail: the bound for every network."""

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


def _detail(motion: Motion) -> Array:
    if motion.high is None:
        return np.zeros(motion.low.shape, np.float32)
    turned = motion.high.double().cpu().numpy() @ motion.frame[..., :3].transpose(0, 2, 1)
    return np.asarray(turned, np.float32)
