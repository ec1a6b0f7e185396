"""The command ``ssdr compare``."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..sequence import MeshSequence, joined
from ..skinning import Skinning
from .format_options import read_options
from .options import FILES, RUN, Force, SpaceOptions, argument, option, takes
from .output import Output, page_row
from .reading import read_any, read_pairs
from .view import check_page

if TYPE_CHECKING:
    from ..metrics.comparison import Comparison
    from ..viewer.page import Page

_SLACK = 0.02  # in log10 (5 %), between the ratio of two diagonals and a power of ten


@dataclasses.dataclass(kw_only=True)
class CompareOptions(SpaceOptions):
    """Arguments and options of ``ssdr compare``."""

    reference: Annotated[Path, argument("A", "The reference.")]
    other: Annotated[Path, argument("B", "What is measured against it.")]
    hausdorff: Annotated[bool, option(RUN, "Hausdorff distances; they are slow.")] = True
    sted: Annotated[bool, option(RUN, "Spatio-temporal edge difference.")] = True
    target: Annotated[
        Path | None,
        option(FILES, "A page of both with the error.", "--output", "-o", metavar="PAGE.html"),
    ] = None
    force: Force = False


@takes
def compare(options: CompareOptions) -> None:
    """Measure how far two animations of one mesh are apart.

    Skinnings are posed first, and a welded mesh is spread back to its original vertices.  Files
    with several clips are compared clip by clip, all of them unless --clip names some.
    --read A:KEY=VALUE is an option for A alone, --read B:KEY=VALUE for B alone.

    The page of --output shows B as the result and A as the input, by bones if B is a skinning.
    """
    output = Output.start(options)
    from ..io import in_space
    from ..metrics import compare as measure
    from ..metrics.inputs import as_pair
    from ..metrics.normal_angles import known_errors

    files = options.reference, options.other
    if options.target is not None:
        check_page(options.target, "--output", others=list(files))
    read = read_options(files, options, roles=("A", "B"))
    with output.waiting(f"loading {files[0]}, {files[1]}"):
        found = read_pairs(files, options.clip, read)
        pairs = [(n, *as_pair(a, in_space(b, a.space))) for n, a, b in found]
    model = in_space(read_any(options.other, **read[1]), pairs[0][2].space)
    (_, a, b), compared = found[0], pairs[0][2].space
    if compared != b.space:
        output.warn(f"A is in {a.space}, B in {b.space}: compared in {compared}")
    hint = _other_units(pairs[0][1], pairs[0][2], read[1].get("scale", 1.0))
    if hint:
        output.warn(hint)

    def drawn(result: Comparison, a: MeshSequence, shots: list[MeshSequence]) -> Comparison:
        """Copy of `result` with the errors of the normals that engines draw.

        If B is not a skinning with A's triangles, `result` itself is returned.
        """
        if not isinstance(model, Skinning) or model.n_vertices != a.n_vertices:
            return result
        if not np.array_equal(model.faces, a.faces):
            return result
        clips = model if len(model.clips) == 1 else model.select(*(b.clip for b in shots))
        return dataclasses.replace(result, normals=known_errors(a, clips))

    document: dict[str, Any] = {"command": "compare", "reference": files[0], "other": files[1]}
    with output.waiting("measuring"):
        results = [
            (name, drawn(measure(a, b, hausdorff=options.hausdorff, sted=options.sted), a, [b]))
            for name, a, b in pairs
        ]
        whole = results[0][1]
        text = str(whole)
        if len(results) > 1:
            a, shots = joined([a for _, a, _ in pairs]), [b for _, _, b in pairs]
            whole = drawn(measure(a, joined(shots), hausdorff=False, sted=False), a, shots)
            document["clips"] = [{"name": name, **result.as_dict()} for name, result in results]
            text = "\n\n".join([*(f"{n}: {r}" for n, r in results), f"all clips: {whole}"])
    if options.target is not None:
        with output.waiting("writing the page"):
            page = _write_page(options, options.target, pairs, model)
        document["output"] = page.path
        text += "\n" + "  ".join(page_row(page))
    output.result({**document, **whole.as_dict()}, text)


def _write_page(
    options: CompareOptions,
    target: Path,
    pairs: list[tuple[str, MeshSequence, MeshSequence]],
    model: MeshSequence | Skinning,
) -> Page:
    """Write the viewer page that shows B (`model`) beside A, and return its Page."""
    import ssdr

    if not isinstance(model, Skinning):
        model = joined([b for _, _, b in pairs])
    elif len(model.clips) > 1:
        model = model.select(*(b.clip for _, _, b in pairs))
    return ssdr.view(
        model,
        [a for _, a, _ in pairs],
        target,
        title=f"{options.other.name} beside {options.reference.name}",
        file=options.other,
        reference_name=options.reference.name,
    )


def _other_units(a: MeshSequence, b: MeshSequence, scale: float) -> str:
    """Hint for the user that the sizes of two meshes differ by about a power of ten.

    It is empty if they do not.  `scale` is the factor by which B was scaled when it was read.
    """
    sizes = a.diagonal(), b.diagonal()
    if min(sizes) <= 0:
        return ""
    tens = math.log10(sizes[1] / sizes[0])
    power = round(tens)
    if power == 0 or abs(tens - power) > _SLACK:
        return ""
    larger, smaller = ("B", "A") if power > 0 else ("A", "B")
    return (
        f"the diagonal of {larger} is about {10.0 ** abs(power):,.0f} times that of {smaller}: "
        "are they in different units, such as metres and centimetres? "
        f"--read B:scale={scale * 10.0**-power:g} brings B to A"
    )
