"""The quality gate on 200 short clips of four garments, 20 of them spoilt on purpose in five ways.

``python benchmarks/garment/gate.py -o FOLDER`` writes what it measured of each clip, and prints how
many of each kind it refused, and why; what is there is not made again.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.garment.scenes.body import default_body
from benchmarks.garment.scenes.cloth import Cloth, Solver
from benchmarks.garment.scenes.cut import cut_garment
from benchmarks.garment.scenes.dance.choreography import dance
from benchmarks.garment.scenes.garments import Garment
from benchmarks.garment.scenes.scene_file import load_data_set
from benchmarks.garment.scenes.simulator import outfit_of, pins_of
from benchmarks.garment.scenes.simulator import simulate as simulated
from garmentnet.evaluation.tables import markdown
from garmentnet.importing.quality import LIMITS, judge
from ssdr import skin
from ssdr.io.atomic import write_bytes

GARMENTS = ("dress", "a_line", "skirt", "t_shirt")
SPOILT = ("caught", "limb", "pressed", "unpinned", "late")
CLIPS, EVERY, SEED = 200, 10, 60_000
FRAMES, START, LATE, VERTICES = 90, 30, 5, 600
BODY, SOLVER = default_body(), Solver(substeps=30, approach=8, settle=22)
Array = np.ndarray


def spoil(kind: str, v: Array, joints: Array, garment: Garment, rng: np.random.Generator) -> Array:
    """Vertices of a clip of which a patch is caught or pressed into the body, or that come late."""
    b, out = BODY.skinning, v.copy()
    posed = np.asarray(skin(b.rest, b.indices, b.weights, joints), np.float32)
    pairs = zip(v, posed, strict=True)
    way = [q[np.argmin(((p[:, None] - q) ** 2).sum(-1), axis=1)] - p for p, q in pairs]
    gap = np.linalg.norm(way, axis=2)
    middle = rng.choice(np.flatnonzero(~garment.pinned & (gap[START] < 0.05)))
    far = np.linalg.norm(v[START] - v[START, middle], axis=1)
    if kind == "caught":  # it stays where it is, and the cloth around it nearly
        held = np.exp(-((far / 0.08) ** 2)) * ~garment.pinned
        out[START:] += held[:, None] * (v[START] - v[START:])
    elif kind == "pressed":  # 2 cm beyond the nearest vertex of the skin, for a second and a half
        hit, when = np.flatnonzero((far < 0.12) & ~garment.pinned), slice(START, START + 45)
        to = np.asarray(way)[when, hit] * (1 + 0.02 / gap[when, hit])[..., None]
        out[when, hit] += to
    elif kind == "late":
        out[LATE:] = v[:-LATE]
    return out


def measured(number: int) -> dict[str, object]:
    """Kind of a clip and what the gate says of it."""
    kind = SPOILT[number // EVERY % len(SPOILT)] if number % EVERY == 0 else "sound"
    name, rng = GARMENTS[number // 3 % len(GARMENTS)], np.random.default_rng(SEED + number)
    data_set = load_data_set(name)
    garment = cut_garment(BODY, dataclasses.replace(data_set.garment, vertices=VERTICES))
    worn = garment
    if kind == "limb":  # the right leg and arm do not touch it
        worn = dataclasses.replace(garment, sides=np.ones(garment.n_vertices, np.int8))
    if kind == "unpinned":  # on the left
        worn = dataclasses.replace(garment, pinned=garment.pinned & (garment.rest[:, 0] < 0))
    classes = {"caught": ["walk"], "limb": ["walk", "kick"]}.get(kind)
    motion = dance(BODY.skeleton, seed=SEED + number, frames=FRAMES, classes=classes)
    v = simulated(Cloth(BODY, worn, SOLVER), motion, data_set.base).vertices
    if kind in ("caught", "pressed", "late"):
        v = spoil(kind, v, motion.joints, garment, rng)
    outfit = outfit_of(BODY, garment, motion.fps)
    limits, bound = LIMITS | data_set.gate, pins_of(garment)
    found = judge(outfit, motion.joints, v, bound=bound, limits=limits)
    return {"kind": kind, "garment": name, **found}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--output", "-o", type=Path, default=Path("out/gate"))
    folder, rows = options.parse_args().output, []
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(CLIPS):
        file = folder / f"{number:03d}.json"
        if not file.is_file():
            write_bytes(file, json.dumps(measured(number), indent=1).encode())
        rows.append(json.loads(file.read_text("utf-8")))
    table = []
    for kind in ("sound", *SPOILT):
        clips = [r for r in rows if r["kind"] == kind]
        why = Counter(x.split()[0] for r in clips for x in r["reason"].split("; ") if x)
        count = sum(not r["accepted"] for r in clips)
        reasons = ", ".join(f"{k} {n}" for k, n in why.items())
        table.append([kind, str(len(clips)), str(count), reasons])
    print(markdown(["clips", "made", "refused", "because of"], table))


if __name__ == "__main__":
    main()
