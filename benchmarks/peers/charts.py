"""Charts of the record of bench.py."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import bench
from benchmarks.common import (
    RESULTS,
    Row,
    number_ticks,
    plain_log_ticks,
    pyplot,
    read_rows,
    save_figure,
)
from benchmarks.peers.tables import WITHIN, find, kind_rows, race_rows, sweeps

KIB = 1024
STYLE = {
    "dembones default": ("Dem Bones, default", "#cc79a7", "-"),
    "dembones 0": ("Dem Bones, regularisers 0", "#d55e00", "-"),
    "2012": ("SSDR 2012", "0.45", "-"),
    "ssdr fast": ("ssdr fast", "#e69f00", "-"),
    "ssdr balanced": ("ssdr balanced", "#0072b2", "-"),
    "ssdr best": ("ssdr best", "#009e73", "-"),
    bench.FREE: ("ssdr balanced, rest pose free", "#0072b2", "--"),
    "published": ("published by Dem Bones' authors", "black", ""),
    "pca": ("PCA of the trajectories", "0.6", "--"),
}
OWN = ("black", "#882255", "#56b4e9")  # colours of solvers of one's own
KINDS = {"rigid": "#0072b2", "similarity": "#e69f00", "affine": "#d55e00"}
Rows = Mapping[str, Row]


def draw(rows: Rows, images: Path, own: Iterable[str] = ()) -> None:
    """Draw every chart that the rows allow."""
    if cases := race_rows(rows, own):
        race_chart(rows, cases, images / "race.png", own)
    if all(rows.get(f"{name}-0 K0 pca", {}).get("pca") for name in bench.FRONT):
        size_chart(rows, images / "size.png")
        bones_chart(rows, images / "bones.png")
    if any(row["rigid"] for row in kind_rows(rows)) and not own:
        kinds_chart(rows, images / "bone_models.png")
    if line := sweeps(rows):
        scaling_chart(line, images / "scaling.png")
    if smooth := [r for r in rows.values() if r["solver"].startswith("smooth") and "E" in r]:
        smooth_chart(smooth, images / "smooth.png")


def plain_x(axis: Any) -> None:
    """Give a logarithmic x axis at least a decade and plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axis.get_xlim()
    if 0 < high < 12 * low:
        middle = (low * high) ** 0.5
        axis.set_xlim(middle / 12**0.5, middle * 12**0.5)
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())


