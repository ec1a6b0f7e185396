"""What the benchmarks share: data, the machine's rates, errors by plain NumPy, tables, charts.

Errors are computed here from the arrays of a model, by code of this file alone.
"""

from __future__ import annotations

import csv
import functools
import json
import os
import platform
import re
import subprocess
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import threadpoolctl

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
IMAGES = ROOT / "docs" / "images"


def data_folder() -> Path:
    """SSDR_TEST_DATA, else the folder shared/data beside the repository."""
    folder = Path(os.environ.get("SSDR_TEST_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        raise SystemExit(f"no data: {folder} is not a folder; set SSDR_TEST_DATA")
    return folder


def load(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frames (F, V, 3) and faces (T, 3) of one of the sequences."""
    with np.load(data_folder() / f"{name}.npz", allow_pickle=False) as archive:
        return archive["vertices"], archive["faces"]


def _best(function: Callable[[], object], repeats: int) -> float:
    function()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def gemm_rates(n: int = 1024, repeats: int = 4) -> dict[str, float]:
    """float64 matrix products, GFLOP/s: one thread, and one in each of two threads at once."""
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, n, n))
    with threadpoolctl.threadpool_limits(limits=1, user_api="blas"):
        one = _best(lambda: a @ b, repeats)
        with ThreadPoolExecutor(2) as pool:
            both = _best(lambda: list(pool.map(lambda m: m @ b, (a, a))), repeats)
    return {"gemm_1": 2e-9 * n**3 / one, "gemm_2": 4e-9 * n**3 / both}


def memory_bandwidth(megabytes: int = 256, repeats: int = 4) -> float:
    """GB/s of a copy in one thread, bytes read and bytes written."""
    source = np.ones(megabytes << 17)
    target = np.zeros_like(source)
    return 2e-9 * source.nbytes / _best(lambda: np.copyto(target, source), repeats)


def machine() -> dict[str, Any]:
    """What the run's times depend on, measured now."""
    return {
        "cpu": _cpu(),
        "cores": len(os.sched_getaffinity(0)),
        "load": round(os.getloadavg()[0], 2),
        **{key: round(value, 1) for key, value in gemm_rates().items()},
        "memory": round(memory_bandwidth(), 1),
        "revision": revision(),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


@functools.cache
def revision() -> str | None:
    """The commit that is measured, with a plus where the solver has changed since."""
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


revision()  # now: what is imported is what is measured, whatever is committed meanwhile


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def tell(rates: dict[str, Any]) -> str:
    return (
        f"{rates['cpu']}, {rates['cores']} cores, load {rates['load']}; GEMM float64 "
        f"{rates['gemm_1']} GFLOP/s in one thread, {rates['gemm_2']} in two; "
        f"copy {rates['memory']} GB/s"
    )


def reskin(
    rest: np.ndarray, indices: np.ndarray, weights: np.ndarray, transforms: np.ndarray
) -> np.ndarray:
    """Positions (F, V, 3) in float64, one slot of the influences after the other."""
    p = np.asarray(rest, dtype=np.float64)
    m = np.asarray(transforms, dtype=np.float64)
    out = np.zeros((len(m), len(p), 3))
    for k in range(indices.shape[1]):
        w = np.asarray(weights[:, k], dtype=np.float64)
        for t in range(len(m)):
            bone = m[t, indices[:, k]]
            out[t] += w[:, None] * (np.einsum("vij,vj->vi", bone[..., :3], p) + bone[..., 3])
    return out


def error_e(reference: np.ndarray, other: np.ndarray) -> float:
    """E = 1000 ‖A − Ã‖_F / sqrt(3 F V), in the files' own units."""
    difference = np.asarray(reference, dtype=np.float64) - other
    return 1000.0 * float(np.linalg.norm(difference)) / float(np.sqrt(difference.size))


def e_of(frames: np.ndarray, model: Any) -> float:
    """E of a skinned model against the frames, re-skinned here."""
    return error_e(frames, reskin(model.rest, model.indices, model.weights, model.transforms))


def defects(model: Any, bones: int, influences: int) -> list[str]:
    """What is wrong with a model; empty if nothing is."""
    found = []
    if model.transforms.shape[1] != bones:
        found.append(f"{model.transforms.shape[1]} bones, not {bones}")
    if (model.weights > 0).sum(axis=1).max() > influences:
        found.append(f"more than {influences} influences")
    if model.weights.min() < 0 or abs(model.weights.sum(axis=1) - 1).max() > 1e-6:
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


def write_json(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, indent=1, ensure_ascii=False)
    # lists of numbers, and of pairs of them, on one line each
    flat = r"\[(?:[^\[\]{}]|\[[^\[\]{}]*\])*\]"
    text = re.sub(flat, lambda match: re.sub(r"\s+", " ", match.group()), text)
    path.write_text(text + "\n", encoding="utf-8")


def write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def table(rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> str:
    """Rows as a Markdown table."""
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for row in rows:
        cells = [_cell(row.get(column)) for column in columns]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


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
    """Ticks of a logarithmic y axis as plain numbers, also where it spans less than a decade."""
    from matplotlib.ticker import LogLocator

    axis.yaxis.set_major_formatter("{x:g}")
    low, high = axis.get_ylim()
    if low > 0 and high > 1e4 * low:  # the decades alone fill the axis
        return
    axis.yaxis.set_minor_locator(LogLocator(subs=(2, 3, 5)))
    axis.yaxis.set_minor_formatter("{x:g}")


def save_figure(figure: Any, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout()
    # no date and no version of the library: the same figures give the same file
    tight = "tight" if figure.legends else None  # one that stands beside the panels
    figure.savefig(path, metadata={"Software": None}, bbox_inches=tight)
