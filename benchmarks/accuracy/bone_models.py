"""When do bones that grow or stretch pay, at equal bones and at equal bytes of transforms?

    python benchmarks/accuracy/bone_models.py

A rigid bone takes 7 floats a frame (quaternion and translation), one that grows
8, an affine one 12; rest pose and weights cost the same for all.  Each case is
solved with all three at the same number of bones, and with as many similarity
and affine bones as fit into the bytes of the rigid ones.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import (
    IMAGES,
    RESULTS,
    e_of,
    load,
    machine,
    plain_log_ticks,
    pyplot,
    save_figure,
    table,
    tell,
    write_csv,
    write_json,
)

FLOATS = {"rigid": 7, "similarity": 8, "affine": 12}
COLOURS = {"rigid": "#0072b2", "similarity": "#e69f00", "affine": "#d55e00"}
CASES = [
    ("cow_elastic", 24), ("horse_gallop", 10), ("horse_gallop", 20), ("horse_gallop", 30),
    ("ea_bone", 20),
]  # fmt: skip
# E of the affine bones of the 2012 author's program, 4 influences
AUTHOR = {
    ("cow_elastic", 24): 3.15,
    ("horse_gallop", 10): 5.65,
    ("horse_gallop", 20): 2.80,
    ("horse_gallop", 30): 1.76,
}
COLUMNS = [
    "data", "rigid bones", "effort", "compared at", "bone_model", "bones", "bytes a frame", "E",
    "E / rigid", "author's affine", "cpu seconds",
]  # fmt: skip


def variants(bones: int) -> list[tuple[str, str, int]]:
    """(compared at, bone model, bones)."""
    same = [("equal bones", model, bones) for model in FLOATS]
    fitting = [
        ("equal bytes", model, bones * FLOATS["rigid"] // FLOATS[model])
        for model in ("similarity", "affine")
    ]
    return same + fitting


def measure(data: str, rigid: int, effort: Any, at: str, model: Any, bones: int) -> dict[str, Any]:
    frames, faces = load(data)
    cpu = time.process_time()
    result = ssdr.decompose(
        frames, faces, bones=bones, bone_model=model, effort=effort, influences=4
    )
    cpu = time.process_time() - cpu
    skinning = result.skinning
    det = np.linalg.det(skinning.transforms[..., :3])
    if not det.min() > 0 or skinning.n_bones != bones:
        raise SystemExit(f"{data}, {model}: det {det.min()}, {skinning.n_bones} bones")
    return {
        "data": data, "rigid bones": rigid, "effort": effort, "compared at": at,
        "bone_model": model, "bones": bones, "bytes a frame": 4 * FLOATS[model] * bones,
        "E": e_of(frames, skinning), "smallest det": float(det.min()),
        "largest det": float(det.max()), "cpu seconds": cpu,
        "author's affine": AUTHOR.get((data, rigid)) if model == "affine" and bones == rigid
        else None,
    }  # fmt: skip


def key(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[k] for k in ("data", "rigid bones", "effort", "compared at", "bone_model"))


def finish(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """In order, with the ratio to the rigid bones of the same case and effort."""
    base = {key(row)[:3]: row["E"] for row in rows if row["bone_model"] == "rigid"}
    for row in rows:
        known = base.get(key(row)[:3])
        row["E / rigid"] = None if known is None else row["E"] / known
    place = {case: k for k, case in enumerate(CASES)}
    kinds = list(FLOATS)
    return sorted(
        rows,
        key=lambda r: (
            place[r["data"], r["rigid bones"]],
            r["effort"],
            r["compared at"],
            kinds.index(r["bone_model"]),
        ),
    )


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Error over bytes of transforms, a panel a sequence."""
    plt = pyplot()
    names = list(dict.fromkeys(data for data, _ in CASES))
    figure, axes = plt.subplots(1, len(names), figsize=(2.6 * len(names), 3.0))
    for axis, name in zip(axes, names, strict=True):
        for model, colour in COLOURS.items():
            mine = [
                (r["bytes a frame"], r["E"])
                for r in rows
                if r["data"] == name and r["bone_model"] == model and r["effort"] == "balanced"
            ]
            if mine:
                x, y = np.array(sorted(set(mine))).T
                axis.plot(x, y, "o-", color=colour, label=model, markersize=4)
        axis.set(yscale="log", title=name, xlabel="bytes of transforms a frame")
        plain_log_ticks(axis)
    axes[0].set_ylabel("E")
    axes[0].legend(fontsize=7)
    save_figure(figure, path)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--effort", choices=["fast", "balanced", "best"], default="balanced")
    parser.add_argument("--only", nargs="+", help="sequences")
    parser.add_argument("--bone-models", nargs="+", choices=list(FLOATS), default=list(FLOATS))
    parser.add_argument("--chart-only", action="store_true", help="draw what is there again")
    parser.add_argument("--out", type=Path, default=RESULTS / "bone_models.json")
    parser.add_argument("--chart", type=Path, default=IMAGES / "bone_models.png")
    args = parser.parse_args()
    old = json.loads(args.out.read_text()) if args.out.exists() else {"rows": [], "machine": {}}
    rows = {key(row): row for row in old["rows"]}
    rates = old["machine"]
    if not args.chart_only:
        rates = machine()
        tiny = np.random.default_rng(0).standard_normal((3, 8, 3))
        ssdr.decompose(tiny, bones=2, effort="fast")  # kernels ready
        for data, bones in CASES:
            if args.only and data not in args.only:
                continue
            for at, model, count in variants(bones):
                if model not in args.bone_models:
                    continue
                row = measure(data, bones, args.effort, at, model, count)
                rows[key(row)] = row
                print(
                    f"{data:22} {at} {model:10} {count:3} bones  E {row['E']:8.4f}  "
                    f"{row['cpu seconds']:6.1f} s",
                    flush=True,
                )
                ordered = finish(list(rows.values()))
                question = {"question": __doc__.splitlines()[0], "machine": rates}
                write_json(args.out, question | {"rows": ordered})
    ordered = finish(list(rows.values()))
    write_csv(args.out.with_suffix(".csv"), [{k: r[k] for k in COLUMNS} for r in ordered])
    chart(ordered, args.chart)
    print(table(ordered, COLUMNS))
    print(tell(rates))


if __name__ == "__main__":
    main()
