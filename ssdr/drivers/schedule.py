"""Which stages in which order, for every effort.

    fast       a first model, soon; bones too many, merged and re-seeded on a sample; polish
    balanced   the same; then relax and polish
    best       a start relaxed and searched; then the best model rebuilt time and again

Every schedule reads from top to bottom.  Bones that stretch, a smoothness penalty and parts
that the caller prescribed have schedules of their own.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Literal, get_args

from ..joints.stages import Contend, Hang, SearchTrees, SearchWeights, Sprout, StartOnSkeleton
from ..search.prescribed import Prescribed
from ..search.run import Stage
from ..search.sampling import Everywhere, Recall, Sample
from ..search.stages import (
    Alternate,
    Compress,
    Merge,
    Polish,
    QuickStart,
    Regrow,
    Relax,
    Reseed,
    Search,
    Spread,
    Start,
)
from ..solver.model import Fixed

__all__ = [
    "Effort",
    "HierarchyKind",
    "Schedule",
    "fingerprint",
    "schedule_for",
    "settling_schedule",
]

Effort = Literal["fast", "balanced", "best"]
HierarchyKind = Literal["none", "loose", "rigid"]
Schedule = tuple[Stage, ...]

# On the frames as they are and without a bone too many: a usable model early, which now and then
# stays the best.
FIRST_MODEL: Schedule = (QuickStart(), Alternate(steps=20, gain=0.01), Compress())

# The longest part of "balanced": four polish steps a number of influences, where "best" takes
# eight, and an end where eight steps gain less than 1 % of the error.
RELAXED: Schedule = (Relax(polish_steps=4, cost=30), Polish(steps=40, gain=0.01))


def merged_start(
    factor: float,
    before: int,
    after: int,
    *,
    branch: bool = False,
    rigid: bool = False,
    influences: int | None = None,
) -> Schedule:
    """Start with `factor` times the bones asked for and merge them down.

    `before` and `after` are the most alternations on either side of the merge.
    """
    return (
        Start(factor=factor, branch=branch, rigid=rigid, influences=influences),
        Alternate(steps=before, branch=branch, rigid=rigid),
        Merge(branch=branch, rigid=rigid),
        Alternate(steps=after, branch=branch, rigid=rigid),
    )


# --- rigid bones, nothing prescribed -----------------------------------------------------------

# What a sample of the vertices tells of where bones belong costs a fifth of what all of them do,
# and all of them judge it in the end.
PLACED: Schedule = (
    *FIRST_MODEL,
    Sample(),
    *merged_start(1.6, 12, 6),
    Recall(),
    Reseed(steps=24, patience=6),
    Everywhere(alternations=8),
    Recall(),
    Polish(steps=6),
)

FAST: Schedule = PLACED

BALANCED: Schedule = (*PLACED, *RELAXED)


@dataclasses.dataclass(frozen=True)
class _Tries:
    """How much "best" searches, by the size of the problem.

    Attributes
    ----------
    first : int
        Tries of the search of a start.
    before, after : int
        How often the best model is rebuilt before the merged start is set beside it, and after.
    last : int
        Tries of the search in the end.
    """

    first: int
    before: int
    after: int
    last: int


# Chosen by hand on a dozen sequences.  Small problems, below 2e6 vertices × frames ×
# bones: where a rebuild takes seconds the first model is rebuilt six times before the merged
# start is set beside it (ea_bone with 5 bones: 3.95 for 4.48 without).  Large ones, above 1e7:
# four rebuilds in place of six, for the time that they take.
_SMALL = _Tries(first=10, before=6, after=6, last=10)
_MIDDLE = _Tries(first=10, before=0, after=6, last=10)
_LARGE = _Tries(first=6, before=0, after=4, last=6)
_MIDDLE_SIZE, _LARGE_SIZE = 2e6, 1e7
_MOST_TRIES_OF_A_REBUILD = 6
# A search gives up that is behind the best one by 8 % before its first try, or by 2 % later.
_RACE = (1.08, 1.02)
# From so many bones on alternations alone put many of them in better places; and now and then a
# start ends where no rebuilding helps: so there are several, with few tries of each.
_MANY_BONES, _STARTS, _TRIES_OF_A_START = 24, 3, 4


def judged(tries: int, *, branch: bool = False) -> Schedule:
    """Relax, polish, search: bones in new places can be judged only after the weights adapt."""
    return (
        Relax(branch=branch),
        Polish(steps=8, branch=branch),
        Search(steps=tries, patience=tries, race=_RACE, branch=branch),
    )


def best(bones: int, size: float, *, stretching: bool) -> Schedule:
    """A start relaxed and searched; then the best model so far rebuilt time and again.

    Which start leads further shows only once it has been rebuilt, too: where that takes
    seconds, the first model is, before another is set beside it.
    """
    tries = _LARGE if size >= _LARGE_SIZE else _MIDDLE if size >= _MIDDLE_SIZE else _SMALL
    regrown_start = (
        Start(),
        Alternate(steps=12),
        Regrow(steps=10, patience=8),
        *judged(_TRIES_OF_A_START),
    )
    many = bones >= _MANY_BONES
    rebuild = (Recall(), Regrow(), *judged(min(tries.first, _MOST_TRIES_OF_A_REBUILD)))
    rigid_first = rigid_start("best") if stretching else ()
    return (
        *FIRST_MODEL,
        *(_STARTS * regrown_start if many else judged(tries.first)),
        *(rigid_first if tries.before else ()),
        *tries.before * rebuild,
        # on small smooth motions, such as a beam's, the other starts end far above this one
        *merged_start(1.6, 12, 6, branch=True),
        Reseed(branch=True),
        *judged(_TRIES_OF_A_START if many else tries.first, branch=True),
        *(() if tries.before else rigid_first),
        *tries.after * rebuild,
        Recall(),
        Search(steps=tries.last, patience=tries.last),
        Recall(),
        Polish(steps=60, gain=0.002),
    )


# --- bones that stretch ------------------------------------------------------------------------


def rigid_start(effort: Effort) -> Schedule:
    """A start from rigid bones, beside the one from bones that stretch.

    A bone may not turn inside out on its way, and where a part is thin that bars many a way
    from its own start.  Which start leads further shows only in the end.
    """
    start = merged_start(1.6, 12, 6, branch=True, rigid=True)
    if effort == "fast":
        return start
    settle = (Polish(steps=8), *RELAXED)
    return (*start, *(dataclasses.replace(stage, branch=True) for stage in settle))


FAST_STRETCHING: Schedule = (
    *FIRST_MODEL,
    *merged_start(1.6, 6, 4),
    *rigid_start("fast"),
    Recall(),
    Polish(steps=6),
)

BALANCED_STRETCHING: Schedule = (*BALANCED, *rigid_start("balanced"))


# --- weights or all bones prescribed -----------------------------------------------------------


def nothing_to_place(effort: Effort) -> Schedule:
    """One start, then down to the nearest minimum."""
    steps = {"fast": 10, "balanced": 40, "best": 120}[effort]
    return (
        Compress(),
        Start(),
        Alternate(steps=10),
        Polish(steps=steps, gain=1e-3),
    )


# --- a penalty on weights that are not smooth --------------------------------------------------


def smooth(effort: Effort, *, placed: bool) -> Schedule:
    """The polish does not know the penalty: alternate until that settles.

    Then once more from where the polish leads without it, which now and then is further.
    `placed`: weights or all bones are prescribed.
    """
    settle = Alternate(steps={"fast": 20, "balanced": 100, "best": 400}[effort])
    if placed:
        return (Compress(), Start(), Alternate(steps=10), settle)
    if effort == "fast":
        return (
            *FIRST_MODEL,
            *merged_start(1.6, 6, 4),
            Recall(),
            settle,
            Polish(steps=6),
            settle,
        )
    if effort == "balanced":
        return (
            *FIRST_MODEL,
            *merged_start(1.6, 12, 6),
            Recall(),
            Reseed(),
            settle,
            *RELAXED,
            settle,
        )
    return (
        *FIRST_MODEL,
        *merged_start(1.6, 12, 6),
        *merged_start(2.2, 12, 6),
        Recall(),
        settle,
        Relax(),
        Polish(steps=60, gain=0.002),
        settle,
    )


# --- bones that hang on joints ------------------------------------------------------------------

# Bones of one influence are compact: a tree over them is close to the one that is looked for,
# and what they cannot move alone the other influences take up once they hang.
_FIRST_TREE: Schedule = (
    QuickStart(influences=1),
    Alternate(steps=20, gain=0.01),
    Compress(),
    Hang(),
    Polish(steps=8),
)


def tree_start(factor: float = 1.6, *, branch: bool = False) -> Schedule:
    """Compact bones, merged and moved about, then hung and relaxed."""
    return (
        *merged_start(factor, 12, 6, branch=branch, influences=1),
        Reseed(branch=branch),
        Hang(branch=branch),
        Polish(steps=8, branch=branch),
    )


# Which tree a search ends on is decided where it starts: of a dozen starts on the fox of glTF's
# samples two lead to the right tree, the others to five times its error or more, however long they
# are searched.  After eight polish steps the lowest are the same as in the end: so many begin, and
# the lowest goes on.
_FEW_TREES, _TREES = 3, 6
# Searches of the lowest of so many, with "best", by the size of the problem: on exact data one in
# four ends on the skeleton itself.
_SEARCHES_SMALL, _SEARCHES_MIDDLE, _SEARCHES_LARGE = 6, 4, 3
# Then the lowest is relaxed and searched time and again, two tries of each change a time.  Against
# 24 to 48 tries at one go, E of cow_elastic with 24 bones is 7.14 for 7.36, of horse_gallop with 20
# 1.91 for 1.94, and the body of garmentnet is found whole, for 14 of its 17 joints.
_TIMES, _TRIES_A_TIME = 6, 14
# Of the weights on a skeleton that was handed over: horse_gallop 1.74 for 1.81 with one time.
_TIMES_OF_WEIGHTS = 3
# Starts from free bones where the skeleton brings no weights: the lowest goes on, and once more.
# On the fox each takes two seconds.
_STARTS_BY_MOTION = 4
# A search of trees gives up that is this many times behind before its first try, and later.
_RACE_OF_TREES = (4.0, 1.5)
_RELAXED_TREE: Schedule = (Relax(polish_steps=6, cost=30), Polish(steps=24, gain=0.01))
_LAST_OF_TREES = Polish(steps=40, gain=0.002)


def best_of(starts: int, start: Schedule) -> Schedule:
    """The lowest of so many starts, and of one where one is set aside already."""
    each = (*start, Contend())
    return (*(starts - 1) * each, *start, Contend(last=True), Polish(steps=20, gain=0.01))


def rigid_joints(effort: Effort, size: float) -> Schedule:
    """A tree early, then better ones; searched, as long as the effort allows."""
    if effort == "fast":
        return (*_FIRST_TREE, Contend(), *best_of(1, tree_start()))
    first = (*_FIRST_TREE, Contend())
    if effort == "balanced":
        search = SearchTrees(steps=10, patience=10)
        return (*first, *best_of(_FEW_TREES, tree_start()), *_RELAXED_TREE, search, _LAST_OF_TREES)
    search = SearchTrees(steps=10, patience=10, race=_RACE_OF_TREES)
    searched = (*best_of(_TREES, tree_start()), *_RELAXED_TREE, search)
    below = _SEARCHES_MIDDLE if size >= _MIDDLE_SIZE else _SEARCHES_SMALL
    count = _SEARCHES_LARGE if size >= _LARGE_SIZE else below
    longer = SearchTrees(steps=_TRIES_A_TIME, patience=_TRIES_A_TIME)
    again = (Recall(), *_RELAXED_TREE, longer)
    return (*first, *count * searched, *_TIMES * again, Recall(), _LAST_OF_TREES)


def on_skeleton(effort: Effort, *, placed: bool, rigid: bool, skinned: bool) -> Schedule:
    """Weights and motion of bones whose tree is known; `placed`: the weights are, too.

    `skinned`: the skeleton brings weights to start from.  Without them the vertices near each limb
    are one start, those that move together another, and the lower goes on.
    """
    steps = {"fast": 10, "balanced": 40, "best": 120}[effort]
    start: Schedule = (Compress(), StartOnSkeleton())
    settle = Polish(steps=steps, gain=1e-3)
    if not rigid:  # bones that are free, from where the skeleton puts them
        relaxed = () if placed or effort == "fast" else (Polish(steps=8), *RELAXED)
        return (*start, Alternate(steps=20, gain=1e-3), *relaxed, settle)
    hung = (*start, Hang(), Polish(steps=20, gain=0.01))
    if placed:
        return (*hung, settle)
    if effort == "fast":
        return (*hung, Sprout(), Polish(steps=6))
    longest = effort == "best"
    tries = 16 if longest else 4
    relaxed = (Sprout(), *_RELAXED_TREE, SearchWeights(steps=tries, patience=tries))
    if not skinned:
        hang = (Hang(), Polish(steps=8))
        place = (*merged_start(1.6, 12, 6, influences=1), Reseed())
        by_motion = (*place, StartOnSkeleton(matched=True), *hang)
        lowest = best_of(_STARTS_BY_MOTION if longest else 1, by_motion)
        hung = (*start, *hang, Contend(), *lowest)
        if longest:
            hung = (*hung, *relaxed, *lowest)
    again = _TIMES_OF_WEIGHTS - 1 if longest else 0
    return (*hung, *relaxed, *again * (Recall(), *relaxed), Recall(), _LAST_OF_TREES)


# --- which of them -----------------------------------------------------------------------------


def schedule_for(
    effort: Effort,
    *,
    fixed: Fixed,
    bones: int,
    prescribed: Prescribed,
    smoothed: bool,
    size: float,
    hierarchy: HierarchyKind = "none",
) -> Schedule:
    """The schedule of a call.

    Parameters
    ----------
    effort : {"fast", "balanced", "best"}
    fixed : Fixed
    bones : int
    prescribed : Prescribed
    smoothed : bool
        Whether there is a penalty on weights.
    size : float
        Vertices × frames × bones.
    hierarchy : {"none", "loose", "rigid"}
    """
    if prescribed.skeleton is not None:
        placed = prescribed.weights is not None
        skinned = prescribed.skin is not None
        return on_skeleton(effort, placed=placed, rigid=hierarchy == "rigid", skinned=skinned)
    if hierarchy == "rigid":
        return rigid_joints(effort, size)
    all_bones = fixed.bones is not None and bool(fixed.locked(bones).all())
    placed = prescribed.weights is not None or all_bones
    if smoothed:
        return smooth(effort, placed=placed)
    if placed:
        return nothing_to_place(effort)
    stretching = fixed.bone_model != "rigid" and prescribed.transforms is None
    if effort == "best":
        return best(bones, size, stretching=stretching)
    if stretching:
        return FAST_STRETCHING if effort == "fast" else BALANCED_STRETCHING
    return FAST if effort == "fast" else BALANCED


def settling_schedule(effort: Effort, *, smoothed: bool) -> Schedule:
    """What a model of some frames goes through when it is carried over to more of them."""
    steps = {"fast": 6, "balanced": 20, "best": 60}[effort]
    if smoothed:
        return (Spread(), Alternate(steps=steps, gain=0.002, cost=6))
    return (Spread(), Polish(steps=steps, gain=0.002))


def fingerprint(schedule: Schedule) -> str:
    """Tells the stages of one version of this package from those of another."""
    settling = [settling_schedule(e, smoothed=False) for e in get_args(Effort)]
    return hashlib.sha256(repr((schedule, settling)).encode()).hexdigest()
