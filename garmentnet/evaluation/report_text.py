"""Tables of a report as text, and the figures of its ratios and seeds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .clip_scores import PARTS, VERTICES, ClipScore, Score
from .scores import Row, pool, table
from .statistics import FEW_CLIPS, paired_ratio, pooled_error

__all__ = [
    "class_table",
    "clip_tables",
    "name_width",
    "ratio_table",
    "ratios",
    "score_tables",
    "seed_figures",
    "seed_table",
]

# Of the figures of a score; RMSE is pooled in squares.
_POWERS = {"rmse": 2.0, "hausdorff": 1.0, "sted": 1.0}
_LEVEL = 0.95
# Below this many mm or units of STED nothing is left to divide by: a method that is exact.
_NOTHING = 1e-6


def score_tables(rows: Sequence[Row], n_free: int) -> list[str]:
    """The table of scores over all and over free vertices, and overall RMSE by class of motion."""
    n_vertices = len(rows[0].per_vertex)
    if n_free == n_vertices:
        return [
            f"all vertices ({n_vertices}, none pinned); RMSE and Hausdorff distance in mm",
            table(rows),
            "",
            *class_table(rows, "all"),
        ]
    lines = []
    for vertices, count in zip(VERTICES, (n_vertices, n_free), strict=True):
        lines += [
            f"{vertices} vertices ({count}); RMSE and Hausdorff distance in mm",
            table(rows, vertices),
            "",
        ]
    for vertices in VERTICES:
        lines += class_table(rows, vertices)
    return lines


def class_table(rows: Sequence[Row], vertices: str) -> list[str]:
    """Overall RMSE by class of motion."""
    tables = [r.per_class_free if vertices == "free" else r.per_class for r in rows]
    kinds = sorted({k for t in tables for k in t})
    width = name_width(rows)
    lines = [
        f"overall RMSE (mm) by class of motion, {vertices} vertices",
        " " * width + "".join(f"{k:>10}" for k in kinds),
    ]
    for row, found in zip(rows, tables, strict=True):
        cells = "".join(f"{found.get(k, math.nan):10.1f}" for k in kinds)
        lines.append(f"{row.name:<{width}}{cells}")
    return [*lines, ""]


def name_width(rows: Sequence[Row]) -> int:
    """Of the column with the names of the methods."""
    return max([20, *(len(r.name) + 1 for r in rows)])


def clip_tables(rows: Sequence[Row], n_free: int) -> list[str]:
    """The tables of each clip."""
    lines = []
    for k, first in enumerate(rows[0].clips):
        lines += [f"clip {first.clip}, {first.frames} frames"]
        lines += score_tables([pool(r.name, r.clips[k : k + 1], n_free) for r in rows], n_free)
    return lines


def ratios(rows: Sequence[Row], reference: str) -> dict[str, Any]:
    """Each method's pooled RMSE with its interval, and its ratios to a reference, for JSON.

    Parameters
    ----------
    rows : sequence of Row
        Of the same clips.
    reference : str
        Name of one of them.

    Returns
    -------
    dict
        ``reference``, ``level``, ``n_clips`` and ``methods``: for each name, "all" or "free", part
        and figure the ``ratio``, ``low`` and ``high``, and beside ``rmse`` its value with the
        interval as ``pooled_rmse``.  None where there is no number: the interval of one clip, and
        ratios to a method without error.
    """
    (against,) = (r for r in rows if r.name == reference)
    frames = [c.frames for c in against.clips]
    methods: dict[str, Any] = {}
    for row in rows:
        places = methods.setdefault(row.name, {})
        for vertices in VERTICES:
            for part in PARTS:
                own = _figures(row.clips, vertices, part)
                other = _figures(against.clips, vertices, part)
                error = pooled_error(own["rmse"], frames=frames, level=_LEVEL)
                found: dict[str, Any] = {"pooled_rmse": _plain(error)}
                for figure, power in _POWERS.items():
                    if min(other[figure]) <= _NOTHING:
                        found[figure] = None
                        continue
                    ratio = paired_ratio(
                        own[figure], other[figure], frames=frames, power=power, level=_LEVEL
                    )
                    found[figure] = _plain(ratio)
                places.setdefault(vertices, {})[part] = found
    return {
        "reference": reference,
        "level": _LEVEL,
        "n_clips": len(frames),
        "methods": methods,
    }


def ratio_table(document: Mapping[str, Any], vertices: str) -> list[str]:
    """Overall ratios to the reference as text.

    Parameters
    ----------
    document : dict
        From :func:`ratios`.
    vertices : {"all", "free"}
    """
    n, methods = document["n_clips"], document["methods"]
    width = max([8, *(len(name) for name in methods)])
    lines = [
        f"overall error divided by that of {document['reference']}, {vertices} vertices, {n} "
        f"{'clip' if n == 1 else 'clips'}, in brackets the {100 * document['level']:.0f}% interval "
        "(paired bootstrap over clips)",
        f"{'':<{width}} | {'RMSE, mm':<23} | {'RMSE ratio':<20} | {'Hausdorff ratio':<20} | "
        "STED ratio",
    ]
    for name, places in methods.items():
        found = places[vertices]["overall"]
        cells = [_cell(found["pooled_rmse"], 2, 23)]
        cells += [_cell(found[figure], 3, 20) for figure in _POWERS]
        lines.append(f"{name:<{width}} | " + " | ".join(cells).rstrip())
    if n == 1:
        lines.append("one clip says nothing about others: no intervals")
    elif n < FEW_CLIPS:
        lines.append(f"{n} clips are few: the intervals are rough")
    return [*lines, ""]


def seed_figures(rows: Sequence[Row], seeds: Sequence[Mapping[int, str]]) -> list[dict[str, Any]]:
    """Mean and standard deviation over seeds of every figure, for JSON.

    Parameters
    ----------
    rows : sequence of Row
    seeds : sequence of dict
        From :func:`~garmentnet.evaluation.selection.seeds_of`.
    """
    known = {r.name: r for r in rows}
    documents = []
    for names in seeds:
        document: dict[str, Any] = {"names": list(names.values()), "seeds": list(names)}
        for vertices in VERTICES:
            for part in PARTS:
                scores = [getattr(known[n].parts(vertices), part) for n in names.values()]
                place = document.setdefault(vertices, {}).setdefault(part, {})
                for figure in _POWERS:
                    values = np.array([getattr(s, figure) for s in scores])
                    place[figure] = {
                        "mean": float(values.mean()),
                        "deviation": float(values.std(ddof=1)),
                    }
        documents.append(document)
    return documents


def seed_table(documents: Sequence[Mapping[str, Any]], vertices: str) -> list[str]:
    """Overall figures as mean ± standard deviation over seeds."""
    lines = [f"mean ± standard deviation over seeds, overall, {vertices} vertices"]
    for d in documents:
        found = d[vertices]["overall"]
        cells = [
            f"{label} {found[key]['mean']:.{digits}f} ± {found[key]['deviation']:.{digits}f}{unit}"
            for label, key, digits, unit in (
                ("RMSE", "rmse", 2, " mm"),
                ("Hausdorff", "hausdorff", 1, " mm"),
                ("STED", "sted", 4, ""),
            )
        ]
        seeds = ", ".join(str(s) for s in d["seeds"])
        lines.append(f"{d['names'][0]}, seeds {seeds}: " + ", ".join(cells))
    return [*lines, ""]


def _figures(clips: Sequence[ClipScore], vertices: str, part: str) -> dict[str, list[float]]:
    scores: list[Score] = [getattr(getattr(c, vertices), part) for c in clips]
    return {figure: [getattr(s, figure) for s in scores] for figure in _POWERS}


def _plain(result: Any) -> dict[str, Any]:
    # JSON has no NaN.
    values = dataclasses.asdict(result)
    return {
        k: None if isinstance(v, float) and not math.isfinite(v) else v
        for k, v in values.items()
        if k not in ("n_clips", "level")
    }


def _cell(found: Mapping[str, Any] | None, digits: int, width: int) -> str:
    if found is None:
        return f"{'-':<{width}}"
    value = found.get("value", found.get("ratio"))
    text = f"{value:.{digits}f}"
    if found["low"] is not None:
        text += f" [{found['low']:.{digits}f}, {found['high']:.{digits}f}]"
    return f"{text:<{width}}"
