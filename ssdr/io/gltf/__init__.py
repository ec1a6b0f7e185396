"""glTF 2.0 (``.glb``, ``.gltf``): skins, morph targets and moving nodes."""

from __future__ import annotations

from .reader import list_clips, list_meshes, read, read_skinning
from .template import template_problem
from .writer import write_skinning

__all__ = [
    "list_clips",
    "list_meshes",
    "read",
    "read_skinning",
    "template_problem",
    "write_skinning",
]
