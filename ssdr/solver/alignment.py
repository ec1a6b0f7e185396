"""The map between the input's space and the solver's.

In the solver's space each frame is centred and rotated onto the first; one scale serves all frames.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.checks import LARGEST, check_squarable
from ..common.parallel import chunk_bounds
from ..model.rigid import nearest_rotation

Array = NDArray[np.float64]

_AT_ONCE = 512  # frames whose transforms are mapped at a time
_APART = f"distances of less than {LARGEST:g} times the mesh's size"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Alignment:
    """The map between the input's space and the solver's space.

    Attributes
    ----------
    centre : (F, 3), rotation : (F, 3, 3), scale : float
        A point x' of a frame in the solver's space is ``rotation @ (scale * x') + centre`` in the
        input's space.
    """

    centre: Array
    rotation: Array
    scale: float

    def select_frames(self, frames: Any) -> Alignment:
        """The alignment of some frames, given by indices or a slice."""
        return dataclasses.replace(self, centre=self.centre[frames], rotation=self.rotation[frames])

    def points_to_world(self, points: Array) -> Array:
        """Map points (n, 3) of the rest pose to the input's space."""
        return np.asarray(points * self.scale + self.centre[0])

    def to_world(self, rest: Array, transforms: Array) -> tuple[Array, Array]:
        """Map a rest pose (V, 3) and transforms (F, B, 3, 4) to the input's space."""
        origin, out = self.centre[0], np.empty(transforms.shape)
        # by parts, since the transforms of all frames may be most of what memory holds
        for i, k in chunk_bounds(len(out), _AT_ONCE):
            m, turn = transforms[i:k], self.rotation[i:k]
            r = np.einsum("tab,tjbc->tjac", turn, m[..., :3])
            shift = self.scale * np.einsum("tab,tjb->tja", turn, m[..., 3])
            out[i:k, ..., :3] = r
            out[i:k, ..., 3] = shift + self.centre[i:k, None] - r @ origin
        return self.points_to_world(rest), out

    def points_from_world(self, points: Array, argument: str) -> Array:
        """Map points of the rest pose to the solver's space.

        Raises
        ------
        InputError
            If coordinates are too large to be squared; the message names the points `argument`.
        """
        inner = (np.asarray(points, dtype=np.float64) - self.centre[0]) / self.scale
        check_squarable(inner, argument, _APART)
        return np.ascontiguousarray(inner)

    def moves_from_world(self, transforms: Array, argument: str) -> Array:
        """Map transforms (F, B, 3, 4) to the solver's space.

        Raises InputError as :meth:`points_from_world` does.
        """
        m = np.asarray(transforms, dtype=np.float64)
        r = np.einsum("tba,tjbc->tjac", self.rotation, m[..., :3])
        moved = m[..., 3] + m[..., :3] @ self.centre[0] - self.centre[:, None]
        t = np.einsum("tba,tjb->tja", self.rotation, moved) / self.scale
        check_squarable(t, argument, _APART)
        return np.ascontiguousarray(np.concatenate([r, t[..., None]], axis=-1))

    def inward(self, block: NDArray[np.floating], first: int, frame_scale: Array | None) -> Array:
        """Map frames `first`, `first` + 1, ... (c, V, 3) to the solver's space, as (V, c, 3).

        Each is multiplied by its entry of `frame_scale` (F,), unless that is None.
        """
        some = slice(first, first + len(block))
        turn = self.rotation[some] / self.scale
        if frame_scale is not None:
            turn = turn * frame_scale[some, None, None]
        return np.ascontiguousarray(((block - self.centre[some, None]) @ turn).swapaxes(0, 1))


def centred(frames: NDArray[np.floating], share: Array | None) -> tuple[Array, Array]:
    """Positions (..., V, 3) relative to their centroid, and the centroid (..., 3), per frame.

    `share` (V,) holds the weights of the vertices in the centroid, with sum 1; None stands for
    equal weights.
    """
    # in C order, since the order in memory decides the last bits of sums
    here = frames.astype(np.float64, order="C")
    # far from the origin, sums of positions lose digits that the positions still have
    anchor = here[..., :1, :].copy()
    here -= anchor
    mean = here.mean(axis=-2, keepdims=True) if share is None else (share @ here)[..., None, :]
    here -= mean
    check_squarable(here, "vertices", f"positions less than {LARGEST:g} apart")
    return here, (anchor + mean)[..., 0, :]


def rotations_onto(here: Array, first: Array, share: Array | None) -> Array:
    """Rotations R (..., 3, 3) with which ``here @ R`` is nearest to `first`, for centred frames."""
    known = first if share is None else first * share[:, None]
    return nearest_rotation(np.swapaxes(here, -1, -2) @ known)
