"""A checked call of ``decompose``: what every driver solves, and the frames it is solved on."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..checks import (
    as_sequences,
    check_bone_model,
    check_bones,
    check_count,
    check_importance,
    check_index,
    check_influences,
    check_nonnegative,
    check_rng,
    parse_tolerance,
)
from ..errors import InputError, check_choice, is_real, is_whole
from ..frames.digest import Digests, digests_of
from ..search.prescribed import Prescribed, check_prescribed, single_joint
from ..search.progress import Callback
from ..search.state import Checkpoint, SolverState
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.model import Fixed
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Array, Trajectories, gather
from .schedule import Effort, HierarchyKind

__all__ = ["MOST_BONES", "Measure", "Problem", "check_problem"]

Measure = Literal["rmse", "max"]

MOST_BONES = 256  # of a tolerance, unless more are asked for: what an index of 8 bits tells apart
# Importance relative to the largest.  Of a frame: with less, the steps of all bones together
# would not notice what its own bones do.  Of a vertex, beside a tolerance: what counts for less
# is held by no search.
_LEAST_FRAME = 1e-4
_LEAST_VERTEX = 1e-4


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """A call of ``decompose`` whose arguments have been checked.

    Attributes
    ----------
    sequences : list of MeshSequence
        Shots of one mesh.
    bones, influences : int
    effort : {"fast", "balanced", "best"}
    fixed : Fixed
        What stays as it is, and what bones may do.
    hierarchy : {"none", "loose", "rigid"}
    names : tuple of str
        Of the bones of a skeleton that was handed over.
    rng : numpy.random.Generator
    prescribed : Prescribed
        In the input's space, of all frames.
    smoothness : float
        In the mesh's units.
    vertex_importance : (V,) array or None
    frame_importance : (F,) array or None
    tolerance : float, str or None
        As :func:`~ssdr.checks.parse_tolerance` reads it.
    tolerance_of : {"rmse", "max"}
    max_iterations : int or None
    time_limit : float or None
        Seconds.
    callback : callable or None
    resume : SolverState or None
    checkpoint : Checkpoint or None
    """

    sequences: list[MeshSequence]
    bones: int
    influences: int
    effort: Effort
    fixed: Fixed
    hierarchy: HierarchyKind
    names: tuple[str, ...]
    rng: np.random.Generator
    prescribed: Prescribed
    smoothness: float
    vertex_importance: Array | None
    frame_importance: Array | None
    tolerance: float | str | None
    tolerance_of: Measure
    max_iterations: int | None
    time_limit: float | None
    callback: Callback | None
    resume: SolverState | None
    checkpoint: Checkpoint | None

    def detached(self) -> Problem:
        """With arrays of its own, so that nothing that the caller writes to changes the result."""
        return dataclasses.replace(self, sequences=[_copied(s) for s in self.sequences])

    @property
    def n_frames(self) -> int:
        return sum(len(s) for s in self.sequences)

    @property
    def n_vertices(self) -> int:
        return self.sequences[0].n_vertices

    @property
    def offsets(self) -> NDArray[np.int64]:
        """(S + 1,) first frame of each shot, and the number of frames."""
        return np.cumsum([0, *[len(s) for s in self.sequences]])

    def gather(
        self,
        sequences: Sequence[MeshSequence],
        frame_importance: Array | None,
        *,
        compress: bool = False,
    ) -> Trajectories:
        """Frames as the solver sees them: all of them, or those that a driver has chosen."""
        return gather(
            sequences,
            bones=self.bones,
            vertex_importance=self.vertex_importance,
            frame_importance=frame_importance,
            compress=compress,
        )

    def smoothness_of(self, data: Trajectories) -> WeightSmoothness | None:
        """The penalty on the weights, where there is one."""
        return WeightSmoothness.build(data, self.sequences[0].faces, self.smoothness)

    def fingerprint(self, data: Trajectories, digests: Digests | None = None) -> str:
        """Tells another input from the one that a state belongs to.

        `digests` are those of all frames where a walk has made them already.
        """
        p = self.prescribed
        if digests is None:
            digests = digests_of(self.sequences)
        arrays: list[Any] = [digests, data.importance, data.frame_scale, self.sequences[0].faces]
        arrays += [p.rest, p.indices, p.weights, p.transforms, p.locked_vertices, p.locked_bones]
        if p.skeleton is not None:
            arrays += [p.skeleton.parents, p.skeleton.points, p.start, p.label, *(p.skin or ())]
        if p.turns is not None:
            arrays.append(p.turns)
        if max(p.sprouts, default=-1) >= 0:
            arrays.append(np.array(p.sprouts))
        digest = hashlib.sha256()
        for array in arrays:
            if array is not None:
                digest.update(str(np.shape(array)).encode())
                digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def settings(self, **more: Any) -> dict[str, Any]:
        """What a state has to agree with, so that a run may go on from it."""
        # left out where there is none: states saved before this setting was know nothing of it
        joints = {} if self.hierarchy == "none" else {"hierarchy": self.hierarchy}
        return (
            {
                "bones": self.bones,
                "influences": self.influences,
                "effort": self.effort,
                "bone_model": self.fixed.bone_model,
                "rest_frame": self.prescribed.rest_frame,
                "clips": [len(s) for s in self.sequences],
            }
            | joints
            | more
        )


def check_problem(
    sequence: Any,
    faces: Any,
    *,
    bones: Any,
    influences: Any,
    effort: Any,
    bone_model: Any,
    hierarchy: Any,
    skeleton: Any,
    extra_bones: Any,
    locked_joints: Any,
    rng: Any,
    max_iterations: Any,
    time_limit: Any,
    callback: Any,
    resume: Any,
    checkpoint: Any,
    rest: Any,
    rest_frame: Any,
    indices: Any,
    weights: Any,
    locked_vertices: Any,
    transforms: Any,
    locked_bones: Any,
    smoothness: Any,
    vertex_importance: Any,
    frame_importance: Any,
    tolerance: Any,
    tolerance_of: Any,
) -> Problem:
    """Check every argument of ``decompose``.

    Raises
    ------
    InputError, FormatError
        Before anything has been computed.
    """
    sequences = as_sequences(sequence, faces)
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    hierarchy = ("none" if skeleton is None else "rigid") if hierarchy is None else hierarchy
    sprouts: tuple[int, ...] = ()
    if skeleton is not None:
        sprouts = _check_skeleton(skeleton, extra_bones, hierarchy, indices)
        count = skeleton.n_bones + len(sprouts)
        if bones is not None and bones != count:
            raise InputError("bones", f"{count}, as the skeleton has, or None", repr(bones))
        bones = count
    elif extra_bones != 0:
        raise InputError("extra_bones", "0 without a skeleton", repr(extra_bones))
    if bones is None and tolerance is None:
        raise InputError("bones", f"an integer from 1 to {n}, or a tolerance", "None")
    bones = check_bones(min(n, MOST_BONES) if bones is None else bones, n)
    influences = check_influences(influences)
    check_choice(effort, "effort", Effort)
    bone_model = check_bone_model(bone_model)
    check_choice(hierarchy, "hierarchy", HierarchyKind)
    check_choice(tolerance_of, "tolerance_of", Measure)
    if max_iterations is not None:
        max_iterations = check_count(max_iterations, "max_iterations", "an integer >= 1 or None")
    _check_time_limit(time_limit)
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
    prescribed = check_prescribed(
        (n_frames, n, bones, influences),
        bone_model,
        rest=rest,
        rest_frame=rest_frame,
        indices=indices,
        weights=weights,
        transforms=transforms,
        locked_vertices=locked_vertices,
        locked_bones=locked_bones,
        skeleton=skeleton,
        sprouts=sprouts,
        locked_joints=locked_joints,
        start=None if skeleton is None else _frame(sequences, rest_frame),
    )
    vertex_importance = check_importance(vertex_importance, "vertex_importance", n)
    frame_importance = check_importance(frame_importance, "frame_importance", n_frames)
    if frame_importance is not None and not (frame_importance > 0).all():
        raise InputError("frame_importance", "numbers > 0", float(frame_importance.min()))
    if frame_importance is not None:
        frame_importance = np.maximum(frame_importance, _LEAST_FRAME)
    fixed = Fixed(
        rest=rest is not None,
        weights=prescribed.locked_vertices,
        bones=prescribed.fixed_bones,
        bone_model=bone_model,
        joints=skeleton is not None and rest is not None,
        near_skin=hierarchy == "rigid" and skeleton is None,
        rotations=prescribed.turns,
    )
    problem = Problem(
        sequences=sequences,
        bones=bones,
        influences=influences,
        effort=effort,
        fixed=fixed,
        hierarchy=hierarchy,
        names=() if skeleton is None else skeleton.joint_names,
        rng=generator,
        prescribed=prescribed,
        smoothness=float(smoothness),
        vertex_importance=vertex_importance,
        frame_importance=frame_importance,
        tolerance=tolerance,
        tolerance_of=tolerance_of,
        max_iterations=max_iterations,
        time_limit=time_limit,
        callback=callback,
        resume=SolverState.load(resume) if isinstance(resume, (str, Path)) else resume,
        checkpoint=None if checkpoint is None else Checkpoint(checkpoint),
    )
    _check_tolerance(problem)
    _check_hierarchy(problem)
    return problem


def _copied(sequence: MeshSequence) -> MeshSequence:
    vertices, surface = sequence.vertices, sequence.surface
    if isinstance(vertices, np.ndarray) and not isinstance(vertices, np.memmap):
        vertices = vertices.copy()
    if surface is not None:
        arrays = ("uv", "normals", "material_index")
        there = {name: getattr(surface, name) for name in arrays}
        surface = dataclasses.replace(
            surface, **{name: a.copy() for name, a in there.items() if a is not None}
        )
    return dataclasses.replace(
        sequence,
        vertices=vertices,
        faces=sequence.faces.copy(),
        surface=surface,
        vertex_map=None if sequence.vertex_map is None else sequence.vertex_map.copy(),
        validate=False,
    )


def _check_tolerance(problem: Problem) -> None:
    """Whether what is asked for goes together with a tolerance, or without one."""
    if problem.tolerance is None:
        if problem.tolerance_of != "rmse":
            raise InputError(
                "tolerance_of", "'rmse' without a tolerance", repr(problem.tolerance_of)
            )
        return
    for name in ("weights", "transforms"):
        if getattr(problem.prescribed, name) is not None:
            raise InputError(name, "None beside a tolerance", "an array")
    if problem.smoothness > 0:
        raise InputError("smoothness", "0 beside a tolerance", "more")
    parse_tolerance(problem.tolerance, 1.0)
    importance = problem.vertex_importance
    if importance is not None and importance.min() < _LEAST_VERTEX:
        raise InputError(
            "vertex_importance",
            f"numbers > 0 (at least {_LEAST_VERTEX:g} of the largest) beside a tolerance, "
            "which bounds the plain error",
            f"{importance.min():.3g} of the largest",
        )


def _check_skeleton(
    skeleton: Any, extra_bones: Any, hierarchy: Any, indices: Any
) -> tuple[int, ...]:
    """The parents of the bones that a skeleton gets more; −1: where the error is."""
    if not isinstance(skeleton, Skinning):
        raise InputError("skeleton", "a Skinning with a hierarchy", type(skeleton).__name__)
    sprouts: list[int] = []
    for name, more in extra_bones.items() if isinstance(extra_bones, Mapping) else ():
        sprouts += [single_joint(skeleton, name, "extra_bones")] * _extra(more)
    if not isinstance(extra_bones, Mapping):
        sprouts = [-1] * _extra(extra_bones)
    if hierarchy == "none":
        raise InputError("hierarchy", "'rigid' or 'loose' beside a skeleton", repr(hierarchy))
    if hierarchy == "loose" and sprouts:
        raise InputError("extra_bones", "0 beside hierarchy='loose'", extra_bones)
    if indices is not None and sprouts:
        raise InputError("extra_bones", "0 beside indices and weights", extra_bones)
    return tuple(sprouts)


def _extra(count: Any) -> int:
    if not is_whole(count) or count < 0:
        raise InputError("extra_bones", "an integer >= 0, or some by name", repr(count))
    return int(count)


def _frame(sequences: list[MeshSequence], index: int) -> Array:
    """One frame of the shots, counted through all of them."""
    for sequence in sequences:
        if index < len(sequence):
            return np.asarray(sequence.vertices[index], dtype=np.float64)
        index -= len(sequence)
    raise AssertionError


def _check_hierarchy(problem: Problem) -> None:
    """Whether what is asked for goes together with bones that hang on joints."""
    if problem.hierarchy == "none":
        return
    beside = f"beside hierarchy={problem.hierarchy!r}"
    if problem.fixed.bone_model != "rigid":
        raise InputError("bone_model", f"'rigid' {beside}", repr(problem.fixed.bone_model))
    if problem.tolerance is not None and problem.prescribed.skeleton is not None:
        raise InputError("tolerance", "None beside a skeleton", repr(problem.tolerance))
    if problem.hierarchy == "loose" and problem.prescribed.turns is not None:
        raise InputError("locked_joints", "None beside hierarchy='loose'", "some")
    if problem.hierarchy == "loose" and problem.prescribed.skeleton is None:
        return
    for name in ("weights", "transforms") if problem.prescribed.skeleton is None else ():
        if getattr(problem.prescribed, name) is not None:
            raise InputError(name, f"None {beside}", "an array")
    if problem.smoothness > 0:
        raise InputError("smoothness", f"0 {beside}", problem.smoothness)


def _check_time_limit(seconds: Any) -> None:
    if seconds is not None and not (is_real(seconds, finite=False) and seconds > 0):
        raise InputError("time_limit", "a number of seconds > 0 or None", repr(seconds))
