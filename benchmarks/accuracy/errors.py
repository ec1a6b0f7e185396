"""Error by effort, bones, influences, seed and bone model, and on data that is exact skinning.

    python benchmarks/accuracy/errors.py                      # hours; --only takes words of names
    python benchmarks/accuracy/errors.py --only "efforts fox" "recovery chain"

efforts: sequences that the race does not run.  recovery: exact linear blend skinning, a game
character's own (fox, baked to float32) and a bending tube.  kinds: bones that grow or stretch, with
as many bones as the rigid model, and with as many as fit into the bytes of its transforms.  bones,
influences, seeds: the dancer that ships with the package, also pruned from eight influences.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.common import EFFORTS, Row, plain_log_ticks, pyplot, save_figure

# E after 100 plain alternations of weights, bones and rest pose
PLAIN = {
    ("horse_gallop", 10, 4): 4.88,
    ("horse_gallop", 20, 4): 2.05,
    ("horse_gallop", 30, 4): 0.94,
    ("cow_elastic", 24, 4): 4.68,
    ("samba", 20, 4): 3.26,
    ("ea_bone", 5, 8): 6.7,
    ("ea_bone", 10, 8): 1.30,
    ("ea_bone", 20, 8): 0.45,
    ("fox", 24, 4): 18.9,
}
HERE = [*PLAIN][5:]  # not in the race
# E of the affine bones of the 2012 author's program
AUTHOR = {
    ("cow_elastic", 24): 3.645,
    ("horse_gallop", 10): 6.606,
    ("horse_gallop", 20): 3.274,
    ("horse_gallop", 30): 2.056,
}
FLOATS = {"rigid": 7, "similarity": 8, "affine": 12}  # numbers per bone and frame
EXACT = {"fox": 24, "chain": 6}  # bones
STRETCH = [*AUTHOR, ("ea_bone", 20)]


def chain(bones: int = 6, frames: int = 60, seed: int = 7) -> np.ndarray:
    """A tube of 80 rings of 16 vertices on a chain of joints that swing and twist."""
    rng = np.random.default_rng(seed)
    along = np.linspace(0.0, bones, 80)
    angle = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    x, a = (m.ravel() for m in np.meshgrid(along, angle, indexing="ij"))
    rest = np.stack([x, 0.35 * np.cos(a), 0.25 * np.sin(a)], axis=1)
    dense = np.exp(-(((x[:, None] - np.arange(bones) - 0.5) / 0.8) ** 2))
    indices = np.argsort(-dense, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(dense, indices, axis=1)
    weights[weights < 0.01] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    phase, speed = rng.uniform(0, 2 * np.pi, (bones, 3)), rng.uniform(1.0, 4.0, (bones, 3))
    clock = np.arange(frames)[:, None, None] / 24.0
    swing = np.sin(clock * speed + phase) * np.array([0.3, 0.4, 0.5])
    transforms = np.empty((frames, bones, 3, 4))
    for t in range(frames):
        world = np.eye(4)
        for j, turn in enumerate(Rotation.from_euler("XYZ", swing[t]).as_matrix()):
            local, pivot = np.eye(4), np.array([j, 0.0, 0.0])
            local[:3, :3], local[:3, 3] = turn, pivot - turn @ pivot
            world = world @ local
            transforms[t, j] = world[:3]
    return common.reskin(rest, indices, weights, transforms)


def cases() -> Iterator[tuple[str, Row]]:
    """Name and arguments of each case."""

    def case(group: str, sequence: str, bones: int, **more: Any) -> tuple[str, Row]:
        words = [group, f"{sequence}-{bones}", *map(str, more.values())]
        return " ".join(words), {"group": group, "sequence": sequence, "bones": bones, **more}

    for sequence, bones, influences in HERE:
        for effort in EFFORTS:
            yield case("efforts", sequence, bones, effort=effort, influences=influences)
    for sequence, bones in EXACT.items():
        for effort in EFFORTS:
            yield case("recovery", sequence, bones, effort=effort)
    for sequence, rigid in STRETCH:
        for kind in FLOATS:
            yield case("kinds", sequence, rigid, bone_model=kind)
        for kind in ("similarity", "affine"):
            fitting = rigid * FLOATS["rigid"] // FLOATS[kind]
            yield case("kinds, equal bytes", sequence, fitting, bone_model=kind, rigid=rigid)
    yield case("kinds", "cow_elastic", 24, bone_model="affine", effort="best")
    for bones in (5, 10, 20, 40, 80):
        yield case("bones", "dancer", bones)
    for influences in (1, 2, 3, 4, 6, 8):
        yield case("influences", "dancer", 20, influences=influences)
    for seed in range(5):
        yield case("seeds", "dancer", 20, seed=seed)


def measure(
    group: str,
    sequence: str,
    bones: int,
    effort: Any = "balanced",
    influences: int = 4,
    bone_model: Any = "rigid",
    seed: int = 0,
    rigid: int | None = None,
) -> Row:
    frames, faces = (chain(), None) if sequence == "chain" else common.load(sequence)
    common.compile_kernels()
    wall, cpu = time.perf_counter(), time.process_time()
    result = ssdr.decompose(
        frames, faces, bones=bones, influences=influences, effort=effort,
        bone_model=bone_model, rng=seed,
    )  # fmt: skip
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    model = result.skinning
    if wrong := common.defects(model, bones, influences):
        raise SystemExit("; ".join(wrong))
    diagonal = ssdr.MeshSequence(frames).diagonal()
    away = np.linalg.norm(np.asarray(frames, dtype=np.float64) - common.skinned(model), axis=-1)
    row: Row = {
        "effort": effort, "influences": influences, "bone_model": bone_model, "seed": seed,
        "rigid": rigid or bones,
        "E": common.e_of(frames, model), "seconds": wall, "cpu seconds": cpu,
        "rmse / diagonal": float(np.sqrt((away**2).mean())) / diagonal,
        "max / diagonal": float(away.max()) / diagonal,
    }  # fmt: skip
    if group == "influences" and influences == 8:
        pruned = {k: common.e_of(frames, model.prune(k)) for k in (1, 2, 3, 4, 6, 8)}
        row["E pruned"] = {str(k): e for k, e in pruned.items()}
    return row


# --- the chart -----------------------------------------------------------------------------------


def chart(rows: dict[str, Row], images: Path) -> None:
    """Error over bytes of transforms, a panel for each sequence."""
    found = [row for row in rows.values() if row["group"].startswith("kinds")]
    if not found:
        return
    names = list(dict.fromkeys(name for name, _ in STRETCH))
    figure, axes = pyplot().subplots(1, len(names), figsize=(2.6 * len(names), 3.0))
    colours = dict(zip(FLOATS, ("#0072b2", "#e69f00", "#d55e00"), strict=True))
    for axis, name in zip(axes, names, strict=True):
        for kind, colour in colours.items():
            line = {
                (4 * FLOATS[kind] * r["bones"], r["E"])
                for r in found
                if (r["sequence"], r["bone_model"], r["effort"]) == (name, kind, "balanced")
            }
            if line:
                axis.plot(*np.array(sorted(line)).T, "o-", color=colour, label=kind, markersize=4)
        axis.set(yscale="log", title=name, xlabel="bytes of transforms a frame")
        plain_log_ticks(axis)
    axes[0].set_ylabel("E")
    axes[0].legend(fontsize=7)
    save_figure(figure, images / "bone_models.png")


def millimetres(e: float) -> float:
    """RMSE in millimetres of a sequence in metres, from E."""
    return float(np.sqrt(3) * e)


if __name__ == "__main__":
    columns = ("E", "rmse / diagonal", "max / diagonal", "seconds", "cpu seconds")
    common.run(__file__, __doc__, dict(cases()), measure, columns, chart)
