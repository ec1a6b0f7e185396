"""Clips of the paper's VirtualBonesDataset as a store: ``published_data.py dress02 a.clips``.

A folder holds ``template.obj`` and, for every clip, a ``.npz`` with ``pose`` (F, 52, 3), rotation
vectors of SMPL-H's joints, ``trans`` (F, 3) and ``sim_res`` (F, V, 3).  Of ten clips one is for
testing and one for validation.  Tried on files of that layout, not on the data itself.
"""

import sys
import tomllib
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr
from garmentnet.data.outfit import Outfit
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.skeleton import Skeleton
from garmentnet.data.store import ClipStore
from garmentnet.importing.rig import bare_body

source, target = map(Path, sys.argv[1:])
table = tomllib.loads(Path(__file__).with_name("smplh.toml").read_text())["joint"]
names, parents, rest = zip(*((j["name"], j["parent"], j["rest"]) for j in table), strict=True)
skeleton = Skeleton(names, parents, rest)
mesh, body = ssdr.load(source / "template.obj"), bare_body(skeleton.rest, names)
store = ClipStore.create(target, Outfit(mesh.vertices[0], mesh.faces, body, skeleton, fps=30.0))
for k, file in enumerate(sorted(source.glob("*.npz"), key=lambda f: (len(f.stem), f.stem))):
    clip, split = np.load(file), {8: "validation", 9: "test"}.get(k % 10, "train")
    turn = Rotation.from_rotvec(clip["pose"].reshape(-1, 3)).as_matrix().reshape(-1, 52, 3, 3)
    joints = skeleton.transforms(skeleton.rest[0] + clip["trans"], turn)
    store.add(
        file.stem, vertices=clip["sim_res"], joints=joints, split=split, motion=file.stem,
        parameters=SimulationParameters(), provenance={"parameter_set": "published"},
    )  # fmt: skip
