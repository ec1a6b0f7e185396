"""What the commands do: read, call a function of the package, write, report."""

from __future__ import annotations

import inspect
import math
from pathlib import Path
from typing import Any

import numpy as np

import ssdr

from ..common.errors import InputError
from ..io import SaveReport, check_outputs, in_space, load_any, load_clips, save_all
from ..io.inputs import clips_in
from ..io.outputs import check_file
from ..mesh.sequence import MeshSequence, joined
from ..model.shapes import Skinned
from ..model.transforms import rest_diagonal
from ..show import Style
from .files import check_page, file_options, files_of, storage_options
from .output import Output, clips_document, saved_line
from .parameters import passes


@passes(storage_options, file_options, load_clips, ssdr.load)
def convert(source: Path, target: Path, *, bake: bool = False, **options: Any) -> None:
    """Write a file again in another format.

    A skinning is written as a skinning, with all its clips, if the format can hold it; otherwise
    the vertices of one clip are written.

    Parameters
    ----------
    source : Path
        A sequence or a skinning.
    target : Path
        The file to write, whose suffix chooses the format.
    bake : bool
        Write the vertices of a skinning, not its bones.
    """
    check_outputs([target], inputs=[source])
    reading, writing = files_of(options, [source])
    with Output.current.waiting(f"loading {source}"):
        if bake or "weld" in reading:
            thing: Any = _one(load_clips(source, **reading))
        else:
            thing = load_any(source, **reading)
    with Output.current.waiting(f"saving {target}"):
        (report,) = save_all(thing, [target], **writing)
    document = {
        "input": source,
        "kind": "skinning" if isinstance(thing, Skinned) else "sequence",
        "frames": thing.n_frames,
        "clips": clips_document(thing.clips if isinstance(thing, Skinned) else ()),
        "output": report,
    }
    rows = [("read", f"{source}: {thing!r}"), ("wrote", saved_line(report))]
    Output.current.result(document, rows)


@passes(ssdr.metrics.compare, file_options, load_clips, ssdr.load, without=["weld"])
def compare(
    reference: Path, other: Path, *, output: Path | None = None, scale: float = 1.0, **options: Any
) -> None:
    """Measure how far two animations of one mesh are apart.

    Skinnings are posed first, and a welded mesh is compared at the vertices that are left. Files
    with several clips are compared clip by clip, all of them unless --clip names some.

    Parameters
    ----------
    reference : Path
        The reference.
    other : Path
        What is measured against it.
    output : Path, optional
        A page (.html) of both with the error.
    scale : float
        Factor by which all lengths of OTHER are multiplied.
    """
    if output is not None:
        check_page(output, [reference, other])
    reading = files_of(options, ())[0]
    names = reading.pop("clip", None)
    with Output.current.waiting(f"loading {reference}, {other}"):
        several = [len(clips_in(path, fps=reading.get("fps"))) > 1 for path in (reference, other)]
        # A file with one clip has no choice where the other has several.
        alone = None if any(several) else names
        chosen = [(names or ["all"]) if many else alone for many in several]
        first = load_clips(reference, clip=chosen[0], **reading)
        whole: Any = load_any(other, clip=chosen[1], scale=scale, **reading)
        if (stated := whole.space) != first[0].space:
            whole = in_space(whole, first[0].space)
            said = f"REFERENCE is in {first[0].space}, OTHER in {stated}"
            if whole.space != stated:
                Output.current.warn(f"{said}: compared in {whole.space}")
    second = _shots(whole)
    if len(first) != len(second):
        clips = [", ".join(side) for side in ([a.clip for a in first], second)]
        raise InputError("--clip", "as many clips of both files", ", and ".join(clips))
    for a in first if len(first) > 1 else ():
        if a.clip not in second:
            expected = f"the clips of REFERENCE, {a.clip} too"
            raise InputError("OTHER", expected, ", ".join(second))
    pairs = [(a, second[a.clip] if len(first) > 1 else next(iter(second.values()))) for a in first]
    _hint_at_units(first[0], whole, scale)
    document: dict[str, Any] = {"reference": reference, "other": other}
    with Output.current.waiting("measuring"):
        found = [_measure(a, b, **options) for a, b in pairs]
        result, text = found[0], str(found[0])
        if len(pairs) > 1:
            whole = whole.select(*(a.clip for a in first))
            result = _measure(joined(first), whole, hausdorff=False, sted=False)
            named = [(a.clip, one) for a, one in zip(first, found, strict=True)]
            document["clips"] = [{"name": name, **one.as_dict()} for name, one in named]
            text = "\n\n".join([*(f"{n}: {one}" for n, one in named), f"all clips: {result}"])
    if output is not None:
        title = f"{other.name} beside {reference.name}"
        with Output.current.waiting("writing the page"):
            about: Any = {"title": title, "file": other, "reference_name": reference.name}
            page = ssdr.view(whole, first, output, **about)
        document["output"] = page.path
        text += f"\npage  {_page_text(page)}"
    Output.current.result({**document, **result.as_dict()}, text)


def _shots(thing: MeshSequence | Skinned) -> dict[str, Any]:
    """Clips of a skinning, or the one of a sequence, by name."""
    if isinstance(thing, MeshSequence):
        return {thing.clip: thing}
    several = len(thing.clips) > 1
    return {c.name: thing.select(c.name) if several else thing for c in thing.clips}


