"""Results say what they are in a few words, whatever the size of their arrays."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.fit.fit import Fit
from ssdr.fit.fit_bones import BoneFit
from ssdr.search.progress import Progress, Record
from ssdr.show.page.page import Page

ARRAYS = ("NDArray", "Array", "Any", "bytes", "tuple[Skinning", "tuple[Record")


def public() -> list[type]:
    """Every public dataclass."""
    homes = [ssdr, *(m for n in ssdr.__all__ if inspect.ismodule(m := getattr(ssdr, n)))]
    things = [getattr(home, name) for home in homes for name in home.__all__]
    things += [Fit, BoneFit, Progress, Record, Page]
    kinds = {x for x in things if inspect.isclass(x) and dataclasses.is_dataclass(x)}
    return sorted(kinds, key=lambda kind: kind.__name__)


@pytest.mark.parametrize("kind", public(), ids=lambda kind: kind.__name__)
def test_no_class_with_arrays_has_the_representation_of_a_dataclass(kind: Any) -> None:
    generated = hasattr(kind.__repr__, "__wrapped__")  # by reprlib.recursive_repr
    holds = [f.name for f in dataclasses.fields(kind) if any(a in str(f.type) for a in ARRAYS)]
    assert not (generated and holds), holds


def test_results_in_a_few_words() -> None:
    chain = motions.chain(bones=5, frames=60)
    frames = ssdr.MeshSequence(chain.frames, chain.faces)
    fit = ssdr.fit_weights(frames, chain.skinning)
    surface = fit.skinning.surface
    things = [
        fit,
        ssdr.fit_bones(frames, chain.skinning, max_sweeps=1),
        ssdr.metrics.compare(frames, frames),
        ssdr.laplacian.split_frequencies(frames, length=0.1),
        surface,
        ssdr.Material(texture=b"0123456789" * 1000),
        ssdr.Kept(rest=chain.rest),
    ]
    for thing in things:
        text = repr(thing)
        assert text.startswith(type(thing).__name__ + "(")
        assert "array(" not in text
        assert "\n" not in text
        assert len(text) < 1200
    assert "squared_error=<float64 (120,)>" in repr(fit)
    assert f"rmse={fit.rmse!r}" in repr(fit)
    assert "texture=<10000 bytes>" in repr(things[5])


def test_few_numbers_are_shown() -> None:
    start = ssdr.Kept(indices=[0, 2], rest=np.zeros((4, 3), np.float32))
    assert "indices=[0, 2]" in repr(start)
    assert "rest=<float32 (4, 3)>" in repr(start)
