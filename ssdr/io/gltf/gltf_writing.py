"""Writing of glTF 2.0: a skinned mesh with its joints and clips, alone or in a template file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import InputError
from ...mesh.surface import Material, Surface
from ...model.shaped_normals import shaped_normals
from ...model.shapes import ShapedSkinning, Skinned, skinning_and_shapes, without_shapes
from ..corners import Corners, rest_normals, split_corners
from ..played_model import PlayedModel, WeightStorage, as_played
from ..save_report import SaveReport
from .builder import (
    ARRAY,
    ELEMENTS,
    Builder,
    add_animation,
    add_skin,
    add_weights,
    skeleton_nodes,
)
from .gltf_template import Template


def write_skinning(
    skinning: Skinned,
    path: Path,
    *,
    weights: WeightStorage = "float32",
    template: str | os.PathLike[str] | None = None,
    meshes: str | Sequence[str] | None = None,
    clip_names: Mapping[str, str | None] | None = None,
) -> SaveReport:
    """Write a skinning as ``.glb``, or as ``.gltf`` with a ``.bin`` of the same name beside it.

    Scene and mesh have the name of the skinning or, if it has none, of the file. An animation has
    the name of its clip or, if that has none, of the mesh.

    Parameters
    ----------
    skinning : Skinning or ShapedSkinning
        In metres with y up.  A bone that stretches becomes two nodes, of which the outer one
        rotates and scales and the inner one, the joint, rotates.  Shapes become morph targets,
        whose normals are fitted; they cannot be written with a template.
    path : Path
    weights : {"float32", "uint16", "uint8"}
        Type in which glTF stores weights.
    template : path, optional
        The glTF file that the model was made from, or one with the same vertices and triangles.
        It is written again with the model's skin and clips; all else in it stays as it is: names,
        materials, pictures, vertex colours, other meshes and their animation. Morph targets of
        the model's meshes are removed, because the skin replaces them.
    meshes : str or several of them, optional
        Names of the template's meshes that the model replaces, or of their nodes; all by default.
    clip_names : mapping of str to str, optional
        Maps the name of a clip in the template to its name in the model, where these differ, or to
        None if the clip is left out on purpose and not to be reported as lost.

    Returns
    -------
    SaveReport
        Its `error` is that of the whole file: rounding to float32 and quaternions, and stored
        weights.

    Raises
    ------
    InputError
        If the model does not fit the format (see :func:`ssdr.io.played_model.as_played`) or the
        template.

    References
    ----------
    Khronos, "glTF 2.0 specification", sections 3.7.3 (skins) and 3.11 (animations).
    """
    title = skinning.name or path.stem
    played = as_played(skinning, most=8, storage=weights, stretch=True)
    if played.n_bones > 65535:
        raise InputError("thing", "at most 65535 bones", played.n_bones)
    if template is None:
        return write_played(skinning, played, path, title)
    plain = without_shapes(skinning, "a file with a template")
    old = Template(Path(template), plain, meshes, clip_names or {})
    old.put(played, title)
    return _report(skinning, played, path, old.builder)


def write_played(skinning: Skinned, played: PlayedModel, path: Path, title: str) -> SaveReport:
    """Write a model without a template, given how it is played."""
    return _report(skinning, played, path, _document(skinning, played, title))


def _document(model: Skinned, played: PlayedModel, title: str) -> Builder:
    """A new document with the model."""
    builder = Builder()
    json = builder.json
    mesh: dict[str, Any] = {"name": title, "primitives": _mesh(builder, model, played)}
    if isinstance(model, ShapedSkinning) and model.driven:
        mesh["extras"] = {"ssdr": {"driven": True}}
    if played.shapes is not None:
        # without an animation: nothing if a frame has nothing, otherwise the mean
        amounts = played.shapes.amounts * bool(played.shapes.amounts.any(axis=1).all())
        mesh["weights"] = amounts.mean(axis=0).tolist()
        mesh.setdefault("extras", {})["targetNames"] = list(played.shapes.names)
    json["meshes"] = [mesh]
    # The mesh stands at the top of the scene: glTF ignores the transform of a
    # skinned mesh's node, and importers disagree about its parents.
    nodes = [{"name": title, "mesh": 0, "skin": 0}, *skeleton_nodes(played, title, 1)]
    json |= {"nodes": nodes, "scenes": [{"name": title, "nodes": [0, 1]}]}
    json["skins"] = [add_skin(builder, played, title, 1)]
    unnamed = ("", model.name) if len(played.clips) == 1 else ()
    json["animations"] = [
        add_animation(builder, played, clip, title if clip.name in unnamed else clip.name, 1)
        for clip in played.clips
    ]
    return builder


def _mesh(builder: Builder, model: Skinned, played: PlayedModel) -> list[dict[str, Any]]:
    """Add a mesh and return the JSON of its primitives."""
    surface, (skinning, shapes), fitted = model.surface, skinning_and_shapes(model), None
    normals = rest_normals(skinning, played.rest)
    if shapes is not None and normals is not None:
        fitted = shaped_normals(ShapedSkinning(skinning, shapes))
        normals = fitted.rest[fitted.corner].astype(np.float32)
    uv, colors = (None, None) if surface is None else (surface.uv, surface.colors)
    corners = split_corners(model.faces, model.n_vertices, uv, normals, colors)
    index = np.zeros(len(corners.faces), dtype=np.int32)
    if surface is not None and surface.material_index is not None:
        index = surface.material_index
    attributes = _attributes(builder, played, corners)
    primitives: list[dict[str, Any]] = [{"attributes": attributes, "mode": 0}]
    if len(corners.faces):
        primitives = _primitives(builder, surface or Surface(), corners, index, attributes)
    if played.shapes is not None:
        moved = {"POSITION": played.shapes.displacements[:, corners.vertex]}
        if fitted is not None:
            number = np.zeros(len(corners.vertex), dtype=np.int32)
            number[corners.faces] = fitted.corner
            moved["NORMAL"] = fitted.added[:, number]
        found = {name: builder.displaced(values) for name, values in moved.items()}
        targets = [dict(zip(found, one, strict=True)) for one in zip(*found.values(), strict=True)]
        primitives = [{**primitive, "targets": targets} for primitive in primitives]
    return primitives


def _report(model: Skinned, played: PlayedModel, path: Path, builder: Builder) -> SaveReport:
    """Write the file and return a report of its size, storage error, notes and losses."""
    size, notes = builder.save(path), builder.notes
    if played.indices.shape[1] > 4:
        notes.append("engines that read 4 influences alone will drop the smaller ones")
    return played.report(model, path=path, bytes=size, notes=tuple(notes), lost=tuple(builder.lost))


def _attributes(builder: Builder, played: PlayedModel, corners: Corners) -> dict[str, int]:
    def put(array: NDArray[Any], kind: str, **fields: Any) -> int:
        return builder.accessor(array, kind, target=ARRAY, **fields)

    vertex = corners.vertex
    attributes = {"POSITION": put(played.rest[vertex], "VEC3", bounds=True)}
    if corners.normals is not None:
        attributes["NORMAL"] = put(corners.normals, "VEC3")
    if corners.uv is not None:
        flipped = np.stack([corners.uv[:, 0], 1 - corners.uv[:, 1]], axis=1)
        attributes["TEXCOORD_0"] = put(flipped.astype(np.float32), "VEC2")
    if corners.colors is not None:
        attributes["COLOR_0"] = put(corners.colors, "VEC4")
    attributes |= add_weights(builder, played, vertex)
    # The model's vertex at each vertex of the file, so that reading can close the seams. Attributes
    # cannot be uint32, and float32 holds integers exactly up to 2^24.
    if len(played.rest) <= 1 << 24:
        attributes["_VERTEX"] = put(vertex.astype(np.float32), "SCALAR")
    return attributes


def _primitives(
    builder: Builder,
    surface: Surface,
    corners: Corners,
    index: NDArray[np.integer],
    attributes: dict[str, int],
) -> list[dict[str, Any]]:
    """Add the materials and triangles, and return the JSON of a primitive for each material."""
    # glTF's own default is bare metal, which is black wherever there is nothing to reflect
    materials = surface.materials or (Material(),)
    if "materials" not in builder.json:
        builder.json["materials"] = [_material(builder, m) for m in materials]
    wide = np.uint16 if len(corners.vertex) < 65535 else np.uint32
    result: list[dict[str, Any]] = []
    for k in np.unique(index):
        flat = corners.faces[index == k].reshape(-1).astype(wide)
        number = builder.accessor(flat, "SCALAR", target=ELEMENTS)
        result.append({"attributes": attributes, "indices": number, "mode": 4, "material": int(k)})
    return result


def _material(builder: Builder, material: Material) -> dict[str, Any]:
    look: dict[str, Any] = {
        "baseColorFactor": [float(c) for c in material.base_color],
        "metallicFactor": float(material.metallic),
        "roughnessFactor": float(material.roughness),
    }
    kind = material.texture_type
    if material.texture is not None and kind in ("image/png", "image/jpeg"):
        images = builder.json.setdefault("images", [])
        textures = builder.json.setdefault("textures", [])
        look["baseColorTexture"] = {"index": len(textures)}
        textures.append({"source": len(images)})
        view = builder.view(material.texture)
        images.append({"bufferView": view, "mimeType": kind, "name": material.name})
    elif material.texture is not None:
        builder.notes.append(
            f"the texture of {material.name} is left out: glTF holds PNG and JPEG, not {kind}"
        )
    item: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": look}
    if material.double_sided:
        item["doubleSided"] = True
    if material.base_color[3] < 1:
        item["alphaMode"] = "BLEND"
    return item
