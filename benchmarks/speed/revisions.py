"""Is a revision as fast as the one before it, at the same error?

    python benchmarks/speed/revisions.py v0.1.0 HEAD
    python benchmarks/speed/revisions.py HEAD . --problems ea_bone:10 samba:20 --effort fast
    python benchmarks/speed/revisions.py v0.1.0 . --race --seeds --chart docs/images/revisions.png

Both are installed into folders of their own and run in turn, A B A B ..., each call in a fresh
process whose kernels are cached, so that a drift of the machine meets both.  Figures: CPU and
wall seconds of ``decompose`` (compilation left out), their ratio pair by pair, E, and the seconds
of ``import ssdr``.  With ``--seeds`` every pair has a seed of its own, and E's ratio is that of
the pairs; "E at equal time" compares both when the faster one ended.  Problems are sequences of the
data folder, and small ones: `llama` (all its clips), and two made sheets of 369 and 576 vertices,
`wings` and `sheet`.
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

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

import ssdr
from benchmarks import common
from benchmarks.peers.race import CASES
from benchmarks.robustness.same_bits import installed

_PROGRAM = """
import json, sys, time
began = time.perf_counter()
import ssdr
ssdr.decompose
imported = time.perf_counter() - began
import numpy as np
path, bones, effort, seed = sys.argv[1:]
with np.load(path) as archive:
    frames, faces = archive["vertices"], archive["faces"]
ssdr.decompose(frames[:2, :50], bones=2, effort="fast")  # kernels
wall, cpu = time.perf_counter(), time.process_time()
result = ssdr.decompose(frames, faces, bones=int(bones), effort=effort, rng=int(seed))
out = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, "import": imported}
out["history"] = [[h.elapsed, 1000 * h.rmse / 3**0.5] for h in result.history]
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
    parser.add_argument("--race", action="store_true", help="the problems of the race")
    parser.add_argument("--seeds", action="store_true", help="a seed for each pair")
    parser.add_argument("--chart", type=Path, help="error over time of the first pairs, a picture")
    parser.add_argument("--keep", type=Path, help="a folder in which the installations stay")
    parser.add_argument("--out", type=Path, help="a .json for the figures; what is there stays")
    args = parser.parse_args()
    problems = [f"{name}:{bones}" for name, bones in CASES] if args.race else args.problems
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.keep or Path(temporary)
        homes = [installed(revision, folder)[1] for revision in (args.before, args.after)]
        figures: dict[str, Any] = {"machine": common.machine()}
        if args.out and args.out.is_file():
            figures |= json.loads(args.out.read_text("utf-8"))
        for problem in (p for p in problems if p not in figures):
            name, bones = problem.split(":")
            path = _path(name, folder)
            for home in homes:  # kernels are compiled, files are read once
                call(home, path, "2", "fast")
            pairs = [
                [call(home, path, bones, args.effort, k * args.seeds) for home in homes]
                for k in range(args.pairs)
            ]
            figures[problem] = summary(pairs)
            print(f"{problem:18} {line(figures[problem])}", flush=True)
            if args.out:
                common.write_json(args.out, figures)
    over = {k: statistics.median(figures[p][k]["ratio"] for p in problems) for k in ("wall", "E")}
    print(f"median over the problems: wall {over['wall']:.3f}, E {over['E']:.4f}")
    print(json.dumps(figures["machine"]))
    if args.chart:
        chart({p: figures[p] for p in problems}, args.chart)


def _path(name: str, folder: Path) -> Path:
    """Where a problem's frames and faces lie; small ones are written first."""
    from helpers.motions import cloth, wings

    path = common.data_folder() / f"{name}.npz"
    if path.exists():
        return path
    if name == "llama":
        source = common.data_folder() / "gltf" / "Llama.gltf"
        model = ssdr.load_skinning(source)
        frames, faces = model.skin(), model.faces
    else:
        frames, faces = {
            "wings": lambda: wings(120, 41, 9),
            "sheet": lambda: cloth(120, 24),
        }[name]()
    path = folder / f"{name}.npz"
    np.savez(path, vertices=frames.astype(np.float32), faces=faces)
    return path


def call(
    environment: dict[str, str], path: Path, bones: str, effort: str, seed: int = 0
) -> dict[str, Any]:
    command = [sys.executable, "-P", "-c", _PROGRAM, str(path), bones, effort, str(seed)]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout))


def summary(pairs: list[list[dict[str, float]]]) -> dict[str, Any]:
    out: dict[str, Any] = {"pairs": len(pairs)}
    for key in ("cpu", "wall", "import", "E"):
        ratios = [after[key] / before[key] for before, after in pairs]
        out[key] = {
            "before": statistics.median(before[key] for before, _ in pairs),
            "after": statistics.median(after[key] for _, after in pairs),
            "ratio": statistics.median(ratios),
            "least": min(ratios),
            "most": max(ratios),
        }
    ratios = [_at_equal_time(before, after) for before, after in pairs]
    out["E at equal time"] = {
        "ratio": statistics.median(ratios),
        "least": min(ratios),
        "most": max(ratios),
    }
    out["history"] = [side["history"] for side in pairs[0]]
    return out


def _at_equal_time(before: dict[str, Any], after: dict[str, Any]) -> float:
    """Ratio of the errors of both at the moment when the faster one ended."""
    moment = min(before["wall"], after["wall"])
    ends = [
        min(error for seconds, error in side["history"] if seconds <= moment)
        for side in (before, after)
    ]
    return ends[1] / ends[0]


def chart(figures: dict[str, Any], path: Path) -> None:
    """E over the seconds of a call, a panel for each problem; the first pair of each."""
    plt = common.pyplot()
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    columns = min(3, len(figures))
    rows = -(-len(figures) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.4 * columns, 3.0 * rows), squeeze=False)
    for axis, (problem, row) in zip(axes.flat, figures.items(), strict=False):
        for history, style, name in zip(
            row["history"], ("C7--", "C0-"), ("before", "after"), strict=True
        ):
            seconds, error = zip(*history, strict=True)
            axis.step(seconds, error, style, where="post", label=name)
            axis.plot(seconds[-1], error[-1], style[:2] + "o", markersize=4)
        axis.set_title(problem.replace(":", ", ") + " bones")
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
        axis.yaxis.set_major_locator(MaxNLocator(4))
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_formatter("{x:g}")
            side.set_minor_formatter(NullFormatter())
        axis.set_xlabel("seconds")
        axis.set_ylabel("E")
    axes[0, 0].legend(fontsize=8)
    common.save_figure(figure, path)


def line(row: dict[str, Any]) -> str:
    parts = []
    for key in ("E", "cpu", "wall", "import"):
        r = row[key]
        parts.append(
            f"{key} {r['before']:.4g} {r['after']:.4g}, "
            f"ratio {r['ratio']:.3f} ({r['least']:.3f} to {r['most']:.3f})"
        )
    return "; ".join(parts)


if __name__ == "__main__":
    main()
