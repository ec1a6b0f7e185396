"""The stability suite: the right error, or as good a model as without the disturbance."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.stability import Case, Problem, invalid, run
from helpers.stability_cases import CASES, GROUPS, plain


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_case(case: Case) -> None:
    outcome = run(case)
    assert outcome.passed, outcome
    assert (case.refused is None) == (outcome.outcome == "solved"), outcome


def test_no_case_of_the_design_is_missing() -> None:
    assert [group.number for group in GROUPS] == list(range(1, 22))
    assert all(group.cases and group.catches for group in GROUPS)
    assert len({case.name for case in CASES}) == len(CASES)


def test_error_names_argument_expectation_and_finding() -> None:
    frames = np.zeros((4, 6, 3))
    frames[2, 5, 0] = np.nan
    with pytest.raises(ssdr.InputError) as caught:
        ssdr.decompose(frames, bones=2)
    assert "vertices: expected finite numbers, got nan at frame 2, vertex 5" in str(caught.value)
    with pytest.raises(ssdr.InputError, match=r"from 0 to 5, got 6 in face 1"):
        ssdr.decompose(np.zeros((4, 6, 3)), [[0, 1, 2], [0, 1, 6]], bones=2)
    with pytest.raises(ssdr.InputError, match=r"1 to 6 .*got 7"):
        ssdr.decompose(np.zeros((4, 6, 3)), bones=7)


def test_the_suite_itself_can_fail() -> None:
    """A case that asks for too much, and a model with a mirror in it, are told apart."""
    frames = np.random.default_rng(0).standard_normal((5, 30, 3))
    noise = Case("noise", lambda: Problem(frames, 1.0, None, {"bones": 2}))
    assert not run(noise).passed
    wrong = Case("wrong", plain, check=lambda problem: "all of it")
    assert not run(wrong).passed
    assert not run(Case("not refused", plain, refused="vertices")).passed
    refused = Case("refused for another reason", lambda: plain(bones=0), refused="vertices")
    assert not run(refused).passed
    good = Problem(frames, 1.0, None, {"bones": 2}).solve().skinning
    assert invalid(good, frames, 2) == ""
    mirrored = good.transforms * np.array([1, 1, -1, 1.0])
    bad = ssdr.Skinning(good.rest, good.indices, good.weights, mirrored)
    assert invalid(bad, frames, 2) == "rotations"
    assert invalid(good, frames, 3).startswith("number of bones")
