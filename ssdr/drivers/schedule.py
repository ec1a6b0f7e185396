"""Schedules: which stages a call runs, in which order; the numbers are in :mod:`.efforts`.

    fast       a first model; then more bones, merged and moved on a sample of the vertices; polish
    balanced   the stages of "fast"; then relax and polish
    best       several starts, each relaxed and searched; then the best model rebuilt repeatedly

The stages of a schedule run in the order in which they are written.
"""

from __future__ import annotations

from typing import Literal

from ..checks import BoneModel
from ..joints.stages import (
    AddBones,
    AttachToJoints,
    AttachUnattached,
    FreeBones,
    SearchTrees,
    SearchWeights,
    StartOnSkeleton,
)
from ..search.given import Given
from ..search.run import Lowest, Schedule
from ..search.sampling import AllVertices, ReturnToBest, SampleVertices
from ..search.stages import (
    AddAndMerge,
    Alternate,
    Compress,
    Merge,
    MoveBones,
    Polish,
    Relax,
    Search,
    SolveNormals,
)
from ..search.starts import QuickStart, Spread, StartFromModel, StartFromMotion
from .efforts import (
    MANY_BONES,
    NUMBERS,
    REBUILDS,
    SECONDS_OF_A_NUMBER,
    START_SECONDS,
    STARTS_OF_MANY_BONES,
    TREE_ROUNDS,
    TRIALS_OF_A_REBUILD,
    TRIALS_OF_A_START,
    TRIALS_OF_A_TREE,
    Effort,
    Rebuilds,
)

__all__ = [
    "RigKind",
    "from_model",
    "merged_start",
    "normals_last",
    "schedule_for",
    "settling_schedule",
]

RigKind = Literal["none", "loose", "rigid"]


# --- pieces --------------------------------------------------------------------------------------

# A usable model early, without excess bones and before the frames are compressed.
FIRST_MODEL: Schedule = (QuickStart(), Alternate(steps=20, gain=0.01), Compress())
# Five polish steps at each number of influences, of which "best" makes eight.  Smooth motion, such
# as a cloth's, takes many steps at the end, which stop once eight gain less than 0.4 %.
RELAXED: Schedule = (Relax(polish_steps=5, cost=35), Polish(steps=200, gain=0.004, cost=2))
RELAXED_TREE: Schedule = (Relax(polish_steps=6, cost=30), Polish(steps=24, gain=0.01))
ATTACHED: Schedule = (AttachToJoints(), Polish(steps=8))
LAST_OF_TREES = Polish(steps=40, gain=0.002)
# Repeated searches, each from the best tree so far.
TREES_SEARCHED: Schedule = TREE_ROUNDS * (
    ReturnToBest(),
    *RELAXED_TREE,
    SearchTrees(steps=TRIALS_OF_A_TREE, patience=TRIALS_OF_A_TREE),
)


def merged_start(
    before: int,
    after: int,
    *,
    factor: float = 1.6,
    rigid: bool = False,
    influences: int | None = None,
) -> Schedule:
    """Schedule that starts with `factor` times the bones asked for and merges them down.

    `before` and `after` are the most alternations before and after the merge.
    """
    return (
        StartFromMotion(factor=factor, rigid=rigid, influences=influences),
        Alternate(steps=before, rigid=rigid),
        Merge(rigid=rigid),
        Alternate(steps=after, rigid=rigid),
    )


# Bones are placed on a sample of the vertices, which takes a fifth of the time; whether the result
# is better is then decided on all vertices.
PLACED: Schedule = (
    *FIRST_MODEL,
    SampleVertices(),
    *merged_start(12, 6),
    ReturnToBest(),
    MoveBones(steps=24, patience=6),
    AllVertices(alternations=8),
    ReturnToBest(),
    Polish(steps=6),
)


