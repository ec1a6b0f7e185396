"""Pruning: every step says what it cost."""

from __future__ import annotations

import ssdr
from helpers.measures import small, wavy
from ssdr import parsimony


def test_every_pruning_says_what_it_cost() -> None:
    found = small().parsimony
    assert [p.what for p in found.prunings] == ["bones", "influences", "keyframes"]
    bones, influences, keyframes = found.prunings
    assert bones.before >= bones.after == found.bones
    assert influences.after < influences.before
    assert influences.bytes_after < influences.bytes_before
    assert keyframes.bytes_after <= keyframes.bytes_before
    assert influences.error_after == keyframes.error_before
    assert keyframes.error_after == found.error
    assert keyframes.bytes_after == found.size.total == parsimony.size(small().skinning).total
    assert influences.after == (small().skinning.weights > 0).sum()
    assert small().skinning.keyframes is not None
    assert keyframes.after == small().skinning.keyframes.sum()
    for p in found.prunings:
        assert p.cost == p.error_after - p.error_before


def test_one_bone_less_is_tried_before_it_is_given_up() -> None:
    tried: set[str] = set()

    def note(progress: ssdr.Progress) -> None:
        tried.add(progress.phase.partition(" ")[0])

    found = ssdr.smallest(wavy(), tolerance="0.8%", effort="fast", callback=note).parsimony
    assert str(found.bones) in tried
    assert found.bones == found.least_bones or str(found.bones - 1) in tried
