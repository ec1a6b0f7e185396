"""Methods of models whose bones may have parents and joints."""

from __future__ import annotations

import dataclasses
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.errors import InputError
from ..mesh.clips import Clip
from .transforms import from_local, joint_gaps, local_of_pose, to_local


class Articulated:
    """Base class of models whose bones may have parents and joints."""

    transforms: Any
    parents: Any
    joint_positions: Any
    fps: float
    name: str

    def local_transforms(self) -> NDArray[np.float64]:
        """``(F, B, 3, 4)`` transforms of the joints relative to the joints of their parents.

        A joint's coordinate system has its origin at the joint and, in the rest pose, the axes of
        the world.  The transform of a root is relative to the world.

        Raises
        ------
        InputError
            If the bones have no hierarchy.

        Examples
        --------
        >>> rest, indices, weights = np.eye(3), np.array([[0], [1], [1]]), np.ones((3, 1))
        >>> tree = {"parents": [-1, 0], "joint_positions": [[0, 0, 0], [0, 1, 0]]}
        >>> still = np.broadcast_to(np.eye(3, 4), (5, 2, 3, 4))
        >>> arm = ssdr.Skinning(rest, indices, weights, still, **tree)
        >>> arm.local_transforms()[0, 1, :, 3]
        array([0., 1., 0.])
        """
        parents, positions = self._hierarchy("local_transforms")
        return to_local(self.transforms, parents, positions)

    def joint_gaps(self) -> NDArray[np.float64]:
        """Distances ``(F, B)`` between the points to which a bone and its parent move their joint.

        They are 0 at roots, and 0 up to rounding where the joints are rigid.

        Raises
        ------
        InputError
            If the bones have no hierarchy.

        Examples
        --------
        >>> rest, indices, weights = np.eye(3), np.array([[0], [1], [1]]), np.ones((3, 1))
        >>> apart = np.array(np.broadcast_to(np.eye(3, 4), (5, 2, 3, 4)))
        >>> apart[4, 1, :, 3] = [0, 0.5, 0]
        >>> tree = {"parents": [-1, 0], "joint_positions": np.zeros((2, 3))}
        >>> ssdr.Skinning(rest, indices, weights, apart, **tree).joint_gaps().max()
        0.5
        """
        parents, positions = self._hierarchy("joint_gaps")
        return joint_gaps(self.transforms, parents, positions)

    def pose(self, local_rotations: ArrayLike, root: ArrayLike | None = None) -> Self:
        """A copy of the model with a new motion, given as rotations of its joints.

        Parameters
        ----------
        local_rotations : (f, B, 3, 3) or (f, B, 4) array
            Rotation of each joint relative to its parent, as a matrix or a unit quaternion xyzw.
            The first axis may be left out for a single frame.
        root : (f, R, 3) array, optional
            Positions of the joints of the R roots, in the order of the bones;
            those of the rest pose by default.

        Returns
        -------
        Skinning
            With f frames, all of them keys of one clip.

        Raises
        ------
        InputError
            If the bones have no hierarchy, shapes do not match or a matrix or
            quaternion is no rotation.

        Examples
        --------
        >>> rest, indices, weights = np.eye(3), np.array([[0], [1], [1]]), np.ones((3, 1))
        >>> tree = {"parents": [-1, 0], "joint_positions": [[0, 0, 0], [0, 1, 0]]}
        >>> still = np.broadcast_to(np.eye(3, 4), (5, 2, 3, 4))
        >>> arm = ssdr.Skinning(rest, indices, weights, still, **tree)
        >>> half = np.sqrt(0.5)
        >>> bent = arm.pose([[0, 0, 0, 1], [half, 0, 0, half]])
        >>> bent.skin()[0, 2].round(3)
        array([0., 0., -1.])
        """
        parents, positions = self._hierarchy("pose")
        local = local_of_pose(parents, positions, local_rotations, root)
        moved = from_local(local, parents, positions).astype(self.transforms.dtype)
        one = (Clip(self.name, 0, len(moved), self.fps),)
        model: Any = self  # a dataclass, as the classes derived from this one are
        return dataclasses.replace(  # type: ignore[no-any-return]
            model, transforms=moved, keyframes=None, clips=one
        )

    def _hierarchy(self, what: str) -> tuple[NDArray[np.int32], NDArray[np.floating]]:
        if self.parents is None:
            raise InputError(
                "parents",
                f"a hierarchy for {what}: decompose(..., rig='rigid') finds one",
                "bones without one",
            )
        return self.parents, self.joint_positions