def searched(trials: int) -> Schedule:
    """Schedule that relaxes, polishes, then searches with at most `trials` trials.

    Bones in new places can be judged only after the weights have adapted to them.
    """
    return (Relax(), Polish(steps=8), Search(steps=trials, patience=trials))


def lowest(count: int, start: Schedule) -> Schedule:
    """Schedule that runs `start` `count` times and polishes the model of lowest objective."""
    return (Lowest(starts=count * (start,)), Polish(steps=20, gain=0.01))


# --- free bones ----------------------------------------------------------------------------------


def rebuilds(size: float) -> Rebuilds:
    """Numbers of rebuilds, starts and trials of the effort "best" for a problem of this size."""
    return next(numbers for bound, numbers in REBUILDS if size < bound)


def free_bones(effort: Effort, bones: int, size: float, *, stretching: bool) -> Schedule:
    """Schedule for bones without a hierarchy.

    If bones may stretch (`stretching`), a second start is made from rigid bones.  Bones that
    stretch must keep det > 0 in every step, which blocks many paths from their own start if a part
    of the mesh is thin.  Which of the two starts is better shows only at the end.
    """
    rigid_start = merged_start(12, 6, rigid=True)
    # for a small problem, as many further starts as fit into a tenth of a second
    count = int(0.1 / (START_SECONDS + SECONDS_OF_A_NUMBER * size))
    if effort == "fast" and stretching:
        more = count * (*rigid_start, MoveBones(rigid=True), Polish(steps=8))
        starts = (*merged_start(6, 4), *rigid_start, *more)
        return (*FIRST_MODEL, *starts, ReturnToBest(), Polish(steps=6))
    more = count * (*merged_start(12, 6), MoveBones(), Polish(steps=8))
    placed: Schedule = (*PLACED, *more, ReturnToBest(), Polish(steps=6)) if more else PLACED
    if effort == "fast":
        return placed
    from_rigid = (*rigid_start, Polish(steps=8), *RELAXED) if stretching else ()
    if effort == "balanced":
        # a long polish before the relaxation leads bones that stretch to worse minima
        polish = () if stretching else (Polish(steps=60, gain=0.01),)
        return (*placed, *polish, *RELAXED, *from_rigid)
    n = rebuilds(size)
    many = bones >= MANY_BONES
    first: Schedule = searched(n.trials)
    if many:
        moved = (StartFromMotion(), Alternate(steps=12), AddAndMerge(steps=10, patience=8))
        first = STARTS_OF_MANY_BONES * (*moved, *searched(TRIALS_OF_A_START))
    rebuild = (ReturnToBest(), AddAndMerge(), *searched(min(n.trials, TRIALS_OF_A_REBUILD)))
    # if the animation comes from a skeleton, a tree leads to a model that free bones do not find
    tree = (*merged_start(12, 6, influences=1), MoveBones(), *ATTACHED)
    from_tree: Schedule = (
        *lowest(n.trees, tree),
        FreeBones(
            attached=RELAXED_TREE, searched=TREES_SEARCHED, freed=searched(TRIALS_OF_A_START)
        ),
    )
    return (
        *FIRST_MODEL,
        *first,
        *(() if stretching else from_tree),
        *(from_rigid if n.before else ()),
        *n.before * rebuild,
        # on small smooth motions, such as a beam's, the other starts end with far more error
        *merged_start(12, 6),
        MoveBones(),
        *searched(TRIALS_OF_A_START if many else n.trials),
        *(() if n.before else from_rigid),
        *n.after * rebuild,
        *last_search(n.trials),
    )


def last_search(trials: int) -> Schedule:
    """Schedule that searches around the best model, then polishes it to its minimum."""
    return (
        ReturnToBest(),
        Search(steps=trials, patience=trials),
        ReturnToBest(),
        Polish(steps=60, gain=0.002),
    )


