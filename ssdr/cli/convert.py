"""The command ``ssdr convert``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from ..sequence import MeshSequence
from ..skinning import Skinning
from .format_options import read_options
from .options import FILES, Force, SpaceOptions, Write, argument, option, takes
from .output import Output, saved_line
from .reading import clips_document, read_model, read_vertices
from .saving import check_outputs
from .template import options_with_template


@dataclasses.dataclass(kw_only=True)
class ConvertOptions(SpaceOptions):
    """Arguments and options of ``ssdr convert``."""

    source: Annotated[Path, argument("IN", "A sequence or a skinning.")]
    target: Annotated[Path, argument("OUT", "The suffix chooses the format.")]
    bake: Annotated[
        bool, option(FILES, "Write the vertices of a skinning, not its bones.", "--bake")
    ] = False
    write: Write = None
    force: Force = False


@takes
def convert(options: ConvertOptions) -> None:
    """Write a file again in another format.

    A skinning is written as a skinning, with all its clips, if the format can hold it; otherwise
    the vertices of one clip are written.
    """
    output = Output.start(options)
    import ssdr

    source, target = options.source, options.target
    (read,) = read_options([source], options)
    check_outputs([target], options.write, sources=[source])
    thing: MeshSequence | Skinning
    with output.waiting(f"loading {source}"):
        take = read_vertices if options.bake or read.get("weld") else read_model
        thing = take(source, options.clip, read)
    skinned = isinstance(thing, Skinning)
    inputs = {source: read}
    clips = thing.clips if isinstance(thing, Skinning) else ()
    names = [clip.name for clip in clips]
    settings = options_with_template(target, options.write, inputs, clips=names)
    with output.waiting(f"saving {target}"):
        report = ssdr.save(thing, target, **settings)
        document = {
            "command": "convert",
            "input": source,
            "kind": "skinning" if skinned else "sequence",
            "frames": thing.n_frames,
            "clips": clips_document(clips),
            "output": dataclasses.asdict(report),
        }
    output.result(document, [("read", f"{source}: {thing!r}"), ("wrote", saved_line(report))])
