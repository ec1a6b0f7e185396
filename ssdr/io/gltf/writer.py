"""Writing glTF 2.0: a skinned mesh with an animation that any engine plays."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip
from ...errors import InputError
from ...sequence import Material
from ...skinning import Skinning
from ..atomic import write_bytes
from ..corners import Corners, corner_normals, split_corners
from ..registry import SaveReport, seconds
from ..rig import Rig, Up, WeightStorage, build_rig, check_up, quantise, turn_skinning_up

__all__ = ["write_skinning"]

_COMPONENT = {"float32": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121}
_ARRAY, _ELEMENTS = 34962, 34963


def write_skinning(
    skinning: Skinning,
    path: Path,
    *,
    influences: int | None = None,
    weights: WeightStorage = "float32",
    up: Up = "y",
    name: str | None = None,
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
    joints, stored, values = quantise(rig.joints, rig.weights, weights)
    error = rig.error(model, weights=values)
    between = rig.error(model, weights=values, between=True)
    title = name or skinning.name or path.stem
    notes = ["glTF takes the unit for metres"]
    document = _Writer()
    corners = split_corners(
        model.faces,
        model.n_vertices,
        None if model.surface is None else model.surface.uv,
        corner_normals(rig.rest, model.faces, model.surface) if len(model.faces) else None,
    )
    _mesh(document, model, rig, corners, joints, stored, title, notes)
    _skeleton(document, rig, title)
    unnamed = ("", skinning.name) if len(rig.clips) == 1 else ()
    document.json["animations"] = [
        _animation(document, rig, clip, title if clip.name in unnamed else clip.name)
        for clip in rig.clips
    ]
    size = document.save(path)
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
    )


class _Writer:
    """A glTF document whose buffer grows with each accessor."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "ssdr"},
            "scene": 0,
            "accessors": [],
            "bufferViews": [],
        }
        self.blocks: list[bytes] = []
        self.length = 0

    def view(self, data: bytes, **fields: Any) -> int:
        padding = -len(data) % 4
        views: list[Any] = self.json["bufferViews"]
        views.append(
            {"buffer": 0, "byteOffset": self.length, "byteLength": len(data)}
            | {k: v for k, v in fields.items() if v is not None}
        )
        self.blocks.append(data + b"\0" * padding)
        self.length += len(data) + padding
        return len(views) - 1

    def accessor(
        self,
        array: NDArray[Any],
        kind: str,
        *,
        target: int | None = None,
        normalized: bool = False,
        bounds: bool = False,
    ) -> int:
        item: dict[str, Any] = {
            "bufferView": self.view(np.ascontiguousarray(array).tobytes(), target=target),
            "componentType": _COMPONENT[array.dtype.name],
            "count": len(array),
            "type": kind,
        }
        if normalized:
            item["normalized"] = True
        if bounds:
            # float() of a float32 keeps its value in JSON; validators compare exactly.
            flat = array.reshape(len(array), -1)
            item["min"] = [float(x) for x in flat.min(axis=0)]
            item["max"] = [float(x) for x in flat.max(axis=0)]
        accessors: list[Any] = self.json["accessors"]
        accessors.append(item)
        return len(accessors) - 1

    def save(self, path: Path) -> int:
        binary = b"".join(self.blocks)
        buffer: dict[str, Any] = {"byteLength": len(binary)}
        self.json["buffers"] = [buffer]
        if path.suffix.lower() == ".gltf":
            sidecar = path.with_suffix(".bin")
            buffer["uri"] = quote(sidecar.name)
            text = json.dumps(self.json, indent=1, allow_nan=False).encode()
            return write_bytes(sidecar, binary) + write_bytes(path, text)
        text = json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + len(binary)
        if total > 0xFFFFFFFF:
            raise InputError("path", "a .gltf for more than 4 GiB", str(path))
        head = struct.pack("<4sII", b"glTF", 2, total)
        first = struct.pack("<I4s", len(text), b"JSON") + text
        second = struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return write_bytes(path, head + first + second)


