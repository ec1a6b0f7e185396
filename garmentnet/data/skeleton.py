"""A body's skeleton: hierarchy and rest positions of its joints, and conversion of poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssdr.common.errors import InputError
from ssdr.model.transforms import from_local, local_of_pose, to_local

# Largest entry of |RRᵀ − I| that still counts as a rotation; text files round to few digits.
_ORTHOGONAL = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints in the rest pose, with axes aligned with those of the world.

    Parameters
    ----------
    names : tuple of str
        Names of the joints; those of left and right ones end in ``_l`` and ``_r``.
    parents : (J,) int array
        The parent of every joint, which comes before it; -1 for the root, the first.
    rest : (J, 3) float array
        Positions in the rest pose, metres, y up.

    Raises
    ------
    InputError
        If shapes do not match or a parent does not come before its child.

    Examples
    --------
    >>> arm = Skeleton(("upper", "fore"), [-1, 0], [[0, 1, 0], [1, 1, 0]])
    >>> arm.n_joints, arm.names.index("fore")
    (2, 1)
    """

    names: tuple[str, ...]
    parents: NDArray[np.int32]
    rest: NDArray[np.float64]

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "names", tuple(str(n) for n in self.names))
        count = len(self.names)
        if count == 0 or len(set(self.names)) != count:
            raise InputError("names", "one or more names, no two the same", self.names)
        parents = np.asarray(self.parents, dtype=np.int32)
        if parents.shape != (count,) or parents[0] != -1:
            raise InputError("parents", f"{count} indices, the first -1", parents)
        for j in range(1, count):
            if not 0 <= parents[j] < j:
                raise InputError("parents", f"an index from 0 to {j - 1} at {j}", parents[j])
        rest = np.asarray(self.rest, dtype=np.float64)
        if rest.shape != (count, 3) or not np.isfinite(rest).all():
            raise InputError("rest", f"finite numbers of shape ({count}, 3)", f"{rest.shape}")
        put(self, "parents", parents)
        put(self, "rest", rest)

    @property
    def n_joints(self) -> int:
        return len(self.names)

    def read(self, names: Sequence[str]) -> list[int]:
        """Numbers of the joints that features read, ascending: those named, or all.

        The root's rotation says which way is down; it is read in any case.

        Raises
        ------
        InputError
            If there is no joint of a name.
        """
        missing = [n for n in names if n not in self.names]
        if missing:
            expected = f"joints of the body ({', '.join(self.names)})"
            raise InputError("features.joints", expected, ", ".join(missing))
        return sorted({0, *map(self.names.index, names or self.names)})

    def mirror(self) -> NDArray[np.int32]:
        """Index ``(J,)`` of the mirror image of each joint; the joint itself if there is none."""
        other, number = {"_l": "_r", "_r": "_l"}, {n: j for j, n in enumerate(self.names)}
        return np.array(
            [number.get(n[:-2] + other.get(n[-2:], n[-2:]), j) for n, j in number.items()],
            dtype=np.int32,
        )

    def transforms(self, root: ArrayLike, rotations: ArrayLike) -> NDArray[np.float64]:
        """World transforms of a pose.

        Parameters
        ----------
        root : (F, 3) array
            Position of the root joint.
        rotations : (F, J, 3, 3) array
            Rotation of every joint relative to its parent, in the axes of the rest pose; the
            root's is that of the body in the world.

        Returns
        -------
        (F, J, 3, 4) float64
            ``[R | T]`` from the rest pose to the pose.

        Examples
        --------
        >>> arm = Skeleton(("upper", "fore"), [-1, 0], [[0, 1, 0], [1, 1, 0]])
        >>> still = np.tile(np.eye(3), (1, 2, 1, 1))
        >>> arm.transforms([[0, 3, 0]], still)[0, 1, :, 3].tolist()
        [0.0, 2.0, 0.0]
        """
        place = np.asarray(root, dtype=np.float64)[:, None]
        local = local_of_pose(self.parents, self.rest, rotations, place)
        return from_local(local, self.parents, self.rest)

    def positions(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Positions ``(F, J, 3)`` of the joints under world transforms ``(F, J, 3, 4)``.

        Examples
        --------
        >>> arm = Skeleton(("upper", "fore"), [-1, 0], [[0, 1, 0], [1, 1, 0]])
        >>> arm.positions(np.eye(3, 4)[None, None].repeat(2, axis=1))[0, 1].tolist()
        [1.0, 1.0, 0.0]
        """
        m = check_joints(joints, self.n_joints)
        return np.asarray(np.einsum("fjab,jb->fja", m[..., :3], self.rest) + m[..., 3])

    def pose(self, joints: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Root positions ``(F, 3)`` and relative rotations ``(F, J, 3, 3)`` of world transforms.

        The inverse of :meth:`transforms`.

        Examples
        --------
        >>> arm = Skeleton(("upper", "fore"), [-1, 0], [[0, 1, 0], [1, 1, 0]])
        >>> root, rotations = arm.pose(np.tile(np.eye(3, 4), (5, 2, 1, 1)))
        >>> root[0].tolist(), rotations.shape
        ([0.0, 1.0, 0.0], (5, 2, 3, 3))
        """
        local = to_local(check_joints(joints, self.n_joints), self.parents, self.rest)
        return local[:, 0, :, 3], local[..., :3]


def mirror_transforms(joints: ArrayLike, mirror: ArrayLike) -> NDArray[np.floating]:
    """World transforms ``(F, J, 3, 4)`` reflected in x: S M S, with M of the mirrored joint.

    They stay rigid, since the reflection S is applied twice.

    Examples
    --------
    >>> moved = np.eye(3, 4)[None, None] + [0, 0, 0, 1]
    >>> mirror_transforms(moved, [0])[0, 0, :, 3].tolist()
    [-1.0, 1.0, 1.0]
    """
    m = np.asarray(joints)[:, np.asarray(mirror)]
    sign = np.outer([-1, 1, 1], [-1, 1, 1, 1]).astype(m.dtype)
    return np.asarray(m * sign)


def check_joints(joints: ArrayLike, n_joints: int) -> NDArray[np.float64]:
    """Joint transforms as float64 ``(F, J, 3, 4)``.

    Raises
    ------
    InputError
        If the shape does not fit, a number is not finite or a 3×3 block is not a
        rotation; the message names frame and joint.

    Examples
    --------
    >>> check_joints(np.eye(3, 4)[None, None], 1).shape
    (1, 1, 3, 4)
    >>> check_joints(2 * np.eye(3, 4)[None, None], 1)
    Traceback (most recent call last):
    ssdr.InputError: joints: expected rigid transforms, got no rotation at frame 0, joint 0
    """
    try:
        m = np.asarray(joints, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("joints", f"numbers (F, {n_joints}, 3, 4)", repr(joints)[:40]) from error
    if m.ndim != 4 or m.shape[1:] != (n_joints, 3, 4) or not len(m):
        raise InputError("joints", f"shape (F, {n_joints}, 3, 4)", f"shape {m.shape}")
    bad = ~np.isfinite(m).all(axis=(2, 3))
    if bad.any():
        t, j = (int(k) for k in np.argwhere(bad)[0])
        raise InputError("joints", "finite numbers", f"NaN or Inf at frame {t}, joint {j}")
    r = m[..., :3]
    off = np.abs(r @ r.swapaxes(-1, -2) - np.eye(3)).max(axis=(2, 3))
    bad = (off > _ORTHOGONAL) | (np.linalg.det(r) < 0)
    if bad.any():
        t, j = (int(k) for k in np.argwhere(bad)[0])
        raise InputError("joints", "rigid transforms", f"no rotation at frame {t}, joint {j}")
    return m


def check_finite(values: NDArray[np.floating], what: str) -> None:
    """Check that every number is finite.

    Parameters
    ----------
    values : (F, ...) array
    what : str
        Name of the array, for the error.

    Raises
    ------
    InputError
        If a number is not finite; the message names the first frame with NaN or Inf.

    Examples
    --------
    >>> check_finite(np.zeros((2, 4, 3)), "vertices")
    """
    bad = ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
    if bad.any():
        raise InputError(what, "finite numbers", f"NaN or Inf in frame {bad.argmax()}")
