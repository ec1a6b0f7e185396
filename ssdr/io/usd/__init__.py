"""USD (``.usd``, ``.usda``, ``.usdc``): point caches and UsdSkel characters.

Importing it raises a :class:`~ssdr.MissingDependencyError` without usd-core.
"""

from ..registry import require

require("pxr.UsdSkel", "usd", "USD")
