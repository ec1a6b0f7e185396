"""Is a revision as fast as the one before it, at the same error?

    python benchmarks/speed/revisions.py v0.1.0 HEAD
    python benchmarks/speed/revisions.py HEAD . --problems ea_bone:10 samba:20 --effort fast

Both are installed into folders of their own and run in turn, A B A B ..., each call in a fresh
process whose kernels are cached, so that a drift of the machine meets both.  Figures: CPU and
wall seconds of ``decompose`` (compilation left out), their ratio pair by pair, E, and the seconds
of ``import ssdr``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.robustness.same_bits import installed

_PROGRAM = """
import json, sys, time
began = time.perf_counter()
import ssdr
ssdr.decompose
imported = time.perf_counter() - began
import numpy as np
path, bones, effort = sys.argv[1:]
with np.load(path) as archive:
    frames, faces = archive["vertices"], archive["faces"]
ssdr.decompose(frames[:2, :50], bones=2, effort="fast")  # kernels
wall, cpu = time.perf_counter(), time.process_time()
result = ssdr.decompose(frames, faces, bones=int(bones), effort=effort)
out = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, "import": imported}
print(json.dumps(out | {"E": 1000 * result.rmse / 3**0.5}))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("before", nargs="?", default="HEAD", help="a revision, or a folder")
    parser.add_argument("after", nargs="?", default=".", help="a revision, or a folder")
    parser.add_argument(
        "--problems", nargs="+", default=["horse_gallop:20", "samba:20", "ea_bone:10"]
    )
    parser.add_argument("--effort", default="balanced")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--keep", type=Path, help="a folder in which the installations stay")
    parser.add_argument("--out", type=Path, help="a .json for the figures")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.keep or Path(temporary)
        homes = [installed(revision, folder)[1] for revision in (args.before, args.after)]
        figures: dict[str, Any] = {"machine": common.machine()}
        for problem in args.problems:
            name, bones = problem.split(":")
            path = common.data_folder() / f"{name}.npz"
            for home in homes:  # kernels are compiled, files are read once
                call(home, path, "2", "fast")
            pairs = [
                [call(home, path, bones, args.effort) for home in homes] for _ in range(args.pairs)
            ]
            figures[problem] = summary(pairs)
            print(f"{problem:18} {line(figures[problem])}", flush=True)
    print(json.dumps(figures["machine"]))
    if args.out:
        args.out.write_text(json.dumps(figures, indent=1) + "\n")


def call(environment: dict[str, str], path: Path, bones: str, effort: str) -> dict[str, float]:
    command = [sys.executable, "-P", "-c", _PROGRAM, str(path), bones, effort]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout))


def summary(pairs: list[list[dict[str, float]]]) -> dict[str, Any]:
    out: dict[str, Any] = {"pairs": len(pairs)}
    for key in ("cpu", "wall", "import"):
        ratios = [after[key] / before[key] for before, after in pairs]
        out[key] = {
            "before": statistics.median(before[key] for before, _ in pairs),
            "after": statistics.median(after[key] for _, after in pairs),
            "ratio": statistics.median(ratios),
            "least": min(ratios),
            "most": max(ratios),
        }
    out["E"] = [pairs[0][0]["E"], pairs[0][1]["E"]]
    return out


def line(row: dict[str, Any]) -> str:
    parts = [f"E {row['E'][0]:.4f} {row['E'][1]:.4f}"]
    for key in ("cpu", "wall", "import"):
        r = row[key]
        parts.append(
            f"{key} {r['before']:.3g} {r['after']:.3g} s, "
            f"ratio {r['ratio']:.3f} ({r['least']:.3f} to {r['most']:.3f})"
        )
    return "; ".join(parts)


if __name__ == "__main__":
    main()
