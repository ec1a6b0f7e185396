"""USD (``.usd``, ``.usda``, ``.usdc``): point caches and UsdSkel characters.

Importing this package raises a :class:`~ssdr.MissingDependencyError` if usd-core is not installed.
"""

from ..optional import require

require("pxr.UsdSkel", "usd", "USD")

from .reader import list_clips, list_meshes, read, read_skinning  # noqa: E402
from .writer import write_sequence, write_skinning  # noqa: E402

__all__ = [
    "list_clips",
    "list_meshes",
    "read",
    "read_skinning",
    "write_sequence",
    "write_skinning",
]
