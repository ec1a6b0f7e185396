"""Import of the paper's own data, ``VirtualBonesDataset``: clips of a dress on an SMPL-H body.

A folder holds ``template.obj``, the dress at rest, and a ``.npz`` for every clip with ``pose``
(F, 52, 3), rotation vectors of the joints relative to their parents; ``trans`` (F, 3), the body's
translation; and ``sim_res`` (F, V, 3), the simulated dress.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr
from ssdr import Skinning
from ssdr.errors import InputError
from ssdr.io.arrays.archive import read_arrays
from ssdr.io.atomic import check_writable

from ..data.clip_files import Split
from ..data.motion import CLASSES
from ..data.parameters import SimulationParameters
from ..data.skeleton import Skeleton
from ..data.store import ClipStore
from ..io.files import writing
from .scene_files import Say

_FINGERS = ("index", "middle", "pinky", "ring", "thumb")
# Name, parent and place (m, T-pose, y up, the pelvis near the origin) of the body's joints.  The
# data set does not state places.  These are an adult's, to about a centimetre; a network reads the
# joints' rotations and the root's motion, on which they have no influence.
_BODY = (
    ("pelvis", -1, 0.0, -0.24, 0.03),
    ("hip_l", 0, 0.06, -0.33, 0.01),
    ("hip_r", 0, -0.06, -0.33, 0.01),
    ("spine1", 0, 0.0, -0.13, 0.0),
    ("knee_l", 1, 0.11, -0.70, 0.01),
    ("knee_r", 2, -0.11, -0.70, 0.01),
    ("spine2", 3, 0.0, 0.0, 0.0),
    ("ankle_l", 4, 0.09, -1.11, -0.03),
    ("ankle_r", 5, -0.09, -1.11, -0.03),
    ("spine3", 6, 0.0, 0.05, 0.03),
    ("foot_l", 7, 0.12, -1.16, 0.09),
    ("foot_r", 8, -0.12, -1.16, 0.09),
    ("neck", 9, 0.0, 0.26, -0.01),
    ("collar_l", 9, 0.08, 0.17, 0.0),
    ("collar_r", 9, -0.08, 0.17, 0.0),
    ("head", 12, 0.0, 0.33, 0.04),
    ("shoulder_l", 13, 0.17, 0.21, -0.01),
    ("shoulder_r", 14, -0.17, 0.21, -0.01),
    ("elbow_l", 16, 0.43, 0.19, -0.03),
    ("elbow_r", 17, -0.43, 0.19, -0.03),
    ("wrist_l", 18, 0.68, 0.20, -0.03),
    ("wrist_r", 19, -0.68, 0.20, -0.03),
)
_REACH = (0.10, 0.13, 0.155)  # distance of a finger's joints from the wrist, metres
_SHORTEST = 2  # frames of a clip


def smplh_skeleton() -> Skeleton:
    """The 52 joints of SMPL-H: 22 of the body, then 15 of the left and of the right hand.

    Examples
    --------
    >>> s = smplh_skeleton()
    >>> s.n_joints, s.names[0], s.names[s.parents[22]]
    (52, 'pelvis', 'wrist_l')
    """
    names = [row[0] for row in _BODY]
    parents = [row[1] for row in _BODY]
    rest = [row[2:] for row in _BODY]
    for wrist, side in ((20, 1.0), (21, -1.0)):
        x, y, z = rest[wrist]
        for k, finger in enumerate(_FINGERS):
            for n, reach in enumerate(_REACH):
                parents.append(len(names) - 1 if n else wrist)
                names.append(f"{finger}{n + 1}_{'l' if side > 0 else 'r'}")
                rest.append((x + side * reach, y, z + 0.02 * (2 - k)))
    return Skeleton(tuple(names), np.array(parents, np.int32), np.array(rest))


def import_published(
    folder: Path | str,
    path: Path | str,
    *,
    fps: float = 30.0,
    test: Sequence[str] = (),
    validation: Sequence[str] = (),
    say: Say = lambda _: None,
) -> ClipStore:
    """Add the clips of a folder of the published data set to a store, which is made if need be.

    Clips that are in the store already are not added again.

    Parameters
    ----------
    folder : path
        Such as ``VirtualBonesDataset/dress02``.
    path : path
        Path of the store.
    fps : float
        Frame rate, which the data set does not state.
    test, validation : sequence of str
        Names of the clips of these splits, such as ``"88"``.  By default every tenth clip is for
        testing and the one before it for validation, in the order of their numbers.
    say : callable, optional
        Called with a sentence for each clip.

    Raises
    ------
    InputError
        If the folder has no template or no clip, a name is none of its clips, or the store is of
        another garment.
    FormatError
        If a clip lacks an array or one has another shape.
    """
    source, target = Path(folder), Path(path)
    template = source / "template.obj"
    files = sorted(source.glob("*.npz"), key=lambda f: (len(f.stem), f.stem))
    if not (template.is_file() and files):
        raise InputError("data", "a folder with template.obj and clips as .npz", str(source))
    names = [f.stem for f in files]
    for name in (*test, *validation):
        if name not in names:
            raise InputError("test, validation", f"some of {', '.join(names)}", name)
    test = test or names[9::10] or names[-1:]
    validation = validation or [n for n in names[8::10] if n not in test]
    if not target.exists():
        with writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            check_writable(target)
    mesh, skeleton = ssdr.load(template), smplh_skeleton()
    still = np.tile(np.eye(3, 4), (1, skeleton.n_joints, 1, 1))
    each = np.arange(skeleton.n_joints)[:, None]
    body = Skinning(
        skeleton.rest, each, np.ones(each.shape), still, bone_names=skeleton.names, name="body"
    )
    store = ClipStore.create(
        target,
        rest=mesh.vertices[0],
        faces=mesh.faces,
        body=body,
        skeleton=skeleton,
        fps=fps,
    )
    store.sweep()
    for file in files:
        if file.stem in store:
            continue
        split: Split = "train"
        if file.stem in test:
            split = "test"
        elif file.stem in validation:
            split = "validation"
        _add(store, file, split)
        say(f"{file.name}: {store.clip(file.stem).n_frames} frames, {split}")
    return store


def _add(store: ClipStore, file: Path, split: Split) -> None:
    found = read_arrays(file, required=("pose", "trans", "sim_res"), optional=())
    frames = len(found["sim_res"])
    joints, count = store.skeleton.n_joints, store.n_vertices
    shapes = {"pose": (frames, joints, 3), "trans": (frames, 3), "sim_res": (frames, count, 3)}
    for key, shape in shapes.items():
        if found[key].shape != shape or frames < _SHORTEST:
            raise InputError(f"{key} of {file.name}", f"shape {shape}", found[key].shape)
    v = found["sim_res"].astype(np.float32)
    turn = Rotation.from_rotvec(found["pose"].reshape(-1, 3)).as_matrix()
    m = store.skeleton.transforms(
        store.skeleton.rest[0] + found["trans"], turn.reshape(frames, joints, 3, 3)
    )
    store.add(
        file.stem,
        vertices=v,
        joints=m,
        classes=np.full(frames, CLASSES.index("recorded")),
        split=split,
        motion=file.stem,
        parameters=SimulationParameters(),
        seed=0,
        quality={"accepted": True, "reason": ""},
        provenance={
            "cloth": file.name,
            "parameter_set": "published",
            "sha256": hashlib.sha256(v.tobytes()).hexdigest(),
        },
    )
