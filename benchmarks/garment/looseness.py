"""Error of each vertex against its distance from the body (the paper's figure on loose parts).

Run after ``garmentnet reproduce --only table2``, with its folders and settings, from which the
networks are taken::

    python benchmarks/garment/looseness.py --data out --output out/reproduction [--set ...]

Printed are mean errors over the vertices of each quarter, by mean distance from the body, on the
test dances; ``--chart FILE`` draws distance and errors on the dress.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks.garment.published import BASELINES
from benchmarks.garment.reproduce import Reproduction
from garmentnet.data.store import ClipStore
from ssdr import MeshSequence
from ssdr.render import render_frame

EVERY = 10  # frames between those whose distance from the body is measured
SIZE, HEAD = (420, 560), 30  # pixels of a picture, and of the line above it


def looseness(store: ClipStore, names: list[str]) -> NDArray[np.float64]:
    """Mean distance (V,) of each vertex from the nearest vertex of the body, metres."""
    found = []
    for name in names:
        clip = store.clip(name)
        bodies, cloth = clip.body(slice(None, None, EVERY)), clip.sequence.vertices[::EVERY]
        found += [cKDTree(b).query(v)[0] for b, v in zip(bodies, cloth, strict=True)]
    return np.mean(found, axis=0)


def draw(store: ClipStore, shown: dict[str, NDArray[np.float64]]) -> Image.Image:
    """The garment at rest, coloured by each of some lengths (V,); the first has its own scale."""
    rest = np.asarray(store.rest, np.float64)
    plain = MeshSequence(rest[None], store.faces)
    names = list(shown)
    worst = max(np.percentile(shown[n], 98) for n in names[1:])
    sheet = Image.new("RGB", (SIZE[0] * len(names), SIZE[1] + HEAD), "white")
    font, text = ImageFont.load_default(18), ImageDraw.Draw(sheet)
    for k, name in enumerate(names):
        top = float(np.percentile(shown[name], 98)) if k == 0 else float(worst)
        # A reference that is moved by the length has this length as its error.
        moved = MeshSequence((rest + shown[name][:, None] * [1.0, 0.0, 0.0])[None], store.faces)
        picture = render_frame(
            plain, style="error", reference=moved, size=SIZE, scale=top, azimuth=25.0
        )
        sheet.paste(picture, (SIZE[0] * k, HEAD))
        text.text((SIZE[0] * k + 12, 5), f"{name}, 0 to {1e3 * top:.0f} mm", "black", font)
    return sheet


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--data", type=Path, required=True, help="folder of the data sets")
    options.add_argument("--output", type=Path, required=True, help="folder of the reproduction")
    options.add_argument("--store", default="dress")
    options.add_argument("--set", action="append", default=[], help="settings of the reproduction")
    options.add_argument("--chart", type=Path)
    given = options.parse_args()
    run = Reproduction(given.data, given.output, settings=given.set)
    store, config = run.store(given.store), run.config("rooted", "data.frames=40000")
    names = run.clips(given.store, config)[2]
    chosen = [v for v in BASELINES if v.name.endswith("published") or v.name == "TailorNet"]
    methods = [run.method(given.store, "rooted", config)]
    methods += run.baselines(given.store, config, chosen)
    shown = {"distance from the body": looseness(store, names)}
    bound = run.bones(given.store, config).bound
    for make in methods:
        method, total, frames = make(), 0.0, 0
        for name in names:
            clip = store.clip(name)
            got = method.predict(clip)
            got = got if bound is None else bound.place(got, clip.joints)
            gap = np.linalg.norm(got - clip.sequence.vertices, axis=2)
            total, frames = total + gap.sum(axis=0, dtype=np.float64), frames + len(gap)
        shown[method.name] = total / frames
    far = shown["distance from the body"]
    quarter = np.digitize(far, np.percentile(far, [25, 50, 75]))
    heads = [f"{1e3 * far[quarter == q].mean():.0f}" for q in range(4)]
    print(f"| mean distance from the body, mm | {' | '.join(heads)} | correlation |")
    print("|---" * 6 + "|")
    for name, error in list(shown.items())[1:]:
        cells = [f"{1e3 * error[quarter == q].mean():.1f}" for q in range(4)]
        print(f"| {name} | {' | '.join(cells)} | {np.corrcoef(far, error)[0, 1]:.2f} |")
    if given.chart:
        draw(store, shown).save(given.chart)


if __name__ == "__main__":
    main()
