"""Report of a search for the smallest model and of its prunings."""

from __future__ import annotations

import dataclasses
from typing import Literal

from ..model.size import Size
from ..search.result import Decomposition

Measure = Literal["rmse", "max"]


@dataclasses.dataclass(frozen=True)
class Pruning:
    """Count, bytes and error before and after one kind of pruning.

    Attributes
    ----------
    what : {"bones", "influences", "keyframes"}
    before, after : int
        Number of bones, of influences of all vertices, or of keys of all bones.
    bytes_before, bytes_after : int
        Bytes of the model.
    error_before, error_after : float
        Error of the model in the mesh's units, by the measure of the tolerance.

    Examples
    --------
    >>> pruning = ssdr.parsimony.Pruning("bones", 8, 6, 4000, 3500, 0.25, 0.5)
    >>> pruning.before - pruning.after, pruning.cost
    (2, 0.25)
    """

    what: str
    before: int
    after: int
    bytes_before: int
    bytes_after: int
    error_before: float
    error_after: float

    @property
    def cost(self) -> float:
        """Rise of the error, in the mesh's units; negative if the new solve lowered it."""
        return self.error_after - self.error_before


@dataclasses.dataclass(frozen=True)
class Parsimony:
    """Size and error of the smallest model, and how it was found.

    Attributes
    ----------
    tolerance : float
        Requested tolerance, in the mesh's units.
    measure : {"rmse", "max"}
    error : float
        Error of the result, measured on all frames.
    held : bool
        Whether the tolerance holds.
    bones, influences : int
        Number of bones of the result, and largest number of influences at a vertex.
    least_bones : int
        Lower bound on the number of bones that can hold the tolerance, proven by the rank of the
        motion.
    size : Size
    prunings : tuple of Pruning
        Prunings of bones, influences and keyframes, in this order.  If the search was stopped, the
        last of them are missing.

    Examples
    --------
    >>> points = np.random.default_rng(0).random((8, 3))
    >>> turn = np.diag([-1.0, -1.0, 1.0])
    >>> frames = np.stack([points, points @ turn, points + 1])
    >>> result = ssdr.smallest(frames, tolerance="0.5%", effort="fast", bones=2)
    >>> result.parsimony.held, result.parsimony.bones
    (True, 1)
    """

    tolerance: float
    measure: Measure
    error: float
    held: bool
    bones: int
    influences: int
    least_bones: int
    size: Size
    prunings: tuple[Pruning, ...]


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Smallest(Decomposition):
    """Smallest model found that holds a tolerance; if none does, the model of least error.

    The `rmse` in `history` may rise up to the tolerance, since a smaller model may have a larger
    error.

    Attributes
    ----------
    parsimony : Parsimony
        Size of the model, and how it was found.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small").frames(slice(0, 4))
    >>> result = ssdr.smallest(dancer, tolerance="2%", effort="fast")
    >>> result.parsimony.bones == result.skinning.n_bones
    True
    """

    parsimony: Parsimony
