"""Passes over all frames, which finish a model that was found on some of them.

A pass is one alternation.  It reads the frames span by span and solves the bones of each span, then
solves weights and rest pose from two sums over all frames: Y, the products of vertices with
transforms, and G, those of transforms with each other.  It holds a block of frames, the transforms
and two (V, 4B) matrices in memory.  Its error is that of all frames, not an estimate.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..frames.executor import Executor, Frames, Local, SpanTask, spans_of
from ..parallel import chunk_bounds, run_chunks, serial_blas
from ..problem.problem import Initial
from ..problem.scan import Report, Scan
from ..progress import Stop
from ..sequence import MeshSequence
from ..solver.alignment import Alignment
from ..solver.gauss_newton import fit_motion
from ..solver.model import CHUNK, Constraints, Model
from ..solver.moments import gram_tables
from ..solver.objective import Objective, normal_length, rest_pulls
from ..solver.trajectories import Array, Trajectories, frame_scale_of
from ..solver.vertex_newton import newton_vertices

# Gauss–Seidel sweeps of the bones in a pass, and leaps before them in the first pass, which begins
# with transforms of other frames.
_SWEEPS, _FIRST_LEAPS = 24, 1
_ROUNDS = 3  # Gauss–Newton rounds on a vertex
ENTERING = 3  # number of bones that may enter a vertex's support in a pass
_GAIN = 2e-3  # relative decrease of the objective below which a pass is the last


def carried(
    model: Model,
    nearest: NDArray[np.int64],
    ratio: float,
    initial: Initial,
) -> Model:
    """Copy of a model for other frames, each with the transforms of the most similar solved frame.

    Parameters
    ----------
    model : Model
    nearest : (F,) int
        Index, among the model's frames, of the one most similar to each frame.
    ratio : float
        Scale of the model's space, divided by the scale of the new space.
    initial : Initial
        Given parts in the new space.  If they are a complete model to continue from, its transforms
        are taken.
    """
    transforms = model.transforms[nearest]
    transforms[..., 3] *= ratio
    if initial.is_model and initial.transforms is not None:
        transforms[:] = initial.transforms
    moved = dataclasses.replace(model.copy(), transforms=transforms)
    moved.rest *= ratio
    if moved.tree is not None:
        moved.tree = dataclasses.replace(moved.tree, points=ratio * moved.tree.points)
    return moved


class AllFrames:
    """A model of all frames, started from a model of chosen frames.

    Each frame takes the transforms of the most similar chosen frame at first; :meth:`improve` then
    makes passes over all frames.

    Parameters
    ----------
    sequences : list of MeshSequence
    scan : Scan
    data : Trajectories
        Trajectories of the chosen frames.
    model : Model
        Model of the chosen frames; it is copied.
    constraints : Constraints
    initial : Initial
        Given parts in the solver's space of all frames.
    importance : (F,) array or None
        Importance of the frames.
    executor : Executor, optional
        Executor that processes the spans of frames; by default it runs in this process.
    """

    def __init__(
        self,
        sequences: Sequence[MeshSequence],
        scan: Scan,
        data: Trajectories,
        model: Model,
        *,
        constraints: Constraints,
        initial: Initial,
        importance: Array | None,
        executor: Executor | None = None,
    ) -> None:
        self.sequences, self.constraints = sequences, constraints
        self.executor = executor or Local()
        self.alignment = scan.alignment
        self.passes = 0
        ratio = data.alignment.scale / self.alignment.scale
        self.model = carried(model, scan.nearest, ratio, initial)
        # trajectories of all frames, without their positions
        self.space = Trajectories(
            alignment=scan.alignment,
            z=data.z[:, :0],
            q=None,
            x2=data.x2,
            importance=data.importance,
            frame_scale=frame_scale_of(importance, len(scan.nearest)),
            faces=data.faces,
            normals=None if data.n2 is None else data.z[:, :0],
            n2=data.n2,
            surface=None if data.surface is None else data.surface.scaled(ratio),
        )
        share = self.space.n_frames / data.n_frames
        self.model.error *= ratio**2 * share
        self.model.normal_error *= share

    def improve(self, most: int, *, entering: int, report: Report | None = None) -> Iterator[float]:
        """Make at most `most` passes, until one gains little; yield the objective after each.

        A pass that does not lower the objective is undone, and nothing is yielded.  A pass in which
        `report` raises Stop is completed and is the last.  `entering` and `report` are those of
        :meth:`pass_over`.
        """
        last, stopped = math.inf, False

        def ask(done: float) -> None:
            nonlocal stopped
            if report is not None and not stopped:
                try:
                    report(done)
                except Stop:
                    stopped = True

        for _ in range(most):
            before = self.model.copy() if math.isfinite(last) else None
            value = self.pass_over(entering=entering, report=ask)
            if before is not None and not value < last:
                self.model = before
                return
            yield value
            if stopped or not value < (1 - _GAIN) * last:
                return
            last = value

    @serial_blas()
    def pass_over(self, *, entering: int, report: Report | None = None) -> float:
        """Alternate once over all frames; return the objective (:class:`Objective`) of the model.

        `entering` is the number of bones that may enter the support of a vertex.  `report` is
        called with the fraction of the frames that is done.
        """
        model, space, n_bones = self.model, self.space, self.model.n_bones
        length = normal_length(space, model)
        spans = spans_of(space.n_frames)
        leaps = 0 if self.passes else _FIRST_LEAPS
        # each span is sent with its own transforms, and a pass does not read the support
        still = dataclasses.replace(
            model,
            transforms=model.transforms[:0],
            support=model.indices,
            support_weights=model.weights,
        )
        shared = (
            still,
            space.importance,
            space.alignment.scale,
            space.faces,
            self.constraints,
            leaps,
            length,
        )

        def of_span(k: int) -> tuple[Array, ...]:
            span = slice(*spans[k])
            return (
                space.alignment.centre[span],
                space.alignment.rotation[span],
                space.frame_scale[span],
                model.transforms[span],
            )

        def take(k: int, own: Array) -> None:
            start, stop = spans[k]
            model.transforms[start:stop] = own
            if report is not None:
                report(stop / space.n_frames)

        task = SpanTask(_pass_span, self.sequences, spans, of_span, shared)
        y, g, x2 = self.executor.total(task, take)
        newton_vertices(
            lambda i, k: y[i:k],
            x2,
            gram_tables(g, n_bones),
            model,
            hold=rest_pulls(space, model, self.constraints),
            length=length,
            constraints=self.constraints,
            entering=entering,
            rounds=_ROUNDS,
        )
        self.passes += 1
        # joints do not move in a pass
        return Objective(dataclasses.replace(self.constraints, near_skin=False)).value(space, model)


@serial_blas()
def _pass_span(
    frames: Frames,
    centre: Array,
    rotation: Array,
    frame_scale: Array,
    transforms: Array,
    model: Model,
    importance: Array,
    scale: float,
    faces: NDArray[np.int32],
    constraints: Constraints,
    leaps: int,
    length: float,
) -> tuple[Array, tuple[Array, Array, Array]]:
    """Solve the bones of a span; return their transforms and the span's terms of Y, G and Σ|x|²."""
    n, n_bones, n_points = len(model.rest), transforms.shape[1], 1 + model.normals.shape[1]
    transforms = transforms.copy()
    y, x2 = np.zeros((n, n_points, 4, n_bones)), np.zeros((n, n_points))
    g = np.zeros((4 * n_bones, 4 * n_bones))
    alignment = Alignment(centre=centre, rotation=rotation, scale=scale)
    for start, block in frames.blocks():
        stop = start + len(block)
        flat = alignment.inward(block, start, frame_scale).reshape(n, -1)
        part = Trajectories(
            alignment=alignment.select_frames(slice(start, stop)),
            z=flat,
            q=None,
            x2=np.einsum("ij,ij->i", flat, flat),
            importance=importance,
            frame_scale=frame_scale[start:stop],
            faces=faces,
        )
        if n_points > 1:
            part = part.with_normals()
        x2 += part.squares(slice(None), length)
        piece = dataclasses.replace(
            model,
            transforms=transforms[start:stop],
            error=part.x2.copy(),
            normals=model.normals.copy(),
        )
        fit_motion(part, piece, constraints=constraints, sweeps=_SWEEPS, leaps=leaps, length=length)
        transforms[start:stop] = piece.transforms
        hat = part.stack(piece.transforms)
        g += hat.T @ hat

        def add(_: int, i: int, k: int, part: Trajectories = part, hat: Array = hat) -> None:
            y[i:k] += part.products(slice(i, k), hat, length)

        run_chunks(add, chunk_bounds(n, 2 * CHUNK))
    return transforms, (y, g, x2)
