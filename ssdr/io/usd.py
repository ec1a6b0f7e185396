"""USD (``.usd``, ``.usda``, ``.usdc``): point caches and UsdSkel characters."""

from .usd_read import read, read_skinning
from .usd_write import write_sequence, write_skinning

__all__ = ["read", "read_skinning", "write_sequence", "write_skinning"]
