"""The commands ``garmentnet simulate, dataset``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .learning import output_folder

__all__ = ["dataset", "simulate"]


def simulate(
    scene: Annotated[Path, typer.Argument(help="Scene or data set (TOML).")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Store of clips to write.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Threads; all cores by default.")] = None,
) -> None:
    """Simulate the clips that a file describes."""
    from .data_set import run

    run(scene, output or output_folder() / f"{scene.stem}.clips", workers=workers)


def dataset(
    name: Annotated[str, typer.Argument(help="tiny, small, or a file (TOML).")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Store of clips to write.")
    ] = None,
    motion: Annotated[
        Path | None, typer.Option(help="Folder of BVH files whose motions are added.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Threads; all cores by default.")] = None,
) -> None:
    """Make a data set; stopped and started again, it goes on where it was."""
    from .data_set import run

    stem = Path(name).stem + ("-recorded" if motion else "")
    target = output or output_folder() / f"{stem}.clips"
    run(name, target, motion=motion, workers=workers)
