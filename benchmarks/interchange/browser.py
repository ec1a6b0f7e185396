"""Does a browser see the same vertices in the .glb?  three.js plays it, headless; a table.

    python benchmarks/interchange/browser.py --out out/browser

Needs Chromium and npm on PATH; three.js is installed into the output folder.  The page loads the
file with three.js's own GLTFLoader, sets the animation to every frame, asks the skinned mesh for
its vertices, and draws one frame.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import json
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import ssdr
from ssdr import samples

PAGE = """<!doctype html><body style="margin:0"><script type="importmap">
{"imports": {"three": "./node_modules/three/build/three.module.js",
 "three/addons/": "./node_modules/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
const gltf = await new GLTFLoader().loadAsync('model.glb');
const scene = new THREE.Scene(); scene.background = new THREE.Color(0xf2f3f6);
scene.add(gltf.scene, new THREE.HemisphereLight(0xffffff, 0x8899aa, 3));
const mixer = new THREE.AnimationMixer(gltf.scene);
const clip = gltf.animations[0];
const action = mixer.clipAction(clip);
action.setLoop(THREE.LoopOnce); action.clampWhenFinished = true; action.play();
const meshes = []; gltf.scene.traverse(o => { if (o.isSkinnedMesh) meshes.push(o); });
const out = { frames: [], index: [] };
for (const mesh of meshes) {
  const extra = mesh.geometry.getAttribute('_vertex');
  out.index.push(...Array.from(extra.array));
}
const v = new THREE.Vector3();
for (let t = 0; t < FRAMES; t++) {
  mixer.setTime(Math.min(t / FPS, clip.duration)); gltf.scene.updateMatrixWorld(true);
  const points = [];
  for (const mesh of meshes) for (let i = 0; i < mesh.geometry.attributes.position.count; i++) {
    mesh.getVertexPosition(i, v); v.applyMatrix4(mesh.matrixWorld); points.push(v.x, v.y, v.z);
  }
  out.frames.push(points);
  if (t === SHOW) {
    const box = new THREE.Box3();
    box.setFromArray(points);
    const c = box.getCenter(new THREE.Vector3()), s = box.getSize(new THREE.Vector3()).length();
    const camera = new THREE.PerspectiveCamera(35, 1, s / 100, s * 10);
    camera.position.set(c.x + s * 0.4, c.y + s * 0.15, c.z + s * 1.4); camera.lookAt(c);
    try {
      const r = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
      r.setSize(600, 600); for (const m of meshes) m.frustumCulled = false;
      r.render(scene, camera); out.picture = r.domElement.toDataURL('image/png');
    } catch (e) { out.picture = null; }
  }
}
await fetch('/result', { method: 'POST', body: JSON.stringify(out) });
document.title = 'done';
</script>"""


class Handler(http.server.SimpleHTTPRequestHandler):
    done = threading.Event()
    answer: ClassVar[dict[str, Any]] = {}

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        Handler.answer = json.loads(body)
        self.send_response(204)
        self.end_headers()
        Handler.done.set()

    def log_message(self, *_: object) -> None:
        pass


def install(folder: Path) -> str:
    """three.js into the folder; the browser that there is."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None or shutil.which("npm") is None:
        raise SystemExit("needs chromium and npm on PATH")
    subprocess.run(["npm", "install", "--silent", "--prefix", folder, "three"], check=True)
    return chromium


def played(folder: Path, chromium: str) -> dict[str, Any]:
    """What the folder's page posts back."""
    Handler.done.clear()
    handler = functools.partial(Handler, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory() as profile:
        browser = subprocess.Popen(
            [
                chromium, "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run",
                "--disable-background-networking", "--disable-component-update", "--disable-sync",
                "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                f"--user-data-dir={profile}", f"http://127.0.0.1:{server.server_port}/index.html",
            ],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            if not Handler.done.wait(180):
                raise SystemExit("the page did not answer within 180 s")
        finally:
            browser.terminate()
            browser.wait()
            server.shutdown()
    return Handler.answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/browser"))
    parser.add_argument("--bones", type=int, default=24)
    parser.add_argument("--show", type=int, default=36, help="frame of the picture")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    chromium = install(args.out)

    sequence = samples.load("dancer")
    skinning = ssdr.decompose(sequence, bones=args.bones, effort="fast").skinning
    ssdr.save(skinning, args.out / "model.glb")
    page = PAGE.replace("FRAMES", str(skinning.n_frames)).replace("FPS", str(skinning.fps))
    (args.out / "index.html").write_text(page.replace("SHOW", str(args.show)))

    answer = played(args.out, chromium)
    seen = np.array(answer["frames"]).reshape(skinning.n_frames, -1, 3)
    index = np.array(answer["index"], dtype=int)
    truth = skinning.skin()[:, index]
    error = np.linalg.norm(seen - truth, axis=2).max(axis=1)
    row = {
        "file": "dancer.glb",
        "importer": "three.js in Chromium",
        "frames": len(seen),
        "vertices": len(index),
        "max_error": float(error.max()),
        "max_error_over_diagonal": float(error.max() / sequence.diagonal()),
        "worst_frame": int(error.argmax()),
    }
    (args.out / "browser.json").write_text(json.dumps(row, indent=1) + "\n")
    if answer.get("picture"):
        import base64

        (args.out / "browser.png").write_bytes(base64.b64decode(answer["picture"].split(",")[1]))
    print(json.dumps(row, indent=1))


if __name__ == "__main__":
    main()
