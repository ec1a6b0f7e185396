"""USD (``.usd``, ``.usda``, ``.usdc``): point caches and UsdSkel characters.

Importing this package raises a :class:`~ssdr.MissingDependencyError` if usd-core is not installed.
"""

from ..optional import require

require("usd", "USD")
