"""Put the results into the pages: what stands between two markers is written anew.

    python benchmarks/tools/pages.py [--check]

Markers are <!-- NAME --> and <!-- end NAME -->; --check only says whether a page is out of date.
BLOCKS holds their text and tables.  A table is rows of benchmarks/results and, for each column, its
head and a format string for the row; a value that a row lacks leaves the cell empty.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.accuracy import ablation
from benchmarks.accuracy.errors import AUTHOR, FLOATS, PLAIN, millimetres
from benchmarks.common import EFFORTS, RESULTS, ROOT, Row, read_rows, tell
from benchmarks.leaderboard import tables as leaderboard
from benchmarks.peers import tables
from benchmarks.peers.charts import STYLE

PAGES = [ROOT / "README.md", ROOT / "benchmarks" / "README.md", *(ROOT / "docs").glob("*.md")]
SEQUENCE = "{sequence}, {bones}"
REST_POSES = {
    "free, no normals": "free, `normals=False`",
    "free": "free",
    "surface, no normals": "surface, `normals=False`",
    "surface": "surface, the default",
    "frame 0": "fixed at frame 0",
}


@dataclasses.dataclass
class Table:
    rows: Callable[[], Iterable[Row]]
    columns: dict[str, str]

    def __call__(self) -> str:
        lines = ["| " + " | ".join(self.columns) + " |", "|" + "---|" * len(self.columns)]
        for row in self.rows():
            cells = [cell(template, row) for template in self.columns.values()]
            lines.append("| " + " | ".join(cells) + " |")
        return "\n".join(lines)


def cell(template: str, row: Row) -> str:
    try:
        text = template.format_map(row)
    except (KeyError, TypeError):
        return ""
    return "" if text == "None" else text


def same(*heads: str) -> dict[str, str]:
    """Columns whose heads are the keys of the row."""
    return {head: f"{{{head}}}" for head in heads}


# --- rows ----------------------------------------------------------------------------------------


def rows(name: str, **wanted: Any) -> list[Row]:
    """Rows of a results file that have the wanted values, each with its case."""
    every = [{"case": case} | row for case, row in read_rows(RESULTS / f"{name}.json").items()]
    return [r for r in every if all(r.get(key) == value for key, value in wanted.items())]


def pivot(rows: Iterable[Row], line: str, column: str, value: str) -> list[Row]:
    """Rows grouped into one for each `line`, with a `value` for each `column`."""
    found: dict[str, Row] = {}
    for row in rows:
        first = found.setdefault(cell(line, row), row | {"line": cell(line, row)})
        first[cell(column, row)] = cell(value, row)
    return [*found.values()]


def effort_rows() -> list[Row]:
    """Rows of errors.py, or of the race where that runs the case."""
    found = []
    published = {r["bones"]: r["E"] for r in rows("race", solver="published")}
    for (sequence, bones, influences), plain in PLAIN.items():
        case = {"sequence": sequence, "bones": bones, "influences": influences}
        for effort in EFFORTS:
            own = rows("errors", group="efforts", effort=effort, **case)
            for row in own or rows("race", solver=f"ssdr {effort}", threads=1, **case):
                row |= {"plain": plain, "effort": effort}
                row.setdefault("seconds", row.get("total wall"))
                row.setdefault("cpu seconds", row.get("total cpu"))
                if influences == 8:
                    row["published"] = row["E"] / published[bones]
                found.append(row)
    return found


def choice_rows(group: str) -> list[Row]:
    """RMSE in millimetres, also of the model of most influences after pruning."""
    found = rows("errors", group=group)
    pruned = found[-1].get("E pruned", {})
    for r in found:
        r["mm"], e = millimetres(r["E"]), pruned.get(str(r["influences"]))
        r["pruned"] = e and millimetres(e)
    return found


def kind_rows() -> list[Row]:
    """E by sequence and kind of bones."""
    equal = rows("errors", group="kinds, equal bytes")
    found = rows("errors", group="kinds", effort="balanced") + equal
    for r in found:
        r["author"] = AUTHOR.get((r["sequence"], r["rigid"]))
        r["shown"] = f"{r['E']:.3f}"
        if r in equal:
            r["bone_model"] += ", equal bytes"
            r["shown"] += f" ({r['bones']} bones)"
    return pivot(found, "{sequence}, {rigid}", "{bone_model}", "{shown}")


def parsimony_rows() -> list[Row]:
    found = [r for r in rows("parsimony") if "scene" in r]
    for r in found:
        if r["one less"]:
            r["least"] = min(r["one less"])
            r["effort"] = f"{r['effort']:.1f} times" if r["effort"] else "proven"
    return found


def fewest_rows() -> list[Row]:
    """Models of the fewest bones and of the fewest bytes, and what these have in their place."""
    found = json.loads((RESULTS / "shapes.json").read_text())["smallest"]
    for r in found:
        r["ratio"] = r["bytes"]["bytes"] / r["bones"]["bytes"]
        r["means"] = r["bytes"]["means"] if r["ratio"] < 1 else ""
        r["shapes"] = r["bytes"]["shapes"] or ""
    return found


def ea_bone_rows() -> Iterable[Row]:
    """Models of ea_bone with four influences and with eight, by their bytes."""
    found = json.loads((RESULTS / "shapes.json").read_text())
    both = [r | {"K": k} for k, name in ((4, "bytes"), (8, "eight")) for r in found.get(name, ())]
    return sorted(both, key=lambda r: r["bytes"])


def part_rows(step: str) -> list[Row]:
    """Milliseconds of each part of a step by case, with the part's bound."""
    found = [
        {"case": cell("{data}-{bones}", r), "part": part, "ms": ms, "bound": r["bounds"].get(part)}
        for r in rows("steps", step=step, threads=1)
        for part, ms in r["parts"].items()
    ]
    for r in found:
        r["shown"] = f"{r['ms']:.1f}" + ("" if r["bound"] is None else f" ({r['bound']:.1f})")
    return pivot(found, "{part}", "{case}", "{shown}")


