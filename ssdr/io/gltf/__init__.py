"""glTF 2.0 (``.glb``, ``.gltf``): skins, morph targets and moving nodes."""

from .reader import read, read_skinning
from .writer import write_skinning

__all__ = ["read", "read_skinning", "write_skinning"]
