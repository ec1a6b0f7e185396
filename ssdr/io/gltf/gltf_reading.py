"""Open files of glTF 2.0, and their materials."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mesh.clips import Clip
from ...mesh.surface import METRES_Y_UP, Material
from ...model.shapes import Skinned, shaped
from ..file_clips import pick_clip
from ..file_errors import reading
from ..sampling import Sample, part_starts
from ..scene import join_sequence, join_skinning
from ..signatures import picture_type
from .animation import (
    Nodes,
    animation_names,
    mesh_name,
    read_animation,
    read_animations,
    still_frame,
)
from .document import Document
from .primitives import JointPoints, PrimitiveGroup, names_of, read_parts


def read(
    path: Path,
    *,
    fps: float | None = None,
    clip: int | str | None = None,
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
    with reading(path, "clip", "meshes"):
        document = Document(path, max_bytes)
        index = pick_clip(animation_names(document), clip, path)
        nodes = Nodes(document, read_animation(document, index, fps))
        parts = read_parts(document, nodes, meshes)
        n_frames, n_vertices = len(nodes.animation.times), part_starts(parts)[-1]
        document.budget.spend(
            12.0 * n_frames * n_vertices, f"{n_frames} frames of {n_vertices} vertices"
        )
        sample = _sample(parts, nodes, fps)
        return join_sequence(sample, read_materials(document), mesh_name(document), METRES_Y_UP)


def _sample(parts: Sequence[PrimitiveGroup], nodes: Nodes, fps: float | None) -> Sample:
    """Clip that `nodes` play, with the keys that lie between its frames."""
    one, document = nodes.animation, nodes.document

    def at(times: NDArray[np.float64]) -> Nodes:
        return Nodes(document, dataclasses.replace(one, times=times))

    return Sample(
        clip=one.clip,
        parts=parts,
        time=nodes,
        at=at,
        frames=one.frames,
        path=document.path,
        own=fps is None,
    )


def list_clips(path: Path, *, fps: float | None = None) -> tuple[Clip, ...]:
    """Clips of a file, with frames numbered as in :func:`read_skinning`."""
    with reading(path):
        return in_order(one.clip for one in read_animations(Document(path), fps))


def list_meshes(path: Path) -> tuple[str, ...]:
    """Names of the meshes of the scene: that of the node, or else that of the mesh itself."""
    with reading(path):
        document = Document(path)
        still = Nodes(document, still_frame())
        held = [number for number in still.shown if "mesh" in still.items[number]]
        return tuple(dict.fromkeys(names_of(document, number)[0] for number in held))


def read_skinning(
    path: Path,
    *,
    fps: float | None = None,
    meshes: str | Sequence[str] | None = None,
    joints_alone: bool = False,
    max_bytes: int | None = None,
) -> Skinned:
    """Read the skins of a file without baking them; a mesh without a skin gets one bone.

    The parent of a joint is the nearest node above it that is a joint of the same skin. If no
    joint has a parent, the skinning has no hierarchy.

    Parameters
    ----------
    path, meshes, max_bytes
        As in :func:`read`.
    fps : float, optional
        As in :func:`read`, for every animation; all are read.
    joints_alone : bool
        Read a file without a mesh: the nodes that move, and those below them, with a vertex at
        each.

    Raises
    ------
    FormatError
        As in :func:`read`.
    InputError
        If there is no such animation or mesh.
    """
    with reading(path, "meshes"):
        document = Document(path, max_bytes)
        clips = [Nodes(document, one) for one in read_animations(document, fps)]
        if joints_alone and not any("mesh" in clips[0].items[k] for k in clips[0].shown):
            parts: list[PrimitiveGroup] = [JointPoints(document, clips)]
        else:
            parts = read_parts(document, clips[0], meshes)
        samples = [_sample(parts, nodes, fps) for nodes in clips]
        model = join_skinning(samples, read_materials(document), mesh_name(document), METRES_Y_UP)
        extras = [mesh.get("extras") for mesh in document.items("meshes")]
        stated = [one.get("ssdr") for one in extras if isinstance(one, dict)]
        driven = any(isinstance(one, dict) and one.get("driven") is True for one in stated)
        return _as_face(model) if driven else model


def _as_face(model: Skinned) -> Skinned:
    """Model that weights drive, unless its clips are no expressions (as at another frame rate)."""
    with contextlib.suppress(InputError):
        return dataclasses.replace(shaped(model), driven=True)
    return model


_log = logging.getLogger(__name__)


class GltfFile(SceneFile):
    """A glTF file; all its animations move the same parts."""

    space = METRES_Y_UP

    def __init__(self, path: Path, max_bytes: int | None = None, meshes: Any = None) -> None:
        self.document, self._wanted = Document(path, max_bytes), meshes
        self.name, self.clip_names = mesh_name(self.document), animation_names(self.document)
        extras = [mesh.get("extras") for mesh in self.document.items("meshes")]
        stated = [one.get("ssdr") for one in extras if isinstance(one, dict)]
        self.driven = any(isinstance(one, dict) and one.get("driven") is True for one in stated)
        self._parts: Sequence[PrimitiveGroup] = ()

    def clips(self, fps: float | None) -> list[Clip]:
        return [one.clip for one in read_animations(self.document, fps)]

    def mesh_names(self) -> tuple[str, ...]:
        """Names of the meshes of the scene: that of the node, or else that of the mesh itself."""
        still = Nodes(self.document, still_frame())
        held = [number for number in still.shown if "mesh" in still.items[number]]
        return tuple(dict.fromkeys(names_of(self.document, number)[0] for number in held))

    def sample(self, index: int, fps: float | None, joints_alone: bool = False) -> Sample:
        """Parts of the scene and the nodes that move them in one animation.

        If `joints_alone` and there are no meshes, there is one part, of the moving nodes.
        """
        document = self.document
        one = read_animation(document, index, fps, self.clip_names[index])
        nodes = Nodes(document, one)
        if not self._parts:
            if joints_alone and not any("mesh" in nodes.items[k] for k in nodes.shown):
                self._parts = [JointPoints(document)]
            else:
                self._parts = read_parts(document, nodes, self._wanted)

        def at(times: NDArray[np.float64]) -> Nodes:
            return Nodes(document, dataclasses.replace(one, times=times))

        return Sample(
            clip=one.clip,
            parts=self._parts,
            time=nodes,
            at=at,
            frames=one.frames,
            budget=document.budget,
            own=fps is None,
        )

    def materials(self, _parts: Sequence[Any]) -> list[Material]:
        return [_material(self.document, item) for item in self.document.items("materials")]


def _material(document: Document, item: dict[str, Any]) -> Material:
    look = item.get("pbrMetallicRoughness", {})
    r, g, b, a = document.numbers(look, "baseColorFactor", [1.0] * 4).tolist()
    texture, kind = None, "image/png"
    if "baseColorTexture" in look:
        reference = look["baseColorTexture"]
        if "KHR_texture_transform" in reference.get("extensions", {}):
            _log.warning("%s: the transform of a texture is left out", document.path)
        source = document.items("textures")[reference["index"]].get("source")
        if source is None:
            _log.warning("%s: a texture has no PNG or JPEG image", document.path)
        else:
            image = document.items("images")[source]
            texture = document.picture(image)
            kind = str(image.get("mimeType") or picture_type(texture) or kind)
    return Material(
        name=str(item.get("name", "material")),
        base_color=(r, g, b, a),
        metallic=document.number(look.get("metallicFactor", 1.0), "metallicFactor"),
        roughness=document.number(look.get("roughnessFactor", 1.0), "roughnessFactor"),
        double_sided=bool(item.get("doubleSided", False)),
        texture=texture,
        texture_type=kind,
    )
