"""Assignment of vertices to the bones of a given skeleton, by place and by motion.

The nearest limb says little about a vertex that is near two limbs; the vertex's motion says more.
Free bones, each with the vertices that move as it does, are matched with the skeleton's bones.  The
match makes them lie near their limbs, and keeps parent and child together at their joint.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.tree import Tree
from ...solver.initialization import fit_patches
from ...solver.trajectories import Array, Trajectories
from .placement import fit_joints

# Weight of a joint's squared gap beside squared distances from limbs: gaps distinguish bones that
# are equally near.  On a tree of 18 bones, 16 are matched correctly with weight 1, all with 10 to
# 1000.
_GAP = 10.0
_AWAY = 1e-2  # weight of a joint's squared distance from its given place, which may be a little off


def limb_distances(points: Array, tree: Tree) -> Array:
    """Squared distances (V, B) of points (V, 3) from the limbs of bones.

    A bone's limbs are the segments from its joint to the joints of its children.  The limb of a
    bone without children continues the segment from its parent's joint by the same length.
    """
    away = np.full((len(points), len(tree.parents)), np.inf)
    for k in range(len(tree.parents)):
        ends = tree.points[tree.parents == k]
        if not len(ends):
            above = tree.parents[k]
            ends = 2 * tree.points[[k]] - tree.points[[above if above >= 0 else k]]
        for end in ends:
            along = end - tree.points[k]
            length = float(along @ along)
            off = points - tree.points[k]
            part = np.clip(off @ along / length, 0.0, 1.0) if length > 0 else np.zeros(len(off))
            limb = ((off - part[:, None] * along) ** 2).sum(axis=1)
            away[:, k] = np.minimum(away[:, k], limb)
    return away


def match_by_motion(
    data: Trajectories, rest: Array, label: NDArray[np.intp], count: int, tree: Tree
) -> NDArray[np.intp]:
    """Index (V,) of the skeleton's bone that each vertex is assigned to.

    `label` (V,) divides the vertices among `count` free bones, which are matched with the
    skeleton's by place and motion; each vertex takes the match of its free bone. A free bone
    without a match takes the bone with the nearest limb.
    """
    away = limb_distances(rest, tree)
    used = np.bincount(label, minlength=count)
    place = np.full((count, len(tree.parents)), away.mean())
    for j in np.flatnonzero(used):
        place[j] = away[label == j].mean(axis=0)
    bones = fit_patches(data, rest, label, count)
    hung = tree.non_roots
    gap = np.empty((len(hung), count, count))
    for row, k in enumerate(hung):
        prior = np.broadcast_to(tree.points[k], (count, count, 3))
        point, squared = fit_joints(bones, prior, away=_AWAY)
        gap[row] = squared / len(bones) + _AWAY * ((point - tree.points[k]) ** 2).sum(axis=-1)
    own = matched_bones(place, _GAP * gap, tree)
    nearest = place.argmin(axis=1)
    for bone, j in enumerate(own):
        if j >= 0:
            nearest[j] = bone
    out: NDArray[np.intp] = nearest[label]
    return out


def matched_bones(place: Array, gap: Array, tree: Tree) -> NDArray[np.intp]:
    """Match each bone of a skeleton with a free bone; return the free bones' indices (B,), or −1.

    No free bone is matched twice.  `place` (n, B) is the cost of each match, and `gap` (H, n, n),
    for the H bones with parents, the cost of the match of the bone together with its parent's.
    First, the sum of `place` alone is minimised; then two bones at a time swap their matches while
    that lowers the sum of `place` and `gap`.
    """
    from scipy.optimize import linear_sum_assignment

    n, n_bones = place.shape
    hung, above = tree.non_roots, tree.parents[tree.non_roots]
    # one more free bone, which costs nothing and stands for none
    place = np.pad(place, [(0, 1), (0, 0)])
    gap = np.pad(gap, [(0, 0), (0, 1), (0, 1)])
    rows, columns = linear_sum_assignment(place[:n])
    own = np.full(n_bones, n, dtype=np.intp)
    own[columns] = rows
    bones, edges = np.arange(n_bones), np.arange(len(hung))

    def cost() -> float:
        return float(place[own, bones].sum() + gap[edges, own[hung], own[above]].sum())

    least, found = cost(), True
    while found:
        found = False
        for a in range(n_bones):
            for b in range(a):
                own[[a, b]] = own[[b, a]]
                now = cost()
                if now < least * (1.0 - 1e-9):
                    least, found = now, True
                else:
                    own[[a, b]] = own[[b, a]]
    return np.where(own == n, -1, own)
