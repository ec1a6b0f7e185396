"""Writing glTF 2.0: a skinned mesh with an animation that any engine plays."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip
from ...errors import InputError
from ...rigid import quaternion_from_matrix
from ...sequence import Material
from ...skinning import Skinning
from ..axes import Up, check_up, turn_skinning_up
from ..corners import Corners, corner_normals, split_corners
from ..registry import SaveReport, seconds
from ..rig import Rig, WeightStorage, build_rig, quantise
from .builder import ARRAY, ELEMENTS, Builder
from .template import Template, open_template

__all__ = ["plain", "write_skinning"]


def write_skinning(
    skinning: Skinning,
    path: Path,
    *,
    influences: int | None = None,
    weights: WeightStorage = "float32",
    up: Up = "y",
    name: str | None = None,
    template: str | os.PathLike[str] | None = None,
    meshes: str | Sequence[str] | None = None,
    clip_names: Mapping[str, str] | None = None,
    strict: bool = False,
) -> SaveReport:
    """Write ``.glb``, or ``.gltf`` with a ``.bin`` of the same name beside it.

    Parameters
    ----------
    skinning : Skinning
        Rigid or similarity bones.
    path : Path
    influences : int, optional
        Keep so many of the largest weights of a vertex; more than 8 must be
        pruned.  Many engines read the first 4 alone.
    weights : {"float32", "uint16", "uint8"}
        How weights are stored.
    up : {"y", "z"}
        The model's up axis; glTF's is y, so "z" turns it.
    name : str, optional
        Of scene and mesh; that of the skinning, else of the file, by default.
        Animations are called as the clips, one without a name of its own as
        the mesh.
    template : path, optional
        The glTF file that the model was made of, or one with the same vertices and
        triangles.  It is written again with the model's skin and clips; all else in
        it stays as it is: names, materials, pictures, vertex colours, other meshes
        and their animation.  Morph targets of the model's meshes are baked.
    meshes : str or several of them, optional
        The meshes of the template that the model is, as in :func:`read`.
    clip_names : mapping of str to str, optional
        What clips of the template are called in the model, where that differs.
    strict : bool
        Refuse, rather than report, what of the template cannot be kept.

    Returns
    -------
    SaveReport
        `error`: float32 geometry, quaternions, stored and pruned weights
        together.

    Raises
    ------
    InputError
        If the model does not fit the format, see
        :func:`ssdr.io.rig.build_rig`.

    References
    ----------
    Khronos, "glTF 2.0 specification", sections 3.7.3 (skins) and 3.11 (animations).
    """
    check_up(up)
    model = turn_skinning_up(skinning, up, "y")
    rig = build_rig(model, influences=influences, most=8)
    if rig.n_bones > 65535:
        raise InputError("thing", "at most 65535 bones", rig.n_bones)
    indices, stored, values = quantise(rig.indices, rig.weights, weights)
    error = rig.error(model, weights=values)
    between = rig.error(model, weights=values, between=True)
    title = name or skinning.name or path.stem
    notes = ["glTF takes the unit for metres"]
    lost: list[str] = []
    if template is None:
        size = plain(model, rig, indices, stored, title, notes).save(path)
    else:
        if up != "y":
            raise InputError("up", '"y" beside a template, which has its own axes', repr(up))
        old = open_template(Path(template), skinning, meshes)
        old.clip_names.update(clip_names or {})
        _put(old, rig, indices, stored, title)
        lost, notes = old.lost, old.notes
        if lost and strict:
            raise InputError("template", "a file all of which can be kept", "; ".join(lost))
        size = old.builder.save(path)
    if stored.shape[1] > 4:
        notes.append("engines that read 4 influences alone will drop the smaller ones")
    return SaveReport(
        path=path,
        bytes=size,
        influences=stored.shape[1],
        error=error.rmse,
        max_error=error.largest,
        between_frames=between.rmse,
        note="; ".join(notes),
        lost=tuple(lost),
    )


def plain(
    model: Skinning,
    rig: Rig,
    indices: NDArray[np.int32],
    stored: NDArray[Any],
    title: str,
    notes: list[str],
) -> Builder:
    """A file of the model alone."""
    document = Builder()
    corners = split_corners(
        model.faces,
        model.n_vertices,
        None if model.surface is None else model.surface.uv,
        corner_normals(rig.rest, model.faces, model.surface) if len(model.faces) else None,
    )
    _mesh(document, model, rig, corners, indices, stored, title, notes)
    # The mesh stands at the top of the scene: glTF ignores the transform of a
    # skinned mesh's node, and importers disagree about its parents.
    document.json["nodes"] = [
        {"name": title, "mesh": 0, "skin": 0},
        {"name": f"{title}_skeleton", "children": _children(rig, 2)},
        *_bones(rig, 2),
    ]
    document.json["scenes"] = [{"name": title, "nodes": [0, 1]}]
    document.json["skins"] = [_skin(document, rig, title, 2)]
    document.json["animations"] = [
        _animation(document, rig, clip, _name(rig, clip, model, title), 2, 0.0)
        for clip in rig.clips
    ]
    return document


def _put(
    old: Template, rig: Rig, indices: NDArray[np.int32], stored: NDArray[Any], title: str
) -> None:
    """The model in the place of the template's meshes."""
    document, json = old.builder, old.json
    old.put_meshes(
        rig.rest, lambda index: _influences(document, indices[index], stored[index], rig.n_bones)
    )
    skins = json.setdefault("skins", [])
    first = len(json["nodes"]) + 1
    top = {"name": f"{title}_skeleton", "children": _children(rig, first)}
    old.put_nodes(len(skins), [top, *_bones(rig, first)])
    skins.append(_skin(document, rig, title, first))
    found: set[int] = set()
    added = []
    for clip in rig.clips:
        place = old.start_of(clip.name)
        start = 0.0 if place is None else place[1]
        made = _animation(document, rig, clip, clip.name or title, first, start)
        if place is None:
            added.append(made)
            continue
        found.add(place[0])
        theirs = json["animations"][place[0]]
        if old.clip_names:
            theirs["name"] = clip.name
        offset = len(theirs["samplers"])
        theirs["samplers"] += made["samplers"]
        theirs["channels"] += [{**c, "sampler": c["sampler"] + offset} for c in made["channels"]]
        extras = theirs.get("extras", {})
        if isinstance(extras, dict):
            theirs["extras"] = {**extras, **made["extras"]}
    if added:
        json.setdefault("animations", []).extend(added)
    old.finish(found)


