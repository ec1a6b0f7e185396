"""Triangles, seams, hard edges and textures of a page."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..io.corners import split_corners
from ..normals import NormalHolders, normal_holders
from ..surface import Material, Surface
from .blocks import Blocks

_TEXTURE_BYTES = 2 << 20  # larger textures are drawn anew
_TEXTURE_SIDE = 2048


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
