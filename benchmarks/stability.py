"""Input on which decompositions are known to fail: what comes of each case.

    python benchmarks/stability.py --out out/stability

Writes stability.csv and stability.json: the case, what happened (or the error's text), the
relative error, that of the undisturbed problem and the bound that it had to keep.  The table of
cases is the one that the tests run, tests/stability_cases.py.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stability_cases import CASES, run


def number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/stability"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    print(f"{'case':42} {'error':>9} {'undist.':>9} {'bound':>9}  outcome")
    for case in CASES:
        began = time.perf_counter()
        outcome = run(case)
        row = dataclasses.asdict(outcome) | {
            "passed": outcome.passed,
            "seconds": round(time.perf_counter() - began, 3),
        }
        rows.append(row)
        figures = [number(v) for v in (outcome.figure, outcome.undisturbed, outcome.bound)]
        print(
            f"{case.name:42} {figures[0]:>9} {figures[1]:>9} {figures[2]:>9}  "
            f"{'' if outcome.passed else 'FAILED '}{outcome.outcome}",
            flush=True,
        )
    (out / "stability.json").write_text(json.dumps(rows, indent=1) + "\n")
    with (out / "stability.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    failed = sum(not row["passed"] for row in rows)
    print(f"{len(rows) - failed} of {len(rows)} cases as they should be")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
