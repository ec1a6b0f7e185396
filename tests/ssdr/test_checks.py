"""Arguments: what a tolerance may be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ssdr
from helpers.measures import wavy
from ssdr.checks import parse_tolerance


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.5%", 0.02),
        (" 1 % ", 0.04),
        ("2e-1%", 0.008),
        (0.3, 0.3),
        (np.float32(0.25), 0.25),
        (2, 2),
    ],
)
def test_tolerances(text: Any, expected: float) -> None:
    assert parse_tolerance(text, 4.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    "bad",
    [
        "half", "0.5", "%", "0%", "-1%", "1.2.3%", "nan%", "inf%", "", 0, -0.1, True, np.nan,
        np.inf, [1],
    ],
)  # fmt: skip
def test_bad_tolerances_are_refused(bad: Any) -> None:
    calls: list[object] = []
    with pytest.raises(ssdr.InputError, match="a share of the diagonal such as") as caught:
        ssdr.smallest(wavy(), tolerance=bad, callback=calls.append)
    assert caught.value.argument == "tolerance"
    assert not calls
