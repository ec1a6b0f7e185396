"""The stages that work on a sample of the vertices and frames, and those that lead back."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from ..solver.alternation import alternate, carry_over, vertex_step
from ..solver.model import Model
from .run import Run, Stage

__all__ = ["Everywhere", "Recall", "Sample"]

_SWEEPS = 6  # of the bones of all frames, from those of the frames near them


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sample(Stage):
    """From here on some vertices and frames alone, which tell where bones belong.

    A third of them, within bounds; all, where that leaves less than half out.

    Attributes
    ----------
    least, most : int
        Vertices for each bone asked for.
    frames : int
        At least.
    """

    phase: ClassVar[str] = "sample"
    least: int = 48
    most: int = 128
    frames: int = 48

    def step(self, run: Run) -> bool:
        self.prepare(run)
        if run.model is not None:
            run.model = _on_sample(run, run.model)
        return True

    def prepare(self, run: Run) -> None:
        third = run.whole.n_vertices // 3
        run.take_sample(
            min(self.most * run.bones, max(self.least * run.bones, third)),
            max(self.frames, run.whole.n_frames // 3),
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Everywhere(Stage):
    """From here on all again: each vertex and frame begins as the nearest of the sample.

    Attributes
    ----------
    alternations : int
        Of all vertices, from there.
    """

    phase: ClassVar[str] = "everywhere"
    cost: float = 8
    alternations: int = 4

    def step(self, run: Run) -> bool:
        few, chosen, frames = run.present, run.chosen, run.chosen_frames
        self.prepare(run)
        if chosen is None and frames is None:
            return True
        data, model = run.data, few
        if chosen is not None:
            at = run.prescribed.rest_frame
            rest = data.frame(at) if run.prescribed.rest is None else run.prescribed.rest.copy()
            near = np.asarray(cKDTree(rest[chosen]).query(rest)[1])
            model = few.vertices(near)
            model.rest = rest
            if run.prescribed.rest is None:
                model.rest[chosen] = few.rest
            model.restart_support()
        if frames is not None:
            carry_over(data, model, frames, run.fixed, sweeps=_SWEEPS)
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
        best = _on_sample(run, run.best_model)
        if run.sampled and best.objective(run.data) >= run.present.objective(run.data):
            return True
        run.model = best.with_restarted_support()
        return True


def _on_sample(run: Run, model: Model) -> Model:
    """A model of all vertices and frames as it is on the sample."""
    if run.chosen is not None:
        model = model.vertices(run.chosen)
    if run.chosen_frames is not None:
        model = model.frames(run.chosen_frames)
        vertex_step(run.data, model, fixed=run.fixed)  # its errors were those of all frames
    return model
