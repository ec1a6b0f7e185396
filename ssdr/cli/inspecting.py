"""``ssdr info``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..clips import Clip
from ..hierarchy.transforms import RIGID, depths, rest_diagonal
from ..joints.mirror import mirror_of, mirrored_edges
from ..sequence import MeshSequence
from ..skinning import Skinning
from .output import (
    Fps,
    JsonFlag,
    Output,
    ReadOptions,
    Verbose,
    length_text,
    read_any,
    size_text,
)
from .reading import ClipNames, clips_document, clips_in, clips_text, options_for, read_model


def info(
    source: Annotated[Path, typer.Argument(metavar="FILE", help="A sequence or a skinning.")],
    clip: ClipNames = None,
    fps: Fps = None,
    read: ReadOptions = None,
    json: JsonFlag = False,
    verbose: Verbose = 0,
) -> None:
    """Say what a file holds and what in it may give trouble.

    Of a file of several clips without a skin, all but the list of clips is about the first.
    """
    output = Output.start(json=json, verbose=verbose)
    (options,) = options_for([source], read, fps=fps)
    with output.waiting(f"loading {source}"):
        thing = read_any(source, **options) if clip is None else read_model(source, clip, options)
    if isinstance(thing, Skinning):
        listed = thing.clips
    else:
        name = thing.clip or thing.name or source.stem
        listed = (Clip(name, 0, thing.n_frames, thing.fps),)
        if clip is None:
            listed = clips_in(source, options) or listed
    document: dict[str, Any] = {"command": "info", "input": source}
    if isinstance(thing, Skinning):
        document |= {"kind": "skinning", **_about_skinning(thing)}
        rows = _skinning_rows(document)
    else:
        document |= {"kind": "sequence", **_about_sequence(thing)}
        rows = _sequence_rows(document)
    document["clips"] = clips_document(listed)
    rows.insert(1, ("clips", clips_text(listed) if len(listed) > 1 else listed[0].name))
    output.result(document, [("file", f"{source}: a {document['kind']}"), *rows])


def _about_sequence(sequence: MeshSequence) -> dict[str, Any]:
    first = np.asarray(sequence.frames(0), dtype=np.float64)
    _, weld = sequence.weld()
    itemsize = np.dtype(sequence.vertices.dtype).itemsize
    return {
        "name": sequence.name,
        "frames": sequence.n_frames,
        "vertices": sequence.n_vertices,
        "fps": sequence.fps,
        "duration": sequence.n_frames / sequence.fps,
        "dtype": str(sequence.vertices.dtype),
        "memory": sequence.n_frames * sequence.n_vertices * 3 * itemsize,
        "in_memory": not sequence.is_lazy,
        "diagonal": sequence.diagonal(),
        "low": first.min(axis=0),
        "high": first.max(axis=0),
        "seams": weld.before - weld.after,
        **_about_surface(sequence),
        **_about_faces(sequence.faces, first),
    }


def _about_skinning(skinning: Skinning) -> dict[str, Any]:
    used = (skinning.weights > 0).sum(axis=1)
    share = np.bincount(
        skinning.indices.ravel(), skinning.weights.ravel(), minlength=skinning.n_bones
    )
    rest = skinning.rest.astype(np.float64)
    arrays = (skinning.rest, skinning.indices, skinning.weights, skinning.transforms)
    low, high = rest.min(axis=0), rest.max(axis=0)
    return {
        "name": skinning.name,
        "frames": skinning.n_frames,
        "vertices": skinning.n_vertices,
        "bones": skinning.n_bones,
        "influences": skinning.n_influences,
        "bone_model": skinning.bone_model,
        "fps": skinning.fps,
        "duration": sum(clip.n_frames / clip.fps for clip in skinning.clips),
        "dtype": str(skinning.transforms.dtype),
        "memory": sum(a.nbytes for a in arrays),
        "rest_diagonal": float(np.linalg.norm(high - low)),
        "influence_histogram": np.bincount(used, minlength=skinning.n_influences + 1)[1:],
        "bones_without_vertices": int((share == 0).sum()),
        "weight_sum_error": float(np.abs(skinning.weights.sum(axis=1, dtype=np.float64) - 1).max()),
        "seams": _seams(skinning),
        **_about_bones(skinning),
        "hierarchy": _about_hierarchy(skinning),
        **_about_surface(skinning),
        **_about_faces(skinning.faces, rest),
    }


def _about_bones(skinning: Skinning) -> dict[str, Any]:
    """How far bones are from turning alone; growth, which a similarity may have, apart."""
    linear = skinning.transforms[..., :3].astype(np.float64)
    determinant = np.linalg.det(linear)
    stretch = np.linalg.svd(linear, compute_uv=False)
    turn = linear
    if skinning.bone_model != "rigid":
        scale = np.cbrt(np.abs(determinant))
        turn = linear / np.where(scale > 0, scale, 1)[..., None, None]
    off = np.swapaxes(turn, -1, -2) @ turn - np.eye(3)
    return {
        "orthonormality_error": float(np.abs(off).max()),
        "smallest_determinant": float(determinant.min()),
        "smallest_stretch": float(stretch.min()),
        "largest_stretch": float(stretch.max()),
    }


def _about_hierarchy(skinning: Skinning) -> dict[str, Any] | None:
    """Roots, depth, and how far joints come apart; None where there is no hierarchy."""
    if skinning.parents is None:
        return None
    names, gaps = skinning.names(), skinning.joint_gaps().max(axis=0)
    return {
        "joints": skinning.n_bones,
        "roots": [names[b] for b in np.flatnonzero(skinning.parents < 0)],
        "depth": int(depths(skinning.parents).max()) + 1,
        "parents": skinning.parents,
        "largest_gap": float(gaps.max()),
        "joint_of_largest_gap": names[int(gaps.argmax())],
        "rigid": bool(gaps.max() <= RIGID * rest_diagonal(skinning.rest)),
        "mirror": _about_mirror(skinning),
    }


def _about_mirror(skinning: Skinning) -> dict[str, Any] | None:
    """The rest pose's plane of symmetry, and how much of the tree is its own image in it."""
    mirror = mirror_of(skinning.rest, skinning.indices, skinning.weights, skinning.n_bones)
    if mirror is None or skinning.parents is None:
        return None
    mirrored, edges = mirrored_edges(mirror, skinning.parents)
    return {
        "normal": mirror.normal,
        "offset": mirror.offset,
        "bones_with_partner": int((mirror.partners >= 0).sum()),
        "edges": edges,
        "mirrored_edges": mirrored,
    }


