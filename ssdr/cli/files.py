"""Options of the files that commands read and write."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..common.errors import InputError
from ..io import load, load_clips
from ..io.outputs import check_file
from ..io.references import trust
from ..io.weight_storage import WeightStorage

_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
PAGES = (".html", ".htm")


def file_options(
    *,
    units: str | None = None,
    meshes: list[str] | None = None,
    faces: str | None = None,
    joints_alone: bool = False,
) -> None:
    """Options of every command that reads files, beside those of :func:`ssdr.load`.

    Parameters
    ----------
    units : str, optional
        Unit of the inputs, in place of what they state: m, cm, mm, in, ft or metres in a unit.
    meshes : list of str, optional
        Name of a mesh to read of several; repeatable.
    faces : str, optional
        File of the triangles of a .npy, .zarr, .pc2 or .mdd, or none.
    joints_alone : bool
        Read joints that move no vertices.
    """


def storage_options(
    *,
    weights: WeightStorage = "float32",
    template: str | None = None,
    centimetres: bool = False,
) -> None:
    """Options of every command that writes models, for the formats that have them.

    Parameters
    ----------
    weights : {"float32", "uint16", "uint8"}
        How glTF stores weights.
    template : str, optional
        File whose other contents a glTF output keeps, or none; by default the first glTF input.
    centimetres : bool
        Write FBX in centimetres.
    """


def files_of(options: dict[str, Any], inputs: Sequence[Path]) -> tuple[dict[str, Any], ...]:
    """Take the options of files out of those of a command.

    Returns
    -------
    reading : dict
        Options of :func:`ssdr.load_clips` and :func:`ssdr.io.load_any`.
    writing : dict
        Options of :func:`ssdr.io.save_all`, with the inputs as templates where these fit: not if
        the mesh is scaled, or said to be elsewhere than the rest of its file.
    """
    reading, writing = (
        {name: options.pop(name) for name in tuple(options) if name in names}
        for names in (
            {*_names(file_options), *_names(load_clips), *_names(load)},
            _names(storage_options),
        )
    )
    if "units" in reading:
        reading["units"] = _metres(reading["units"])
    if "folder" in reading:
        trust(reading.pop("folder"))  # templates may refer to files below it, too
    placed = any(name in reading for name in ("scale", "units", "up"))
    if writing.get("template") == "none":
        placed = writing.pop("template") == "none"
    if not placed:
        writing |= {"templates": inputs} | {k: v for k, v in reading.items() if k == "meshes"}
    return reading, writing


def _names(function: Callable[..., Any]) -> list[str]:
    parameters = inspect.signature(function).parameters.values()
    return [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]


def _metres(text: str) -> float:
    try:
        return _UNITS.get(text) or float(text)
    except ValueError:
        raise InputError("--units", f"metres, or {', '.join(_UNITS)}", repr(text)) from None


def check_page(path: Path, others: Sequence[Path]) -> None:
    """Raise an InputError before the work if a page could not be written to `path` after it."""
    if path.suffix.lower() not in PAGES:
        raise InputError("--output", "a file ending in .html", str(path))
    check_file(path, "output", others=others)
