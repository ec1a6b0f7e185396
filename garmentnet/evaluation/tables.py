"""The tables of a report, in Markdown."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from .scores import PARTS, VERTICES, Scores
from .statistics import paired_ratio

__all__ = ["class_table", "interval_cell", "interval_table", "intervals", "markdown", "score_table"]

# Power with which each figure of a score is pooled over clips: 2 for RMSE, 1 for means.
_POWERS = {"rmse": 2.0, "hausdorff": 1.0, "sted": 1.0}
# An error below this many mm or units of STED counts as 0, and no ratio to it is given.
_NOTHING = 1e-6


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column is text and whose others are numbers."""
    widths = [max(3, *(len(r[k]) for r in [head, *rows])) for k in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        padded = [c.rjust(w) for c, w in zip(cells, widths, strict=True)]
        return f"| {' | '.join([cells[0].ljust(widths[0]), *padded[1:]])} |"

    rule = ["-" * widths[0], *("-" * (w - 1) + ":" for w in widths[1:])]
    return "\n".join([line(head), line(rule), *map(line, rows)])


def score_table(rows: Sequence[Scores], vertices: str = "all") -> str:
    """Table of RMSE and Hausdorff distance in mm, STED, and the share of vertices inside the body.

    The column ``left`` is the error of the detail as a share of the detail's RMS.

    Parameters
    ----------
    rows : sequence of Scores
    vertices : {"all", "free"}
    """
    head = [f"{vertices} vertices"]
    for part in PARTS:
        head += [f"{part} RMSE", "Hausd.", "STED"]
    lines = []
    for row in rows:
        scores = [getattr(getattr(row, vertices), part) for part in PARTS]
        cells = [
            x for s in scores for x in (f"{s.rmse:.2f}", f"{s.hausdorff:.1f}", f"{s.sted:.4f}")
        ]
        inside = row.inside_free if vertices == "free" else row.inside
        left = f"{100 * getattr(row, vertices).left:.0f} %"
        lines.append([row.name, *cells, left, f"{100 * inside:.2f} %"])
    return markdown([*head, "left", "inside"], lines)


def class_table(rows: Sequence[Scores], vertices: str) -> str:
    """Overall RMSE by class of motion, mm."""
    kinds = list(rows[0].per_class)
    lines = [[r.name, *(f"{getattr(r.per_class[k], vertices):.1f}" for k in kinds)] for r in rows]
    return markdown([f"RMSE, {vertices} vertices", *kinds], lines)


def intervals(rows: Sequence[Scores], reference: str) -> dict[str, Any]:
    """Errors of each part and their ratios to those of a reference, with intervals.

    Parameters
    ----------
    rows : sequence of Scores
        Scores of the methods on the same clips.
    reference : str
        Name of one of the methods.

    Returns
    -------
    dict
        The ``reference``, and ``methods[name][vertices][part]`` with `vertices` "all" or "free".
        Each entry holds the value, lower and upper end of ``error`` (RMSE, mm) and of the ratios
        ``rmse``, ``hausdorff`` and ``sted``.  None stands for the interval of a single clip and for
        ratios to a method without error.
    """
    (against,) = (r for r in rows if r.name == reference)
    frames = [c.frames for c in against.clips]

    def figures(row: Scores, vertices: str, part: str, figure: str) -> list[float]:
        return [getattr(getattr(getattr(c, vertices), part), figure) for c in row.clips]

    methods: dict[str, Any] = {}
    for row in rows:
        for vertices, part in itertools.product(VERTICES, PARTS):
            errors = figures(row, vertices, part, "rmse")
            error = paired_ratio(errors, [1.0] * len(errors), frames=frames)
            found: dict[str, Any] = {"error": list(error)}
            for figure, power in _POWERS.items():
                own, other = (figures(r, vertices, part, figure) for r in (row, against))
                found[figure] = [None] * 3
                if min(other) > _NOTHING:
                    found[figure] = list(paired_ratio(own, other, frames=frames, power=power))
            methods.setdefault(row.name, {}).setdefault(vertices, {})[part] = found
    return {"reference": reference, "methods": methods}


def interval_table(document: dict[str, Any], vertices: str) -> str:
    """Table of the whole garment's intervals over "all" or "free" `vertices`, in Markdown."""
    head = ["RMSE, mm", "RMSE ratio", "Hausdorff ratio", "STED ratio"]
    lines = []
    for name, found in document["methods"].items():
        cells = found[vertices]["overall"].items()
        lines.append(
            [name, *(interval_cell(value, 2 if k == "error" else 3) for k, value in cells)]
        )
    return markdown([f"overall, {vertices} vertices", *head], lines)


def interval_cell(found: list[float | None], digits: int) -> str:
    """A value and its interval, as ``0.97 [0.95, 0.99]``; "-" for what is None."""
    value, low, high = ("-" if x is None else f"{x:.{digits}f}" for x in found)
    return value if low == "-" else f"{value} [{low}, {high}]"
