"""Stages that switch to a sample of the vertices, to all vertices, or to the best model."""

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
    """Work on a sample of the vertices from now on: a third of them, within bounds.

    A sample is enough to tell where bones belong.  If the bounds ask for half of the vertices or
    more, all are used.

    Attributes
    ----------
    least, most : int
        Bounds of the number of vertices, for each bone asked for.
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
    """Work on all vertices again; each starts with the weights of the nearest sampled vertex.

    Attributes
    ----------
    alternations : int
        Number of alternations on all vertices from that start.
    """

    phase: ClassVar[str] = "all vertices"
    cost: float = 8
    alternations: int = 4

    def apply(self, run: Run) -> Iterator[None]:
        few, chosen = run.present, run.chosen
        run.take_all()
        if chosen is not None:
            data, given = run.data, run.present_parts
            rest = given.first_pose(data)
            near = np.asarray(cKDTree(rest[chosen]).query(rest)[1])
            model = few.select_vertices(near)
            if given.rest is None:
                # a vertex starts as far from the sampled one as it is in the rest frame
                rest = model.rest + rest - rest[chosen][near]
            model.rest = rest
            model.restart_support()
            vertex_step(data, model, locked=run.locked)
            alternate(data, model, self.alternations, run.locked)
            run.iteration += self.alternations
            run.model = model
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReturnToBest(Stage):
    """Continue from the best model so far.

    While a sample of vertices is used, this is done only if the best model has less error on the
    sample than the present model.
    """

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
