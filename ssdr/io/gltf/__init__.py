"""glTF 2.0 (``.glb``, ``.gltf``): skins, morph targets and moving nodes."""

from .reader import list_clips, read, read_skinning
from .writer import write_skinning

__all__ = ["list_clips", "read", "read_skinning", "write_skinning"]
