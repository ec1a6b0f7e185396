"""Start of bones and weights from motion, usable alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.checks import (
    BoneModel,
    check_bone_model,
    check_floats,
    check_influences,
    check_rng,
    check_squarable,
    check_whole,
)
from ..mesh.clips import names_of
from ..mesh.sequence import MeshSequence, as_sequences
from ..model.drawn_normals import with_fitted_normals
from ..model.skinning import Skinning
from ..solver.alternation import vertex_step
from ..solver.initialization import start_model
from ..solver.model import Constraints, Model
from ..solver.trajectories import Trajectories, gather


def initialize(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    bones: int,
    influences: int = 4,
    bone_model: BoneModel = "rigid",
    rest: Any = None,
    rng: int | np.random.Generator = 0,
) -> Skinning:
    """Make bones and weights to start from, by motion alone.

    For each requested bone, farthest-point sampling of the trajectories finds eight patches of
    vertices, and each patch is fitted by Kabsch in every frame.  Let E_ij be the squared error of
    vertex i if it moves with patch j.  The bones are patches chosen one by one, each to lower
    Σ_i min_j E_ij most (greedy facility location), and refitted to the vertices that they fit best.
    The weights are then solved once.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    faces : (T, 3) int array, optional
        Triangles, if `sequence` is a plain array.  They have no effect on bones and weights, so
        that separate components and point clouds may be used as well.
    bones : int
        Number of bones, from 1 to V.
    influences : int
        Most influences per vertex.
    bone_model : {"rigid", "similarity", "affine"}
    rest : (V, 3) array, optional
        A rest pose to keep; by default it is solved for, starting with the first frame.
    rng : int or numpy.random.Generator

    Returns
    -------
    Skinning

    Raises
    ------
    InputError
        If an argument is not usable.

    References
    ----------
    Le and Deng 2012, section 3.1, for the alternation of assignment and Kabsch;
    the choice among patches is greedy facility location (Cornuéjols et al. 1977).

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.initialize(dancer, bones=4)
    >>> start.n_bones, start.weights.shape
    (4, (799, 4))
    """
    sequences = as_sequences(sequence, faces)
    bone_model = check_bone_model(bone_model)
    data, model, constraints = started(
        sequences, bones=bones, influences=influences, bone_model=bone_model, rest=rest, rng=rng
    )
    return fitted_skinning(sequences, data, model, constraints)


def started(
    sequences: list[MeshSequence],
    *,
    bones: int,
    influences: int,
    rest: Any,
    rng: int | np.random.Generator,
    bone_model: BoneModel = "rigid",
) -> tuple[Trajectories, Model, Constraints]:
    """Check the arguments of :func:`initialize`; return frames, start, and its locked parts.

    Frames and start are in the solver's space.
    """
    n = sequences[0].n_vertices
    bones = check_whole(bones, "bones", 1, n, " (the number of vertices)")
    k = check_influences(influences)
    generator = check_rng(rng)
    inner_rest = None
    if rest is not None:
        inner_rest = check_floats(rest, "rest", (n, 3), copy=True).astype(np.float64)
        check_squarable(inner_rest, "rest")
    data = gather(sequences, bones=bones)
    start = (
        data.frame(0)
        if inner_rest is None
        else data.alignment.points_from_world(inner_rest, "rest")
    )
    model = start_model(data, start, bones, min(k, bones), generator, bone_model)
    constraints = Constraints(lock_rest=rest is not None, bone_model=bone_model)
    vertex_step(data, model, constraints=constraints)
    return data, model, constraints


def fitted_skinning(
    sequences: list[MeshSequence], data: Trajectories, model: Model, constraints: Constraints
) -> Skinning:
    """Convert a model of the solver to a skinning in the space of the sequences."""
    rest, transforms = data.alignment.to_world(model.rest, model.transforms)
    found = Skinning(
        rest,
        model.indices,
        model.weights,
        transforms,
        faces=sequences[0].faces,
        bone_model=constraints.bone_model,
        **names_of(sequences),
    )
    return with_fitted_normals(sequences, found)
