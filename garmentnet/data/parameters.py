"""Simulation parameters: bending, density, time scale, and their normalised form."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError, SsdrWarning, is_real

# Ranges that the data sets cover, which normalisation maps to [-1, 1]; units as in
# SimulationParameters.
RANGES: Mapping[str, tuple[float, float]] = {
    "bending": (0.2, 2.0),
    "density": (0.1, 0.3),
    "time_scale": (0.7, 1.3),
}
# Relative tolerance of parameters, since those read from a file may be rounded.
_ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True)
class SimulationParameters:
    """The cloth's material and the speed of its time.

    Parameters
    ----------
    bending : float
        Bending stiffness, in units of 1e-3 N·m; about 0.2 (soft) to 2 (stiff).
    density : float
        kg/m²; about 0.1 (light) to 0.3 (heavy).
    time_scale : float
        Seconds of the cloth in a second of the body; 0.7 (slow) to 1.3 (fast).

    Raises
    ------
    InputError
        If a parameter is not a positive, finite number.

    Examples
    --------
    >>> print(SimulationParameters(bending=1.0))
    bending 1, density 0.2, time scale 1
    """

    bending: float = 0.5
    density: float = 0.2
    time_scale: float = 1.0

    def __post_init__(self) -> None:
        for name in RANGES:
            value = getattr(self, name)
            if not (is_real(value) and value > 0):
                raise InputError(name, "a positive number", repr(value))
            object.__setattr__(self, name, float(value))

    def __str__(self) -> str:
        return f"bending {self.bending:g}, density {self.density:g}, time scale {self.time_scale:g}"

    def normalised(self) -> NDArray[np.float64]:
        """Logarithms ``(3,)`` of bending, density and time scale, scaled to [-1, 1] on `RANGES`.

        Logarithms are used because the ratio of two values matters: doubling a parameter is a step
        of the same length from any value.

        Examples
        --------
        >>> SimulationParameters(bending=2.0, density=0.1, time_scale=1.3).normalised()
        array([ 1., -1.,  1.])
        """
        low, high = np.log(np.array(list(RANGES.values()))).T
        value = np.log([self.bending, self.density, self.time_scale])
        return np.asarray(2 * (value - low) / (high - low) - 1)


def warn_beyond(
    parameters: SimulationParameters, trained_on: Sequence[SimulationParameters | None]
) -> None:
    """Warn if a prediction extrapolates, with the values and the ranges.

    Parameters
    ----------
    parameters : SimulationParameters
    trained_on : sequence of SimulationParameters or None
        Of each network; None for one that reads the parameters, which is meant for `RANGES`.

    Warns
    -----
    SsdrWarning
        If a parameter lies outside the range of those that the networks were trained on.
    """
    known = [dataclasses.asdict(p) for p in trained_on if p is not None]
    messages = []
    for key, value in dataclasses.asdict(parameters).items():
        seen = [p[key] for p in known] or RANGES[key]
        low, high = min(seen), max(seen)
        if not low * (1 - _ROUNDING) <= value <= high * (1 + _ROUNDING):
            range_ = "trained from" if known else "meant for"
            messages.append(f"{key} {value:g}, {range_} {low:g} to {high:g}")
    if messages:
        warnings.warn(f"extrapolated: {'; '.join(messages)}", SsdrWarning, stacklevel=3)