def ablation_rows(effort: str) -> list[Row]:
    """E and CPU seconds without a step, relative to those of the whole search, by sequence."""
    found = rows("ablation", effort=effort)
    whole = {(r["sequence"], r["seed"]): r for r in found if r["step"] == "nothing"}
    ratios: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for r in found:
        base = whole[r["sequence"], r["seed"]]
        pair = r["E"] / base["E"], r["cpu seconds"] / base["cpu seconds"]
        ratios.setdefault((r["step"], r["sequence"]), []).append(pair)
    for r in found:
        mine = ratios[r["step"], r["sequence"]]
        error, seconds = (math.prod(part) ** (1 / len(mine)) for part in zip(*mine, strict=True))
        r["shown"] = f"{error:.3f} ({seconds:.2f})"
    return pivot([r for r in found if r["step"] != "nothing"], "{step}", "{sequence}", "{shown}")


def smooth_rows() -> list[Row]:
    found = [r for r in rows("choices") if r["solver"].startswith("smooth")]
    found = [r | {"share": r["solver"].split()[1]} for r in found]
    return sorted(found, key=lambda r: (cell(SEQUENCE, r), float(r["share"])))


def rest_rows() -> list[Row]:
    found = rows("rest_poses")
    for r in found:
        r["pose"] = REST_POSES[r["case"].partition(" ")[2]]
    shown = "{E:.3f}, {drawn:.1f}° ({bent:.1f}°)"
    return pivot(found, SEQUENCE, "{pose}", shown)


def lit_rows() -> list[Row]:
    """Rows of lit.py with keys that a format string can name."""
    return [{key.replace(".js", ""): v for key, v in r.items()} for r in rows("lit")]


def named(rows: Iterable[Row]) -> list[Row]:
    return [r | {"name": STYLE[r["solver"]][0]} for r in rows]


