"""A tree or forest over the bones of a model, and operations on it."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from .transforms import parents_first

__all__ = ["Tree", "root_at_centroids"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Tree:
    """Parents and joints of bones.

    Attributes
    ----------
    parents : (B,) int64
        −1 at roots.
    points : (B, 3) float64
        Joint between each bone and its parent, in the rest pose; not used at roots.
    rigid : bool
        Whether the two bones of each joint move it to the same point in every frame, up to
        rounding.
    """

    parents: NDArray[np.int64]
    points: Array
    rigid: bool

    @property
    def roots(self) -> NDArray[np.intp]:
        """Bones without a parent."""
        return np.flatnonzero(self.parents < 0)

    @property
    def non_roots(self) -> NDArray[np.intp]:
        """Bones with a parent."""
        return np.flatnonzero(self.parents >= 0)

    @property
    def order(self) -> NDArray[np.int64]:
        """An order of the bones in which parents come before children."""
        return parents_first(self.parents)

    def neighbours(self, bone: int) -> list[int]:
        """A list of a bone's children, then of its parent if it has one."""
        near = np.flatnonzero(self.parents == bone).tolist()
        return near + ([int(self.parents[bone])] if self.parents[bone] >= 0 else [])

    def joint(self, a: int, b: int) -> Array:
        """Joint (3,) between two neighbours in the tree."""
        return np.asarray(self.points[a if self.parents[a] == b else b])

    def subtree_sums(self, values: Array) -> Array:
        """For each bone, the sum of `values` (B,) over its subtree, as an array (B,)."""
        total = values.copy()
        for bone in self.order[::-1]:
            if self.parents[bone] >= 0:
                total[self.parents[bone]] += total[bone]
        return total

    def subtree(self, bone: int) -> list[int]:
        """A sorted list of the bone and its descendants."""
        inside = {bone}
        for k in self.order.tolist():
            if self.parents[k] in inside:
                inside.add(k)
        return sorted(inside)

    def path(self, a: int, b: int) -> tuple[list[int], list[int]]:
        """Edges of the path between bones a and b: those above a, then those above b.

        Each edge is named by its child.
        """
        up, down = self._to_root(a), self._to_root(b)
        both = set(up) & set(down)
        return [k for k in up if k not in both], [k for k in down if k not in both]

    def replace_edge(self, edge: int, a: int, b: int, point: Array) -> Tree:
        """A copy without the edge above the bone `edge`, and with an edge between a and b.

        `a` must be in the subtree of `edge`, and `b` outside.  The subtree is rerooted at `a`,
        which becomes a child of `b` with the joint `point`.
        """
        parents, points = self.parents.copy(), self.points.copy()
        path = self._to_root(a)
        path = path[: path.index(edge) + 1]
        for child, parent in zip(path[:0:-1], path[-2::-1], strict=True):
            parents[child], points[child] = parent, points[parent]
        parents[a], points[a] = b, point
        return Tree(parents, points, rigid=False)

    def contract(self, bone: int, into: int, points: dict[int, Array]) -> Tree:
        """A copy without `bone`, whose neighbour `into` is connected with its other neighbours.

        `points` are the joints between these neighbours and `into`.  The numbers of bones after
        `bone` decrease by 1.
        """
        parents, joints = self.parents.copy(), self.points.copy()
        above = int(parents[bone])
        for k in self.neighbours(bone):
            if k == into:
                continue
            if k == above:
                joints[into] = points[k]
            else:
                parents[k], joints[k] = into, points[k]
        if into != above:
            parents[into] = above
        keep = np.delete(np.arange(len(parents)), bone)
        number = np.full(len(parents) + 1, -1)  # the last entry is that of a root's parent, −1
        number[keep] = np.arange(len(keep))
        return Tree(number[parents[keep]], joints[keep], rigid=False)

    def _to_root(self, bone: int) -> list[int]:
        """A list of the bone and its ancestors, up to the root."""
        path = [bone]
        while self.parents[path[-1]] >= 0:
            path.append(int(self.parents[path[-1]]))
        return path


def root_at_centroids(edges: NDArray[np.bool_], mass: Array) -> NDArray[np.int64]:
    """Parents (B,) of a forest whose trees are rooted at their centroids.

    A tree's centroid is the bone whose removal splits it into parts of which the heaviest is as
    light as possible.

    Parameters
    ----------
    edges : (B, B) bool array
        Which bones are connected; symmetric, without cycles.
    mass : (B,) array
        Weight of each bone.
    """
    n = len(mass)
    parents = np.full(n, -2, dtype=np.int64)
    for first in range(n):
        if parents[first] != -2:
            continue
        bones = _orient(edges, parents, first)
        local = np.where(parents[bones] >= 0, np.searchsorted(bones, parents[bones]), -1)
        below = Tree(local, np.zeros((len(bones), 3)), rigid=False).subtree_sums(mass[bones])
        # the heaviest part without each bone: the part above it or one of the parts below
        heaviest = below.max() - below
        np.maximum.at(heaviest, local[local >= 0], below[local >= 0])
        parents[bones] = -2
        _orient(edges, parents, int(bones[heaviest.argmin()]))
    return parents


def _orient(edges: NDArray[np.bool_], parents: NDArray[np.int64], root: int) -> NDArray[np.intp]:
    """Set the parents of all bones connected with `root` (in place); return these bones, ascending.

    Their parents must be −2 before.
    """
    parents[root] = -1
    bones = [root]
    for bone in bones:
        for k in np.flatnonzero(edges[bone]).tolist():
            if parents[k] == -2:
                parents[k] = bone
                bones.append(k)
    return np.sort(np.array(bones, dtype=np.intp))
