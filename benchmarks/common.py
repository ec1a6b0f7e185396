"""What the benchmarks share: data, errors, fresh processes, results that are kept, tables, charts.

A script of a study is its cases and how one of them is measured; ``run`` is its command line.  Each
case is measured in a process of its own, and its row is written at once to a record: what has a row
there is not measured again.  Errors are computed here from the arrays of a model, by code of this
file.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import (
    RESULTS,
    ROOT,
    Record,
    Row,
    load_average,
    machine,
    read_rows,
)

__all__ = ["RESULTS", "ROOT", "Record", "Row", "machine", "read_rows"]

IMAGES = ROOT / "docs" / "images"
EFFORTS = ("fast", "balanced", "best")

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


# --- a script's command line ---------------------------------------------------------------------


def peak_memory(what: str = "VmHWM") -> float:
    """Most MiB that this process held, or the MiB of another line of /proc/self/status."""
    text = Path("/proc/self/status").read_text()
    line = next(line for line in text.splitlines() if line.startswith(what))
    return int(line.split()[1]) / 1024


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


def run(
    script: str,
    doc: str,
    cases: Mapping[str, Row],
    measure: Callable[..., Row],
    columns: Sequence[str],
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
    parser.add_argument("--anew", action="store_true", help="forget the results that there are")
    parser.add_argument("--report", action="store_true", help="the table, no measurement")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--together", type=int, default=1, help="cases measured at a time")
    parser.add_argument(
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="effort=fast: of every case"
    )
    default = out or RESULTS / f"{Path(script).stem}.json"
    parser.add_argument("--out", type=Path, default=default, help="results")
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
    record = Record(args.out) if args.report else Record.open(args.out, anew=args.anew)
    todo = [n for n in names if not args.report and n not in record.rows]
    if check is not None:
        check([cases[names[name]] for name in todo])
    given = vars(own.parse_known_args()[0]).items()
    mine = [word for name, value in given if value for word in (f"--{name}", str(value))]

    def one(name: str) -> None:
        words = [*mine, *(["--set", *args.set] if changes else [])]
        try:
            row = fresh([script, "--case", names[name], *words], threads=args.threads)
        except SystemExit as error:
            if "failed" not in columns:
                raise
            row = {"failed": str(error).rpartition(": ")[2]}
        asked = {"threads": args.threads, "load": load_average(), **cases[names[name]], **changes}
        record.add(name, asked | row)
        print(name, *(f"{k} {_cell(row[k])}" for k in columns if _cell(row.get(k))), flush=True)

    with ThreadPoolExecutor(args.together) as pool:
        for _ in pool.map(one, todo):
            pass
    rows = [{"case": n} | record.rows[n] for n in names if n in record.rows]
    print(table(rows, ["case", *columns]))


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
