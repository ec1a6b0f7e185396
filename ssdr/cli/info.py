"""The command that says what a file holds."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..io import list_clips, list_meshes, load, load_any
from ..mesh.clips import Clip
from ..mesh.sequence import MeshSequence
from ..model.shapes import Skinned
from ..model.skinning import Skinning
from ..model.transforms import depths, rest_diagonal
from .files import file_options, files_of
from .output import Output, clips_document, clips_text, in_words
from .parameters import passes

_BONES = {
    "bones": "{bones} ({bone_model}), {bones_without_vertices} move nothing",
    "influences": "at most {influences}",
}
_SEAMS = {
    "seams": "{seams:,} vertices coincide with others in every frame (--weld merges them)",
}
_TREE = {
    "hierarchy": "{joints} joints, {depth} deep, roots: {roots}; "
    "largest gap of a joint {largest_gap:.3g}, at {joint_of_largest_gap}",
}
_MESH = {
    "frames": "{frames:,} at {fps:g} a second, {duration:.3g} s",
    "vertices": "{vertices:,}, {loose_vertices:,} of them in no triangle",
    "triangles": "{triangles:,} in {components:,} connected components, "
    "{degenerate_triangles:,} degenerate",
    "edges": "{boundary_edges:,} boundary, {nonmanifold_edges:,} non-manifold",
    "surface": "UVs: {uv}, normals: {normals}, materials: {materials}",
    "size": "diagonal {diagonal:.4g}",
}


@passes(file_options, load, without=["clip", "weld"])
def info(source: Path, *, clip: list[str] | None = None, **options: Any) -> None:
    """Show what a file holds and what in it may cause problems.

    If a file without a skin has several clips, all of them are listed and the first is examined.

    Parameters
    ----------
    source : Path
        A sequence or a skinning.
    clip : list of str, optional
        Clip to examine; repeatable.
    """
    reading, _ = files_of(options, ())
    with Output.current.waiting(f"loading {source}"):
        thing = load_any(source, clip=clip, **reading)
    if isinstance(thing, Skinned):
        clips, kind, about, table = thing.clips, "skinning", _about_skinning(thing.skinning), _BONES
    else:
        clips = (Clip(thing.clip or thing.name or source.stem, 0, thing.n_frames, thing.fps),)
        if clip is None and len(list_clips(source)) > 1:
            clips = list_clips(source, fps=reading.get("fps"))
        kind, about, table = "sequence", _about_sequence(thing), _SEAMS
    about |= _about_mesh(thing)
    meshes = list_meshes(source)
    several = f"{len(meshes)}, read as one (--meshes NAME takes one): {', '.join(meshes[:20])}"
    rows = [("file", f"{source}: a {kind}"), ("clips", clips_text(clips))]
    rows += [("meshes", several if len(meshes) > 1 else ""), ("space", str(thing.space))]
    rows += in_words(about, _MESH | table)
    if about.get("hierarchy") is not None:
        rows += in_words(about["hierarchy"], _TREE)
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
    return {
        "duration": sum(clip.n_frames / clip.fps for clip in skinning.clips),
        "diagonal": rest_diagonal(skinning.rest),
        "bones": skinning.n_bones,
        "influences": skinning.n_influences,
        "bone_model": skinning.bone_model,
        "bones_without_vertices": int((skinning.sparse_weights().sum(axis=0) == 0).sum()),
        "hierarchy": None if skinning.parents is None else _about_tree(skinning, skinning.parents),
    }


def _about_tree(skinning: Skinning, parents: NDArray[np.int32]) -> dict[str, Any]:
    names, gaps = skinning.names(), skinning.joint_gaps().max(axis=0)
    return {
        "joints": skinning.n_bones,
        "roots": [names[b] for b in np.flatnonzero(parents < 0)],
        "depth": int(depths(parents).max()) + 1,
        "largest_gap": float(gaps.max()),
        "joint_of_largest_gap": names[int(gaps.argmax())],
    }


def _about_mesh(thing: MeshSequence | Skinned) -> dict[str, Any]:
    """Entries for the report on a mesh: counts, defects, connected components and surface."""
    n, faces, surface = thing.n_vertices, thing.faces, thing.surface
    first = thing.skinning.rest if isinstance(thing, Skinned) else thing.frames(0)
    points = np.asarray(first, dtype=np.float64)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, times = np.unique(edges, axis=0, return_counts=True)
    ones = np.ones(len(edges), dtype=np.int8)
    _, label = connected_components(coo_array((ones, edges.T), shape=(n, n)), directed=False)
    used = np.unique(faces)
    a, b, c = (points[faces[:, k]] for k in range(3))
    double = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return {
        "name": thing.name,
        **dataclasses.asdict(thing.space),
        "frames": thing.n_frames,
        "fps": thing.fps,
        "vertices": n,
        "triangles": len(faces),
        "components": len(np.unique(label[used])),
        "loose_vertices": n - len(used),
        "degenerate_triangles": int((double <= 1e-10 * longest).sum()),
        "boundary_edges": int((times == 1).sum()),
        "nonmanifold_edges": int((times > 2).sum()),
        "uv": surface is not None and surface.uv is not None,
        "normals": surface is not None and surface.normals is not None,
        "materials": [m.name for m in surface.materials] if surface is not None else [],
    }
