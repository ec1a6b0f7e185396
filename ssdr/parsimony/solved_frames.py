"""Frames that a search solves, and errors of models on the solved frames and on all frames.

If the frames do not fit into memory, representative frames are solved, and the error is measured on
all frames.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InputError
from ..frames.error import largest_error, rmse
from ..frames.normals import with_fitted_normals
from ..metrics.normal_angles import errors_of_model
from ..metrics.vertex_distances import distances
from ..problem.answer import skinning_of
from ..problem.problem import Initial, Problem
from ..problem.scan import needs_streaming
from ..search.descent import Descent
from ..search.passes import ENTERING, AllFrames
from ..search.solve import read_frames, rounded, scan_of
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.model import Model
from ..solver.rest_normals import with_rest_normals
from ..solver.trajectories import Trajectories
from ..storage.size import Size, size
from .report import FileSize, Measure

__all__ = ["SolvedFrames", "Written"]

# Returns the bytes of the file of a skinning, and the skinning that a reader decodes from it.
Written = Callable[[Skinning], tuple[int, Skinning]]


class SolvedFrames:
    """Frames that a search solves: all of them, or representative ones if they are streamed.

    Parameters
    ----------
    problem : Problem
    measure : {"rmse", "max"}
        Error that the tolerance of the search bounds.
    written : Written, optional
        Counts the bytes of the file of a skinning, and decodes it.

    Attributes
    ----------
    sequences : list of MeshSequence
    data : Trajectories
        Compressed trajectories of the frames in `sequences`.
    initial : Initial
        Parts that the caller gave, in the solver's space and for the frames in `sequences`.
    scan : Scan or None
        None if all frames are in memory.
    degree : float
        Length that counts as much as a degree of the mean angle of drawn normals; 0 if that has no
        tolerance.
    slack : float
        Squared error that the tolerance allows if normals have a tolerance, too; otherwise 0.
    """

    def __init__(
        self,
        problem: Problem,
        measure: Measure,
        written: Written | None = None,
    ) -> None:
        self.problem, self.measure, self.written = problem, measure, written
        self.degree = self.slack = 0.0
        self.scan = scan_of(problem) if needs_streaming(problem.sequences) else None
        self.sequences, data, initial = read_frames(problem, self.scan)
        data, self.initial = problem.with_rest_surface(data, initial)
        self.data = data.compressed(problem.bones)

    def squared(self, rmse: float) -> float:
        """Convert an RMSE to a squared error in the solver's space, summed over solved frames."""
        return (rmse / self.data.scale) ** 2 * self.data.n_frames * self.data.n_vertices

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

    @property
    def are_all_exact(self) -> bool:
        """Whether all frames are solved, and weights and keys returned as solved, not rounded."""
        return self.scan is None and self.problem.storage == "float32" and self.written is None

    @property
    def tolerant(self) -> Trajectories:
        """Trajectories whose errors within the tolerance count for little, so that normals gain."""
        return dataclasses.replace(self.data, slack=self.slack)

    def with_normals(self, model: Model) -> tuple[Trajectories, Model]:
        """The trajectories and a model, with normals if these have a tolerance and bones are rigid.

        Otherwise both are returned as they are. The normals are those that
        :func:`~ssdr.search.steps.solve_normals` adds; the trajectories then also have the `slack`.
        """
        if not self.degree or self.problem.constraints.bone_model != "rigid":
            return self.data, model
        data = self.tolerant.with_normals()
        return data, with_rest_normals(data, model)

    def larger(self, error: float, angle: float | None) -> float:
        """The larger of an error of positions and a mean angle of normals, converted to a length.

        The angle counts only if normals have a tolerance.
        """
        return max(error, self.degree * (angle or 0.0))

    def error(self, model: Model, measure: Measure | None = None) -> float:
        """Error of a model on the frames that the search solves, in the mesh's units.

        If `measure` is given, the error is that of positions alone, by this measure.
        """
        if measure is None:
            error = self.error(model, self.measure)
            return self._with_angle(error, self._inputs(), self.skinning(model))
        if self.scan is not None and measure == "rmse":
            # each representative frame counts as often as there are frames like it
            return math.sqrt(max(model.weighted_error(self.data), 0.0) / self.squared(1.0))
        rest, transforms = self.data.to_world(model.rest, model.transforms)
        skin = rest, model.indices, model.weights
        if self.scan is not None:
            return _error(measure, self.sequences, *skin, transforms)
        return _error(measure, self.problem.inputs, *self.problem.for_inputs(*skin), transforms)

    def error_of_all(self, s: Skinning, measure: Measure | None = None) -> float:
        """Error of a skinning, measured on all frames; `measure` is that of :meth:`error`."""
        problem = self.problem
        if measure is None:
            error = self.error_of_all(s, self.measure)
            return self._with_angle(error, problem.inputs, s, executor=problem.executor)
        if s.shapes is not None:
            found = distances(np.concatenate([x.frames(slice(None)) for x in problem.inputs]), s)
            return found.max if measure == "max" else found.rmse
        parts = (s.rest, s.indices, s.weights, s.transforms)
        return _error(measure, problem.inputs, *parts, executor=problem.executor)

    def _inputs(self) -> list[MeshSequence]:
        """The frames that the search solves, with all vertices of the caller's mesh."""
        rows, (first, *_) = self.problem.rows, self.problem.inputs
        if self.scan is None:
            return self.problem.inputs
        if rows is None:
            return self.sequences
        frames = self.sequences[0].frames(slice(None))[:, rows]
        return [dataclasses.replace(first, vertices=frames, validate=False)]

    def _with_angle(
        self, error: float, sequences: list[MeshSequence], s: Skinning, **executor: Any
    ) -> float:
        if not self.degree:
            return error
        fitted = with_fitted_normals(sequences, s, **executor)
        found = errors_of_model(sequences, fitted, **executor)
        return self.larger(error, None if found is None else found.mean)

    def file(self, skinning: Skinning) -> FileSize | None:
        """Bytes of the file of a skinning, and its errors on all frames.

        Returns None if no file is described.
        """
        if self.written is None:
            return None
        try:
            sequences, executor = self.problem.inputs, self.problem.executor
            fitted = with_fitted_normals(sequences, skinning, executor=executor)
            size, decoded = self.written(fitted)
        except InputError as error:
            if error.argument != "tolerance":
                raise
            return FileSize(0, math.inf)
        found = errors_of_model(sequences, decoded, executor=executor)
        angle = None if found is None else found.mean
        return FileSize(size, self.error_of_all(decoded, self.measure), angle)

    def kept(self, skinning: Skinning, error: float, tolerance: float) -> tuple[int, float]:
        """Bytes and error that decide whether a skinning is kept.

        If `error` holds the tolerance and a file is described, they are those of the file, with an
        error of at least `error`. Otherwise they are those of the skinning.
        """
        file = self.file(skinning) if error <= tolerance else None
        if file is None:
            return self.size(skinning).total, error
        return file.bytes, max(self.larger(file.error, file.normals), error)

    def skinning(self, model: Model) -> Skinning:
        """Convert a model to a skinning of the frames that the search solves."""
        return _trimmed(skinning_of(self.problem, self.data, model, self.sequences))

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

        Weights are rounded to the type `problem.storage`.

        Parameters
        ----------
        model : Model
            Model of the frames that the search solves.
        passes : int
            Most passes over all frames; they end when one gains little.
        entering : int
            Number of bones that may enter the support of a vertex in a pass.
        report : callable
            Called after each round of rounding and within each pass; one in which it raises Stop
            is the last.
        data : Trajectories, optional
            Copy of the trajectories with which the model was solved.
        """
        problem = self.problem
        if data is None:
            data, model = self.with_normals(model)
        model, constraints = rounded(problem, data, model, lambda _: report()), problem.constraints
        if problem.storage != "float32":
            constraints = constraints.with_weights(problem.n_vertices)
        if self.scan is None:
            return self.skinning(model)
        frames = AllFrames(
            problem.sequences,
            self.scan,
            data,
            model,
            constraints=constraints,
            initial=Initial(),
            importance=problem.frame_importance,
            executor=problem.executor,
        )
        for _ in frames.improve(passes, entering=entering, report=lambda _: report()):
            pass
        return _trimmed(skinning_of(problem, frames.alignment, frames.model))

    def size(self, skinning: Skinning) -> Size:
        """Size in bytes of a skinning, with weights counted in the type `problem.storage`."""
        return size(skinning, storage=self.problem.storage)

    def bytes(self, model: Model) -> int:
        """Bytes of a model for all frames, in which every bone has a key at every frame."""
        stored, frames = self.size(self.skinning(model)), self.data.n_frames
        return stored.total + stored.keys // frames * (self.problem.n_frames - frames)


def _error(measure: Measure, sequences: list[MeshSequence], *parts: Any, **executor: Any) -> float:
    error = largest_error if measure == "max" else rmse
    return error(sequences, *parts, **executor)


def _trimmed(skinning: Skinning) -> Skinning:
    """A copy without the influence slots that every vertex leaves empty."""
    return skinning.prune(int(np.count_nonzero(skinning.weights, axis=1).max()))
