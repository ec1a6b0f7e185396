"""``ssdr.decompose``: from frames to a skinned model of a given number of bones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .common.checks import BoneModel, names_arguments
from .mesh.sequence import MeshSequence
from .model.skinning import Skinning
from .model.start import Kept, Skeleton
from .search.check_problem import check_problem
from .search.problem import Effort
from .search.progress import Callback
from .search.result import Decomposition
from .search.solve import finished, solve
from .solver.rest_surface import RestPose


@names_arguments
def decompose(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    bones: int | None = None,
    influences: int = 4,
    effort: Effort = "balanced",
    bone_model: BoneModel = "rigid",
    rig: str | Skeleton | None = None,
    start: Skinning | Decomposition | Kept | None = None,
    vertex_importance: Any = None,
    frame_importance: Any = None,
    smoothness: float = 0.0,
    rest_pose: RestPose = "surface",
    rest_frame: int | None = None,
    normals: bool | float | str = True,
    rng: int | np.random.Generator = 0,
    time_limit: float | None = None,
    checkpoint: str | Path | None = None,
    callback: Callback | None = None,
) -> Decomposition:
    """Find a rest pose, sparse convex skin weights and bones for an animated mesh.

    Minimises Σ_t Σ_i |v_i^t − Σ_j w_ij (R_j^t p_i + T_j^t)|² over rest pose p,
    weights w (w >= 0, Σ_j w_ij = 1, at most K of them per vertex) and bones (R, T),
    rigid unless `bone_model` says otherwise; by default with factors that keep the rest pose a
    surface (`rest_pose`) and fit the normals (`normals`).

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
        A list holds several shots of one mesh: they share rest pose and weights.
        A single frame is allowed.  Arrays may be memory maps, zarr or dask arrays.  Those that
        are too large for memory are read in chunks, on the workers of a Dask client if one is
        active.  They must not change during the call.
    faces : (T, 3) int array, optional
        Triangles, if `sequence` is an array.
    bones : int
        Number of bones of the result, 1 to V.  Can be omitted if a skeleton or a model to start
        from determines it.
    influences : int
        Largest number of bones that move a vertex (K).
    effort : {"fast", "balanced", "best"}
        Trade-off between speed and accuracy.
    bone_model : {"rigid", "similarity", "affine"}
        Transforms that a bone may have.  "rigid": rotation and translation.  "similarity": also
        uniform scale.  "affine": also stretch and shear.  No bone may mirror (det > 0).
    rig : {"loose", "rigid"} or Skeleton, optional
        By default bones have no hierarchy.  "rigid": each bone except roots is attached to its
        parent at a joint, which both move to the same point in every frame, so that the model can
        be posed; only roots translate freely.  "loose": bones are found without a hierarchy and
        then connected by the tree with the smallest gaps, so that joints may come apart.  The
        bones, parents and names of a :class:`Skeleton` are kept.
    start : Skinning, Decomposition or Kept, optional
        A model to start from, such as a checkpoint: the error of the result is never above that of
        this model nor, if neither `rig` nor `smoothness` is given, above that of the same call
        without `start`; but more if `normals` is a length.  If its frames differ from those of
        `sequence`, bones for the latter are fitted to its weights.  Of a :class:`Kept`, rest pose
        or weights are kept.
    vertex_importance : (V,) array, optional
        Non-negative; scales each vertex's squared error in the objective.
    frame_importance : (F,) array, optional
        Positive; scales each frame's squared error.  Values below 1e-4 of the largest are raised
        to that.
    smoothness : float
        Smoothness of the weights, as a length in the mesh's units.  A difference of 1 in a weight
        between the ends of an edge costs as much as an error of this length at one vertex in every
        frame.  0: no such cost.
    rest_pose : {"surface", "free"}
        Whether the rest pose resembles one of the frames ("surface") or only has the least error
        ("free").  On a surface, weights can be painted and cloth bound, and every program lights it
        well; a free rest pose is a crumpled mesh.
    rest_frame : int, optional
        Index of the frame from which the solve of the rest pose starts, and whose surface the
        result resembles.  By default the frame whose edges are nearest to the mean edges of all
        frames, or the first for ``rest_pose="free"``.
    normals : bool, float or str
        Whether the last steps also fit the normals that engines draw (the rest normals, transformed
        by the bones) to those of the animation, or the error of positions that is not seen beside
        them: a length in the mesh's units, or a share of the diagonal such as ``"0.05%"``.  An RMSE
        far below it counts for nothing, so that normals are better at a larger error.  With True it
        is 0; or 0.01 % of the diagonal, if a model has less error than that, but normals more than
        10° off.  If False, normals are fitted only after the model is found.
    rng : int or numpy.random.Generator
        Seed: the same seed gives the same bits, whatever the number of threads.
    time_limit : float, optional
        Seconds of this call, without compilation, after which the best model so
        far is returned; at least one model is always made.
    checkpoint : path, optional
        An ``.npz`` file to which the best model so far is written every minute and at the end,
        complete or not at all.  It is an ordinary model, which `start` and every command accept.
        While frames are streamed, it has only the frames that have been read.
    callback : callable, optional
        Called with a :class:`Progress` after every step; the run stops if it returns True, with
        the best model so far, whose rest pose may still have folds.  An exception that it raises,
        like a KeyboardInterrupt, ends the call without a result, but for the checkpoint.

    Returns
    -------
    Decomposition

    Raises
    ------
    InputError
        If an argument is not usable, before anything is computed.
    Cancelled
        If the callback stopped the run before there was any model.

    Warns
    -----
    SsdrWarning
        If some bones could be removed without raising the error.

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
        rig=rig,
        start=start,
        vertex_importance=vertex_importance,
        frame_importance=frame_importance,
        smoothness=smoothness,
        rest_pose=rest_pose,
        rest_frame=rest_frame,
        normals=normals,
        rng=rng,
        time_limit=time_limit,
        checkpoint=checkpoint,
        callback=callback,
    )
    return finished(problem, solve)