def _mesh(
    document: _Writer,
    model: Skinning,
    rig: Rig,
    corners: Corners,
    joints: NDArray[np.int32],
    stored: NDArray[Any],
    title: str,
    notes: list[str],
) -> None:
    def put(array: NDArray[Any], kind: str, **fields: Any) -> int:
        return document.accessor(array, kind, target=_ARRAY, **fields)

    vertex = corners.vertex
    attributes = {"POSITION": put(rig.rest[vertex], "VEC3", bounds=True)}
    if corners.normals is not None:
        attributes["NORMAL"] = put(corners.normals, "VEC3")
    if corners.uv is not None:
        flipped = np.stack([corners.uv[:, 0], 1 - corners.uv[:, 1]], axis=1)
        attributes["TEXCOORD_0"] = put(flipped.astype(np.float32), "VEC2")
    narrow = np.uint8 if rig.n_bones <= 256 else np.uint16
    for k in range(0, stored.shape[1], 4):
        four_joints = np.zeros((len(vertex), 4), dtype=narrow)
        four_weights = np.zeros((len(vertex), 4), dtype=stored.dtype)
        width = min(4, stored.shape[1] - k)
        four_joints[:, :width] = joints[vertex, k : k + width]
        four_weights[:, :width] = stored[vertex, k : k + width]
        attributes[f"JOINTS_{k // 4}"] = put(four_joints, "VEC4")
        attributes[f"WEIGHTS_{k // 4}"] = put(
            four_weights, "VEC4", normalized=stored.dtype.kind == "u"
        )
    # Which of the model's vertices this is, so that seams can be closed on reading;
    # float32 as attributes may not be uint32, exact up to 2^24.
    if model.n_vertices <= 1 << 24:
        attributes["_VERTEX"] = put(vertex.astype(np.float32), "SCALAR")
    document.json["meshes"] = [
        {"name": title, "primitives": _primitives(document, model, corners, attributes, notes)}
    ]


def _primitives(
    document: _Writer,
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
            "indices": document.accessor(part, "SCALAR", target=_ELEMENTS),
            "mode": 4,
            "material": int(k),
        }
        result.append(primitive)
    return result


def _material(document: _Writer, material: Material, notes: list[str]) -> dict[str, Any]:
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


def _skeleton(document: _Writer, rig: Rig, title: str) -> None:
    count = rig.n_bones
    bones = [
        {"name": bone, "translation": [float(x) for x in center]}
        for bone, center in zip(rig.names, rig.centers, strict=True)
    ]
    # The mesh stands at the top of the scene: glTF ignores the transform of a
    # skinned mesh's node, and importers disagree about its parents.
    document.json["nodes"] = [
        {"name": title, "mesh": 0, "skin": 0},
        {"name": f"{title}_skeleton", "children": list(range(2, 2 + count))},
        *bones,
    ]
    document.json["scenes"] = [{"name": title, "nodes": [0, 1]}]
    inverse = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1))
    inverse[:, 3, :3] = -rig.centers  # column-major: the translation is the last row here
    document.json["skins"] = [
        {
            "name": title,
            "inverseBindMatrices": document.accessor(inverse.reshape(count, 16), "MAT4"),
            "skeleton": 1,
            "joints": list(range(2, 2 + count)),
        }
    ]


def _animation(document: _Writer, rig: Rig, clip: Clip, title: str) -> dict[str, Any]:
    """The keys of a clip, its first frame at 0 s."""
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    stamps: dict[bytes, int] = {}
    for bone in range(rig.n_bones):
        keys = clip.start + np.flatnonzero(rig.keys[clip.frames, bone])
        if keys.tobytes() not in stamps:
            times = seconds(keys - clip.start, clip.fps).astype(np.float32)
            stamps[keys.tobytes()] = document.accessor(times, "SCALAR", bounds=True)
        tracks = [
            ("translation", rig.translations[keys, bone], "VEC3"),
            ("rotation", rig.rotations[keys, bone], "VEC4"),
        ]
        if rig.scales is not None:
            tracks.append(("scale", np.repeat(rig.scales[keys, bone][:, None], 3, axis=1), "VEC3"))
        for track, values, kind in tracks:
            channels.append({"sampler": len(samplers), "target": {"node": 2 + bone, "path": track}})
            samplers.append(
                {
                    "input": stamps[keys.tobytes()],
                    "output": document.accessor(values, kind),
                    "interpolation": "LINEAR",
                }
            )
    return {
        "name": title,
        "samplers": samplers,
        "channels": channels,
        "extras": {"ssdr": {"fps": clip.fps, "frames": clip.n_frames}},
    }
