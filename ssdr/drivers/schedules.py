"""Schedules: what a call does, step by step; the numbers are in :mod:`.efforts`.

fast       a first model; then more bones, merged and moved on a sample of the vertices; polish
balanced   the same; then relax and polish
best       several starts, each relaxed and searched; then the best model rebuilt repeatedly
"""

from __future__ import annotations

from functools import partial
from typing import Literal

from ..joints.steps import (
    add_bones,
    attach,
    attach_unattached,
    search_trees,
    search_weights,
    start_on_skeleton,
)
from ..search.changing import add_and_merge, merge, move_bones, search
from ..search.descent import Descent, Schedule
from ..search.starts import fit_copied_bones, quick_start, start, start_from_model
from ..search.steps import (
    all_vertices,
    alternate,
    beside,
    compress,
    lowest,
    polish,
    relax,
    return_to_best,
    sample_vertices,
    solve_normals,
    unfold,
)
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

__all__ = ["RigKind", "follow_effort", "merged_start", "settle"]

RigKind = Literal["none", "loose", "rigid"]

# Ratio of a tree's objective to the best one up to which the tree is improved.
_PROMISING = 4.0


# --- pieces --------------------------------------------------------------------------------------


def first_model(d: Descent, *, influences: int | None = None) -> None:
    """A usable model early, without excess bones and before the frames are compressed."""
    quick_start(d, influences=influences)
    alternate(d, steps=20, gain=0.01)
    compress(d)


def merged_start(
    d: Descent,
    before: int = 12,
    after: int = 6,
    *,
    factor: float = 1.6,
    influences: int | None = None,
) -> None:
    """Start with `factor` times the bones asked for and merge them down.

    `before` and `after` are the most alternations before and after the merge.
    """
    start(d, factor=factor, influences=influences)
    alternate(d, steps=before)
    merge(d)
    alternate(d, steps=after)


def place_bones(d: Descent) -> None:
    """Place bones on a sample of the vertices, which takes a fifth of the time.

    Whether the result is better is then decided on all vertices.
    """
    first_model(d)
    sample_vertices(d)
    merged_start(d)
    return_to_best(d)
    move_bones(d, steps=24, patience=6)
    all_vertices(d, alternations=8)
    return_to_best(d)


def relax_and_search(d: Descent, trials: int) -> None:
    """Relax, polish, then search: bones in new places are judged once weights have adapted."""
    relax(d)
    polish(d, steps=8)
    search(d, steps=trials)


def relax_bones(d: Descent) -> None:
    """Relax with five polish steps at each number of influences, of which "best" makes eight."""
    relax(d, polish_steps=5)
    polish(d, steps=200, gain=0.004)


def last_polish(d: Descent, *, steps: int, gain: float = 0.0) -> None:
    """A polish in which normals count, too."""
    solve_normals(d)
    polish(d, steps=steps, gain=gain)


def relax_tree(d: Descent) -> None:
    relax(d, polish_steps=6)
    polish(d, steps=24, gain=0.01)


def start_of_tree(d: Descent) -> None:
    """Bones with one influence per vertex are compact, and the tree over them close to the best."""
    merged_start(d, influences=1)
    move_bones(d)
    attach(d)
    polish(d, steps=8)


def lowest_tree(d: Descent, *starts: Schedule) -> None:
    lowest(d, *starts)
    polish(d, steps=20, gain=0.01)


def search_best_trees(d: Descent) -> None:
    """Repeated searches, each from the best tree so far."""
    for _ in range(TREE_ROUNDS):
        return_to_best(d)
        relax_tree(d)
        search_trees(d, steps=TRIALS_OF_A_TREE)


# --- free bones ----------------------------------------------------------------------------------


def rebuilds(size: float) -> Rebuilds:
    """Numbers of rebuilds, starts and trials of the effort "best" for a problem of this size."""
    return next(numbers for bound, numbers in REBUILDS if size < bound)


def free_bones(d: Descent, effort: Effort, size: float, *, stretching: bool) -> None:
    """Bones without a hierarchy.

    If bones may stretch (`stretching`), a second start is made from rigid bones.  Bones that
    stretch must keep det > 0 in every step, which blocks many paths from their own start if a part
    of the mesh is thin.  Which of the two starts is better shows only at the end.
    """
    # for a small problem, as many further starts as fit into a tenth of a second
    count = int(0.1 / (START_SECONDS + SECONDS_OF_A_NUMBER * size))
    if effort == "fast" and stretching:
        first_model(d)
        merged_start(d, 6, 4)
        start_from_rigid(d)
    else:
        place_bones(d)
        if count:
            polish(d, steps=6)
    for _ in range(count):
        if effort == "fast" and stretching:
            with d.rigid_bones():
                merged_start(d)
                move_bones(d)
        else:
            merged_start(d)
            move_bones(d)
        polish(d, steps=8)
    if count or (effort == "fast" and stretching):
        return_to_best(d)
    if effort == "fast":
        last_polish(d, steps=6)
        return
    polish(d, steps=6)
    if stretching:
        relax_bones(d)
        relax_from_rigid(d)
        return
    # with bones that stretch, a long polish before the relaxation leads to worse minima
    polish(d, steps=60, gain=0.01)
    # Five polish steps in place of two end 1 % lower to 2 % higher on six sequences, at 1.2 times
    # the time.  Smooth motion, such as a cloth's, takes many steps at the end.
    relax(d, polish_steps=2)
    last_polish(d, steps=200, gain=0.004)


