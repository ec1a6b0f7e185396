"""Parts of schedules: short runs of steps that several schedules share."""

from __future__ import annotations

from ..problem.problem import Effort
from .bone_steps import merge, move_bones
from .descent import Descent, Schedule
from .efforts import REBUILDS, TREE_ROUNDS, TRIALS_OF_A_TREE, Rebuilds
from .starts import quick_start, start, start_from_model
from .steps import alternate, compress, lowest, polish, relax, return_to_best, solve_normals
from .tree_steps import attach, search_trees

__all__ = [
    "attach_and_polish",
    "first_model",
    "last_polish",
    "lowest_tree",
    "merged_start",
    "polish_model",
    "rebuilds",
    "relax_bones",
    "relax_tree",
    "search_best_trees",
    "start_of_tree",
]


def first_model(d: Descent, *, influences: int | None = None) -> None:
    """Make a usable model early, without excess bones and before the frames are compressed."""
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


def relax_bones(d: Descent) -> None:
    """Relax with five polish steps at each number of influences, of which "best" makes eight."""
    relax(d, polish_steps=5)
    polish(d, steps=200, gain=0.004)


def last_polish(d: Descent, *, steps: int, gain: float = 0.0) -> None:
    """Polish with normals in the objective."""
    solve_normals(d)
    polish(d, steps=steps, gain=gain)


def relax_tree(d: Descent) -> None:
    """Relax and polish bones that are attached at joints."""
    relax(d, polish_steps=6)
    polish(d, steps=24, gain=0.01)


def attach_and_polish(d: Descent) -> None:
    """Attach the bones at joints and polish them there."""
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
    """Make a tree from each start, and polish the one of least objective."""
    lowest(d, *starts)
    polish(d, steps=20, gain=0.01)


def search_best_trees(d: Descent) -> None:
    """Search better trees repeatedly, each time from the best one so far."""
    for _ in range(TREE_ROUNDS):
        return_to_best(d)
        relax_tree(d)
        search_trees(d, steps=TRIALS_OF_A_TREE)


def rebuilds(size: float) -> Rebuilds:
    """Numbers of rebuilds, starts and trials of the effort "best" for a problem of this size."""
    return next(numbers for bound, numbers in REBUILDS if size < bound)


def polish_model(d: Descent, effort: Effort) -> None:
    """Start from the given model and polish it."""
    start_from_model(d)
    compress(d)
    polish(d, steps=6 if effort == "fast" else 20, gain=0.01)
