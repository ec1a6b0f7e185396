"""What a network must know of a store: virtual bones, body, skeleton, frame rate, identity."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np

from ssdr import Skinning

from .skeleton import Skeleton

__all__ = ["Subject", "mesh_identity"]


@dataclasses.dataclass(frozen=True, eq=False)
class Subject:
    """Who wears what: all that a network needs to know of the store.

    Attributes
    ----------
    garment : Skinning
        Rest pose P, weights W and faces of the virtual bones; its transforms are
        of no use.
    body : Skinning
    skeleton : Skeleton
    fps : float
    garment_id : str
        Of the simulated mesh; see :func:`mesh_identity`.
    """

    garment: Skinning
    body: Skinning
    skeleton: Skeleton
    fps: float
    garment_id: str

    @property
    def body_id(self) -> str:
        """Identity of the body: its mesh, its weights and its joints' tree."""
        b, s = self.body, self.skeleton
        names = ",".join(s.names).encode()
        return _digest(b.rest, b.joints, b.weights, b.faces, s.parents, s.rest, names)


def mesh_identity(rest: Any, faces: Any) -> str:
    """A mesh's name: the same for the same rest pose (as float32) and triangles."""
    return _digest(np.asarray(rest, np.float32), np.asarray(faces, np.int32))


def _digest(*parts: Any) -> str:
    h = hashlib.sha256()
    for part in parts:
        h.update(part if isinstance(part, bytes) else np.ascontiguousarray(part).tobytes())
        h.update(b"|")
    return h.hexdigest()[:16]
