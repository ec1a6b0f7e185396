"""``ssdr.decompose``: from frames to a skinned model."""

from __future__ import annotations

import dataclasses
import logging
import math
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .checks import (
    as_sequences,
    check_bone_model,
    check_bones,
    check_count,
    check_importance,
    check_index,
    check_influences,
    check_nonnegative,
    check_rng,
)
from .errors import Cancelled, InputError, SsdrWarning, check_choice
from .parallel import serial_blas
from .parsimony.report import Measure
from .parsimony.solve import MOST_BONES, decompose_within
from .result import Decomposition
from .search.problem import check_parts
from .search.progress import Progress, Record
from .search.run import Run
from .search.schedule import plan_print
from .search.state import Checkpoint, SolverState, check_settings, check_size, taking_up
from .search.task import Task, best_of
from .sequence import MeshSequence
from .skinning import BoneModel, Skinning
from .solver.alternation import bone_costs
from .solver.bone_models import normalise_gauge
from .solver.model import Fixed, Model, pad_influences
from .solver.trajectories import Alignment
from .solver.warmup import compile_kernels
from .streaming.error import squared_error
from .streaming.executor import Executor, executor_for
from .streaming.passes import Passes, scan_progress, share_of
from .streaming.scan import Scan, needs_streaming, scan

__all__ = ["Decomposition", "Effort", "Progress", "Record", "decompose"]

Effort = Literal["fast", "balanced", "best"]
_logger = logging.getLogger(__name__)
_REAL = (int, float, np.integer, np.floating)
_MOST_RATIO = 10.0  # of the true error to the objective's, beyond which they tell different things
# importance of a frame relative to the largest: with less the steps of all bones together would
# not notice what its own do
_LEAST_FRAME = 1e-4
_NO_LOSS = 1e-13  # of the motion's energy: what solving for it leaves to rounding


