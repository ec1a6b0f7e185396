"""Does a file that passes through look the same?  three.js draws it before and after.

    python benchmarks/interchange/passthrough.py
    python benchmarks/interchange/passthrough.py --only "Fox.glb decompose" --set effort=fast

Each glTF of the data folder, and one made by hand that has everything, goes through `ssdr convert`
and `ssdr decompose --clip all`.  three.js in Chromium plays input and output clip by clip and
draws both in the middle of the clip, from one camera: the pictures are compared pixel by pixel, the
vertices as three.js skins and morphs them one by one, the files number by number.  A file of one
frame is not decomposed: it has no motion.  Needs Chromium (or what CHROMIUM names), node and npm.
Pictures (before, after, where they differ) go to out/three/pictures.
"""

from __future__ import annotations

import base64
import functools
import http.server
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import urllib.parse
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.interchange.programs import three_folder
from helpers.gltf_asset import make_asset
from helpers.gltf_difference import difference
from ssdr import cli

MADE = "everything.gltf"


def measure(file: str, way: str, bones: int = 24, effort: str = "balanced") -> common.Row:
    folder = three_folder()
    shutil.copy(Path(__file__).with_suffix(".html"), folder / "index.html")
    # the page loads the input under its own name, and the files that it refers to
    before, after = folder / "before", folder / "after.glb"
    shutil.rmtree(before, ignore_errors=True)
    if file == MADE:
        before.mkdir()
        make_asset(before / MADE)
    else:
        shutil.copytree(common.data_folder() / "gltf", before)
    source = before / file
    clips = {c.name: {"frames": c.n_frames, "fps": c.fps} for c in ssdr.list_clips(source)}
    line = ["convert", str(source), str(after), "-f", "-q"]
    if way == "decompose":
        line = ["decompose", str(source), "-o", str(after), "-f", "-q", "--clip", "all"]
        line += ["--bones", str(bones), "--effort", effort]
    if cli.main(line):
        raise SystemExit(1)
    first, second = played(folder, {"files": [f"before/{file}", "after.glb"], "clips": clips})
    looks = [compared(first[c], second[c], f"{source.stem}_{way}_{c}") for c in first]
    return {
        "clips": list(first),
        **{key: max(look[key] for look in looks) for key in looks[0]},  # the worst clip counts
        "places": len(difference(source, after)),
    }


def compared(before: Any, after: Any, name: str) -> common.Row:
    p, q = (np.array(seen["points"]).reshape(-1, 3) for seen in (before, after))
    first, second = (pixels(seen["picture"]).astype(int) for seen in (before, after))
    off = np.abs(first - second)
    shown = 255 - np.minimum(255, off.max(axis=2, keepdims=True) * 8).repeat(3, axis=2)
    pictures = three_folder() / "pictures"
    pictures.mkdir(exist_ok=True)
    sheet = np.concatenate([first, second, shown], axis=1).astype(np.uint8)
    Image.fromarray(sheet).save(pictures / f"{name}.png")
    diagonal = np.linalg.norm(np.ptp(p, axis=0))
    return {
        "vertices": float(np.linalg.norm(p - q, axis=1).max() / diagonal),
        "pixels, mean": float(off.mean()),
        "pixels, most": int(off.max()),
        "pixels off by more than 8": float((off.max(axis=2) > 8).mean()),
    }


def pixels(picture: str) -> np.ndarray:
    data = base64.b64decode(picture.split(",")[1])
    return np.array(Image.open(io.BytesIO(data)).convert("RGB"))


class Handler(http.server.SimpleHTTPRequestHandler):
    """Server of a folder that keeps what the page posts."""

    answer: Any = None
    done = threading.Event()

    def do_POST(self) -> None:
        Handler.answer = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()
        Handler.done.set()

    def log_message(self, *_: object) -> None:
        pass


def played(folder: Path, job: common.Row) -> Any:
    """Answer of the folder's page in Chromium."""
    handler = functools.partial(Handler, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    words = urllib.parse.quote(json.dumps(job))
    Handler.done.clear()
    with tempfile.TemporaryDirectory() as profile:
        browser = subprocess.Popen(
            [
                os.environ.get("CHROMIUM", "chromium"), "--headless=new", "--no-sandbox",
                "--disable-background-networking", "--use-gl=angle", "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader", f"--user-data-dir={profile}",
                f"http://127.0.0.1:{server.server_port}/index.html#{words}",
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


def files() -> dict[str, list[str]]:
    """Commands that each file goes through."""
    still = ["Duck.glb", "IridescenceSuzanne.glb"]
    return {name: ["convert"] for name in still} | {
        name: ["convert", "decompose"] for name in ("Fox.glb", "Llama.gltf", "Pig.gltf", MADE)
    }


if __name__ == "__main__":
    cases = {
        f"{file} {way}": {"file": file, "way": way}
        for file, ways in files().items()
        for way in ways
    }
    columns = ("vertices", "pixels, mean", "pixels, most", "pixels off by more than 8", "places")
    common.run(__file__, __doc__, cases, measure, columns)
