"""Options of scenes that are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.garment.scenes.body import default_body
from benchmarks.garment.scenes.cloth import Solver
from benchmarks.garment.scenes.cut import Cut
from benchmarks.garment.scenes.dance.choreography import dance
from ssdr.common.errors import InputError


def dancing(**change: Any) -> object:
    return dance(default_body().skeleton, **{"seed": 1, **change})


REFUSED = [
    *((dancing, c) for c in ({"frames": 0}, {"fps": 0.0}, {"classes": ["fly"]}, {"classes": []})),
    *((Solver, {"substeps": n}) for n in (0, 21)),
    (Solver, {"friction": -1.0}),
    (Solver, {"drag": np.nan}),
    (Cut, {"vertices": 10}),
    (Cut, {"hem": 0.7}),
    *((Cut, {"top": x}) for x in (0.85, 0.9)),
    (Cut, {"flare": -1.0}),
    (Cut, {"pleats": 100}),
    (Cut, {"pleat_depth": 0.9}),
    (Cut, {"clearance": 0.0}),
    (Cut, {"armpit": 0.9}),
    (Cut, {"armpit": 0.735, "sleeves": 0.2}),
    (Cut, {"sleeves": 0.5}),
    (Cut, {"pinned": 0.9}),
]


@pytest.mark.parametrize(("make", "change"), REFUSED)
def test_refusals(make: Any, change: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        make(**change)
