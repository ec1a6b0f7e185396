"""Motions from files: rigs, arrays, and clips of a store."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError
from ssdr.io.arrays.array_files import read_arrays
from ssdr.io.file_errors import check, reading

from ..data.clip import Clip
from ..data.skeleton import check_joints
from ..data.store import OUTFIT, ClipStore
from ..data.subject import Subject
from ..importing.rig import rig_of
from ..importing.scene_files import RIGS, Source, read_rig


def read_motion(path: Path | str, subject: Subject) -> tuple[NDArray[np.float64], Clip | None]:
    """Joint transforms of a motion for a network's body, at its frame rate, and the clip.

    Parameters
    ----------
    path : path
        ``.npz`` with an array ``joints`` ``(F, J, 3, 4)`` and, if it is known, ``fps``; the file of
        a clip in a store; or a ``.fbx``, ``.glb`` or ``.usd*`` whose rig has the joints and the
        bind pose of the network's, and of whose animations, if there are several, one is named like
        the file.

    Returns
    -------
    joints : (F, J, 3, 4) float64
    clip : Clip or None
        The simulated clip, if the path is one.

    Raises
    ------
    InputError
        If there is no such file, a clip is of another garment, body or frame rate than the
        network, or a rig is another or has several animations, none named like the file.
    FormatError
        If the file is damaged, of an unknown kind, or has the joints of another body or another
        frame rate.
    """
    file = Path(path)
    if not file.exists():
        raise InputError("motion", "a .fbx, .glb, .usd or .npz, or a clip", str(file))
    folder = file.absolute().parent
    if folder.name == "clips" and (folder.parent / OUTFIT).is_file():
        store = ClipStore.open(folder.parent)
        subject.check_fits(store)
        clip = store.clip(file.stem)
        return np.asarray(clip.joints, np.float64), clip
    if file.suffix.lower() in RIGS:
        try:
            rig = rig_of(read_rig(file, Source(), subject.fps, file.stem, lambda _: None))
            return rig.matched(subject.skeleton, subject.body).joints, None
        except InputError as error:
            raise InputError("motion", error.expected, f"{error.got} ({file.name})") from error
    arrays = read_arrays(file, required=("joints",), optional=("fps",))
    with reading(file):
        fps = subject.fps
        check(arrays.get("fps", fps) == fps, f"not the network's {fps:g} fps")
        return check_joints(arrays["joints"], subject.skeleton.n_joints), None