def decompose(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    bones: int | None = None,
    influences: int = 4,
    effort: Effort = "balanced",
    bone_model: BoneModel = "rigid",
    rng: int | np.random.Generator = 0,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    resume: SolverState | str | Path | None = None,
    checkpoint: str | Path | None = None,
    rest: Any = None,
    rest_frame: int = 0,
    joints: Any = None,
    weights: Any = None,
    locked_vertices: Any = None,
    transforms: Any = None,
    locked_bones: Any = None,
    smoothness: float = 0.0,
    vertex_importance: Any = None,
    frame_importance: Any = None,
    tolerance: float | str | None = None,
    tolerance_of: Measure = "rmse",
) -> Decomposition:
    """Find a rest pose, sparse convex skin weights and bones for an animated mesh.

    Minimises Σ_t Σ_i |v_i^t − Σ_j w_ij (R_j^t p_i + T_j^t)|² over rest pose p,
    weights w (w >= 0, Σ_j w_ij = 1, at most K of them a vertex) and bones (R, T),
    rigid unless `bone_model` says otherwise.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
        A list holds several shots of one mesh: they share rest pose and weights.
        Arrays may be memory maps, zarr or dask arrays: what is too large to be held
        at once is read by chunks, on the workers of a Dask client where one is active.
    faces : (T, 3) int array, optional
        With plain arrays.
    bones : int
        1 to V; the result has exactly as many.  With a tolerance the most it may
        have, by default 256 or V.
    influences : int
        Most bones a vertex (K).
    effort : {"fast", "balanced", "best"}
        Place on the curve of speed against accuracy.
    bone_model : {"rigid", "similarity", "affine"}
        What a bone may do: turn and move, also grow and shrink uniformly, or
        stretch and shear as well (det > 0 always).
    rng : int or numpy.random.Generator
        Same seed, same bits, whatever the number of threads.
    max_iterations : int, optional
        Alternations and polish steps after which the best model so far is returned;
        at least one model is always made.
    time_limit : float, optional
        Seconds of this call, compilation left out, after which the best model so
        far is returned; at least one model is always made.
    callback : callable, optional
        Called with a :class:`Progress` after every step; returning True stops.
        A walk over streamed frames is finished first.
    resume : SolverState or path, optional
        State of an earlier call with the same input and arguments.
    checkpoint : path, optional
        An ``.npz`` to which the state is saved about every minute, after each pass
        over frames that are streamed, and at the end (with a tolerance at the end
        only): what `resume` takes up after the process was killed.
    rest : (V, 3) array, optional
        A rest pose to keep.
    rest_frame : int
        Frame at which the rest pose starts, where it is not given.
    joints, weights : (V, K) arrays, optional
        Weights to start from; kept at `locked_vertices`, everywhere by default.
    locked_vertices : mask or indices, optional
    transforms : (F, B0, 3, 4) array, optional
        Bones to start from, B0 <= `bones`, such as a skeleton read from a file;
        `locked_bones` of them are kept, all by default.
    locked_bones : mask or indices, optional
    smoothness : float
        Length in the mesh's units: a jump of 1 in a weight across an edge costs as
        much as this distance in every frame at one vertex.  0: off.  Where it is
        on, `history` holds the error without penalty.
    vertex_importance : (V,) array, optional
        Non-negative; scales each vertex's squared error in the objective.  Beside
        a tolerance, which bounds the plain error, at least 1e-4 of the largest.
    frame_importance : (F,) array, optional
        Positive; likewise for frames.  Less than 1e-4 of the largest counts as that.
    tolerance : float or str, optional
        Error to put up with, in the mesh's units or as ``"0.5%"`` of the diagonal:
        the model of fewest bones, then of fewest bytes, that holds it is looked
        for, and `parsimony` of the result says what was left out and what that
        cost.  Not beside weights or transforms handed over, nor `smoothness`.
    tolerance_of : {"rmse", "max"}
        Whether it bounds the pooled RMSE or every vertex in every frame.  Only
        beside a tolerance.

    Returns
    -------
    Decomposition

    Raises
    ------
    InputError
        If an argument is not usable; nothing has been computed by then.
    Cancelled
        If the callback stopped the run before there was any model.

    Warns
    -----
    SsdrWarning
        If some bones could go without a loss, so that fewer would do, or if no
        model holds the tolerance: the closest is returned.

    References
    ----------
    Le and Deng, "Smooth skinning decomposition with rigid bones", 2012; the
    polish is variable projection (Golub and Pereyra 1973).
    """
    sequences = as_sequences(sequence, faces)
    n = sequences[0].n_vertices
    lengths = [len(s) for s in sequences]
    n_frames = sum(lengths)
    if bones is None and tolerance is None:
        raise InputError("bones", f"an integer from 1 to {n}, or a tolerance", "None")
    bones = check_bones(min(n, MOST_BONES) if bones is None else bones, n)
    influences = check_influences(influences)
    check_choice(effort, "effort", Effort)
    bone_model = check_bone_model(bone_model)
    check_choice(tolerance_of, "tolerance_of", Measure)
    if tolerance is None and tolerance_of != "rmse":
        raise InputError("tolerance_of", "'rmse' without a tolerance", repr(tolerance_of))
    if max_iterations is not None:
        max_iterations = check_count(max_iterations, "max_iterations", "an integer >= 1 or None")
    timed = isinstance(time_limit, _REAL) and not isinstance(time_limit, bool)
    if time_limit is not None and not (timed and time_limit > 0):
        raise InputError("time_limit", "a number of seconds > 0 or None", repr(time_limit))
    if callback is not None and not callable(callback):
        raise InputError("callback", "a function of one Progress, or None", repr(callback))
    if resume is not None and not isinstance(resume, (SolverState, str, Path)):
        raise InputError(
            "resume", "a SolverState (result.state) or the path of one", type(resume).__name__
        )
    rest_frame = check_index(rest_frame, "rest_frame", n_frames)
    smoothness = check_nonnegative(smoothness, "smoothness", "a length >= 0 in the mesh's units")
    if smoothness > 0 and len(sequences[0].faces) == 0:
        raise InputError("smoothness", "0 for a mesh without faces", smoothness)
    generator = check_rng(rng)
    parts = check_parts(
        n, n_frames, bones, influences, rest, joints, weights, transforms,
        locked_vertices, locked_bones, bone_model,
    )  # fmt: skip
    importance = check_importance(vertex_importance, "vertex_importance", n)
    frame_weights = check_importance(frame_importance, "frame_importance", n_frames)
    if frame_weights is not None and not (frame_weights > 0).all():
        raise InputError("frame_importance", "numbers > 0", float(frame_weights.min()))
    if frame_weights is not None:
        frame_weights = np.maximum(frame_weights, _LEAST_FRAME)
    state = SolverState.load(resume) if isinstance(resume, (str, Path)) else resume
    saver = None if checkpoint is None else Checkpoint(checkpoint)

    if tolerance is not None:
        result = decompose_within(
            sequences, parts, tolerance=tolerance, measure=tolerance_of, bones=bones,
            influences=influences, effort=effort, bone_model=bone_model, rng=generator,
            rest_frame=rest_frame, smoothness=smoothness, importance=importance,
            frame_importance=frame_weights, max_iterations=max_iterations,
            time_limit=time_limit, callback=callback, state=state,
            ready=compile_kernels,
        )  # fmt: skip
        if saver is not None:
            saver.save(result.state)
        return result
    compile_seconds = compile_kernels()
    began = time.perf_counter()
    found = executor = None
    if needs_streaming(sequences):
        executor = executor_for(sequences)
        found = None if state is None else state.scan
        if found is None or found.alignment.n_frames != n_frames:
            found = scan(
                sequences, importance, [rest_frame], executor=executor,
                told=scan_progress(callback, began),
            )  # fmt: skip
    fixed = Fixed(
        rest=rest is not None, weights=parts.locked_vertices, bones=parts.kept_bones,
        bone_model=bone_model,
    )  # fmt: skip
    task = Task(
        sequences=sequences, bones=bones, influences=influences, effort=effort, rng=generator,
        parts=parts, fixed=fixed, rest_frame=rest_frame, smoothness=smoothness,
        importance=importance, frame_importance=frame_weights, executor=executor,
    )  # fmt: skip
    run, print_of_input = task.first(found, began)
    settings = {
        "bones": bones, "influences": influences, "effort": effort, "bone_model": bone_model,
        "rest_frame": rest_frame, "smoothness": float(smoothness),
        "max_iterations": max_iterations, "input": print_of_input, "plan": plan_print(run.plan),
    }  # fmt: skip
    if state is not None:
        check_settings(state, settings)
    more = None if found is None else found.widened(n)
    settling = more is not None and state is not None and state.settling
    if found is not None and more is not None and settling:
        run = task.second(found, more, run)
    if state is not None:
        _restore(run, state)

    def now(whole: Passes | None = None) -> SolverState:
        return _state(run, settings, found, settling, whole)

    # passes go on where they were only under a model that is not going to change
    earlier = state if run.finished and (settling or more is None) else None
    keep = None if saver is None else lambda: saver.offer(now)
    while True:
        ends = (0.0, 1.0) if found is None else share_of(settling, more is not None)
        reason = _walk(run, max_iterations, time_limit, callback, ends, keep)
        over = settling or not run.finished or reason == "cancelled"
        if found is None or more is None or over:
            break
        run, settling = task.second(found, more, run), True
    spare = _spare_bones(run)
    done = None
    model, records = best_of(run), run.records
    if found is not None:
        frames = task.all_frames(more if settling and more is not None else found, run)
        run.release()
        done = Passes(frames, earlier)
        stopped = done.finish(
            run, effort, time_limit, callback,
            None if saver is None else lambda: saver.save(now(done)),
            hurried=reason in ("cancelled", "iterations"),
        )  # fmt: skip
        reason = "cancelled" if stopped else reason
        model, records = done.best, done.records
    alignment: Alignment = run.data if found is None else found.alignment
    result = _result(
        run, alignment, model, records, sequences, now(done), reason, influences,
        compile_seconds, executor, spare,
    )  # fmt: skip
    if saver is not None:
        saver.save(result.state)
    return result