def start_from_rigid(d: Descent) -> None:
    with d.rigid_bones():
        merged_start(d)


def relax_from_rigid(d: Descent) -> None:
    start_from_rigid(d)
    polish(d, steps=8)
    relax_bones(d)


def best_bones(d: Descent, size: float, *, stretching: bool) -> None:
    """Free bones with the effort "best"."""
    n, many = rebuilds(size), d.bones >= MANY_BONES
    first_model(d)
    if many:
        for _ in range(STARTS_OF_MANY_BONES):
            start(d)
            alternate(d, steps=12)
            add_and_merge(d, steps=10, patience=8)
            relax_and_search(d, TRIALS_OF_A_START)
    else:
        relax_and_search(d, n.trials)
    if not stretching:
        start_from_tree(d, n.trees)
    elif n.before:
        relax_from_rigid(d)
    for _ in range(n.before):
        rebuild(d, n.trials)
    # on small smooth motions, such as a beam's, the other starts end with far more error
    merged_start(d)
    move_bones(d)
    relax_and_search(d, TRIALS_OF_A_START if many else n.trials)
    if stretching and not n.before:
        relax_from_rigid(d)
    for _ in range(n.after):
        rebuild(d, n.trials)
    return_to_best(d)
    search(d, steps=n.trials)
    return_to_best(d)
    last_polish(d, steps=60, gain=0.002)


def rebuild(d: Descent, trials: int) -> None:
    return_to_best(d)
    add_and_merge(d)
    relax_and_search(d, min(trials, TRIALS_OF_A_REBUILD))


def start_from_tree(d: Descent, trees: int) -> None:
    """Make a tree, improve it, drop it and improve the freed bones.

    If the animation comes from a skeleton, a tree leads to a model that free bones do not find: it
    becomes the best model, and better trees are searched before it is dropped.  If its objective is
    more than four times the best one, it is given up at once.
    """
    lowest_tree(d, *trees * (start_of_tree,))
    best = d.best_value
    if not d.below(_PROMISING * best, expected=True):
        d.model = d.best_model.with_restarted_support()
        return
    relax_tree(d)
    if d.below(best, expected=False):
        search_best_trees(d)
    d.drop_tree()
    relax_and_search(d, TRIALS_OF_A_START)


def nothing_to_place(d: Descent, effort: Effort) -> None:
    """Locked weights or bones: one start and a descent to the nearest minimum."""
    compress(d)
    start(d)
    alternate(d, steps=10)
    last_polish(d, steps=NUMBERS[effort].polish, gain=1e-3)


def smooth(d: Descent, effort: Effort, *, placed: bool) -> None:
    """A smoothness penalty: alternations until the error settles, since the polish ignores it.

    Unless weights or all bones are locked (`placed`), a polish and further alternations follow the
    first ones, since this sometimes lowers the penalised error.
    """
    steps = NUMBERS[effort].smooth
    if placed:
        compress(d)
        start(d)
        alternate(d, steps=10)
        alternate(d, steps=steps)
        return
    first_model(d)
    if effort == "fast":
        merged_start(d, 6, 4)
    else:
        merged_start(d)
    if effort == "best":
        merged_start(d, factor=2.2)
    return_to_best(d)
    if effort == "balanced":
        move_bones(d)
    alternate(d, steps=steps)
    if effort == "fast":
        polish(d, steps=6)
    elif effort == "balanced":
        relax_bones(d)
    else:
        relax(d)
        polish(d, steps=60, gain=0.002)
    alternate(d, steps=steps)


# --- bones attached at joints --------------------------------------------------------------------


def tree_of_bones(d: Descent, effort: Effort, size: float) -> None:
    """Bones with joints whose tree is not known: trees from several starts, then a search.

    Once the bones are attached, more influences follow.  There are several starts because a search
    ends near its start: of twelve starts on the Fox of the glTF samples, two led to the right tree.
    """

    def early(d: Descent) -> None:
        first_model(d, influences=1)
        attach(d)
        polish(d, steps=8)

    starts: tuple[Schedule, ...] = NUMBERS[effort].trees * (start_of_tree,)
    lowest(d, early, *starts)
    if effort == "fast":
        last_polish(d, steps=20, gain=0.01)
        return
    polish(d, steps=20, gain=0.01)
    relax_tree(d)
    search_trees(d, steps=10)
    if effort == "best":
        for _ in range(rebuilds(size).tree_searches - 1):
            lowest_tree(d, *starts)
            relax_tree(d)
            search_trees(d, steps=10)
        search_best_trees(d)
        return_to_best(d)
    last_polish(d, steps=40, gain=0.002)


