"""Problem to solve: the checked arguments of a call, with the parts that it starts from."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..mesh.executor import Executor, Local, executor_for
from ..mesh.sequence import MeshSequence
from ..model.skinning import Skinning
from ..model.tree import Tree
from ..solver.alignment import Alignment
from ..solver.initialization import central_frame
from ..solver.model import Constraints, Skin
from ..solver.rest_surface import RestPose, RestSurface
from ..solver.trajectories import Array, Trajectories
from .progress import Monitor
from .scan import needs_streaming, subset

Effort = Literal["fast", "balanced", "best"]
RigKind = Literal["none", "loose", "rigid", "kept"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Initial:
    """Parts of a model that a caller hands over.

    Attributes
    ----------
    rest : (V, 3) array or None
        Rest pose.
    rest_frame : int or None
        Index of the frame from which the rest pose is solved if `rest` is None; None until it is
        chosen.
    skin : Skin or None
    transforms : (F, B, 3, 4) array or None
        Transforms of all bones; only beside `skin`.
    is_model : bool
        Whether the parts are a complete model to improve, of which nothing is kept.
    tree : Tree or None
        Parents and joints of the given bones; bones that are added come after these.
    keeps_tree : bool
        Whether the tree is that of a skeleton, so that its parents must not change.
    tree_pose : (V, 3) array or None
        Rest pose that fits the joints of `tree`; it is used if `rest` is None.
    nearest_bone : (V,) array or None
        For a skeleton of another mesh, the index of the bone that is nearest to each vertex and
        moves it at the start.
    skeleton_skin : Skin or None
        For a skeleton of the same mesh, its weights, used as a start.
    extra_parents : tuple of int
        Index of the parent, in a skeleton, of each bone to add.  −1 does not stand for a root, but
        for a bone whose parent is open: it goes where the error is largest.
    """

    rest: Array | None = None
    rest_frame: int | None = None
    skin: Skin | None = None
    transforms: Array | None = None
    is_model: bool = False
    tree: Tree | None = None
    keeps_tree: bool = False
    tree_pose: Array | None = None
    nearest_bone: NDArray[np.intp] | None = None
    skeleton_skin: Skin | None = None
    extra_parents: tuple[int, ...] = ()

    def first_pose(self, data: Trajectories) -> Array:
        """Rest pose (V, 3) with which a solve starts, in the space of `data`."""
        return data.frame(self.rest_frame or 0) if self.rest is None else self.rest.copy()

    def beside_model(self) -> Initial:
        """Parts for starts that do not use a complete given model.

        They are `rest_frame` alone if such a model was given, and otherwise all parts.
        """
        return Initial(rest_frame=self.rest_frame) if self.is_model else self

    def of_vertices(self, kept: NDArray[np.intp]) -> Initial:
        """A copy for the vertices `kept` alone."""
        some: dict[str, Any] = {}
        for name in ("rest", "skin", "tree_pose", "nearest_bone", "skeleton_skin"):
            part = getattr(self, name)
            if isinstance(part, Skin):
                some[name] = Skin._make(np.ascontiguousarray(array[kept]) for array in part)
            elif part is not None:
                some[name] = np.ascontiguousarray(part[kept])
        return dataclasses.replace(self, **some)

    def of_frames(self, chosen: NDArray[np.int64]) -> Initial:
        """A copy for the frames `chosen` alone, ascending; `rest_frame` must be one of them."""
        transforms = self.transforms
        return dataclasses.replace(
            self,
            rest_frame=self.rest_frame and int(np.searchsorted(chosen, self.rest_frame)),
            transforms=None if transforms is None else np.ascontiguousarray(transforms[chosen]),
        )

    def inside(self, alignment: Alignment) -> Initial:
        """A copy with rest pose, joints and transforms mapped to the solver's space."""
        inward, tree, inside = alignment.points_from_world, self.tree, dict[str, Any]()
        if tree is not None:
            owner = "rig.skinning" if self.keeps_tree else "start"
            points = inward(tree.points, f"{owner}.joint_positions")
            inside["tree"] = dataclasses.replace(tree, points=points)
        if self.transforms is not None:
            inside["transforms"] = alignment.moves_from_world(self.transforms, "start.transforms")
        if self.rest is not None:
            inside["rest"] = inward(self.rest, "start.rest")
        if self.tree_pose is not None:
            inside["tree_pose"] = inward(self.tree_pose, "rig.skinning.rest")
        return dataclasses.replace(self, **inside)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Problem to solve: the checked arguments of a call.

    Attributes
    ----------
    sequences : list of MeshSequence
        Shots of one mesh, without copies of vertices.
    inputs : list of MeshSequence
        The shots as the caller gave them.
    rows : (V0,) array or None
        Index of the vertex of `sequences` for each vertex of `inputs`; None if no two coincide in
        every frame.
    bones, influences : int
    effort : {"fast", "balanced", "best"}
    rig : {"none", "loose", "rigid", "kept"}
        "kept" stands for joints whose motion is given.
    names : tuple of str
        Names of the bones of a given skeleton.
    constraints : Constraints
        Parts that must not change, and the bone model.
    initial : Initial
        Parts that the caller gave, in the input's space and for all frames.
    start : Skinning or None
        A complete model to continue from.
    smoothness : float
        Smoothness of the weights, as a length in the mesh's units; 0 if they are not penalised.
    rest_pose : {"surface", "free"}
    normals : float or None
        Length, in the mesh's units, below which errors of positions do not count against normals;
        None if normals are not part of the objective.
    vertex_importance : (V,) array or None
        Importance of each vertex of `sequences`: the sum over the copies of one.
    weighted : bool
        Whether the caller gave an importance of vertices or frames.
    frame_importance : (F,) array or None
    rng : numpy.random.Generator
    monitor : Monitor
    """

    sequences: list[MeshSequence]
    inputs: list[MeshSequence]
    rows: NDArray[np.intp] | None
    bones: int
    influences: int
    effort: Effort
    rig: RigKind
    names: tuple[str, ...]
    constraints: Constraints
    initial: Initial
    start: Skinning | None
    smoothness: float
    rest_pose: RestPose
    normals: float | None
    vertex_importance: Array | None
    weighted: bool
    frame_importance: Array | None
    rng: np.random.Generator
    monitor: Monitor

    @functools.cached_property
    def executor(self) -> Executor:
        """Executor of loops over frames: Dask workers if there are any and frames are streamed."""
        return executor_for(self.sequences) if needs_streaming(self.sequences) else Local()

    @property
    def n_frames(self) -> int:
        return sum(map(len, self.sequences))

    @property
    def n_vertices(self) -> int:
        return self.sequences[0].n_vertices

    @property
    def copies(self) -> int:
        """Number of vertices of `inputs` that are copies of another one."""
        return self.inputs[0].n_vertices - self.n_vertices

    @property
    def offsets(self) -> NDArray[np.int64]:
        """First frame of each of the S shots, followed by the number of frames, (S + 1,)."""
        return np.cumsum([0, *map(len, self.sequences)])

    def of_frames(self, chosen: NDArray[np.int64], importance: Array | None) -> Problem:
        """A copy for the frames `chosen` alone, ascending, which are read into memory.

        `importance` (S,) is theirs.
        """
        few = subset(self.sequences, chosen, executor=self.executor)
        (vertices,) = self.for_inputs(few.frames(slice(None)).swapaxes(0, 1))
        whole = dataclasses.replace(
            self.inputs[0], vertices=vertices.swapaxes(0, 1), validate=False
        )
        return dataclasses.replace(
            self,
            sequences=[few],
            inputs=[few if self.rows is None else whole],
            initial=self.initial.of_frames(chosen),
            frame_importance=importance,
        )

    def for_inputs(self, *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """Expand arrays (V, ...) of the vertices of `sequences` to those (V0, ...) of `inputs`."""
        return arrays if self.rows is None else tuple(array[self.rows] for array in arrays)

    def with_rest_surface(
        self, data: Trajectories, initial: Initial
    ) -> tuple[Trajectories, Initial]:
        """Copies of `data` with a reference surface, and of `initial` with a rest frame.

        `data` must be uncompressed.  The surface is the rest pose of `initial`, or otherwise its
        skeleton's, or otherwise the rest frame, which is chosen unless the caller named it.  There
        is no surface if the rest pose is free or locked.  A start model that is only tried beside
        other starts is no reference, since it may be crumpled.  Bones that stretch need a rest
        frame in which every part has a size, even if the rest pose is free.
        """
        keeps_to = self.rest_pose == "surface" and len(data.faces) > 0
        pose = initial.tree_pose if initial.rest is None or self.tries_model else initial.rest
        chosen = keeps_to or self.constraints.bone_model != "rigid"
        if pose is None and initial.rest_frame is None and chosen:
            frame = central_frame(data, first=not keeps_to)
            initial = dataclasses.replace(initial, rest_frame=frame)
        if not keeps_to or self.constraints.lock_rest:
            return data, initial
        pose = initial.beside_model().first_pose(data) if pose is None else pose
        return dataclasses.replace(data, surface=RestSurface.build(data.faces, pose)), initial

    @property
    def tries_model(self) -> bool:
        """Whether a complete model was given that is only tried beside other starts."""
        bound = self.rig == "rigid" or self.initial.keeps_tree or self.smoothness > 0
        return self.initial.is_model and not bound
