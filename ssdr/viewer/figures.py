"""Table and summary line of the quantities that a page states."""

from __future__ import annotations

from pathlib import Path

from rich.filesize import decimal

from .. import metrics
from ..skinning import Skinning
from ..storage.size import size
from .motion import MotionFigures, Truth


def figures(
    model: Skinning,
    skinned: bool,
    motion: MotionFigures,
    truth: Truth | None,
    angles: metrics.NormalErrors | None,
    file: Path | None,
    reference_name: str,
) -> list[tuple[str, str, str]]:
    """Rows of a table: name, value, and where the value comes from."""
    cache = 12 * model.n_frames * model.n_vertices
    cached = "every vertex of every frame in float32"
    seconds = sum(clip.n_frames / clip.fps for clip in model.clips)
    rows = [
        ("Vertices", f"{model.n_vertices:,}", f"{len(model.faces):,} triangles"),
        ("Frames", f"{model.n_frames:,}", f"{seconds:.3g} seconds"),
    ]
    if skinned:
        held = size(model)
        tree = "without a hierarchy" if model.parents is None else "in a hierarchy"
        used = int((model.weights > 0).sum(axis=1).max())
        rows += [
            ("Bones", f"{model.n_bones:,}", f"{model.bone_model}, {tree}"),
            ("Influences", f"{used}", "most bones that move one vertex"),
        ]
        if file is not None:
            rows.append(("File", decimal(file.stat().st_size), file.name))
        rows += [
            ("Animation", decimal(held.keys), "keys of the bones in float32"),
            ("Mesh and weights", decimal(held.total - held.keys), "as an engine stores them"),
        ]
        times = f"{cache / max(held.total, 1):,.1f} × the {decimal(held.total)} of"
        times += " animation, mesh and weights"
        if file is not None:
            times = f"{cache / max(file.stat().st_size, 1):,.1f} × the file ({times})"
        rows.append(("Vertex cache", decimal(cache), f"{cached}: {times}"))
    else:
        rows.append(("Vertex cache", decimal(cache), cached))
    if truth is not None:
        source = f"root mean square over all frames and vertices, against {reference_name}"
        where = f"in frame {motion.worst_frame} at vertex {motion.worst[motion.worst_frame]}"
        largest = motion.in_words(float(motion.largest.max()))
        rows += [("RMSE", motion.in_words(motion.rmse), source), ("Largest error", largest, where)]
    unit = "the mesh's units; per cent above are of this"
    rows.append(("Diagonal", f"{motion.diagonal:.4g}", unit))
    if angles is not None:
        source = f"mean angle to those of {reference_name}"
        source += ", as engines draw them" if skinned else ""
        source += f"; 95 % within {angles.p95:.3g}°, {100 * angles.inwards:.2g} % inwards"
        rows.append(("Normals", f"{angles.mean:.3g}°", source))
    return rows


def summary(
    model: Skinning, skinned: bool, motion: MotionFigures, truth: Truth | None, file: Path | None
) -> str:
    """One line of text with the most important quantities."""
    parts = [f"{model.n_bones:,} bones"] if skinned else []
    parts += [f"{model.n_vertices:,} vertices", f"{model.n_frames:,} frames"]
    if truth is not None:
        parts.append(f"RMSE {motion.in_words(motion.rmse)}")
    if file is not None:
        parts.append(f"file {decimal(file.stat().st_size)}")
    return " · ".join(parts)