def race_chart(rows: Rows, cases: list[Row], path: Path, own: Iterable[str]) -> None:
    """Error over CPU time, a panel a case, every iteration a point; below, what comes before."""
    columns = min(3, len(cases))
    lines = -(-len(cases) // columns)
    figure = pyplot().figure(figsize=(4 * columns + 0.5, 3.3 * lines + 1.6))
    grid = figure.add_gridspec(lines + 1, columns, height_ratios=[1.0] * lines + [0.4])
    handles: dict[str, Any] = {}
    mine = {name: (name, colour, "-") for name, colour in zip(own, OWN, strict=False)}
    for k, case in enumerate(cases):
        axis = figure.add_subplot(grid[k // columns, k % columns])
        name = case["sequence"], case["bones"]
        for solver, (label, colour, line) in (STYLE | mine).items():
            run = find(rows, solver, *name)
            if published := find(rows, solver, *name, 8) if solver == "published" else None:
                handles[label] = axis.axhline(
                    published["E"], color=colour, linewidth=0.8, linestyle=(0, (1, 3))
                )
            if run is not None and (points := [(cpu, e) for _, _, cpu, e in run["curve"] if cpu]):
                size = 6 if len(points) == 1 else 2
                axis.plot(
                    *np.array(points).T, color=colour, linestyle=line, marker="o",
                    linewidth=0.8, markersize=size,
                )  # fmt: skip
                handles[label] = axis.lines[-1]
        if "peer" in case:
            handles["1 % above Dem Bones' best"] = axis.axhline(
                WITHIN * case["peer"]["E"], color="#d55e00", linewidth=0.6, linestyle="--"
            )
        axis.set(xscale="log", yscale="log", title="{}, {} bones".format(*name))
        axis.grid(which="minor", alpha=0.12)
        plain_log_ticks(axis)
        plain_x(axis)
        if k % columns == 0:
            axis.set_ylabel("E")
        if k + columns >= len(cases):
            axis.set_xlabel("CPU seconds since the call")
    waits_chart(figure.add_subplot(grid[lines, :]))
    labels = [*handles]
    # the legend stands in a strip above the panels, as high as its lines
    ncols = 4 if columns == 3 else columns
    strip = 0.15 + 0.17 * -(-len(labels) // ncols)
    figure.set_figheight(figure.get_figheight() + strip)
    figure.legend(
        [handles[label] for label in labels], labels, loc="upper center", ncols=ncols, fontsize=8,
        frameon=False, bbox_to_anchor=(0.5, 1.0),
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0, 1, 1 - strip / figure.get_figheight()))
    save_figure(figure, path, tight=False)


def waits_chart(axis: Any) -> None:
    """Seconds before the first call of a process, by first_call.py."""
    calls = read_rows(RESULTS / "first_call.json")
    found = {
        "import": ("import ssdr", "process"),
        "kernels from the cache": ("first call, kernels cached", "kernels"),
        "kernels compiled, once a machine": ("first call, nothing compiled", "kernels"),
    }
    bars = [(what, calls[case][key]) for what, (case, key) in found.items() if case in calls]
    axis.barh(range(len(bars)), [max(seconds, 1e-3) for _, seconds in bars], color="0.8")
    for k, (what, seconds) in enumerate(bars):
        axis.text(1.1e-3, k, f"ssdr: {what}, {seconds:.2g} s", va="center", fontsize=8)
    axis.set_yticks([])
    axis.invert_yaxis()
    axis.set(xscale="log", xlim=(1e-3, 100))
    axis.set_title("seconds before the first call, not in the curves")
    axis.tick_params(labelsize=7)


def panels(
    rows: Rows, height: int, tall: float
) -> tuple[Any, np.ndarray, list[tuple[int, str, list[Row]]]]:
    """A figure with a column for each sequence: its number, name, and rows of its grid."""
    figure, axes = pyplot().subplots(
        height, len(bench.FRONT), figsize=(5.5 * len(bench.FRONT), tall), squeeze=False
    )
    grid = [(b, k) for b in bench.GRID[0] for k in bench.GRID[1]]
    mine = [
        (column, name, [r for at in grid if (r := find(rows, "ssdr balanced", name, *at))])
        for column, name in enumerate(bench.FRONT)
    ]
    return figure, axes, mine


def size_chart(rows: Rows, path: Path) -> None:
    """Error over bytes: ours over bones and influences, others at their bones, PCA as a line."""
    figure, axes, columns = panels(rows, 1, 4)
    for column, name, grid in columns:
        axis = axes[0, column]
        label, colour, line = STYLE["pca"]
        pca = rows[f"{name}-0 K0 pca"]["pca"]
        axis.plot([p[1] / KIB for p in pca], [p[2] for p in pca], line, color=colour, label=label)
        raced = [r for r in rows.values() if r["sequence"] == name and "E8" in r]
        for bits, fill in ((8, "full"), (16, "none")):
            label, colour, _ = STYLE["ssdr balanced"]
            front = front_of([(r[f"bytes{bits}"] / KIB, r[f"E{bits}"]) for r in grid])
            if front:
                axis.plot(
                    *np.array(front).T, "o-", color=colour, fillstyle=fill, markersize=4,
                    linewidth=0.8, label=f"{label}, weights of {bits} bits",
                )  # fmt: skip
            for solver in ("dembones default", "dembones 0", "2012", "published", "ssdr best"):
                label, colour, _ = STYLE[solver]
                if runs := [r for r in raced if r["solver"] == solver]:
                    axis.plot(
                        [r[f"bytes{bits}"] / KIB for r in runs], [r[f"E{bits}"] for r in runs], "*",
                        color=colour, fillstyle=fill, label=label if bits == 8 else None,
                    )  # fmt: skip
        sizes = [r["bytes16"] / KIB for r in raced]
        axis.set_xlim(0.7 * min(sizes), 1.5 * max(sizes))
        errors = [r["E16"] for r in raced]
        axis.set(xscale="log", yscale="log", title=name, xlabel="KiB")
        axis.set_ylim(0.6 * min(errors), 1.6 * max(errors))
        plain_log_ticks(axis)
        plain_x(axis)
    axes[0, 0].set_ylabel("E of the stored model")
    legend_below(figure, axes.flat)
    save_figure(figure, path)


def front_of(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Pareto front of points (x, y)."""
    out: list[tuple[float, float]] = []
    for x, y in sorted(points):
        if not out or y < out[-1][1]:
            out.append((x, y))
    return out


def legend_below(figure: Any, axes: Iterable[Any]) -> None:
    """One legend under all panels, of whatever any of these shows."""
    found: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(
        list(found.values()), list(found), loc="upper center", bbox_to_anchor=(0.5, 0.0),
        ncols=4, fontsize=7, frameon=False,
    )  # fmt: skip


def scaling_chart(lines: list[Row], path: Path) -> None:
    figure, axes = pyplot().subplots(1, 3, figsize=(11, 3.6))
    for axis, word in zip(axes, ("frames", "vertices", "bones"), strict=True):
        for row in (r for r in lines if r["over"] == word):
            label, colour, _ = STYLE[row["solver"]]
            name = f"{label}: {word}^{row['exponent']:.2f}"
            axis.plot(*np.array(row["line"]).T, "o-", color=colour, label=name)
        axis.set(xscale="log", yscale="log", xlabel=word)
        plain_log_ticks(axis)
        axis.legend(fontsize=7)
        plain_x(axis)
    axes[0].set_ylabel("CPU seconds of a call")
    save_figure(figure, path)


def kinds_chart(rows: Rows, path: Path) -> None:
    """Error over bytes of transforms, a panel for each sequence."""
    names = [*dict.fromkeys(name for name, _ in bench.STRETCH)]
    figure, axes = pyplot().subplots(1, len(names), figsize=(2.6 * len(names), 3.0))
    for axis, name in zip(axes, names, strict=True):
        for kind, floats in bench.FLOATS.items():
            columns = (kind, f"{kind}, equal bytes")
            every = [row[c] for row in kind_rows(rows) if row["sequence"] == name for c in columns]
            line = sorted({(4 * floats * r["bones"], r["E"]) for r in every if r})
            if line:
                axis.plot(*np.array(line).T, "o-", color=KINDS[kind], label=kind, markersize=4)
        axis.set(yscale="log", title=name, xlabel="bytes of transforms a frame")
        plain_log_ticks(axis)
    axes[0].set_ylabel("E")
    axes[0].legend(fontsize=7)
    save_figure(figure, path)


def bones_chart(rows: Rows, path: Path) -> None:
    """Error over bones for each limit of influences, and over influences."""
    figure, axes, columns = panels(rows, 2, 6.4)
    shades = {1: "#56b4e9", 2: "#e69f00", 4: "#0072b2", 8: "#009e73"}
    for column, name, mine in columns:
        top, low = axes[:, column]
        for k, colour in shades.items():
            line = sorted((r["bones"], r["E"]) for r in mine if r["influences"] == k)
            if line:
                label = f"{k} influence{'s' * (k > 1)}"
                top.plot(*np.array(line).T, "o-", color=colour, label=label)
        for b in sorted({r["bones"] for r in mine}):
            line = sorted((r["influences"], r["E"]) for r in mine if r["bones"] == b)
            low.plot(*np.array(line).T, "o-", label=f"{b} bones")
        for axis, word in ((top, "bones"), (low, "influences")):
            axis.set(xscale="log", yscale="log", xlabel=word)
            number_ticks(axis, [r[word] for r in mine])
            plain_log_ticks(axis)
        top.set_title(name)
    for axis in axes[:, 0]:
        axis.set_ylabel("E")
        axis.legend(fontsize=7)
    save_figure(figure, path)


def smooth_chart(records: list[Row], path: Path) -> None:
    """Smoothness: error on the frames that were fitted, on those that were not, and jumps."""
    cases: dict[str, list[Row]] = {}
    for r in records:
        cases.setdefault(f"{r['sequence']}, {r['bones']} bones", []).append(r)
    figure, axes = pyplot().subplots(1, len(cases), figsize=(4.6 * len(cases), 3.6), squeeze=False)
    for axis, (name, mine) in zip(axes.flat, cases.items(), strict=True):
        line = sorted(
            (float(r["solver"].split()[1]), r["E"], r["E kept out"], r["jump"]) for r in mine
        )
        share, fitted, others, jump = np.array(line).T
        x = np.arange(len(line))
        axis.plot(x, fitted, "o-", color="#0072b2", label="E, frames that were fitted")
        axis.plot(x, others, "s--", color="#d55e00", label="E, frames kept out")
        twin = axis.twinx()
        twin.plot(x, jump, "^:", color="0.5", label="mean jump of weights across an edge")
        twin.set_ylim(0)
        twin.grid(visible=False)
        axis.set_ylim(0)
        axis.set_xticks(x, [f"{s:g}" for s in share])
        axis.set(title=name, xlabel="smoothness, share of the diagonal")
        handles = axis.lines + twin.lines
        axis.legend(handles, [h.get_label() for h in handles], fontsize=7, loc="lower left")
    axes[0, 0].set_ylabel("E")
    twin.set_ylabel("mean jump of weights")
    save_figure(figure, path)
