"""Do other programs see the same skeleton?  three.js, usd-core and Blender are asked; a table.

    python benchmarks/interchange/trees.py FOX.glb LLAMA.gltf --out out/trees

A made rig and those of the files are written as glTF, USD and (where Blender is found) FBX and
opened in three.js in Chromium, with its SkeletonHelper, in usd-core, and by Blender's importers.
Compared are parents and names, joints in the rest pose, transforms relative to the parents, and
vertices.  Needs Chromium and npm on PATH; three.js is installed into the output folder.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

import ssdr
from benchmarks.common import write_csv
from benchmarks.interchange.browser import install, played
from helpers.rig_model import baked_by_usd
from helpers.rig_tree import creature, tree_of
from ssdr.errors import MissingDependencyError
from ssdr.hierarchy.transforms import to_local
from ssdr.io.axes import turn_up
from ssdr.io.blender import bridge, command
from ssdr.io.rig import unique_names
from ssdr.io.usd.skeleton import identifier

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
const helper = new THREE.SkeletonHelper(gltf.scene);
helper.material.linewidth = 2; scene.add(helper);
const called = o => o.userData.name || o.name;
const out = { index: [], clips: {}, bones: [], drawn: helper.geometry.attributes.position.count };
for (const bone of helper.bones)
  out.bones.push([called(bone), bone.parent.isBone ? called(bone.parent) : null]);
const skeleton = meshes[0].skeleton;
const joints = new Map(skeleton.bones.map((b, k) => [b, skeleton.boneInverses[k]]));
out.binds = helper.bones.map(b => joints.get(b).clone().invert().toArray());
for (const mesh of meshes)
  out.index.push(...Array.from(mesh.geometry.getAttribute('_vertex').array));
const v = new THREE.Vector3();
for (const clip of gltf.animations) {
  const { fps, frames } = wanted[clip.name];
  const mixer = new THREE.AnimationMixer(gltf.scene);
  const action = mixer.clipAction(clip);
  action.setLoop(THREE.LoopOnce); action.clampWhenFinished = true; action.play();
  const seen = { locals: [], points: [] };
  for (const t of frames) {
    mixer.setTime(Math.min(t / fps, clip.duration)); gltf.scene.updateMatrixWorld(true);
    seen.locals.push(helper.bones.map(b => b.matrix.toArray()));
    const points = [];
    for (const mesh of meshes) for (let i = 0; i < mesh.geometry.attributes.position.count; i++) {
      mesh.getVertexPosition(i, v); v.applyMatrix4(mesh.matrixWorld); points.push(v.x, v.y, v.z);
    }
    seen.points.push(points);
    if (!out.picture && t > 0) {
      const box = new THREE.Box3(); box.setFromArray(points);
      const c = box.getCenter(new THREE.Vector3()), s = box.getSize(new THREE.Vector3()).length();
      const camera = new THREE.PerspectiveCamera(35, 1, s / 100, s * 10);
      camera.position.set(c.x + s * 1.0, c.y + s * 0.3, c.z + s * 1.0); camera.lookAt(c);
      try {
        const r = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
        r.setSize(600, 600);
        for (const m of meshes) {
          m.frustumCulled = false; m.material.transparent = true; m.material.opacity = 0.45;
        }
        r.render(scene, camera); out.picture = r.domElement.toDataURL('image/png');
      } catch (e) { out.picture = null; }
    }
  }
  out.clips[clip.name] = seen;
  action.stop(); mixer.uncacheClip(clip);
}
await fetch('/result', { method: 'POST', body: JSON.stringify(out) });
</script>"""

_FRAMES = 12  # of a clip, the first and the last among them


def sampled(model: ssdr.Skinning) -> dict[str, np.ndarray]:
    """Frames of each clip at which programs are compared, from the clip's first on."""
    return {
        clip.name: np.unique(np.linspace(0, clip.n_frames - 1, _FRAMES).astype(int))
        for clip in model.clips
    }


