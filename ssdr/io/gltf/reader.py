"""glTF 2.0 (``.glb``, ``.gltf``): skins, morph targets and moving nodes, baked or as a skinning."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip, in_order
from ...errors import FormatError, InputError
from ...sequence import MeshSequence
from ...skinning import Skinning, skin
from ..registry import reading
from ..rig import MAX_BYTES, check_size, join_trees, model_of, unique_names
from .animation import Animation, World, choose, every, title
from .document import Document
from .mesh import Part, check_meshes, join_surface, read_parts
from .writer import write_skinning

__all__ = ["list_clips", "read", "read_skinning", "write_skinning"]

_log = logging.getLogger(__name__)
_CHUNK_BYTES = 64 << 20  # bytes of float64 positions skinned at a time: more takes more memory


def read(
    path: Path,
    *,
    fps: float | None = None,
    clip: int | str | None = None,
    animation: int | str | None = None,
    meshes: str | Sequence[str] | None = None,
    max_bytes: int | None = None,
) -> MeshSequence:
    """Read all meshes of the scene, every animation channel baked to vertices.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Where to sample; that of the keys by default, 24 where they say
        nothing.
    clip : int or str, optional
        Which animation, by number or name; the first by default.  The log
        lists them all.
    animation : int or str, optional
        The same by glTF's word.
    meshes : str or several of them, optional
        Names of meshes, or of nodes that have one; the others are left out.
    max_bytes : int, optional
        Largest size of the vertices; 16 GiB by default.

    Returns
    -------
    MeshSequence
        float32, y up, metres; meshes one behind the other in the order of the
        scene.

    Raises
    ------
    FormatError
        If the file is damaged, hostile, or needs an extension that is not
        supported.
    InputError
        If there is no such animation.
    """
    with reading(path):
        document = Document(path)
    chosen = _chosen(document, clip, animation, fps)
    wanted = check_meshes(document, meshes)
    with reading(path):
        world = World(document, chosen)
        parts = read_parts(document, world, wanted)
        count = sum(len(part.vertex) for part in parts)
        check_size(chosen.n_frames, count, MAX_BYTES if max_bytes is None else max_bytes)
        frames = np.empty((chosen.n_frames, count, 3), dtype=np.float32)
        first = 0
        for part in parts:
            last = first + len(part.vertex)
            _bake(part, chosen, world, frames[:, first:last])
            first = last
        faces = _join_faces(parts)
        return MeshSequence(
            frames,
            faces,
            chosen.fps,
            name=title(document),
            clip=chosen.name,
            surface=join_surface(document, parts, len(faces)),
        )


def list_clips(path: Path, *, fps: float | None = None) -> tuple[Clip, ...]:
    """The animations of a file, in the frames of :func:`read_skinning`."""
    with reading(path):
        document = Document(path)
        return _clips(every(document, fps))


def _clips(animations: list[Animation]) -> tuple[Clip, ...]:
    return in_order(Clip(a.name, 0, a.n_frames, a.fps) for a in animations)


def _chosen(
    document: Document, clip: int | str | None, animation: int | str | None, fps: float | None
) -> Animation:
    if animation is None:
        return choose(document, clip, fps)
    if clip is not None:
        raise InputError("animation", "nothing beside a clip", repr(animation))
    return choose(document, animation, fps, "animation")


def read_skinning(
    path: Path,
    *,
    fps: float | None = None,
    animation: int | str | None = None,
    meshes: str | Sequence[str] | None = None,
) -> Skinning:
    """Read skins as they are; a mesh without a skin becomes one bone that carries it.

    A joint hangs on the nearest node above it that is a joint of the same skin.  Where none
    hangs on another, there is no hierarchy.

    Parameters
    ----------
    path : Path
    fps : float, optional
        As in :func:`read`, of every animation.
    animation : int or str, optional
        One animation alone, by number or name; all of them by default.
    meshes : str or several of them, optional
        As in :func:`read`.

    Raises
    ------
    FormatError
        Also where morph targets move the mesh: no skinning holds them.
    InputError
        If there is no such animation.
    """
    with reading(path):
        document = Document(path)
    alone = None if animation is None else choose(document, animation, fps, "animation")
    wanted = check_meshes(document, meshes)
    with reading(path):
        chosen = every(document, fps) if alone is None else [alone]
        worlds = [World(document, one) for one in chosen]
        world = worlds[0]
        parts = read_parts(document, world, wanted)
        if any(part.morphs(w) for part in parts for w in worlds):
            raise FormatError(
                f"{path}: morph targets move the mesh, which no skinning holds; "
                "ssdr.load bakes them"
            )
        bones = [(part.skin, part.node if part.skin is None else -1) for part in parts]
        order = list(dict.fromkeys(bones))
        matrices = {}
        names: list[str] = []
        starts = {}
        for part, key in zip(parts, bones, strict=True):
            if key not in matrices:
                starts[key] = len(names)
                matrices[key] = np.concatenate([part.matrices(w) for w in worlds])
                names += part.bone_names(document)
        check_size(sum(one.n_frames for one in chosen), 4 * len(names), MAX_BYTES)
        transforms = np.concatenate([matrices[key] for key in order], axis=1)
        width = max(part.indices.shape[1] for part in parts)
        indices = [
            _widen(part.indices + starts[key], width)
            for part, key in zip(parts, bones, strict=True)
        ]
        weights = np.concatenate([_widen(part.weights, width) for part in parts])
        faces = _join_faces(parts)
        trees = {key: part.hierarchy(world) for key, part in zip(bones, parts, strict=True)}
        parents, positions = join_trees([trees[key] for key in order])
        return Skinning(
            np.concatenate([part.rest(world) for part in parts]),
            np.where(weights > 0, np.concatenate(indices), 0),
            weights,
            transforms,
            faces=faces,
            bone_model=model_of(transforms),
            surface=join_surface(document, parts, len(faces)),
            bone_names=unique_names(names),
            name=title(document),
            clips=_clips(chosen),
            parents=parents,
            joint_positions=positions,
        )


def _join_faces(parts: list[Part]) -> NDArray[np.int32]:
    starts = np.cumsum([0] + [len(part.vertex) for part in parts])
    return np.concatenate(
        [part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]
    ).astype(np.int32)


def _widen(values: NDArray[Any], width: int) -> NDArray[Any]:
    return np.pad(values, ((0, 0), (0, width - values.shape[1])))


def _bake(part: Part, clip: Animation, world: World, out: NDArray[np.float32]) -> None:
    matrices = part.matrices(world)
    amounts = part.morph_weights(world)
    if amounts is None and part.skin is None and (matrices == np.eye(3, 4)).all():
        out[:] = part.positions  # to the bit: a product with 1 turns -0 into 0
        return
    step = max(1, _CHUNK_BYTES // (24 * len(part.vertex)))
    for first in range(0, clip.n_frames, step):
        last = min(first + step, clip.n_frames)
        if amounts is None:
            out[first:last] = skin(
                part.positions, part.indices, part.weights, matrices[first:last], dtype=np.float64
            )
            continue
        for frame in range(first, last):
            shape = part.positions + np.einsum("k,kvc->vc", amounts[frame], part.targets)
            out[frame] = skin(shape, part.indices, part.weights, matrices[frame], dtype=np.float64)
    if not np.isfinite(out).all():
        raise InputError("vertices", "finite numbers in float32", "an overflow")