def _walk(
    run: Run,
    max_iterations: int | None,
    time_limit: float | None,
    callback: Callable[[Progress], bool | None] | None,
    ends: tuple[float, float],
    keep: Callable[[], None] | None,
) -> str:
    """Steps until the plan, a limit or the caller ends it; says why."""
    scale = run.data.scale / math.sqrt(run.data.n_frames * run.data.n_vertices)
    with serial_blas():
        while not run.finished:
            if run.best is not None:
                if max_iterations is not None and run.iteration >= max_iterations:
                    return "iterations"
                if time_limit is not None and run.here >= time_limit:
                    return "time limit"
            phase = run.phase
            run.advance()
            _logger.debug(
                "%s, iteration %d, rmse %.6g", phase, run.iteration,
                scale * math.sqrt(run.best_value),
            )  # fmt: skip
            if keep is not None:
                keep()
            if callback is None:
                continue
            fraction = ends[0] + (ends[1] - ends[0]) * run.fraction
            left = run.elapsed * (1 - fraction) / fraction if fraction > 0 else math.inf
            if time_limit is not None:
                left = min(left, max(0.0, time_limit - run.here))
            progress = Progress(
                phase=phase, iteration=run.iteration, elapsed=run.elapsed,
                rmse=scale * math.sqrt(run.best_value), fraction=fraction, time_left=left,
            )  # fmt: skip
            if callback(progress):
                if run.best is None:
                    raise Cancelled("stopped by the callback before there was any model")
                return "cancelled"
    return "converged" if run.settled else "plan finished"


