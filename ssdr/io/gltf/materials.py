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
    """UVs and normals of the parts, and all materials of a file in its order."""
    return Looks(
        [part.uv for part in parts],
        [part.normals for part in parts],
        [part.material for part in parts],
        [_material(document, item) for item in document.items("materials")],
    )


def _material(document: Document, item: dict[str, Any]) -> Material:
    look = item.get("pbrMetallicRoughness", {})
    r, g, b, a = document.numbers(look, "baseColorFactor", [1.0] * 4).tolist()
    factors = {"factors": [look.get("metallicFactor", 1.0), look.get("roughnessFactor", 1.0)]}
    metallic, roughness = document.numbers(factors, "factors", [1.0, 1.0]).tolist()
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
            jpeg = texture.startswith(b"\xff\xd8\xff")
            kind = str(image.get("mimeType", "image/jpeg" if jpeg else "image/png"))
    return Material(
        name=str(item.get("name", "material")),
        base_color=(r, g, b, a),
        metallic=metallic,
        roughness=roughness,
        double_sided=bool(item.get("doubleSided", False)),
        texture=texture,
        texture_type=kind,
    )
