"""The stages that work on a sample of the vertices, and those that lead back."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from ..solver.alternation import alternate, vertex_step
from .run import Run, Stage

__all__ = ["Everywhere", "Recall", "Sample"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sample(Stage):
    """From here on some vertices alone, where they are many: they tell where bones belong.

    A third of them, within bounds; all, where that leaves less than half out.

    Attributes
    ----------
    least, most : int
        Vertices for each bone asked for.
    """

    phase: ClassVar[str] = "sample"
    least: int = 48
    most: int = 128

    def step(self, run: Run) -> bool:
        self.prepare(run)
        if run.model is not None and run.chosen is not None:
            run.model = run.model.select_vertices(run.chosen)
        return True

    def prepare(self, run: Run) -> None:
        third = run.whole.n_vertices // 3
        run.take_sample(min(self.most * run.bones, max(self.least * run.bones, third)))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Everywhere(Stage):
    """From here on all vertices again: each begins with the bones of the nearest of the sample.

    Attributes
    ----------
    alternations : int
        Of all vertices, from there.
    """

    phase: ClassVar[str] = "everywhere"
    cost: float = 8
    alternations: int = 4

    def step(self, run: Run) -> bool:
        few, chosen = run.present, run.chosen
        self.prepare(run)
        if chosen is None:
            return True
        data, frame = run.data, run.prescribed.rest_frame
        rest = data.frame(frame) if run.prescribed.rest is None else run.prescribed.rest.copy()
        near = np.asarray(cKDTree(rest[chosen]).query(rest)[1])
        model = few.select_vertices(near)
        model.rest = rest
        if run.prescribed.rest is None:
            model.rest[chosen] = few.rest
        model.restart_support()
        vertex_step(data, model, fixed=run.fixed)
        alternate(data, model, self.alternations, run.fixed)
        run.iteration += self.alternations
        run.model = model
        return True

    def prepare(self, run: Run) -> None:
        run.take_all()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recall(Stage):
    """Go on from the best model so far; on a sample, from what it is there if that is better."""

    phase: ClassVar[str] = "recall"
    cost: float = 0

    def step(self, run: Run) -> bool:
        best = run.best_model
        if run.chosen is not None:
            best = best.select_vertices(run.chosen)
            if best.weighted_error(run.data) >= run.present.weighted_error(run.data):
                return True
        run.model = best.with_restarted_support()
        return True
