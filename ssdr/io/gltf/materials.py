"""Reading of glTF's materials."""

from __future__ import annotations

import logging
from typing import Any

from ...surface import Material
from ..signatures import picture_type
from .document import Document

_log = logging.getLogger(__name__)


def read_materials(document: Document) -> list[Material]:
    """All materials of the file."""
    return [_material(document, item) for item in document.items("materials")]


def _material(document: Document, item: dict[str, Any]) -> Material:
    look = item.get("pbrMetallicRoughness", {})
    r, g, b, a = document.numbers(look, "baseColorFactor", [1.0] * 4).tolist()
    texture, kind = None, "image/png"
    if "baseColorTexture" in look:
        reference = look["baseColorTexture"]
        if "KHR_texture_transform" in reference.get("extensions", {}):
            _log.warning("%s: the transform of a texture is left out", document.path)
        source = document.items("textures")[reference["index"]].get("source")
        if source is None:
            _log.warning("%s: a texture has no PNG or JPEG image", document.path)
        else:
            image = document.items("images")[source]
            texture = document.picture(image)
            kind = str(image.get("mimeType") or picture_type(texture) or kind)
    return Material(
        name=str(item.get("name", "material")),
        base_color=(r, g, b, a),
        metallic=document.number(look.get("metallicFactor", 1.0), "metallicFactor"),
        roughness=document.number(look.get("roughnessFactor", 1.0), "roughnessFactor"),
        double_sided=bool(item.get("doubleSided", False)),
        texture=texture,
        texture_type=kind,
    )
