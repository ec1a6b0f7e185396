"""The examples in the docstrings run as they stand."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import garmentnet

# This runs the command.
_WITHOUT = ("garmentnet.__main__",)
_MODULES = [
    module.name
    for module in pkgutil.walk_packages(garmentnet.__path__, "garmentnet.")
    if module.name not in _WITHOUT
]


@pytest.mark.parametrize("name", _MODULES)
def test_examples_of_a_module_run(name: str) -> None:
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    result = doctest.testmod(importlib.import_module(name), optionflags=flags)
    assert result.failed == 0