def _seams(skinning: Skinning) -> int:
    """Vertices at the place of others at rest, with their weights: they coincide in every frame."""
    rest = skinning.rest.astype(np.float64)
    size = float(np.linalg.norm(rest.max(axis=0) - rest.min(axis=0)))
    weights = skinning.dense_weights().astype(np.float64) * (size or 1.0)
    columns = np.concatenate([rest, weights], axis=1)
    columns = np.pad(columns, ((0, 0), (0, -columns.shape[1] % 3)))
    frames = np.swapaxes(columns.reshape(len(rest), -1, 3), 0, 1)
    _, weld = MeshSequence(frames, validate=False).weld()
    return weld.before - weld.after


def _about_surface(thing: MeshSequence | Skinning) -> dict[str, Any]:
    surface = thing.surface
    return {
        "uv": surface is not None and surface.uv is not None,
        "normals": surface is not None and surface.normals is not None,
        "materials": [m.name for m in surface.materials] if surface is not None else [],
        "welded_from": None if thing.vertex_map is None else len(thing.vertex_map),
    }


def _about_faces(faces: NDArray[np.int32], points: NDArray[np.float64]) -> dict[str, Any]:
    """Counts that say whether a mesh is closed, clean and in one piece."""
    n = len(points)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, times = np.unique(edges, axis=0, return_counts=True)
    ones = np.ones(len(edges), dtype=np.int8)
    graph = coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(n, n))
    used = np.zeros(n, dtype=bool)
    used[faces] = True
    _, label = connected_components(graph, directed=False)
    a, b, c = (points[faces[:, k]] for k in range(3))
    double = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return {
        "triangles": len(faces),
        "components": len(np.unique(label[used])),
        "loose_vertices": int(n - used.sum()),
        "degenerate_triangles": int((double <= 1e-10 * longest).sum()),
        "boundary_edges": int((times == 1).sum()),
        "nonmanifold_edges": int((times > 2).sum()),
    }


