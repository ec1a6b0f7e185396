"""Garment and body that a network was trained for: virtual bones, skeleton, frame rate."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr import Skinning

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
        Hash of the simulated mesh; see :func:`mesh_identity`.
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
