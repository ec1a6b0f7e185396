"""Animations that ship with the package; ``ORIGIN.md`` in this folder states their origin."""

from __future__ import annotations

from pathlib import Path as _Path
from typing import TYPE_CHECKING

from ...common.errors import InputError

if TYPE_CHECKING:
    from ...mesh.sequence import MeshSequence

__all__ = ["load", "names", "path"]

_FOLDER = _Path(__file__).parent


def names() -> tuple[str, ...]:
    """Names of the samples.

    ``dancer`` has F = 72 frames at 24 frames per second, V = 4202 vertices and T = 8392 triangles.
    ``dancer_small`` is the same motion with F = 24 at 8 frames per second and V = 799, for tests.
    Both are in metres, with y up.

    Examples
    --------
    >>> ssdr.samples.names()
    ('dancer', 'dancer_small')
    """
    return tuple(sorted(file.stem for file in _FOLDER.glob("*.npz")))


def path(name: str = "dancer") -> _Path:
    """Path of a sample's ``.npz`` file.

    Raises
    ------
    InputError
        If there is no sample of that name.

    Examples
    --------
    >>> ssdr.samples.path("dancer_small").name
    'dancer_small.npz'
    """
    if name not in names():
        raise InputError("name", f"one of {', '.join(names())}", repr(name))
    return _FOLDER / f"{name}.npz"


def load(name: str = "dancer") -> MeshSequence:
    """Load a sample by its name, as ``ssdr.load(ssdr.samples.path(name))`` does.

    Raises
    ------
    InputError
        If there is no sample of that name.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> dancer.n_frames, dancer.n_vertices
    (24, 799)
    """
    from ... import io

    return io.load(path(name))
