"""Rows of the leaderboard's tables, from its results and from what others published."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping

from benchmarks.common import RESULTS, Record, Row
from benchmarks.leaderboard.catalogue import HYPERSPECTRAL, LE_AFFINE, LE_RIGID, SEQUENCES
from benchmarks.leaderboard.score import EXPRESSIONS, is_dense

METRIC = "2 E / diagonal"
MEASURES = {
    "E": "E", "largest %": "largest error, %", "STED": "STED",
    "MXE": "largest of a coordinate, mm", "MAE": "mean of a coordinate, mm",
}  # fmt: skip
NAMES = {
    "2012": "SSDR 2012", "dembones": "Dem Bones", "published": "published model",
    "ssdr": "ssdr",
}  # fmt: skip
SEQUENCE = "{sequence}, {bones}"


Rows = Mapping[str, Row]


def results(rows: Rows) -> list[Row]:
    """Rows that have an error, with the words that tables have for them."""
    found = [dict(r) for r in rows.values() if "E" in r]
    for r in found:
        r["weights"] = "dense" if is_dense(r) else f"K = {r['influences']}"
        r["by"] = r["solver"].split()[0]
        r["name"] = r["solver"] if r["by"] == "ssdr" else NAMES[r["by"]]
        r["column"] = f"{r['by']} {r['weights'].split()[0]} {r['bone_model']} {r['rest']}"
    return found


def by_case(rows: Iterable[Row]) -> Iterator[Row]:
    """One row for each sequence and number of bones, with every row of it by its column."""
    found: dict[tuple[str, int], Row] = {}
    for r in rows:
        key = r["sequence"], r["bones"]
        found.setdefault(key, {"sequence": key[0], "bones": key[1]})[r["column"]] = r
    yield from found.values()


def published_rows(rows: Rows) -> list[Row]:
    """The sequences of which figures are published, in their metric."""
    found = []
    for row in by_case(results(rows)):
        key = row["sequence"], row["bones"]
        if key in HYPERSPECTRAL:
            figures = {"HIS": HYPERSPECTRAL[key], "Le": LE_AFFINE[key]}
            figures |= {"Le rigid": LE_RIGID[key]} if key in LE_RIGID else {}
            found.append(row | figures)
    return found


def ea_rows(rows: Rows) -> list[Row]:
    return [row for row in by_case(results(rows)) if row["sequence"] == "ea_bone"]


def face_rows(rows: Rows) -> list[Row]:
    found = [r for r in results(rows) if "MXE" in r]
    for r in found:
        r["RMS"] = SEQUENCES[r["sequence"]].millimetres * r["E"] / 1000
    return found


def better_rows(rows: Rows) -> Iterator[Row]:
    """Cases in which another method is better than ours by a measure, theirs and ours."""
    fields = ("sequence", "bones", "influences", "bone_model", "rest")
    known = results(rows)
    usual = [r for r in known if r["by"] == "ssdr" and r["solver"] != EXPRESSIONS]
    ours = {tuple(r[k] for k in fields): r for r in usual}
    for r in known:
        mine = ours.get(tuple(r[k] for k in fields))
        if mine is not None and r["by"] != "ssdr" and not r["defects"]:
            for key, measure in MEASURES.items():
                if key in r and r[key] < mine[key]:
                    yield r | {"measure": measure, "theirs": r[key], "ours": mine[key]}
    for name, bones in HYPERSPECTRAL:
        mine = ours.get((name, bones, bones, "affine", "given"))
        theirs = HYPERSPECTRAL[name, bones]
        if mine is not None and theirs < mine[METRIC]:
            words = {"name": "Hyperspectral Inverse Skinning", "measure": METRIC}
            yield mine | words | {"theirs": theirs, "ours": mine[METRIC]}


def better_cases(rows: Rows) -> Iterator[Row]:
    """`better_rows`, those of a case on one line."""
    found: dict[tuple[object, ...], Row] = {}
    for r in better_rows(rows):
        key = r["sequence"], r["bones"], r["weights"], r["bone_model"], r["rest"]
        words = "{measure}: {name} {theirs:.4g} ({ours:.4g})".format_map(r)
        found.setdefault(key, r | {"where": []})["where"].append(words)
    for r in found.values():
        yield r | {"where": "; ".join(r["where"])}


def sequence_rows(rows: Rows) -> Iterator[Row]:
    for name, s in SEQUENCES.items():
        yield {"name": name, **vars(s)}


def metric(column: str) -> str:
    return f"{{{column}[{METRIC}]:.3f}}"


def three(column: str) -> str:
    """E, largest error in percent of the diagonal, STED."""
    return f"{{{column}[E]:.3f}}, {{{column}[largest %]:.2f}} %, {{{column}[STED]:.4f}}"


# Rows and columns (head and format) of each table of the page.
TABLES: dict[str, tuple[Callable[[Rows], Iterable[Row]], dict[str, str]]] = {
    "board_dense": (published_rows, {
        "sequence, bones": SEQUENCE,
        "affine, rest given: HIS": "{HIS:.3f}",
        "ssdr": metric("ssdr dense affine given"),
        "affine, rest solved: ssdr": metric("ssdr dense affine solved"),
        "rigid, rest given: ssdr": metric("ssdr dense rigid given"),
        "rigid, rest solved: ssdr": metric("ssdr dense rigid solved"),
    }),
    "board_affine": (published_rows, {
        "sequence, bones": SEQUENCE,
        "rest given: Le": "{Le:.3f}",
        "ssdr": metric("ssdr K affine given"),
        "rest solved: Le's model, rest fitted here": metric("published K affine solved"),
        "ssdr, rest solved": metric("ssdr K affine solved"),
    }),
    "board_rigid": (published_rows, {
        "sequence, bones": SEQUENCE,
        "rest given: Le": "{Le rigid:.2f}",
        "Dem Bones": metric("dembones K rigid given"),
        "SSDR 2012": metric("2012 K rigid given"),
        "ssdr": metric("ssdr K rigid given"),
        "rest solved: ssdr": metric("ssdr K rigid solved"),
    }),
    "board_ea": (ea_rows, {
        "sequence, bones": SEQUENCE,
        "published by EA": three("published K rigid solved"),
        "rest given: Dem Bones": three("dembones K rigid given"),
        "SSDR 2012": three("2012 K rigid given"),
        "ssdr": three("ssdr K rigid given"),
        "rest solved: ssdr": three("ssdr K rigid solved"),
        "ssdr, affine": three("ssdr K affine solved"),
    }),
    "board_faces": (face_rows, {
        "sequence, bones": SEQUENCE, "weights": "{weights}", "bone model": "{bone_model}",
        "solver": "{name}", "largest, mm": "{MXE:.2f}", "mean, mm": "{MAE:.4f}",
        "RMS, mm": "{RMS:.4f}", "numbers not 0": "{numbers:,}", "STED": "{STED:.4f}",
        "defects": "{defects}",
    }),
    "board_better": (better_cases, {
        "sequence, bones": SEQUENCE, "weights": "{weights}", "bone model": "{bone_model}",
        "rest pose": "{rest}", "measure: method, theirs (ssdr's)": "{where}",
    }),
    "board_sequences": (sequence_rows, {
        "name": "{name}", "github.com/": "{repository}", "commit": "{commit:.7}",
        "licence": "{licence}", "credit": "{credit}",
    }),
}  # fmt: skip


def every_case() -> str:
    """All rows as comma-separated values."""
    columns = (
        "sequence", "bones", "influences", "bone_model", "rest", "solver", "E", METRIC, "largest %",
        "STED", "cpu seconds", "defects",
    )  # fmt: skip
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([*columns, "revision"])
    record = Record(RESULTS / "leaderboard.json")
    for r in results(record.rows):
        values = [r.get(column, "") for column in columns]
        shown = [f"{value:.5g}" if isinstance(value, float) else value for value in values]
        writer.writerow([*shown, record.revision])
    return file.getvalue()
