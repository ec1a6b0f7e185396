"""Parents and joints of bones, and transforms relative to the parent.

Bone b is attached to its parent a at its joint, the point c_b of the rest pose.  The joint's
coordinate system moves with the bone; in the rest pose it has its origin at c_b and the axes of the
world.  Its transform to the world is G_b = M_b (I | c_b), and its transform relative to the
parent's is L_b = G_a⁻¹ G_b.  If both bones move the joint to the same point in every frame
(M_b c_b = M_a c_b), then only the rotation of L_b changes, and its translation stays that of the
rest pose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.checks import as_array
from ..common.errors import InputError
from .rigid import matrix_from_quaternion

RIGID = 1e-6  # gap of a joint, in diagonals of the mesh, up to which it does not translate

Array = NDArray[np.float64]


def check_parents(parents: ArrayLike, n_bones: int) -> NDArray[np.int32]:
    """Check parents (B,) for cycles and indices out of range; return them as int32, −1 at roots."""
    array = as_array(parents, "parents", "integers")
    if array.shape != (n_bones,) or array.dtype.kind not in "iu":
        raise InputError(
            "parents", f"integers of shape ({n_bones},)", f"{array.dtype} of shape {array.shape}"
        )
    if array.min() < -1 or array.max() >= n_bones:
        raise InputError(
            "parents", f"-1 or a bone from 0 to {n_bones - 1}", f"{array.min()} to {array.max()}"
        )
    array = array.astype(np.int32)
    parents_first(array)
    return array


def parents_first(parents: NDArray[Any]) -> NDArray[np.int64]:
    """An order of the bones in which each bone comes after its parent.

    Raises
    ------
    InputError
        If the parents form a cycle.
    """
    return np.argsort(depths(parents), kind="stable")


def depths(parents: NDArray[Any]) -> NDArray[np.int64]:
    """Number of ancestors of each bone (B,): 0 at roots.

    Raises
    ------
    InputError
        If the parents form a cycle.
    """
    depth = np.zeros(len(parents), dtype=np.int64)
    at = np.asarray(parents, dtype=np.int64).copy()
    while (at >= 0).any():
        depth[at >= 0] += 1
        at = np.where(at >= 0, np.asarray(parents)[at], -1)
        if depth.max() > len(parents):
            circle = np.flatnonzero(at >= 0).tolist()
            raise InputError("parents", "a tree", f"a cycle through or above bones {circle}")
    return depth


def to_local(transforms: ArrayLike, parents: NDArray[Any], positions: ArrayLike) -> Array:
    """Transforms (..., B, 3, 4) of the joints' coordinate systems relative to their parents'.

    These are the L_b of the module's docstring, given the M_b.
    """
    m = np.asarray(transforms, dtype=np.float64)
    c = np.asarray(positions, dtype=np.float64)
    frame = m.copy()
    frame[..., 3] += np.einsum("...bij,bj->...bi", m[..., :3], c)
    local = frame.copy()
    hung = np.flatnonzero(np.asarray(parents) >= 0)
    above = frame[..., np.asarray(parents)[hung], :, :]
    back = np.linalg.inv(above[..., :3])
    local[..., hung, :, :3] = back @ frame[..., hung, :, :3]
    shift = frame[..., 3][..., hung, :] - above[..., 3]
    local[..., 3][..., hung, :] = np.einsum("...bij,...bj->...bi", back, shift)
    return local


def from_local(local: ArrayLike, parents: NDArray[Any], positions: ArrayLike) -> Array:
    """Transforms M (..., B, 3, 4) from the rest pose: the inverse of :func:`to_local`."""
    return from_frames(to_world(local, parents), positions)


def from_frames(frame: Array, positions: ArrayLike) -> Array:
    """Transforms M (..., B, 3, 4) from the rest pose, given the joints' G (..., B, 3, 4)."""
    shift = np.einsum("...bij,bj->...bi", frame[..., :3], np.asarray(positions, dtype=np.float64))
    return np.concatenate([frame[..., :3], (frame[..., 3] - shift)[..., None]], axis=-1)


def to_world(local: ArrayLike, parents: NDArray[Any]) -> Array:
    """The joints' transforms G (..., B, 3, 4) to the world, given those relative to the parent."""
    frame = np.array(local, dtype=np.float64)
    for b in parents_first(parents):
        a = int(parents[b])
        if a >= 0:
            above = frame[..., a, :, :]
            moved = np.einsum("...ij,...j->...i", above[..., :3], frame[..., b, :, 3])
            frame[..., b, :, :3] = above[..., :3] @ frame[..., b, :, :3]
            frame[..., b, :, 3] = moved + above[..., 3]
    return frame


