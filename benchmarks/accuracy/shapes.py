"""What shapes beside bones, affine bones and bones driven by expressions bring, and cost.

    python benchmarks/accuracy/shapes.py [--data FOLDER] [--only face,bytes,eight,none,smallest]

Five tables go to benchmarks/results/shapes.json: the ICT face by decompose_expressions; shapes and
affine bones on ea_bone at equal bytes, with four influences and with eight; whether fit_shapes
makes shapes where bones do better; and twelve sequences by smallest with the fewest bones and with
the fewest bytes.
E is 1000 · RMSE/√3, seconds are CPU seconds.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

import ssdr
from docs.gallery.made import bouncing_ball
from ssdr.fit.shapes import shapes_within
from ssdr.storage.keyframes import Tracks

RESULTS = Path(__file__).parents[1] / "results" / "shapes.json"
DATA = Path(__file__).parents[3] / "shared" / "data"
TOLERANCE = "0.5%"
SMALLEST = (
    "ea_bone", "ball", "fox", "morph_stress", "dancer", "horse_poses", "cat_poses", "horse_gallop",
    "cow_elastic", "ict_face_expressions", "mannequin_rumba", "samba",
)  # fmt: skip
NONE = (("horse_gallop", 20), ("samba", 20), ("cow_elastic", 24), ("morph_stress", 9))


def timed(call: Any) -> tuple[Any, float]:
    start = time.process_time()
    return call(), time.process_time() - start


def error(vertices: np.ndarray, truth: np.ndarray) -> float:
    return float(1000 * np.sqrt(((vertices - truth) ** 2).sum(axis=2).mean() / 3))


def sizes(model: ssdr.Skinning) -> dict[str, int]:
    """Bytes of .glb files: plain, compressed, and with all expressions in one clip."""
    one = dataclasses.replace(model, clips=None, fps=24.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.glb"
        return {
            "clips": ssdr.save(model, path).bytes,
            "one_clip": ssdr.save(one, path).bytes,
            "one_clip_meshopt": ssdr.save(one, path, compression="meshopt").bytes,
        }


def face(data: Path) -> list[dict[str, Any]]:
    """The ICT face, in millimetres, with 40 bones; and as blend shapes alone."""
    arrays = np.load(data / "ict_face_expressions.npz")
    frames, faces = 10 * arrays["vertices"].astype(np.float64), arrays["faces"]
    rest, moved = frames[0], frames[1:] - frames[0]
    names = [str(name) for name in arrays["names"][1:]]
    truth = ssdr.MeshSequence(frames, faces)
    amounts = np.zeros((2 * len(moved), len(moved)))
    amounts[1::2] = np.eye(len(moved))
    index = np.where(np.arange(len(amounts)) % 2 == 1, 1 + np.arange(len(amounts)) // 2, 0)
    clips = tuple(ssdr.Clip(name, 2 * k, 2 * k + 2, 24) for k, name in enumerate(names))
    rows = []
    for limit in (1.0, 0.5):
        options: dict[str, Any] = {"faces": faces, "names": names, "bones": 40, "tolerance": limit}
        made, cpu = timed(lambda o=options: ssdr.decompose_expressions(rest, moved + rest, **o))
        model = dataclasses.replace(made.skinning, space=ssdr.Space(0.001, "y"))
        still = np.eye(3, 4)
        off = np.abs(model.skin()[1::2] - frames[1:])
        blend = ssdr.fit_shapes(
            frames[index],
            ssdr.Skinning.from_dense(
                rest, np.ones((len(rest), 1)), np.tile(np.eye(3, 4), (len(index), 1, 1, 1)),
                faces=faces, clips=clips, space=model.space,
            ),
            tolerance=limit, amounts=amounts, names=names,
        )  # fmt: skip
        pairs = np.array([
            [k in pair for k in range(len(moved))]
            for pair in itertools.combinations(range(len(moved)), 2)
        ], dtype=float)  # fmt: skip
        worst, squares = 0.0, 0.0
        for some in np.array_split(pairs, 64):
            gap = ssdr.drive(model, some).skin() - rest - np.tensordot(some, moved, 1)
            distance = np.linalg.norm(gap, axis=2)
            worst, squares = max(worst, float(distance.max())), squares + float((distance**2).sum())
        turned = [
            ssdr.metrics.normals(dataclasses.replace(truth, vertices=frames[index]), x).mean
            for x in (dataclasses.replace(model, shapes=None), model)
        ]
        rows.append({
            "tolerance_mm": limit, "bones": 40, "influences": 8, "cpu_s": cpu,
            "deltas": made.displaced, "blend_shape_deltas": blend.displaced,
            "rmse_mm": made.rmse, "max_mm": made.max_error,
            "coordinate_mean_mm": float(off.mean()), "coordinate_max_mm": float(off.max()),
            "bone_numbers_not_0": 6 * int((model.transforms[1::2] != still).any((2, 3)).sum()),
            "pairs_rmse_mm": float(np.sqrt(squares / pairs.shape[0] / len(rest))),
            "pairs_max_mm": worst, "normals_without": turned[0], "normals_with": turned[1],
            "bytes": sizes(model), "blend_bytes": sizes(blend.skinning),
        })  # fmt: skip
    return rows


def row_of(truth: ssdr.MeshSequence, rows: list[dict[str, Any]]) -> Any:
    """Function that adds the row of a model."""

    def row(what: str, model: ssdr.Skinning, cpu: float) -> None:
        with tempfile.TemporaryDirectory() as folder:
            report = ssdr.save(model, Path(folder) / "a.glb")
            back = ssdr.load_skinning(report.path).skin()
        rows.append({
            "what": what, "E": error(model.skin(), truth.vertices),
            "bytes": ssdr.parsimony.size(model).total, "glb_bytes": report.bytes,
            "E_of_file": error(back, truth.vertices), "cpu_s": cpu,
            "E_between_frames": 1000 * (report.between_frames or 0.0) / np.sqrt(3),
            "normals": ssdr.metrics.normals(truth, model).mean,
        })  # fmt: skip

    return row


def equal_bytes(data: Path) -> list[dict[str, Any]]:
    """ea_bone: rigid bones, rigid bones and shapes, affine bones as two nodes each."""
    arrays, rows = np.load(data / "ea_bone.npz"), []
    truth = ssdr.MeshSequence(arrays["vertices"], arrays["faces"])
    row = row_of(truth, rows)
    for bones in (10, 20):
        found, cpu = timed(lambda b=bones: ssdr.decompose(truth, bones=b))
        row(f"{bones} rigid", found.skinning, cpu)
        for shapes in (5, 10) if bones == 10 else ():
            fit, more = timed(
                lambda s=shapes, m=found.skinning: ssdr.fit_shapes(truth, m, shapes=s)
            )
            row(f"{bones} rigid + {shapes}, worth {fit.worth:.2f}", fit.skinning, cpu + more)
    found, cpu = timed(lambda: ssdr.decompose(truth, bones=10, bone_model="affine"))
    row("10 affine", found.skinning, cpu)
    return rows


def eight(data: Path) -> list[dict[str, Any]]:
    """ea_bone with eight influences; shapes whatever they are worth, and affine bones' keys."""
    arrays, rows = np.load(data / "ea_bone.npz"), []
    truth = ssdr.MeshSequence(arrays["vertices"], arrays["faces"])
    row = row_of(truth, rows)
    for kind, bones in (("rigid", 10), ("rigid", 13), ("rigid", 18), ("affine", 10)):
        options: dict[str, Any] = {"bones": bones, "bone_model": kind, "influences": 8}
        found, cpu = timed(lambda o=options: ssdr.decompose(truth, **o))
        model = found.skinning
        row(f"{bones} {kind}", model, cpu)
        if kind == "affine":
            tracks = Tracks(model, np.array([0, model.n_frames]))
            kept = tracks.sparsest(1e-4, lambda m: error(m.skin(), truth.vertices) <= 0.101)
            row("10 affine, fewer keys", kept, cpu)
        for limit in (0.68, 0.44) if bones == 10 and kind == "rigid" else ():
            shaped = shapes_within(truth.vertices, model, limit / 1000 * np.sqrt(3)).skinning
            row(f"10 rigid + {shaped.n_shapes}", shaped, cpu)
    return rows


