"""Surface of a mesh beside its triangles, unit and up axis, and vertices that coincide.

Vertices that coincide in every frame, as at seams or in a triangle soup, are solved as one vertex:
solved separately they would drift apart, and the mesh would crack.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..common.checks import check_range
from ..common.errors import InputError, is_real
from ..common.short_repr import short_repr


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Material:
    """Appearance of a surface, in the terms of glTF's metallic-roughness model.

    Attributes
    ----------
    name : str
    base_color : tuple of 4 float
        Linear RGBA in [0, 1].
    metallic, roughness : float
    double_sided : bool
    texture : bytes or None
        The encoded base colour image, which is never decoded or changed.
    texture_type : str
        MIME type of the texture, ``image/png`` or ``image/jpeg``.

    Examples
    --------
    >>> red = ssdr.Material(name="red", base_color=(1, 0, 0, 1))
    >>> red.name, red.texture is None
    ('red', True)
    """

    name: str = "material"
    base_color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    metallic: float = 0.0
    roughness: float = 0.9
    double_sided: bool = False
    texture: bytes | None = None
    texture_type: str = "image/png"

    __repr__ = short_repr


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Surface:
    """Texture coordinates, normals and materials of a mesh, stored per triangle corner.

    Welding keeps these values, since they belong to corners; at a seam, corners at one vertex
    differ.

    Attributes
    ----------
    uv : (T, 3, 2) float32 or None
        Texture coordinates, v upward (as in OBJ and USD; glTF flips it).
    normals : (T, 3, 3) float32 or None
        Unit normals; where corners of one vertex differ there is a hard edge.  Those of a
        :class:`~ssdr.Skinning` belong to its rest pose, and engines skin them with the bones.
        Those of a :class:`~ssdr.MeshSequence` are of the file's reference frame and only show which
        edges are hard.
    colors : (T, 3, 4) float32 or None
        RGBA as a file states it, 0 to 1; glTF takes it as linear.
    material_index : (T,) int32 or None
        Index into `materials`; None means that all triangles use the first.
    materials : tuple of Material

    Examples
    --------
    >>> uv = np.array([[[0, 0], [1, 0], [0, 1]]], np.float32)
    >>> surface = ssdr.Surface(uv=uv)
    >>> ssdr.MeshSequence(np.zeros((2, 3, 3)), [[0, 1, 2]], surface=surface).surface.uv.shape
    (1, 3, 2)
    """

    uv: NDArray[np.float32] | None = None
    normals: NDArray[np.float32] | None = None
    colors: NDArray[np.float32] | None = None
    material_index: NDArray[np.int32] | None = None
    materials: tuple[Material, ...] = ()

    __repr__ = short_repr


def protect(thing: Any) -> None:
    """Make the arrays of a frozen dataclass read-only views: nobody writes through it by mistake.

    The arrays that they view, such as the caller's, stay as they are.
    """
    for name, value in list(vars(thing).items()):
        if type(value) is np.ndarray and value.flags.writeable:
            view = value.view()
            view.flags.writeable = False
            object.__setattr__(thing, name, view)


def as_trimesh(points: NDArray[np.floating], faces: NDArray[np.int32]) -> Any:
    """A ``trimesh.Trimesh`` of copies of the vertices and triangles, in their order."""
    import trimesh

    return trimesh.Trimesh(np.array(points, dtype=np.float64), faces.copy(), process=False)


def check_surface(surface: Surface, n_faces: int) -> Surface:
    if not isinstance(surface, Surface):
        raise InputError("surface", "a Surface or None", type(surface).__name__)
    tails = {"uv": (3, 2), "normals": (3, 3), "colors": (3, 4), "material_index": ()}
    for field, tail in tails.items():
        array = getattr(surface, field)
        if array is not None and np.shape(array) != (n_faces, *tail):
            raise InputError(
                f"surface.{field}", f"shape {(n_faces, *tail)}", f"shape {np.shape(array)}"
            )
    if surface.material_index is not None:
        count = max(1, len(surface.materials))
        check_range(surface.material_index, "surface.material_index", count)
    return surface


Up = Literal["y", "z"]
Rows = NDArray[np.intp]


@dataclasses.dataclass(frozen=True)
class Space:
    """Unit and up axis of coordinates, as far as they are known.

    Parameters
    ----------
    units : float, optional
        Metres in a unit of length: 0.01 for centimetres. None: not known.
    up : {"y", "z"}, optional
        Up axis. None: not known.

    Raises
    ------
    InputError
        If `units` is not a positive number, or `up` is another axis.

    Examples
    --------
    >>> print(ssdr.Space(0.01, "z"))
    0.01 m a unit, z up
    >>> print(ssdr.Space())
    unit not stated, up axis not stated
    """

    units: float | None = None
    up: Up | None = None

    def __post_init__(self) -> None:
        if self.units is not None and not (is_real(self.units) and self.units > 0):
            raise InputError("units", "metres in a unit, a positive number", repr(self.units))
        if self.up not in ("y", "z", None):
            raise InputError("up", '"y", "z" or None', repr(self.up))

    def __str__(self) -> str:
        unit = f"{self.units:g} m a unit" if self.units else "unit not stated"
        return f"{unit}, {f'{self.up} up' if self.up else 'up axis not stated'}"

    def but(self, other: Space) -> Space:
        """Space with unit and up axis of `other` where these are known, otherwise of this one."""
        return Space(other.units or self.units, other.up or self.up)


def check_space(space: object) -> None:
    """Raise an InputError unless `space` is a Space."""
    if not isinstance(space, Space):
        raise InputError("space", "a Space", repr(space))


UNKNOWN = Space()
METRES_Y_UP = Space(1.0, "y")  # the space of glTF, and of files exchanged with Blender


def common_space(spaces: Iterable[Space]) -> Space:
    """Space of several meshes; a unit or up axis in which they differ is unknown."""
    units, up = (set(known) for known in zip(*((s.units, s.up) for s in spaces), strict=True))
    return Space(units.pop() if len(units) == 1 else None, up.pop() if len(up) == 1 else None)


# --- vertices that coincide ------------------------------------------------------------------


def coincident(blocks: Iterable[NDArray[np.floating]], n_vertices: int) -> Rows:
    """Labels ``(V,)``, equal for vertices whose positions are equal in all blocks ``(n, V, 3)``.

    Reading stops when no two vertices coincide in all the blocks read so far.
    """
    label = np.zeros(n_vertices, dtype=np.intp)
    for block in blocks:
        some = np.flatnonzero(np.bincount(label)[label] > 1)
        if not len(some):
            break
        # adding 0.0 makes -0.0 equal to 0.0 in its bytes, too
        paths = np.ascontiguousarray(block[:, some].transpose(1, 0, 2)).reshape(len(some), -1) + 0.0
        rows = paths.view(np.dtype((np.void, paths.dtype.itemsize * paths.shape[1]))).ravel()
        here = np.zeros(n_vertices, dtype=np.intp)
        here[some] = np.unique(rows, return_inverse=True)[1].ravel()
        label = np.unique(label * n_vertices + here, return_inverse=True)[1].ravel()
    return label


def distinct(label: Rows) -> tuple[Rows, Rows]:
    """First vertex of each label (U,), ascending, and each vertex's row in that array (V,)."""
    _, kept, row = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(kept)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return kept[order], rank[row.ravel()]


def told_apart(label: Rows, *arrays: NDArray[Any] | None) -> Rows:
    """Labels ``(V,)``, equal for vertices with the same `label` and equal rows of all `arrays`."""
    parts = [np.reshape(a, (len(label), -1)) for a in arrays if a is not None]
    if not parts or label.max() + 1 == len(label):
        return label
    every = np.concatenate([label[:, None], *parts], axis=1)
    return np.unique(every, axis=0, return_inverse=True)[1].ravel()


@dataclasses.dataclass(frozen=True, eq=False)
class Selected:
    """Lazy view of some vertices of an array (F, V, 3) that is read on demand."""

    source: Any
    kept: Rows

    @property
    def shape(self) -> tuple[int, int, int]:
        return (int(self.source.shape[0]), len(self.kept), 3)

    @property
    def dtype(self) -> np.dtype[Any]:
        dtype: np.dtype[Any] = np.dtype(self.source.dtype)
        return dtype

    def __getitem__(self, frames: Any) -> NDArray[np.floating]:
        return np.asarray(self.source[frames])[..., self.kept, :]
