"""The commands that read files and solve nothing: info, compare and convert."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

import ssdr

from ..common.errors import InputError
from ..io import (
    check_outputs,
    list_clips,
    list_left_out,
    list_meshes,
    load_any,
    load_clips,
    save_all,
)
from ..mesh.clips import Clip
from ..mesh.sequence import MeshSequence
from ..model.shapes import Skinned
from ..model.skinning import Skinning
from ..model.transforms import depths, rest_diagonal
from .files import READ, WRITTEN, files_of, pair
from .output import Output, clips_document, clips_text, in_words, saved_line
from .parameters import passes

_MESH = {
    "frames": "{frames:,} at {fps:g} a second, {duration:.3g} s",
    "vertices": "{vertices:,}",
    "triangles": "{triangles:,}",
    "surface": "UVs: {uv}, normals: {normals}, colours: {colors}, materials: {materials}",
    "size": "diagonal {diagonal:.4g}",
}
_SEAMS = {
    "seams": "{seams:,} vertices coincide with others in every frame (--weld merges them)",
}
_BONES = {
    "bones": "{bones} ({bone_model}), {bones_without_vertices} move nothing",
    "influences": "at most {influences}",
}
_TREE = {"hierarchy": "{joints} joints, {depth} deep, roots: {roots}"}


@passes(*READ, without=["clip", "weld"])
def info(source: Path, *, clip: list[str] | None = None, **options: Any) -> None:
    """Show what a file holds.

    If a file without a skin has several clips, all of them are listed and the first is examined.

    Parameters
    ----------
    source : Path
        A sequence or a skinning.
    clip : list of str, optional
        Clip to examine; repeatable.
    """
    reading, _ = files_of(options)
    with Output.current.waiting(f"loading {source}"):
        thing = load_any(source, clip=clip, **reading)
    if isinstance(thing, Skinned):
        clips, kind, about, table = thing.clips, "skinning", _about_skinning(thing.skinning), _BONES
    else:
        clips = (Clip(thing.clip or thing.name or source.stem, 0, thing.n_frames, thing.fps),)
        if clip is None and len(list_clips(source)) > 1:
            clips = list_clips(source, fps=reading.get("fps"))
        kind, about, table = "sequence", _about_sequence(thing), _SEAMS
    surface, meshes = thing.surface, list_meshes(source)
    about |= {
        "name": thing.name,
        **dataclasses.asdict(thing.space),
        "frames": thing.n_frames,
        "fps": thing.fps,
        "vertices": thing.n_vertices,
        "triangles": len(thing.faces),
        "uv": surface is not None and surface.uv is not None,
        "normals": surface is not None and surface.normals is not None,
        "colors": surface is not None and surface.colors is not None,
        "not_read": list(list_left_out(source)),
        "materials": [m.name for m in surface.materials] if surface is not None else [],
    }
    several = f"{len(meshes)}, read as one (--meshes NAME takes one): {', '.join(meshes[:20])}"
    rows = [("file", f"{source}: a {kind}"), ("clips", clips_text(clips))]
    rows += [("meshes", several if len(meshes) > 1 else ""), ("space", str(thing.space))]
    rows += in_words(about, _MESH | table)
    if about.get("hierarchy") is not None:
        rows += in_words(about["hierarchy"], _TREE)
    rows.append(("not read", ", ".join(about["not_read"])))
    document = {"input": source, "kind": kind, **about, "meshes": meshes}
    Output.current.result({**document, "clips": clips_document(clips)}, rows)


def _about_sequence(sequence: MeshSequence) -> dict[str, Any]:
    _, weld = sequence.weld()
    return {
        "duration": sequence.n_frames / sequence.fps,
        "diagonal": sequence.diagonal(),
        "seams": weld.before - weld.after,
    }


def _about_skinning(skinning: Skinning) -> dict[str, Any]:
    tree, parents, names = None, skinning.parents, skinning.names()
    if parents is not None:
        roots = [names[b] for b in np.flatnonzero(parents < 0)]
        depth = int(depths(parents).max()) + 1
        tree = {"joints": skinning.n_bones, "roots": roots, "depth": depth}
    return {
        "duration": sum(clip.n_frames / clip.fps for clip in skinning.clips),
        "diagonal": rest_diagonal(skinning.rest),
        "bones": skinning.n_bones,
        "influences": skinning.n_influences,
        "bone_model": skinning.bone_model,
        "bones_without_vertices": int((skinning.sparse_weights().sum(axis=0) == 0).sum()),
        "hierarchy": tree,
    }


@passes(*READ, *WRITTEN)
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
    reading, writing = files_of(options, [source])
    check_outputs([target], inputs=[source], **writing)
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
    size = rest_diagonal(thing.skinning.rest) if isinstance(thing, Skinned) else thing.diagonal()
    rows = [("read", f"{source}: {thing!r}"), ("wrote", saved_line(report, size, 1e-6 * size))]
    Output.current.result(document, rows)


def _one(shots: list[MeshSequence]) -> MeshSequence:
    if len(shots) > 1:
        known = ", ".join(shot.clip for shot in shots)
        raise InputError("--clip", f"one clip where vertices are read, of {known}", len(shots))
    return shots[0]


@passes(ssdr.metrics.compare, *READ, without=["weld"])
def compare(reference: Path, other: Path, *, scale: float = 1.0, **options: Any) -> None:
    """Measure how far two animations of one mesh are apart.

    Skinnings are posed first, and a welded mesh is compared at the vertices that are left. The
    clips of OTHER are compared with those of the same names, all together; --clip chooses some.

    Parameters
    ----------
    reference : Path
        The reference.
    other : Path
        What is measured against it.
    scale : float
        Factor by which all lengths of OTHER are multiplied.
    """
    reading, _ = files_of(options)
    thing, truth = pair(other, reference, reading, scale=scale)
    _hint_at_units(truth, thing, scale)
    whole = thing.vertex_map is None and not np.array_equal(thing.faces, truth.faces)
    if isinstance(thing, Skinned) and whole:  # of other triangles, the vertices are compared
        thing = MeshSequence(thing.skin(), thing.faces, thing.fps, validate=False)
    with Output.current.waiting("measuring"):
        result = ssdr.metrics.compare(truth, thing, **options)
    document = {"reference": reference, "other": other, **result.as_dict()}
    Output.current.result(document, str(result))


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
