"""Reading glTF 2.0: skins, morph targets and moving nodes, baked or as a skinning."""

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
    """Read all meshes of the scene, with every animation channel baked to vertices.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Where to sample; by default at the rate of the keys, 24 where they do not determine one.
    clip : int or str, optional
        Which animation, by number or name; the first by default. The log lists them all.
    animation : int or str, optional
        The same as `clip`, under glTF's name for it.
    meshes : str or several of them, optional
        Names of meshes, or of nodes that have one; the others are left out.
    max_bytes : int, optional
        Memory that the file may ask for; by default 1000 times its size, but at least 1 GiB and
        at most 16 GiB.

    Returns
    -------
    MeshSequence
        float32, y up, metres; the meshes follow each other in the order of the scene.

    Raises
    ------
    FormatError
        If the file is damaged, hostile, or needs an extension that is not supported.
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
    """Read skins as they are; a mesh without a skin becomes one bone that carries it.

    The parent of a joint is the nearest node above it that is a joint of the same skin. Where no
    joint has one, there is no hierarchy.

    Parameters
    ----------
    path, fps, meshes, max_bytes
        As in :func:`read`, of every animation.
    animation : int or str, optional
        One animation alone, by number or name; all of them by default.

    Raises
    ------
    FormatError
        Also where morph targets move the mesh: no skinning holds them.
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
