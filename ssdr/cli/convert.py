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
from .reading import clips_document, clips_text, read_model, read_vertices
from .saving import check_outputs
from .template import options_with_template, shared_format


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
    the vertices of one clip are written. From glTF to glTF and from USD to USD, the whole file is
    copied, unless an option other than --clip changes what is read or written.
    """
    output = Output.start(options)
    import ssdr

    source, target = options.source, options.target
    (read,) = read_options([source], options)
    check_outputs([target], options.write, sources=[source])
    thing: MeshSequence | Skinning
    if shared_format(source, target) and not (options.bake or read or options.write):
        names = None if options.clip is None or "all" in options.clip else options.clip
        report = ssdr.io.copy(source, target, clips=names)
        # A clip without a name is named after its file, which is the one that was read.
        clips = ssdr.list_clips(source if names is None else target)
        kind, words, frames = "file", clips_text(clips), sum(clip.n_frames for clip in clips)
    else:
        with output.waiting(f"loading {source}"):
            take = read_vertices if options.bake or read.get("weld") else read_model
            thing = take(source, options.clip, read)
        skinned = isinstance(thing, Skinning)
        inputs = {source: read}
        clips = thing.clips if isinstance(thing, Skinning) else ()
        names = [clip.name for clip in clips]
        settings = options_with_template(
            target, options.write, inputs, new_bones=not skinned, clips=names
        )
        with output.waiting(f"saving {target}"):
            report = ssdr.save(thing, target, **settings)
        kind, words, frames = ("skinning" if skinned else "sequence"), repr(thing), thing.n_frames
    document = {
        "command": "convert",
        "input": source,
        "kind": kind,
        "frames": frames,
        "clips": clips_document(clips),
        "output": dataclasses.asdict(report),
    }
    output.result(document, [("read", f"{source}: {words}"), ("wrote", saved_line(report))])
