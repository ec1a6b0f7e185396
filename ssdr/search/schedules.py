"""Schedules: what a call does, step by step.  What depends on size is in :mod:`.effort_numbers`.

    fast       a first model; then more bones, merged and moved on a sample of the vertices; polish
    balanced   the same; then relax and polish
    best       all of balanced; then a search, and the best rebuilt and searched repeatedly

Those of bones with joints are in :mod:`.tree_schedules`.
"""

from __future__ import annotations

from functools import partial

from .descent import Descent
from .effort_numbers import (
    NUMBERS,
    REBUILDS,
    RELAXED_VERTICES,
    TRIALS_OF_A_REBUILD,
    TRIALS_OF_ALL,
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
    for_positions,
    last_polish,
    look_ahead,
    move_bones,
    on_sample,
    polish,
    relax,
    relax_bones,
    return_to_best,
    search,
    unfold,
)
from .trees.tree_schedules import (
    bones_of_skeleton,
    loose_from_model,
    loose_skeleton,
    skin_of_joints,
    tree_from_model,
    tree_of_bones,
)

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
    """Find bones without a hierarchy: all of "fast", or of "balanced".

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
    look_ahead(d, steps=3)
    bones = [place_bones] if effort == "fast" else [place_bones, relax_placed]
    sizes = {"least": RELAXED_VERTICES, "most": 2 * RELAXED_VERTICES}
    on_sample(d, *bones, **sizes, free=False)
    if effort == "fast":
        last_polish(d, steps=6)
    else:
        # smooth motion, such as a cloth's, takes many steps
        last_polish(d, steps=200, gain=0.016)


def relax_placed(d: Descent) -> None:
    """Polish and relax bones that are placed; with bones that stretch, this leads to worse minima.

    The second relaxation lowers the error by 1 % in the median, and by 10 % at most; a third does
    not.  A search after it would lower it further: that is what the effort "best" is for.
    """
    polish(d, steps=60, gain=0.02)
    for _ in range(2):
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
    polish(d, steps=200, gain=0.016)


def bones_of_effort(d: Descent, effort: Effort, *, stretching: bool) -> None:
    """Find bones without a hierarchy.

    The effort "best" makes all steps of "balanced" first.  What it finds after them is the result
    only if both its objective and its error are lower.
    """
    free_bones(d, effort, stretching=stretching)
    if not stretching:
        bones_that_turn(d, effort)
    whole_parts(d)
    if effort == "best":
        unfold(d)
        beside(d, search_further)


def search_further(d: Descent) -> None:
    """Search for positions alone, then polish with normals; for normals, if only they count."""
    return_to_best(d)
    if d.data.slack:
        search(d, steps=2 * TRIALS_OF_A_REBUILD)
    else:
        for_positions(d, search_positions)
    polish(d, steps=200, gain=0.002)
    whole_parts(d)
    unfold(d)


def search_positions(d: Descent) -> None:
    """Search on a sample; then relax and search on all vertices, so that nothing is overfitted."""
    n = RELAXED_VERTICES
    if on_sample(d, search_and_rebuild, least=n, most=n, free=False):
        relax_and_search(d, TRIALS_OF_ALL)


def search_and_rebuild(d: Descent) -> None:
    """Search from the model of "balanced", then rebuild the best model repeatedly.

    A rebuild has bones in new places, which are judged once influences and weights have adapted.
    """
    polish(d, steps=20, gain=0.005)
    relax_and_search(d, TRIALS_OF_A_REBUILD)
    for _ in range(REBUILDS):
        return_to_best(d)
        add_and_merge(d)
        relax_and_search(d, TRIALS_OF_A_REBUILD)


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
    rig : {"none", "loose", "rigid", "kept"}
        Kind of joints.
    bones_placed : bool
        Whether weights or all bones are locked.
    tries_model : bool
        Whether a complete model was given that is only tried beside other starts.
    """
    starts_from_model = d.initial.is_model and not tries_model
    stretching = d.constraints.bone_model != "rigid" and d.initial.beside_model().transforms is None
    if rig == "kept":
        skin_of_joints(d)
        return
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
        tree_of_bones(d, effort)
    elif d.smoothness is not None:
        smooth(d, effort, bones_placed=bones_placed, stretching=stretching)
    elif bones_placed:
        nothing_to_place(d, effort)
    else:
        bones_of_effort(d, effort, stretching=stretching)
    if tries_model:
        beside(d, partial(polish_model, effort=effort))
    unfold(d)
