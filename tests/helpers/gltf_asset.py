"""A glTF file that has everything: what needs no numbers stands in gltf_asset.json."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from helpers.motions import grid as triangles

_CODES = {"float32": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121, "int16": 5122}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def png(color, size=8):
    """A picture of chequers as PNG."""
    x, y = np.indices((size, size)) // 2
    pixels = np.where(((x + y) % 2)[..., None] == 1, color, 255).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    return buffer.getvalue()


class Made:
    """Two buffers, a file beside and a data URI, that views fall into by turns."""

    def __init__(self):
        self.json = json.loads(Path(__file__).with_suffix(".json").read_text())
        self.json |= {"accessors": [], "bufferViews": []}
        self.blobs = [b"", b""]

    def view(self, data, **fields):
        views = self.json["bufferViews"]
        number = len(views) % 2
        self.blobs[number] += b"\0" * (-len(self.blobs[number]) % 4)
        views.append({"buffer": number, "byteOffset": len(self.blobs[number])} | fields)
        views[-1]["byteLength"] = len(data)
        views[-1]["name"] = f"view {len(views) - 1}"
        self.blobs[number] += data
        return len(views) - 1

    def put(self, values, *, view=None, offset=0, **fields):
        values = np.asarray(values)
        flat = values.reshape(len(values), -1)
        item = {
            "bufferView": self.view(values.tobytes()) if view is None else view,
            "byteOffset": offset,
            "componentType": _CODES[values.dtype.name],
            "count": len(values),
            "type": _KINDS[flat.shape[1]],
            "extras": {"accessor": len(self.json["accessors"])},
        } | fields
        if values.dtype.kind == "f":
            item |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        self.json["accessors"].append(item)
        return len(self.json["accessors"]) - 1

    def save(self, path):
        self.json["buffers"] = [
            {"byteLength": len(self.blobs[0]), "uri": f"{path.stem}-data.bin", "name": "beside"},
            {
                "byteLength": len(self.blobs[1]),
                "uri": "data:application/octet-stream;base64,"
                + base64.b64encode(self.blobs[1]).decode(),
            },
        ]
        path.with_name(f"{path.stem}-data.bin").write_bytes(self.blobs[0])
        path.write_text(json.dumps(self.json))
        return path


def grid(columns, rows, width, height, bend=0.0):
    """Vertices, normals, tangents, UVs and triangles of a bent sheet with a seam of UVs."""
    u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    u, v = u.ravel(), v.ravel()
    x = (u - 0.5) * width
    points = np.stack([x, v * height, bend * np.cos(3 * u)], axis=1)
    normals = np.stack([3 * bend / width * np.sin(3 * u), 0 * u, 1 + 0 * u], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = np.stack([normals[:, 2], 0 * u, -normals[:, 0], 1 + 0 * u], axis=1)
    uv = np.stack([u, 1 - v], axis=1)
    arrays = (a.astype(np.float32) for a in (points, normals, tangents, uv))
    return (*arrays, triangles(rows, columns))


def make_asset(path):
    """Write the file with what lies beside it; meshes Body and Coat are there to be replaced."""
    made = Made()
    document = made.json
    points, normals, tangents, uv, faces = grid(9, 13, 1.0, 2.0, 0.3)
    n = len(points)
    body = {
        "POSITION": made.put(points),
        "NORMAL": made.put(normals),
        "TANGENT": made.put(tangents),
        "TEXCOORD_0": made.put(uv),
        "TEXCOORD_1": made.put((uv[:, ::-1] * 65535).astype(np.uint16), normalized=True),
        "COLOR_0": made.put(
            (np.random.default_rng(1).random((n, 4)) * 255).astype(np.uint8), normalized=True
        ),
        "_TEMPERATURE": made.put(np.linspace(0, 1, n, dtype=np.float32)),
    }
    half = len(faces) // 2
    upper = made.put(faces[:half].astype(np.uint16).reshape(-1))
    lower = made.put(faces[half:].astype(np.uint16).reshape(-1))
    bulge = (points * [0, 0, 0] + normals * 0.2 * np.sin(3 * points[:, 1:2])).astype(np.float32)
    rows = np.arange(0, n, 2, dtype=np.uint16)
    sparse = {
        "count": len(rows),
        "indices": {"bufferView": made.view(rows.tobytes()), "componentType": 5123},
        "values": {"bufferView": made.view(bulge[rows].tobytes())},
    }
    document["accessors"].append(
        {"componentType": 5126, "count": n, "type": "VEC3", "sparse": sparse}
        | {"min": [-1.0] * 3, "max": [1.0] * 3}
    )
    thin = len(document["accessors"]) - 1
    targets = [{"POSITION": made.put(bulge)}, {"POSITION": thin}]
    # The coat's attributes stand in one view, vertex by vertex.
    p, q, _, st, coat_faces = grid(6, 6, 1.4, 1.0, 0.5)
    mixed = np.concatenate([p, q, st], axis=1)
    view = made.view(mixed.tobytes(), byteStride=32)
    coat = {
        "POSITION": made.put(p, view=view),
        "NORMAL": made.put(q, view=view, offset=12),
        "TEXCOORD_0": made.put(st, view=view, offset=24),
    }
    prop_points, _, _, _, prop_faces = grid(3, 3, 0.5, 0.5)
    prop = {"POSITION": made.put(prop_points)}
    prop_target = made.put(prop_points * np.float32(0.1))
    coat_indices = made.put(coat_faces.astype(np.uint8).reshape(-1))
    prop_indices = made.put(prop_faces.astype(np.uint16).reshape(-1))
    document["meshes"] = [
        {
            "name": "Body",
            "extras": {"targetNames": ["bulge", "thin"], "rig": "hero"},
            "weights": [0.0, 0.25],
            "primitives": [
                {"attributes": body, "indices": upper, "material": 0, "targets": targets}
                | {"extras": {"part": "upper"}},
                {"attributes": body, "indices": lower, "material": 1, "targets": targets},
            ],
        },
        {
            "name": "Coat",
            "extras": {"layer": 2},
            "primitives": [{"attributes": coat, "indices": coat_indices, "material": 2}],
        },
        {
            "name": "Prop",
            "primitives": [
                {"attributes": prop, "indices": prop_indices, "material": 1}
                | {"targets": [{"POSITION": prop_target}]}
            ],
        },
    ]
    _pictures(made, path)
    turn = Rotation.from_rotvec([0, 0.3, 0]).as_quat().tolist()
    document["nodes"][2]["rotation"] = turn
    frames = 13
    times = made.put((0.25 + np.arange(frames) / 24).astype(np.float32))
    phase = np.linspace(0, 2 * np.pi, frames)
    amounts = np.stack([0.5 + 0.5 * np.sin(phase), 0.5 - 0.5 * np.cos(phase)], axis=1)
    turns = Rotation.from_rotvec(np.outer(np.sin(phase) * 0.6, [0, 0, 1])).as_quat()
    moves = np.stack([0.3 * np.sin(phase), 0.5 + 0 * phase, 0.4 + 0 * phase], axis=1)
    spin = Rotation.from_rotvec(np.outer(phase, [0, 1, 0])).as_quat()

    def track(values):
        return made.put(np.asarray(values, dtype=np.float32))

    document["animations"] = [
        _clip(
            "Dance",
            times,
            (1, "weights", made.put(amounts.astype(np.float32).reshape(-1))),
            (2, "rotation", track(turns)),
            (2, "translation", track(moves)),
            (4, "translation", track(np.stack([moves[:, 0], 1 + 0 * phase, 6 + 0 * phase], 1))),
        ),
        _clip(
            "Spin",
            times,
            (3, "rotation", track(spin)),
            (3, "weights", made.put(amounts[:, 0].astype(np.float32))),
        ),
    ]
    document["animations"][0]["extras"] = {"author": "somebody"}
    return made.save(path)


def _clip(name, times, *tracks):
    return {
        "name": name,
        "samplers": [{"input": times, "output": k, "interpolation": "LINEAR"} for *_, k in tracks],
        "channels": [
            {"sampler": k, "target": {"node": node, "path": path}}
            for k, (node, path, _) in enumerate(tracks)
        ],
    }


def _pictures(made, path):
    pictures = [png(c) for c in ((200, 60, 40), (128, 128, 255), (0, 200, 90), (250, 220, 10))]
    (path.parent / "maps").mkdir(exist_ok=True)
    (path.parent / "maps" / "base color.png").write_bytes(pictures[0])
    inline = "data:image/png;base64," + base64.b64encode(pictures[1]).decode()
    made.json["images"] = [
        {"uri": "maps/base%20color.png", "name": "base"},
        {"uri": inline, "name": "bumps"},
        {"bufferView": made.view(pictures[2]), "mimeType": "image/png", "name": "metal"},
        {"bufferView": made.view(pictures[3]), "mimeType": "image/png", "extras": {"i": 3}},
    ]