def _result(
    run: Run,
    data: Alignment,
    model: Model,
    records: list[tuple[int, float, float, str]],
    sequences: list[MeshSequence],
    state: SolverState,
    reason: str,
    influences: int,
    compile_seconds: float,
    executor: Executor | None,
    spare: int,
) -> Decomposition:
    joints, weights = pad_influences(model, influences)
    if run.asked.bone_model != "rigid":
        model = model.copy()  # the state keeps its own, so that resuming goes on to the same bits
        normalise_gauge(model, run.data.importance, run.asked)
    rest, transforms = data.to_world(model.rest, model.transforms)
    squared = squared_error(sequences, rest, joints, weights, transforms, executor=executor)
    count = data.n_frames * len(rest)
    rmse = math.sqrt(float(squared.sum()) / count)
    first = sequences[0]
    skinning = Skinning(
        rest, joints, weights, transforms, faces=first.faces, fps=first.fps,
        bone_model=run.asked.bone_model, surface=first.surface, vertex_map=first.vertex_map,
        name=first.name,
    )  # fmt: skip
    values = np.array([r[2] for r in records])
    errors = data.scale * np.sqrt(np.maximum(values, 0.0) / count)
    # the reduced basis and importance change the objective, not which model is better: the
    # last record is measured on the frames, the others keep their ratio to it
    # (where what counts is exact there is no ratio: the error is of what does not count)
    last = errors[-1]
    told = last > 0 and rmse < _MOST_RATIO * last
    errors = np.maximum(errors * (rmse / last) if told else errors, rmse)
    history = tuple(
        Record(iteration=r[0], elapsed=r[1], rmse=float(e), phase=r[3])
        for r, e in zip(records, errors, strict=True)
    )
    history = (*history[:-1], dataclasses.replace(history[-1], rmse=rmse))
    notes = []
    if spare:
        notes.append(f"{spare} of {run.bones} bones could each go at no loss: fewer bones would do")
    for note in notes:
        warnings.warn(note, SsdrWarning, stacklevel=3)
    return Decomposition(
        skinning=skinning, rmse=rmse, converged=reason == "converged", stop_reason=reason,
        history=history, offsets=np.cumsum([0, *[len(s) for s in sequences]]), state=state,
        compile_seconds=compile_seconds, warnings=tuple(notes),
    )  # fmt: skip


def _spare_bones(run: Run) -> int:
    """How many bones could each go at no loss."""
    wide = best_of(run).widened()
    energy = float(run.data.importance @ run.data.x2)
    return int((bone_costs(run.data, wide) <= _NO_LOSS * energy).sum())


def _state(
    run: Run, settings: dict[str, Any], found: Scan | None, settling: bool, done: Passes | None
) -> SolverState:
    progress = run.progress() | {"settling": settling}
    return SolverState(
        settings=settings,
        progress=progress if done is None else progress | done.progress(),
        history=np.array([r[:3] for r in run.records], dtype=np.float64).reshape(-1, 3),
        phases=tuple(r[3] for r in run.records), current=run.model, best=run.best,
        scan=found, whole=None if done is None or not done.records else done.best,
    )  # fmt: skip


def _restore(run: Run, state: SolverState) -> None:
    for model in (state.current, state.best):
        check_size(model, run.data.n_vertices, run.data.n_frames)
    records = [
        (int(row[0]), float(row[1]), float(row[2]), phase)
        for row, phase in zip(state.history, state.phases, strict=True)
    ]
    with taking_up():
        run.restore(
            state.progress,
            None if state.current is None else state.current.copy(),
            None if state.best is None else state.best.copy(),
            records,
        )
