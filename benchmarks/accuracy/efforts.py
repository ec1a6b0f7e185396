"""How accurate is each effort, and after how many seconds?

    python benchmarks/accuracy/efforts.py --effort fast balanced
    python benchmarks/accuracy/efforts.py --effort best --only ea_bone-20

E = 1000 ‖A − Ã‖_F / sqrt(3 F V) in the files' own units, from the model's arrays by plain NumPy.
"wall" and "cpu seconds" (both cores together) are seconds of the call without compilation; on a
machine that others use too the second says more.  Runs of one effort replace the rows of that
effort in the table; the others stay, each beside the rates of the machine when it ran.  The cases
that the race runs are not run again here: the page takes its rows.
"""

from __future__ import annotations

import argparse
import dataclasses
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
    data_folder,
    defects,
    e_of,
    error_e,
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


@dataclasses.dataclass(frozen=True)
class Case:
    """A sequence, its bones, and E of others: the plain alternation of a sketch (100 iterations,
    NumPy, SciPy and Numba), and the bounds that this project set itself; `raced`: in race.py."""

    data: str
    bones: int
    plain: float
    core: float
    peers: float
    influences: int = 4
    raced: bool = False

    @property
    def name(self) -> str:
        return f"{self.data}-{self.bones}"


CASES = [
    Case("horse_gallop", 10, 4.88, 4.2, 3.6, raced=True),
    Case("horse_gallop", 20, 2.05, 1.65, 1.38, raced=True),
    Case("horse_gallop", 30, 0.94, 0.80, 0.66, raced=True),
    Case("cow_elastic", 24, 4.68, 4.50, 4.30, raced=True),
    Case("samba", 20, 3.26, 3.15, 2.95, raced=True),
    Case("ea_bone", 5, 6.7, 5.5, 4.4, influences=8),
    Case("ea_bone", 10, 1.30, 1.1, 0.85, influences=8),
    Case("ea_bone", 20, 0.45, 0.40, 0.28, influences=8),
    Case("fox", 24, 18.9, 9.5, 0.95),
]
HERE = [case for case in CASES if not case.raced]
EFFORTS = ("fast", "balanced", "best")
COLUMNS = (
    "case", "K", "effort", "E", "wall", "cpu seconds", "seconds to plain", "plain", "core", "peers",
    "E / plain", "E / EA", "stopped", "gemm_1", "gemm_2", "load",
)  # fmt: skip


def ea_published(bones: int) -> float:
    """E of EA's own result, dense weights, from the arrays that they published."""
    with np.load(data_folder() / "reference" / f"ea_ref_Decomposition_{bones:02}.npz") as z:
        rest, weights, transforms = z["rest"], z["weights"], z["transforms"]
    frames, _ = load("ea_bone")
    p = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    return error_e(frames, np.einsum("vb,tbij,vj->tvi", weights, transforms, p, optimize=True))


def measure(case: Case, effort: Any, seed: int, rates: dict[str, Any]) -> dict[str, Any]:
    frames, faces = load(case.data)
    cpu = time.process_time()
    result = ssdr.decompose(
        frames, faces, bones=case.bones, influences=case.influences, effort=effort, rng=seed
    )
    cpu = time.process_time() - cpu
    e = e_of(frames, result.skinning)
    wrong = defects(result.skinning, case.bones, case.influences)
    if wrong:
        raise SystemExit(f"{case.name}, {effort}: {'; '.join(wrong)}")
    per_rmse = 1000 / np.sqrt(3)
    history = [(round(r.elapsed, 3), round(per_rmse * r.rmse, 4)) for r in result.history]
    reached = next((s for s, value in history if value <= case.plain), None)
    ea = ea_published(case.bones) if case.data == "ea_bone" else None
    return {
        "case": case.name, "K": case.influences, "effort": effort, "seed": seed, "E": e,
        "stated E": per_rmse * result.rmse, "last gain": result.history[-1].elapsed,
        "wall": result.state.progress["elapsed"], "cpu seconds": cpu, "seconds to plain": reached,
        "plain": case.plain, "core": case.core, "peers": case.peers, "E / plain": e / case.plain,
        "E / core": e / case.core, "E / peers": e / case.peers,
        "EA": ea, "E / EA": None if ea is None else e / ea, "stopped": result.stop_reason,
        "history": history, **rates,
    }  # fmt: skip


def keep(rows: dict[tuple[str, str], dict[str, Any]], path: Path) -> list[dict[str, Any]]:
    order = [(c.name, e) for c in HERE for e in EFFORTS if (c.name, e) in rows]
    ordered = [rows[key] for key in order]
    write_json(path, {"question": __doc__.splitlines()[0], "rows": ordered})
    return ordered


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Error over time, one panel a case."""
    plt = pyplot()
    figure, axes = plt.subplots(2, 2, figsize=(8, 6.4))
    colours = dict(zip(EFFORTS, ("#e69f00", "#0072b2", "#009e73"), strict=True))
    for axis, case in zip(axes.flat, HERE, strict=True):
        for row in rows:
            if row["case"] == case.name:
                seconds, errors = np.array([*row["history"], (row["wall"], row["E"])]).T
                axis.step(
                    seconds, errors, where="post", color=colours[row["effort"]], label=row["effort"]
                )
        for value, style, name in (
            (case.plain, ":", "plain"),
            (case.core, "--", "first bound"),
            (case.peers, "-.", "harder bound"),
        ):
            axis.axhline(value, color="0.4", linewidth=0.8, linestyle=style, label=name)
        axis.set(
            xscale="log",
            yscale="log",
            title=f"{case.data}, {case.bones} bones, {case.influences} influences",
        )
        plain_log_ticks(axis)
    for axis in axes[-1]:
        axis.set_xlabel("seconds since the call")
    for axis in axes[:, 0]:
        axis.set_ylabel("E")
    axes.flat[0].legend(fontsize=7)
    save_figure(figure, path)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--effort",
        nargs="*",
        choices=EFFORTS,
        default=["fast", "balanced"],
        help="none: only draw the chart again",
    )
    parser.add_argument("--only", nargs="+", choices=[c.name for c in HERE])
    parser.add_argument("--rng", type=int, default=0, help="seed")
    parser.add_argument("--out", type=Path, default=RESULTS / "accuracy.json")
    parser.add_argument("--chart", type=Path, default=IMAGES / "accuracy.png")
    args = parser.parse_args()
    old = json.loads(args.out.read_text())["rows"] if args.out.exists() else []
    rows = {(row["case"], row["effort"]): row for row in old}
    frames, _ = load("fox")
    ssdr.decompose(frames[:4], bones=2, effort="fast", max_iterations=1)  # kernels ready
    rates = machine()
    for case in HERE:
        if args.only and case.name not in args.only:
            continue
        for effort in args.effort:
            rates = machine()
            row = measure(case, effort, args.rng, rates)
            rows[case.name, effort] = row
            print(
                f"{case.name:16} {effort:9} E {row['E']:8.4f}  {row['wall']:7.2f} s  "
                f"/plain {row['E / plain']:.3f}  /core {row['E / core']:.3f}  "
                f"/peers {row['E / peers']:.3f}  load {rates['load']}",
                flush=True,
            )
            keep(rows, args.out)
    ordered = keep(rows, args.out)
    write_csv(args.out.with_suffix(".csv"), [{k: r[k] for k in COLUMNS} for r in ordered])
    chart(ordered, args.chart)
    print(table(ordered, COLUMNS))
    print(tell(rates))


if __name__ == "__main__":
    main()
