"""A garment on a body at rest, which all clips of a store share."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ssdr.skinning import Skinning

from .skeleton import Skeleton


@dataclasses.dataclass(frozen=True, eq=False)
class Outfit:
    """A garment on a body, at rest.

    Attributes
    ----------
    rest : (V, 3) float32
        The garment as it was cut, on the body at rest; metres.
    faces : (T, 3) int32
    body : ssdr.Skinning
        The body as a skinned collider: rest pose, weights and names of the joints; one frame, at
        rest.
    skeleton : Skeleton
    fps : float
        Frames a second of every clip.
    pinned : (V,) bool
        Vertices that follow the body.
    mirror_vertices : (V,) int32 or None
        Mirror image of each vertex of the garment; None if it is not symmetric.
    """

    rest: NDArray[np.float32]
    faces: NDArray[np.int32]
    body: Skinning
    skeleton: Skeleton
    fps: float
    pinned: NDArray[np.bool_]
    mirror_vertices: NDArray[np.int32] | None = None

    @property
    def n_vertices(self) -> int:
        return len(self.rest)

    def is_like(self, other: Outfit) -> bool:
        """Whether garment, body, skeleton and frame rate are the same."""
        return (
            self.fps == other.fps
            and np.array_equal(self.rest, other.rest)
            and np.array_equal(self.faces, other.faces)
            and np.array_equal(self.pinned, other.pinned)
            and np.array_equal(self.body.rest, other.body.rest)
            and np.array_equal(self.body.weights, other.body.weights)
            and self.skeleton.names == other.skeleton.names
            and np.array_equal(self.skeleton.rest, other.skeleton.rest)
        )
