"""Poses of a body over time, from the generator of dances or from motion capture (BVH)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from garmentnet.data.clip import CLASSES
from garmentnet.data.skeleton import Skeleton, check_joints
from ssdr.common.errors import InputError


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """A body's pose over time.

    Parameters
    ----------
    joints : (F, J, 3, 4) float array
        World transforms from the rest pose to the pose of each frame, rigid.
    classes : (F,) int array
        Class of motion of each frame, an index into :data:`garmentnet.data.clip.CLASSES`.
    fps : float

    Raises
    ------
    InputError
        If shapes do not match, a number is not finite or a transform is not rigid.

    Examples
    --------
    >>> still = Motion(np.tile(np.eye(3, 4), (10, 2, 1, 1)), np.zeros(10, int))
    >>> still.n_frames, still.cut(2, 5).n_frames
    (10, 3)
    """

    joints: NDArray[np.float64]
    classes: NDArray[np.int8]
    fps: float = 30.0

    def __post_init__(self) -> None:
        shape = np.shape(self.joints)
        joints = check_joints(self.joints, shape[1] if len(shape) == 4 else 1)
        classes = np.asarray(self.classes, dtype=np.int8)
        if classes.shape != (len(joints),) or classes.min() < 0 or classes.max() >= len(CLASSES):
            raise InputError("classes", f"{len(joints)} indices below {len(CLASSES)}", classes)
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise InputError("fps", "a positive number", self.fps)
        object.__setattr__(self, "joints", joints)
        object.__setattr__(self, "classes", classes)

    @property
    def n_frames(self) -> int:
        return len(self.joints)

    def cut(self, start: int, stop: int) -> Motion:
        """Motion with the frames from `start` up to, but not including, `stop`."""
        if not 0 <= start < stop <= self.n_frames:
            raise InputError("start, stop", f"0 to {self.n_frames}", (start, stop))
        return Motion(self.joints[start:stop], self.classes[start:stop], self.fps)


def interpolate(
    skeleton: Skeleton, joints: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """World transforms ``(n, J, 3, 4)`` at fractional frames `at`.

    The root moves linearly and every rotation relative to the parent by slerp, so that no limb
    changes its length between frames.

    Examples
    --------
    >>> body = Skeleton(("root",), [-1], [[0, 0, 0]])
    >>> joints = np.tile(np.eye(3, 4), (2, 1, 1, 1))
    >>> joints[1, 0, :, 3] = [1, 0, 0]
    >>> interpolate(body, joints, np.array([0.25]))[0, 0, :, 3].tolist()
    [0.25, 0.0, 0.0]
    """
    count = len(joints)
    at = np.clip(np.asarray(at, dtype=np.float64), 0, count - 1)
    root, local = skeleton.pose(joints)
    if count == 1 or not len(at):
        return np.repeat(joints[:1], len(at), axis=0)
    frames = np.arange(count)
    place = np.stack([np.interp(at, frames, root[:, c]) for c in range(3)], axis=1)
    turned = np.empty((len(at), skeleton.n_joints, 3, 3))
    for j in range(skeleton.n_joints):
        turned[:, j] = Slerp(frames, Rotation.from_matrix(local[:, j]))(at).as_matrix()
    return skeleton.transforms(place, turned)
