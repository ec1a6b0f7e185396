"""Calls that are refused: what is right about each of them, and what makes it wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

import ssdr

Call = tuple[Callable[..., object], dict[str, Any]]  # a function and arguments that are right
Row = tuple[str, str, str, Sequence[Any]]  # call, argument of the error, words of it, values


def each(rows: Sequence[Row]) -> list[Any]:
    """One parameter set a value."""
    return [
        pytest.param(call, argument, says, value, id=f"{call}-{argument}-{k}")
        for call, argument, says, values in rows
        for k, value in enumerate(values)
    ]


def refused(call: Call, argument: str, says: str, value: Any) -> None:
    """The error names the argument as the caller wrote it.

    A value stands for the argument of that name; a dictionary for several.
    """
    function, right = call
    change = value if isinstance(value, dict) else {argument: value}
    with pytest.raises(ssdr.InputError, match="expected") as caught:
        function(**(right | change))
    assert isinstance(caught.value, ValueError)
    assert caught.value.argument == argument
    assert says in str(caught.value)
