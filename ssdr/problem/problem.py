"""Problem that a driver solves: the checked arguments of ``decompose`` or ``smallest``."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import (
    check_bone_model,
    check_callback,
    check_frame_importance,
    check_importance,
    check_influences,
    check_rng,
    check_smoothness,
    check_whole,
)
from ..errors import InputError, check_choice, check_flag, is_real, is_whole
from ..frames.executor import Executor, Local, executor_for
from ..quantisation import WeightStorage
from ..search.efforts import Effort
from ..search.schedules import RigKind
from ..sequence import MeshSequence, as_sequences, labels_of, without_copies
from ..skinning import Skinning
from ..solver.model import Locked
from ..solver.rest_surface import RestPose, RestSurface, central_frame
from ..solver.trajectories import Array, Trajectories, gather
from ..start import Skeleton, Start, as_start
from .check_start import check_skeleton, check_start, extra_parents, with_skeleton
from .checkpoint import Checkpoint
from .initial import Given
from .progress import Callback
from .scan import needs_streaming

__all__ = ["Problem", "check_problem"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """A call whose arguments have been checked.

    Attributes
    ----------
    sequences : list of MeshSequence
        Shots of one mesh, without copies of vertices.
    inputs : list of MeshSequence
        The shots as the caller gave them.
    rows : (V0,) array or None
        Vertex of `sequences` for each of `inputs`; None if no two coincide in every frame.
    bones, influences : int
    storage : {"float32", "uint16", "uint8"}
        Type in which the weights will be stored.
    effort : {"fast", "balanced", "best"}
    rig : {"none", "loose", "rigid"}
    names : tuple of str
        Names of the bones of a given skeleton.
    locked : Locked
        Parts that are kept, and the bone model.
    given : Given
        Parts that the caller gave, in the input's space and for all frames.
    start : Skinning or None
        A whole model to go on from.
    smoothness : float
        Length in the mesh's units.
    rest_pose : {"surface", "free"}
    normals : bool
        Whether normals are part of the objective.
    vertex_importance : (V,) array or None
        With copies, the sum of theirs.
    weighted : bool
        Whether the caller gave an importance.
    frame_importance : (F,) array or None
    rng : numpy.random.Generator
    time_limit : float or None
        Seconds.
    callback : callable or None
    checkpoint : Checkpoint
    """

    sequences: list[MeshSequence]
    inputs: list[MeshSequence]
    rows: NDArray[np.intp] | None
    bones: int
    influences: int
    storage: WeightStorage
    effort: Effort
    rig: RigKind
    names: tuple[str, ...]
    locked: Locked
    given: Given
    start: Skinning | None
    smoothness: float
    rest_pose: RestPose
    normals: bool
    vertex_importance: Array | None
    weighted: bool
    frame_importance: Array | None
    rng: np.random.Generator
    time_limit: float | None
    callback: Callback | None
    checkpoint: Checkpoint

    @functools.cached_property
    def executor(self) -> Executor:
        """Executor of loops over the frames: Dask workers if frames are streamed and some exist."""
        return executor_for(self.sequences) if needs_streaming(self.sequences) else Local()

    @property
    def n_frames(self) -> int:
        return sum(len(s) for s in self.sequences)

    @property
    def n_vertices(self) -> int:
        return self.sequences[0].n_vertices

    @property
    def copies(self) -> int:
        """Number of vertices of `inputs` that stand for another of theirs."""
        return self.inputs[0].n_vertices - self.n_vertices

    @property
    def offsets(self) -> NDArray[np.int64]:
        """First frame of each of the S shots, followed by the number of frames, (S + 1,)."""
        return np.cumsum([0, *[len(s) for s in self.sequences]])

    def spread(self, *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """Arrays (V, ...) of the problem's vertices for those of `inputs`."""
        return arrays if self.rows is None else tuple(array[self.rows] for array in arrays)

    def trajectories(
        self, sequences: Sequence[MeshSequence], frame_importance: Array | None
    ) -> Trajectories:
        """Trajectories, in the solver's space, of the frames of `sequences`."""
        return gather(
            sequences,
            bones=self.bones,
            vertex_importance=self.vertex_importance,
            frame_importance=frame_importance,
            compress=False,
        )

    def with_rest_surface(self, data: Trajectories, given: Given) -> tuple[Trajectories, Given]:
        """Copies of `data`, uncompressed, with what the rest pose is to resemble, and of `given`.

        That is the rest pose of `given`, of its skeleton, or else its rest frame, which is chosen
        unless the caller named it.  That of a model that is tried beside others does not count, as
        it may be a crumpled mesh.  Bones that stretch need a rest frame in which no part is without
        size, even if the rest pose is free.
        """
        keeps_to = self.rest_pose == "surface" and len(data.faces) > 0
        pose = given.tree_pose if given.rest is None or self.beside else given.rest
        chosen = keeps_to or self.locked.bone_model != "rigid"
        if pose is None and given.rest_frame is None and chosen:
            frame = central_frame(data, first=not keeps_to)
            given = dataclasses.replace(given, rest_frame=frame)
        if not keeps_to or self.locked.rest:
            return data, given
        pose = given.beside_model().first_pose(data) if pose is None else pose
        return dataclasses.replace(data, surface=RestSurface.build(data, pose)), given

    @property
    def beside(self) -> bool:
        """Whether a whole model was given that is tried beside other starts."""
        bound = self.rig == "rigid" or self.given.keeps_tree or self.smoothness > 0
        return self.given.free and not bound

    @property
    def placed(self) -> bool:
        """Whether weights or all bones are locked, so that no bone has to find its place."""
        every = self.locked.bone_mask(self.bones).all() if self.locked.bones is not None else False
        return self.given.locked_vertices is not None or bool(every)


