"""The command ``ssdr compare``."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ..errors import InputError
from ..sequence import MeshSequence
from .format_options import read_options
from .options import RUN, Options, argument, option, takes
from .output import Output
from .reading import join, read_pairs

_SLACK = 0.02  # in log10 (5 %), between the ratio of two diagonals and a power of ten


@dataclasses.dataclass(kw_only=True)
class CompareOptions(Options):
    """Arguments and options of ``ssdr compare``."""

    reference: Annotated[Path, argument("A", "The reference.")]
    other: Annotated[Path, argument("B", "What is measured against it.")]
    hausdorff: Annotated[bool, option(RUN, "Hausdorff distances; they are slow.")] = True
    sted: Annotated[bool, option(RUN, "Spatio-temporal edge difference.")] = True


@takes
def compare(options: CompareOptions) -> None:
    """Measure how far two animations of one mesh are apart.

    Skinnings are posed first, and a welded mesh is spread back to its original vertices.  Files
    with several clips are compared clip by clip, all of them unless --clip names some.
    --read A:KEY=VALUE is an option for A alone, --read B:KEY=VALUE for B alone.
    """
    output = Output.start(options)
    from ..metrics import compare as measure

    files = options.reference, options.other
    read = read_options(files, options, roles=("A", "B"))
    with output.waiting(f"loading {files[0]}, {files[1]}"):
        found = read_pairs(files, options.clip, read)
        pairs = [(name, *_on_the_same_vertices(a, b)) for name, a, b in found]
    hint = _other_units(pairs[0][1], pairs[0][2], read[1].get("scale", 1.0))
    if hint:
        output.warn(hint)
    document: dict[str, Any] = {"command": "compare", "reference": files[0], "other": files[1]}
    with output.waiting("measuring"):
        results = [
            (name, measure(a, b, hausdorff=options.hausdorff, sted=options.sted))
            for name, a, b in pairs
        ]
        whole = results[0][1]
        text = str(whole)
        if len(results) > 1:
            a, b = join([a for _, a, _ in pairs]), join([b for _, _, b in pairs])
            whole = measure(a, b, hausdorff=False, sted=False)
            document["clips"] = [{"name": name, **result.as_dict()} for name, result in results]
            text = "\n\n".join([*(f"{n}: {r}" for n, r in results), f"all clips: {whole}"])
    output.result({**document, **whole.as_dict()}, text)


def _other_units(a: MeshSequence, b: MeshSequence, scale: float) -> str:
    """Hint for the user if the sizes of two meshes differ by about a power of ten, else "".

    `scale` is the factor by which B was read.
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


def _on_the_same_vertices(a: MeshSequence, b: MeshSequence) -> tuple[MeshSequence, MeshSequence]:
    a, b = _spread(a, b), _spread(b, a)
    if a.n_vertices != b.n_vertices:
        raise InputError(
            "B",
            f"the {a.n_vertices:,} vertices of A (if one of them was welded, weld the other, "
            "too: ssdr convert IN OUT.npz --weld)",
            f"{b.n_vertices:,}",
        )
    return a, b


def _spread(sequence: MeshSequence, like: MeshSequence) -> MeshSequence:
    """Sequence spread to the vertices before its welding, if `like` has as many; else unchanged."""
    if sequence.vertex_map is None or len(sequence.vertex_map) != like.n_vertices:
        return sequence
    vertices = np.concatenate([sequence.unweld(block, axis=1) for _, block in sequence.chunks()])
    return dataclasses.replace(
        sequence, vertices=vertices, faces=like.faces, surface=None, vertex_map=None, validate=False
    )