def nothing_to_place(effort: Effort) -> Schedule:
    """Schedule for locked weights or bones: one start and a descent to the nearest minimum."""
    last = Polish(steps=NUMBERS[effort].polish, gain=1e-3)
    return (Compress(), StartFromMotion(), Alternate(steps=10), last)


def smooth(effort: Effort, *, placed: bool) -> Schedule:
    """Schedule under a smoothness penalty, which ends with alternations until the error settles.

    The polish ignores the penalty and cannot be last.  Unless weights or all bones are locked
    (`placed`), a polish and further alternations follow the first ones, since this sometimes lowers
    the penalised error.
    """
    settle = Alternate(steps=NUMBERS[effort].smooth)
    if placed:
        return (Compress(), StartFromMotion(), Alternate(steps=10), settle)
    if effort == "fast":
        start = (*FIRST_MODEL, *merged_start(6, 4), ReturnToBest(), settle)
        return (*start, Polish(steps=6), settle)
    if effort == "balanced":
        start = (*FIRST_MODEL, *merged_start(12, 6), ReturnToBest(), MoveBones(), settle)
        return (*start, *RELAXED, settle)
    start = (*FIRST_MODEL, *merged_start(12, 6), *merged_start(12, 6, factor=2.2))
    last = Polish(steps=60, gain=0.002)
    return (*start, ReturnToBest(), settle, Relax(), last, settle)


# --- bones attached at joints --------------------------------------------------------------------


def tree_of_bones(effort: Effort, size: float) -> Schedule:
    """Schedule for bones with joints whose tree is not known.

    It makes trees from several starts and, unless the effort is "fast", searches for better trees.
    Bones start with one influence per vertex, which makes them compact and the tree over them close
    to the best.  Once the bones are attached, more influences follow.  There are several starts
    because a search ends near its start: of twelve starts on the Fox of the glTF samples, two led
    to the right tree.
    """
    early = (QuickStart(influences=1), Alternate(steps=20, gain=0.01), Compress(), *ATTACHED)
    start = (*merged_start(12, 6, influences=1), MoveBones(), *ATTACHED)
    trees = NUMBERS[effort].trees
    first = (Lowest(starts=(early, *trees * (start,))), Polish(steps=20, gain=0.01))
    if effort == "fast":
        return first
    search = SearchTrees(steps=10, patience=10)
    if effort == "balanced":
        return (*first, *RELAXED_TREE, search, LAST_OF_TREES)
    more = (*lowest(trees, start), *RELAXED_TREE, search)
    searches = rebuilds(size).tree_searches - 1
    return (
        *first, *RELAXED_TREE, search, *searches * more, *TREES_SEARCHED, ReturnToBest(),
        LAST_OF_TREES,
    )  # fmt: skip


def on_skeleton(effort: Effort, given: Given, *, rigid: bool) -> Schedule:
    """Schedule for bones whose tree is known: it finds their weights and motion.

    If the skeleton brings no weights, one start binds vertices to the nearest limb, and others bind
    vertices that move together; the run continues from the lowest objective.
    """
    n, placed = NUMBERS[effort], given.weights is not None
    start: Schedule = (Compress(), StartOnSkeleton())
    settle = Polish(steps=n.polish, gain=1e-3)
    if not rigid:  # loose bones, which start where the skeleton puts them
        relaxed = () if placed or effort == "fast" else (Polish(steps=8), *RELAXED)
        return (*start, Alternate(steps=20, gain=1e-3), *relaxed, settle)
    attached = (*start, AttachToJoints(), Polish(steps=20, gain=0.01))
    if placed:
        return (*attached, settle)
    if effort == "fast":
        return (*attached, AddBones(), Polish(steps=6))
    trials = n.weight_trials
    search = SearchWeights(steps=trials, patience=trials)
    relaxed = (AddBones(), *RELAXED_TREE, search)
    if given.skeleton_skin is None:
        free = (*merged_start(12, 6, influences=1), MoveBones())
        by_motion = (*free, StartOnSkeleton(by_motion=True), *ATTACHED)
        starts = ((*start, *ATTACHED), *n.limbs * (by_motion,))
        attached = (Lowest(starts=starts), Polish(steps=20, gain=0.01))
        if effort == "best":
            attached = (*attached, *relaxed, *lowest(n.limbs, by_motion))
    again = (n.rounds - 1) * (ReturnToBest(), *relaxed)
    return (*attached, *relaxed, *again, ReturnToBest(), LAST_OF_TREES)


