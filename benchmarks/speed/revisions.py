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
those of the first call, which compiles.  Ratios are after over before, pair by pair.
"""

from __future__ import annotations

import argparse
import hashlib
import json
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
from benchmarks.accuracy.parsimony import SCENES
from benchmarks.common import Row
from benchmarks.peers.race import CASES

# Calls what all revisions have, or `smallest` where a revision has it.
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
ssdr.decompose(frames[:20], bones=2, effort="fast")
wall, cpu = time.perf_counter(), time.process_time()
options = {"effort": problem["effort"], "rng": problem["seed"]}
if not problem["size"].endswith("%"):
    result = ssdr.decompose(frames, faces, bones=int(problem["size"]), **options)
elif hasattr(ssdr, "smallest"):
    result = ssdr.smallest(frames, faces, tolerance=problem["size"], **options)
else:
    result = ssdr.decompose(frames, faces, tolerance=problem["size"], **options)
out = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
out |= {"import": imported - began, "kernels": wall - loading}
gone = np.asarray(result.skinning.skin(), dtype=np.float64) - frames
out["E"] = 1000 * float(np.sqrt((gone**2).mean()))
out["bones found"] = result.skinning.n_bones
out["bytes"] = result.parsimony.size.total if problem["size"].endswith("%") else 0
print(json.dumps(out))
"""
MEASURES = ("E", "cpu", "wall", "import", "kernels", "bones found", "bytes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("before", help="a revision, or a folder")
    parser.add_argument("after", nargs="?", default=".", help="a revision, or a folder")
    parser.add_argument(
        "--problems", nargs="+", default=[], metavar="NAME:SIZE", help="SIZE: bones, or 0.5%%"
    )
    parser.add_argument("--race", action="store_true", help="the sequences of the race")
    parser.add_argument("--scenes", action="store_true", help="the scenes of parsimony.py")
    parser.add_argument("--effort", default="balanced", choices=common.EFFORTS)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--seeds", action="store_true", help="another seed for each pair")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path, help="results (.json); what it holds is not run again")
    args = parser.parse_args()
    problems = list(args.problems)
    problems += [f"{name}:{bones}" for name, bones in CASES] if args.race else []
    problems += [f"{name}:{tolerance}" for name, (_, tolerance, _) in SCENES.items()] * args.scenes
    problems = problems or ["horse_gallop:20", "samba:20", "ea_bone:10"]
    rows = common.read_rows(args.out) if args.out else {}
    rates = common.machine()
    print(common.tell(rates), flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        homes = [copied(name, folder) for name in (args.before, args.after)]
        for problem in (p for p in problems if p not in rows):
            name, size = problem.rsplit(":", 1)
            job = {"path": str(path_of(name, folder)), "size": size, "effort": args.effort}
            job |= {"threads": args.threads, "seed": 0}
            first = [solve(home, job | {"size": "2", "effort": "fast"}) for home in homes]
            seeds = [k * args.seeds for k in range(args.pairs)]
            pairs = [[solve(home, job | {"seed": seed}) for home in homes] for seed in seeds]
            rows[problem] = summary(pairs) | {
                "sequence": name, "bones": size, "effort": args.effort, "threads": args.threads,
                "revisions": [args.before, args.after], "pairs": args.pairs, "machine": rates,
                "first call": [side["import"] + side["kernels"] for side in first],
            }  # fmt: skip
            print(f"{problem:24} {line(rows[problem])}", flush=True)
            if args.out:
                common.write_rows(args.out, rows)
    for key in MEASURES:
        ratios = [rows[problem][key]["ratio"] for problem in problems]
        print(f"{key:11} median {statistics.median(ratios):.4f}, most {max(ratios):.4f}")
    before, after = rows[problems[0]]["first call"]
    print(f"import and kernels, nothing compiled: {before:.1f} s -> {after:.1f} s")


def copied(revision: str, folder: Path) -> Path:
    """Folder with a copy of the package at a revision, or from a working folder."""
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


def path_of(name: str, folder: Path) -> Path:
    """File with the frames of a problem, written where there is none."""
    path = common.data_folder() / f"{name}.npz"
    made = folder / f"{name}.npz"
    if not path.exists() and not made.exists():
        np.savez(made, **made_problem(name))
    return path if path.exists() else made


def made_problem(name: str) -> dict[str, np.ndarray]:
    import ssdr
    from helpers.motions import cloth, wings

    if name in SCENES:
        return {"vertices": SCENES[name][0]()}
    if name == "llama":
        model = ssdr.load_skinning(common.data_folder() / "gltf" / "Llama.gltf")
        frames, faces = model.skin(), model.faces
    elif name in ("wings", "sheet"):
        frames, faces = wings(120, 41, 9) if name == "wings" else cloth(120, 24)
    else:
        frames, faces = common.load(name)
    return {"vertices": frames.astype(np.float32), "faces": faces}


def solve(home: Path, job: Row) -> Row:
    # -P: the working folder must not come before that of the revision
    places = {"PYTHONPATH": str(home), "NUMBA_CACHE_DIR": str(home / "numba")}
    return common.fresh(["-P", "-c", PROGRAM, json.dumps(job)], threads=job["threads"], **places)


def summary(pairs: list[list[Row]]) -> Row:
    """Medians of both sides, and median, least and most of the ratios."""
    out: Row = {}
    for key in MEASURES:
        ratios = [(b[key] / a[key]) if a[key] > 1e-9 else 1.0 for a, b in pairs]
        out[key] = {
            "before": statistics.median(a[key] for a, _ in pairs),
            "after": statistics.median(b[key] for _, b in pairs),
            "ratio": statistics.median(ratios), "least": min(ratios), "most": max(ratios),
        }  # fmt: skip
    return out


def line(row: dict[str, Any]) -> str:
    """Both sides in words; bones and bytes only where they differ."""
    return "; ".join(
        f"{key} {r['before']:.4g} -> {r['after']:.4g}, "
        f"ratio {r['ratio']:.3f} ({r['least']:.3f} to {r['most']:.3f})"
        for key, r in ((key, row[key]) for key in MEASURES)
        if key not in ("bones found", "bytes") or r["least"] != 1 or r["most"] != 1
    )


if __name__ == "__main__":
    main()
