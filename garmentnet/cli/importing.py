"""The command ``garmentnet import``."""

from __future__ import annotations

import glob
import os
from pathlib import Path
from typing import Annotated

import typer

from ssdr.common.errors import InputError
from ssdr.io.mesh_names import natural_key
from ssdr.mesh.surface import Up

from .learning import Parameters, entered_parameters


def import_clips(
    output: Annotated[Path, typer.Option("--output", "-o", help="Store of clips, new or not.")],
    cloth: Annotated[
        list[str] | None,
        typer.Option("--cloth", "-c", help="Animated mesh, as .abc, .usd or .glb; repeatable."),
    ] = None,
    rig: Annotated[
        list[str] | None,
        typer.Option("--rig", "-r", help="Its skeleton, as .fbx, .glb or .usd; one per cloth."),
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Frames a second of the store.")] = None,
    parameters: Parameters = "",
    test: Annotated[
        list[str] | None,
        typer.Option(help="Clip for testing; else the last tenth of the clips. Repeatable."),
    ] = None,
    validation: Annotated[
        list[str] | None,
        typer.Option(help="Clip for validation; else the tenth before those. Repeatable."),
    ] = None,
    rest: Annotated[
        Path | None, typer.Option(help="Garment as it was cut, on the body in its bind pose.")
    ] = None,
    offset: Annotated[
        float, typer.Option(help="Seconds from the rig's first frame to the cloth's.")
    ] = 0.0,
    mesh: Annotated[str, typer.Option(help="Name of the cloth in its file; else all.")] = "",
    body: Annotated[str, typer.Option(help="Name of the body in the rig's file; else all.")] = "",
    cloth_scale: Annotated[float, typer.Option(help="Factor of the cloth's lengths.")] = 1.0,
    rig_scale: Annotated[float, typer.Option(help="Factor of the rig's lengths.")] = 1.0,
    cloth_up: Annotated[
        Up | None, typer.Option(help="Axis of the cloth that points up, y or z; else as stated.")
    ] = None,
    rig_up: Annotated[Up | None, typer.Option(help="Likewise of the rig.")] = None,
) -> None:
    """Make a store of your own simulations: of each an animated mesh and the skeleton under it."""
    from ..data.parameters import SimulationParameters
    from ..importing.importing import ImportOptions, import_clips
    from ..importing.scene_files import Source
    from ..io.tables import from_table

    def say(text: str) -> None:
        typer.echo(text, err=True)

    cloths, rigs = _files("--cloth", cloth or []), _files("--rig", rig or [])
    if not cloths:
        raise InputError("--cloth", "an animated mesh", "none")
    if len(rigs) == 1:  # one file with a clip for every cloth
        rigs *= len(cloths)
    if len(cloths) != len(rigs):
        raise InputError("--rig", f"one file, or as many as cloths: {len(cloths)}", len(rigs))
    table = entered_parameters(parameters)
    options = ImportOptions(
        fps=fps,
        offset=offset,
        cloth=Source(mesh, cloth_scale, cloth_up),
        rig=Source(body, rig_scale, rig_up),
        parameters=from_table(SimulationParameters, table, file="--parameters"),
        test=test or (),
        validation=validation or (),
    )
    pairs = list(zip(cloths, rigs, strict=True))
    store = import_clips(pairs, output, options, rest=rest, say=say)
    if refused := store.refused():
        say(refused)
    typer.echo(str(store.path))


def _files(option: str, words: list[str]) -> list[Path]:
    """Files of the given names and patterns, in natural order (2 before 10).

    What the names of a pattern's files have in common at their ends does not count: of ``walk_rig``
    and ``walk2_rig`` the first is the first, as of ``walk`` and ``walk2``.
    A pattern of numbered meshes stays one entry, since they are the frames of one cloth.
    """
    found: list[Path] = []
    for word in words:
        numbered = Path(word).suffix.lower() in (".obj", ".ply")
        if Path(word).exists() or numbered or not glob.has_magic(word):
            found.append(Path(word))
            continue
        here = [Path(name) for name in glob.glob(word)]
        end = len(os.path.commonprefix([p.stem[::-1] for p in here]))  # noqa: RUF071
        here.sort(key=lambda p: natural_key(p.stem[: len(p.stem) - end]))
        if not here:
            raise InputError(option, "a pattern of files that exist", word)
        found += here
    return found
