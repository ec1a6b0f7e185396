"""A tree or forest over the bones of a model, and operations on it."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, connected_components

from .transforms import parents_first

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
        """Indices of the bones without a parent."""
        return np.flatnonzero(self.parents < 0)

    @property
    def non_roots(self) -> NDArray[np.intp]:
        """Indices of the bones with a parent."""
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
        """Position (3,), in the rest pose, of the joint between two adjacent bones of the tree."""
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

        `points` are the joints between these neighbours and `into`.  The indices of bones after
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
    _, part = connected_components(edges, directed=False)
    _, first = np.unique(part, return_index=True)
    tree = Tree(_rooted(edges, first), np.zeros((len(mass), 3)), rigid=False)
    # the heaviest part without each bone: the part above it or one of the parts below
    below, hung = tree.subtree_sums(mass), tree.non_roots
    heaviest = below[first][part] - below
    np.maximum.at(heaviest, tree.parents[hung], below[hung])
    order = np.lexsort((heaviest, part))
    return _rooted(edges, order[np.searchsorted(part[order], np.arange(len(first)))])


def _rooted(edges: NDArray[np.bool_], roots: NDArray[np.intp]) -> NDArray[np.int64]:
    """Parents (B,) in a forest with the given edges, one of `roots` in each tree."""
    above = [breadth_first_order(edges, root, directed=False)[1] for root in roots]
    return np.asarray(np.max(above, axis=0, initial=-1), dtype=np.int64)
