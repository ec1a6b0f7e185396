"""USD (``.usd``, ``.usda``, ``.usdc``): point caches and UsdSkel characters.

Importing it raises a :class:`~ssdr.MissingDependencyError` without usd-core.
"""

from . import requirement as requirement
from .reader import list_clips, read, read_skinning
from .template import copy, left_out, template_problem
from .writer import write_sequence, write_skinning

__all__ = [
    "copy",
    "left_out",
    "list_clips",
    "read",
    "read_skinning",
    "template_problem",
    "write_sequence",
    "write_skinning",
]
