"""``ssdr.round_weights``: skin weights of 8 or 16 bits, and a model refitted to them."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

from .errors import check_choice
from .problem.answer import with_normals
from .problem.check import check_problem
from .result import Decomposition
from .search.descent import Descent
from .search.solve import solve
from .search.starts import start_from_model
from .search.steps import compress, unfold
from .sequence import MeshSequence
from .skinning import Skinning, check_skinning
from .solver.warmup import compile_kernels
from .start import Skeleton

_CHANGED = ("rest", "indices", "weights", "transforms", "joint_positions")
_RIGID = 1e-4  # largest gap of a rigid joint in single precision, relative to the mesh's size


def round_weights(
    sequence: MeshSequence | Any,
    skinning: Skinning,
    *,
    storage: Literal["uint8", "uint16"] = "uint8",
) -> Decomposition:
    """Round the weights of a copy of a model for a file, and solve its rest pose and bones again.

    This is the last step of :func:`decompose` with ``influences=(K, storage)``, for an existing
    model.  Weights become multiples of 1/255 ("uint8") or 1/65535 ("uint16") that sum to 1, which
    writers keep exactly.  Then rest pose, bones and, step by step, weights are solved alternately.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
        Animation that the model reproduces, with as many frames as the model.  It is held in
        memory.
    skinning : Skinning
        The model.  Number of bones, hierarchy and names are kept; every frame becomes a key.
    storage : {"uint8", "uint16"}

    Returns
    -------
    Decomposition

    Raises
    ------
    InputError
        If an argument is not usable.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> model = ssdr.decompose(dancer, bones=8, effort="fast").skinning
    >>> units = 255 * ssdr.round_weights(dancer, model).skinning.weights
    >>> np.allclose(units, units.round())
    True
    """
    skinning = check_skinning(skinning)
    check_choice(storage, "storage", Literal["uint8", "uint16"])
    rig = None
    if skinning.parents is not None:
        size = float(np.ptp(skinning.rest, axis=0).max() or 1.0)
        rigid = bool(skinning.joint_gaps().max() <= _RIGID * size)
        rig = Skeleton(skinning, joints="rigid" if rigid else "loose")
    problem = check_problem(
        sequence,
        None,
        influences=(skinning.n_influences, storage),
        bones=None,
        effort="best",
        bone_model=skinning.bone_model,
        rig=rig,
        start=skinning,
        rng=0,
    )
    compile_seconds = compile_kernels()
    outcome = solve(problem, _begin)
    found = {name: getattr(outcome.skinning, name) for name in _CHANGED}
    rounded = dataclasses.replace(skinning, **found, keyframes=None)
    rounded, normals = with_normals(problem, rounded)
    return dataclasses.replace(
        outcome, skinning=rounded, normals=normals, compile_seconds=compile_seconds, warnings=()
    )


def _begin(d: Descent) -> None:
    start_from_model(d)
    compress(d)
    unfold(d)
