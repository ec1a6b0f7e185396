"""Frames that a search solves, and errors of models on the solved frames and on all frames.

If the frames do not fit into memory, representative frames are solved, and the error is measured on
all frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..frames.error import largest_error, rmse
from ..problem.answer import skinning_of
from ..problem.problem import Initial, Problem
from ..problem.scan import needs_streaming
from ..search.descent import Descent
from ..search.passes import ENTERING, AllFrames
from ..search.solve import read_frames, scan_of
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.model import Model
from ..solver.trajectories import Trajectories
from ..storage.size import size
from .report import Measure


class SolvedFrames:
    """Frames that a search solves: all of them, or representative ones if they are streamed.

    Parameters
    ----------
    problem : Problem
    measure : {"rmse", "max"}
        Error that the tolerance of the search bounds.

    Attributes
    ----------
    sequences : list of MeshSequence
    data : Trajectories
        Compressed trajectories of the frames in `sequences`.
    initial : Initial
        Parts that the caller gave, in the solver's space and for the frames in `sequences`.
    scan : Scan or None
        None if all frames are in memory.
    """

    def __init__(self, problem: Problem, measure: Measure) -> None:
        self.problem, self.measure = problem, measure
        self.scan = scan_of(problem) if needs_streaming(problem.sequences) else None
        self.sequences, data, initial = read_frames(problem, self.scan)
        data, self.initial = problem.with_rest_surface(data, initial)
        self.data = data.compressed(problem.bones)

    def squared(self, rmse: float) -> float:
        """Convert an RMSE to a squared error in the solver's space, summed over solved frames."""
        return (rmse / self.data.alignment.scale) ** 2 * self.data.n_frames * self.data.n_vertices

    def descent(
        self, bones: int, *, data: Trajectories | None = None, initial: Initial | None = None
    ) -> Descent:
        """Begin a descent on the frames that the search solves.

        `data`, if given, is a changed copy of the trajectories that replaces them; `initial`
        replaces the initial parts.
        """
        problem = self.problem
        return Descent(
            self.data if data is None else data,
            bones=bones,
            influences=problem.influences,
            rng=problem.rng,
            constraints=problem.constraints,
            initial=self.initial.beside_model() if initial is None else initial,
            monitor=problem.monitor,
            rigid_joints=problem.rig == "rigid",
            normals=True,
        )

    def error(self, model: Model, measure: Measure | None = None) -> float:
        """Error of a model on the frames that the search solves, in the mesh's units."""
        measure = measure or self.measure
        if self.scan is not None and measure == "rmse":
            # each representative frame counts as often as there are frames like it
            return math.sqrt(max(model.weighted_error(self.data), 0.0) / self.squared(1.0))
        rest, transforms = self.data.alignment.to_world(model.rest, model.transforms)
        skin = rest, model.indices, model.weights
        if self.scan is not None:
            return _error(measure, self.sequences, *skin, transforms)
        return _error(measure, self.problem.inputs, *self.problem.for_inputs(*skin), transforms)

    def error_of_all(self, s: Skinning, measure: Measure | None = None) -> float:
        """Error of a skinning, measured on all frames."""
        parts = (s.rest, s.indices, s.weights, s.transforms)
        options = {"executor": self.problem.executor}
        return _error(measure or self.measure, self.problem.inputs, *parts, **options)

    def skinning(self, model: Model) -> Skinning:
        """Convert a model to a skinning of the frames that the search solves."""
        return _trimmed(skinning_of(self.problem, self.data.alignment, model, self.sequences))

    def skinning_of_all(
        self,
        model: Model,
        *,
        passes: int,
        entering: int = ENTERING,
        report: Callable[[], None],
        data: Trajectories | None = None,
    ) -> Skinning:
        """Convert a model to a skinning of all frames; streamed frames are solved in passes.

        Parameters
        ----------
        model : Model
            Model of the frames that the search solves.
        passes : int
            Most passes over all frames; they end when one gains little.
        entering : int
            Number of bones that may enter the support of a vertex in a pass.
        report : callable
            Called within each pass; one in which it raises Stop is the last.
        data : Trajectories, optional
            Copy of the trajectories with which the model was solved.
        """
        problem, data = self.problem, data or self.data
        if self.scan is None:
            return self.skinning(model)
        frames = AllFrames(
            problem.sequences,
            self.scan,
            data,
            model,
            constraints=problem.constraints,
            initial=Initial(),
            importance=problem.frame_importance,
            executor=problem.executor,
        )
        for _ in frames.improve(passes, entering=entering, report=lambda _: report()):
            pass
        return _trimmed(skinning_of(problem, frames.alignment, frames.model))

    def bytes(self, model: Model) -> int:
        """Bytes of a model for all frames, in which every bone has a key at every frame."""
        stored, frames = size(self.skinning(model)), self.data.n_frames
        return stored.total + stored.keys // frames * (self.problem.n_frames - frames)


def _error(measure: Measure, sequences: list[MeshSequence], *parts: Any, **executor: Any) -> float:
    error = largest_error if measure == "max" else rmse
    return error(sequences, *parts, **executor)


def _trimmed(skinning: Skinning) -> Skinning:
    """A copy without the influence slots that every vertex leaves empty."""
    return skinning.prune(int(np.count_nonzero(skinning.weights, axis=1).max()))