def rest_offsets(parents: NDArray[Any], positions: ArrayLike) -> Array:
    """Offsets (B, 3) of joints from their parents' joints in the rest pose.

    The offset of a root is its position.
    """
    c = np.asarray(positions, dtype=np.float64)
    return np.asarray(c - np.where((np.asarray(parents) >= 0)[:, None], c[parents], 0.0))


def translating(
    transforms: ArrayLike, parents: NDArray[Any], positions: ArrayLike, diagonal: float
) -> NDArray[np.bool_]:
    """Mask (B,) of joints that leave their place on the parent, and roots that move, in some frame.

    Parameters
    ----------
    transforms : (F, B, 3, 4) array
    parents, positions : (B,), (B, 3) arrays
    diagonal : float
        Diagonal of the mesh.  A distance up to a millionth of it counts as no translation.
    """
    m, c = np.asarray(transforms, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    off = joint_gaps(m, parents, c)
    for b in np.flatnonzero(np.asarray(parents) < 0):
        off[:, b] = np.linalg.norm(m[:, b, :, :3] @ c[b] + m[:, b, :, 3] - c[b], axis=-1)
    return np.asarray((off > RIGID * diagonal).any(axis=0))


def rest_diagonal(rest: ArrayLike) -> float:
    """Diagonal of the rest pose's bounding box."""
    return float(np.linalg.norm(np.ptp(np.asarray(rest, dtype=np.float64), axis=0)))


def joint_gaps(transforms: ArrayLike, parents: NDArray[Any], positions: ArrayLike) -> Array:
    """Distances (..., B) between the points to which bone and parent move a joint; 0 at roots."""
    m = np.asarray(transforms, dtype=np.float64)
    above = np.where(np.asarray(parents) >= 0, parents, np.arange(len(parents)))
    apart = m - m[..., above, :, :]
    gap = np.einsum("...bij,bj->...bi", apart[..., :3], np.asarray(positions, dtype=np.float64))
    return np.asarray(np.linalg.norm(gap + apart[..., 3], axis=-1))


def local_of_pose(
    parents: NDArray[Any], positions: NDArray[Any], rotations: ArrayLike, root: ArrayLike | None
) -> Array:
    """Local transforms (f, B, 3, 4) of f poses, from local rotations and the offsets at rest.

    `rotations` are matrices or quaternions.  `root` are the positions of the roots; None stands for
    those at rest.
    """
    n_bones = len(parents)
    wanted = f"shape (f, {n_bones}, 3, 3) or (f, {n_bones}, 4)"
    turn = as_array(rotations, "local_rotations", "rotations of the joints")
    if turn.dtype.kind not in "fiu":
        raise InputError("local_rotations", "real numbers", f"dtype {turn.dtype}")
    if turn.shape in ((n_bones, 4), (n_bones, 3, 3)):
        turn = turn[None]
    if not len(turn) or turn.shape[1:] not in ((n_bones, 4), (n_bones, 3, 3)):
        raise InputError("local_rotations", wanted, f"shape {turn.shape}")
    if turn.ndim == 3:
        length = np.linalg.norm(turn, axis=-1)
        off = np.abs(length - 1).max()
        turn = turn if not off < 1e-4 else matrix_from_quaternion(turn)
    else:
        off = np.abs(np.swapaxes(turn, -1, -2) @ turn - np.eye(3)).max()
        if off < 1e-4 and not (np.linalg.det(turn) > 0).all():
            raise InputError("local_rotations", "rotations", "a reflection")
    if not off < 1e-4:
        raise InputError("local_rotations", "rotations", f"off orthonormal by {off:.3g}")
    hung = np.asarray(parents) >= 0
    local = np.empty((len(turn), n_bones, 3, 4))
    local[..., :3] = turn
    local[..., 3] = rest_offsets(parents, positions)
    if root is not None:
        where = as_array(root, "root", "positions of the roots")
        shape = (len(turn), int((~hung).sum()), 3)
        if where.shape not in (shape, shape[1:] if len(turn) == 1 else shape):
            raise InputError("root", f"shape {shape}", f"shape {where.shape}")
        if where.dtype.kind not in "fiu" or not np.isfinite(where).all():
            raise InputError("root", "finite real numbers", "NaN, Inf or another kind")
        local[..., 3][:, ~hung] = where
    return local