# --- from a model --------------------------------------------------------------------------------


def from_model(effort: Effort) -> Schedule:
    """Schedule that starts from a whole model and polishes it."""
    return (StartFromModel(), Compress(), Polish(steps=6 if effort == "fast" else 20, gain=0.01))


def with_joints(effort: Effort, *, rigid: bool, keeps_tree: bool, smoothed: bool) -> Schedule:
    """Schedule that continues from a whole model with joints, or under a smoothness penalty."""
    if smoothed:
        return (StartFromModel(), Compress(), Alternate(steps=NUMBERS[effort].smooth))
    if rigid:
        start: Schedule = (StartFromModel(), Compress(), AttachUnattached())
        searcher = SearchWeights if keeps_tree else SearchTrees
        search = searcher(steps=TRIALS_OF_A_TREE, patience=TRIALS_OF_A_TREE)
        again = (ReturnToBest(), *RELAXED_TREE, search)
        count = {"fast": 0, "balanced": 1, "best": TREE_ROUNDS}[effort]
        return (*start, *count * again, ReturnToBest(), LAST_OF_TREES)
    # loose joints of a skeleton
    relaxed = () if effort == "fast" else (*RELAXED, ReturnToBest())
    return (*from_model(effort), *relaxed, Polish(steps=20, gain=0.01))


# --- which of them -------------------------------------------------------------------------------


def normals_last(schedule: Schedule) -> Schedule:
    """The schedule with normals in the objective from its last polish on."""
    last = max((k for k, stage in enumerate(schedule) if isinstance(stage, Polish)), default=None)
    if last is None:
        return schedule
    return (*schedule[:last], SolveNormals(), *schedule[last:])


def schedule_for(
    effort: Effort,
    *,
    bone_model: BoneModel,
    bones: int,
    given: Given,
    placed: bool,
    smoothed: bool,
    size: float,
    rig: RigKind = "none",
) -> Schedule:
    """Schedule of a call, without normals in the objective.

    Parameters
    ----------
    effort : {"fast", "balanced", "best"}
    bone_model : {"rigid", "similarity", "affine"}
    bones : int
    given : Given
    placed : bool
        Whether weights or all bones are locked.
    smoothed : bool
        Whether there is a penalty on the weights.
    size : float
        Number of vertices × frames × bones.
    rig : {"none", "loose", "rigid"}
        Kind of joints.
    """
    if given.free:
        if rig == "rigid" or given.keeps_tree or smoothed:
            tree = given.keeps_tree
            return with_joints(effort, rigid=rig == "rigid", keeps_tree=tree, smoothed=smoothed)
        given = given.beside_model()
    if given.tree is not None:
        return on_skeleton(effort, given, rigid=rig == "rigid")
    if rig == "rigid":
        return tree_of_bones(effort, size)
    if smoothed:
        return smooth(effort, placed=placed)
    if placed:
        return nothing_to_place(effort)
    stretching = bone_model != "rigid" and given.transforms is None
    return free_bones(effort, bones, size, stretching=stretching)


def settling_schedule(effort: Effort, *, smoothed: bool) -> Schedule:
    """Schedule for a model that was found on some frames and carried over to more frames."""
    steps = NUMBERS[effort].settle
    if smoothed:
        return (Spread(), Alternate(steps=steps, gain=0.002, cost=6))
    return (Spread(), Polish(steps=steps, gain=0.002))
