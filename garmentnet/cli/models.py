"""The command ``garmentnet models``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ssdr.common.errors import FormatError, InputError

from .progress import aligned

_HEAD = ("name", "vertices", "bones", "reads", "MB", "error")


def models(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="Searched for checkpoints, too.")
    ] = None,
) -> None:
    """List the garments that ship, and those in a folder and the folders below it."""
    from ..io.tensors import SHIPPED

    files = {path.stem: path for path in sorted(SHIPPED.glob("*.safetensors"))}
    if folder is not None:
        if not folder.is_dir():
            raise InputError("folder", "a folder", str(folder))
        there = (p for p in sorted(folder.rglob("*.safetensors")) if ".state" not in p.suffixes)
        files |= {str(path): path for path in there}
    rows = [_HEAD, *((name, *_row(path)) for name, path in files.items())]
    typer.echo(aligned(rows))


def _row(path: Path) -> tuple[str, ...]:
    from ..networks.checkpoint import load_checkpoint

    size = f"{path.stat().st_size / 1e6:.1f}"
    try:
        found = load_checkpoint(path)
    except FormatError as error:
        return "", "", "", size, str(error).removeprefix(f"{path}: ")
    reads = ["pose"] + ["parameters"] * found.reads_parameters
    errors = [f"{k} {1e3 * v:.1f} mm" for k, v in found.errors.items()]
    g = found.subject.garment
    return str(g.n_vertices), str(g.n_bones), ", ".join(reads), size, ", ".join(errors) or "unknown"
