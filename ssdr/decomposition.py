"""``ssdr.decompose``: from frames to a skinned model."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .drivers.in_memory import Outcome
from .drivers.in_memory import solve as solve_in_memory
from .drivers.problem import Measure, check_problem
from .drivers.scan import needs_streaming
from .drivers.schedule import Effort, HierarchyKind
from .drivers.streamed import solve as solve_streamed
from .errors import InputError, SsdrWarning
from .parsimony.solve import SmallestModel
from .parsimony.solve import solve as solve_within_tolerance
from .result import Decomposition
from .search.progress import Callback
from .search.state import SolverState
from .sequence import MeshSequence
from .skinning import BoneModel, Skinning
from .solver.warmup import compile_kernels

__all__ = ["decompose"]


def decompose(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    bones: int | None = None,
    influences: int = 4,
    effort: Effort = "balanced",
    bone_model: BoneModel = "rigid",
    hierarchy: HierarchyKind | None = None,
    skeleton: Skinning | None = None,
    extra_bones: int | Mapping[str, int] = 0,
    locked_joints: Sequence[str] | None = None,
    rng: int | np.random.Generator = 0,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    callback: Callback | None = None,
    resume: SolverState | str | Path | None = None,
    checkpoint: str | Path | None = None,
    rest: Any = None,
    rest_frame: int = 0,
    indices: Any = None,
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
        One frame, or frames all alike, will do, since a program may cut a motion
        anywhere; the command refuses a single frame, which there is nearly always
        one file named in place of a pattern.
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
    hierarchy : {"none", "loose", "rigid"}
        Which bone hangs on which, by which point; "none" by default, "rigid" with a
        skeleton.  "loose": a tree over the bones that are found without one, whose
        joints may come apart; its parents are those of least gaps, or the skeleton's,
        where bones start.  "rigid": every
        joint is one point under the bone and its parent in every frame, so that the
        model can be posed; a root alone moves about.
    skeleton : Skinning, optional
        A rig, such as :func:`load_skinning` reads, whose parents and names are kept
        while weights, rest pose, motion and places of the joints are fitted; with
        `indices` and `weights` those are kept, with `rest` that and the joints.  If it
        moves another mesh, its joints are taken to lie in the rest frame, and its weights
        say nothing.
    extra_bones : int or mapping
        Bones more, children of the skeleton's where the error is; or how many below
        which of its bones, by name: ``{"chest": 2, "hips": 1}``.
    locked_joints : sequence of str, optional
        Joints of the skeleton, each with a parent, whose rotation relative to it stays
        what the skeleton says: in each frame, where it has as many as the sequence, or
        in its one pose.  In memory only.
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
        A pass over streamed frames is finished first.  What it writes to the
        arrays of this call has no effect; frames that are streamed must not change.
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
    indices, weights : (V, K) arrays, optional
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
        If an argument is not usable, before anything is computed; if a state to resume
        from is of another run, once the frames have been read.
    FormatError
        If a state to resume from is not one, or damaged.
    Cancelled
        If the callback stopped the run before there was any model.

    Warns
    -----
    SsdrWarning
        If some bones could go without a loss, so that fewer would do, or if no
        model holds the tolerance: the closest is returned.

    References
    ----------
    Le and Deng, "Smooth skinning decomposition with rigid bones", 2012, and, for
    joints, "Robust and accurate skeletal rigging from mesh sequences", 2014; the
    polish is variable projection (Golub and Pereyra 1973).

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.decompose(dancer, bones=8, influences=4, effort="fast")
    >>> result.skinning.n_bones, result.skinning.n_influences
    (8, 4)
    >>> result.rmse < 0.01 * dancer.diagonal()
    True
    """
    problem = check_problem(
        sequence,
        faces,
        bones=bones,
        influences=influences,
        effort=effort,
        bone_model=bone_model,
        hierarchy=hierarchy,
        skeleton=skeleton,
        extra_bones=extra_bones,
        locked_joints=locked_joints,
        rng=rng,
        max_iterations=max_iterations,
        time_limit=time_limit,
        callback=callback,
        resume=resume,
        checkpoint=checkpoint,
        rest=rest,
        rest_frame=rest_frame,
        indices=indices,
        weights=weights,
        locked_vertices=locked_vertices,
        transforms=transforms,
        locked_bones=locked_bones,
        smoothness=smoothness,
        vertex_importance=vertex_importance,
        frame_importance=frame_importance,
        tolerance=tolerance,
        tolerance_of=tolerance_of,
    )
    streamed = needs_streaming(problem.sequences)
    if streamed and problem.fixed.rotations is not None:
        raise InputError("locked_joints", "None for frames that are streamed", repr(locked_joints))
    if problem.callback is not None and not streamed:
        problem = problem.detached()
    compile_seconds = compile_kernels()
    outcome: Outcome
    if problem.tolerance is not None:
        outcome = solve_within_tolerance(problem)
    elif streamed:
        outcome = solve_streamed(problem)
    else:
        outcome = solve_in_memory(problem)
    if problem.checkpoint is not None:
        problem.checkpoint.save(outcome.state)
    for note in outcome.warnings:
        warnings.warn(note, SsdrWarning, stacklevel=2)
    return Decomposition(
        skinning=outcome.skinning,
        rmse=outcome.rmse,
        converged=outcome.stop_reason in ("converged", "tolerance held"),
        stop_reason=outcome.stop_reason,
        history=outcome.history,
        offsets=problem.offsets,
        state=outcome.state,
        compile_seconds=compile_seconds,
        warnings=outcome.warnings,
        parsimony=outcome.parsimony if isinstance(outcome, SmallestModel) else None,
    )
