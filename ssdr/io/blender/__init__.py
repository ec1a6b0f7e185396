"""FBX through Blender, which runs in a process of its own."""

from .fbx_reading import list_clips, list_meshes, read, read_skinning
from .fbx_writing import write_skinning

__all__ = ["list_clips", "list_meshes", "read", "read_skinning", "write_skinning"]
