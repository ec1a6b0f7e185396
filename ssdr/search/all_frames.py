"""A model that was found on chosen frames, fitted to all frames in one walk over them.

The walk is an alternation.  It reads the frames span by span and fits the bones of each span, then
solves weights and rest pose from two sums over all frames: Y, the products of vertices with
transforms, and G, those of transforms with each other.  It holds a block of frames, the transforms
and two (V, 4B) matrices in memory.
"""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

import numpy as np

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..mesh.executor import Frames, SpanTask, spans_of
from ..solver.alignment import Alignment
from ..solver.gauss_newton import fit_motion
from ..solver.model import CHUNK, Constraints, Model
from ..solver.moments import gram_tables
from ..solver.objective import normal_length, rest_pulls
from ..solver.trajectories import Array, Trajectories, frame_scale_of
from ..solver.vertex_newton import newton_vertices
from .problem import Problem
from .progress import Stop
from .scan import Report, Scan

# Gauss–Seidel sweeps of the bones, and leaps before them, since most frames begin with transforms
# of other frames.
_SWEEPS, _LEAPS = 24, 1
_ROUNDS = 3  # Gauss–Newton rounds on a vertex
ENTERING = 3  # number of bones that may enter a vertex's support


@serial_blas()
def fit_all_frames(
    problem: Problem,
    scan: Scan,
    data: Trajectories,
    model: Model,
    *,
    entering: int = ENTERING,
    report: Report,
) -> tuple[Alignment, Model]:
    """Fit a model of chosen frames to all frames; return their alignment and the new model.

    Parameters
    ----------
    problem : Problem
        With all frames.
    scan : Scan
    data : Trajectories
        Trajectories of the chosen frames.
    model : Model
        Model of the chosen frames.  Each frame starts from the transforms of the most similar one.
    entering : int
        Number of bones that may enter the support of a vertex.
    report : callable
        Called with the fraction of the frames that is done.  If it raises Stop, all frames are
        fitted even so.
    """
    constraints, n_frames, n_bones = problem.constraints, problem.n_frames, model.n_bones
    if problem.smoothness > 0:  # the vertices' solve ignores the penalty, so that weights stay
        constraints = constraints.with_weights(problem.n_vertices)
    alignment = Alignment(centre=scan.centre, rotation=scan.rotation, scale=data.alignment.scale)
    frame_scale = frame_scale_of(problem.frame_importance, n_frames)
    length, hold = normal_length(data, model), rest_pulls(data, model, constraints)
    hold[:, 0] *= n_frames / data.n_frames  # in proportion to the error of all frames
    moves = model.transforms[scan.nearest]
    # each span is sent with its own transforms, and no span reads the support
    model = dataclasses.replace(
        model.copy(),
        transforms=moves[:0],
        support=model.indices.copy(),
        support_weights=model.weights.copy(),
    )
    shared = model, data.importance, data.faces, constraints, length
    spans = spans_of(n_frames)

    def of_span(k: int) -> tuple[Any, ...]:
        span = slice(*spans[k])
        return alignment.select_frames(span), frame_scale[span], moves[span]

    sums: tuple[Array, ...] = ()
    walk = problem.executor.map(SpanTask(_fit_span, problem.sequences, spans, of_span, shared))
    for (start, stop), (own, *more) in zip(spans, walk, strict=True):
        moves[start:stop] = own
        sums = tuple(a + b for a, b in zip(sums, more, strict=True)) if sums else tuple(more)
        with contextlib.suppress(Stop):  # the walk is finished even so
            report(stop / n_frames)
    y, g, x2 = sums
    newton_vertices(
        lambda i, k: y[i:k],
        x2,
        gram_tables(g, n_bones),
        model,
        hold=hold,
        length=length,
        constraints=constraints,
        entering=0 if problem.smoothness > 0 else entering,
        rounds=_ROUNDS,
    )
    return alignment, dataclasses.replace(model, transforms=moves)


@serial_blas()
def _fit_span(
    frames: Frames,
    alignment: Alignment,
    frame_scale: Array,
    transforms: Array,
    model: Model,
    importance: Array,
    faces: Any,
    constraints: Constraints,
    length: float,
) -> tuple[Array, Array, Array, Array]:
    """Fit the bones of a span; return their transforms and the span's terms of Y, G and Σ|x|²."""
    n, n_bones, n_points = len(model.rest), transforms.shape[1], 1 + model.normals.shape[1]
    transforms = transforms.copy()
    y, x2 = np.zeros((n, n_points, 4, n_bones)), np.zeros((n, n_points))
    g = np.zeros((4 * n_bones, 4 * n_bones))
    for start, block in frames.blocks():
        some = slice(start, start + len(block))
        flat = alignment.inward(block, start, frame_scale).reshape(n, -1)
        part = Trajectories(
            z=flat,
            q=None,
            x2=np.einsum("ij,ij->i", flat, flat),
            importance=importance,
            frame_scale=frame_scale[some],
            faces=faces,
            alignment=alignment.select_frames(some),
        )
        if n_points > 1:
            part = part.with_normals()
        x2 += part.squares(slice(None), length)
        piece = dataclasses.replace(
            model, transforms=transforms[some], error=part.x2.copy(), normals=model.normals.copy()
        )
        fit_motion(
            part, piece, constraints=constraints, sweeps=_SWEEPS, leaps=_LEAPS, length=length
        )
        transforms[some] = piece.transforms
        hat = part.stack(piece.transforms)
        g += hat.T @ hat

        def add(_: int, i: int, k: int, part: Trajectories = part, hat: Array = hat) -> None:
            y[i:k] += part.products(slice(i, k), hat, length)

        run_chunks(add, chunk_bounds(n, 2 * CHUNK))
    return transforms, y, g, x2
