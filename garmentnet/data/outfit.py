"""A garment on a body at rest, which all clips of a store share."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.checks import check_mask
from ssdr.model.skinning import Skinning

from .skeleton import Skeleton


@dataclasses.dataclass(frozen=True, eq=False)
class Outfit:
    """A garment on a body, at rest.

    Attributes
    ----------
    rest : (V, 3) float32
        The garment as it was cut, on the body at rest; metres.
    faces : (T, 3) int32
    body : ssdr.Skinning
        The body as a skinned collider: rest pose, weights and names of the joints; one frame, at
        rest.
    skeleton : Skeleton
    fps : float
        Frames a second of every clip.
    pinned : (V,) bool
        Vertices that follow the body.
    mirror_vertices : (V,) int32 or None
        Mirror image of each vertex of the garment; None if it is not symmetric.
    """

    rest: NDArray[np.float32]
    faces: NDArray[np.int32]
    body: Skinning
    skeleton: Skeleton
    fps: float
    pinned: Any = None
    mirror_vertices: Any = None

    def __post_init__(self) -> None:
        put, mirror = object.__setattr__, self.mirror_vertices
        put(self, "rest", np.asarray(self.rest, np.float32))
        put(self, "faces", np.asarray(self.faces, np.int32))
        put(self, "pinned", check_mask(self.pinned, "pinned", len(self.rest)))
        put(self, "mirror_vertices", None if mirror is None else np.asarray(mirror, np.int32))

    @property
    def n_vertices(self) -> int:
        return len(self.rest)

    @property
    def garment_id(self) -> str:
        """Hash of the garment's mesh."""
        return mesh_identity(self.rest, self.faces)

    @property
    def body_id(self) -> str:
        """Hash of the body."""
        return body_identity(self.body, self.skeleton)

    def is_like(self, other: Outfit) -> bool:
        """Whether garment, body, skeleton and frame rate are the same."""
        same = all(getattr(self, k) == getattr(other, k) for k in ("fps", "garment_id", "body_id"))
        return same and np.array_equal(self.pinned, other.pinned)


def is_mirror(mirror: NDArray[np.integer], faces: NDArray[np.integer], count: int) -> bool:
    """Whether a permutation of `count` vertices, its own inverse, maps triangles to triangles."""
    if mirror.shape != (count,) or not np.array_equal(np.sort(mirror), np.arange(count)):
        return False
    own, turned = ({tuple(sorted(f)) for f in some.tolist()} for some in (faces, mirror[faces]))
    return own == turned and np.array_equal(mirror[mirror], np.arange(count))


def neighbours(faces: Any, count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Neighbours of every vertex along the mesh's edges, in compressed rows.

    Those of vertex v are ``others[starts[v] : starts[v + 1]]``; `count` is the number of vertices.

    Examples
    --------
    >>> starts, others = neighbours([[0, 1, 2]], 4)
    >>> starts.tolist(), others.tolist()
    ([0, 2, 4, 6, 6], [1, 2, 0, 2, 0, 1])
    """
    f = np.asarray(faces)
    pairs = np.concatenate([f[:, [a, b]] for a in range(3) for b in range(3) if a != b])
    pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
    starts = np.searchsorted(pairs[:, 0], np.arange(count + 1)).astype(np.int32)
    return starts, np.ascontiguousarray(pairs[:, 1], dtype=np.int32)


def body_identity(body: Skinning, skeleton: Skeleton) -> str:
    """Hash of a body's mesh, weights and skeleton."""
    mesh, names = (body.rest, body.indices, body.weights, body.faces), ",".join(skeleton.names)
    return _digest(*mesh, skeleton.parents, skeleton.rest, names.encode())


def mesh_identity(rest: Any, faces: Any) -> str:
    """Hash of a mesh: equal for equal rest poses (as float32) and triangles.

    Examples
    --------
    >>> mesh_identity([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    '98c4edc67b8ce133'
    """
    return _digest(np.asarray(rest, np.float32), np.asarray(faces, np.int32))


def _digest(*parts: Any) -> str:
    h = hashlib.sha256()
    for part in parts:
        h.update(part if isinstance(part, bytes) else np.ascontiguousarray(part).tobytes())
        h.update(b"|")
    return h.hexdigest()[:16]
