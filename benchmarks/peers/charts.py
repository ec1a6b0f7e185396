"""Charts of race.py's records."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import (
    RESULTS,
    Row,
    number_ticks,
    plain_log_ticks,
    pyplot,
    read_rows,
    save_figure,
)
from benchmarks.peers.tables import (
    WITHIN,
    by_case,
    front_of,
    level_and_apart,
    only,
    summary,
    sweeps,
)

KIB = 1024
STYLE = {
    "dembones default": ("Dem Bones, default", "#cc79a7", "-"),
    "dembones 0": ("Dem Bones, regularisers 0", "#d55e00", "-"),
    "2012": ("SSDR 2012", "0.45", "-"),
    "ssdr fast": ("ssdr fast", "#e69f00", "-"),
    "ssdr balanced": ("ssdr balanced", "#0072b2", "-"),
    "ssdr best": ("ssdr best", "#009e73", "-"),
    "ssdr balanced free": ("ssdr balanced, rest pose free", "#0072b2", "--"),
    "ssdr balanced similarity": ("ssdr balanced, similarity bones", "#56b4e9", "--"),
    "ssdr balanced affine": ("ssdr balanced, affine bones", "#882255", "--"),
    "ssdr best affine": ("ssdr best, affine bones", "#882255", "-"),
    "published": ("published by Dem Bones' authors", "black", ""),
    "pca": ("PCA of the trajectories", "0.6", "--"),
}


def draw(folder: Path, images: Path) -> None:
    """Draw every chart that the records in a folder of results allow."""
    parts = ("race", "front", "scaling", "choices")
    race, front, scaling, choices = (
        [*read_rows(folder / f"{part}.json").values()] for part in parts
    )
    if level := level_and_apart(race)[0]:
        race_chart(level, images / "race.png", race)
    if front:
        size_chart(front, race, images / "size.png")
        bones_chart(front, images / "bones.png")
    if scaling:
        scaling_chart(sweeps(scaling), images / "scaling.png")
    if smooth := [r for r in choices if r["solver"].startswith("smooth")]:
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


def race_chart(cases: dict[str, list[Row]], path: Path, everything: list[Row]) -> None:
    """Error over time, a panel a case, every iteration a point; below, what comes before."""
    columns = 3
    rows = -(-len(cases) // columns)
    figure = pyplot().figure(figsize=(4 * columns + 0.5, 3.3 * rows + 1.6))
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[1.0] * rows + [0.4])
    handles: dict[str, Any] = {}
    for k, (case, records) in enumerate(cases.items()):
        axis = figure.add_subplot(grid[k // columns, k % columns])
        for solver, (label, colour, line) in STYLE.items():
            runs = [r for r in only(records, solver) if r["seed"] == 0]
            if runs and solver == "published":
                handles[label] = axis.axhline(
                    runs[0]["E"], color=colour, linewidth=0.8, linestyle=(0, (1, 3))
                )
            elif runs:
                # of the thread counts the one that ended first
                curve = min(runs, key=lambda r: r["total wall"])["curve"]
                points = [(wall, e) for _, wall, _, e in curve if wall > 0]
                axis.plot(
                    *np.array(points).T, color=colour, linestyle=line, marker="o",
                    linewidth=0.8, markersize=2,
                )  # fmt: skip
                handles[label] = axis.lines[-1]
        if (row := summary(records)) is not None:
            handles["1 % above Dem Bones' best"] = axis.axhline(
                WITHIN * row["Dem Bones"], color="#d55e00", linewidth=0.6, linestyle="--"
            )
        axis.set(xscale="log", yscale="log", title=case.replace("-", ", ") + " bones")
        axis.grid(which="minor", alpha=0.12)
        plain_log_ticks(axis)
        plain_x(axis)
        if k % columns == 0:
            axis.set_ylabel("E")
        if k + columns >= len(cases):
            axis.set_xlabel("seconds since the call")
    waits_chart(figure.add_subplot(grid[rows, :]), everything)
    labels = [label for label, _, _ in STYLE.values() if label in handles]
    labels += [label for label in handles if label not in labels]
    # the legend stands in a strip above the panels, as high as its lines
    ncols = 4
    strip = 0.15 + 0.17 * -(-len(labels) // ncols)
    figure.set_figheight(figure.get_figheight() + strip)
    figure.legend(
        [handles[label] for label in labels], labels, loc="upper center", ncols=ncols, fontsize=8,
        frameon=False, bbox_to_anchor=(0.5, 1.0),
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0, 1, 1 - strip / figure.get_figheight()))
    save_figure(figure, path, tight=False)


def waits_chart(axis: Any, records: list[Row]) -> None:
    """Seconds before the first call of a process: imports, and kernels loaded or compiled."""
    bars: list[tuple[str, float]] = []
    for solver, name in {"ssdr ": "ssdr", "dembones ": "Dem Bones"}.items():
        waits = [r["waits"] for r in records if r["solver"].startswith(solver) and "waits" in r]
        for key, what in {"import": "import", "kernels": "kernels from the cache"}.items():
            if known := [w[key] for w in waits if key in w]:
                bars.append((f"{name}: {what}", float(np.median(known))))
    cold = read_rows(RESULTS / "first_call.json").get("first call, nothing compiled")
    if cold:
        bars.append(("ssdr: kernels compiled, once a machine", cold["kernels"]))
    axis.barh(range(len(bars)), [max(b[1], 1e-3) for b in bars], color="0.8")
    for k, (what, seconds) in enumerate(bars):
        axis.text(1.1e-3, k, f"{what}, {seconds:.2g} s", va="center", fontsize=8)
    axis.set_yticks([])
    axis.invert_yaxis()
    axis.set(xscale="log", xlim=(1e-3, 100))
    axis.set_title("seconds before the first call, not in the curves")
    axis.tick_params(labelsize=7)


def panels(
    records: list[Row], rows: int, height: float
) -> tuple[Any, np.ndarray, list[tuple[int, str, list[Row]]]]:
    """A figure with a column for each sequence: its number, name and records."""
    names = sorted({r["sequence"] for r in records})
    figure, axes = pyplot().subplots(
        rows, len(names), figsize=(4.2 * len(names), height), squeeze=False
    )
    mine = [(k, n, [r for r in records if r["sequence"] == n]) for k, n in enumerate(names)]
    return figure, axes, mine


def size_chart(front: list[Row], race: list[Row], path: Path) -> None:
    """Error over bytes: ours over bones and influences, peers at their bones, PCA as a line."""
    figure, axes, columns = panels(front, 1, 4)
    ours = ("ssdr balanced", "ssdr best", "ssdr balanced similarity", "ssdr balanced affine")
    for column, name, mine in columns:
        axis, raced = axes[0, column], [r for r in race if r["sequence"] == name]
        label, colour, line = STYLE["pca"]
        pca = next(r["pca"] for r in mine + raced if "pca" in r)
        axis.plot([p[1] / KIB for p in pca], [p[2] for p in pca], line, color=colour, label=label)
        for bits, fill in ((8, "full"), (16, "none")):
            for solver in ours:
                label, colour, _ = STYLE[solver]
                line = front_of(
                    [(r[f"bytes{bits}"] / KIB, r[f"E{bits}"]) for r in only(mine, solver)]
                )
                if line:
                    axis.plot(
                        *np.array(line).T, "o-", color=colour, fillstyle=fill, markersize=4,
                        linewidth=0.8, label=f"{label}, weights of {bits} bits",
                    )  # fmt: skip
            for solver in ("dembones default", "dembones 0", "2012", "published"):
                label, colour, _ = STYLE[solver]
                if runs := only(raced, solver):
                    axis.plot(
                        [r[f"bytes{bits}"] / KIB for r in runs], [r[f"E{bits}"] for r in runs], "*",
                        color=colour, fillstyle=fill, label=label if bits == 8 else None,
                    )  # fmt: skip
        sizes = [r["bytes16"] / KIB for r in mine if "bytes16" in r]
        axis.set_xlim(0.7 * min(sizes), 1.5 * max(sizes))
        errors = [r["E16"] for r in front + race if r["sequence"] == name and r.get("E16")]
        axis.set(xscale="log", yscale="log", title=name, xlabel="KiB")
        axis.set_ylim(0.6 * min(errors), 1.6 * max(errors))
        plain_log_ticks(axis)
        plain_x(axis)
    axes[0, 0].set_ylabel("E of the stored model")
    legend_below(figure, axes.flat)
    save_figure(figure, path)


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


def scaling_chart(rows: list[Row], path: Path) -> None:
    figure, axes = pyplot().subplots(1, 3, figsize=(11, 3.6))
    for axis, word in zip(axes, ("frames", "vertices", "bones"), strict=True):
        for row in (r for r in rows if r["over"] == word):
            label, colour, _ = STYLE[row["solver"]]
            name = f"{label}: {word}^{row['exponent']:.2f}"
            axis.plot(row["size"], row["seconds"], "o-", color=colour, label=name)
        axis.set(xscale="log", yscale="log", xlabel=word)
        plain_log_ticks(axis)
        axis.legend(fontsize=7)
        plain_x(axis)
    axes[0].set_ylabel("seconds of a call")
    save_figure(figure, path)


def bones_chart(front: list[Row], path: Path) -> None:
    """Error over bones for each limit of influences, and over influences."""
    figure, axes, columns = panels(front, 2, 6.4)
    shades = {1: "#56b4e9", 2: "#e69f00", 4: "#0072b2", 8: "#009e73"}
    for column, name, records in columns:
        mine, (top, low) = only(records, "ssdr balanced"), axes[:, column]
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
    cases = by_case(records)
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
        axis.set(
            title=name.replace("-", ", ") + " bones", xlabel="smoothness, share of the diagonal"
        )
        handles = axis.lines + twin.lines
        axis.legend(handles, [h.get_label() for h in handles], fontsize=7, loc="lower left")
    axes[0, 0].set_ylabel("E")
    twin.set_ylabel("mean jump of weights")
    save_figure(figure, path)
