"""The command ``garmentnet``: every part of the pipeline, from simulation to pictures.

Whatever is heavy is imported where it is used, so that ``--help`` is quick and a part that
needs an extra does not stand in the way of the others.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from ssdr.errors import SsdrError

from . import learning_cli

__all__ = ["app", "main"]

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Loose garments on a moving body: simulate, learn, predict.",
)


@app.command()
def simulate(
    scene: Annotated[Path, typer.Argument(help="Scene or data set (TOML).")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Store of clips to write.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes; all cores by default.")] = None,
) -> None:
    """Simulate the clips that a file describes."""
    from .scenes.report import run

    run(scene, output or learning_cli.output_folder() / f"{scene.stem}.clips", workers=workers)


@app.command()
def dataset(
    name: Annotated[str, typer.Argument(help="tiny, small, or a file (TOML).")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Store of clips to write.")
    ] = None,
    motion: Annotated[
        Path | None, typer.Option(help="Folder of BVH files whose motions are added.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes; all cores by default.")] = None,
) -> None:
    """Make a data set; stopped and started again, it goes on where it was."""
    from .scenes.report import run

    stem = Path(name).stem + ("-recorded" if motion else "")
    run(
        name,
        output or learning_cli.output_folder() / f"{stem}.clips",
        motion=motion,
        workers=workers,
    )


for _command in (
    learning_cli.train,
    learning_cli.evaluate,
    learning_cli.predict,
    learning_cli.demo,
):
    app.command()(_command)


def main(arguments: list[str] | None = None) -> Any:
    """Run the command; errors of this package become one line and exit status 1."""
    try:
        return app(args=arguments)
    except SsdrError as error:
        print(f"garmentnet: {error}", file=sys.stderr)
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
