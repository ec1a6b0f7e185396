"""The tables of a report, in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from .scores import PARTS, Scores


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column is text and whose others are numbers."""
    widths = [max(3, *(len(r[k]) for r in [head, *rows])) for k in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        padded = [c.rjust(w) for c, w in zip(cells, widths, strict=True)]
        return f"| {' | '.join([cells[0].ljust(widths[0]), *padded[1:]])} |"

    rule = ["-" * widths[0], *("-" * (w - 1) + ":" for w in widths[1:])]
    return "\n".join([line(head), line(rule), *map(line, rows)])


def score_table(rows: Sequence[Scores], vertices: str = "all") -> str:
    """Table of RMSE and Hausdorff distance in mm, and STED.

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
        left = f"{100 * getattr(row, vertices).left:.0f} %"
        lines.append([row.name, *cells, left])
    return markdown([*head, "left"], lines)


def class_table(rows: Sequence[Scores], vertices: str) -> str:
    """Overall RMSE by class of motion, mm."""
    kinds = list(rows[0].per_class)

    def cell(row: Scores, kind: str) -> str:
        return f"{getattr(row.per_class[kind], vertices):.1f}" if kind in row.per_class else ""

    lines = [[r.name, *(cell(r, k) for k in kinds)] for r in rows]
    return markdown([f"RMSE, {vertices} vertices", *kinds], lines)


def mode_table(rows: Sequence[Scores]) -> str:
    """Overall RMSE by modes of the cloth, mm."""
    lines = [[r.name, *(f"{x:.1f}" for x in r.modes.values())] for r in rows]
    return markdown(["RMSE by mode", *rows[0].modes], lines)
