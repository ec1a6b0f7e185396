"""Motions from files: BVH, arrays, and clips of a store."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssdr.errors import FormatError, InputError
from ssdr.io.arrays.archive import read_arrays
from ssdr.io.registry import reading

from ..data.bvh import read_bvh
from ..data.clip import Clip
from ..data.retarget import retarget
from ..data.skeleton import check_joints
from ..data.store import ClipStore
from ..networks.checkpoint import Checkpoint

__all__ = ["read_clip", "read_joints"]


def read_clip(path: Path | str, checkpoint: Checkpoint) -> Clip | None:
    """The simulated clip at a path, or None if the path is another kind of motion.

    Raises
    ------
    InputError
        If the clip has another garment, body or frame rate than the checkpoint, or the store has no
        clip of that name.
    FormatError
        If the store is damaged.
    """
    file = Path(path)
    if not (file.is_dir() and file.parent.name == "clips"):
        return None
    store = ClipStore.open(file.parent.parent)
    checkpoint.check_fits(store)
    return store.clip(file.name)


def read_joints(path: Path | str, checkpoint: Checkpoint) -> NDArray[np.float64]:
    """Joint transforms of a motion file for a checkpoint's body, at its frame rate.

    Parameters
    ----------
    path : path
        ``.bvh`` or ``.bvh.gz``, retargeted by the names of its joints; ``.npz`` with an array
        ``joints`` ``(F, J, 3, 4)``; or the folder of a clip in a store.

    Raises
    ------
    InputError
        If there is no such file.
    FormatError
        If the file is damaged, of an unknown kind, or has the joints of another body.
    """
    file, subject = Path(path), checkpoint.subject
    suffix = file.suffix.lower()
    if not file.exists():
        raise InputError("motion", "a .bvh, a .npz or a clip", str(file))
    if file.name.lower().endswith((".bvh", ".bvh.gz")):
        moved = retarget(read_bvh(file), subject.skeleton, fps=subject.fps)
        return np.asarray(moved.joints, np.float64)
    clip = read_clip(file, checkpoint)
    if clip is not None:
        return np.asarray(clip.joints, np.float64)
    if suffix != ".npz":
        raise FormatError(f"{file}: a motion is a .bvh, a .npz with joints, or a clip of a store")
    joints = np.asarray(read_arrays(file, required=("joints",))["joints"], np.float64)
    with reading(file):
        return check_joints(joints, subject.skeleton.n_joints)
