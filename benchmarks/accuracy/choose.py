"""What do more bones and more influences buy, and how much does the seed matter?

    python benchmarks/accuracy/choose.py

On the dancer that ships with the package, effort "balanced": RMSE in millimetres for several
numbers of bones, for several limits of influences (beside a model of eight that is pruned to the
limit), and for several seeds.  The errors are from the model's arrays by plain NumPy.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import (
    IMAGES,
    RESULTS,
    defects,
    e_of,
    machine,
    plain_log_ticks,
    pyplot,
    save_figure,
    table,
    tell,
    write_json,
)

BONES, INFLUENCES, SEEDS = (5, 10, 20, 40, 80), (1, 2, 3, 4, 6, 8), (0, 1, 2, 3, 4)
USUAL_BONES, USUAL_INFLUENCES = 20, 4


def chart(bones: list[dict[str, Any]], influences: list[dict[str, Any]], path: Path) -> None:
    plt = pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4))
    left.plot([r["B"] for r in bones], [r["rmse mm"] for r in bones], "o-", color="#0072b2")
    left.set(xscale="log", yscale="log", xlabel="bones", ylabel="RMSE, mm")
    left.set_xticks([r["B"] for r in bones], [str(r["B"]) for r in bones])
    left.set_xticks([], minor=True)
    k = [r["K"] for r in influences]
    right.plot(k, [r["rmse mm"] for r in influences], "o-", color="#0072b2", label="asked for")
    right.plot(
        k, [r["pruned mm"] for r in influences], "s--", color="#e69f00", label="pruned from 8"
    )
    right.set(xlabel="influences", yscale="log")
    right.legend()
    for axis in (left, right):
        plain_log_ticks(axis)
    save_figure(figure, path)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", default="dancer", choices=ssdr.samples.names())
    parser.add_argument("--out", type=Path, default=RESULTS / "choose.json")
    parser.add_argument("--chart", type=Path, default=IMAGES / "choose.png")
    args = parser.parse_args()
    sequence = ssdr.samples.load(args.sample)
    frames = np.asarray(sequence.vertices)
    ssdr.decompose(frames[:4], bones=2, effort="fast", max_iterations=1)  # kernels ready
    rates = machine()
    known: dict[tuple[int, int, int], tuple[dict[str, Any], Any]] = {}

    def millimetres(model: Any) -> float:
        return float(np.sqrt(3) * e_of(frames, model))  # the sample is in metres

    def run(bones: int, influences: int, seed: int = 0) -> tuple[dict[str, Any], Any]:
        key = bones, influences, seed
        if key not in known:
            result = ssdr.decompose(sequence, bones=bones, influences=influences, rng=seed)
            model = result.skinning
            wrong = defects(model, bones, influences)
            if wrong:
                raise SystemExit(f"{key}: {'; '.join(wrong)}")
            row = {
                "B": bones,
                "K": influences,
                "seed": seed,
                "rmse mm": millimetres(model),
                "s": result.state.progress["elapsed"],
            }
            known[key] = row, model
        return known[key]

    bones = [run(b, USUAL_INFLUENCES)[0] for b in BONES]
    widest = run(USUAL_BONES, max(INFLUENCES))[1]
    influences = [
        run(USUAL_BONES, k)[0] | {"pruned mm": millimetres(widest.prune(k))} for k in INFLUENCES
    ]
    seeds = [run(USUAL_BONES, USUAL_INFLUENCES, s)[0] for s in SEEDS]
    write_json(
        args.out,
        {
            "question": __doc__.splitlines()[0],
            "sample": args.sample,
            "bones": bones,
            "influences": influences,
            "seeds": seeds,
            **rates,
        },
    )
    chart(bones, influences, args.chart)
    for rows in (bones, influences, seeds):
        print(table(rows, list(rows[0])) + "\n")
    print(tell(rates))


if __name__ == "__main__":
    main()
