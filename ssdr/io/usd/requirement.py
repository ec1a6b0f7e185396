"""usd-core, on which all modules of this folder stand: what to install where it is missing."""

from ..registry import require

require("pxr.UsdSkel", "usd", "USD")
