"""Put the latest results into the pages: what stands between two markers is written anew.

    python benchmarks/tools/pages.py [--check]

Markers are <!-- NAME --> and <!-- end NAME -->; --check only says whether a page is out of date.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.accuracy.efforts import CASES, EFFORTS
from benchmarks.common import RESULTS, ROOT, table, tell
from benchmarks.peers.charts import STYLE

PAGES = [
    ROOT / "benchmarks" / "README.md",
    *(
        ROOT / "docs" / f"{name}.md"
        for name in ("decompose", "benchmarks", "how-to-choose", "parsimony", "stability")
    ),
]


def read(name: str) -> dict[str, Any]:
    return dict(json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8")))


def accuracy_rows() -> list[dict[str, Any]]:
    """Those of accuracy/efforts.py, and of the race where it is that which runs the case."""
    own = {(r["case"], r["effort"]): r for r in read("accuracy")["rows"]}
    race = {
        (r["case"], r["K"], r["solver"]): r
        for r in read("race")["rows"]
        if r["threads"] == 1 and not r["failed"]
    }
    rows = []
    for case, effort in itertools.product(CASES, EFFORTS):
        if not case.raced:
            if (case.name, effort) in own:
                rows.append(own[case.name, effort])
        elif (row := race.get((case.name, case.influences, f"ssdr {effort}"))) is not None:
            rows.append({
                "case": case.name, "K": case.influences, "effort": effort, "E": row["E"],
                "wall": row["total wall"], "cpu seconds": row["total cpu"], "plain": case.plain,
                "core": case.core, "peers": case.peers, "E / core": row["E"] / case.core,
                "E / EA": None, "load": row["load"], "revision": row["revision"],
            })  # fmt: skip
    return rows


def accuracy() -> str:
    rows = []
    for row in accuracy_rows():
        rows.append({
            "sequence": row["case"], "K": row["K"], "effort": row["effort"],
            "E": f"{row['E']:.3f}", "s": f"{row['wall']:.1f}", "CPU s": f"{row['cpu seconds']:.1f}",
            "plain": row["plain"], "first bound": row["core"], "harder bound": row["peers"],
            "E / first bound": f"{row['E / core']:.2f}",
            "E / EA": None if row["E / EA"] is None else f"{row['E / EA']:.3f}",
            "load": row["load"], "revision": row.get("revision"),
        })  # fmt: skip
    return table(rows, list(rows[0]))


def efforts() -> str:
    """One row a sequence."""
    found: dict[str, dict[str, Any]] = {}
    for row in accuracy_rows():
        line = found.setdefault(row["case"], {"sequence, bones": row["case"].replace("-", ", ")})
        line[row["effort"]] = f"{row['E']:.2f} in {row['cpu seconds']:.1f} s"
        line["plain alternation"] = row["plain"]
    rows = list(found.values())
    return table(rows, ["sequence, bones", "fast", "balanced", "best", "plain alternation"])


def steps() -> str:
    results = read("steps")
    rows = [
        {
            "case": r["case"],
            "step": r["step"],
            "threads": r["threads"],
            "ms": f"{r['ms']:.1f}",
            "products, GFLOP": f"{r['GFLOP']:.2f}",
            "products at the GEMM rate, ms": f"{r['floor ms']:.1f}",
            "ratio": f"{r['times floor']:.1f}",
            "GEMM, GFLOP/s": r["gemm_1" if r["threads"] == 1 else "gemm_2"],
            "load": r["load"],
        }
        for r in results["steps"]
    ]
    out = [table(rows, list(rows[0]))]
    for step in ("outer iteration", "polish step"):
        one = [r for r in results["steps"] if r["step"] == step and r["threads"] == 1]
        parts = [
            {"part": name} | {r["case"]: part_beside_bound(r, name) for r in one}
            for name in one[0]["parts ms"]
        ]
        beside = " (the part's own bound)" if one[0].get("bounds ms") else ""
        title = f"Parts of one {step}, one thread, ms{beside}:"
        out.append(title + "\n\n" + table(parts, list(parts[0])))
    memory = [
        {
            "case": r["case"],
            "input as float64, MiB": f"{r['float64 MiB']:.0f}",
            "peak, MiB": f"{r['peak MiB']:.0f}",
            "before the call, MiB": f"{r['before MiB']:.0f}",
        }
        for r in results["memory"]
    ]
    out.append("Peak memory of the process:\n\n" + table(memory, list(memory[0])))
    out.append(tell(results["steps"][-1]))
    return "\n\n".join(out)


def part_beside_bound(row: dict[str, Any], part: str) -> str:
    bound = row.get("bounds ms", {}).get(part)
    return f"{row['parts ms'][part]:.1f}" + ("" if bound is None else f" ({bound:.1f})")


def first_call() -> str:
    results = read("first_call")
    names = {
        "process": "whole process",
        "kernels": "compiling or loading kernels",
        "solve": "solving",
    }
    rows = [
        {"": r["what"]} | {title: f"{r[k]:.2f}" for k, title in names.items() if k in r}
        for r in results["waits"]
    ]
    kernels = [{"kernel": r["kernel"], "s": f"{r['s']:.1f}"} for r in results["kernels"]]
    return "\n\n".join([
        f"Seconds; {results['sample']}.", table(rows, ["", *names.values()]),
        f"{len(kernels)} kernels, {results['all kernels']:.1f} s:", table(kernels, ["kernel", "s"]),
        tell(results),
    ])  # fmt: skip


def recovery() -> str:
    results = read("recovery")
    rows = [
        {
            "data": r["data"],
            "B": r["B"],
            "effort": r["effort"],
            "RMSE / diagonal": f"{r['rmse / diagonal']:.1e}",
            "max / diagonal": f"{r['max / diagonal']:.1e}",
            "E": f"{r['E']:.2f}",
            "s": f"{r['seconds']:.1f}",
        }
        for r in results["recovered"]
    ]
    walks = [
        {
            "data": r["data"],
            "effort": r["effort"],
            "models re-skinned": r["stops"],
            "first": f"{r['first']:.1e}",
            "last": f"{r['last']:.1e}",
            "largest rise, relative": f"{r['largest rise, relative']:.0e}",
        }
        for r in results["walks"]
    ]
    return table(rows, list(rows[0])) + "\n\n" + table(walks, list(walks[0]))


def choose_bones() -> str:
    rows = [
        {"bones": r["B"], "RMSE, mm": f"{r['rmse mm']:.2f}", "s": f"{r['s']:.1f}"}
        for r in read("choose")["bones"]
    ]
    return table(rows, list(rows[0]))


def bone_models() -> str:
    """One row a sequence, a column a kind of bones."""
    found: dict[tuple[str, int], dict[str, Any]] = {}
    for r in read("bone_models")["rows"]:
        if r["effort"] != "balanced":
            continue
        line = found.setdefault(
            (r["data"], r["rigid bones"]),
            {"sequence, rigid bones": f"{r['data']}, {r['rigid bones']}"},
        )
        title = r["bone_model"]
        if r["compared at"] == "equal bytes":
            title += ", equal bytes"
        line[title] = f"{r['E']:.3f}" + (
            f" ({r['bones']} bones)" if r["compared at"] == "equal bytes" else ""
        )
        if r["author's affine"]:
            line["the 2012 author's affine"] = r["author's affine"]
    columns = [
        "sequence, rigid bones",
        "rigid",
        "similarity",
        "affine",
        "similarity, equal bytes",
        "affine, equal bytes",
        "the 2012 author's affine",
    ]
    return table(list(found.values()), columns)


def choose_influences() -> str:
    rows = [
        {
            "influences": r["K"],
            "RMSE, mm": f"{r['rmse mm']:.2f}",
            "pruned from 8, mm": f"{r['pruned mm']:.2f}",
            "s": f"{r['s']:.1f}",
        }
        for r in read("choose")["influences"]
    ]
    return table(rows, list(rows[0]))


def rates(row: dict[str, Any]) -> str:
    return (
        f"GEMM float64 {row['gemm_1']} GFLOP/s in one thread, {row['gemm_2']} in two; "
        f"copy {row['memory']} GB/s; load {row['load']}; revision {row['revision']}"
    )


def figure(value: float | None, digits: int = 3) -> str | None:
    return None if value is None else f"{value:.{digits}f}"


def words(case: str) -> str:
    return case.replace("-", ", ")


def parsimony() -> str:
    rows = []
    for r in read("parsimony")["scenes"]:
        less, times = r["B - 1"], r["times"]
        rows.append(
            {
                "scene": r["scene"],
                "tolerance": r["tolerance"],
                "made with": r["made with"],
                "bones": r["B"],
                "proven least": r["least by rank"],
                "influences": r["K"],
                "error": f"{r['error / tolerance']:.2f}",
                "one bone less, best of all tries": None if less is None else f"{less:.3g}",
                "effort on it": f"{times:.1f} times"
                if times
                else None
                if less is None
                else "proven",
                "bytes before and after pruning": f"{r['bytes with all']:,}, {r['bytes']:,}",
                "CPU s": f"{r['CPU s']:.1f}",
            }
        )
    return table(rows, list(rows[0]))


def race_run() -> str:
    results = read("race")
    rows = [r for r in results["rows"] if r["load"] is not None]
    clock = {"cpu": "CPU seconds", "wall": "seconds"}[results["clock"]]
    threads = " and ".join(str(n) for n in sorted({r["threads"] for r in rows}))
    loads = sorted(r["load"] for r in rows)
    rates = sorted(r["gemm_1"] for r in rows)
    return (
        f"The run shown: {len(results['summary'])} sequences and {len(results['apart'])} apart, on "
        f"{threads} thread{'s' * (threads != '1')}; charts in {clock}; load {loads[0]} to "
        f"{loads[-1]}; GEMM float64 in one thread {rates[0]} to {rates[-1]} GFLOP/s. "
        "What has no figure was not run."
    )


def race_errors() -> str:
    rows = [
        {
            "sequence, bones": words(r["case"]),
            "Dem Bones": f"{r['Dem Bones']:.3f}",
            "regularisers": r["setting"],
            "SSDR 2012": figure(r["2012"]),
            "ssdr fast": figure(r["fast"]),
            "balanced": figure(r["balanced"]),
            "best": figure(r["best"]),
            "balanced ÷": figure(r["balanced / Dem Bones"], 2),
            "best ÷": figure(r["best / Dem Bones"], 2),
            "balanced, rest fixed ÷": figure(r["balanced fixed / Dem Bones"], 2),
            "best, rest fixed ÷": figure(r["best fixed / Dem Bones"], 2),
        }
        for r in read("race")["summary"]
    ]
    return table(rows, list(rows[0]))


def race_times() -> str:
    rows = []
    found = read("race")["summary"]
    for r in found:
        row = {"sequence, bones": words(r["case"])}
        for clock in ("cpu", "wall"):
            short = {"cpu": "CPU s", "wall": "s"}[clock]
            row |= {
                f"Dem Bones, {short}": figure(r[f"Dem Bones {clock} s"], 2),
                f"ssdr, {short}": figure(r[f"balanced {clock} s"], 2),
                f"ratio, {short}": figure(r[f"times faster, balanced, {clock}"], 0),
                f"rest fixed, ratio, {short}": figure(
                    r[f"times faster, balanced fixed, {clock}"], 0
                ),
            }
        row["threads"] = ", ".join(map(str, r["threads tried"]))
        row["GEMM, GFLOP/s"] = f"{r['gemm_1']}, {r['gemm_2']}"
        row["copy, GB/s"], row["load"], row["revision"] = r["memory"], r["load"], r["revision"]
        rows.append(row)
    return table(rows, list(rows[0]))


def race_seeds() -> str:
    path = RESULTS / "seeds.json"
    if not path.exists():
        return "Not run."
    rows = [
        {
            "sequence, bones": words(r["case"]),
            "runs": r["runs"],
            "least E": figure(r["least"]),
            "most E": figure(r["most"]),
            "(most - least) / least": f"{100 * r['spread']:.1f} %",
            "CPU s a run": f"{r['CPU s']:.0f}",
            "revision": r.get("revision"),
        }
        for r in json.loads(path.read_text(encoding="utf-8"))["rows"]
    ]
    return table(rows, list(rows[0]))


def race_apart() -> str:
    results = read("race")
    cases = {r["case"] for r in results["apart"]}
    rows = [
        {
            "sequence, bones": words(r["case"]),
            "solver": STYLE[r["solver"]][0],
            "threads": r["threads"],
            "bones in the result": r["bones found"],
            "E": figure(r["E"]),
            "failed": r["failed"],
        }
        for r in results["rows"]
        if r["case"] in cases
    ]
    if not rows:
        return "None was run."
    return table(
        rows, [*list(rows[0])[:5], *(["failed"] if any(r["failed"] for r in rows) else [])]
    )


def race_history() -> str:
    # below that the error is rounding, and there is nothing to compare
    found = [r for r in read("race")["walks"] if r["E"] > 1e-4]
    worst = max(found, key=lambda r: abs(r["E"] / r["history"] - 1))
    return (
        f"At {len(found)} stops of {len({r['case'] for r in found})} runs the error of the "
        f"re-skinned model and the one that the history states differ by at most "
        f"{abs(worst['E'] / worst['history'] - 1):.1e} of it "
        f"({words(worst['case'])} bones, iteration {worst['iteration']})."
    )


def sizes() -> str:
    rows = [
        {
            "sequence, bones": words(r["case"]),
            "K": r["K"],
            "KiB": f"{r['bytes8'] / 1024:.0f}",
            "E": figure(r["E"]),
            "E stored": figure(r["E8"]),
            "E of PCA at these bytes": figure(r["PCA at these bytes"]),
        }
        for r in read("front")["rows"]
        if r["solver"] == "ssdr balanced" and r["K"] == 4 and r["E"] is not None
    ]
    rows.sort(
        key=lambda r: (r["sequence, bones"].split(",")[0], int(r["sequence, bones"].split(",")[1]))
    )
    return table(rows, list(rows[0])) + "\n\n" + rates(read("front")["rows"][-1])


def scaling() -> str:
    results = read("scaling")
    rows = []
    for r in results["rows"]:
        key = {
            "solver": r["solver"].replace("dembones 0", "Dem Bones, regularisers 0"),
            "over": {"F": "frames", "V": "vertices", "B": "bones"}[r["over"]],
            "exponent": f"{r['exponent']:.2f}",
        }
        if not rows or any(rows[-1][k] != v for k, v in key.items()):
            rows.append(key | {"size: seconds (E)": ""})
        mark = ", " if rows[-1]["size: seconds (E)"] else ""
        rows[-1]["size: seconds (E)"] += f"{mark}{r['size']}: {r['seconds']:.1f} ({r['E']:.1f})"
    clock = {"cpu": "CPU seconds", "wall": "Seconds"}[results["clock"]]
    return f"{clock} of one call.\n\n{table(rows, list(rows[0]))}\n\n{rates(results['rows'][-1])}"


def rest_poses() -> str:
    found: dict[str, dict[str, Any]] = {}
    names = {
        "ssdr balanced": "solved, from frame 0",
        "ssdr balanced middle": "solved, from the middle",
        "ssdr balanced fixed": "fixed at frame 0",
        "ssdr balanced fixed middle": "fixed at the middle",
    }
    for r in read("choices")["rows"]:
        if r["solver"] in names:
            case = f"{r['sequence']}, {r['bones']}"
            line = found.setdefault(case, {"sequence, bones": case})
            line[names[r["solver"]]] = figure(r["E"])
    return table(list(found.values()), ["sequence, bones", *names.values()])


def smoothness() -> str:
    rows = [
        {
            "sequence, bones": f"{r['sequence']}, {r['bones']}",
            "smoothness / diagonal": r["solver"].split()[1],
            "E, fitted frames": figure(r["E"]),
            "E, frames kept out": figure(r["E kept out"]),
            "mean jump of weights across an edge": figure(r["jump"]),
        }
        for r in read("choices")["rows"]
        if r["solver"].startswith("smooth")
    ]
    rows.sort(key=lambda r: (r["sequence, bones"], float(r["smoothness / diagonal"])))
    return table(rows, list(rows[0]))


def stability() -> str:
    rows = []
    seen = None
    results = read("stability")["rows"]
    for r in results:
        mine = re.sub(r" \(\d+ such.*", "", r["outcome"]).replace("|", "/")
        if r["outcome"] == "solved":
            mine = "passes" if r["figure"] is None else f"error {r['figure']:.1e}"
            if r["bound"] is not None and r["figure"] is not None:
                mine += f" (may be {r['bound']:.1e})"
        theirs = r.get("Dem Bones", "not run")
        rows.append(
            {
                "": r["number"] if r["number"] != seen else None,
                "case": r["case"],
                "ssdr": ("" if r["passed"] else "FAILS: ") + mine,
                "right, ssdr": "yes" if r["passed"] else "no",
                "Dem Bones": theirs,
                "right, Dem Bones": {True: "yes", False: "no"}.get(r.get("Dem Bones right")),
                "what the test would have caught": r["catches"] if r["number"] != seen else None,
            }
        )
        seen = r["number"]
    others = [r for r in results if "Dem Bones right" in r]
    lines = (
        f"`ssdr`: {sum(r['passed'] for r in results)} of {len(results)} right. "
        f"Dem Bones: {sum(r['Dem Bones right'] for r in others)} of {len(others)}."
    )
    return f"{lines}\n\n{table(rows, list(rows[0]))}"


def soak() -> str:
    """Of each what it found, if it was run."""
    lines = []
    if (RESULTS / "soak.json").is_file():
        long = read("soak")
        others = len(long["failures"]) - long["hangs"] - long["crashes"]
        text = (
            f"The soak shown: {long['seconds'] / 3600:.1f} h, {long['cases']} problems, "
            f"{long['cpu seconds']:.0f} CPU seconds, {long['iterations']} iterations; hangs "
            f"{long['hangs']}, crashes {long['crashes']}, other faults {others}; revision "
            f"{long['revision']}."
        )
        for part in long["memory"][-1:]:
            text += (
                f" Memory of the process: {part['median of the first quarter']:.0f} MiB in the "
                f"first quarter after warm-up, {part['median of the last quarter']:.0f} MiB in "
                f"the last (medians)."
            )
        lines.append(text)
    if (RESULTS / "fuzz.json").is_file():
        files = read("fuzz")
        text = (
            f"The fuzz shown: {files['files']} files of {len(files['formats'])} kinds, "
            f"{files['refused']} refused, faults {len(files['failures'])}; revision "
            f"{files['revision']}."
        )
        for fault in files["failures"]:
            text += f" Seed {fault['seed']}: {fault['fault']}."
        lines.append(text)
    return "\n\n".join(lines) or "None is shown."


PARTS: dict[str, Callable[[], str]] = {
    "accuracy": accuracy, "efforts": efforts, "steps": steps, "first_call": first_call,
    "recovery": recovery, "choose_bones": choose_bones, "choose_influences": choose_influences,
    "bone_models": bone_models, "parsimony": parsimony,
    "race_run": race_run, "race_errors": race_errors, "race_times": race_times,
    "race_seeds": race_seeds,
    "race_apart": race_apart,
    "race_history": race_history, "sizes": sizes, "scaling": scaling, "rest_poses": rest_poses,
    "smoothness": smoothness, "stability": stability, "soak": soak,
}  # fmt: skip


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