class Truth:
    """A model and how far what a program shows is from it, lengths over the diagonal."""

    def __init__(self, model: ssdr.Skinning) -> None:
        self.model = model
        self.tree = tree_of(model)
        self.local = model.local_transforms()
        some = model.skin(range(0, model.n_frames, max(1, model.n_frames // 40)))
        self.diagonal = max(float(np.linalg.norm(np.ptp(p, axis=0))) for p in some)

    def in_usd_by_blender(self, found: list[str]) -> dict[str, str]:
        """Our names by Blender's, which are identifiers, of joints that have weights.

        Its importer leaves out what `jointNames` says, and groups of vertices that are empty.
        """
        names = self.model.names()
        plain = dict(zip(unique_names([identifier(n) for n in names]), names, strict=True))
        known = {name: plain[name] for name in found}
        weighted = self.model.dense_weights().any(axis=0)
        assert {n for n, used in zip(names, weighted, strict=True) if used} <= set(known.values())
        return known

    def contracted(self, kept: set[str]) -> dict[str, str | None]:
        """The tree of some joints: each hangs on the nearest of them above it."""
        result = {}
        for name in kept:
            above = self.tree[name]
            while above is not None and above not in kept:
                above = self.tree[above]
            result[name] = above
        return result

    def row(
        self,
        tree: dict[str, str | None],
        joints: np.ndarray,
        local: dict[str, np.ndarray],
        points: dict[str, np.ndarray],
        *,
        index: Any = slice(None),
        weightless: bool = False,
    ) -> dict[str, Any]:
        """Joints (B, 3) and transforms (f, B, 3, 4) are in the order of `tree`.

        `weightless`: joints without weights need not be there; transforms are compared where a
        joint's parent is the model's.
        """
        names = list(tree)
        chosen = sampled(self.model)
        starts = {clip.name: clip.start for clip in self.model.clips}
        order = [self.model.names().index(n) for n in names if n in self.tree]
        expected = self.contracted(set(names)) if weightless else self.tree
        row: dict[str, Any] = {"same_names_and_parents": tree == expected}
        if not row["same_names_and_parents"]:
            return row
        row["joints"] = float(np.abs(joints - self.model.joint_positions[order]).max())
        row["joints"] /= self.diagonal
        turned = moved = off = 0.0
        for clip, found in local.items():
            gone = np.abs(found - self.local[starts[clip] + chosen[clip]][:, order])
            gone = gone[:, [tree[n] == self.tree[n] for n in names]]
            turned = max(turned, float(gone[..., :3].max()))
            moved = max(moved, float(gone[..., 3].max()) / self.diagonal)
        for clip, found in points.items():
            truth = self.model.skin(starts[clip] + chosen[clip], dtype=np.float64)[:, index]
            off = max(off, float(np.linalg.norm(found - truth, axis=-1).max()) / self.diagonal)
        return {**row, "local_rotations": turned, "local_translations": moved, "vertices": off}


def in_three(truth: Truth, path: Path, folder: Path, chromium: str) -> dict[str, Any]:
    (folder / "model.glb").write_bytes(path.read_bytes())
    clips = {
        c.name: {"fps": c.fps, "frames": sampled(truth.model)[c.name].tolist()}
        for c in truth.model.clips
    }
    (folder / "index.html").write_text(PAGE.replace("CLIPS", json.dumps(clips)))
    answer = played(folder, chromium)
    if answer.get("picture"):
        picture = base64.b64decode(answer["picture"].split(",")[1])
        (folder / f"{path.stem}_three.png").write_bytes(picture)
    assert answer["drawn"] == 2 * sum(above is not None for _, above in answer["bones"])
    n_bones = len(answer["bones"])

    def matrices(values: Any) -> np.ndarray:
        return np.swapaxes(np.array(values).reshape(-1, n_bones, 4, 4), -1, -2)[..., :3, :]

    return truth.row(
        dict(answer["bones"]),
        matrices([answer["binds"]])[0, :, :, 3],
        {clip: matrices(seen["locals"]) for clip, seen in answer["clips"].items()},
        {
            clip: np.array(seen["points"]).reshape(len(seen["points"]), -1, 3)
            for clip, seen in answer["clips"].items()
        },
        index=np.array(answer["index"], dtype=int),
    )


def in_usd(truth: Truth, path: Path) -> dict[str, Any]:
    """The clip that is bound, by UsdSkel's own queries and its baking."""
    from pxr import Usd, UsdSkel

    stage = Usd.Stage.Open(str(path))
    skeleton = next(UsdSkel.Skeleton(p) for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton))
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetDefaultPrim()), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skeleton)
    joints = [str(joint) for joint in query.GetJointOrder()]
    said = [str(name) for name in skeleton.GetJointNamesAttr().Get() or ()]
    names = said or [joint.rsplit("/", 1)[-1] for joint in joints]
    parents = query.GetTopology().GetParentIndices()
    tree = {n: names[p] if p >= 0 else None for n, p in zip(names, parents, strict=True)}
    binds = np.array(query.GetJointWorldBindTransforms())[:, 3, :3]
    first = truth.model.clips[0].name
    frames = sampled(truth.model)[first].tolist()
    local = [np.array(query.ComputeJointLocalTransforms(float(t))) for t in frames]
    return truth.row(
        tree,
        binds,
        {first: np.swapaxes(np.array(local), -1, -2)[..., :3, :]},
        {first: baked_by_usd(path, [float(t) for t in frames])},
    )


