"""Check for usd-core, which every module of this folder needs."""

from ..registry import require

require("pxr.UsdSkel", "usd", "USD")
