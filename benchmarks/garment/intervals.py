"""Confidence intervals of errors and of their ratios, by bootstrap over clips.

Frames of one clip are alike, so clips are drawn, not frames.  Two methods are scored on the same
clips, and a hard clip is hard for both: their ratio is known better than either error.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm
from scipy.stats import t as student

from garmentnet.evaluation.scores import PARTS, Scores

_LEVEL = 0.95
# An error below this many mm counts as 0, and no ratio to it is given.
_NOTHING = 1e-6


def paired_ratio(
    a: ArrayLike,
    b: ArrayLike,
    *,
    frames: ArrayLike | None = None,
    resamples: int = 10_000,
    rng: int | np.random.Generator = 0,
) -> tuple[float, float | None, float | None]:
    """The pooled error of method `a` divided by that of `b`; below 1 the first is better.

    Returned are the ratio and both ends of its 95 % confidence interval, None for a single clip.
    The pooled error of clips is √(Σ frames · error² / Σ frames); with `b` = 1, the result is
    the pooled error of `a` itself.  Clips are drawn with replacement, the same ones for
    both methods.  The interval lies between two percentiles of the resampled ratios, which are
    taken farther out for few clips (the expanded percentile interval).  On
    synthetic clips whose ratios scatter by 5 to 15%, the 95% interval of 6 to 24 clips holds the
    true ratio in 91 to 94% of the cases; plain percentiles do in 82 to 92%, and BCa intervals (at
    15%) in 80 to 87%.

    Parameters
    ----------
    a, b : (n,) array
        Errors of the two methods, clip by clip in one order; those of `b` are positive.
    frames : (n,) array, optional
        Numbers of frames, the weights of the clips; equal by default.
    resamples : int
    rng : int or numpy Generator
        Equal seeds give equal intervals.

    References
    ----------
    Hesterberg, "What teachers should know about the bootstrap", 2015.

    Examples
    --------
    >>> errors = np.array([20.0, 30.0, 25.0])
    >>> [round(x, 6) for x in paired_ratio(0.8 * errors, errors)]
    [0.8, 0.8, 0.8]
    """
    n = np.size(a)
    weights = np.ones(n) if frames is None else np.asarray(frames, float)
    above, below = (weights * np.asarray(x, float) ** 2 for x in (a, b))
    value = math.sqrt(above.sum() / below.sum())
    if n < 2:
        return value, None, None
    drawn = np.random.default_rng(rng).multinomial(n, np.full(n, 1 / n), size=resamples)
    found = np.sqrt(drawn @ above / (drawn @ below))
    # Plain percentiles are too narrow for few clips, like a normal quantile in place of Student's t
    # and n in place of n - 1.
    wide = math.sqrt(n / (n - 1)) * student.ppf((1 + _LEVEL) / 2, n - 1)
    tail = norm.cdf(-wide)
    low, high = np.quantile(found, [tail, 1 - tail])
    return value, float(low), float(high)


def intervals(rows: Sequence[Scores], reference: str) -> dict[str, Any]:
    """Ratios of RMSE over all vertices to those of a reference, with intervals.

    Parameters
    ----------
    rows : sequence of Scores
        Scores of the methods on the same clips.
    reference : str
        Name of one of the methods.

    Returns
    -------
    dict
        Value, lower and upper end of the ratio by name of the method and part.  None stands for the
        interval of a single clip, and for ratios to a method without error.
    """

    def errors(row: Scores, part: str) -> list[float]:
        return [getattr(c.all, part).rmse for c in row.clips]

    (against,) = (r for r in rows if r.name == reference)
    frames, found = [c.frames for c in against.clips], {}
    for row, part in itertools.product(rows, PARTS):
        own, other = (errors(r, part) for r in (row, against))
        known = min(other) > _NOTHING
        ratio = list(paired_ratio(own, other, frames=frames)) if known else [None] * 3
        found.setdefault(row.name, {})[part] = ratio
    return found


def interval_cell(found: Sequence[float | None]) -> str:
    """A value and its interval, as ``0.970 [0.951, 0.989]``; "-" for what is None."""
    value, low, high = ("-" if x is None else f"{x:.3f}" for x in found)
    return value if low == "-" else f"{value} [{low}, {high}]"