def in_blender(truth: Truth, path: Path) -> dict[str, Any]:
    """Blender's bones, evaluated by Blender; vertices too where the file says which is which."""
    local, points = {}, {}
    index: Any = slice(None)
    chosen = sampled(truth.model)
    clips = truth.model.clips[:1] if path.suffix == ".usdc" else truth.model.clips
    turn = turn_up(np.eye(3), "z", "y").T
    for clip in clips:
        # in a scene of the clip's frame rate
        job = {"path": str(path.resolve()), "fps": clip.fps, "resample": False}
        job["max_bytes"] = 16 << 30
        arrays = bridge.run({**job, "action": "read skinning"})
        names = json.loads(str(arrays["bones"]))
        if path.suffix == ".usdc":
            known = truth.in_usd_by_blender(names)
            names = [known[name] for name in names]
        parents, joints = arrays["parents"], turn_up(arrays["joint_positions"], "z", "y")
        m = arrays["transforms"]
        m = np.concatenate([turn @ m[..., :3] @ turn.T, (turn @ m[..., 3:])], axis=-1)
        frames = np.split(to_local(m, parents, joints), np.cumsum(arrays["frames"])[:-1])
        takes = json.loads(str(arrays["names"])) or [clip.name]
        local[clip.name] = frames[takes.index(clip.name)][chosen[clip.name]]
        shown = bridge.run({**job, "action": "read", "take": clip.name if len(takes) > 1 else None})
        seen = turn_up(shown["vertices"], "z", "y")[chosen[clip.name]]
        index = shown.get("vertex", index)
        if "vertex" in shown or seen.shape[1] == truth.model.n_vertices:
            points[clip.name] = seen
    tree = {n: names[p] if p >= 0 else None for n, p in zip(names, parents, strict=True)}
    return truth.row(tree, joints, local, points, index=index, weightless=path.suffix == ".usdc")


def measure(name: str, model: ssdr.Skinning, folder: Path, chromium: str) -> list[dict[str, Any]]:
    truth = Truth(model)
    rows = []
    for suffix in (".glb", ".usdc", ".fbx"):
        path = folder / f"{name}{suffix}"
        if suffix == ".fbx":  # whose takes have one rate
            rate = model.clips[0].fps
            model = model.select(*(c.name for c in model.clips if c.fps == rate))
            truth = Truth(model)
        try:
            ssdr.save(model, path)
        except (MissingDependencyError, ssdr.InputError) as error:
            sys.stderr.write(f"{path.name}: {error}\n")
            continue
        found = {}
        if suffix == ".glb":
            found["three.js"] = in_three(truth, path, folder, chromium)
        elif suffix == ".usdc":
            found["usd-core"] = in_usd(truth, path)
        try:
            found["Blender"] = in_blender(truth, path)
        except MissingDependencyError as error:
            sys.stderr.write(f"{path.name}: {error}\n")
        back = ssdr.load_skinning(path) if suffix != ".fbx" or "Blender" in found else None
        if back is not None:
            chosen = sampled(model)
            here = {c.name: c.start + chosen[c.name] for c in back.clips}
            found["ssdr"] = truth.row(
                tree_of(back),
                back.joint_positions,
                {c: back.local_transforms()[t] for c, t in here.items()},
                {c: back.skin(t, dtype=np.float64) for c, t in here.items()},
            )
        rows += [{"model": name, "format": suffix[1:], "program": p, **r} for p, r in found.items()]
    return rows


def picture(model: ssdr.Skinning, name: str, folder: Path) -> None:
    """A frame of one clip and its bones as Blender has them from glTF, USD and FBX."""
    one = model.select(model.clips[0].name)
    files = [folder / f"{name}_one{suffix}" for suffix in (".glb", ".usdc", ".fbx")]
    for file in files:
        ssdr.save(one, file)
    out, frame = (folder / f"{name}_blender.png").resolve(), str(one.n_frames // 3)
    out.unlink(missing_ok=True)
    script = Path(__file__).with_name("blender_picture.py")
    words = [*command(script, str(out), frame, *map(str, files)), "--bones", "--turn", "60"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    if not out.is_file():  # some releases of bpy crash when they are torn down, the work being done
        raise SystemExit(done.stderr[-2000:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sources", type=Path, nargs="*", help="glTF files with skeletons")
    parser.add_argument("--out", type=Path, default=Path("out/trees"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    chromium = install(args.out)
    models = {"rigid": creature(frames=24), "loose": creature(frames=24, loose=True)}
    models |= {path.stem.lower(): ssdr.load_skinning(path) for path in args.sources}
    rows = []
    for name, model in models.items():
        rows += measure(name, model, args.out, chromium)
        with contextlib.suppress(MissingDependencyError):
            picture(model, name, args.out)
    columns = [*rows[0], *({k: None for r in rows for k in r if k not in rows[0]})]
    write_csv(args.out / "trees.csv", [{c: row.get(c, "") for c in columns} for row in rows])
    for row in rows:
        values = {k: v for k, v in row.items() if isinstance(v, float)}
        sys.stdout.write(
            f"{row['model']:<8} {row['format']:<5} {row['program']:<9} "
            f"{'same tree' if row['same_names_and_parents'] else 'ANOTHER TREE'}: "
            + ", ".join(f"{k.replace('_', ' ')} {v:.1e}" for k, v in values.items())
            + "\n"
        )


if __name__ == "__main__":
    main()
