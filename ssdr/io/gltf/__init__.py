"""glTF 2.0 (``.glb``, ``.gltf``): skins, morph targets and moving nodes."""

from __future__ import annotations

from .passing import copy, left_out, template_problem
from .reader import list_clips, list_meshes, read, read_skinning
from .writer import compact_size, write_skinning

__all__ = [
    "compact_size",
    "copy",
    "left_out",
    "list_clips",
    "list_meshes",
    "read",
    "read_skinning",
    "template_problem",
    "write_skinning",
]
