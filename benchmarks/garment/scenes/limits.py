"""Numbers of a scene within their limits."""

from __future__ import annotations

import dataclasses
from typing import Any

from ssdr.common.checks import LARGEST
from ssdr.common.errors import InputError, is_real, is_whole


def check_numbers(values: Any, **limits: tuple[float, float]) -> None:
    """Check the numbers of a dataclass: each from 0 on, or within its `limits`.

    Raises
    ------
    InputError
        If a number is out of its range or not finite, or an integer is none.
    """
    for field in dataclasses.fields(values):
        if field.type not in ("int", "float"):
            continue
        value, (low, high) = getattr(values, field.name), limits.get(field.name, (0, LARGEST))
        good, kind = (is_whole, "an integer") if field.type == "int" else (is_real, "a number")
        if not good(value):
            raise InputError(field.name, kind, repr(value))
        if not low <= value <= high:
            raise InputError(field.name, f"a number from {low:g} to {high:g}", value)
