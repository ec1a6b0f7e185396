"""Reading of glTF 2.0, either baked to vertices or as a skinning."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...clips import Clip, in_order, pick
from ...errors import InputError
from ...sequence import MeshSequence
from ...skinning import Skinning
from ..registry import pick_clip, reading
from ..scene import Sample, join_sequence, join_skinning, part_starts
from .animation import Nodes, animation_names, mesh_name, read_animation, read_animations
from .document import Document
from .parts import check_meshes, read_looks, read_parts


def read(
    path: Path,
    *,
    fps: float | None = None,
    clip: int | str | None = None,
    animation: int | str | None = None,
    meshes: str | Sequence[str] | None = None,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read all meshes of the scene, with skins, morph targets and moving nodes baked to vertices.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Frames per second at which to sample; by default those that the file states or its keys
        imply, else 24.
    clip : int or str, optional
        Name or index of the animation; the first by default. The log lists all of them.
    animation : int or str, optional
        Another name of `clip`, as in glTF.
    meshes : str or several of them, optional
        Names of the meshes to read, or of nodes that hold them; all by default.
    max_bytes : int, optional
        Most memory that reading may take; by default 1000 times the size of the file, but at
        least 1 GiB and at most 16 GiB.

    Returns
    -------
    MeshSequence
        Vertices in float32, in metres, with y up; the meshes follow each other in the order of the
        scene.

    Raises
    ------
    FormatError
        If the file is damaged, needs more memory than `max_bytes`, or requires an extension that
        is not supported.
    InputError
        If there is no such animation or mesh.
    """
    with reading(path):
        document = Document(path, max_bytes)
        names = animation_names(document)
    if clip is not None and animation is not None:
        raise InputError("animation", "nothing beside a clip", repr(animation))
    chosen = (clip, path) if animation is None else (animation, path, "animation")
    index = pick_clip(names, *chosen)
    wanted = check_meshes(document, meshes)
    with reading(path):
        nodes = Nodes(document, read_animation(document, index, fps))
        parts = read_parts(document, nodes, wanted)
        n_frames, n_vertices = len(nodes.animation.times), part_starts(parts)[-1]
        document.budget.spend(
            12.0 * n_frames * n_vertices, f"{n_frames} frames of {n_vertices} vertices"
        )
        sample = Sample(nodes.animation.clip, parts, nodes)
        return join_sequence(sample, read_looks(document, parts), mesh_name(document))


def list_clips(path: Path, *, fps: float | None = None) -> tuple[Clip, ...]:
    """Clips of a file, with frames numbered as in :func:`read_skinning`."""
    with reading(path):
        return in_order(one.clip for one in read_animations(Document(path), fps))


def read_skinning(
    path: Path,
    *,
    fps: float | None = None,
    animation: int | str | None = None,
    meshes: str | Sequence[str] | None = None,
    max_bytes: int | None = None,
) -> Skinning:
    """Read the skins of a file without baking them; a mesh without a skin gets one bone.

    The parent of a joint is the nearest node above it that is a joint of the same skin. If no
    joint has a parent, the skinning has no hierarchy.

    Parameters
    ----------
    path, meshes, max_bytes
        As in :func:`read`.
    fps : float, optional
        As in :func:`read`, for every animation.
    animation : int or str, optional
        Name or index of the only animation to read; all are read by default.

    Raises
    ------
    FormatError
        As in :func:`read`, and if morph targets move a mesh, which a skinning cannot store.
    InputError
        If there is no such animation or mesh.
    """
    with reading(path):
        document = Document(path, max_bytes)
        names = animation_names(document)
    numbers = range(len(names)) if animation is None else [pick(names, animation, "animation")]
    wanted = check_meshes(document, meshes)
    with reading(path):
        clips = [Nodes(document, read_animation(document, k, fps)) for k in numbers]
        parts = read_parts(document, clips[0], wanted)
        samples = [Sample(nodes.animation.clip, parts, nodes) for nodes in clips]
        return join_skinning(samples, read_looks(document, parts), mesh_name(document))
