"""``ssdr.smallest``: the smallest model of an animated mesh that holds a tolerance."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..common.checks import BoneModel, check_whole, names_arguments, parse_tolerance
from ..common.errors import InputError, check_choice
from ..mesh.sequence import MeshSequence
from ..model.skinning import Skinning, skinning_in
from ..model.start import Kept, Skeleton
from ..search.check_problem import check_problem, refuse_weights
from ..search.problem import Effort, Problem
from ..search.progress import Callback
from ..search.result import Decomposition
from ..search.solve import finished
from ..solver.rest_surface import RestPose
from .find_smallest import find_smallest
from .report import Measure, Smallest

_MOST_BONES = 256  # by default, so that the index of a bone fits into 8 bits
# Least importance of a vertex, relative to the largest: a solver that ignores a vertex cannot bound
# its error.
_LEAST_VERTEX = 1e-4


@names_arguments
def smallest(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    tolerance: float | str,
    measure: Measure = "rmse",
    bones: int | None = None,
    influences: int = 4,
    effort: Effort = "balanced",
    bone_model: BoneModel = "rigid",
    rig: str | None = None,
    start: Skinning | Decomposition | Kept | None = None,
    vertex_importance: Any = None,
    frame_importance: Any = None,
    rest_pose: RestPose = "surface",
    rest_frame: int | None = None,
    normals: bool | float | str = True,
    rng: int | np.random.Generator = 0,
    time_limit: float | None = None,
    checkpoint: str | Path | None = None,
    callback: Callback | None = None,
) -> Smallest:
    """Find the smallest model of an animated mesh that holds a tolerance.

    The result has the fewest bones found that hold the tolerance.  Then influences and keyframes
    are dropped as far as the tolerance allows, which saves bytes.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
        As in :func:`decompose`.  If the frames do not fit into memory, those that differ most are
        solved, and the tolerance is verified on all frames.
    faces : (T, 3) int array, optional
        Triangles, if `sequence` is a plain array.
    tolerance : float or str
        Positive: a length in the mesh's units, or a share of the diagonal such as ``"0.5%"``.  The
        diagonal is that of the bounding box in the frame where it is largest.
    measure : {"rmse", "max"}
        Error that the tolerance bounds: the root mean square sqrt(Σ|d|² / (F V)) of the distances d
        between model and input over F frames and V vertices, or the largest of these distances.
        The solver minimises squares, so that "max" takes more bones than necessary.
    bones : int, optional
        Largest number of bones; by default 256, or the number of vertices if that is less.
    influences : int
        Largest number of bones that move a vertex (K).
    effort : {"fast", "balanced", "best"}
        Work spent on each number of bones before it is given up.
    bone_model : {"rigid", "similarity", "affine"}
        As in :func:`decompose`.
    rig : {"loose", "rigid"}, optional
        As in :func:`decompose`; a skeleton cannot be kept.
    start : Skinning, Decomposition or Kept, optional
        A model to begin from, such as a checkpoint, with at most `bones` bones: if it holds the
        tolerance, the result is no larger.  A :class:`Kept` may give a rest pose only.
    vertex_importance : (V,) array, optional
        Guides the solver as in :func:`decompose`.  Each value must be at least 1e-4 of the largest,
        since the tolerance bounds the error without importance.
    frame_importance : (F,) array, optional
        Positive; guides the solver as in :func:`decompose`.
    rest_pose : {"surface", "free"}
    rest_frame : int, optional
        Both as in :func:`decompose`.
    normals : bool, float or str
        As in :func:`decompose`.  The last steps solve normals only if the result then holds the
        tolerance and takes at most 3 % more bytes.
    rng : int or numpy.random.Generator
        The same seed gives the same bits, whatever the number of threads.
    time_limit : float, optional
        Most seconds for this call, without compilation.  When they are over, the smallest model so
        far that holds the tolerance is returned without pruning; if none does, the model of least
        error.
    checkpoint : path, optional
        As in :func:`decompose`; holds the smallest model so far that holds the tolerance.
    callback : callable, optional
        Called with a :class:`Progress` after every step; if it returns True, the search ends as at
        the time limit.  `Progress.rmse` is the error, by `measure`, of the smallest model so far
        that holds the tolerance; inf if none does.

    Returns
    -------
    Smallest
        A :class:`Decomposition` with `parsimony`, the report of the search.  `stop_reason` is
        "tolerance held", "tolerance out of reach", "time limit" or "cancelled".

    Raises
    ------
    InputError
        If an argument is not usable, before anything is computed.
    Cancelled
        If the callback stopped the search before there was a model.

    Warns
    -----
    SsdrWarning
        If the result does not hold the tolerance.

    References
    ----------
    Lower bound: Eckart and Young, "The approximation of one matrix by another of lower rank",
    1936.  Bytes: Everett, "Generalized Lagrange multiplier method", 1963.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.smallest(dancer, tolerance="1%", effort="fast")
    >>> result.rmse <= 0.01 * dancer.diagonal(), result.stop_reason
    (True, 'tolerance held')
    """
    continues = isinstance(skinning_in(start), Skinning)
    problem = check_problem(
        sequence,
        faces,
        bones=None if continues else bones,  # a model may have fewer
        influences=influences,
        effort=effort,
        bone_model=bone_model,
        rig=rig,
        start=start,
        vertex_importance=vertex_importance,
        frame_importance=frame_importance,
        rest_pose=rest_pose,
        rest_frame=rest_frame,
        normals=normals,
        rng=rng,
        time_limit=time_limit,
        checkpoint=checkpoint,
        callback=callback,
        most_bones=None if continues else _MOST_BONES,
    )
    most = problem.bones
    if continues:
        most = min(problem.n_vertices, _MOST_BONES) if bones is None else bones
        n = problem.inputs[0].n_vertices
        most = check_whole(most, "bones", 1, n, " (the number of vertices)")
    check_choice(measure, "measure", Measure)
    parse_tolerance(tolerance, 1.0)
    _check_beside_tolerance(problem, rig, most)
    length = parse_tolerance(tolerance, max(s.diagonal() for s in problem.inputs))
    # a joint that the motion does not determine need not lie near the skin: there is no penalty
    constraints = dataclasses.replace(problem.constraints, near_skin=False)
    sought = dataclasses.replace(problem, bones=most, constraints=constraints)
    return finished(sought, partial(find_smallest, asked=length, measure=measure))


def _check_beside_tolerance(problem: Problem, rig: Any, most: int) -> None:
    """Raise InputError for arguments that cannot be combined with a tolerance."""
    if isinstance(rig, Skeleton):
        raise InputError("rig", "None, 'loose' or 'rigid' beside a tolerance", "a Skeleton")
    if problem.start is None:
        refuse_weights(problem.initial, "beside a tolerance")
    elif problem.start.n_bones > most:
        raise InputError("start", f"at most {most} bones", problem.start.n_bones)
    importance = problem.vertex_importance if problem.weighted else None
    if importance is not None and importance.min() < _LEAST_VERTEX:
        raise InputError(
            "vertex_importance",
            f"numbers > 0 (at least {_LEAST_VERTEX:g} of the largest) beside a tolerance, "
            "which bounds the plain error",
            f"{importance.min():.3g} of the largest",
        )
