"""Arrays of a page as compressed blocks of bytes, which ``data.js`` unpacks."""

from __future__ import annotations

import dataclasses
import io
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...io.corners import split_corners
from ...mesh.normals import NormalHolders, normal_holders
from ...mesh.surface import Material, Surface
from ...model.skinning import Skinning
from ..palette import heat, srgb_from_linear

_SPAN_BYTES = 1 << 20  # of 16-bit differences that are decoded at a time
_WEIGHT_STEPS = 1 << 20
_TEXTURE_BYTES = 2 << 20  # larger textures are drawn anew
_TEXTURE_SIDE = 2048
_LEVEL = 6  # of zlib; 9 takes three times as long for 1 %


@dataclasses.dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of bytes in the order in which they were added.

    Attributes
    ----------
    data : list of bytes
    """

    data: list[bytes] = dataclasses.field(default_factory=list)

    def raw(self, data: bytes) -> int:
        """Append `data` unchanged as a new block and return the block's index."""
        self.data.append(data)
        return len(self.data) - 1

    def array(self, values: NDArray[Any], *, delta: bool = False) -> dict[str, Any]:
        """Append an array as a new block; return its document entry, with block index and layout.

        Its bytes are shuffled, one plane for each byte of a number, and compressed by zlib.

        Parameters
        ----------
        values : array
            Of uint8, uint16, int16, uint32, int32 or float32.
        delta : bool
            Whether to store the differences between consecutive rows, which wrap around.
        """
        plain = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
        if delta and len(plain):
            plain = np.concatenate([plain[:1], plain[1:] - plain[:-1]])
        planes = plain.reshape(-1, 1).view(np.uint8).T.tobytes()
        kind = {"u": "Uint", "i": "Int", "f": "Float"}[plain.dtype.kind]
        return {
            "block": self.raw(zlib.compress(planes, _LEVEL)),
            "type": f"{kind}{8 * plain.dtype.itemsize}Array",
            "shape": list(plain.shape),
            "delta": delta,
        }

    def fixed(self, values: NDArray[np.floating], *, delta: bool = True) -> dict[str, Any]:
        """Append an array in fixed point, as multiples of 2⁻²², and return its document entry.

        The step is larger for numbers above 2⁸.
        """
        largest = float(np.abs(values).max(initial=0.0))
        step = 2.0**-22 * max(1.0, 2.0 ** np.ceil(np.log2(max(largest, 1e-300) / 2**8)))
        entry = self.array(np.rint(values / step).astype(np.int32), delta=delta)
        return {**entry, "step": step}


def weight_entries(model: Skinning, blocks: Blocks) -> dict[str, Any]:
    """Append indices and weights, the largest first, to `blocks`; return their document entries.

    The stored weights of a vertex sum to exactly 1.
    """
    order = np.argsort(-model.weights, axis=1, kind="stable")
    weights = np.take_along_axis(model.weights, order, axis=1).astype(np.float64)
    steps = np.rint(_WEIGHT_STEPS * weights).astype(np.int32)
    steps[:, 0] += _WEIGHT_STEPS - steps.sum(axis=1)
    used = max(1, int((steps > 0).any(axis=0).sum()))
    indices = np.where(steps > 0, np.take_along_axis(model.indices, order, axis=1), 0)
    return {
        "indices": blocks.array(indices[:, :used].astype(np.uint32)),
        "weights": {**blocks.array(steps[:, :used]), "step": 1 / _WEIGHT_STEPS},
    }


