"""glTF 2.0 (``.glb``, ``.gltf``): skins, morph targets and moving nodes."""

from .passing import copy, left_out
from .reader import list_clips, read, read_skinning
from .template import template_problem
from .writer import write_skinning

__all__ = [
    "copy",
    "left_out",
    "list_clips",
    "read",
    "read_skinning",
    "template_problem",
    "write_skinning",
]
