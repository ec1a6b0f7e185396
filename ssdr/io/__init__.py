"""Reading and writing of files, in a format chosen by the file's suffix."""

from __future__ import annotations

from .load_save import list_clips, list_meshes, load, load_skinning, save
from .registry import FORMATS, SaveReport
from .spaces import in_space

__all__ = [
    "FORMATS",
    "SaveReport",
    "in_space",
    "list_clips",
    "list_meshes",
    "load",
    "load_skinning",
    "save",
]
