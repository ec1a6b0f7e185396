"""The stages that work on a sample of the vertices, and those that lead back."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from ..solver.alternation import alternate, vertex_step
from .run import Run, Stage

__all__ = ["AllVertices", "ReturnToBest", "SampleVertices"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SampleVertices(Stage):
    """Work on a third of the vertices from now on, within bounds: they tell where bones belong.

    On all of them, where that would leave less than half out.

    Attributes
    ----------
    least, most : int
        Vertices for each bone asked for.
    """

    phase: ClassVar[str] = "sample"
    least: int = 48
    most: int = 128

    def apply(self, run: Run) -> Iterator[None]:
        third = run.whole.n_vertices // 3
        run.take_sample(min(self.most * run.bones, max(self.least * run.bones, third)))
        if run.model is not None and run.chosen is not None:
            run.model = run.model.select_vertices(run.chosen)
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class AllVertices(Stage):
    """Work on all vertices again: each begins with the bones of the nearest one of the sample.

    Attributes
    ----------
    alternations : int
        On all vertices, from there.
    """

    phase: ClassVar[str] = "all vertices"
    cost: float = 8
    alternations: int = 4

    def apply(self, run: Run) -> Iterator[None]:
        few, chosen = run.present, run.chosen
        run.take_all()
        if chosen is not None:
            data, given = run.data, run.given
            rest = data.frame(given.rest_frame) if given.rest is None else given.rest.copy()
            near = np.asarray(cKDTree(rest[chosen]).query(rest)[1])
            model = few.select_vertices(near)
            model.rest = rest
            if given.rest is None:
                model.rest[chosen] = few.rest
            model.restart_support()
            vertex_step(data, model, locked=run.locked)
            alternate(data, model, self.alternations, run.locked)
            run.iteration += self.alternations
            run.model = model
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReturnToBest(Stage):
    """Reset to the best model so far, restricted to the sample if that has lower error there."""

    phase: ClassVar[str] = "return to best"
    cost: float = 0

    def apply(self, run: Run) -> Iterator[None]:
        best = run.best_model
        if run.chosen is not None:
            best = best.select_vertices(run.chosen)
            if best.weighted_error(run.data) >= run.present.weighted_error(run.data):
                yield
                return
        run.model = best.with_restarted_support()
        yield
