"""Put the results into the pages: what stands between two markers is written anew.

    python benchmarks/tools/pages.py [--check]

Markers are <!-- NAME --> and <!-- end NAME -->; --check only says whether a page is out of date.
A table is rows of benchmarks/results and, for each column, its head and a format of the row; what
a row lacks leaves the cell empty.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.accuracy.errors import AUTHOR, BOUNDS, FLOATS, millimetres
from benchmarks.common import EFFORTS, RESULTS, ROOT, Row, read_rows, tell
from benchmarks.peers import tables
from benchmarks.peers.charts import STYLE
from benchmarks.robustness.stability import shown

PAGES = [ROOT / "benchmarks" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def rows(name: str, **wanted: Any) -> list[Row]:
    """Rows of a results file, by some of their values; each has its case."""
    every = [{"case": case} | row for case, row in read_rows(RESULTS / f"{name}.json").items()]
    return [r for r in every if all(r.get(key) == value for key, value in wanted.items())]


def cell(template: str, row: Row) -> str:
    try:
        text = template.format_map(row)
    except (KeyError, TypeError):
        return ""
    return "" if text == "None" else text


def table(rows: Iterable[Row], columns: dict[str, str]) -> str:
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for row in rows:
        lines.append("| " + " | ".join(cell(t, row) for t in columns.values()) + " |")
    return "\n".join(lines)


def pivot(rows: Iterable[Row], line: str, column: str, value: str) -> list[Row]:
    """A row for each `line`, with a `value` for each `column`."""
    found: dict[str, Row] = {}
    for row in rows:
        found.setdefault(cell(line, row), dict(row))[cell(column, row)] = cell(value, row)
    return [{"line": name} | row for name, row in found.items()]


def pivoted(rows: Iterable[Row], head: str, line: str, column: str, value: str, *heads: str) -> str:
    found = pivot(rows, line, column, value)
    return table(found, {head: "{line}"} | {h: f"{{{h}}}" for h in heads})


SEQUENCE = "{sequence}, {bones}"


def effort_rows() -> list[Row]:
    """Those of errors.py, and of the race where it is that which runs the case."""
    found = []
    published = {r["bones"]: r["E"] for r in rows("race", solver="published")}
    for key, bounds in BOUNDS.items():
        sequence, bones, influences = key
        case = {"sequence": sequence, "bones": bones, "influences": influences}
        for effort in EFFORTS:
            own = rows("errors", group="efforts", effort=effort, **case)
            raced = rows("race", solver=f"ssdr {effort}", threads=1, **case)
            for row in own or raced[:1]:
                extra = dict(zip(("plain", "first", "harder"), bounds, strict=True))
                extra |= {"ratio": row["E"] / bounds[1], "effort": effort}
                extra["seconds"] = row.get("seconds", row.get("total wall"))
                extra["cpu seconds"] = row.get("cpu seconds", row.get("total cpu"))
                if influences == 8:
                    extra["published"] = row["E"] / published[bones]
                found.append(row | extra)
    return found


def accuracy() -> str:
    return table(effort_rows(), {
        "sequence": "{sequence}-{bones}", "K": "{influences}", "effort": "{effort}",
        "E": "{E:.3f}", "s": "{seconds:.1f}", "CPU s": "{cpu seconds:.1f}", "plain": "{plain}",
        "first bound": "{first}", "harder bound": "{harder}", "E / first bound": "{ratio:.2f}",
        "E / EA": "{published:.3f}", "load": "{machine[load]}", "revision": "{machine[revision]}",
    })  # fmt: skip


def efforts() -> str:
    value = "{E:.2f} in {cpu seconds:.1f} s"
    found = pivot(effort_rows(), SEQUENCE, "{effort}", value)
    columns = {"sequence, bones": "{line}"} | {e: f"{{{e}}}" for e in EFFORTS}
    return table(found, columns | {"plain alternation": "{plain}"})


def choose_influences() -> str:
    found = rows("errors", group="influences")
    pruned = found[-1]["E pruned"]
    return table(
        [
            r
            | {"mm": millimetres(r["E"]), "pruned": millimetres(pruned[str(r["influences"])])}
            for r in found
        ],
        {"influences": "{influences}", "RMSE, mm": "{mm:.2f}", "pruned from 8, mm": "{pruned:.2f}",
         "s": "{seconds:.1f}"},
    )  # fmt: skip


def choose_bones() -> str:
    found = [r | {"mm": millimetres(r["E"])} for r in rows("errors", group="bones")]
    return table(found, {"bones": "{bones}", "RMSE, mm": "{mm:.2f}", "s": "{seconds:.1f}"})


def bone_models() -> str:
    """One row a sequence, a column a kind of bones."""
    same = rows("errors", group="kinds", effort="balanced")
    equal = rows("errors", group="kinds, equal bytes")
    found = pivot(same, "{sequence}, {rigid}", "{bone_model}", "{E:.3f}")
    value = "{E:.3f} ({bones} bones)"
    fewer = pivot(equal, "{sequence}, {rigid}", "{bone_model}, equal bytes", value)
    for line, other in zip(found, fewer, strict=True):
        line |= {k: v for k, v in other.items() if k.endswith("equal bytes")}
        line["author"] = AUTHOR.get((line["sequence"], line["rigid"]))
    kinds = [*FLOATS, "similarity, equal bytes", "affine, equal bytes"]
    columns = {"sequence, rigid bones": "{line}"} | {kind: f"{{{kind}}}" for kind in kinds}
    return table(found, columns | {"the 2012 author's affine": "{author}"})


def parsimony() -> str:
    found = [r for r in rows("parsimony") if "scene" in r]
    for r in found:
        if r["one less"]:
            r["least"] = min(r["one less"])
            r["effort"] = f"{r['effort']:.1f} times" if r["effort"] else "proven"
    return table(found, {
        "scene": "{scene}", "tolerance": "{tolerance}", "made with": "{made with}",
        "bones": "{bones}", "proven least": "{proven}", "influences": "{influences}",
        "error": "{error / tolerance:.2f}", "one bone less, best of all tries": "{least:.3g}",
        "effort on it": "{effort}", "bytes before and after pruning": "{bytes before:,}, {bytes:,}",
        "CPU s": "{cpu seconds:.1f}",
    })  # fmt: skip


def first_call() -> str:
    found = {r["case"]: r for r in rows("first_call")}
    kernels = found.pop("kernels")
    waits = table(found.values(), {
        "": "{case}", "whole process": "{process:.2f}",
        "compiling or loading kernels": "{kernels:.2f}", "solving": "{solve:.2f}",
    })  # fmt: skip
    each = table(kernels["kernels"], {"kernel": "{kernel}", "s": "{s:.1f}"})
    head = f"{len(kernels['kernels'])} kernels, {kernels['seconds']:.1f} s:"
    sample = "Seconds; dancer_small, 12 bones, effort fast."
    return "\n\n".join([sample, waits, head, each, tell(kernels["machine"])])


def steps() -> str:
    found = rows("steps")
    out = [table(found, {
        "case": "{data}-{bones}", "step": "{step}", "threads": "{threads}", "ms": "{ms:.1f}",
        "products, GFLOP": "{GFLOP:.2f}", "products at the GEMM rate, ms": "{floor ms:.1f}",
        "ratio": "{ratio:.1f}", "GEMM, GFLOP/s": "{rate}", "load": "{machine[load]}",
    })]  # fmt: skip
    for step in ("outer iteration", "polish step"):
        one = [r for r in found if r["step"] == step and r["threads"] == 1]
        heads = [cell("{data}-{bones}", r) for r in one]
        parts: list[Row] = [
            {"part": name} | {h: beside(r, name) for h, r in zip(heads, one, strict=True)}
            for name in one[0]["parts"]
        ]
        note = " (the part's own bound)" if one[0]["bounds"] else ""
        columns = {"part": "{part}"} | {h: f"{{{h}}}" for h in heads}
        out.append(f"Parts of one {step}, one thread, ms{note}:\n\n{table(parts, columns)}")
    return "\n\n".join([*out, tell(found[-1]["machine"])])


def beside(row: Row, part: str) -> str:
    bound = row["bounds"].get(part)
    return f"{row['parts'][part]:.1f}" + ("" if bound is None else f" ({bound:.1f})")


def rates(machine: Row) -> str:
    return (
        f"GEMM float64 {machine['gemm_1']} GFLOP/s in one thread, {machine['gemm_2']} in two; "
        f"copy {machine['memory']} GB/s; load {machine['load']}; revision {machine['revision']}"
    )


def race_errors() -> str:
    return table(tables.summaries(tables.read("race")), {
        "sequence, bones": SEQUENCE, "Dem Bones": "{Dem Bones:.3f}", "regularisers": "{setting}",
        "SSDR 2012": "{SSDR 2012:.3f}", "ssdr fast": "{fast:.3f}", "balanced": "{balanced:.3f}",
        "best": "{best:.3f}", "balanced ÷": "{balanced ratio:.2f}", "best ÷": "{best ratio:.2f}",
        "balanced, rest fixed ÷": "{balanced fixed ratio:.2f}",
        "best, rest fixed ÷": "{best fixed ratio:.2f}",
    })  # fmt: skip


def race_times() -> str:
    columns = {"sequence, bones": SEQUENCE}
    for clock, unit in (("cpu", "CPU s"), ("wall", "s")):
        columns |= {
            f"Dem Bones, {unit}": f"{{Dem Bones {clock}:.2f}}",
            f"ssdr, {unit}": f"{{balanced {clock}:.2f}}",
            f"ratio, {unit}": f"{{balanced {clock} ratio:.0f}}",
            f"rest fixed, ratio, {unit}": f"{{balanced fixed {clock} ratio:.0f}}",
        }
    return table(tables.summaries(tables.read("race")), columns | {
        "threads": "{threads}", "GEMM, GFLOP/s": "{machine[gemm_1]}, {machine[gemm_2]}",
        "copy, GB/s": "{machine[memory]}", "load": "{machine[load]}",
        "revision": "{machine[revision]}",
    })  # fmt: skip


def race_seeds() -> str:
    return table(tables.seed_rows(), {
        "sequence, bones": SEQUENCE, "runs": "{runs}", "least E": "{least:.3f}",
        "most E": "{most:.3f}", "(most - least) / least": "{spread:.1f} %",
        "CPU s a run": "{cpu:.0f}", "revision": "{revision}",
    })  # fmt: skip


def race_apart() -> str:
    found = [r | {"name": STYLE[r["solver"]][0]} for r in tables.apart_rows()]
    return table(found, {
        "sequence, bones": SEQUENCE, "solver": "{name}", "threads": "{threads}",
        "bones in the result": "{bones found}", "E": "{E:.3f}",
    })  # fmt: skip


def sizes() -> str:
    found = tables.size_rows()
    return table(found, {
        "sequence, bones": SEQUENCE, "K": "{influences}", "KiB": "{KiB:.0f}", "E": "{E:.3f}",
        "E stored": "{E8:.3f}", "E of PCA at these bytes": "{PCA:.3f}",
    }) + "\n\n" + rates(rows("front")[-4]["machine"])  # fmt: skip


def scaling() -> str:
    found = tables.sweeps(tables.read("scaling"))
    columns = {"solver": "{name}", "over": "{over}", "exponent": "{exponent:.2f}"}
    text = table(
        [r | {"name": STYLE[r["solver"]][0]} for r in found],
        columns | {"size: seconds (E)": "{points}"},
    )
    return f"Seconds of one call.\n\n{text}\n\n{rates(found[-1]['machine'])}"


def rest_poses() -> str:
    names = {
        "ssdr balanced": "solved, from frame 0",
        "ssdr balanced middle": "solved, from the middle",
        "ssdr balanced fixed": "fixed at frame 0",
        "ssdr balanced fixed middle": "fixed at the middle",
    }
    found = [r | {"pose": names[r["solver"]]} for r in rows("choices") if r["solver"] in names]
    return pivoted(found, "sequence, bones", SEQUENCE, "{pose}", "{E:.3f}", *names.values())


def smoothness() -> str:
    found = [r for r in rows("choices") if r["solver"].startswith("smooth")]
    found = [r | {"share": r["solver"].split()[1]} for r in found]
    found.sort(key=lambda r: (cell(SEQUENCE, r), float(r["share"])))
    return table(found, {
        "sequence, bones": SEQUENCE, "smoothness / diagonal": "{share}",
        "E, fitted frames": "{E:.3f}", "E, frames kept out": "{E kept out:.3f}",
        "mean jump of weights across an edge": "{jump:.3f}",
    })  # fmt: skip


def recovery() -> str:
    return table(rows("errors", group="recovery"), {
        "data": "{sequence}", "B": "{bones}", "effort": "{effort}",
        "RMSE / diagonal": "{rmse / diagonal:.1e}", "max / diagonal": "{max / diagonal:.1e}",
        "E": "{E:.2f}", "s": "{seconds:.1f}",
    })  # fmt: skip


def stability() -> str:
    found = rows("stability")
    others = [r for r in found if "right" in r]
    text = (
        f"`ssdr`: {sum(r['passed'] for r in found)} of {len(found)} right. "
        f"Dem Bones: {sum(r['right'] for r in others)} of {len(others)}."
    )
    return f"{text}\n\n" + table(shown(found), {
        "": "{first}", "case": "{case}", "ssdr": "{ours}", "right, ssdr": "{ours right}",
        "Dem Bones": "{Dem Bones}", "right, Dem Bones": "{theirs right}",
        "what the test would have caught": "{caught}",
    })  # fmt: skip


PARTS: dict[str, Callable[[], str]] = {
    part.__name__: part
    for part in (
        accuracy, efforts, choose_bones, choose_influences, bone_models, recovery, parsimony,
        first_call, steps, race_errors, race_times, race_seeds, race_apart, sizes, scaling,
        rest_poses, smoothness, stability,
    )
}  # fmt: skip
PARTS |= {"race_run": tables.run_words, "race_history": tables.history_words}


def renew(text: str) -> str:
    def put(match: re.Match[str]) -> str:
        name = match[1]
        return f"<!-- {name} -->\n\n{PARTS[name]()}\n\n<!-- end {name} -->"

    return re.sub(r"<!-- (\w+) -->\n.*?<!-- end \1 -->", put, text, flags=re.DOTALL)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    for page in PAGES:
        old = page.read_text(encoding="utf-8")
        new = renew(old)
        if new != old and args.check:
            sys.exit(f"{page.relative_to(ROOT)} is out of date: run benchmarks/tools/pages.py")
        if new != old:
            page.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
