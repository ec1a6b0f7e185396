"""Garment and body that a network was trained for: virtual bones, skeleton, frame rate."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr import Skinning
from ssdr.common.errors import InputError

from .outfit import Outfit, body_identity
from .skeleton import Skeleton
from .skin_weights import BodyBound


@dataclasses.dataclass(frozen=True, eq=False)
class Subject:
    """Garment and body that a network was trained for.

    Attributes
    ----------
    garment : Skinning
        Rest pose P, weights W and faces of the virtual bones; one frame, at rest.
    body : Skinning
    skeleton : Skeleton
    fps : float
    garment_id : str
        Hash of the simulated mesh; see :func:`garmentnet.data.outfit.mesh_identity`.
    bound : BodyBound or None
        Vertices bound to the body; None if all are predicted.
    """

    garment: Skinning
    body: Skinning
    skeleton: Skeleton
    fps: float
    garment_id: str
    bound: BodyBound | None = None

    @property
    def free(self) -> NDArray[np.int64]:
        """Vertices that a network predicts, ascending; the body carries the others."""
        every = np.arange(self.garment.n_vertices)
        return every if self.bound is None else np.setdiff1d(every, self.bound.index)

    @property
    def carried(self) -> NDArray[np.bool_]:
        """Which vertices ``(V,)`` the body carries: those that a network does not predict."""
        return ~np.isin(np.arange(self.garment.n_vertices), self.free)

    def skin(self, *, smooth: bool) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Rest pose, bones and weights of all vertices, those that the body carries too.

        Behind the virtual bones come the body's joints.  `smooth` says whether what the body
        carries is smoothed at rest, as it is for the low frequencies alone.
        """
        g, b = self.garment, self.bound
        width = max(part.indices.shape[1] for part in (g, b) if part is not None)
        pad = ((0, 0), (0, width - g.indices.shape[1]))
        rest, bones, weights = np.array(g.rest), np.pad(g.indices, pad), np.pad(g.weights, pad)
        if b is not None:
            at, used = b.index[:, None], np.arange(b.indices.shape[1])
            rest[b.index] = b.smooth if smooth else b.rest
            bones[b.index] = weights[b.index] = 0
            bones[at, used], weights[at, used] = g.n_bones + b.indices, b.weights
        return rest, bones, weights

    @property
    def body_id(self) -> str:
        """Hash of the body; see :func:`garmentnet.data.outfit.body_identity`."""
        return body_identity(self.body, self.skeleton)

    def check_fits(self, outfit: Outfit) -> None:
        """Raise InputError unless an outfit has this garment, body and frame rate."""
        for name in ("garment_id", "body_id", "fps"):
            expected, got = getattr(outfit, name), getattr(self, name)
            if expected != got:
                wanted = f"one of the {name.removesuffix('_id')} of the store ({expected})"
                raise InputError("checkpoint", wanted, f"another ({got})")
