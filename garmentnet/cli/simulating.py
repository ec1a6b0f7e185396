"""The command ``garmentnet dataset``, also called ``simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .learning import output_folder

__all__ = ["dataset"]


def dataset(
    name: Annotated[str, typer.Argument(help="A scene or data set (TOML), or tiny, small.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Store of clips to write.")
    ] = None,
    motion: Annotated[
        Path | None, typer.Option(help="Folder of BVH files whose motions are added.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Threads; all cores by default.")] = None,
) -> None:
    """Simulate the clips of a scene or a data set; stopped and started again, it goes on."""
    from .data_set import run

    stem = Path(name).stem + ("-recorded" if motion else "")
    target = output or output_folder() / f"{stem}.clips"
    run(name, target, motion=motion, workers=workers)
