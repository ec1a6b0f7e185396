"""Charts of race.py's records."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, plain_log_ticks, pyplot, save_figure
from benchmarks.peers.tables import WITHIN, Record, case_of, divide, front_of, least, only, summary

KIB = 1024
STRETCH = ("ssdr balanced similarity", "ssdr balanced affine")
STYLE = {
    "dembones default": ("Dem Bones, default", "#cc79a7", "-"),
    "dembones 0": ("Dem Bones, regularisers 0", "#d55e00", "-"),
    "2012": ("SSDR 2012", "0.45", "-"),
    "ssdr fast": ("ssdr fast", "#e69f00", "-"),
    "ssdr balanced": ("ssdr balanced", "#0072b2", "-"),
    "ssdr best": ("ssdr best", "#009e73", "-"),
    "ssdr balanced fixed": ("ssdr balanced, rest pose fixed", "#0072b2", ":"),
    "ssdr best fixed": ("ssdr best, rest pose fixed", "#009e73", ":"),
    "ssdr balanced similarity": ("ssdr balanced, similarity bones", "#56b4e9", "--"),
    "ssdr balanced affine": ("ssdr balanced, affine bones", "#882255", "--"),
    "ssdr best affine": ("ssdr best, affine bones", "#882255", "-"),
    "published": ("published by Dem Bones' authors", "black", ""),
    "pca": ("PCA of the trajectories", "0.6", "--"),
}


def clock_label(clock: str) -> str:
    return "seconds" if clock == "wall" else "CPU seconds"


def plain_x(axis: Any) -> None:
    """A logarithmic x axis of at least a decade, with plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axis.get_xlim()
    if 0 < high < 12 * low:
        middle = (low * high) ** 0.5
        axis.set_xlim(middle / 12**0.5, middle * 12**0.5)
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())


def draw_curve(axis: Any, record: Record, clock: str, **style: Any) -> None:
    column = 1 if clock == "wall" else 2
    points = [p for p in record["curve"] if p[column] > 0]
    if points:
        axis.plot([p[column] for p in points], [p[3] for p in points], markersize=2, **style)