def none(data: Path) -> list[dict[str, Any]]:
    """Whether fit_shapes makes shapes where the rule says bones."""
    rows = []
    for name, bones in NONE:
        arrays = np.load(data / f"{name}.npz")
        truth = ssdr.MeshSequence(arrays["vertices"], arrays["faces"])
        model = ssdr.decompose(truth, bones=bones, effort="fast").skinning
        fit, cpu = timed(lambda t=truth, m=model: ssdr.fit_shapes(t, m, shapes=2))
        rows.append({"sequence": name, "bones": bones, "worth": fit.worth, "cpu_s": cpu,
                     "shapes": fit.skinning.n_shapes})  # fmt: skip
    return rows


def smallest(data: Path) -> Iterator[dict[str, Any]]:
    """Bytes and CPU seconds of the smallest model by bones, and by bytes."""
    for name in SMALLEST:
        made = {"ball": bouncing_ball, "dancer": lambda: ssdr.samples.load("dancer")}
        if name in made:
            truth = made[name]()
        else:
            arrays = np.load(data / f"{name}.npz")
            truth = ssdr.MeshSequence(arrays["vertices"], arrays["faces"])
        row: dict[str, Any] = {"sequence": name, "tolerance": TOLERANCE}
        for fewest in ("bones", "bytes"):
            found, cpu = timed(
                lambda t=truth, f=fewest: ssdr.smallest(
                    t, tolerance=TOLERANCE, effort="fast", fewest=f
                )
            )
            model, report = found.skinning, found.parsimony
            gap = model.skin(dtype=np.float64) - truth.vertices
            rmse = float(np.sqrt((gap**2).sum(axis=2).mean()))
            row[fewest] = {
                "means": report.prunings[1].what if fewest == "bytes" else "", "cpu_s": cpu,
                "bones": model.n_bones, "bone_model": model.bone_model, "shapes": model.n_shapes,
                "influences": model.n_influences, "bytes": report.size.total,
                "error_of_tolerance": rmse / report.tolerance,
            }  # fmt: skip
        yield row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--only", default="face,bytes,eight,none,smallest")
    chosen = parser.parse_args()
    tables: dict[str, Any] = {
        "face": face,
        "bytes": equal_bytes,
        "eight": eight,
        "none": none,
        "smallest": smallest,
    }
    record = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    record["command"] = "python benchmarks/accuracy/shapes.py"
    for name in chosen.only.split(","):
        record[name] = []
        for row in tables[name](chosen.data):
            record[name].append(row)
            print(row, flush=True)
            RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