def _measure(a: MeshSequence, b: Any, **options: Any) -> Any:
    """Errors of `b` from `a`; of a model with other triangles, only its vertices are compared."""
    if isinstance(b, Skinned) and b.vertex_map is None and not np.array_equal(b.faces, a.faces):
        b = MeshSequence(b.skin(), b.faces, b.fps, validate=False)
    return ssdr.metrics.compare(a, b, **options)


def _hint_at_units(a: MeshSequence, b: MeshSequence | Skinned, scale: float) -> None:
    """Warn if the sizes of two meshes differ by about a power of ten."""
    sizes = a.diagonal(), rest_diagonal(b.skinning.rest) if isinstance(b, Skinned) else b.diagonal()
    if min(sizes) <= 0:
        return
    tens = math.log10(sizes[1] / sizes[0])
    power = round(tens)
    if power and abs(tens - power) < 0.02:
        larger, smaller = ("OTHER", "REFERENCE") if power > 0 else ("REFERENCE", "OTHER")
        Output.current.warn(
            f"the diagonal of {larger} is about {10.0 ** abs(power):,.0f} times that of {smaller}: "
            "are they in different units, such as metres and centimetres? "
            f"--scale {scale * 10.0**-power:g} brings OTHER to REFERENCE"
        )


@passes(file_options, load_clips, ssdr.load, without=["units", "weld"])
def render(
    source: Path,
    *,
    output: Path,
    reference: Path | None = None,
    frames: str = "5",
    frame: int | None = None,
    styles: list[Style] | None = None,
    width: int | None = None,
    title: str | None = None,
    up: str | None = None,
    azimuth: float | None = None,
    elevation: float = 12.0,
    **options: Any,
) -> None:
    """Draw a contact sheet, one frame or a film; no display is needed.

    Parameters
    ----------
    source : Path
        A sequence or a skinning.
    output : Path
        The picture; .gif or .webp is a film.
    reference : Path, optional
        The true animation; shows the error.
    frames : str
        How many columns, or which frames as 0,10,20.
    frame : int, optional
        One frame alone instead of a sheet.
    styles : list of str, optional
        Row of the sheet or panel of the film; repeatable.
    width : int, optional
        Pixels; by default 1600, for one frame 1000, for a film 480.
    title : str, optional
        Heading of the sheet.
    up : str, optional
        Up axis, as x, y, z or with a minus; by default that of the file, or y.
    azimuth : float, optional
        Degrees around; chosen by default.
    elevation : float
        Degrees above.
    """
    from ..show import draw
    from ..show.figures import picture_format

    picture_format(output)
    check_file(output, "output", others=[source] if reference is None else [source, reference])
    try:
        columns = [int(part) for part in frames.split(",")]
    except ValueError:
        expected = "a number, or frames such as 0,10,20"
        raise InputError("--frames", expected, repr(frames)) from None
    subject, truth = _pair(source, reference, options)
    with Output.current.progress_bar() as show:
        draw(
            subject,
            output,
            reference=truth,
            frame=frame,
            frames=columns if "," in frames else columns[0],
            styles=styles or None,
            width=width,
            title=title,
            up=up or subject.space.up or "y",
            azimuth=azimuth,
            elevation=elevation,
            callback=lambda done: show("drawing", done, ""),
        )
    document = {"input": source, "output": output}
    Output.current.result(document, [("wrote", str(output))])


@passes(
    *(ssdr.view, file_options, load_clips, ssdr.load),
    without=["file", "reference_name", "units", "weld"],
)
def view(
    model: Path, reference: Path | None = None, *, output: Path | None = None, **options: Any
) -> None:
    """Show a model beside its input in the browser: one page, to be kept or sent.

    The page needs no network. It plays the animation, compares it with the input, colours it by
    texture, bone, weight or error, and turns the joints of a rigid tree.

    Parameters
    ----------
    model : Path
        A skinning or a sequence.
    reference : Path, optional
        The true animation.
    output : Path, optional
        The page; without it, a temporary one is opened.
    """
    if output is not None:
        check_page(output, [model] if reference is None else [model, reference])
    names = inspect.signature(ssdr.view).parameters
    look = {name: options.pop(name) for name in tuple(options) if name in names}
    thing, truth = _pair(model, reference, options)
    look.setdefault("title", thing.name or model.stem)
    name = "" if reference is None else reference.name
    with Output.current.waiting("writing the page"):
        page = ssdr.view(thing, truth, output, file=model, reference_name=name, **look)
    document = {"input": model, **vars(page), "output": page.path}
    Output.current.result(document, [("page", _page_text(page))])


def _pair(source: Path, reference: Path | None, options: dict[str, Any]) -> Any:
    """What a file holds, and the sequence of its reference with the same clips."""
    reading = files_of(options, ())[0]
    with Output.current.waiting(f"loading {source}"):
        thing = load_any(source, **reading)
        if reference is None:
            return thing, None
        clips = thing.clips if isinstance(thing, Skinned) else ()
        several = len(clips_in(reference, fps=reading.get("fps"))) > 1
        reading["clip"] = [clip.name for clip in clips] if several and clips else None
        return thing, joined(load_clips(reference, **reading))


def _page_text(page: Any) -> str:
    return saved_line(SaveReport(path=page.path, bytes=page.bytes, notes=tuple(page.notes)))


def _one(shots: list[MeshSequence]) -> MeshSequence:
    if len(shots) > 1:
        known = ", ".join(shot.clip for shot in shots)
        raise InputError("--clip", f"one clip where vertices are read, of {known}", len(shots))
    return shots[0]
