"""The result of a decomposition."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.short_repr import notebook_html
from ..model.drawn_normals import NormalErrors
from ..model.frame_error import share_of
from ..model.skinning import Skinning
from .progress import Record


@dataclasses.dataclass(frozen=True, eq=False)
class Decomposition:
    """A skinned model, its error, and how it was found.

    Attributes
    ----------
    skinning : Skinning
        Rest pose, indices, weights and transforms (frames of all shots in order).
    rmse : float
        sqrt(Σ|d|² / (F V)) over all frames, in the mesh's units, measured by
        skinning the result and comparing it with the input.
    stop_reason : str
        "converged" if the last stage ended by its stopping test, "effort spent" if it made all
        its steps, "time limit" or "cancelled".  A result of :func:`smallest` has "tolerance held"
        or "tolerance out of reach" in place of the first two.
    history : tuple of Record
        One record for each accepted model, of which the last is the result.  The objective never
        rises; the RMSE may rise where its other terms (rest pose, normals, `smoothness`) gain more.
        For :func:`smallest`, one record for each smaller model that held the tolerance, then the
        result.
    offsets : (S + 1,) int array
        First frame of each of the S shots, followed by the total number of frames.
    compile_seconds : float
        Time that loading or compiling the kernels took in this call.
    warnings : tuple of str
        Messages of the warnings (:class:`SsdrWarning`) of the call.
    motion : float
        Root mean square distance of the input's vertices from their mean pose once the rigid motion
        of the whole mesh is removed, in the mesh's units, over about 500 frames at most; NaN if it
        is not known.
    copies : int
        Number of vertices that coincide with another in every frame, as at seams or in a triangle
        soup.  They are solved as one vertex, so that the mesh does not crack.
    normals : NormalErrors or None
        Angles, over about 500 frames at most, between the normals of the input's surface and those
        that engines draw of `skinning`; None without triangles.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.decompose(dancer, bones=4, effort="fast")
    >>> result.skinning.n_bones, result.reconstruct().shape
    (4, (24, 799, 3))
    >>> np.allclose(result.rmse, result.history[-1].rmse)
    True
    """

    skinning: Skinning
    rmse: float
    stop_reason: str
    history: tuple[Record, ...]
    offsets: NDArray[np.int64]
    compile_seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    normals: NormalErrors | None = None
    motion: float = math.nan
    copies: int = 0

    @property
    def converged(self) -> bool:
        """Whether the last stage ended by its stopping test, or the tolerance is held."""
        return self.stop_reason in ("converged", "tolerance held")

    @property
    def motion_lost(self) -> float:
        """Share of the motion that the model lacks, rmse / motion (NaN if nothing deforms).

        An error that is small relative to the mesh can be as large as a small motion.
        """
        return share_of(self.rmse, self.motion)

    def reconstruct(self, frames: Any = None) -> NDArray[np.floating]:
        """Vertex positions of the model in the given frames, by default in all: as its ``skin``."""
        return self.skinning.skin(frames)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.skinning!r}, rmse={self.rmse:.6g}, {self.stop_reason})"

    _repr_html_ = notebook_html
