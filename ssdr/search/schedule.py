"""The order of the solver's steps, for every effort.

start -> alternate                                      a first model, soon
start -> alternate -> merge -> alternate -> re-seed -> relax -> polish
start -> alternate -> relax -> search, then time and again regrow -> relax -> search
spread -> polish                                        a model of some frames, on more
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Literal

from ..solver.model import Fixed
from .problem import Given

__all__ = ["EFFORTS", "Op", "make_plan", "plan_print", "settling_plan"]

Phase = Literal[
    "quick", "compress", "start", "alternate", "merge", "reseed", "regrow", "relax", "search",
    "polish", "recall", "spread",
]  # fmt: skip

_SETTLING = {"fast": 6, "balanced": 20, "best": 60}  # steps of a polish on more frames


@dataclasses.dataclass(frozen=True)
class Op:
    """One entry of the plan.

    `count` steps at most; `amount` is the bones to start with relative to those
    asked for (start), alternations a step (merge, reseed) or after each change of a step
    (regrow), polish steps at each number of influences (relax); failures in a row at
    which to stop (`patience`: reseed, search, regrow, where 0 is one step whatever comes
    of it), relative gain at which to stop (`tolerance`: of three alternations, of eight
    polish steps) or that makes a try a success (of the objective, search); ratio to the
    objective of the search that ended lowest, after as many tries, at which a search
    gives up (`race`: before the first, after four or more; 0, never); `cost` in
    alternations a step, for the time left; draws of its own, from those of an `aside`
    start on: given up, it leaves no trace in what comes after (`aside`); with rigid
    bones whatever was asked for (`rigid`).
    """

    phase: Phase
    count: int = 1
    amount: float = 0.0
    patience: int = 0
    tolerance: float = 0.0
    cost: float = 1.0
    race: tuple[float, float] = (0.0, 0.0)
    aside: bool = False
    rigid: bool = False


# On the frames as they are and without a bone too many: what it finds is soon there to be
# had, and now and then stays the best.
_FIRST = [Op("quick", cost=8), Op("alternate", count=20, tolerance=0.01), Op("compress", cost=4)]


def _begin(factor: float, first: int, second: int) -> list[Op]:
    return [
        Op("start", amount=factor, cost=8),
        Op("alternate", count=first),
        Op("merge", count=1000, amount=4, cost=20),
        Op("alternate", count=second),
    ]


def _polish(count: int, tolerance: float) -> Op:
    return Op("polish", count=count, tolerance=tolerance, cost=6)


_RESEED = Op("reseed", count=16, amount=4, patience=4, cost=6)
_MOST_EXTRA = 4  # influences more for a while: a vertex of the polish costs (K + 2)² numbers
_RELAX = Op("relax", count=_MOST_EXTRA, amount=8, cost=40)


def _search(count: int, race: tuple[float, float] = (0.0, 0.0)) -> Op:
    return Op("search", count=count, patience=count, tolerance=1e-3, cost=60, race=race)


# "best", by vertices × frames × bones: tries at first; how often the model is rebuilt before
# the merged start and after it; tries in the end
_BEST = {1e7: (6, 0, 4, 6), 2e6: (10, 0, 6, 10), 0.0: (10, 6, 6, 10)}
_MOST_TRIES, _RACE = 6, (1.08, 1.02)  # of what was rebuilt
# From so many bones on alternations alone put many of them in better places; and now and
# then a start ends where no rebuilding helps: so there are some, and few tries of each.
_MANY_BONES, _STARTS, _START_TRIES = 24, 3, 4


def _best(tries: int, before: int, after: int, last: int, *, many_bones: bool) -> list[Op]:
    """A start relaxed and searched; then the best model rebuilt time and again.

    What bones in other places are worth shows only once influences and weights have
    followed them: each change is relaxed, polished and searched before it is judged.
    Which start leads further shows only once it has been rebuilt, too: where that takes
    seconds, the first model is, before another is set beside it.
    """

    def judged(tries: int) -> list[Op]:
        return [_RELAX, _polish(8, 0.0), _search(tries, _RACE)]

    first, begun = [*_FIRST, *judged(tries)], tries
    if many_bones:
        start = [
            Op("start", amount=1.0, cost=8), Op("alternate", count=12),
            Op("regrow", count=10, amount=3, patience=8, cost=20), *judged(_START_TRIES),
        ]  # fmt: skip
        first, begun = [*_FIRST, *_STARTS * start], _START_TRIES
    # small smooth motions, such as a beam's, are where the other starts end far above it
    merged = [*_begin(1.6, 12, 6), _RESEED, *judged(begun)]
    merged = [dataclasses.replace(op, aside=True) for op in merged]
    rebuild = [Op("recall", cost=0), Op("regrow", amount=3, cost=20)]
    rebuild += judged(min(tries, _MOST_TRIES))
    return [
        *first, *before * rebuild, *merged, *after * rebuild,
        Op("recall", cost=0), _search(last), Op("recall", cost=0), _polish(60, 0.002),
    ]  # fmt: skip


_RELAXED = [dataclasses.replace(_RELAX, amount=6, cost=30), _polish(40, 0.01)]
EFFORTS: dict[str, list[Op]] = {
    "fast": [*_FIRST, *_begin(1.6, 6, 4), Op("recall", cost=0), _polish(6, 0.0)],
    "balanced": [
        *_FIRST,
        *_begin(1.6, 12, 6),
        Op("recall", cost=0),
        _RESEED,
        *_RELAXED,
    ],
}
# where there is a penalty, of which the changes that follow a start know nothing
_PLAIN: dict[str, list[Op]] = {
    "fast": [_polish(6, 0.0)],
    "balanced": _RELAXED,
    "best": [_RELAX, _polish(60, 0.002)],
}
_SMOOTH_BEST = [*_FIRST, *_begin(1.6, 12, 6), *_begin(2.2, 12, 6), Op("recall", cost=0)]


def make_plan(
    effort: str, *, fixed: Fixed, bones: int, given: Given, smooth: bool, size: float
) -> list[Op]:
    """The plan of an effort, less what fixed parts and smoothness rule out.

    `size` is vertices × frames × bones.
    """
    if effort != "best":
        plan = list(EFFORTS[effort])
    elif smooth:
        plan = list(_SMOOTH_BEST)
    else:
        counts = next(counts for least, counts in _BEST.items() if size >= least)
        plan = _best(*counts, many_bones=bones >= _MANY_BONES)
    all_bones = fixed.bones is not None and bool(fixed.locked(bones).all())
    if given.weights is not None or all_bones:
        # nothing to place: one start, then down to the nearest minimum
        steps = {"fast": 10, "balanced": 40, "best": 120}[effort]
        plan = [
            Op("compress", cost=4), Op("start", amount=1.0, cost=8),
            Op("alternate", count=10), _polish(steps, 1e-3),
        ]  # fmt: skip
    elif fixed.bone_model != "rigid" and given.transforms is None and not smooth:
        plan = _with_rigid_start(plan, effort)
    if smooth:
        # the polish does not know the penalty: alternate until it settles; then once more from
        # where the polish goes without it, which now and then leads further
        steps = {"fast": 20, "balanced": 100, "best": 400}[effort]
        without = [op for op in plan if op.phase not in ("polish", "relax", "search")]
        settle = Op("alternate", count=steps)
        again = [] if given.weights is not None or all_bones else [*_PLAIN[effort], settle]
        plan = [*without, settle, *again]
    return plan


def _with_rigid_start(plan: list[Op], effort: str) -> list[Op]:
    """The plan of bones that stretch, lest they end above rigid ones.

    A bone may not turn inside out on its way, and where a part is thin that bars many a
    way from its own start. Which start leads further shows only in the end.
    """
    start = [dataclasses.replace(op, rigid=True) for op in _begin(1.6, 12, 6)]
    if effort != "fast":
        start += [_polish(8, 0.0), *_RELAXED]
    start = [dataclasses.replace(op, aside=True) for op in start]
    # what is recalled after it may then be either
    recalled = next(k for k, op in enumerate(plan) if op.phase == "recall")
    at = len(plan) if effort == "balanced" else recalled
    return [*plan[:at], *start, *plan[at:]]


def settling_plan(effort: str, smooth: bool) -> list[Op]:
    """What a model of some frames goes through when it is carried to more of them."""
    steps = Op(
        "alternate" if smooth else "polish", count=_SETTLING[effort], tolerance=0.002, cost=6
    )
    return [Op("spread", cost=12), steps]


def plan_print(plan: list[Op]) -> str:
    """Tells the steps of one version of this package from those of another."""
    return hashlib.sha256(repr([plan, sorted(_SETTLING.items())]).encode()).hexdigest()
