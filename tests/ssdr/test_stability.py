"""Stability suite: the expected error, or a model as good as without the disturbance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from helpers.stability import Case, Problem, run
from helpers.stability_cases import CASES, plain

SLOW = {"exact skinning", "planar rest pose", "collinear rest pose", "nearly still", "V bones",
        "V - 1 bones", "100,000 vertices", "4,000 frames"}  # fmt: skip


def marked(case: Case) -> Any:
    return pytest.param(case, id=case.name, marks=[pytest.mark.slow] * (case.name in SLOW))


@pytest.mark.parametrize("case", [*map(marked, CASES)])
def test_a_case_is_solved_or_refused_as_its_table_says(case: Case) -> None:
    outcome = run(case)
    assert outcome.passed, outcome
    assert (case.refused is None) == (outcome.outcome == "solved"), outcome


def test_the_suite_itself_can_fail() -> None:
    frames = np.random.default_rng(0).standard_normal((5, 30, 3))
    noise = Case("noise", lambda: Problem(frames, 1.0, None, {"bones": 2}))
    assert not run(noise).passed
    wrong = Case("wrong", plain, check=lambda problem: "all of it")
    assert not run(wrong).passed
    assert not run(Case("not refused", plain, refused="vertices")).passed
    refused = Case("refused for another reason", lambda: plain(bones=0), refused="vertices")
    assert not run(refused).passed
