"""``ssdr compare``."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..errors import InputError
from ..sequence import MeshSequence
from .output import Fps, JsonFlag, Output, ReadOptions, Threads, Verbose, read_options
from .reading import ClipNames, join, options_for, read_pairs

_ABOUT = 0.02  # of log10, 5 %: how far a model's diagonal may be off that of its reference


def compare(
    reference: Annotated[Path, typer.Argument(metavar="A", help="What is right.")],
    other: Annotated[Path, typer.Argument(metavar="B", help="What is measured against it.")],
    hausdorff: Annotated[
        bool, typer.Option(help="Hausdorff distances, the slowest of the measures.")
    ] = True,
    sted: Annotated[bool, typer.Option(help="Spatio-temporal edge difference.")] = True,
    clip: ClipNames = None,
    fps: Fps = None,
    scale: Annotated[
        float,
        typer.Option("--scale", metavar="FACTOR", help="Of B's lengths: 0.01 turns cm into m."),
    ] = 1.0,
    read: ReadOptions = None,
    threads: Threads = None,
    json: JsonFlag = False,
    verbose: Verbose = 0,
) -> None:
    """Measure how far two animations of one mesh are apart.

    Files that hold a skinning are posed first.  Where one of them was welded, the
    other's vertices are compared with the welded ones spread back.  Files of several
    clips are compared clip by clip, all of them unless --clip names some.
    """
    output = Output.start(json=json, verbose=verbose, threads=threads)
    import ssdr

    options = options_for((reference, other), read, fps=fps, roles=("A", "B"))
    options[1] |= read_options(None, fps=None, scale=scale)
    with output.waiting(f"loading {reference}, {other}"):
        found = read_pairs((reference, other), clip, options)
        pairs = [(name, *_alike(a, b)) for name, a, b in found]
    hint = _other_units(pairs[0][1], pairs[0][2], scale)
    if hint:
        output.warn(hint)
    with output.waiting("measuring"):
        results = [
            (name, ssdr.metrics.compare(a, b, hausdorff=hausdorff, sted=sted))
            for name, a, b in pairs
        ]
    document = {"command": "compare", "reference": reference, "other": other}
    if len(pairs) == 1:
        document |= results[0][1].as_dict()
        text = str(results[0][1])
    else:
        joined = (join([a for _, a, _ in pairs]), join([b for _, _, b in pairs]))
        whole = ssdr.metrics.compare(*joined, hausdorff=False, sted=False)
        document |= whole.as_dict()
        document["clips"] = [{"name": name, **result.as_dict()} for name, result in results]
        text = "\n\n".join([*(f"{n}: {r}" for n, r in results), f"all clips: {whole}"])
    if json:
        output.result(document, [])
    else:
        typer.echo(text)


def _other_units(a: MeshSequence, b: MeshSequence, scale: float) -> str:
    """What to say of two meshes whose sizes differ by a power of ten, else nothing."""
    sizes = a.diagonal(), b.diagonal()
    if min(sizes) <= 0:
        return ""
    tens = math.log10(sizes[1] / sizes[0])
    power = round(tens)
    if power == 0 or abs(tens - power) > _ABOUT:
        return ""
    times = f"{10.0 ** abs(power):,.0f} times"
    larger, smaller = ("B", "A") if power > 0 else ("A", "B")
    return (
        f"the diagonal of {larger} is about {times} that of {smaller}: are they in different "
        f"units, such as metres and centimetres? --scale {scale * 10.0**-power:g} brings B to A"
    )


def _alike(a: MeshSequence, b: MeshSequence) -> tuple[MeshSequence, MeshSequence]:
    """Both on the same vertices."""
    if a.n_vertices != b.n_vertices:
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
    """A welded sequence on the vertices of the original mesh, if the other has those."""
    if sequence.vertex_map is None or len(sequence.vertex_map) != like.n_vertices:
        return sequence
    vertices = np.concatenate([sequence.unweld(block, axis=1) for _, block in sequence.chunks()])
    return dataclasses.replace(
        sequence, vertices=vertices, faces=like.faces, surface=None, vertex_map=None, validate=False
    )
