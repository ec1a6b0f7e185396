"""The model that a decomposition returns, and forward linear blend skinning (LBS)."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from .clips import Clip, check_clips, in_order, pick
from .errors import InputError, check_choice, is_whole
from .kernels.lbs import skin_range
from .parallel import chunk_bounds, run_chunks
from .sequence import Surface

__all__ = ["BoneModel", "Skinning", "skin"]

BoneModel = Literal["rigid", "similarity", "affine"]
_VERTEX_CHUNK = 1024  # vertices in a task: fewer cost more calls, more balance threads worse


@dataclasses.dataclass(frozen=True, eq=False)
class Skinning:
    """Rest pose, sparse skin weights and bone transforms of an animated mesh.

    Parameters
    ----------
    rest : (V, 3) float array
        Rest pose.
    joints : (V, K) int array
        Bones that move each vertex; padded with bone 0, weight 0.
    weights : (V, K) float array
        Non-negative, summing to 1 over K.
    transforms : (F, B, 3, 4) float array
        ``[R | T]`` from the rest pose to the pose of each frame, for column
        vectors.
    faces : (T, 3) int array, optional
    fps : float, optional
        Frames per second of the first clip, 24 by default; of the whole where
        there is one clip or all have one rate.
    bone_model : {"rigid", "similarity", "affine"}
        What the 3×3 blocks may be: rotations, uniformly scaled rotations,
        anything.
    keyframes : (F, B) bool array, optional
        Which transforms are keys; the others follow by interpolation and
        `transforms` holds their values.  None: every frame is a key.
    surface, vertex_map
        As in :class:`~ssdr.MeshSequence`.
    bone_names : tuple of str, optional
        ``bone_0``, ``bone_1``, ... by default.
    name : str
        Of the mesh.
    clips : tuple of Clip, optional
        Ranges of frames that play apart, each at its own rate; one behind the
        other they cover all frames.  One clip over all frames by default.

    Raises
    ------
    InputError
        If shapes do not match, an index is out of range, a number is not
        finite, a weight is negative, a row of weights does not sum to 1
        within 1e-4, or clips do not cover the frames.

    Examples
    --------
    >>> rest, joints, weights = np.eye(3), np.zeros((3, 1), int), np.ones((3, 1))
    >>> transforms = np.broadcast_to(np.eye(3, 4), (5, 1, 3, 4))
    >>> skinning = ssdr.Skinning(rest, joints, weights, transforms)
    >>> skinning.n_frames, skinning.n_bones, skinning.skin().shape
    (5, 1, (5, 3, 3))
    """

    rest: Any
    joints: Any
    weights: Any
    transforms: Any
    _: dataclasses.KW_ONLY
    faces: Any = None
    fps: float = None  # type: ignore[assignment]  # that of the clips, else 24
    bone_model: BoneModel = "rigid"
    keyframes: Any = None
    surface: Surface | None = None
    vertex_map: Any = None
    bone_names: tuple[str, ...] | None = None
    name: str = ""
    clips: tuple[Clip, ...] = None  # type: ignore[assignment]  # one over all frames

    def __post_init__(self) -> None:
        from .sequence import _check_faces, _check_surface, _check_vertex_map

        put = object.__setattr__
        rest = _floats(self.rest, "rest", ("V", 3))
        n_vertices = len(rest)
        joints = np.asarray(self.joints)
        if joints.ndim != 2 or len(joints) != n_vertices or joints.shape[1] < 1:
            raise InputError("joints", f"shape ({n_vertices}, K)", f"shape {joints.shape}")
        if joints.dtype.kind not in "iu":
            raise InputError("joints", "integers", f"dtype {joints.dtype}")
        weights = _floats(self.weights, "weights", joints.shape)
        transforms = _floats(self.transforms, "transforms", ("F", "B", 3, 4))
        n_bones = transforms.shape[1]
        if joints.min() < 0 or joints.max() >= n_bones:
            raise InputError(
                "joints", f"indices from 0 to {n_bones - 1}", f"{joints.min()} to {joints.max()}"
            )
        if weights.min() < 0:
            raise InputError("weights", "numbers >= 0", f"{weights.min()}")
        off = np.abs(weights.sum(axis=1, dtype=np.float64) - 1)
        if off.max() > 1e-4:
            worst = int(off.argmax())
            raise InputError(
                "weights", "rows that sum to 1", f"{weights[worst].sum()} at vertex {worst}"
            )
        check_choice(self.bone_model, "bone_model", BoneModel)
        clips, fps = check_clips(self.clips, fps=self.fps, name=self.name, n_frames=len(transforms))
        faces = _check_faces(self.faces, n_vertices, "faces")
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
            _check_surface(self.surface, len(faces))
        if self.vertex_map is not None:
            put(self, "vertex_map", _check_vertex_map(self.vertex_map, n_vertices))
        if self.bone_names is not None:
            named = self.bone_names
            if not isinstance(named, (list, tuple, np.ndarray)) or np.ndim(named) != 1:
                raise InputError("bone_names", f"a list of {n_bones} names", type(named).__name__)
            if len(named) != n_bones:
                raise InputError("bone_names", f"{n_bones} names", f"{len(named)}")
            put(self, "bone_names", tuple(str(name) for name in self.bone_names))
        put(self, "rest", rest)
        put(self, "joints", np.ascontiguousarray(joints, dtype=np.int32))
        put(self, "weights", weights)
        put(self, "transforms", transforms)
        put(self, "faces", faces)
        put(self, "fps", fps)
        put(self, "clips", clips)

    @property
    def n_vertices(self) -> int:
        return int(self.rest.shape[0])

    @property
    def n_influences(self) -> int:
        return int(self.joints.shape[1])

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

    def names(self) -> tuple[str, ...]:
        """Names of the bones."""
        return self.bone_names or tuple(f"bone_{j}" for j in range(self.n_bones))

    def skin(self, frames: Any = None, *, dtype: Any = None) -> NDArray[np.floating]:
        """Positions ``(f, V, 3)`` of the named frames; all of them by default."""
        chosen = self.transforms
        if frames is not None:
            chosen = chosen[_frame_index(frames, self.n_frames)]
        return skin(self.rest, self.joints, self.weights, chosen, dtype=dtype)

    def select(self, *clips: str | int) -> Skinning:
        """The model with the named clips alone, in that order.

        Raises
        ------
        InputError
            If there is no such clip, or one is named twice.

        Examples
        --------
        >>> rest, joints, weights = np.eye(3), np.zeros((3, 1), int), np.ones((3, 1))
        >>> transforms = np.broadcast_to(np.eye(3, 4), (5, 1, 3, 4))
        >>> clips = ssdr.Clip("walk", 0, 3, 24), ssdr.Clip("jump", 3, 5, 60)
        >>> skinning = ssdr.Skinning(rest, joints, weights, transforms, clips=clips)
        >>> jump = skinning.select("jump")
        >>> jump.n_frames, jump.fps, jump.clips
        (2, 60.0, (Clip(name='jump', start=0, stop=2, fps=60.0),))
        """
        known = [clip.name for clip in self.clips]
        chosen = [self.clips[pick(known, clip)] for clip in clips]
        if not chosen or len(set(chosen)) < len(chosen):
            raise InputError("clip", f"some of {known}, each once", list(clips))
        index = np.concatenate([np.arange(clip.start, clip.stop) for clip in chosen])
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

    def dense_weights(self) -> NDArray[np.floating]:
        """Weights as a ``(V, B)`` matrix."""
        return np.asarray(self.sparse_weights().toarray())

    def sparse_weights(self) -> csr_array:
        """Weights as a sparse ``(V, B)`` matrix."""
        n, k = self.joints.shape
        rows = np.repeat(np.arange(n), k)
        matrix = csr_array(
            (self.weights.ravel(), (rows, self.joints.ravel())), shape=(n, self.n_bones)
        )
        matrix.eliminate_zeros()
        return matrix

    def centroids(self) -> NDArray[np.float64]:
        """Weighted centroid ``(B, 3)`` in the rest pose of what each bone moves.

        A bone that moves nothing gets the centroid of the mesh.
        """
        w = self.sparse_weights().astype(np.float64)
        total = np.asarray(w.sum(axis=0)).ravel()
        mean = self.rest.astype(np.float64).mean(axis=0)
        sums = w.T @ self.rest.astype(np.float64)
        safe = np.where(total > 0, total, 1.0)[:, None]
        return np.asarray(np.where(total[:, None] > 0, sums / safe, mean))

    def prune(self, influences: int, *, minimum: float = 0.0) -> Skinning:
        """Keep the `influences` largest weights of a vertex, at least `minimum` each; renormalise.

        The largest weight of a vertex is always kept.  What it costs is the
        caller's to measure: ``metrics.compare(model.skin(), pruned.skin())``.

        Raises
        ------
        InputError
            If `influences` is below 1 or `minimum` is not in [0, 1).
        """
        if not is_whole(influences) or influences < 1:
            raise InputError("influences", "an integer >= 1", repr(influences))
        if not 0 <= minimum < 1:
            raise InputError("minimum", "a number in [0, 1)", minimum)
        k = min(int(influences), self.n_influences)
        order = np.argsort(-self.weights, axis=1, kind="stable")[:, :k]
        weights = np.take_along_axis(self.weights, order, axis=1).astype(np.float64)
        joints = np.take_along_axis(self.joints, order, axis=1)
        drop = weights < minimum
        drop[:, 0] = False
        weights[drop] = 0.0
        weights /= weights.sum(axis=1, keepdims=True)
        return dataclasses.replace(
            self,
            joints=np.where(weights > 0, joints, 0).astype(np.int32),
            weights=weights.astype(self.weights.dtype),
        )


def skin(
    rest: ArrayLike,
    joints: ArrayLike,
    weights: ArrayLike,
    transforms: ArrayLike,
    *,
    dtype: Any = None,
) -> NDArray[np.floating]:
    """Linear blend skinning: v_i^t = Σ_k w_ik M_{j_ik}^t (p_i, 1).

    Parameters
    ----------
    rest : (V, 3) array
    joints : (V, K) int array
    weights : (V, K) array
    transforms : (F, B, 3, 4) or (B, 3, 4) array
    dtype : float32 or float64, optional
        Precision of the computation and of the result; the widest of the
        inputs by default.

    Returns
    -------
    (F, V, 3) array, or (V, 3) for a single frame.

    Raises
    ------
    InputError
        If shapes do not match or an index is out of range.

    References
    ----------
    Magnenat-Thalmann et al., "Joint-dependent local deformations", 1988.

    Examples
    --------
    >>> move = np.eye(3, 4)[None]
    >>> move[0, :, 3] = [1, 2, 3]
    >>> posed = ssdr.skin(np.zeros((2, 3)), np.zeros((2, 1), int), np.ones((2, 1)), move)
    >>> np.allclose(posed, [1, 2, 3])
    True
    """
    p, w, m = np.asarray(rest), np.asarray(weights), np.asarray(transforms)
    j = np.asarray(joints)
    if p.ndim != 2 or p.shape[1] != 3:
        raise InputError("rest", "shape (V, 3)", f"shape {p.shape}")
    if j.ndim != 2 or len(j) != len(p) or j.shape[1] < 1 or j.dtype.kind not in "iu":
        raise InputError("joints", f"integers of shape ({len(p)}, K)", f"{j.dtype} {j.shape}")
    if w.shape != j.shape:
        raise InputError("weights", f"shape {j.shape}", f"shape {w.shape}")
    single = m.ndim == 3
    if m.ndim not in (3, 4) or m.shape[-2:] != (3, 4):
        raise InputError("transforms", "shape (F, B, 3, 4) or (B, 3, 4)", f"shape {m.shape}")
    if j.size and (j.min() < 0 or j.max() >= m.shape[-3]):
        raise InputError(
            "joints", f"indices from 0 to {m.shape[-3] - 1}", f"{j.min()} to {j.max()}"
        )
    for name, array in (("rest", p), ("weights", w), ("transforms", m)):
        if array.dtype.kind not in "fiu":
            raise InputError(name, "real numbers", f"dtype {array.dtype}")
    try:
        kind = np.result_type(p, w, m) if dtype is None else np.dtype(dtype)
    except (TypeError, ValueError) as error:
        raise InputError("dtype", "float32, float64 or None", repr(dtype)) from error
    if kind not in (np.dtype(np.float32), np.dtype(np.float64)):
        kind = np.dtype(np.float64)
    p, w, m = (np.ascontiguousarray(a, dtype=kind) for a in (p, w, m))
    j = np.ascontiguousarray(j, dtype=np.int32)
    frames = m[None] if single else m
    out = np.empty((len(frames), len(p), 3), dtype=kind)

    def work(_: int, first: int, last: int) -> None:
        skin_range(p, j, w, frames, out, first, last)

    run_chunks(work, chunk_bounds(len(p), _VERTEX_CHUNK))
    return out[0] if single else out


def _frame_index(frames: Any, n_frames: int) -> Any:
    if isinstance(frames, slice):
        return frames
    index = np.atleast_1d(np.asarray(frames))
    if index.dtype == bool and index.shape == (n_frames,):
        return index
    usable = index.ndim == 1 and (index.dtype.kind in "iu" or index.size == 0)
    if not usable or (index.size and not -n_frames <= index.min() <= index.max() < n_frames):
        raise InputError("frames", f"indices below {n_frames}, a slice or a mask", frames)
    return index.astype(np.intp)


def _floats(value: Any, argument: str, shape: tuple[Any, ...]) -> NDArray[np.floating]:
    array = np.asarray(value)
    wanted = f"shape ({', '.join(str(s) for s in shape)})"
    if array.ndim != len(shape) or any(
        isinstance(s, int) and s != n for s, n in zip(shape, array.shape, strict=True)
    ):
        raise InputError(argument, wanted, f"shape {array.shape}")
    if array.size == 0:
        raise InputError(argument, f"{wanted}, none of them 0", f"shape {array.shape}")
    if array.dtype.kind not in "fiu":
        raise InputError(argument, "real numbers", f"dtype {array.dtype}")
    if array.dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
        array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError(argument, "finite numbers", "NaN or Inf")
    return np.ascontiguousarray(array)
