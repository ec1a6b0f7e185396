"""glTF's materials as the package has them."""

from __future__ import annotations

import logging
from typing import Any

from ...sequence import Material
from ..scene import Looks
from .document import Document
from .parts import PrimitiveGroup

__all__ = ["read_looks"]

_log = logging.getLogger(__name__)


def read_looks(document: Document, parts: list[PrimitiveGroup]) -> Looks:
    """All materials of a file, in its order, and those of the parts."""
    count = len(document.items("materials"))
    return Looks(
        [part.uv for part in parts],
        [part.normals for part in parts],
        [part.material for part in parts],
        [_material(document, k) for k in range(count)],
    )


def _material(document: Document, index: int) -> Material:
    item = document.item("materials", index)
    look = document.dictionary(item, "pbrMetallicRoughness")
    r, g, b, a = document.numbers(look, "baseColorFactor", [1.0] * 4).tolist()
    texture, kind = None, "image/png"
    reference = document.dictionary(look, "baseColorTexture")
    if reference:
        texture, kind = _texture(document, reference)
    return Material(
        name=str(item.get("name", "material")),
        base_color=(r, g, b, a),
        metallic=document.number(look.get("metallicFactor", 1.0), "metallicFactor"),
        roughness=document.number(look.get("roughnessFactor", 1.0), "roughnessFactor"),
        double_sided=bool(item.get("doubleSided", False)),
        texture=texture,
        texture_type=kind,
    )


def _texture(document: Document, reference: dict[str, Any]) -> tuple[bytes | None, str]:
    """The bytes of a picture and their MIME type."""
    if "KHR_texture_transform" in document.dictionary(reference, "extensions"):
        _log.warning("%s: the transform of a texture is left out", document.path)
    texture = document.item("textures", reference.get("index"))
    if "source" not in texture:
        _log.warning("%s: a texture has no PNG or JPEG image", document.path)
        return None, "image/png"
    image = document.item("images", texture["source"])
    if "bufferView" in image:
        data = bytes(document.view(image["bufferView"])[0])
    else:
        data = document.uri(image.get("uri"), "an image")
    kind = "image/jpeg" if data.startswith(b"\xff\xd8\xff") else "image/png"
    return data, str(image.get("mimeType", kind))
