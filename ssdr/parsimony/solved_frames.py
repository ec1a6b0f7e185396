"""Frames that a search solves, and errors of models on the solved frames and on all frames.

If the frames do not fit into memory, representative frames are solved, and the error is measured on
all frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..mesh.sequence import MeshSequence
from ..model.frame_error import largest_error, rmse
from ..model.size import size
from ..model.skinning import Skinning
from ..search.all_frames import ENTERING, fit_all_frames
from ..search.descent import Descent
from ..search.problem import Initial, Problem
from ..search.scan import needs_streaming
from ..search.solve import gathered, scan_of, skinning_of
from ..solver.model import Model
from ..solver.trajectories import Trajectories
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
    solved : Problem
        The problem with the solved frames alone.
    data : Trajectories
        Compressed trajectories of these frames.
    initial : Initial
        Parts that the caller gave, in the solver's space and for these frames.
    scan : Scan or None
        None if all frames are in memory.
    """

    def __init__(self, problem: Problem, measure: Measure) -> None:
        self.problem = self.solved = problem
        self.measure, self.scan = measure, None
        if needs_streaming(problem.sequences):
            self.scan = scan_of(problem, spread=False)
            # each representative frame counts as often as there are frames like it
            counts = np.bincount(self.scan.nearest, weights=problem.frame_importance)
            self.solved = problem.of_frames(self.scan.chosen, counts.astype(np.float64))
        data, self.initial = gathered(self.solved)
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
            normals=problem.normals,
        )

    def error(self, model: Model, measure: Measure | None = None) -> float:
        """Error of a model on the frames that the search solves, in the mesh's units."""
        measure = measure or self.measure
        if self.scan is not None and measure == "rmse":
            return math.sqrt(max(model.weighted_error(self.data), 0.0) / self.squared(1.0))
        rest, transforms = self.data.alignment.to_world(model.rest, model.transforms)
        skin = self.solved.for_inputs(rest, model.indices, model.weights)
        return _error(measure, self.solved.inputs, *skin, transforms)

    def error_of_all(self, s: Skinning, measure: Measure | None = None) -> float:
        """Error of a skinning, measured on all frames."""
        parts = (s.rest, s.indices, s.weights, s.transforms)
        options = {"executor": self.problem.executor}
        return _error(measure or self.measure, self.problem.inputs, *parts, **options)

    def skinning(self, model: Model) -> Skinning:
        """Convert a model to a skinning of the frames that the search solves."""
        return _trimmed(skinning_of(self.solved, self.data.alignment, model))

    def skinning_of_all(
        self,
        model: Model,
        *,
        entering: int = ENTERING,
        report: Callable[[], None],
        data: Trajectories | None = None,
    ) -> Skinning:
        """Convert a model to a skinning of all frames, to which it is fitted if they are streamed.

        Parameters
        ----------
        model : Model
            Model of the frames that the search solves.
        entering, report
            As in :func:`~ssdr.search.all_frames.fit_all_frames`.
        data : Trajectories, optional
            Copy of the trajectories with which the model was solved.
        """
        if self.scan is None:
            return self.skinning(model)
        alignment, model = fit_all_frames(
            self.problem,
            self.scan,
            data or self.data,
            model,
            entering=entering,
            report=lambda _: report(),
        )
        return _trimmed(skinning_of(self.problem, alignment, model))

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
