"""The package warp, loaded once and kept quiet."""

from __future__ import annotations

import functools
from typing import Any

from ..io.packages import require

__all__ = ["load_warp"]


@functools.cache
def load_warp() -> Any:
    """The package warp.

    Raises
    ------
    MissingDependencyError
        Where it is not installed.
    """
    wp = require("warp", "garmentnet[scenes]", "a simulation")
    # Every process would say again that there is no GPU, and what it compiled.
    wp.config.log_level = wp.LOG_ERROR
    return wp
