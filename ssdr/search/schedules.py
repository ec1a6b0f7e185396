"""Schedules: what a call does, step by step.  What depends on size is in :mod:`.effort_numbers`.

    fast       a first model; then more bones, merged and moved on a sample of the vertices; polish
    balanced   the same; then relax and polish
    best       several starts, each relaxed and searched; then the best model rebuilt repeatedly

Those of bones with joints are in :mod:`.tree_schedules`.
"""

from __future__ import annotations

from functools import partial

from .descent import Descent
from .effort_numbers import (
    MANY_BONES,
    NUMBERS,
    RELAXED_VERTICES,
    STARTS_OF_MANY_BONES,
    TRIALS_OF_A_REBUILD,
    TRIALS_OF_A_START,
    Rebuilds,
    rebuilds,
)
from .problem import Effort, RigKind
from .progress import Stop
from .starts import (
    first_model,
    merged_start,
    normals_need_a_start,
    polish_model,
    quick_start,
    start,
    start_from_model,
    start_with_normals,
    whole_parts,
)
from .steps import (
    add_and_merge,
    alternate,
    beside,
    compress,
    last_polish,
    move_bones,
    on_sample,
    polish,
    relax,
    relax_bones,
    return_to_best,
    search,
    try_places,
    unfold,
)
from .trees.tree_schedules import (
    bones_of_skeleton,
    loose_from_model,
    loose_skeleton,
    lowest_tree,
    relax_tree,
    search_best_trees,
    start_of_tree,
    tree_from_model,
    tree_of_bones,
)

# Ratio of a tree's objective to the best one up to which the tree is improved.
_PROMISING = 4.0


# --- free bones ----------------------------------------------------------------------------------


def place_bones(d: Descent) -> None:
    """Choose bones on a sample of the vertices, in a fifth of the time.

    Then continue from the model with the lowest objective, the one before it included.
    """
    on_sample(d, merge_and_move)
    return_to_best(d)


def merge_and_move(d: Descent) -> None:
    """Alternate; start anew with more bones than requested, merge them; move the cheapest ones."""
    alternate(d, steps=20, gain=0.01)
    merged_start(d)
    return_to_best(d)
    move_bones(d, steps=24, patience=6)


def relax_and_search(d: Descent, trials: int) -> None:
    """Relax, polish, then search: bones in new places are judged once weights have adapted."""
    relax(d)
    polish(d, steps=8)
    search(d, steps=trials)


def free_bones(d: Descent, effort: Effort, *, stretching: bool) -> None:
    """Find bones without a hierarchy, with the effort "fast" or "balanced".

    If bones may stretch (`stretching`), a start from rigid bones is tried too.  In every step a
    bone that stretches must keep det > 0; where the mesh is thin, this can trap a start with
    stretching bones in a poor minimum.
    """
    if effort == "fast" and stretching:
        stretching_bones_fast(d)
        return
    quick_start(d)
    compress(d)
    if stretching:
        place_bones(d)
        polish(d, steps=6)
        relax_bones(d)
        relax_from_rigid(d)
        return
    bones = [place_bones] if effort == "fast" else [place_bones, relax_placed]
    sizes = {"least": RELAXED_VERTICES, "most": 2 * RELAXED_VERTICES}
    on_sample(d, *bones, **sizes, free=False, ahead=3)
    if effort == "fast":
        last_polish(d, steps=6)
    else:
        # smooth motion, such as a cloth's, takes many steps
        last_polish(d, steps=200, gain=0.016)


def relax_placed(d: Descent) -> None:
    """Polish and relax bones that are placed; with bones that stretch, this leads to worse minima.

    A search of four trials after it would lower the error by 3 % in the median, and by 15 % at
    most, for two thirds more time: that is what the effort "best" is for.
    """
    polish(d, steps=60, gain=0.02)
    relax(d, polish_steps=4)
    polish(d, steps=20, gain=0.02)
    return_to_best(d)


def stretching_bones_fast(d: Descent) -> None:
    """Find bones that may stretch, with the effort "fast": the second start has rigid bones."""
    first_model(d)
    merged_start(d, 6, 4)
    with d.rigid_bones():
        merged_start(d)
    return_to_best(d)
    polish(d, steps=6)


def relax_from_rigid(d: Descent) -> None:
    """Start from rigid bones, then relax them with the requested bone model."""
    with d.rigid_bones():
        merged_start(d)
    polish(d, steps=8)
    relax_bones(d)


def bones_that_turn(d: Descent, effort: Effort) -> None:
    """Start anew with normals in the objective, where these need it; keep the model if it is lower.

    Relaxed for positions alone, bones of a sheet stop turning, and normals do not bring that back.
    """
    if not normals_need_a_start(d):
        return
    start_with_normals(d)
    polish(d, steps=60, gain=0.02)
    if effort == "fast":
        return
    relax(d, polish_steps=4)
    if effort == "best":
        search(d, steps=TRIALS_OF_A_START)
    polish(d, steps=200, gain=0.016)


def best_bones(d: Descent, size: float, *, stretching: bool) -> None:
    """Find bones without a hierarchy with the effort "best".

    The search runs on a sample if that is less than half of the vertices.  On horse_gallop this
    halves the time at least; the error is 2 % higher with 10 bones and 3 % lower with 20 bones.
    """
    n = rebuilds(size)
    searches = partial(first_search, n=n), partial(search_from_starts, n=n, stretching=stretching)
    first_model(d)
    if on_sample(d, *searches, least=RELAXED_VERTICES, most=2 * RELAXED_VERTICES, free=False):
        polish(d, steps=40, gain=0.01)
        relax_and_search(d, TRIALS_OF_A_START)
        return_to_best(d)
        search(d, steps=TRIALS_OF_A_START)
    return_to_best(d)
    last_polish(d, steps=200, gain=0.002)