def _sequence_rows(d: dict[str, Any]) -> list[tuple[str, str]]:
    where = "" if d["in_memory"] else ", read by chunks"
    box = " × ".join(f"{x:.4g}" for x in d["high"] - d["low"])
    return [
        *_time_rows(d),
        *_mesh_rows(d),
        _seams_row(d),
        ("size", f"diagonal {length_text(d['diagonal'], None)}, frame 0 {box}"),
        ("memory", f"{size_text(d['memory'])}, {d['dtype']}{where}"),
    ]


def _skinning_rows(d: dict[str, Any]) -> list[tuple[str, str]]:
    counts = [f"{k + 1}: {int(n):,}" for k, n in enumerate(d["influence_histogram"])]
    idle = d["bones_without_vertices"]
    return [
        *_time_rows(d),
        ("bones", f"{d['bones']} ({d['bone_model']})" + (f", {idle} move nothing" * bool(idle))),
        ("influences", f"at most {d['influences']}; vertices by number: {', '.join(counts)}"),
        ("weights", f"sums off 1 by at most {d['weight_sum_error']:.2g}"),
        *_hierarchy_rows(d),
        _bones_row(d),
        *_mesh_rows(d),
        _seams_row(d),
        ("size", f"diagonal of the rest pose {length_text(d['rest_diagonal'], None)}"),
        ("memory", f"{size_text(d['memory'])}, {d['dtype']}"),
    ]


def _seams_row(d: dict[str, Any]) -> tuple[str, str]:
    seams = f"{d['seams']:,} vertices coincide with others in every frame (--weld merges them)"
    return "seams", seams if d["seams"] else "none"


def _hierarchy_rows(d: dict[str, Any]) -> list[tuple[str, str]]:
    tree = d["hierarchy"]
    if tree is None:
        return []
    roots = tree["roots"]
    said = f"root {roots[0]}" if len(roots) == 1 else f"{len(roots)} roots"
    gap = "rigid joints"
    if not tree["rigid"]:
        size = length_text(tree["largest_gap"], d["rest_diagonal"])
        gap = f"largest gap of a joint {size}, at {tree['joint_of_largest_gap']}"
    mirror, symmetry = tree["mirror"], "the rest pose is not its own mirror image"
    if mirror is not None:
        symmetry = (
            f"{mirror['bones_with_partner']} of {tree['joints']} joints have a mirror image, "
            f"{mirror['mirrored_edges']} of {mirror['edges']} edges between them, too"
        )
    return [
        ("hierarchy", f"{tree['joints']} joints, {said}, {tree['depth']} deep; {gap}"),
        ("symmetry", symmetry),
    ]


def _bones_row(d: dict[str, Any]) -> tuple[str, str]:
    off = f"off orthonormal by at most {d['orthonormality_error']:.2g}"
    determinant = f"determinant from {d['smallest_determinant']:.6g}"
    low, high = d["smallest_stretch"], d["largest_stretch"]
    scales = f"{low:.4g}" if math.isclose(low, high, rel_tol=1e-4) else f"{low:.4g} to {high:.4g}"
    if d["bone_model"] == "rigid":
        return "rotations", f"{off}, {determinant}"
    if d["bone_model"] == "similarity":
        return "rotations", f"scaled by {scales}; apart from that {off}"
    return "transforms", f"stretch by {scales}, {determinant}"


def _time_rows(d: dict[str, Any]) -> list[tuple[str, str]]:
    return [("frames", f"{d['frames']:,} at {d['fps']:g} a second, {d['duration']:.3g} s")]


def _mesh_rows(d: dict[str, Any]) -> list[tuple[str, str]]:
    what = [name for name, there in (("UVs", d["uv"]), ("normals", d["normals"])) if there]
    what += [f"{len(d['materials'])} materials"] if d["materials"] else []
    trouble = [
        f"{d[key]:,} {key.replace('_', ' ')}"
        for key in (
            "loose_vertices",
            "degenerate_triangles",
            "boundary_edges",
            "nonmanifold_edges",
        )
        if d[key]
    ]
    welded = "" if d["welded_from"] is None else f" (welded from {d['welded_from']:,})"
    return [
        ("vertices", f"{d['vertices']:,}{welded}"),
        ("triangles", f"{d['triangles']:,}, connected components: {d['components']:,}"),
        ("mesh", ", ".join(trouble) or "closed and clean"),
        ("surface", ", ".join(what)),
    ]