def _name(rig: Rig, clip: Clip, model: Skinning, title: str) -> str:
    unnamed = ("", model.name) if len(rig.clips) == 1 else ()
    return title if clip.name in unnamed else clip.name


def _influences(
    document: Builder, indices: NDArray[np.int32], stored: NDArray[Any], n_bones: int
) -> dict[str, int]:
    """Attributes of the skin weights, four of them in each."""
    narrow = np.uint8 if n_bones <= 256 else np.uint16
    attributes = {}
    for k in range(0, stored.shape[1], 4):
        four_joints = np.zeros((len(indices), 4), dtype=narrow)
        four_weights = np.zeros((len(indices), 4), dtype=stored.dtype)
        width = min(4, stored.shape[1] - k)
        four_joints[:, :width] = indices[:, k : k + width]
        four_weights[:, :width] = stored[:, k : k + width]
        attributes[f"JOINTS_{k // 4}"] = document.accessor(four_joints, "VEC4", target=ARRAY)
        attributes[f"WEIGHTS_{k // 4}"] = document.accessor(
            four_weights, "VEC4", target=ARRAY, normalized=stored.dtype.kind == "u"
        )
    return attributes


def _mesh(
    document: Builder,
    model: Skinning,
    rig: Rig,
    corners: Corners,
    indices: NDArray[np.int32],
    stored: NDArray[Any],
    title: str,
    notes: list[str],
) -> None:
    def put(array: NDArray[Any], kind: str, **fields: Any) -> int:
        return document.accessor(array, kind, target=ARRAY, **fields)

    vertex = corners.vertex
    attributes = {"POSITION": put(rig.rest[vertex], "VEC3", bounds=True)}
    if corners.normals is not None:
        attributes["NORMAL"] = put(corners.normals, "VEC3")
    if corners.uv is not None:
        flipped = np.stack([corners.uv[:, 0], 1 - corners.uv[:, 1]], axis=1)
        attributes["TEXCOORD_0"] = put(flipped.astype(np.float32), "VEC2")
    attributes |= _influences(document, indices[vertex], stored[vertex], rig.n_bones)
    # Which of the model's vertices this is, so that seams can be closed on reading;
    # float32 as attributes may not be uint32, exact up to 2^24.
    if model.n_vertices <= 1 << 24:
        attributes["_VERTEX"] = put(vertex.astype(np.float32), "SCALAR")
    document.json["meshes"] = [
        {"name": title, "primitives": _primitives(document, model, corners, attributes, notes)}
    ]


def _primitives(
    document: Builder,
    model: Skinning,
    corners: Corners,
    attributes: dict[str, int],
    notes: list[str],
) -> list[dict[str, Any]]:
    if not len(corners.faces):
        return [{"attributes": attributes, "mode": 0}]
    surface = model.surface
    # glTF's own default is bare metal, which is black wherever there is nothing to reflect
    materials = (surface.materials if surface is not None else ()) or (Material(),)
    document.json["materials"] = [_material(document, m, notes) for m in materials]
    index = np.zeros(len(corners.faces), dtype=np.int32)
    if surface is not None and surface.material_index is not None:
        index = surface.material_index
    wide = np.uint16 if len(corners.vertex) < 65535 else np.uint32
    result = []
    for k in np.unique(index):
        part = corners.faces[index == k].reshape(-1).astype(wide)
        primitive: dict[str, Any] = {
            "attributes": attributes,
            "indices": document.accessor(part, "SCALAR", target=ELEMENTS),
            "mode": 4,
            "material": int(k),
        }
        result.append(primitive)
    return result


