"""A tree over the bones of a model: who hangs on whom, and by which rest point."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..solver.trajectories import Array
from .transforms import parents_first

__all__ = ["Tree", "rooted"]


@dataclasses.dataclass(frozen=True, eq=False)
class Tree:
    """Parents and joints of a model's bones.

    Attributes
    ----------
    parents : (B,) int64
        −1 at roots.
    points : (B, 3) float64
        Joints in the rest pose; those of roots play no part.
    rigid : bool
        Whether every bone hangs on its joint in every frame, but for rounding.
    """

    parents: NDArray[np.int64]
    points: Array
    rigid: bool

    @property
    def roots(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.parents < 0)

    @property
    def hung(self) -> NDArray[np.intp]:
        """Bones that have a parent."""
        return np.flatnonzero(self.parents >= 0)

    @property
    def order(self) -> NDArray[np.int64]:
        """Bones, parents before children."""
        return parents_first(self.parents)

    def neighbours(self, bone: int) -> list[int]:
        """Children, then the parent."""
        near = np.flatnonzero(self.parents == bone).tolist()
        return near + ([int(self.parents[bone])] if self.parents[bone] >= 0 else [])

    def joint(self, a: int, b: int) -> Array:
        """Point that joins two neighbours."""
        return np.asarray(self.points[a if self.parents[a] == b else b])

    def beyond(self, mass: Array) -> Array:
        """(B,) mass of each bone and of all that hangs on it."""
        total = mass.copy()
        for bone in self.order[::-1]:
            if self.parents[bone] >= 0:
                total[self.parents[bone]] += total[bone]
        return total

    def part(self, bone: int) -> list[int]:
        """The bone and all that hangs on it."""
        inside = np.zeros(len(self.parents), dtype=bool)
        inside[bone] = True
        for k in self.order:
            if self.parents[k] >= 0 and inside[self.parents[k]]:
                inside[k] = True
        return np.flatnonzero(inside).tolist()

    def way(self, a: int, b: int) -> tuple[list[int], list[int]]:
        """The edges between two bones, as children: those above a and those above b."""
        up, down = self._above(a), self._above(b)
        both = set(up) & set(down)
        return [k for k in up if k not in both], [k for k in down if k not in both]

    def rehung(self, edge: int, a: int, b: int, point: Array) -> Tree:
        """Without the joint of bone `edge`; of what hung there, bone a hangs on b instead."""
        parents, points = self.parents.copy(), self.points.copy()
        way = self._above(a)
        way = way[: way.index(edge) + 1]
        for child, above in zip(way[:0:-1], way[-2::-1], strict=True):
            parents[child], points[child] = above, points[above]
        parents[a], points[a] = b, point
        return Tree(parents, points, rigid=False)

    def without(self, bone: int, heir: int, points: dict[int, Array]) -> Tree:
        """Without a bone whose other neighbours hang on `heir`, one of them, by new points."""
        parents, joints = self.parents.copy(), self.points.copy()
        above = int(parents[bone])
        for k in self.neighbours(bone):
            if k == heir:
                continue
            if k == above:
                joints[heir] = points[k]
            else:
                parents[k], joints[k] = heir, points[k]
        if heir != above:
            parents[heir] = above
        keep = np.delete(np.arange(len(parents)), bone)
        rank = np.full(len(parents) + 1, -1)  # the last for roots, whose parent is −1
        rank[keep] = np.arange(len(keep))
        return Tree(rank[parents[keep]], joints[keep], rigid=False)

    def _above(self, bone: int) -> list[int]:
        way = [bone]
        while self.parents[way[-1]] >= 0:
            way.append(int(self.parents[way[-1]]))
        return way


def rooted(edges: NDArray[np.bool_], mass: Array) -> NDArray[np.int64]:
    """Parents of a forest's bones, each tree hung by the bone that balances it best.

    Parameters
    ----------
    edges : (B, B) bool array
        Symmetric, without cycles.
    mass : (B,) array
        The root is the bone without which the heaviest part that is left is lightest.
    """
    n = len(mass)
    parents = np.full(n, -2, dtype=np.int64)
    for first in range(n):
        if parents[first] != -2:
            continue
        tree = np.flatnonzero(_reached(edges, first))
        _hang(edges, parents, first)
        above = np.where(
            parents[tree] >= 0, np.searchsorted(tree, np.maximum(parents[tree], 0)), -1
        )
        beyond = Tree(above, np.zeros((len(tree), 3)), rigid=False).beyond(mass[tree])
        heaviest = beyond.max() - beyond  # what would be left above each bone, then below it
        np.maximum.at(heaviest, above[above >= 0], beyond[above >= 0])
        parents[tree] = -2
        _hang(edges, parents, int(tree[heaviest.argmin()]))
    return parents


def _reached(edges: NDArray[np.bool_], first: int) -> NDArray[np.bool_]:
    seen = np.zeros(len(edges), dtype=bool)
    seen[first] = True
    while (grown := seen | edges[seen].any(axis=0)).sum() > seen.sum():
        seen = grown
    return seen


def _hang(edges: NDArray[np.bool_], parents: NDArray[np.int64], root: int) -> None:
    parents[root] = -1
    ahead = [root]
    while ahead:
        bone = ahead.pop()
        for k in np.flatnonzero(edges[bone]).tolist():
            if parents[k] == -2:
                parents[k] = bone
                ahead.append(k)
