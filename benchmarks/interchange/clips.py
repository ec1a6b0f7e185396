"""Do other programs play each clip alone?  three.js, usd-core and Blender are asked; a table.

    python benchmarks/interchange/clips.py LLAMA.gltf --out out/clips

All clips of the file are decomposed together by the command, written as glTF, USD and (where
Blender is found) FBX, and played one by one: three.js in Chromium and usd-core at the times
k / fps, Blender's own FBX importer take by take.  A second model has clips of 24 and 60 frames a
second.  Needs Chromium and npm on PATH; three.js is installed into the output folder.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

import ssdr
from benchmarks.common import write_csv
from benchmarks.interchange.browser import install, played
from helpers.rig_model import tube
from ssdr import cli
from ssdr.errors import MissingDependencyError
from ssdr.io.axes import turn_up
from ssdr.io.blender import bridge

PAGE = """<!doctype html><body style="margin:0"><script type="importmap">
{"imports": {"three": "./node_modules/three/build/three.module.js",
 "three/addons/": "./node_modules/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
const wanted = CLIPS;
const gltf = await new GLTFLoader().loadAsync('model.glb');
const scene = new THREE.Scene(); scene.background = new THREE.Color(0xf2f3f6);
scene.add(gltf.scene, new THREE.HemisphereLight(0xffffff, 0x8899aa, 3));
const meshes = []; gltf.scene.traverse(o => { if (o.isSkinnedMesh) meshes.push(o); });
const out = { clips: {}, index: [], names: gltf.animations.map(a => a.name), pictures: {} };
for (const mesh of meshes)
  out.index.push(...Array.from(mesh.geometry.getAttribute('_vertex').array));
let renderer = null;
try {
  renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setSize(400, 400);
} catch (e) {}
const v = new THREE.Vector3();
let camera = null;
for (const clip of gltf.animations) {
  const { fps, frames } = wanted[clip.name];
  const mixer = new THREE.AnimationMixer(gltf.scene);
  const action = mixer.clipAction(clip);
  action.setLoop(THREE.LoopOnce); action.clampWhenFinished = true; action.play();
  const seen = { duration: clip.duration, frames: [] };
  for (let t = 0; t < frames; t++) {
    mixer.setTime(Math.min(t / fps, clip.duration)); gltf.scene.updateMatrixWorld(true);
    const points = [];
    for (const mesh of meshes) for (let i = 0; i < mesh.geometry.attributes.position.count; i++) {
      mesh.getVertexPosition(i, v); v.applyMatrix4(mesh.matrixWorld); points.push(v.x, v.y, v.z);
    }
    seen.frames.push(points);
    if (renderer && t === Math.floor(frames / 2)) {
      if (camera === null) {
        const box = new THREE.Box3(); box.setFromArray(points);
        const c = box.getCenter(new THREE.Vector3()), s = box.getSize(new THREE.Vector3()).length();
        camera = new THREE.PerspectiveCamera(35, 1, s / 100, s * 10);
        camera.position.set(c.x + s * 1.1, c.y + s * 0.3, c.z + s * 1.1); camera.lookAt(c);
      }
      for (const m of meshes) m.frustumCulled = false;
      renderer.render(scene, camera);
      out.pictures[clip.name] = renderer.domElement.toDataURL('image/png');
    }
  }
  out.clips[clip.name] = seen;
  action.stop(); mixer.uncacheClip(clip);
}
await fetch('/result', { method: 'POST', body: JSON.stringify(out) });
</script>"""


def gap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(((a.astype(np.float64) - b) ** 2).sum(axis=2)).max())


def in_three(model: ssdr.Skinning, path: Path, folder: Path, chromium: str) -> dict[str, Any]:
    """Largest distance of each clip, and how far its duration is off in seconds."""
    (folder / "model.glb").write_bytes(path.read_bytes())
    clips = {c.name: {"fps": c.fps, "frames": c.n_frames} for c in model.clips}
    (folder / "index.html").write_text(PAGE.replace("CLIPS", json.dumps(clips)))
    answer = played(folder, chromium)
    assert answer["names"] == [c.name for c in model.clips]
    index = np.array(answer["index"], dtype=int)
    found = {}
    for clip in model.clips:
        seen = answer["clips"][clip.name]
        vertices = np.array(seen["frames"]).reshape(clip.n_frames, -1, 3)
        off = abs(seen["duration"] - (clip.n_frames - 1) / clip.fps)
        found[clip.name] = gap(vertices, model.skin(clip.frames)[:, index]), off
    for name, picture in answer["pictures"].items():
        file = folder / f"{path.stem}_{name}.png"
        file.write_bytes(base64.b64decode(picture.split(",")[1]))
    return found


def in_usd(model: ssdr.Skinning, path: Path) -> dict[str, Any]:
    """The same by UsdSkel.BakeSkinning, each animation bound in turn."""
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

    found = {}
    for k, clip in enumerate(model.clips):
        stage = Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(path)))
        (skeleton,) = [p for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton)]
        animation = [p for p in stage.Traverse() if p.IsA(UsdSkel.Animation)][k]
        assert animation.GetCustomDataByKey("ssdr")["name"] == clip.name
        UsdSkel.BindingAPI(skeleton).GetAnimationSourceRel().SetTargets([animation.GetPath()])
        tempo = stage.GetTimeCodesPerSecond()
        codes = UsdSkel.Animation(animation).GetTranslationsAttr().GetTimeSamples()
        off = np.abs(np.array(codes) / tempo - np.arange(clip.n_frames) / clip.fps).max()
        span = Gf.Interval(codes[0], codes[-1])
        assert UsdSkel.BakeSkinning(stage.Traverse(), span)
        mesh = next(UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
        seen = np.stack([np.array(mesh.GetPointsAttr().Get(code)) for code in codes])
        found[clip.name] = gap(seen, model.skin(clip.frames)), float(off)
    return found


def in_blender(model: ssdr.Skinning, path: Path) -> dict[str, Any]:
    """Takes of an FBX file by Blender's importer; its vertices are matched over all frames."""
    from scipy.spatial import cKDTree

    listed = ssdr.list_clips(path)
    assert listed == model.clips
    seen = {c.name: np.asarray(ssdr.load(path, clip=c.name).vertices) for c in listed}
    pick = [(c, k) for c in model.clips for k in (0, c.n_frames // 2)]
    theirs = np.concatenate([seen[c.name][k] for c, k in pick], axis=1)
    ours = np.concatenate([model.skin([c.start + k])[0] for c, k in pick], axis=1)
    order = cKDTree(ours).query(theirs)[1]
    return {c.name: (gap(seen[c.name], model.skin(c.frames)[:, order]), 0.0) for c in model.clips}


def in_blender_gltf(model: ssdr.Skinning, path: Path) -> dict[str, Any]:
    """Animations of a glTF by Blender's importer, in a scene of the clip's frame rate."""
    found = {}
    for clip in model.clips:
        job = {"action": "read", "path": str(path.resolve()), "take": clip.name, "fps": clip.fps}
        arrays = bridge.run({**job, "resample": False, "max_bytes": 16 << 30})
        seen = turn_up(arrays["vertices"], "z", "y")
        assert len(seen) == clip.n_frames
        found[clip.name] = gap(seen, model.skin(clip.frames)[:, arrays["vertex"]]), 0.0
    return found


def measure(model: ssdr.Skinning, stem: str, folder: Path, chromium: str) -> list[dict[str, Any]]:
    diagonal = max(
        ssdr.MeshSequence(model.skin(c.frames), validate=False).diagonal() for c in model.clips
    )
    found = {}
    for suffix in (".glb", ".usdc", ".fbx"):
        path = folder / f"{stem}{suffix}"
        try:
            if suffix == ".fbx":
                bridge.interpreter()
            ssdr.save(model, path)
        except (MissingDependencyError, ssdr.InputError) as error:
            sys.stderr.write(f"{path.name}: {error}\n")
            continue
        if suffix == ".glb":
            found["three.js"] = in_three(model, path, folder, chromium)
            with contextlib.suppress(MissingDependencyError):
                found["Blender, glTF"] = in_blender_gltf(model, path)
        elif suffix == ".usdc":
            found["usd-core"] = in_usd(model, path)
        else:
            found["Blender, FBX"] = in_blender(model, path)
        back = ssdr.load_skinning(path) if suffix != ".fbx" else None
        if back is not None:
            assert back.clips == model.clips
            found[f"ssdr, {suffix}"] = {
                c.name: (gap(back.skin(c.frames), model.skin(c.frames)), 0.0) for c in back.clips
            }
    return [
        {
            "model": stem,
            "player": player,
            "clip": clip.name,
            "fps": clip.fps,
            "frames": clip.n_frames,
            "max_error_over_diagonal": clips[clip.name][0] / diagonal,
            "seconds_off": clips[clip.name][1],
        }
        for player, clips in found.items()
        for clip in model.clips
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path, help="a glTF of several clips")
    parser.add_argument("--out", type=Path, default=Path("out/clips"))
    parser.add_argument("--bones", default="16")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    chromium = install(args.out)
    stem = args.source.stem.lower()
    packed = args.out / f"{stem}.npz"
    line = ["decompose", str(args.source), "--clip", "all", "--weld", "-o", str(packed), "-f"]
    if cli.main([*line, "--bones", args.bones, "--effort", "fast"]):
        raise SystemExit(1)
    mixed = [ssdr.Clip("slow", 0, 9, 24.0), ssdr.Clip("quick", 9, 20, 60.0)]
    models = {
        stem: ssdr.load_skinning(packed),
        "mixed_rates": dataclasses.replace(tube(), clips=mixed),
    }
    rows = []
    for name, model in models.items():
        rows += measure(model, name, args.out, chromium)
    write_csv(args.out / "clips.csv", rows)
    for row in rows:
        sys.stdout.write(
            f"{row['model']:<12} {row['player']:<13} {row['clip']:<9} {row['frames']:>4} at "
            f"{row['fps']:g}: {row['max_error_over_diagonal']:.1e} of the diagonal, "
            f"{row['seconds_off']:.1e} s off\n"
        )


if __name__ == "__main__":
    main()
