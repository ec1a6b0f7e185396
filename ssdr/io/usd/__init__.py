"""USD (``.usd``, ``.usda``, ``.usdc``): point caches and UsdSkel characters."""

from .reader import list_clips, read, read_skinning
from .writer import write_sequence, write_skinning

__all__ = ["list_clips", "read", "read_skinning", "write_sequence", "write_skinning"]
