"""Does a file that passes through look the same?  three.js draws it before and after; a table.

    python benchmarks/interchange/passthrough.py DATA/gltf/* --out out/passthrough

Each glTF, and one made by hand that has everything, goes through ``ssdr convert`` and ``ssdr
decompose --clip all``.  three.js in Chromium plays input and output clip by clip and draws both
in the middle of the clip, from one camera: the pictures are compared pixel by pixel, the vertices
as three.js skins and morphs them one by one, the files number by number.  A file of one frame is
not decomposed: it has no motion.  Needs Chromium and npm on PATH; three.js is installed into the
output folder.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import re
import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

import ssdr
from benchmarks.common import RESULTS
from benchmarks.interchange.browser import install, played
from helpers.gltf_asset import make_asset
from helpers.gltf_difference import NEW_SKIN, difference
from ssdr import cli
from ssdr.io.gltf.document import Document

PAGE = """<!doctype html><body style="margin:0"><script type="importmap">
{"imports": {"three": "./node_modules/three/build/three.module.js",
 "three/addons/": "./node_modules/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { RoomEnvironment } from 'three/addons/environments/RoomEnvironment.js';
const size = 480, files = FILES, frames = FRAMES;
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
renderer.setSize(size, size);
const room = new THREE.PMREMGenerator(renderer).fromScene(new RoomEnvironment()).texture;
const out = [], v = new THREE.Vector3(), cameras = {}, times = {};
for (const file of files) {
  const gltf = await new GLTFLoader().loadAsync(file);
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0xf2f3f6); scene.environment = room;
  scene.add(gltf.scene);
  const meshes = [];
  gltf.scene.traverse(o => { if (o.isMesh) { o.frustumCulled = false; meshes.push(o); } });
  const seen = { file, clips: {} }; out.push(seen);
  // A file without an animation is drawn as it stands.
  for (const clip of gltf.animations.length ? gltf.animations : [null]) {
    const mixer = new THREE.AnimationMixer(gltf.scene);
    let time = 0;
    if (clip) {
      const action = mixer.clipAction(clip);
      action.setLoop(THREE.LoopOnce); action.clampWhenFinished = true; action.play();
      // On a frame, and none between two; the output plays what the input played.
      const { n, fps } = frames[clip.name];
      time = times[clip.name] ??= clip.duration - (n - 1 - Math.floor(n / 2)) / fps;
      mixer.setTime(time);
    }
    gltf.scene.updateMatrixWorld(true);
    const points = [];
    for (const mesh of meshes) for (let i = 0; i < mesh.geometry.attributes.position.count; i++) {
      mesh.getVertexPosition(i, v); v.applyMatrix4(mesh.matrixWorld); points.push(v.x, v.y, v.z);
    }
    const name = clip ? clip.name : '';
    if (!(name in cameras)) {
      const box = new THREE.Box3(); box.setFromArray(points);
      const c = box.getCenter(new THREE.Vector3()), s = box.getSize(new THREE.Vector3()).length();
      const camera = new THREE.PerspectiveCamera(35, 1, s / 100, s * 10);
      camera.position.set(c.x + s * 0.9, c.y + s * 0.35, c.z + s * 1.2); camera.lookAt(c);
      cameras[name] = camera;
    }
    renderer.render(scene, cameras[name]);
    seen.clips[name] = { time, points, duration: clip ? clip.duration : 0,
      names: meshes.map(m => m.name), picture: renderer.domElement.toDataURL('image/png') };
    if (clip) { mixer.stopAllAction(); mixer.uncacheClip(clip); }
  }
}
await fetch('/result', { method: 'POST', body: JSON.stringify(out) });
</script>"""


# Of the differences that a new skin may make.
KINDS = {
    "joints and weights": r"/attributes/[+-]?(JOINTS|WEIGHTS)_\d",
    "rest pose": r"/attributes/[+-]?(POSITION|NORMAL|TANGENT)",
    "morph targets": r"targets$|targetNames$|[+-]?weights$",
    "new joints": r"_skeleton$",
    "skins": r"skins?$",
}


def skeleton(source: Path) -> set[str]:
    """Names of the file's joints and of the nodes that hold joints and nothing else."""
    tree = Document(source).json
    nodes = tree["nodes"]
    joints = {k for skin in tree.get("skins", []) for k in skin["joints"]}

    def below(k: int) -> list[int]:
        return [k, *(j for child in nodes[k].get("children", []) for j in below(child))]

    def bare(k: int) -> bool:
        return not {"mesh", "camera", "extensions", "extras"} & nodes[k].keys()

    found = [
        k for k in range(len(nodes)) if joints & {*below(k)} and all(bare(j) for j in below(k))
    ]
    return {str(nodes[k].get("name", k)) for k in {*joints, *found}} | {
        str(node.get("name", k)) for k, node in enumerate(nodes) if "mesh" in node
    }


def kind_of(place: str, old: set[str]) -> str:
    """What differs there; "other" is what a new skin has no right to change."""
    if NEW_SKIN.match(place):
        for kind, pattern in KINDS.items():
            if re.search(pattern, place):
                return kind
    if place.startswith("scenes/") and place.rpartition("/-")[2] in old:
        return "old joints"
    gone = re.match(r"animations/[^/]+/channels/-/(.+):\w+$", place)
    if gone and gone[1].rpartition("/")[2] in old:
        return "tracks of the old skin"
    if re.match(r"animations/[^/]+/channels/\+/(.*/)?[^/]*_skeleton/bone_\d+:\w+$", place):
        return "tracks of the new skin"
    if re.match(r"animations/[^/]+/(\+extras|extras/\+ssdr)$", place):
        return "frame rate in extras"
    return "other"


def pixels(picture: str) -> np.ndarray:
    data = base64.b64decode(picture.split(",")[1])
    return np.array(Image.open(io.BytesIO(data)).convert("RGB"))


def sheet(before: np.ndarray, after: np.ndarray, path: Path) -> None:
    """Before, after, and where they differ, from white: none to black: 32 of 255 or more."""
    off = np.abs(before.astype(int) - after).max(axis=2, keepdims=True)
    shown = 255 - np.minimum(255, off * 8).astype(np.uint8)
    Image.fromarray(np.concatenate([before, after, shown.repeat(3, axis=2)], axis=1)).save(path)


def compared(
    source: Path, target: Path, way: str, folder: Path, answer: Any
) -> list[dict[str, Any]]:
    """Rows of one output, one for each clip."""
    before, after = (seen["clips"] for seen in answer)
    assert list(before) == list(after), (list(before), list(after))
    rows = []
    for name, a in before.items():
        b = after[name]
        p, q = (np.array(seen["points"]).reshape(-1, 3) for seen in (a, b))
        first, second = pixels(a["picture"]), pixels(b["picture"])
        off = np.abs(first.astype(int) - second)
        file = folder / f"{source.stem}_{way}{'_' + name if name else ''}.png"
        sheet(first, second, file)
        ground = (first == first[0, 0]).all(axis=2)
        rows.append(
            {
                "file": source.name,
                "way": way,
                "clip": name,
                "time": a["time"],
                "seconds_off": abs(a["duration"] - b["duration"]),
                "meshes": a["names"],
                "same_meshes": a["names"] == b["names"],
                "max_error_over_diagonal": float(
                    np.linalg.norm(p - q, axis=1).max() / np.linalg.norm(np.ptp(p, axis=0))
                )
                if p.shape == q.shape
                else None,
                "drawn": float(1 - ground.mean()),
                "pixels_mean": float(off.mean()),
                "pixels_mean_where_drawn": float(off[~ground].mean()),
                "pixels_max": int(off.max()),
                "pixels_off_by_more_than_8": float((off.max(axis=2) > 8).mean()),
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sources", type=Path, nargs="*", help="glTF files")
    parser.add_argument("--out", type=Path, default=Path("out/passthrough"))
    parser.add_argument("--bones", default="24")
    parser.add_argument("--effort", default="balanced")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    chromium = install(args.out)
    pictures = args.out / "pictures"
    pictures.mkdir(exist_ok=True)
    made = args.out / "made"
    made.mkdir(exist_ok=True)
    rows: list[dict[str, Any]] = []
    differences: list[dict[str, Any]] = []
    for source in [*args.sources, make_asset(made / "everything.gltf")]:
        if source.suffix not in (".gltf", ".glb"):
            continue
        # The page asks for the input by its own name, and for what it refers to.
        copies = args.out / "before"
        shutil.rmtree(copies, ignore_errors=True)
        shutil.copytree(source.parent, copies)
        clips = {c.name: {"n": c.n_frames, "fps": c.fps} for c in ssdr.list_clips(source)}
        moving = any(clip["n"] > 1 for clip in clips.values())
        for way in ("convert", "decompose") if moving else ("convert",):
            target = args.out / "after" / f"{source.stem}_{way}.glb"
            target.parent.mkdir(exist_ok=True)
            line = [way, str(source), "-f", "-q"]
            line += ["-o", str(target)] if way == "decompose" else [str(target)]
            if way == "decompose":
                line += ["--clip", "all", "--bones", args.bones, "--effort", args.effort]
            if cli.main(line):
                raise SystemExit(1)
            files = [f"before/{source.name}", f"after/{target.name}"]
            page = PAGE.replace("FILES", json.dumps(files))
            page = page.replace("FRAMES", json.dumps(clips))
            (args.out / "index.html").write_text(page)
            places = difference(source, target)
            kinds = Counter(kind_of(place, skeleton(source)) for place in places)
            differences.append({"file": source.name, "way": way, "places": dict(kinds)})
            rows += compared(source, target, way, pictures, played(args.out, chromium))
    three = json.loads((args.out / "node_modules/three/package.json").read_text())["version"]
    result = {
        "command": f"python benchmarks/interchange/passthrough.py DATA/gltf/*.gl* --bones "
        f"{args.bones} --effort {args.effort}",
        "three": three,
        "differences": differences,
        "rows": rows,
    }
    text = json.dumps(result, indent=1) + "\n"
    (args.out / "passthrough.json").write_text(text)
    RESULTS.joinpath("passthrough.json").write_text(text)
    for row in rows:
        apart = row["max_error_over_diagonal"]
        sys.stdout.write(
            f"{row['file']:<24} {row['way']:<9} {row['clip']:<9} "
            f"vertices {'apart' if apart is None else f'{apart:.1e}'}, "
            f"pixels {row['pixels_mean']:.4f} of 255, at most {row['pixels_max']}\n"
        )
    for one in differences:
        sys.stdout.write(f"{one['file']:<24} {one['way']:<9} {one['places']}\n")


if __name__ == "__main__":
    main()
