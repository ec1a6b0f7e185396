"""What the benchmarks share: data, errors, fresh processes, results that are kept, tables, charts.

A script is its cases and how one of them is measured; ``run`` is its command line.  Each case is
measured in a process of its own, beside the machine's rates, and its row is written at once to a
JSON file, ``{"rows": {case: row}}``: what has a row there is not measured again, so that a run can
be stopped and go on.  Errors are computed here from the arrays of a model, by code of this file.
"""

from __future__ import annotations

import argparse
import functools
import importlib.util
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import threadpoolctl

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
IMAGES = ROOT / "docs" / "images"
EFFORTS = ("fast", "balanced", "best")
COLOURS = {"fast": "#e69f00", "balanced": "#0072b2", "best": "#009e73"}

Row = dict[str, Any]

# --- data and errors -----------------------------------------------------------------------------


def data_folders() -> list[Path]:
    """Folders of sequences: that of SSDR_TEST_DATA, else shared/data beside the repository and
    out/data, where leaderboard/fetch.py puts them."""
    if named := os.environ.get("SSDR_TEST_DATA"):
        return [Path(named)]
    return [ROOT.parent / "shared" / "data", ROOT / "out" / "data"]


def data_folder() -> Path:
    """First of the data folders that there is."""
    if found := [folder for folder in data_folders() if folder.is_dir()]:
        return found[0]
    raise SystemExit(f"no data: {data_folders()[0]} is not a folder; set SSDR_TEST_DATA")


def data_file(name: str) -> Path:
    """File of the data folders, by its path in them; the first that there is, or would be."""
    files = [folder / name for folder in data_folders()]
    return next((file for file in files if file.is_file()), files[0])


def sequence_file(name: str) -> Path:
    """File of a sample or of a sequence in the data folders."""
    sample = ROOT / "ssdr" / "io" / "samples" / f"{name}.npz"
    return sample if sample.is_file() else data_file(f"{name}.npz")


def require(names: Iterable[str]) -> None:
    """End with a word about every sequence that is missing, if any is."""
    if missing := sorted({name for name in names if not sequence_file(name).is_file()}):
        raise SystemExit(
            f"no data for {', '.join(missing)}: expected NAME.npz in "
            f"{' or '.join(map(str, data_folders()))}, or where SSDR_TEST_DATA says; "
            "benchmarks/leaderboard/fetch.py --list says what can be fetched"
        )


def require_package(name: str, extra: str) -> None:
    """End with a word where a package is not installed."""
    if importlib.util.find_spec(name) is None:
        raise SystemExit(f'{name} is not installed: pip install ".[{extra}]"')


