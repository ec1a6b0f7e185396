"""Reading and writing of files, in a format chosen by the file's suffix."""

from __future__ import annotations

from .formats import FORMATS
from .inputs import load_any, load_clips
from .load_save import list_clips, list_left_out, list_meshes, load, load_skinning, save
from .outputs import check_outputs, save_all
from .save_report import SaveReport
from .spaces import in_space

__all__ = [
    "FORMATS",
    "SaveReport",
    "check_outputs",
    "in_space",
    "list_clips",
    "list_left_out",
    "list_meshes",
    "load",
    "load_any",
    "load_clips",
    "load_skinning",
    "save",
    "save_all",
]