def stability_rows() -> list[Row]:
    """Outcomes in words; the first row of a group has its number and what it catches."""
    seen = None
    found = rows("stability")
    for r in found:
        ours = re.sub(r" \(\d+ such.*", "", r["outcome"]).replace("|", "/")
        if ours == "solved" and r["figure"] is None:
            ours = "passes"
        elif ours == "solved":
            ours = f"error {r['figure']:.1e}"
            ours += "" if r["bound"] is None else f" (may be {r['bound']:.1e})"
        r["ours"] = ours if r["passed"] else f"FAILS: {ours}"
        r["passed"] = "yes" if r["passed"] else "no"
        r["right"] = {True: "yes", False: "no"}.get(r.get("right"), "")
        r.setdefault("Dem Bones", "not run")
        r["first"] = None if r["number"] == seen else r["number"]
        r["caught"] = None if r["number"] == seen else r["catches"]
        seen = r["number"]
    return found


# --- text ----------------------------------------------------------------------------------------


def rates(name: str) -> str:
    machine = [r["machine"] for r in rows(name) if "gemm_1" in r["machine"]][-1]
    return (
        f"GEMM float64 {machine['gemm_1']} GFLOP/s in one thread, {machine['gemm_2']} in two; "
        f"copy {machine['memory']} GB/s; load {machine['load']}; revision {machine['revision']}"
    )


def kernel_words() -> str:
    (row,) = rows("first_call", case="kernels")
    return f"{len(row['kernels'])} kernels, {row['seconds']:.1f} s:"


def stability_words() -> str:
    found = rows("stability")
    others = [r["right"] for r in found if "right" in r]
    return (
        f"`ssdr`: {sum(r['passed'] for r in found)} of {len(found)} right. "
        f"Dem Bones: {sum(others)} of {len(others)}."
    )


def ablation_table(effort: str, sequences: Iterable[str]) -> Table:
    return Table(lambda: ablation_rows(effort), {"without": "{step}", **same(*sequences)})


