"""Is a revision as fast and as accurate as another?

    python benchmarks/speed/revisions.py v0.1.0 .                          # three sequences
    python benchmarks/speed/revisions.py v0.1.0 . --race --seeds --pairs 3
    python benchmarks/speed/revisions.py v0.1.0 HEAD --problems ea_bone:10 samba:20 --effort fast
    python benchmarks/speed/revisions.py v0.1.0 . --scenes --pairs 1       # the smallest models

A problem is SEQUENCE:BONES, or SCENE:TOLERANCE for the smallest model that holds a tolerance.
Sequences are files of the data folder, samples of the package, `llama` (all its clips) and two
made sheets, `wings` and `sheet`; scenes are those of accuracy/parsimony.py.

The package of each revision is copied to a folder of its own, with its own cache of kernels. Both
run in turn, before, after, before, after, each call in a fresh process, so that a drift of the
machine meets both.  Measured are E of the skinned model, the CPU and wall seconds of the call
(compilation left out), the seconds before it (`import ssdr`, cached kernels) and, once a revision,
those of the first call, which compiles.  Ratios are after over before, pair by pair.  "E at equal
time" compares both errors at the moment when the faster run ended.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.peers.race import CASES

# Only what both revisions offer under the same name, and what one of them replaces.
PROGRAM = """
import json, sys, time, warnings
began = time.perf_counter()
import ssdr
ssdr.decompose
imported = time.perf_counter()
import numpy as np
problem = json.loads(sys.argv[1])
with np.load(problem["path"]) as archive:
    frames = archive["vertices"]
    faces = archive["faces"] if "faces" in archive else None
warnings.simplefilter("ignore")
loading = time.perf_counter()
ssdr.decompose(frames[:2, :50], bones=2, effort="fast")
wall, cpu = time.perf_counter(), time.process_time()
options = {"effort": problem["effort"], "rng": problem["seed"]}
if not problem["size"].endswith("%"):
    result = ssdr.decompose(frames, faces, bones=int(problem["size"]), **options)
elif hasattr(ssdr, "smallest"):
    result = ssdr.smallest(frames, faces, tolerance=problem["size"], **options)
else:
    result = ssdr.decompose(frames, faces, tolerance=problem["size"], **options)