def race_chart(
    cases: dict[str, list[Record]], path: Path, clock: str, everything: list[Record]
) -> None:
    """Error over time, a panel a case, every iteration a point; below, what comes before."""
    plt = pyplot()
    columns = 3
    rows = -(-len(cases) // columns)
    figure = plt.figure(figsize=(4 * columns + 0.5, 3.3 * rows + 1.6))
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[1.0] * rows + [0.4])
    handles: dict[str, Any] = {}
    for k, (case, records) in enumerate(cases.items()):
        axis = figure.add_subplot(grid[k // columns, k % columns])
        for solver, (label, colour, line) in STYLE.items():
            runs = [r for r in only(records, solver) if r["seed"] == 0]
            if not runs or solver == "pca":
                continue
            if solver == "published":
                handles[label] = axis.axhline(
                    runs[0]["E"], color=colour, linewidth=0.8, linestyle=(0, (1, 3))
                )
                continue
            # the thread count with which it was done first
            run = min(runs, key=lambda r: r["total wall" if clock == "wall" else "total cpu"])
            draw_curve(axis, run, clock, color=colour, linestyle=line, marker="o", linewidth=0.8)
            handles[label] = axis.lines[-1]
        row = summary(case, records)
        if row is not None:
            handles["1 % above Dem Bones' best"] = axis.axhline(
                WITHIN * row["Dem Bones"], color="#d55e00", linewidth=0.6, linestyle="--"
            )
        axis.set(xscale="log", yscale="log", title=case.replace("-", ", ") + " bones")
        axis.grid(which="minor", alpha=0.12)
        plain_log_ticks(axis)
        plain_x(axis)
        if k % columns == 0:
            axis.set_ylabel("E")
        if k // columns == rows - 1 or k + columns >= len(cases):
            axis.set_xlabel(clock_label(clock) + " since the call")
    waits_chart(figure.add_subplot(grid[rows, :]), everything, clock)
    labels = [label for label, _, _ in STYLE.values() if label in handles]
    labels += [label for label in handles if label not in labels]
    # the legend gets a strip of its own above the panels, as high as its lines
    ncols = 4
    strip = 0.15 + 0.17 * -(-len(labels) // ncols)
    figure.set_figheight(figure.get_figheight() + strip)
    figure.legend(
        [handles[label] for label in labels], labels, loc="upper center", ncols=ncols, fontsize=8,
        frameon=False, bbox_to_anchor=(0.5, 1.0),
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0, 1, 1 - strip / figure.get_figheight()))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)


def waits_chart(axis: Any, records: list[Record], clock: str) -> None:
    """Before the first call of a process: imports, and kernels from the cache or compiled."""
    bars: list[tuple[str, float]] = []
    for solver, name in {"ssdr ": "ssdr", "dembones ": "Dem Bones"}.items():
        waits = [r["waits"] for r in records if r["solver"].startswith(solver) and "waits" in r]
        for key, what in {"import": "import", "kernels": "kernels from the cache"}.items():
            seconds = [w.get(f"{key} cpu" if clock == "cpu" else key) for w in waits]
            if known := [s for s in seconds if s is not None]:
                bars.append((f"{name}: {what}", float(np.median(known))))
    first = RESULTS / "first_call.json"
    if first.exists():
        waits = {r["what"]: r for r in json.loads(first.read_text())["waits"]}
        cold = waits.get("first call, nothing compiled")
        if cold:
            bars.append(("ssdr: kernels compiled, once a machine", cold["kernels"]))
    axis.barh(range(len(bars)), [max(b[1], 1e-3) for b in bars], color="0.8")
    for k, (what, seconds) in enumerate(bars):
        axis.text(1.1e-3, k, f"{what}, {seconds:.2g} s", va="center", fontsize=8)
    axis.set_yticks([])
    axis.invert_yaxis()
    axis.set(xscale="log", xlim=(1e-3, 100))
    axis.set_title(clock_label(clock) + " before the first call, not in the curves")
    axis.tick_params(labelsize=7)


def front_chart(records: list[Record], path: Path, clock: str) -> None:
    """Bones × influences × effort: error over size and over time, what nothing beats joined."""
    plt = pyplot()
    names = sorted({r["sequence"] for r in records})
    figure, axes = plt.subplots(2, len(names), figsize=(4.2 * len(names), 7), squeeze=False)
    marks = {1: "v", 2: "s", 4: "o", 8: "D"}
    seconds = f"total {clock}"
    for column, name in enumerate(names):
        mine = [r for r in records if r["sequence"] == name and r.get("E8") is not None]
        for row, key in enumerate(("bytes8", seconds)):
            axis = axes[row, column]
            error, unit = ("E8", KIB) if row == 0 else ("E", 1)
            for r in mine:
                colour = STYLE[r["solver"]][1]
                axis.plot(
                    r[key] / unit,
                    r[error],
                    marks.get(r["influences"], "x"),
                    color=colour,
                    markersize=4,
                )
                if r["influences"] == 4 and r["solver"] == "ssdr balanced":
                    axis.annotate(
                        str(r["bones"]), (r[key] / unit, r[error]), xytext=(4, 3),
                        textcoords="offset points", fontsize=7,
                    )  # fmt: skip
            front = front_of([(r[key] / unit, r[error]) for r in mine])
            axis.step(*np.array(front).T, where="post", color="0.3", linewidth=0.7)
            axis.set(xscale="log", yscale="log", title=name if row == 0 else None)
            axis.set_xlabel("KiB, weights of 8 bits" if row == 0 else clock_label(clock))
            plain_log_ticks(axis)
            plain_x(axis)
        axes[0, column].set_ylabel("E of the stored model" if column == 0 else "")
        axes[1, column].set_ylabel("E" if column == 0 else "")
    for k, mark in marks.items():
        axes[1, 0].plot([], [], mark, color="0.4", label=f"{k} influence" + "s" * (k > 1))
    present = {r["solver"] for r in records if r.get("E8") is not None}
    for solver in (s for s in STYLE if s in present):
        axes[1, 0].plot([], [], "-", color=STYLE[solver][1], label=STYLE[solver][0])
    legend_below(figure, axes[1, :1])
    save_figure(figure, path)
    plt.close(figure)


def size_chart(front: list[Record], race: list[Record], path: Path) -> None:
    """Error over bytes: ours over bones and influences, peers at their bones, PCA as a line."""
    plt = pyplot()
    names = sorted({r["sequence"] for r in front})
    figure, axes = plt.subplots(1, len(names), figsize=(4.2 * len(names), 4), squeeze=False)
    for axis, name in zip(axes.flat, names, strict=True):
        for r in front + race:
            if r["sequence"] == name and r["solver"] == "pca" and "pca" in r:
                label, colour, line = STYLE["pca"]
                size, e = np.array(r["pca"])[:, 1:].T
                axis.plot(size / KIB, e, line, color=colour, label=label)
                break
        for bits, fill in ((8, "full"), (16, "none")):
            for solver in ("ssdr balanced", "ssdr best", *STRETCH):
                label, colour, _ = STYLE[solver]
                runs = only((r for r in front if r["sequence"] == name), solver)
                line = front_of([(r[f"bytes{bits}"] / KIB, r[f"E{bits}"]) for r in runs])
                if line:
                    axis.plot(
                        *np.array(line).T, "o-", color=colour, fillstyle=fill, markersize=4,
                        linewidth=0.8, label=f"{label}, weights of {bits} bits",
                    )  # fmt: skip
            for solver in ("dembones default", "dembones 0", "2012", "published"):
                label, colour, _ = STYLE[solver]
                runs = only((r for r in race if r["sequence"] == name), solver)
                if runs:
                    axis.plot(
                        [r[f"bytes{bits}"] / KIB for r in runs], [r[f"E{bits}"] for r in runs], "*",
                        color=colour, fillstyle=fill, label=label if bits == 8 else None,
                    )  # fmt: skip
        sizes = [r["bytes16"] / KIB for r in front if r["sequence"] == name and "bytes16" in r]
        if sizes:
            axis.set_xlim(0.7 * min(sizes), 1.5 * max(sizes))
        errors = [r["E16"] for r in front + race if r["sequence"] == name and r.get("E16")]
        axis.set(xscale="log", yscale="log", title=name, xlabel="KiB")
        axis.set_ylim(0.6 * min(errors), 1.6 * max(errors))
        plain_log_ticks(axis)
        plain_x(axis)
    axes[0, 0].set_ylabel("E of the stored model")
    legend_below(figure, axes.flat)
    save_figure(figure, path)
    plt.close(figure)


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


def scaling_chart(rows: list[Record], path: Path, clock: str) -> None:
    plt = pyplot()
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6))
    words = {"F": "frames", "V": "vertices", "B": "bones"}
    for axis, (sweep, word) in zip(axes, words.items(), strict=True):
        for solver in ("ssdr balanced", "dembones 0"):
            label, colour, _ = STYLE[solver]
            line = [r for r in rows if r["over"] == sweep and r["solver"] == solver]
            if line:
                name = f"{label}: {word}^{line[0]['exponent']:.2f}"
                axis.plot([r["size"] for r in line], [r["seconds"] for r in line], "o-",
                          color=colour, label=name)  # fmt: skip
        axis.set(xscale="log", yscale="log", xlabel=word)
        plain_log_ticks(axis)
        axis.legend(fontsize=7)
        plain_x(axis)
    axes[0].set_ylabel(clock_label(clock) + " of a call")
    save_figure(figure, path)
    plt.close(figure)