def first_search(d: Descent, n: Rebuilds) -> None:
    """Relax and search from the first model or, with many bones, from several starts."""
    if d.bones >= MANY_BONES:
        for _ in range(STARTS_OF_MANY_BONES):
            start(d)
            alternate(d, steps=12)
            try_places(d, steps=10, patience=8)
            relax_and_search(d, TRIALS_OF_A_START)
    else:
        relax_and_search(d, n.trials)


def search_from_starts(d: Descent, n: Rebuilds, *, stretching: bool) -> None:
    """Relax and search from further starts; then rebuild the best model repeatedly."""
    many = d.bones >= MANY_BONES
    if not stretching:
        start_from_tree(d, n.trees)
    elif n.before:
        relax_from_rigid(d)
    for _ in range(n.before):
        rebuild(d, n.trials)
    search_merged(d, TRIALS_OF_A_START if many else n.trials)
    if stretching and not n.before:
        relax_from_rigid(d)
    for _ in range(n.after):
        rebuild(d, n.trials)
    return_to_best(d)
    search(d, steps=n.trials)


def search_merged(d: Descent, trials: int) -> None:
    """Search from the start of "balanced", with its moves of bones.

    On small smooth motions, such as a beam's, the other starts end with far more error.
    """
    merged_start(d)
    move_bones(d)
    relax_and_search(d, trials)


def rebuild(d: Descent, trials: int) -> None:
    """Rebuild the best model with several bones in new places, then search."""
    return_to_best(d)
    add_and_merge(d)
    relax_and_search(d, min(trials, TRIALS_OF_A_REBUILD))


def start_from_tree(d: Descent, trees: int) -> None:
    """Make a tree, improve it, drop it and improve the freed bones.

    If the animation comes from a skeleton, a tree leads to models that free bones do not find.  If
    the tree's objective is below the best one, better trees are therefore searched before the tree
    is dropped.  If it is more than four times the best one, the tree is given up at once.
    """
    lowest_tree(d, *trees * (start_of_tree,))
    best = d.best.value
    if not d.below(_PROMISING * best, expected=True):
        d.model = d.best.model.with_restarted_support()
        return
    relax_tree(d)
    if d.below(best, expected=False):
        search_best_trees(d)
    d.drop_tree()
    relax_and_search(d, TRIALS_OF_A_START)


def nothing_to_place(d: Descent, effort: Effort) -> None:
    """Descend to the nearest minimum from one start, as weights or bones are locked."""
    compress(d)
    start(d)
    alternate(d, steps=10)
    last_polish(d, steps=NUMBERS[effort].polish, gain=1e-3)


def smooth(d: Descent, effort: Effort, *, bones_placed: bool, stretching: bool) -> None:
    """Alternate under a smoothness penalty, which the polish ignores, until the error settles.

    Unless weights or all bones are locked (`bones_placed`), a polish and further alternations
    follow the first ones, since this sometimes lowers the penalised error.  With the efforts
    "balanced" and "best", a second start is the model found without the penalty.
    """
    steps = NUMBERS[effort].smooth
    if bones_placed:
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
    if effort != "fast":
        # on a cloth this lowers the penalised error, too; on wings it raises it
        bare = d.unpenalised()
        try:
            free_bones(bare, "balanced", stretching=stretching)
        except Stop as stop:
            if str(stop) != "converged":  # no error is left, but the penalty is
                raise
        if not d.planning:
            d.model = bare.best.model.with_restarted_support()
        alternate(d, steps=steps)


# --- from a model, and which of them -------------------------------------------------------------


def smooth_from_model(d: Descent, effort: Effort) -> None:
    """Continue from the given model under a smoothness penalty."""
    start_from_model(d)
    compress(d)
    alternate(d, steps=NUMBERS[effort].smooth)


def follow_effort(
    d: Descent, *, effort: Effort, rig: RigKind, bones_placed: bool, tries_model: bool
) -> None:
    """Make all steps of a call, by the schedule for its arguments.

    Parameters
    ----------
    d : Descent
    effort : {"fast", "balanced", "best"}
    rig : {"none", "loose", "rigid"}
        Kind of joints.
    bones_placed : bool
        Whether weights or all bones are locked.
    tries_model : bool
        Whether a complete model was given that is only tried beside other starts.
    """
    size = float(d.data.n_vertices) * d.data.n_frames * d.bones
    starts_from_model = d.initial.is_model and not tries_model
    stretching = d.constraints.bone_model != "rigid" and d.initial.beside_model().transforms is None
    if starts_from_model and d.smoothness is not None:
        smooth_from_model(d, effort)
    elif starts_from_model and rig == "rigid":
        tree_from_model(d, effort)
    elif starts_from_model:
        loose_from_model(d, effort)
    elif d.initial.beside_model().tree is not None and rig == "rigid":
        bones_of_skeleton(d, effort)
    elif d.initial.beside_model().tree is not None:
        loose_skeleton(d, effort)
    elif rig == "rigid":
        tree_of_bones(d, effort, size)
    elif d.smoothness is not None:
        smooth(d, effort, bones_placed=bones_placed, stretching=stretching)
    elif bones_placed:
        nothing_to_place(d, effort)
    else:
        if effort == "best":
            best_bones(d, size, stretching=stretching)
        else:
            free_bones(d, effort, stretching=stretching)
        if not stretching:
            bones_that_turn(d, effort)
        if d.influences == 1 and d.data.parts is not None:
            whole_parts(d)
    if tries_model:
        beside(d, partial(polish_model, effort=effort))
    unfold(d)
