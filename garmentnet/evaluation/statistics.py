"""What a set of test clips supports: intervals by bootstrap over clips, and learning curves.

Frames of one clip are alike, so clips are what is drawn, not frames.  Two methods are scored on the
same clips, and a hard clip is hard for both: their ratio is known better than either error.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.stats import norm
from scipy.stats import t as student

from ssdr.errors import InputError, is_whole

__all__ = [
    "FEW_CLIPS",
    "PairedRatio",
    "PooledError",
    "PowerLaw",
    "fit_power_law",
    "paired_ratio",
    "pooled_error",
]

# Below so many clips, an interval of the bootstrap is rough, mostly too narrow.
FEW_CLIPS = 8

Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class PooledError:
    """The error of a method over clips.

    Attributes
    ----------
    value : float
        In the unit of the figures.
    low, high : float
        Interval; NaN for a single clip, which says nothing about others.
    n_clips : int
    level : float
        Of the interval.
    """

    value: float
    low: float
    high: float
    n_clips: int
    level: float


@dataclasses.dataclass(frozen=True)
class PairedRatio:
    """The error of one method divided by that of another on the same clips.

    Attributes
    ----------
    ratio : float
        Below 1: the first method is better.
    low, high : float
        Interval; NaN for a single clip.
    n_clips : int
    level : float
        Of the interval.
    """

    ratio: float
    low: float
    high: float
    n_clips: int
    level: float


@dataclasses.dataclass(frozen=True)
class PowerLaw:
    """A learning curve: error = √(floor² + (coefficient · frames^−exponent)²).

    Attributes
    ----------
    exponent : float
    coefficient : float
        In the unit of the errors; at one frame, without the floor.
    floor : float or None
        Error that no number of frames removes; None: left out.
    low, high : float
        Interval of the exponent; NaN where no degree of freedom is left.
    level : float
        Of the interval.
    """

    exponent: float
    coefficient: float
    floor: float | None
    low: float
    high: float
    level: float

    def error(self, frames: ArrayLike) -> Floats:
        """Errors that the curve has at numbers of frames."""
        x = np.asarray(frames, float)
        return np.hypot(self.floor or 0.0, self.coefficient * x**-self.exponent)


def pooled_error(
    figures: ArrayLike,
    *,
    frames: ArrayLike | None = None,
    power: float = 2.0,
    resamples: int = 10_000,
    level: float = 0.95,
    rng: int | np.random.Generator = 0,
) -> PooledError:
    """The error over all clips, with an interval by bootstrap over clips.

    Parameters
    ----------
    figures : (n,) array
        One for each clip.
    frames : (n,) array, optional
        Numbers of frames, the weights of the clips; equal by default.
    power : float
        (Σ frames · figure^power / Σ frames)^(1/power): 2 for RMSE, 1 for figures that are means
        over frames.
    resamples : int
    level : float
        Between 0 and 1.
    rng : int or numpy Generator
        Equal seeds give equal intervals.

    Raises
    ------
    InputError
        If shapes or numbers are not usable.
    """
    values, weights = _figures(figures, "figures"), _weights(figures, frames)
    _check(resamples, level)
    sums = np.stack([weights * values**power, weights])

    def statistic(s: Floats) -> Floats:
        return (s[..., 0] / s[..., 1]) ** (1 / power)

    value, low, high = _bootstrap(sums, statistic, resamples, level, rng)
    return PooledError(value, low, high, len(values), level)


def paired_ratio(
    a: ArrayLike,
    b: ArrayLike,
    *,
    frames: ArrayLike | None = None,
    power: float = 2.0,
    resamples: int = 10_000,
    level: float = 0.95,
    rng: int | np.random.Generator = 0,
) -> PairedRatio:
    """The pooled error of method `a` divided by that of `b`, with an interval.

    Clips are drawn with replacement, each with its number of frames, and the same clips for both
    methods.  The interval runs between two percentiles of the resampled ratios, which are taken
    farther out for few clips (the expanded percentile interval).  On synthetic clips whose ratios
    scatter by 5 to 15%, the 95% interval of 6 to 24 clips holds the true ratio in 91 to 94% of the
    cases; plain percentiles do in 82 to 92%, and BCa intervals (at 15%) in 80 to 87%.

    Parameters
    ----------
    a, b : (n,) array
        Figures of the two methods, clip by clip in one order; those of `b` are positive.
    frames : (n,) array, optional
        Numbers of frames, the weights of the clips; equal by default.
    power : float
        Of pooling, as in :func:`pooled_error`: 2 for RMSE, 1 for figures that are means over
        frames.
    resamples : int
    level : float
        Between 0 and 1.
    rng : int or numpy Generator
        Equal seeds give equal intervals.

    Raises
    ------
    InputError
        If shapes or numbers are not usable.

    References
    ----------
    Hesterberg, "What teachers should know about the bootstrap", 2015.

    Examples
    --------
    >>> errors = np.array([20.0, 30.0, 25.0])
    >>> exact = paired_ratio(0.8 * errors, errors)
    >>> round(exact.ratio, 6), round(exact.low, 6), round(exact.high, 6), exact.n_clips
    (0.8, 0.8, 0.8, 3)
    """
    first, second = _figures(a, "a"), _figures(b, "b")
    if len(first) != len(second):
        raise InputError("b", f"{len(first)} figures, as in a", f"{len(second)}")
    if not (second > 0).all():
        raise InputError("b", "positive figures", second)
    weights = _weights(a, frames)
    _check(resamples, level)
    sums = np.stack([weights * first**power, weights * second**power])

    def statistic(s: Floats) -> Floats:
        return (s[..., 0] / s[..., 1]) ** (1 / power)

    ratio, low, high = _bootstrap(sums, statistic, resamples, level, rng)
    return PairedRatio(ratio, low, high, len(first), level)


def fit_power_law(
    frames: ArrayLike,
    errors: ArrayLike,
    *,
    floor: float | Literal["fit"] | None = None,
    level: float = 0.95,
) -> PowerLaw:
    """The learning curve through errors at several numbers of training frames.

    Least squares on the logarithms.  With a floor, the chaos floor for instance, the law holds for
    what lies above it: √(error² − floor²), since independent errors add up in squares.

    Parameters
    ----------
    frames, errors : (n,) array
        Several errors at one number of frames, of several seeds, are several entries.
    floor : float or "fit", optional
        In the unit of the errors, below all of them; "fit": fitted too, which needs errors at four
        numbers of frames.
    level : float
        Of the interval of the exponent, by Student's t.

    Raises
    ------
    InputError
        If numbers are not usable or too few.

    Examples
    --------
    >>> law = fit_power_law([1000, 4000, 16000], [60, 30, 15])
    >>> round(law.exponent, 3), law.floor
    (0.5, None)
    """
    x, y = np.asarray(frames, float), np.asarray(errors, float)
    for name, values in (("frames", x), ("errors", y)):
        if values.ndim != 1 or not (np.isfinite(values).all() and (values > 0).all()):
            raise InputError(name, "a list of positive numbers", values)
    if len(x) != len(y):
        raise InputError("errors", f"{len(x)} numbers, as many as frames", f"{len(y)}")
    needed = 4 if floor == "fit" else 2
    if len(np.unique(x)) < needed:
        raise InputError("frames", f"at least {needed} different numbers", np.unique(x))
    _check(1, level)
    if floor == "fit":
        return _with_fitted_floor(np.log(x), y, level)
    if floor is not None and not 0 <= floor < y.min():
        raise InputError("floor", f"a number from 0, below every error ({y.min():g})", floor)
    above = np.log(np.sqrt(y**2 - (floor or 0.0) ** 2))
    design = np.stack([np.ones(len(x)), -np.log(x)], axis=1)
    solution = np.linalg.lstsq(design, above, rcond=None)[0]
    half = _half_width(design, above - design @ solution, level)
    exponent = float(solution[1])
    return PowerLaw(exponent, math.exp(solution[0]), floor, exponent - half, exponent + half, level)


def _with_fitted_floor(log_frames: Floats, errors: Floats, level: float) -> PowerLaw:
    start = fit_power_law(np.exp(log_frames), errors)
    smallest = float(errors.min())

    def residuals(p: Floats) -> Floats:
        fall = np.exp(p[0] - p[1] * log_frames)
        return np.log(np.hypot(smallest * p[2], fall)) - np.log(errors)

    found = least_squares(
        residuals,
        [math.log(start.coefficient), start.exponent, 0.5],
        bounds=([-np.inf, -np.inf, 0.0], [np.inf, np.inf, 1.5]),
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
    )
    half = _half_width(np.asarray(found.jac), found.fun, level)
    exponent = float(found.x[1])
    return PowerLaw(
        exponent,
        math.exp(found.x[0]),
        smallest * float(found.x[2]),
        exponent - half,
        exponent + half,
        level,
    )


def _half_width(design: Floats, residual: Floats, level: float) -> float:
    """Of the interval of the second coefficient."""
    free = len(design) - design.shape[1]
    if free < 1:
        return math.nan
    variance = float(residual @ residual) / free * np.linalg.pinv(design.T @ design)[1, 1]
    return float(student.ppf((1 + level) / 2, free)) * math.sqrt(variance)


def _bootstrap(
    sums: Floats,
    statistic: Callable[[Floats], Floats],
    resamples: int,
    level: float,
    rng: int | np.random.Generator,
) -> tuple[float, float, float]:
    """Value and interval of a statistic of the totals of ``(k, n)`` figures of clips."""
    n = sums.shape[1]
    value = float(statistic(sums.sum(axis=1)))
    if n < 2:
        return value, math.nan, math.nan
    drawn = np.random.default_rng(rng).multinomial(n, np.full(n, 1 / n), size=resamples)
    found = statistic(drawn @ sums.T)
    # Plain percentiles are too narrow for few clips, as if a normal quantile stood for Student's t
    # and n for n - 1.
    wide = math.sqrt(n / (n - 1)) * student.ppf((1 + level) / 2, n - 1)
    tail = norm.cdf(-wide)
    low, high = np.quantile(found, [tail, 1 - tail])
    return value, float(low), float(high)


def _figures(values: ArrayLike, name: str) -> Floats:
    x = np.asarray(values, float)
    if x.ndim != 1 or len(x) < 1 or not (np.isfinite(x).all() and (x >= 0).all()):
        raise InputError(name, "a list of finite figures, none negative", x)
    return x


def _weights(values: ArrayLike, frames: ArrayLike | None) -> Floats:
    n = len(np.asarray(values))
    x = np.ones(n) if frames is None else np.asarray(frames, float)
    if x.shape != (n,) or not (np.isfinite(x).all() and (x > 0).all()):
        raise InputError("frames", f"{n} positive numbers", x)
    return x


def _check(resamples: int, level: float) -> None:
    if not is_whole(resamples) or resamples < 1:
        raise InputError("resamples", "an integer >= 1", repr(resamples))
    if not 0 < level < 1:
        raise InputError("level", "a number between 0 and 1", repr(level))
