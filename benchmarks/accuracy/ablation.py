"""What does each step of a search bring, and what does it cost?

    python benchmarks/accuracy/ablation.py                        # hours
    python benchmarks/accuracy/ablation.py --only "balanced, relaxing" "balanced, nothing"

A case is a sequence, an effort and the step that is left out, which is replaced by one that does
nothing.  "a search beside it" adds four trials where "balanced" has relaxed.  Ratios are to the
case in which nothing is left out, of the same seed.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.common import Row
from ssdr.search import bone_steps, moves, schedules
from ssdr.search.steps import solve_normals

SEEDS = {"balanced": 3, "best": 1}  # the first few
SEQUENCES = {  # bones
    "balanced": {
        "horse_gallop": 10, "samba": 20, "ea_bone": 10, "cow_elastic": 24, "mannequin_rumba": 20,
        "morph_stress": 9,
    },
    "best": {"ea_bone": 10, "morph_stress": 9, "dancer_small": 8},
}  # fmt: skip


def nothing(*_: Any, **__: Any) -> None:
    """A step that is left out."""


def on_all(d: Any, schedule: Any, **_: Any) -> bool:
    """What a sample does where there is none."""
    schedule(d)
    return False


def only_normals(d: Any, **_: Any) -> None:
    solve_normals(d)


def then_search(d: Any, relaxed: Any = schedules.place_and_relax) -> None:
    relaxed(d)
    bone_steps.search(d, steps=4)


def without(change: Any) -> dict[str, Any]:
    return {"CHANGES": tuple(kept for kept in bone_steps.CHANGES if kept is not change)}


LEFT_OUT: dict[str, dict[str, Any]] = {
    "nothing": {},
    "sample": {"on_sample": on_all},
    "merged start": {"merged_start": nothing},
    "moves of bones": {"move_bones": nothing},
    "merged start and moves": {"merged_start": nothing, "move_bones": nothing},
    "relaxing": {"relax": nothing},
    "last polish": {"last_polish": only_normals},
}
ONLY_BALANCED = {"(a search beside it)": {"place_and_relax": then_search}}
ONLY_BEST = {
    "search": {"search": nothing},
    "rebuilds": {"rebuild": nothing},
    "trees": {"start_from_tree": nothing},
    "merged start": {"search_merged": nothing},
    "exchange of bones": without(moves.exchange_bones),
    "exchange of influences": without(moves.exchange_influences),
    "alternations on trial": without(moves.alternate_some),
}


def cases() -> Iterator[tuple[str, Row]]:
    def case(effort: str, step: str, sequence: str, bones: int, seed: int) -> tuple[str, Row]:
        row = {"effort": effort, "step": step, "sequence": sequence, "bones": bones, "seed": seed}
        return f"{effort}, {step}, {sequence}, seed {seed}", row

    for effort, sequences in SEQUENCES.items():
        for seed in range(SEEDS[effort]):
            for step in {**LEFT_OUT, **(ONLY_BEST if effort == "best" else ONLY_BALANCED)}:
                for sequence, bones in sequences.items():
                    yield case(effort, step, sequence, bones, seed)


def measure(effort: Any, step: str, sequence: str, bones: int, seed: int) -> Row:
    frames, faces = common.load(sequence)
    replaced = {**LEFT_OUT, **ONLY_BALANCED, **(ONLY_BEST if effort == "best" else {})}[step]
    common.compile_kernels()
    with contextlib.ExitStack() as stack:
        for name, value in replaced.items():
            homes = [home for home in (schedules, bone_steps) if hasattr(home, name)]
            for home in homes:
                stack.enter_context(mock.patch.object(home, name, value))
        start = time.process_time()
        made = ssdr.decompose(frames, faces, bones=bones, effort=effort, rng=seed)
        seconds = time.process_time() - start
    error, normals = common.e_of(frames, made.skinning), made.normals
    degrees = None if normals is None else normals.mean
    return {"E": error, "degrees": degrees, "cpu seconds": seconds}


if __name__ == "__main__":
    common.run(__file__, __doc__, dict(cases()), measure, ("E", "degrees", "cpu seconds"))