def surface_entries(
    faces: NDArray[np.int32],
    surface: Surface | None,
    n_vertices: int,
    blocks: Blocks,
    notes: list[str],
    *,
    turned: bool = False,
    holders: NormalHolders | None = None,
) -> dict[str, Any]:
    """Append triangles, sorted by material, UVs, normals and textures; return document entries.

    A vertex is copied where its UV or its normal differs between triangles: at a seam or a hard
    edge.  `copies` lists the vertex of each copy.  If there are hard edges, vertices and copies
    with the same index in `groups` share a normal of the surface: by default those of one vertex
    with equal values.  If normals are `turned` with the bones, they are among the entries, too.
    """
    uv = normals = None
    materials: tuple[Material, ...] = ()
    order = np.arange(len(faces))
    counts = np.array([len(faces)])
    if surface is not None:
        uv, normals, materials = surface.uv, surface.normals, surface.materials
        if surface.material_index is not None and len(materials):
            order = np.argsort(surface.material_index, kind="stable")
            counts = np.bincount(surface.material_index, minlength=len(materials))
    corners = split_corners(faces, n_vertices, uv, normals)
    groups = None
    if normals is not None and len(faces):
        holders = holders or normal_holders(faces, n_vertices, surface)
        group = holders.group[holders.corner]
        shared = np.full(len(corners.vertex), group.max() + 1)  # of vertices in no triangle
        shared[corners.faces.reshape(-1)] = group.reshape(-1)
        groups = blocks.array(shared.astype(np.uint32), delta=True)
    parts, start = [], 0
    for k, count in enumerate(counts.tolist()):
        material = materials[k] if materials else None
        if count:
            parts.append({"start": start, "count": count, **_look(material, uv, blocks, notes)})
        start += count
    return {
        "faces": blocks.array(corners.faces[order].reshape(-1).astype(np.uint32), delta=True),
        "copies": blocks.array(corners.vertex[n_vertices:].astype(np.uint32), delta=True),
        "groups": groups,
        "normals": _directions(corners.normals, blocks) if turned and len(faces) else None,
        "uv": None if corners.uv is None else blocks.array(corners.uv.astype(np.float32)),
        "parts": parts,
        "looks": any(part["texture"] for part in parts)
        or len({str(part["color"]) for part in parts}) > 1,
    }


def _directions(normals: Any, blocks: Blocks) -> dict[str, Any]:
    """Append unit vectors, rounded to steps of 2⁻¹⁵, and return their document entry."""
    return {**blocks.array(np.rint(32767 * normals).astype(np.int16)), "step": 1 / 32767}


def _look(material: Material | None, uv: Any, blocks: Blocks, notes: list[str]) -> dict[str, Any]:
    """Colour (linear RGB) of a material, and the entry of its texture.

    The texture is appended to `blocks`.  Both are None without a material.
    """
    if material is None:
        return {"color": None, "texture": None}
    texture = None
    if material.texture is not None and uv is not None:
        data, kind = _small(material.texture, material.texture_type, notes)
        texture = {"block": blocks.raw(data), "type": kind} if data else None
    return {"color": [float(c) for c in material.base_color[:3]], "texture": texture}


def _small(data: bytes, kind: str, notes: list[str]) -> tuple[bytes, str]:
    """Shrink a texture that is too large for a page; return it and its MIME type.

    The texture is empty if it is no picture.
    """
    if len(data) <= _TEXTURE_BYTES and kind in ("image/png", "image/jpeg"):
        return data, kind
    try:
        picture = Image.open(io.BytesIO(data))
        picture.thumbnail((_TEXTURE_SIDE, _TEXTURE_SIDE))
        stored = io.BytesIO()
        picture.convert("RGB").save(stored, "JPEG", quality=88)
    except (OSError, ValueError, Image.DecompressionBombError):
        notes.append("A texture that is no readable picture was left out.")
        return b"", kind
    notes.append(f"A large texture is shown at {picture.width} × {picture.height} pixels.")
    return stored.getvalue(), "image/jpeg"


def difference_entry(
    difference: Callable[[int], NDArray[np.floating]],
    n_frames: int,
    n_vertices: int,
    reach: float,
    scale: float,
    blocks: Blocks,
) -> dict[str, Any]:
    """Append the 16-bit differences of an input in spans of frames; return their document entry.

    `difference` returns those (V, 3) of a frame, `reach` is the largest, and `scale` the length of
    the page's unit.
    """
    step = (reach or 1.0) / 32767
    length = max(1, _SPAN_BYTES // (6 * n_vertices))
    spans = []
    for start in range(0, n_frames, length):
        some = range(start, min(start + length, n_frames))
        off = np.stack([np.rint(difference(k) / step).astype(np.int16) for k in some])
        spans.append(blocks.array(off, delta=True))
    return {"step": step / scale, "length": length, "spans": spans}


def heat_scales() -> list[list[list[float]]]:
    """Colour scales of the error for a light and a dark page, the smallest error first (sRGB)."""
    scales = heat(np.linspace(0, 1, 16)), _from_grey(heat(np.linspace(0.6, 0, 16)))
    return [srgb_from_linear(colors).round(4).tolist() for colors in scales]


def _from_grey(colors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (linear RGB) of which the first five fade in from a medium grey."""
    grey = np.linspace(1.0, 0.0, 6)[:, None]
    return np.concatenate([grey * 0.2 + (1 - grey) * colors[:6], colors[6:]])
