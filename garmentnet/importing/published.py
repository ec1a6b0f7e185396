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
from ssdr.common.errors import InputError
from ssdr.io.arrays.array_files import read_arrays

from ..data.clip_files import Split
from ..data.parameters import SimulationParameters
from ..data.skeleton import Skeleton
from ..data.store import ClipStore
from ..io.tables import read_toml
from .rig import bare_body
from .scene_files import Say

_SHORTEST = 2  # frames of a clip


def smplh_skeleton() -> Skeleton:
    """The 52 joints of SMPL-H: 22 of the body, then 15 of the left and of the right hand.

    Examples
    --------
    >>> s = smplh_skeleton()
    >>> s.n_joints, s.names[0], s.names[s.parents[22]]
    (52, 'pelvis', 'wrist_l')
    """
    joints = read_toml(Path(__file__).with_name("smplh.toml"))["joint"]
    names, parents, rest = ([j[key] for j in joints] for key in ("name", "parent", "rest"))
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
    mesh, skeleton = ssdr.load(template), smplh_skeleton()
    store = ClipStore.create(
        target,
        rest=mesh.vertices[0],
        faces=mesh.faces,
        body=bare_body(skeleton.rest, skeleton.names),
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
        split=split,
        motion=file.stem,
        parameters=SimulationParameters(),
        provenance={
            "cloth": file.name,
            "parameter_set": "published",
            "sha256": hashlib.sha256(v.tobytes()).hexdigest(),
        },
    )
