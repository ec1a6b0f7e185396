"""Choice of the meshes of a file by their names."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import Any

from ..common.errors import InputError

_MOST_NAMES = 20  # in a message


def mesh_names(meshes: Any) -> list[str]:
    """Names in the option `meshes`, as a list of at least one.

    Raises
    ------
    InputError
        If it holds none.
    """
    listed = [meshes] if isinstance(meshes, str) else meshes
    if not (isinstance(listed, (list, tuple, set, frozenset)) and listed):
        raise InputError("meshes", "the name of a mesh, or several", repr(meshes))
    for name in listed:
        if not isinstance(name, str):
            raise InputError("meshes", "the name of a mesh, or several", repr(name))
    return list(listed)


def choose(meshes: str | Sequence[str] | None, names: Sequence[Collection[str]]) -> list[int]:
    """Indices of the meshes that have a name in `meshes`, or of all meshes if `meshes` is None.

    `names` holds, for each mesh, the names by which it can be chosen.

    Raises
    ------
    InputError
        If one of the names is that of no mesh.
    """
    if meshes is None:
        return list(range(len(names)))
    wanted = set(mesh_names(meshes))
    known = set().union(*names)
    for name in sorted(wanted - known):
        more = f" and {len(known) - _MOST_NAMES} more" if len(known) > _MOST_NAMES else ""
        expected = f"one of {sorted(known, key=natural_key)[:_MOST_NAMES]}{more}"
        raise InputError("meshes", expected, repr(name))
    return [k for k, own in enumerate(names) if wanted.intersection(own)]


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sorting key that compares numbers in names by value: ``bone_2`` before ``bone_10``."""
    parts = re.split(r"([0-9]+)", name)
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in parts]
