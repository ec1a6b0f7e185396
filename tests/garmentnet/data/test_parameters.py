"""Simulation parameters and their normalised form."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("zarr")

from garmentnet.data.parameters import RANGES, SimulationParameters
from ssdr.common.errors import InputError


def test_parameters_normalise_to_their_ranges() -> None:
    low, high = (
        SimulationParameters(**{name: r[side] for name, r in RANGES.items()}) for side in (0, 1)
    )
    np.testing.assert_allclose(low.normalised(), -1)
    np.testing.assert_allclose(high.normalised(), 1)
    middle = SimulationParameters(**{n: float(np.sqrt(a * b)) for n, (a, b) in RANGES.items()})
    np.testing.assert_allclose(middle.normalised(), 0, atol=1e-12)
    for bad in (0, -1, np.nan, np.inf, "1", True):
        with pytest.raises(InputError, match="density"):
            SimulationParameters(density=bad)  # type: ignore[arg-type]
