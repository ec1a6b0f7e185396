"""Schedules of bones with joints: to find a tree, or to start from a skeleton or a model."""

from __future__ import annotations

from collections.abc import Callable

from ..descent import Descent, Schedule
from ..effort_numbers import NUMBERS, TREE_ROUNDS, TREE_SEARCHES, TRIALS_OF_A_TREE
from ..problem import Effort
from ..starts import first_model, merged_start, polish_model, start_from_model
from ..steps import (
    alternate,
    compress,
    last_polish,
    lowest,
    move_bones,
    polish,
    relax,
    relax_bones,
    return_to_best,
    solve_normals,
)
from .tree_steps import (
    add_bones,
    attach,
    attach_unattached,
    search_trees,
    search_weights,
    solve_skin,
    start_on_joints,
    start_on_skeleton,
)


def tree_of_bones(d: Descent, effort: Effort) -> None:
    """Find bones with joints and their tree: trees from several starts, then a search.

    Influences are added once the bones are attached.  There are several starts because a search
    ends near its start: of twelve starts on the Fox of the glTF samples, two led to the right tree.
    """

    def early(d: Descent) -> None:
        first_model(d, influences=1)
        attach_and_polish(d)

    starts: tuple[Schedule, ...] = NUMBERS[effort].trees * (start_of_tree,)
    lowest(d, early, *starts)
    if effort == "fast":
        last_polish(d, steps=20, gain=0.01)
        return
    polish(d, steps=20, gain=0.01)
    relax_tree(d)
    search_trees(d, steps=10)
    if effort == "best":
        for _ in range(TREE_SEARCHES - 1):
            lowest_tree(d, *starts)
            relax_tree(d)
            search_trees(d, steps=10)
        search_from_best(d, TREE_ROUNDS, search_trees)
        return_to_best(d)
    last_polish(d, steps=40, gain=0.002)


def bones_of_skeleton(d: Descent, effort: Effort) -> None:
    """Find weights and motion of bones that are attached at the joints of a known tree.

    If the skeleton has no weights, one start binds vertices to the nearest limb, and others (not
    with the effort "fast") bind vertices that move together.  The model of lowest objective is
    continued.
    """
    n, initial = NUMBERS[effort], d.initial

    def by_limb(d: Descent) -> None:
        compress(d)
        start_on_skeleton(d)
        attach_and_polish(d)

    def by_motion(d: Descent) -> None:
        merged_start(d, influences=1)
        move_bones(d)
        start_on_skeleton(d, by_motion=True)
        attach_and_polish(d)

    def relaxed(d: Descent) -> None:
        add_bones(d)
        relax_tree(d)
        search_weights(d, steps=n.weight_trials)

    if initial.skin is not None or effort == "fast" or initial.skeleton_skin is not None:
        compress(d)
        start_on_skeleton(d)
        attach(d)
    else:
        lowest(d, by_limb, *n.limbs * (by_motion,))
    polish(d, steps=20, gain=0.01)
    if initial.skin is not None:
        last_polish(d, steps=n.polish, gain=1e-3)
        return
    if effort == "fast":
        add_bones(d)
        last_polish(d, steps=6)
        return
    if effort == "best" and initial.skeleton_skin is None:
        relaxed(d)
        lowest_tree(d, *n.limbs * (by_motion,))
    relaxed(d)
    for _ in range(n.rounds - 1):
        return_to_best(d)
        relaxed(d)
    return_to_best(d)
    last_polish(d, steps=40, gain=0.002)


def loose_skeleton(d: Descent, effort: Effort) -> None:
    """Find weights and motion of bones that start on a skeleton and may come apart."""
    compress(d)
    start_on_skeleton(d)
    alternate(d, steps=20, gain=1e-3)
    if d.initial.skin is None and effort != "fast":
        polish(d, steps=8)
        relax_bones(d)
    last_polish(d, steps=NUMBERS[effort].polish, gain=1e-3)


def skin_of_joints(d: Descent) -> None:
    """Find weights and rest pose, then with normals, for joints whose motion is given."""
    compress(d)
    start_on_joints(d)
    solve_skin(d)
    solve_normals(d)
    solve_skin(d)


def tree_from_model(d: Descent, effort: Effort) -> None:
    """Continue from the given model with bones attached at joints."""
    start_from_model(d)
    compress(d)
    attach_unattached(d)
    rounds = {"fast": 0, "balanced": 1, "best": TREE_ROUNDS}[effort]
    search_from_best(d, rounds, search_weights if d.initial.keeps_tree else search_trees)
    return_to_best(d)
    last_polish(d, steps=40, gain=0.002)


def loose_from_model(d: Descent, effort: Effort) -> None:
    """Continue from the given model with bones that may come apart."""
    polish_model(d, effort)
    if effort != "fast":
        relax_bones(d)
        return_to_best(d)
    last_polish(d, steps=20, gain=0.01)


def relax_tree(d: Descent) -> None:
    """Widen and reduce influences (:func:`relax`), then polish, for bones attached at joints."""
    relax(d, polish_steps=6)
    polish(d, steps=24, gain=0.01)


def attach_and_polish(d: Descent) -> None:
    """Attach the bones at joints, and polish the attached bones."""
    attach(d)
    polish(d, steps=8)


def start_of_tree(d: Descent) -> None:
    """Make a tree over bones that start with one influence per vertex.

    Such bones are compact, and the tree over them is close to the best.
    """
    merged_start(d, influences=1)
    move_bones(d)
    attach_and_polish(d)


def lowest_tree(d: Descent, *starts: Schedule) -> None:
    """Make a tree from each start, and polish the one of lowest objective."""
    lowest(d, *starts)
    polish(d, steps=20, gain=0.01)


def search_from_best(d: Descent, rounds: int, search: Callable[..., None]) -> None:
    """Relax and search a tree repeatedly, each time from the best model so far."""
    for _ in range(rounds):
        return_to_best(d)
        relax_tree(d)
        search(d, steps=TRIALS_OF_A_TREE)
