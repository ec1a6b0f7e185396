"""USD (``.usd``, ``.usda``, ``.usdc``): point caches and UsdSkel characters."""

from .reader import read, read_skinning
from .writer import write_sequence, write_skinning

__all__ = ["read", "read_skinning", "write_sequence", "write_skinning"]
