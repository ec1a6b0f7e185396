"""``ssdr convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..sequence import MeshSequence
from ..skinning import Skinning
from .assets import of_one_format, options_with_template
from .output import (
    Force,
    Fps,
    JsonFlag,
    Output,
    Quiet,
    ReadOptions,
    Scale,
    Strict,
    Verbose,
    Weld,
    WriteOptions,
    check_outputs,
    saved_document,
    saved_line,
)
from .reading import ClipNames, clips_document, clips_text, one_clip, options_for, read_model


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A sequence or a skinning.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The suffix chooses the format.")],
    bake: Annotated[
        bool, typer.Option("--bake", help="Write the vertices of a skinning, not its bones.")
    ] = False,
    clip: ClipNames = None,
    weld: Weld = False,
    fps: Fps = None,
    scale: Scale = None,
    read: ReadOptions = None,
    write: WriteOptions = None,
    strict: Strict = False,
    force: Force = False,
    json: JsonFlag = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Turn one format into another; a skinning stays one where the format has room for it.

    It keeps all clips unless --clip names some; vertices are those of one clip.  From glTF to
    glTF and from USD to USD, without other options, the whole file passes through.
    """
    output = Output.start(json=json, quiet=quiet, verbose=verbose)
    import ssdr

    (options,) = options_for([source], read, fps=fps, weld=weld, scale=scale)
    # A sequence can never be written where not even a skinning can.
    check_outputs([target], kind=Skinning, pairs=None, force=force, sources=[source])
    if of_one_format(source, target) and source.is_file() and not (bake or options or write):
        names = None if clip in (None, ["all"]) else clip
        report = ssdr.io.copy(source, target, clips=names)
        # A clip without a name is called after its file, which is the one that was read.
        clips = ssdr.list_clips(source if names is None else target)
        document = {
            "command": "convert",
            "input": source,
            "kind": "file",
            "frames": sum(one.n_frames for one in clips),
            "clips": clips_document(clips),
            "output": saved_document(report),
        }
        lines = [("read", f"{source}: {clips_text(clips)}"), ("wrote", saved_line(report))]
        output.result(document, lines)
        return
    thing: MeshSequence | Skinning
    take = one_clip if bake or weld else read_model
    with output.waiting(f"loading {source}"):
        thing = take(source, clip, options)
    check_outputs([target], kind=type(thing), pairs=write, force=force, sources=[source])
    settings = options_with_template(
        target, write, [source], [options], strict=strict, new_bones=not isinstance(thing, Skinning)
    )
    with output.waiting(f"saving {target}"):
        report = ssdr.save(thing, target, **settings)
    kind = "skinning" if isinstance(thing, Skinning) else "sequence"
    document = {
        "command": "convert",
        "input": source,
        "kind": kind,
        "frames": thing.n_frames,
        "vertices": thing.n_vertices,
        **({"clips": clips_document(thing.clips)} if isinstance(thing, Skinning) else {}),
        "output": saved_document(report),
    }
    output.result(document, [("read", f"{source}: {thing!r}"), ("wrote", saved_line(report))])
