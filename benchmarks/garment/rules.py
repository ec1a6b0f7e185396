"""Pivots mixed by a formula of the simulation parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from garmentnet.paper.ensemble import Kernel

Array = NDArray[np.float64]
# Weights (K,) of pivots (K, P) at parameters (P,), all normalised.
Rule = Callable[[Any, Any], Array]
# Distance of normalised parameters that counts as 0; their range is 2 long.
_SAME = 1e-12


class Ruled(Kernel):
    """A kernel whose weights come from a formula of the parameters."""

    def __init__(self, rule: Rule) -> None:
        super().__init__()
        self.rule = rule

    def weights(self, pivots: Any, theta: Any) -> Array:
        return self.rule(pivots, theta)


def inverse_distance(pivots: Any, theta: Any) -> Array:
    """Weights ∝ 1 / ‖θ_i − θ‖, the paper's first alternative; 1 for a pivot at θ itself.

    Examples
    --------
    >>> inverse_distance([[0.0], [3.0]], [1.0]).round(3).tolist()
    [0.667, 0.333]
    """
    gap = np.linalg.norm(np.asarray(pivots, float) - np.asarray(theta, float), axis=1)
    same = gap < _SAME
    near = np.asarray(same, np.float64) if same.any() else 1 / gap
    return np.asarray(near / near.sum())


def nearest(pivots: Any, theta: Any) -> Array:
    """Weight 1 for the pivot whose normalised parameters are closest.

    Examples
    --------
    >>> nearest([[0.0], [3.0]], [1.0]).tolist()
    [1.0, 0.0]
    """
    gap = np.linalg.norm(np.asarray(pivots, float) - np.asarray(theta, float), axis=1)
    return np.asarray(np.arange(len(gap)) == gap.argmin(), float)