def check_problem(
    sequence: Any,
    faces: Any,
    *,
    bones: Any,
    influences: Any,
    effort: Any,
    bone_model: Any = "rigid",
    rig: Any = None,
    start: Any = None,
    vertex_importance: Any = None,
    frame_importance: Any = None,
    smoothness: Any = 0.0,
    rest_pose: Any = "surface",
    normals: Any = True,
    rng: Any,
    time_limit: Any = None,
    checkpoint: Any = None,
    callback: Any = None,
    most_bones: int | None = None,
) -> Problem:
    """Check the arguments of ``decompose``, or of a function that offers some of them.

    With `most_bones`, `bones` may be None without a model, too: then there are that many, or as
    many as there are vertices that differ if these are fewer.

    Raises
    ------
    InputError
        If an argument is not usable, before anything is computed.
    """
    sequences = as_sequences(sequence, faces)
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    influences, storage = _check_stored(influences)
    bone_model = check_bone_model(bone_model)
    check_choice(effort, "effort", Effort)
    check_choice(rest_pose, "rest_pose", RestPose)
    start = as_start(start, n_frames)
    if not (start is None or isinstance(start, (Skinning, Start))):
        expected = "None, a Skinning or a result, a MeshSequence, a Start or the number of a frame"
        raise InputError("start", expected, type(start).__name__)
    if not (rig is None or isinstance(rig, Skeleton) or _is_kind(rig)):
        raise InputError("rig", "None, 'loose', 'rigid' or a Skeleton", repr(rig))
    by_default = bones is None and most_bones is not None
    bones = _count_bones(min(n, most_bones or n) if by_default else bones, n, rig, start)
    given, whole = check_start(start, (n_frames, n, bones, influences), bone_model)
    names: tuple[str, ...] = ()
    kind: RigKind = "none"
    if isinstance(rig, Skeleton):
        given, kind = with_skeleton(rig, given, sequences, influences, whole), rig.joints
        names = rig.skinning.names()
    elif rig is not None:
        kind = rig
    smoothness = check_smoothness(smoothness, sequences[0].faces)
    _check_rig(kind, given, bone_model, smoothness)
    if time_limit is not None and not (is_real(time_limit, finite=False) and time_limit > 0):
        raise InputError("time_limit", "a number of seconds > 0 or None", repr(time_limit))
    frame_importance = check_frame_importance(frame_importance, n_frames)
    importance = check_importance(vertex_importance, "vertex_importance", n)
    weighted = importance is not None or frame_importance is not None
    inputs, rows = sequences, None
    label = given.told_apart(labels_of(inputs))
    differ = int(label.max()) + 1
    if by_default:
        bones = min(bones, differ)
    if bones <= differ < n:
        sequences, importance, kept, rows = without_copies(inputs, label, importance)
        given = given.of_vertices(kept)
    kept_rest = given.rest is not None and not given.free
    skeleton = isinstance(rig, Skeleton)
    return Problem(
        sequences=sequences,
        inputs=inputs,
        rows=rows,
        bones=bones,
        influences=influences,
        storage=storage,
        effort=effort,
        rig=kind,
        names=names,
        locked=Locked(
            rest=kept_rest,
            weights=given.locked_vertices,
            bones=given.leading_locked_bones,
            bone_model=bone_model,
            joints=skeleton and kept_rest,
            near_skin=kind == "rigid" and not skeleton,
            rotations=given.rotations,
        ),
        given=given,
        start=whole,
        smoothness=smoothness,
        rest_pose=rest_pose,
        normals=check_flag(normals, "normals"),
        vertex_importance=importance,
        weighted=weighted,
        frame_importance=frame_importance,
        rng=check_rng(rng),
        time_limit=time_limit,
        callback=check_callback(callback),
        checkpoint=Checkpoint(checkpoint),
    )