def _material(document: Builder, material: Material, notes: list[str]) -> dict[str, Any]:
    look: dict[str, Any] = {
        "baseColorFactor": [float(c) for c in material.base_color],
        "metallicFactor": float(material.metallic),
        "roughnessFactor": float(material.roughness),
    }
    if material.texture is not None:
        if material.texture_type in ("image/png", "image/jpeg"):
            images = document.json.setdefault("images", [])
            images.append(
                {
                    "bufferView": document.view(material.texture),
                    "mimeType": material.texture_type,
                    "name": material.name,
                }
            )
            textures = document.json.setdefault("textures", [])
            textures.append({"source": len(images) - 1})
            look["baseColorTexture"] = {"index": len(textures) - 1}
        else:
            notes.append(
                f"the texture of {material.name} is left out: glTF holds PNG and JPEG, "
                f"not {material.texture_type}"
            )
    item: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": look}
    if material.double_sided:
        item["doubleSided"] = True
    if material.base_color[3] < 1:
        item["alphaMode"] = "BLEND"
    return item


def _children(rig: Rig, first: int, bone: int = -1) -> list[int]:
    """Nodes of the joints that hang on a bone, on the skeleton's own node where it is -1."""
    if rig.parents is None:
        return list(range(first, first + rig.n_bones)) if bone < 0 else []
    return [first + int(k) for k in np.flatnonzero(rig.parents == bone)]


def _bones(rig: Rig, first: int) -> list[dict[str, Any]]:
    """Nodes of the joints, which will be numbered from `first` on."""
    nodes: list[dict[str, Any]] = []
    for bone, name in enumerate(rig.names):
        nodes.append({"name": name, "translation": [float(x) for x in rig.offsets[bone]]})
        if rig.axes is not None and rig.parents is not None:
            above = rig.axes[rig.parents[bone]] if rig.parents[bone] >= 0 else np.eye(3)
            turned = quaternion_from_matrix(above.T @ rig.axes[bone])
            nodes[-1]["rotation"] = [float(x) for x in turned]
        children = _children(rig, first, bone)
        if children:
            nodes[-1]["children"] = children
    return nodes


def _skin(document: Builder, rig: Rig, title: str, first: int) -> dict[str, Any]:
    """The skin of joints from node `first` on, which follow the node of the skeleton."""
    count = rig.n_bones
    inverse = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1))
    inverse[:, 3, :3] = -rig.centers  # column-major: the translation is the last row here
    if rig.axes is not None:
        inverse[:, :3, :3] = rig.axes
        inverse[:, 3, :3] = -np.einsum("bji,bj->bi", rig.axes, rig.centers.astype(np.float64))
    return {
        "name": title,
        "inverseBindMatrices": document.accessor(inverse.reshape(count, 16), "MAT4"),
        "skeleton": first - 1,
        "joints": list(range(first, first + count)),
    }


def _animation(
    document: Builder, rig: Rig, clip: Clip, title: str, first: int, start: float
) -> dict[str, Any]:
    """The keys of a clip for joints from node `first` on, its first frame at `start` seconds."""
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    stamps: dict[bytes, int] = {}
    for bone in range(rig.n_bones):
        keys = clip.start + np.flatnonzero(rig.keys[clip.frames, bone])
        if keys.tobytes() not in stamps:
            times = (start + seconds(keys - clip.start, clip.fps)).astype(np.float32)
            stamps[keys.tobytes()] = document.accessor(times, "SCALAR", bounds=True)
        tracks = [("rotation", rig.rotations[keys, bone], "VEC4")]
        if rig.translating[bone]:
            tracks.insert(0, ("translation", rig.translations[keys, bone], "VEC3"))
        if rig.scales is not None:
            tracks.append(("scale", np.repeat(rig.scales[keys, bone][:, None], 3, axis=1), "VEC3"))
        for track, values, kind in tracks:
            channels.append(
                {"sampler": len(samplers), "target": {"node": first + bone, "path": track}}
            )
            samplers.append(
                {
                    "input": stamps[keys.tobytes()],
                    "output": document.accessor(values, kind),
                    "interpolation": "LINEAR",
                }
            )
    stated: dict[str, Any] = {"fps": clip.fps, "frames": clip.n_frames}
    if start:
        stated["start"] = start
    return {
        "name": title,
        "samplers": samplers,
        "channels": channels,
        "extras": {"ssdr": stated},
    }
