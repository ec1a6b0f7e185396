"""Score a solver or a model file on the sequences of the leaderboard.

    python benchmarks/leaderboard/score.py --solver mine.py            # every case
    python benchmarks/leaderboard/score.py --solver mine.py --only cat_poses "affine given"
    python benchmarks/leaderboard/score.py --solver "ssdr best" --only "horse_gallop-20 K4"
    python benchmarks/leaderboard/score.py --model mine.npz --sequence horse_gallop
    python benchmarks/leaderboard/score.py --together 2 --anew         # what the page's tables show
    python benchmarks/leaderboard/score.py --report                    # those tables' rows, no runs

mine.py has a function, solve (benchmarks/peers/slot.py says what it gets and returns); a model is
what ssdr.load_skinning reads, or an npz with rest, weights (V, B) and transforms (F, B, 3, 4).  A
solver may also be one of "ssdr fast", "ssdr balanced", "ssdr best", "ssdr expressions" (of faces),
"2012" and "dembones", and is then asked what it can answer.  What is missing is named before
anything runs.  A run that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.common import Row
from benchmarks.leaderboard.catalogue import FACES, SEQUENCES, Sequence
from benchmarks.peers import dem_bones, slot
from benchmarks.peers.model_size import sparse

# Sequence, numbers of bones, influences beside dense weights.
ENTRIES = [
    ("cat_poses", (10, 15, 20, 25), 4), ("horse_poses", (10, 20), 4),
    ("horse_gallop", (10, 20, 30), 4), ("cow_elastic", (24,), 4), ("samba", (20,), 4),
    ("ea_bone", (5, 10, 20), 8),
]  # fmt: skip
# Bones, influences and bone models of Kavan et al. 2024; the tables have ours alone with 200.
FACE_SIZES = ((40, 8, ("rigid", "affine")), (200, 32, ("rigid",)))
EXPRESSIONS = "ssdr expressions"
# Dense weights here take minutes with "balanced": the tables have "fast".
LARGE = {
    ("horse_gallop", 20), ("horse_gallop", 30), ("cow_elastic", 24), ("samba", 20), ("ea_bone", 20),
}  # fmt: skip
OURS = ("ssdr fast", "ssdr balanced", "ssdr best", EXPRESSIONS)
KEPT = ("2012", "dembones")  # rigid bones, a rest pose that is given
PUBLISHED = {"ea_bone": "ea_ref_Decomposition_{:02}.npz"} | {
    name: f"le_{name}_{{}}.npz" for name in ("cat_poses", "horse_poses", "horse_gallop")
}
COLUMNS = ("E", "2 E / diagonal", "largest %", "STED", "cpu seconds", "defects", "failed", "before")


# --- cases ---------------------------------------------------------------------------------------


def case(sequence: str, bones: int, influences: int, bone_model: str, rest: str) -> Row:
    return {
        "sequence": sequence, "bones": bones, "influences": influences, "bone_model": bone_model,
        "rest": rest,
    }  # fmt: skip


def questions() -> Iterator[Row]:
    """Every case of the leaderboard, without its solver.

    The faces of Kavan et al. are among them where they have been fetched or are asked for.
    """
    for sequence, numbers, influences in ENTRIES:
        for bones in numbers:
            for k in dict.fromkeys((min(influences, bones), bones)):
                for bone_model in ("rigid", "affine"):
                    for rest in ("given", "solved"):
                        yield case(sequence, bones, k, bone_model, rest)
    for sequence in ("ict_face_expressions", *FACES):
        known = sequence not in FACES or common.sequence_file(sequence).is_file()
        if known or sequence in " ".join(sys.argv):
            for bones, k, kinds in FACE_SIZES:
                for bone_model in kinds:
                    yield case(sequence, bones, k, bone_model, "given")


def is_dense(asked: Row) -> bool:
    return bool(asked["influences"] == asked["bones"] > 8)


def can_answer(solver: str, asked: Row) -> bool:
    """Whether a solver of this folder can be asked a case."""
    if solver == EXPRESSIONS:
        return SEQUENCES[asked["sequence"]].neutral and asked["rest"] == "given"
    if solver in KEPT:
        kept = asked["bone_model"] == "rigid" and asked["rest"] == "given"
        return kept and asked["influences"] <= 8
    if solver == "published":
        if asked["sequence"] not in PUBLISHED or asked["rest"] != "solved" or is_dense(asked):
            return False
        return asked["bone_model"] == ("rigid" if asked["sequence"] == "ea_bone" else "affine")
    return True


def of_tables(asked: Row) -> Iterator[str]:
    """Solvers that the tables of the page have for a case."""
    if can_answer(EXPRESSIONS, asked):
        yield EXPRESSIONS
    if asked["bones"] == FACE_SIZES[1][0]:
        return
    large = is_dense(asked) and (asked["sequence"], asked["bones"]) in LARGE
    yield "ssdr fast" if large else "ssdr balanced"
    yield from (solver for solver in ("published", *KEPT) if can_answer(solver, asked))


def cases(solver: str | None, sequence: str | None = None) -> dict[str, Row]:
    """Cases by name: those of the tables, or of one solver; of all sequences, or of one."""
    found = {}
    for asked in questions():
        if sequence not in (None, asked["sequence"]):
            continue
        for one in of_tables(asked) if solver is None else [solver]:
            if can_answer(one, asked):
                name = f"{describe(asked)}, {Path(one).stem if slot.is_own(one) else one}"
                found[name] = asked | {"solver": one}
    return found


def describe(asked: Row) -> str:
    k = "dense" if is_dense(asked) else f"K{asked['influences']}"
    return f"{asked['sequence']}-{asked['bones']} {k} {asked['bone_model']} {asked['rest']}"


def check(chosen: list[Row]) -> None:
    """End with a word about what is missing."""
    for solver in {row["solver"] for row in chosen}:
        if slot.is_own(solver):
            slot.solver_of(solver)
        elif solver == "dembones":
            common.require_package("py_dem_bones", "bench")
    common.require(row["sequence"] for row in chosen)
    for row in chosen:
        if row["solver"] == "published":
            slot.read(published_file(row["sequence"], row["bones"]))


def published_file(sequence: str, bones: int) -> Path:
    return common.data_file(f"reference/{PUBLISHED[sequence].format(bones)}")


# --- one case ------------------------------------------------------------------------------------


def problem(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, str, float]:
    """Frames, faces, the rest pose that is given, where it is from, and the diagonal.

    The given rest pose is the published one or the neutral face where there is one, else frame 0.
    """
    sequence = SEQUENCES[name]
    frames, faces = common.load(name)
    with np.load(common.sequence_file(name)) as archive:
        rest = archive["rest"] if "rest" in archive else frames[0]
        source = "published" if "rest" in archive else "frame 0"
    diagonal = float(np.linalg.norm(np.ptp(rest, axis=0)))
    if sequence.neutral:
        frames, source = frames[1:], "neutral face"
    if source == "frame 0" and sequence.diagonal is not None:
        diagonal = sequence.diagonal
    return frames, faces, np.asarray(rest, dtype=np.float64), source, diagonal


def measure(
    sequence: str, bones: int, influences: int, bone_model: str, rest: str, solver: str
) -> Row:
    """Row of a case; a solver that fails has the reason in its row."""
    frames, faces, pose, source, diagonal = problem(sequence)
    solve = solver_of(solver, sequence)
    kept = pose if rest == "given" else None
    began, cpu = time.perf_counter(), time.process_time()
    try:
        parts = solve(
            frames, faces, bones=bones, influences=influences, bone_model=bone_model, rest=kept
        )
    except SystemExit as error:  # of what it returned; the other cases go on
        return {"failed": str(error)}
    except Exception as error:
        return {"failed": f"{type(error).__name__}: {error}"[:300]}
    seconds = {"seconds": time.perf_counter() - began, "cpu seconds": time.process_time() - cpu}
    defects = common.defects(parts._replace(bone_model=bone_model), bones, influences)
    if kept is not None and np.abs(parts.rest - kept).max() > 1e-6 * diagonal:
        defects.append("the rest pose that was given is not kept")
    found = score(SEQUENCES[sequence], frames, faces, parts, diagonal)
    # of a model that others published, only the error is known
    seconds = {} if solver == "published" else seconds
    return found | {"defects": ", ".join(defects), "rest from": source, **seconds}


def score(
    sequence: Sequence, frames: np.ndarray, faces: np.ndarray, parts: slot.Parts, diagonal: float
) -> Row:
    """Errors of a model, by plain skinning of its arrays in float64."""
    import ssdr

    skinned = common.reskin(parts.rest, *sparse(parts.weights), parts.transforms)
    off = np.abs(skinned - frames)
    e = common.error_e(frames, skinned)
    largest = float(np.sqrt((off**2).sum(axis=2).max()))
    sted = ssdr.metrics.sted(ssdr.MeshSequence(frames, faces), skinned)
    row: Row = {
        "E": e,
        "2 E / diagonal": 2 * e / diagonal,
        "largest": largest,
        "largest %": 100 * largest / diagonal,
        "STED": sted.spatial if sequence.poses else sted.value,
        "bones found": parts.transforms.shape[1],
        "influences found": int((parts.weights > 0).sum(axis=1).max()),
    }
    if sequence.millimetres:  # as Kavan et al. 2024: of coordinates, not of distances
        row["MXE"], row["MAE"] = (sequence.millimetres * float(x) for x in (off.max(), off.mean()))
        moved = np.abs(parts.transforms - np.eye(3, 4)).max(axis=(2, 3)) > 1e-12
        row["numbers"] = int(moved.sum()) * (6 if parts.bone_model == "rigid" else 12)
    return row


def solver_of(name: str, sequence: str) -> Callable[..., slot.Parts]:
    """Function that is called like `solve` of a file."""
    if slot.is_own(name):
        return slot.solver_of(name)
    if name in OURS or name == "2012":
        common.compile_kernels()
    kind, *effort = name.split()
    return {
        "ssdr": lambda *data, **asked: ours(*data, **asked, effort=effort[0]),
        "2012": le_deng_2012,
        "dembones": dem_bones_best,
        "published": lambda *_, bones, **__: slot.read(published_file(sequence, bones)),
    }[kind]


def ours(
    frames: np.ndarray, faces: np.ndarray, *, rest: np.ndarray | None, effort: Any, **asked: Any
) -> slot.Parts:
    """`ssdr.decompose` with positions as its only aim."""
    import ssdr

    if effort == "expressions":
        face = ssdr.decompose_expressions(rest, frames, faces=faces, **asked).skinning.skinning
        parts = slot.parts_of(dataclasses.replace(face, clips=None), "ssdr")
        return parts._replace(transforms=parts.transforms[1::2])
    start = None if rest is None else ssdr.Kept(rest=rest)
    free: Row = {"rest_pose": "free", "normals": False}
    result = ssdr.decompose(frames, faces, effort=effort, start=start, **free, **asked)
    return slot.parts_of(result.skinning, "ssdr", frames.shape)


def le_deng_2012(
    frames: np.ndarray, faces: np.ndarray, *, bone_model: str, **asked: Any
) -> slot.Parts:
    import ssdr

    return slot.parts_of(ssdr.ssdr2012(frames, faces, **asked).skinning, "2012", frames.shape)


def dem_bones_best(
    frames: np.ndarray, faces: np.ndarray, *, bones: int, influences: int, rest: Any, **_: Any
) -> slot.Parts:
    """Dem Bones without regularisers, which has less error; the best of 100 iterations."""
    solver = dem_bones.prepared(frames, faces, bones, influences, rest=rest, regularised=False)
    _, best = dem_bones.lowest(frames, rest, dem_bones.iterates(solver, len(frames), 100))
    if best is None:
        raise ValueError("no finite model")
    return slot.Parts(rest, *best)


# --- the command line ----------------------------------------------------------------------------


def before(asked: Row, rows: dict[str, Row]) -> str:
    """Least error that the leaderboard has for a case, and whose it is."""
    fields = ("sequence", "bones", "influences", "bone_model", "rest")
    same = [r for r in rows.values() if all(r[k] == asked[k] for k in fields) and "E" in r]
    best = min((r for r in same if not r["defects"]), key=lambda r: r["E"], default=None)
    return "" if best is None else f"{best['E']:.4g} {best['solver']}"


def score_file(path: str, name: str) -> None:
    """Print the score of a model file, and below it what the leaderboard has for its bones."""
    common.require([name])
    frames, faces, _, _, diagonal = problem(name)
    parts = slot.read(path, frames.shape)
    row = score(SEQUENCES[name], frames, faces, parts, diagonal)
    bones, k = row["bones found"], row["influences found"]
    row["defects"] = ", ".join(common.defects(parts, bones, k))
    words = f"{name}-{bones} K{k} {parts.bone_model}, {Path(path).name}"
    known = common.read_rows(common.RESULTS / "leaderboard.json")
    same = [
        {"case": n, **r} for n, r in known.items() if (r["sequence"], r["bones"]) == (name, bones)
    ]
    shown = ["case", *COLUMNS[:4], "MXE", "MAE", "numbers", "defects"]
    print(common.table([{"case": words, **row}, *same], shown))


def main() -> None:
    own = argparse.ArgumentParser(add_help=False)
    own.add_argument("--solver", metavar="FILE|NAME", help="by default those of the tables")
    own.add_argument("--model", metavar="FILE", help="score a model, with --sequence")
    own.add_argument("--sequence", metavar="NAME", help="what the model is of; for solvers, all")
    args = own.parse_known_args()[0]
    if args.sequence and args.sequence not in SEQUENCES:
        raise SystemExit(f"--sequence: {args.sequence}: there are {', '.join(SEQUENCES)}")
    if args.model:
        if not args.sequence:
            raise SystemExit("--model needs --sequence, the name of what it is a model of")
        score_file(args.model, args.sequence)
        return
    named = (*OURS, *KEPT, "published")
    if args.solver and not slot.is_own(args.solver) and args.solver not in named:
        raise SystemExit(f"no solver {args.solver}: a Python file, or one of {', '.join(named)}")
    out = common.RESULTS / "leaderboard.json"
    if args.solver:
        out = common.ROOT / "out" / "leaderboard" / f"{Path(args.solver).stem}.json"
    known = common.read_rows(common.RESULTS / "leaderboard.json") if args.solver else {}
    columns = [c for c in COLUMNS if c != "before" or args.solver]

    def asked(**row: Any) -> Row:
        command = f'score.py --solver "{row["solver"]}" --only "{describe(row)}"'
        found = {"command": command, **measure(**row)}
        return found | ({"before": before(row, known)} if known else {})

    named_cases = cases(args.solver, args.sequence)
    common.run(__file__, __doc__, named_cases, asked, columns, check=check, out=out, own=own)


if __name__ == "__main__":
    main()