def bones_chart(front: list[Record], path: Path) -> None:
    """Error over bones for each limit of influences, and over influences."""
    plt = pyplot()
    names = sorted({r["sequence"] for r in front})
    figure, axes = plt.subplots(2, len(names), figsize=(4.2 * len(names), 6.4), squeeze=False)
    shades = {1: "#56b4e9", 2: "#e69f00", 4: "#0072b2", 8: "#009e73"}
    for column, name in enumerate(names):
        mine = only((r for r in front if r["sequence"] == name), "ssdr balanced")
        top, low = axes[:, column]
        for k, colour in shades.items():
            line = sorted((r["bones"], r["E"]) for r in mine if r["influences"] == k)
            if line:
                s = "" if k == 1 else "s"
                top.plot(*np.array(line).T, "o-", color=colour, label=f"{k} influence{s}")
        for b in sorted({r["bones"] for r in mine}):
            line = sorted((r["influences"], r["E"]) for r in mine if r["bones"] == b)
            low.plot(*np.array(line).T, "o-", label=f"{b} bones")
        for axis, word in ((top, "bones"), (low, "influences")):
            ticks = sorted({r[word] for r in mine})
            axis.set(xscale="log", yscale="log", xlabel=word)
            axis.set_xticks(ticks, [str(t) for t in ticks])
            axis.set_xticks([], minor=True)
            plain_log_ticks(axis)
        top.set_title(name)
    axes[0, 0].set_ylabel("E")
    axes[1, 0].set_ylabel("E")
    for axis in axes[:, 0]:
        axis.legend(fontsize=7)
    save_figure(figure, path)
    plt.close(figure)


