"""Whom a network was trained for: virtual bones, body, skeleton, frame rate."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np

from ssdr import Skinning

from .skeleton import Skeleton
from .skin_weights import BodyBound

__all__ = ["Subject", "mesh_identity"]


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
        Hash of the simulated mesh; see :func:`mesh_identity`.
    bound : BodyBound or None
        Vertices that the body carries; None: all are predicted.
    """

    garment: Skinning
    body: Skinning
    skeleton: Skeleton
    fps: float
    garment_id: str
    bound: BodyBound | None = None

    @property
    def body_id(self) -> str:
        """Hash of the body's mesh, weights and skeleton."""
        b, s = self.body, self.skeleton
        names = ",".join(s.names).encode()
        return _digest(b.rest, b.indices, b.weights, b.faces, s.parents, s.rest, names)


def mesh_identity(rest: Any, faces: Any) -> str:
    """Hash of a mesh: equal for equal rest poses (as float32) and triangles.

    Examples
    --------
    >>> mesh_identity([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    '98c4edc67b8ce133'
    """
    return _digest(np.asarray(rest, np.float32), np.asarray(faces, np.int32))


def _digest(*parts: Any) -> str:
    h = hashlib.sha256()
    for part in parts:
        h.update(part if isinstance(part, bytes) else np.ascontiguousarray(part).tobytes())
        h.update(b"|")
    return h.hexdigest()[:16]