CASES = ("horse_gallop-20", "samba-60", "paper_size-80")
IN_README = ("horse_gallop-20", "samba-20", "cow_elastic-24", "mannequin_rumba-30")
BLOCKS: dict[str, list[str | Callable[[], str]]] = {
    "accuracy": [Table(effort_rows, {
        "sequence": "{sequence}-{bones}", "K": "{influences}", "effort": "{effort}",
        "E": "{E:.3f}", "s": "{seconds:.1f}", "CPU s": "{cpu seconds:.1f}", "plain": "{plain}",
        "E / EA": "{published:.3f}", "load": "{machine[load]}", "revision": "{machine[revision]}",
    })],
    "drawn": [Table(lambda: tables.drawn_rows(rows("race")), {
        "sequence, bones": SEQUENCE, **{
            f"{head}: {what}": f"{{{solver} {key}}}"
            for solver, head in tables.DRAWN.items()
            for key, what in (("E", "E"), ("normals", "normals"))
        }, "revision": "{machine[revision]}",
    })],
    "readme": [Table(lambda: tables.best_known_rows(rows("race"), IN_README), {
        "sequence, bones": SEQUENCE, **{
            head: f"{{{solver} E}}, {{{solver} normals}}"
            for head, solver in {
                "Dem Bones": "best peer", "SSDR 2012": "2012", "ssdr fast": "ssdr fast",
                "balanced": "ssdr balanced", "best": "ssdr best",
            }.items()
        },
        "CPU time": "{balanced cpu ratio:.0f} times less", "revision": "{machine[revision]}",
    })],
    "efforts": [Table(
        lambda: pivot(effort_rows(), SEQUENCE, "{effort}", "{E:.2f} in {cpu seconds:.1f} s"),
        {"sequence, bones": "{line}", **same(*EFFORTS), "plain alternation": "{plain}"},
    )],
    "ablation": [
        "`balanced`:",
        ablation_table("balanced", ablation.SEQUENCES["balanced"]),
        "`best`:",
        ablation_table("best", ablation.SEQUENCES["best"]),
    ],
    "choose_bones": [Table(lambda: choice_rows("bones"), {
        "bones": "{bones}", "RMSE, mm": "{mm:.2f}", "s": "{seconds:.1f}",
    })],
    "choose_influences": [Table(lambda: choice_rows("influences"), {
        "influences": "{influences}", "RMSE, mm": "{mm:.2f}", "pruned from 8, mm": "{pruned:.2f}",
        "s": "{seconds:.1f}",
    })],
    "bone_models": [Table(kind_rows, {
        "sequence, rigid bones": "{line}",
        **same(*FLOATS, "similarity, equal bytes", "affine, equal bytes"),
        "the 2012 author's affine": "{author}",
    })],
    "recovery": [Table(lambda: rows("errors", group="recovery"), {
        "data": "{sequence}", "B": "{bones}", "effort": "{effort}",
        "RMSE / diagonal": "{rmse / diagonal:.1e}", "max / diagonal": "{max / diagonal:.1e}",
        "E": "{E:.2f}", "s": "{seconds:.1f}",
    })],
    "parsimony": [Table(parsimony_rows, {
        "scene": "{scene}", "tolerance": "{tolerance}", "made with": "{made with}",
        "bones": "{bones}", "proven least": "{proven}", "influences": "{influences}",
        "error": "{error / tolerance:.2f}", "one bone less, best of all tries": "{least:.3g}",
        "effort on it": "{effort}", "bytes before and after pruning": "{bytes before:,}, {bytes:,}",
        "CPU s": "{cpu seconds:.1f}",
    })],
    "fewest_bytes": [Table(fewest_rows, {
        "sequence": "{sequence}", "bones, influences": "{bones[bones]}, {bones[influences]}",
        "bytes": "{bones[bytes]:,}", "CPU s": "{bones[cpu_s]:.1f}",
        "in their place": "{means}",
        "bones, influences ": "{bytes[bones]}, {bytes[influences]}", "shapes": "{shapes}",
        "fewest bytes": "{bytes[bytes]:,}", "ratio": "{ratio:.2f}",
        "CPU s ": "{bytes[cpu_s]:.1f}",
    })],
    "ea_bone_bytes": [Table(ea_bone_rows, {
        "model": "{what}", "influences": "{K}", "bytes": "{bytes:,}", "E": "{E:.3f}",
        "E of the file": "{E_of_file:.3f}", "between frames": "{E_between_frames:.2f}",
        "drawn normals": "{normals:.2f}°", "CPU s": "{cpu_s:.1f}",
    })],
    "first_call": [
        "Seconds; dancer_small, 12 bones, effort fast.",
        Table(lambda: rows("first_call")[:-1], {
            "": "{case}", "whole process": "{process:.2f}", "its CPU seconds": "{cpu:.2f}",
            "compiling or loading kernels": "{kernels:.2f}", "solving": "{solve:.2f}",
        }),
        kernel_words,
        Table(lambda: rows("first_call")[-1]["kernels"], {"kernel": "{kernel}", "s": "{s:.1f}"}),
        lambda: tell(rows("first_call")[-1]["machine"]),
    ],
    "steps": [
        Table(lambda: rows("steps"), {
            "case": "{data}-{bones}", "step": "{step}", "threads": "{threads}", "ms": "{ms:.1f}",
            "products, GFLOP": "{GFLOP:.2f}", "products at the GEMM rate, ms": "{floor ms:.1f}",
            "ratio": "{ratio:.1f}", "GEMM, GFLOP/s": "{rate}", "load": "{machine[load]}",
        }),
        "Parts of one outer iteration, one thread, ms (the part's own bound):",
        Table(lambda: part_rows("outer iteration"), {"part": "{part}", **same(*CASES)}),
        "Parts of one polish step, one thread, ms:",
        Table(lambda: part_rows("polish step"), {"part": "{part}", **same(*CASES)}),
        lambda: tell(rows("steps")[-1]["machine"]),
    ],
    "race_errors": [Table(lambda: tables.summaries(rows("race")), {
        "sequence, bones": SEQUENCE, "Dem Bones": "{Dem Bones:.3f}", "regularisers": "{setting}",
        "SSDR 2012": "{SSDR 2012:.3f}", "ssdr fast": "{fast:.3f}", "balanced": "{balanced:.3f}",
        "best": "{best:.3f}", "balanced ÷": "{balanced ratio:.2f}", "best ÷": "{best ratio:.2f}",
    })],
    "race_times": [Table(lambda: tables.summaries(rows("race")), {
        "sequence, bones": SEQUENCE, "Dem Bones, CPU s": "{Dem Bones cpu:.2f}",
        "ssdr, CPU s": "{balanced cpu:.2f}", "ratio": "{balanced cpu ratio:.0f}",
        "threads": "{threads}", "GEMM, GFLOP/s": "{machine[gemm_1]}, {machine[gemm_2]}",
        "copy, GB/s": "{machine[memory]}", "load": "{machine[load]}",
        "revision": "{machine[revision]}",
    })],
    "race_seeds": [Table(tables.seed_rows, {
        "sequence, bones": SEQUENCE, "runs": "{runs}", "least E": "{least:.3f}",
        "most E": "{most:.3f}", "(most - least) / least": "{spread:.1f} %",
        "CPU s a run": "{cpu:.0f}", "revision": "{revision}",
    })],
    "race_apart": [Table(lambda: named(tables.apart_rows()), {
        "sequence, bones": SEQUENCE, "solver": "{name}", "threads": "{threads}",
        "bones in the result": "{bones found}", "E": "{E:.3f}",
    })],
    "sizes": [Table(tables.size_rows, {
        "sequence, bones": SEQUENCE, "K": "{influences}", "KiB": "{KiB:.0f}", "E": "{E:.3f}",
        "E stored": "{E8:.3f}", "E of PCA at these bytes": "{PCA:.3f}",
    }), lambda: rates("front")],
    "scaling": ["Seconds of one call.", Table(lambda: named(tables.sweeps(rows("scaling"))), {
        "solver": "{name}", "over": "{over}", "exponent": "{exponent:.2f}",
        "size: seconds (E)": "{points}",
    }), lambda: rates("scaling")],
    "rest_poses": [Table(rest_rows, {"sequence, bones": "{line}", **same(*REST_POSES.values())})],
    "lit": [Table(lit_rows, {
        "sequence": "{case}", **{
            head: f"{{{key}:.1f}}"
            for program, name in (("three", "three.js"), ("Godot", "Godot"))
            for head, key in (
                (name, program), (f"{name}, before", f"{program} before"),
                (f"{name}, Dem Bones", f"{program} Dem Bones"),
            )
        },
        "Blender": "{Blender:.1f}", "Blender, own normals": "{Blender own normals:.1f}",
        "Blender, Dem Bones": "{Blender Dem Bones:.1f}",
    })],
    "smoothness": [Table(smooth_rows, {
        "sequence, bones": SEQUENCE, "smoothness / diagonal": "{share}",
        "E, fitted frames": "{E:.3f}", "E, frames kept out": "{E kept out:.3f}",
        "mean jump of weights across an edge": "{jump:.3f}",
    })],
    "stability": [stability_words, Table(stability_rows, {
        "": "{first}", "case": "{case}", "ssdr": "{ours}", "right, ssdr": "{passed}",
        "Dem Bones": "{Dem Bones}", "right, Dem Bones": "{right}",
        "what the test would have caught": "{caught}",
    })],
    **{name: [Table(*table)] for name, table in leaderboard.TABLES.items()},
}  # fmt: skip


def renew(text: str) -> str:
    def put(match: re.Match[str]) -> str:
        name = match[1]
        blocks = [block if isinstance(block, str) else block() for block in BLOCKS[name]]
        return "\n\n".join([f"<!-- {name} -->", *blocks, f"<!-- end {name} -->"])

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