def effort_chart(race: dict[str, list[Record]], path: Path, clock: str) -> None:
    """What the efforts cost and bring, and what a fixed rest pose costs."""
    plt = pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8))
    race = {name: records for name, records in race.items() if only(records, "ssdr balanced")}
    names = list(race)
    for solver in ("ssdr fast", "ssdr balanced", "ssdr best"):
        label, colour, _ = STYLE[solver]
        points = [
            (runs[0][f"total {clock}"], runs[0]["E"] / base)
            for records in race.values()
            if (runs := only(records, solver)) and (base := least(records, "ssdr balanced"))
        ]
        if points:
            left.plot(*np.array(points).T, "o", color=colour, label=label)
    for records in race.values():
        line = [
            (runs[0][f"total {clock}"], runs[0]["E"] / (least(records, "ssdr balanced") or 1))
            for s in ("ssdr fast", "ssdr balanced", "ssdr best")
            if (runs := only(records, s))
        ]
        left.plot(*np.array(line).T, "-", color="0.7", linewidth=0.7, zorder=0)
    left.set(xscale="log", xlabel=clock_label(clock), ylabel="E, relative to balanced")
    plain_x(left)
    left.legend(fontsize=7)
    width = 0.4
    for k, effort in enumerate(("balanced", "best")):
        ratios = [
            divide(least(race[n], f"ssdr {effort} fixed"), least(race[n], f"ssdr {effort}")) or 0
            for n in names
        ]
        right.barh(np.arange(len(names)) + (k - 0.5) * width, ratios, width,
                   color=STYLE[f"ssdr {effort}"][1], label=effort)  # fmt: skip
    right.axvline(1, color="0.3", linewidth=0.8)
    right.set_yticks(np.arange(len(names)), names, fontsize=7)
    right.invert_yaxis()
    right.set_xlabel("E with the rest pose fixed at frame 0 / E with it solved")
    right.legend(fontsize=7)
    save_figure(figure, path)
    plt.close(figure)


def smooth_chart(records: list[Record], path: Path) -> None:
    """Smoothness: error on the frames that were fitted, on those that were not, and jumps."""
    plt = pyplot()
    names = sorted({case_of(r) for r in records})
    figure, axes = plt.subplots(1, len(names), figsize=(4.6 * len(names), 3.6), squeeze=False)
    for axis, name in zip(axes.flat, names, strict=True):
        line = sorted((float(r["solver"].split()[1]), r["E"], r["E kept out"], r["jump"])
                      for r in records if case_of(r) == name)  # fmt: skip
        x = np.arange(len(line))
        share, fitted, kept, jump = np.array(line).T
        axis.plot(x, fitted, "o-", color="#0072b2", label="E, frames that were fitted")
        axis.plot(x, kept, "s--", color="#d55e00", label="E, frames kept out")
        twin = axis.twinx()
        twin.plot(x, jump, "^:", color="0.5", label="mean jump of weights across an edge")
        twin.set_ylim(0)
        if name == names[-1]:
            twin.set_ylabel("mean jump of weights")
        twin.grid(visible=False)
        axis.set_ylim(0)
        axis.set_xticks(x, [f"{s:g}" for s in share])
        axis.set_title(name.replace("-", ", ") + " bones")
        if name == names[0]:
            axis.set_ylabel("E")
        axis.set_xlabel("smoothness, share of the diagonal")
        handles = axis.lines + twin.lines
        axis.legend(handles, [h.get_label() for h in handles], fontsize=7, loc="lower left")
    save_figure(figure, path)
    plt.close(figure)