def bones_of_skeleton(d: Descent, effort: Effort) -> None:
    """Bones attached at the joints of a known tree: their weights and motion.

    If the skeleton brings no weights, one start binds vertices to the nearest limb, and others bind
    vertices that move together; the lowest objective is continued.
    """
    n, given = NUMBERS[effort], d.given

    def attached(d: Descent) -> None:
        compress(d)
        start_on_skeleton(d)
        attach(d)

    def by_limb(d: Descent) -> None:
        attached(d)
        polish(d, steps=8)

    def by_motion(d: Descent) -> None:
        merged_start(d, influences=1)
        move_bones(d)
        start_on_skeleton(d, by_motion=True)
        attach(d)
        polish(d, steps=8)

    def relaxed(d: Descent) -> None:
        add_bones(d)
        relax_tree(d)
        search_weights(d, steps=n.weight_trials)

    if given.weights is not None or effort == "fast" or given.skeleton_skin is not None:
        attached(d)
    else:
        lowest(d, by_limb, *n.limbs * (by_motion,))
    polish(d, steps=20, gain=0.01)
    if given.weights is not None:
        last_polish(d, steps=n.polish, gain=1e-3)
        return
    if effort == "fast":
        add_bones(d)
        last_polish(d, steps=6)
        return
    if effort == "best" and given.skeleton_skin is None:
        relaxed(d)
        lowest_tree(d, *n.limbs * (by_motion,))
    relaxed(d)
    for _ in range(n.rounds - 1):
        return_to_best(d)
        relaxed(d)
    return_to_best(d)
    last_polish(d, steps=40, gain=0.002)


def loose_skeleton(d: Descent, effort: Effort) -> None:
    """Bones that start where a skeleton puts them, and may come apart."""
    compress(d)
    start_on_skeleton(d)
    alternate(d, steps=20, gain=1e-3)
    if d.given.weights is None and effort != "fast":
        polish(d, steps=8)
        relax_bones(d)
    last_polish(d, steps=NUMBERS[effort].polish, gain=1e-3)


# --- from a model --------------------------------------------------------------------------------


def polish_given(d: Descent, effort: Effort) -> None:
    """Start from the given model and polish it."""
    start_from_model(d)
    compress(d)
    polish(d, steps=6 if effort == "fast" else 20, gain=0.01)


def smooth_given(d: Descent, effort: Effort) -> None:
    """Continue from the given model under a smoothness penalty."""
    start_from_model(d)
    compress(d)
    alternate(d, steps=NUMBERS[effort].smooth)


def tree_given(d: Descent, effort: Effort) -> None:
    """Continue from the given model with bones attached at joints."""
    search_given = search_weights if d.given.keeps_tree else search_trees
    start_from_model(d)
    compress(d)
    attach_unattached(d)
    for _ in range({"fast": 0, "balanced": 1, "best": TREE_ROUNDS}[effort]):
        return_to_best(d)
        relax_tree(d)
        search_given(d, steps=TRIALS_OF_A_TREE)
    return_to_best(d)
    last_polish(d, steps=40, gain=0.002)


def loose_given(d: Descent, effort: Effort) -> None:
    """Continue from the given model with the loose joints of a skeleton."""
    polish_given(d, effort)
    if effort != "fast":
        relax_bones(d)
        return_to_best(d)
    last_polish(d, steps=20, gain=0.01)


# --- which of them -------------------------------------------------------------------------------


def follow_effort(
    d: Descent, *, effort: Effort, rig: RigKind, placed: bool, tries_model: bool
) -> None:
    """All steps of a call.

    Parameters
    ----------
    d : Descent
    effort : {"fast", "balanced", "best"}
    rig : {"none", "loose", "rigid"}
        Kind of joints.
    placed : bool
        Whether weights or all bones are locked.
    tries_model : bool
        Whether a whole model was given that is tried beside other starts.
    """
    size = float(d.data.n_vertices) * d.data.n_frames * d.bones
    starts_from_model = d.given.free and not tries_model
    if starts_from_model and d.smoothness is not None:
        smooth_given(d, effort)
    elif starts_from_model and rig == "rigid":
        tree_given(d, effort)
    elif starts_from_model:
        loose_given(d, effort)
    elif d.given_parts.tree is not None and rig == "rigid":
        bones_of_skeleton(d, effort)
    elif d.given_parts.tree is not None:
        loose_skeleton(d, effort)
    elif rig == "rigid":
        tree_of_bones(d, effort, size)
    elif d.smoothness is not None:
        smooth(d, effort, placed=placed)
    elif placed:
        nothing_to_place(d, effort)
    else:
        stretching = d.asked.bone_model != "rigid" and d.given_parts.transforms is None
        if effort == "best":
            best_bones(d, size, stretching=stretching)
        else:
            free_bones(d, effort, size, stretching=stretching)
    if tries_model:
        beside(d, partial(polish_given, effort=effort))
    unfold(d)


def settle(d: Descent, *, effort: Effort) -> None:
    """Fit a model that was found on some frames and carried over to more frames."""
    steps = NUMBERS[effort].settle
    fit_copied_bones(d)
    if d.smoothness is None:
        last_polish(d, steps=steps, gain=0.002)
    else:
        alternate(d, steps=steps, gain=0.002)
    unfold(d)