def load(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frames (F, V, 3) and faces (T, 3) of a sequence in the data folders, or of a sample."""
    require([name])
    with np.load(sequence_file(name)) as archive:
        return archive["vertices"], archive["faces"]


def reskin(
    rest: np.ndarray, indices: np.ndarray, weights: np.ndarray, transforms: np.ndarray
) -> np.ndarray:
    """Positions (F, V, 3) in float64 by linear blend skinning, one influence after the other."""
    p = np.asarray(rest, dtype=np.float64)
    m = np.asarray(transforms, dtype=np.float64)
    out = np.zeros((len(m), len(p), 3))
    for k in range(indices.shape[1]):
        w = np.asarray(weights[:, k], dtype=np.float64)
        for t in range(len(m)):
            bone = m[t, indices[:, k]]
            out[t] += w[:, None] * (np.einsum("vij,vj->vi", bone[..., :3], p) + bone[..., 3])
    return out


def skinned(model: Any) -> np.ndarray:
    return reskin(model.rest, model.indices, model.weights, model.transforms)


def error_e(reference: np.ndarray, other: np.ndarray) -> float:
    """E = 1000 ‖A − Ã‖_F / sqrt(3 F V), in the files' own units."""
    difference = np.asarray(reference, dtype=np.float64) - other
    return 1000.0 * float(np.linalg.norm(difference)) / float(np.sqrt(difference.size))


def e_of(frames: np.ndarray, model: Any) -> float:
    return error_e(frames, skinned(model))


def rmse_of(frames: np.ndarray, model: Any) -> float:
    """Root mean square distance of a vertex."""
    return float(np.sqrt(3)) * e_of(frames, model) / 1000


def defects(model: Any, bones: int, influences: int) -> list[str]:
    """Defects of a model in words."""
    found = []
    if model.transforms.shape[1] != bones:
        found.append(f"{model.transforms.shape[1]} bones, not {bones}")
    if (model.weights > 0).sum(axis=1).max() > influences:
        found.append(f"more than {influences} influences")
    if model.weights.min() < 0 or abs(model.weights.sum(axis=1) - 1).max() > 1e-5:
        found.append("weights not convex")
    r = model.transforms[..., :3]
    if model.bone_model == "similarity":
        r = r / np.linalg.norm(r, axis=(-1, -2), keepdims=True) * np.sqrt(3)
    if model.bone_model == "affine":
        if not (np.linalg.det(r) > 0).all():
            found.append("reflections")
    elif abs(r.swapaxes(-1, -2) @ r - np.eye(3)).max() > 1e-6 or np.linalg.det(r).min() < 0:
        found.append("rotations not orthonormal")
    if not all(np.isfinite(a).all() for a in (model.rest, model.weights, model.transforms)):
        found.append("NaN or Inf")
    return found


def compile_kernels() -> None:
    """Compile or load the solver's kernels, which timings leave out."""
    import ssdr

    ssdr.decompose(np.random.default_rng(0).standard_normal((4, 30, 3)), bones=2, effort="fast")


# --- the machine ---------------------------------------------------------------------------------


def quickest(function: Callable[[], object], repeats: int) -> float:
    """Least seconds of several calls, after one that is not counted."""
    function()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def machine() -> Row:
    """Rates of this machine, measured now.

    GFLOP/s of float64 matrix products in one thread and in two at once, GB/s read and written by a
    copy in one thread, and the load.
    """
    n, repeats = 1024, 4
    a, b = np.random.default_rng(0).standard_normal((2, n, n))
    source = np.ones(1 << 25)
    target = np.zeros_like(source)
    with threadpoolctl.threadpool_limits(limits=1, user_api="blas"):
        one = quickest(lambda: a @ b, repeats)
        with ThreadPoolExecutor(2) as pool:
            both = quickest(lambda: list(pool.map(lambda m: m @ b, (a, a))), repeats)
    copy = quickest(lambda: np.copyto(target, source), repeats)
    return {
        "cpu": _cpu(),
        "cores": len(os.sched_getaffinity(0)),
        "load": round(os.getloadavg()[0], 2),
        "gemm_1": round(2e-9 * n**3 / one, 1),
        "gemm_2": round(4e-9 * n**3 / both, 1),
        "memory": round(2e-9 * source.nbytes / copy, 1),
        "revision": revision(),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


@functools.cache
def revision() -> str | None:
    """Commit that is measured, with a plus if the package has been changed since."""
    try:
        head, changed = (
            subprocess.run(
                ["git", *command], cwd=ROOT, capture_output=True, text=True, check=True
            ).stdout.strip()
            for command in (("rev-parse", "--short", "HEAD"), ("status", "-s", "-uno", "ssdr"))
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return head + ("+" if changed else "")


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def tell(rates: Row) -> str:
    return (
        f"{rates['cpu']}, {rates['cores']} cores, load {rates['load']}; GEMM float64 "
        f"{rates['gemm_1']} GFLOP/s in one thread, {rates['gemm_2']} in two; "
        f"copy {rates['memory']} GB/s"
    )


def peak_memory(what: str = "VmHWM") -> float:
    """Most MiB that this process held, or the MiB of another line of /proc/self/status."""
    text = Path("/proc/self/status").read_text()
    line = next(line for line in text.splitlines() if line.startswith(what))
    return int(line.split()[1]) / 1024


# --- a script's command line ---------------------------------------------------------------------


def fresh(
    words: Sequence[str], *, threads: int = 1, python: str = sys.executable, **environment: str
) -> Row:
    """Run Python in a new process; returns its last line of output, which is JSON."""
    counts = ("SSDR_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    settings = {"PYTHONPATH": str(ROOT), **dict.fromkeys(counts, str(threads)), **environment}
    done = subprocess.run(
        [python, *words], env=os.environ | settings, stdout=subprocess.PIPE, text=True
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: ended with status {done.returncode}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def read_rows(path: Path) -> dict[str, Row]:
    """Rows of a results file by case; none where there is no file."""
    return dict(json.loads(path.read_text("utf-8"))["rows"]) if path.is_file() else {}


def write_rows(path: Path, rows: Mapping[str, Row]) -> None:
    write_json(path, {"rows": rows})


def write_json(path: Path, content: Any) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, indent=1, ensure_ascii=False)
    # lists of numbers, and of pairs of them, on one line each
    flat = r"\[(?:[^\[\]{}]|\[[^\[\]{}]*\])*\]"
    text = re.sub(flat, lambda match: re.sub(r"\s+", " ", match.group()), text)
    part = path.with_suffix(".part")
    part.write_text(text + "\n", encoding="utf-8")
    part.replace(path)


def run(
    script: str,
    doc: str,
    cases: Mapping[str, Row],
    measure: Callable[..., Row],
    columns: Sequence[str],
    chart: Callable[[dict[str, Row], Path], None] | None = None,
    *,
    check: Callable[[list[Row]], None] | None = None,
    out: Path | None = None,
    own: argparse.ArgumentParser | None = None,
) -> None:
    """Measure the cases that the command line names, keep their rows, and report.

    A case is the arguments of ``measure``, in a process of its own, whose death ends the command
    unless a column is "failed".  `check` may end it before; `own` has the options of the cases.
    """
    own = own or argparse.ArgumentParser(add_help=False)
    parser = argparse.ArgumentParser(description=doc.splitlines()[0], parents=[own])
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="cases whose name contains one")
    parser.add_argument("--again", action="store_true", help="also cases that have a result")
    parser.add_argument("--report", action="store_true", help="table and chart, no measurement")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument(
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="effort=fast: of every case"
    )
    default = out or RESULTS / f"{Path(script).stem}.json"
    parser.add_argument("--out", type=Path, default=default, help="results")
    parser.add_argument("--images", type=Path, default=IMAGES, help="folder of the charts")
    parser.add_argument("--case", help=argparse.SUPPRESS)  # measure one case in this process
    args = parser.parse_args()
    pairs = (pair.split("=", 1) for pair in args.set)
    changes = {k: int(v) if v.isdecimal() else v for k, v in pairs}
    if args.case:
        print(json.dumps(measure(**cases[args.case] | changes)))
        return
    only = args.only or [""]
    names = {" ".join([c, *args.set]): c for c in cases if any(text in c for text in only)}
    if not names:
        raise SystemExit(f"--only: no case contains {' or '.join(only)}; there are: {[*cases]}")
    rows = read_rows(args.out)
    todo = [n for n in names if not args.report and (args.again or n not in rows)]
    if check is not None:
        check([cases[names[name]] for name in todo])
    given = vars(own.parse_known_args()[0]).items()
    mine = [word for name, value in given if value for word in (f"--{name}", str(value))]
    for name in todo:
        case, rates = names[name], machine()
        words = [*mine, *(["--set", *args.set] if changes else [])]
        try:
            row = fresh([script, "--case", case, *words], threads=args.threads)
        except SystemExit as error:
            if "failed" not in columns:
                raise
            row = {"failed": str(error).rpartition(": ")[2]}
        rows[name] = {"threads": args.threads, "machine": rates, **cases[case], **changes, **row}
        write_rows(args.out, rows)
        print(name, *(f"{k} {_cell(row[k])}" for k in columns if _cell(row.get(k))), flush=True)
    if chart is not None and importlib.util.find_spec("matplotlib"):
        chart({case: rows[case] for case in cases if case in rows}, args.images)
    print(table([{"case": n} | rows[n] for n in names if n in rows], ["case", *columns]))


def table(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Rows as a Markdown table."""
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for row in rows:
        cells = [_cell(row.get(column)) for column in columns]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(value: Any) -> str:
    if value is None or isinstance(value, list | dict):
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


# --- charts --------------------------------------------------------------------------------------


def pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "figure.dpi": 100,
            "font.size": 9,
            "axes.grid": True,
            "grid.alpha": 0.3,
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    )
    return plt


def plain_log_ticks(axis: Any) -> None:
    """Label a logarithmic y axis with plain numbers, also where it spans less than a decade."""
    from matplotlib.ticker import LogLocator

    axis.yaxis.set_major_formatter("{x:g}")
    low, high = axis.get_ylim()
    if low > 0 and high > 1e4 * low:  # labels of the decades are enough
        return
    axis.yaxis.set_minor_locator(LogLocator(subs=(2, 3, 5)))
    axis.yaxis.set_minor_formatter("{x:g}")


def number_ticks(axis: Any, values: Iterable[float]) -> None:
    """Label a logarithmic x axis with these numbers alone."""
    ticks = sorted(set(values))
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_xticks([], minor=True)


def save_figure(figure: Any, path: Path, *, tight: bool = True) -> None:
    """Write a picture without date and version, so that the same figures give the same file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if tight:
        figure.tight_layout()
    # a legend of the figure stands outside the panels
    beside = "tight" if tight and figure.legends else None
    figure.savefig(path, metadata={"Software": None}, bbox_inches=beside)
    pyplot().close(figure)