def _check_stored(influences: Any) -> tuple[int, WeightStorage]:
    """Largest number of influences, and the type in which their weights are stored."""
    if not (isinstance(influences, tuple) and len(influences) == 2):
        return check_influences(influences), "float32"
    count, storage = influences
    check_choice(storage, "influences[1]", WeightStorage)
    return check_influences(count), storage


def _is_kind(rig: Any) -> bool:
    return isinstance(rig, str) and rig in ("loose", "rigid")


def _count_bones(bones: Any, n_vertices: int, rig: Any, start: Any) -> int:
    """Number of bones: that of the given skeleton or model, or else `bones`."""
    known, what = None, "bones"
    if isinstance(rig, Skeleton):
        check_skeleton(rig)
        known, what = rig.skinning.n_bones + len(extra_parents(rig, n_vertices)), "rig"
    elif isinstance(start, Skinning):
        known, what = start.n_bones, "start"
    if bones is None and known is None:
        raise InputError("bones", f"an integer from 1 to {n_vertices}", "None")
    if known is not None and bones is not None and not (is_whole(bones) and bones == known):
        raise InputError("bones", f"{known}, as the {what} has, or None", repr(bones))
    if known is None:
        return check_whole(bones, "bones", 1, n_vertices, " (the number of vertices)")
    if known > n_vertices:
        raise InputError(what, f"at most {n_vertices} bones, as there are vertices", known)
    return known


def _check_rig(kind: RigKind, given: Given, bone_model: str, smoothness: float) -> None:
    """Raise InputError for arguments that cannot be combined with bones attached at joints."""
    if kind == "none":
        return
    beside = "beside a Skeleton" if given.keeps_tree else f"beside rig={kind!r}"
    if bone_model != "rigid":
        raise InputError("bone_model", f"'rigid' {beside}", repr(bone_model))
    if kind == "loose" and given.rotations is not None:
        raise InputError("rig.locked_joints", "() beside loose joints", "some")
    if kind == "loose" and not given.keeps_tree:
        return
    for name in ("weights", "transforms") if not (given.keeps_tree or given.free) else ():
        if getattr(given, name) is not None:
            raise InputError(f"start.{name}", f"None {beside}", "an array")
    if smoothness > 0:
        raise InputError("smoothness", f"0 {beside}", smoothness)