out = {
    "wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu,
    "import": imported - began, "kernels": wall - loading,
}
gone = np.asarray(result.skinning.skin(), dtype=np.float64) - frames
out["E"] = 1000 * float(np.sqrt((gone**2).mean()))
out["history"] = [[h.elapsed, 1000 * h.rmse / 3**0.5] for h in result.history]
out["bones"] = result.skinning.n_bones
out["bytes"] = ssdr.parsimony.size(result.skinning).total
print(json.dumps(out))
"""
MEASURES = ("E", "cpu", "wall", "import", "kernels", "bones", "bytes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("before", help="a revision, or a folder")
    parser.add_argument("after", nargs="?", default=".", help="a revision, or a folder")
    parser.add_argument(
        "--problems", nargs="+", default=[], metavar="NAME:SIZE", help="SIZE: bones, or 0.5%%"
    )
    parser.add_argument("--race", action="store_true", help="the sequences of the race")
    parser.add_argument("--scenes", action="store_true", help="the scenes of parsimony.py")
    parser.add_argument("--effort", default="balanced", choices=["fast", "balanced", "best"])
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--seeds", action="store_true", help="another seed for each pair")
    parser.add_argument("--out", type=Path, help="results (.json); what it holds is not run again")
    parser.add_argument("--chart", type=Path, help="error over time of the first pairs (.png)")
    args = parser.parse_args()
    problems = list(args.problems)
    problems += [f"{name}:{bones}" for name, bones in CASES] if args.race else []
    problems += scenes() if args.scenes else []
    problems = problems or ["horse_gallop:20", "samba:20", "ea_bone:10"]
    kept = json.loads(args.out.read_text("utf-8")) if args.out and args.out.is_file() else {}
    rows: dict[str, Any] = kept.get("problems", {})
    rates = common.machine()
    print(common.tell(rates), flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        sides = [environment(copied(name, folder)) for name in (args.before, args.after)]
        for problem in (p for p in problems if p not in rows):
            name, size = problem.rsplit(":", 1)
            job = {"path": str(path_of(name, folder)), "size": size, "effort": args.effort}
            first = [solve(side, job | {"size": "2", "effort": "fast"}) for side in sides]
            pairs = [
                [solve(side, job, seed=k * args.seeds) for side in sides] for k in range(args.pairs)
            ]
            rows[problem] = summary(pairs) | {
                "effort": args.effort, "revisions": [args.before, args.after],
                "first call": [side["import"] + side["kernels"] for side in first],
                "machine": rates,
            }  # fmt: skip
            print(f"{problem:24} {line(rows[problem])}", flush=True)
            if args.out:
                common.write_json(args.out, {"problems": rows})
    report([rows[p] for p in problems])
    if args.chart:
        chart({p: rows[p] for p in problems}, args.chart)


def scenes() -> list[str]:
    from benchmarks.accuracy.parsimony import SCENES

    return [f"{name}:{tolerance}" for name, (_, tolerance, _) in SCENES.items()]


def copied(revision: str, folder: Path) -> Path:
    """A folder with the package as it is at a revision, or in a folder now."""
    target = folder / hashlib.sha256(revision.encode()).hexdigest()[:12]
    if Path(revision).is_dir():
        skip = shutil.ignore_patterns("__pycache__")
        shutil.copytree(Path(revision, "ssdr"), target / "ssdr", ignore=skip)
    elif not target.is_dir():
        archive = ["git", "archive", revision, "ssdr"]
        packed = subprocess.run(archive, cwd=common.ROOT, check=True, capture_output=True)
        target.mkdir()
        subprocess.run(["tar", "-xf", "-", "-C", str(target)], input=packed.stdout, check=True)
    return target


def environment(home: Path) -> dict[str, str]:
    """Of a process that imports the package of a folder, and caches its kernels there."""
    return os.environ | {"PYTHONPATH": str(home), "NUMBA_CACHE_DIR": str(home / "numba")}


def path_of(name: str, folder: Path) -> Path:
    """The file with the frames of a problem; what has no file yet is written."""
    path = common.data_folder() / f"{name}.npz"
    made = folder / f"{name}.npz"
    if not path.exists() and not made.exists():
        np.savez(made, **made_problem(name))
    return path if path.exists() else made


def made_problem(name: str) -> dict[str, np.ndarray]:
    import ssdr
    from benchmarks.accuracy.parsimony import SCENES
    from helpers.motions import cloth, wings

    if name in SCENES:
        return {"vertices": SCENES[name][0]()}
    if name in ssdr.samples.names():
        sample = ssdr.samples.load(name)
        return {"vertices": np.asarray(sample.vertices), "faces": sample.faces}
    if name == "llama":
        model = ssdr.load_skinning(common.data_folder() / "gltf" / "Llama.gltf")
        frames, faces = model.skin(), model.faces
    else:
        frames, faces = wings(120, 41, 9) if name == "wings" else cloth(120, 24)
    return {"vertices": frames.astype(np.float32), "faces": faces}


def solve(side: dict[str, str], job: dict[str, Any], seed: int = 0) -> dict[str, Any]:
    # -P: the folder of this script must not come before that of the revision
    command = [sys.executable, "-P", "-c", PROGRAM, json.dumps(job | {"seed": seed})]
    done = subprocess.run(command, env=side, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout))


def summary(pairs: list[list[dict[str, Any]]]) -> dict[str, Any]:
    """Medians of both sides, and of their ratios with the least and the most."""
    out: dict[str, Any] = {"pairs": len(pairs)}
    for key in MEASURES:
        ratios = [(b[key] / a[key]) if a[key] > 1e-9 else 1.0 for a, b in pairs]
        out[key] = {
            "before": statistics.median(a[key] for a, _ in pairs),
            "after": statistics.median(b[key] for _, b in pairs),
            "ratio": statistics.median(ratios), "least": min(ratios), "most": max(ratios),
        }  # fmt: skip
    ratios = [at_equal_time(a, b) for a, b in pairs]
    equal = {"ratio": statistics.median(ratios), "least": min(ratios), "most": max(ratios)}
    return out | {"E at equal time": equal, "history": [side["history"] for side in pairs[0]]}


def at_equal_time(before: dict[str, Any], after: dict[str, Any]) -> float:
    """Ratio of the errors of both at the moment when the faster one ended."""
    moment = min(before["wall"], after["wall"])
    a, b = (
        min((error for seconds, error in side["history"] if seconds <= moment), default=side["E"])
        for side in (before, after)
    )
    return b / a if a > 1e-9 else 1.0


def line(row: dict[str, Any]) -> str:
    parts = []
    for key in MEASURES:
        r = row[key]
        if key in ("bones", "bytes") and r["least"] == r["most"] == 1:
            continue
        parts.append(
            f"{key} {r['before']:.4g} -> {r['after']:.4g}, "
            f"ratio {r['ratio']:.3f} ({r['least']:.3f} to {r['most']:.3f})"
        )
    return "; ".join(parts)


def report(rows: list[dict[str, Any]]) -> None:
    """Over the problems: the median and the worst of the ratios."""
    for key in (*MEASURES, "E at equal time"):
        ratios = [row[key]["ratio"] for row in rows]
        print(f"{key:16} median {statistics.median(ratios):.4f}, most {max(ratios):.4f}")
    before, after = (statistics.median(r["first call"][k] for r in rows[:1]) for k in (0, 1))
    print(f"import and kernels, nothing compiled: {before:.1f} s -> {after:.1f} s")


def chart(rows: dict[str, Any], path: Path) -> None:
    """E over the seconds of a call, a panel for each problem; the first pair of each."""
    plt = common.pyplot()
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    columns = min(3, len(rows))
    height = -(-len(rows) // columns)
    figure, axes = plt.subplots(
        height, columns, figsize=(4.4 * columns, 3.0 * height), squeeze=False
    )
    for axis, (problem, row) in zip(axes.flat, rows.items(), strict=False):
        for history, style, name in zip(
            row["history"], ("C7--", "C0-"), ("before", "after"), strict=True
        ):
            seconds, error = zip(*history, strict=True)
            axis.step(seconds, error, style, where="post", label=name)
            axis.plot(seconds[-1], error[-1], style[:2] + "o", markersize=4)
        axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel="E")
        axis.set_title(problem.replace(":", ", ") + " bones")
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
        axis.yaxis.set_major_locator(MaxNLocator(4))
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_formatter("{x:g}")
            side.set_minor_formatter(NullFormatter())
    axes[0, 0].legend(fontsize=8)
    common.save_figure(figure, path)


if __name__ == "__main__":
    main()
