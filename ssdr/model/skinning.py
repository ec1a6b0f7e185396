"""A skinned model: rest pose, skin weights and bone transforms."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..common.checks import (
    BoneModel,
    check_dense,
    check_faces,
    check_floats,
    check_frames,
    check_skin,
)
from ..common.errors import InputError, check_choice, is_whole
from ..common.short_repr import notebook_html
from ..mesh.clips import Clip, check_clips, in_order, pick
from ..mesh.sequence import check_vertex_map
from ..mesh.surface import (
    UNKNOWN,
    Space,
    Surface,
    as_trimesh,
    check_space,
    check_surface,
    protect,
)
from .articulated import Articulated
from .lbs import skin
from .lbs import skinning_in as skinning_in
from .transforms import check_parents


def check_skinning(model: Any) -> Skinning:
    """Check that a model, or that of a result, is a Skinning without shapes, and return it."""
    found = skinning_in(model)
    if not isinstance(found, Skinning):
        raise InputError("skinning", "a Skinning", type(model).__name__)
    return found


@dataclasses.dataclass(frozen=True, eq=False)
class Skinning(Articulated):
    """Rest pose, sparse skin weights and bone transforms of an animated mesh.

    Parameters
    ----------
    rest : (V, 3) float array
        Rest pose.
    indices : (V, K) int array
        Bones that move each vertex; unused ones have weight 0.
    weights : (V, K) float array
        Non-negative, summing to 1 over K.
    transforms : (F, B, 3, 4) float array
        ``[R | T]`` from the rest pose to the pose of each frame, for column
        vectors.
    faces : (T, 3) int array, optional
    fps : float, optional
        Frames per second of the first clip; 24 by default.
    bone_model : {"rigid", "similarity", "affine"}
        What the 3×3 blocks may be: "rigid" rotations, "similarity" uniformly scaled rotations,
        "affine" any matrices.
    keyframes : (F, B) bool array, optional
        Which transforms are keys; the others are interpolated, and `transforms` holds the
        interpolated values.  None: every frame is a key.
    surface, vertex_map, space
        As in :class:`~ssdr.MeshSequence`, but the normals are those that engines skin with the
        bones: n becomes Σ_k w_k R_k n, normalised.  Models that were fitted to frames have the
        normals that come closest, when skinned, to the normals of the frames; they differ from
        the normals of the rest surface.
    bone_names : tuple of str, optional
        ``bone_0``, ``bone_1``, ... by default.
    name : str
        Name of the mesh.
    clips : tuple of Clip, optional
        Ranges of frames that play separately, each at its own rate; in order they
        cover all frames.  One clip over all frames by default.
    parents : (B,) int array, optional
        Parent of each bone, -1 at a root.  None: bones without a hierarchy.
    joint_positions : (B, 3) array, optional
        With `parents`: the point of the rest pose at which a bone is attached to its
        parent, and about which a root rotates.

    Raises
    ------
    InputError
        If shapes do not match, an index is out of range, a number is not
        finite, a weight is negative, a row of weights does not sum to 1
        within 1e-4, clips do not cover the frames, parents form a
        cycle, or one of `parents` and `joint_positions` is missing.

    Examples
    --------
    >>> rest, indices, weights = np.eye(3), np.zeros((3, 1), int), np.ones((3, 1))
    >>> transforms = np.broadcast_to(np.eye(3, 4), (5, 1, 3, 4))
    >>> skinning = ssdr.Skinning(rest, indices, weights, transforms)
    >>> skinning.n_frames, skinning.n_bones, skinning.skin().shape
    (5, 1, (5, 3, 3))
    """

    rest: Any
    indices: Any
    weights: Any
    transforms: Any
    _: dataclasses.KW_ONLY
    faces: Any = None
    fps: float = None  # type: ignore[assignment]  # that of the clips, else 24
    bone_model: BoneModel = "rigid"
    keyframes: Any = None
    surface: Surface | None = None
    vertex_map: Any = None
    space: Space = UNKNOWN
    bone_names: tuple[str, ...] | None = None
    name: str = ""
    clips: tuple[Clip, ...] = None  # type: ignore[assignment]  # one over all frames
    parents: Any = None
    joint_positions: Any = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        rest = check_floats(self.rest, "rest", ("V", 3))
        n_vertices = len(rest)
        transforms = check_floats(self.transforms, "transforms", ("F", "B", 3, 4))
        n_bones = transforms.shape[1]
        indices, weights = check_skin(self.indices, self.weights, n_vertices, n_bones)
        check_choice(self.bone_model, "bone_model", BoneModel)
        clips, fps = check_clips(self.clips, fps=self.fps, name=self.name, n_frames=len(transforms))
        faces = check_faces(self.faces, n_vertices)
        if self.keyframes is not None:
            keyframes = np.asarray(self.keyframes)
            if keyframes.shape != transforms.shape[:2] or keyframes.dtype != bool:
                raise InputError(
                    "keyframes",
                    f"bool of shape {transforms.shape[:2]}",
                    f"{keyframes.dtype} of shape {keyframes.shape}",
                )
            put(self, "keyframes", keyframes)
        if self.surface is not None:
            check_surface(self.surface, len(faces))
        check_space(self.space)
        if self.vertex_map is not None:
            put(self, "vertex_map", check_vertex_map(self.vertex_map, n_vertices))
        if self.bone_names is not None:
            named = self.bone_names
            if not isinstance(named, (list, tuple, np.ndarray)) or np.ndim(named) != 1:
                raise InputError("bone_names", f"a list of {n_bones} names", type(named).__name__)
            if len(named) != n_bones:
                raise InputError("bone_names", f"{n_bones} names", f"{len(named)}")
            put(self, "bone_names", tuple(str(name) for name in self.bone_names))
        if (self.parents is None) != (self.joint_positions is None):
            missing = "parents" if self.parents is None else "joint_positions"
            raise InputError(missing, "parents and joint_positions together", "one of them")
        if self.parents is not None:
            put(self, "parents", check_parents(self.parents, n_bones))
            positions = check_floats(self.joint_positions, "joint_positions", (n_bones, 3))
            put(self, "joint_positions", positions)
        parts = {"rest": rest, "indices": indices, "weights": weights, "transforms": transforms}
        for field, value in {**parts, "faces": faces, "fps": fps, "clips": clips}.items():
            put(self, field, value)
        protect(self)

    @classmethod
    def from_dense(
        cls,
        rest: Any,
        weights: Any,
        transforms: Any,
        *,
        influences: int | None = None,
        **options: Any,
    ) -> Skinning:
        """A model from a matrix of weights with a column for each bone.

        Parameters
        ----------
        rest, transforms, **options
            As in :class:`Skinning`.
        weights : (V, B) array or sparse array
            Non-negative; rows sum to 1.
        influences : int, optional
            Most influences per vertex, K: smaller weights are dropped as by :meth:`prune`.  By
            default the largest number that any vertex has, so that nothing is lost.

        Raises
        ------
        InputError
            As in :class:`Skinning`; also if there is not a column for each bone.

        Examples
        --------
        >>> dense = np.array([[1, 0, 0], [0.5, 0, 0.5], [0, 0, 1]])
        >>> still = np.broadcast_to(np.eye(3, 4), (5, 3, 3, 4))
        >>> model = ssdr.Skinning.from_dense(np.eye(3), dense, still)
        >>> model.n_influences, np.array_equal(model.dense_weights(), dense)
        (2, True)
        """
        dense = check_dense(weights)
        moves = check_floats(transforms, "transforms", ("F", "B", 3, 4))
        if dense.shape[1] != moves.shape[1]:
            wanted = f"{moves.shape[1]} columns, one for each bone of the transforms"
            raise InputError("weights", wanted, f"{dense.shape[1]}")
        indices = np.broadcast_to(np.arange(dense.shape[1]), dense.shape)
        used = max(1, int((dense > 0).sum(axis=1).max()))
        model = cls(rest, indices, dense, moves, **options)
        return model.prune(used if influences is None else influences)

    @property
    def skinning(self) -> Skinning:
        """The model itself; a :class:`ShapedSkinning` has one, too."""
        return self

    @property
    def n_vertices(self) -> int:
        return int(self.rest.shape[0])

    @property
    def n_influences(self) -> int:
        return int(self.indices.shape[1])

    @property
    def n_frames(self) -> int:
        return int(self.transforms.shape[0])

    @property
    def n_bones(self) -> int:
        return int(self.transforms.shape[1])

    def __repr__(self) -> str:
        return (
            f"Skinning(V={self.n_vertices}, B={self.n_bones}, K={self.n_influences}, "
            f"F={self.n_frames}, {self.bone_model})"
        )

    _repr_html_ = notebook_html

    def names(self) -> tuple[str, ...]:
        """Names of the bones, and of the joint at which each is attached."""
        return self.bone_names or tuple(f"bone_{j}" for j in range(self.n_bones))

    def skin(self, frames: Any = None, *, dtype: Any = None) -> NDArray[np.floating]:
        """Vertex positions ``(f, V, 3)`` in some frames, by default all; ``(V, 3)`` in one."""
        index = slice(None) if frames is None else check_frames(frames, self.n_frames)
        return skin(self.rest, self.indices, self.weights, self.transforms[index], dtype=dtype)

    def mesh(self, frame: int | None = None) -> Any:
        """One frame, or the rest pose, as a ``trimesh.Trimesh`` of copies."""
        return as_trimesh(self.rest if frame is None else self.skin(int(frame)), self.faces)

    def select(self, *clips: str | int, between: tuple[float, float] | None = None) -> Skinning:
        """A copy of the model with only the given clips (names or indices), in the given order.

        Of each clip it has all frames, or those `between` two numbers (both included), counted from
        0 at the clip's first frame.

        Raises
        ------
        InputError
            If there is no such clip, one is named twice, or one has no such frame.

        Examples
        --------
        >>> rest, indices, weights = np.eye(3), np.zeros((3, 1), int), np.ones((3, 1))
        >>> transforms = np.broadcast_to(np.eye(3, 4), (5, 1, 3, 4))
        >>> clips = ssdr.Clip("walk", 0, 3, 24), ssdr.Clip("jump", 3, 5, 60)
        >>> skinning = ssdr.Skinning(rest, indices, weights, transforms, clips=clips)
        >>> jump = skinning.select("jump")
        >>> jump.n_frames, jump.fps, jump.clips
        (2, 60.0, (Clip(name='jump', start=0, stop=2, fps=60.0),))
        """
        chosen, index = self.frames_of(*clips, between=between)
        keyframes = self.keyframes
        if keyframes is not None:
            keyframes = keyframes.copy()
            for one in self.clips if len(self.clips) > 1 else ():
                keyframes[[one.start, one.stop - 1]] = True  # each is played without the others
            keyframes = keyframes[index]
        return dataclasses.replace(
            self,
            transforms=self.transforms[index],
            keyframes=keyframes,
            fps=chosen[0].fps,
            clips=in_order(chosen),
        )

    def frames_of(
        self, *clips: str | int, between: tuple[float, float] | None = None
    ) -> tuple[list[Clip], NDArray[np.int64]]:
        """The clips that names or indices choose, and their frames in the given order.

        Raises
        ------
        InputError
            As :meth:`select`.
        """
        known = [clip.name for clip in self.clips]
        chosen = [self.clips[pick(known, clip)] for clip in clips]
        if not chosen or len(set(chosen)) < len(chosen):
            raise InputError("clip", f"some of {known}, each once", list(clips))
        if between is not None:
            chosen = [clip.part(*between) for clip in chosen]
        return chosen, np.concatenate([np.arange(clip.start, clip.stop) for clip in chosen])

    def dense_weights(self) -> NDArray[np.floating]:
        """Weights as a ``(V, B)`` matrix."""
        return np.asarray(self.sparse_weights().toarray())

    def sparse_weights(self) -> csr_array:
        """Weights as a sparse ``(V, B)`` matrix."""
        n, k = self.indices.shape
        rows = np.repeat(np.arange(n), k)
        matrix = csr_array(
            (self.weights.ravel(), (rows, self.indices.ravel())), shape=(n, self.n_bones)
        )
        matrix.eliminate_zeros()
        return matrix

    def centroids(self) -> NDArray[np.float64]:
        """Centroids ``(B, 3)`` of the vertices that each bone moves, by weight, in the rest pose.

        A bone that moves nothing gets the centroid of the mesh.
        """
        w = self.sparse_weights().astype(np.float64)
        total = np.asarray(w.sum(axis=0)).ravel()
        mean = self.rest.astype(np.float64).mean(axis=0)
        sums = w.T @ self.rest.astype(np.float64)
        safe = np.where(total > 0, total, 1.0)[:, None]
        return np.asarray(np.where(total[:, None] > 0, sums / safe, mean))

    def prune(self, influences: int) -> Skinning:
        """Copy with only the largest weights of each vertex, renormalised where any are dropped.

        ``metrics.compare(model.skin(), pruned.skin())`` measures the error that this adds.

        Raises
        ------
        InputError
            If `influences` is below 1.
        """
        if not is_whole(influences) or influences < 1:
            raise InputError("influences", "an integer >= 1", repr(influences))
        k = min(int(influences), self.n_influences)
        order = np.argsort(-self.weights, axis=1, kind="stable")[:, :k]
        weights = np.take_along_axis(self.weights, order, axis=1).astype(np.float64)
        indices = np.take_along_axis(self.indices, order, axis=1)
        lost = np.count_nonzero(weights, axis=1) < np.count_nonzero(self.weights, axis=1)
        weights[lost] /= weights[lost].sum(axis=1, keepdims=True)
        return dataclasses.replace(
            self,
            indices=np.where(weights > 0, indices, 0).astype(np.int32),
            weights=weights.astype(self.weights.dtype),
        )
