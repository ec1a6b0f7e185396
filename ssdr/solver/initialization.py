"""A first model, whose bones are chosen among bones fitted to patches of vertices."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from ..common.checks import BoneModel
from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..kernels.bones import sweep_bones
from ..mesh.edges import triangle_edges
from .affine_fit import PATCH_RIDGE, solve_affine
from .model import CHUNK, Model
from .moments import transform_sums
from .rest_surface import SHORT
from .trajectories import Array, Trajectories

_FEW = 64  # frames among which the central one is chosen
# An edge has no size in a frame if its squared length is below this share of its mean; if the share
# of such edges is below the second number, no part has lost its size.
_NO_SIZE, _FEW_PARTS = 0.01, 0.01
_FEWER = 8  # of these frames, by which points without triangles find their neighbours
_MOST_EDGES = 4096  # edges, evenly spread over the mesh's list, by which it is chosen
_PATCHES_PER_BONE = 8  # candidates for each bone: more take longer and offer more choice
_SAMPLE = 20_000  # vertices by whose error patches are chosen
_REFITS = 3  # rounds of assigning vertices to bones and fitting these (Lloyd's iteration)
_FEWEST_STRETCHED = 6  # vertices of a patch whose bone may stretch: fewer hardly determine how
# Relative difference up to which distances count as equal, as many are in symmetric meshes: if
# rounding chose among these, another unit of length would lead to another model.
_TIED = 1e-9
_SKETCH = 32  # dimensions of a random projection in which trajectories are compared
_MORE_PATCHES = 512  # in which the parts of a mesh may result
_OF_PART = 4  # vertices of each part, at least, by whose error patches are chosen


def by_motion(data: Trajectories) -> NDArray[np.intp]:
    """Vertex indices (V,) in ascending order of the norm of the aligned trajectory.

    The norm is of the distances from the centroid in all frames.  Norms that nearly agree count as
    equal; such vertices keep the order of their indices.
    """
    size = max(float(data.x2.max()), 1e-300)
    return np.argsort(np.rint(data.x2 / (_TIED * size)), kind="stable")


def farthest_points(x: Array, count: int, first: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Choose seeds among the rows of x by farthest-point sampling, from the row `first`.

    Returns the row indices of the seeds and, for each row of x, the index of its nearest seed among
    them.  If rows coincide, there may be fewer than `count` seeds.
    """
    if x.shape[1] > 2 * _SKETCH:
        # approximate distances are enough to spread the seeds
        x = x @ np.random.default_rng(0).standard_normal((x.shape[1], _SKETCH))
    seeds = [first]
    label = np.zeros(len(x), dtype=np.intp)
    norm = np.einsum("ij,ij->i", x, x)
    distance = norm - 2.0 * (x @ x[first]) + norm[first]
    floor = 1e-14 * max(float(norm.max()), 1e-300)
    for k in range(1, min(count, len(x))):
        most = float(distance.max())
        if not most > floor:
            break
        far = int((distance >= (1 - _TIED) * most).argmax())
        new = norm - 2.0 * (x @ x[far]) + norm[far]
        closer = new < (1 - _TIED) * distance
        label[closer] = k
        distance[closer] = new[closer]
        distance[far] = -1.0
        label[far] = k
        seeds.append(far)
    return np.array(seeds), label


def fit_patches(
    data: Trajectories,
    rest: Array,
    label: NDArray[np.intp],
    count: int,
    bone_model: BoneModel = "rigid",
) -> Array:
    """Transforms (F, count, 3, 4) of bones fitted to `count` disjoint sets of vertices.

    `label` (V,) is the index of each vertex's set, or negative if it is in none.  The bone of an
    empty set is the identity.
    """
    member = np.flatnonzero(label >= 0)
    member = member[np.argsort(label[member], kind="stable")]
    bounds = np.searchsorted(label[member], np.arange(count + 1))
    p = np.concatenate([rest[member], np.ones((len(member), 1))], axis=1)
    # a patch without importance is fitted all the same
    weighted = p * np.maximum(data.importance[member], 1e-9)[:, None]
    az = np.zeros((4, count, data.z.shape[1]))
    own = np.zeros((count, 4, 4))
    transforms = np.zeros((data.n_frames, count, 3, 4))
    transforms[..., :3] = np.eye(3)
    with serial_blas():
        for j in range(count):
            rows = slice(bounds[j], bounds[j + 1])
            own[j] = p[rows].T @ weighted[rows]
            az[:, j] = weighted[rows].T @ data.z[member[rows]]
        c = data.expand(az)
    start, nobody = np.zeros(2, dtype=np.int32), np.zeros(0, dtype=np.int32)

    def work(j: int, _first: int, _last: int) -> None:
        # one bone at a time: patches share no vertices, so the table of pairs would be sparse
        piece = np.ascontiguousarray(transforms[:, j : j + 1])
        sums = np.ascontiguousarray(c[..., j : j + 1])
        block = own[j].reshape(1, 1, 4, 4).copy()
        stretches = bone_model != "rigid" and bounds[j + 1] - bounds[j] >= _FEWEST_STRETCHED
        sweep_bones(piece, sums, block, start, nobody, stretches, 1)
        if stretches and bone_model == "affine":
            solve_affine(piece, block, sums, ridge=PATCH_RIDGE)
        transforms[:, j] = piece[:, 0]

    run_chunks(work, chunk_bounds(count, 1))
    return transforms


def single_bone_errors(
    data: Trajectories, rest: Array, transforms: Array, rows: NDArray[np.intp]
) -> Array:
    """Squared error (n, B) of the n vertices `rows` if each bone alone moves them."""
    n_bones = transforms.shape[1]
    out = np.empty((len(rows), n_bones))
    with serial_blas():
        stacked = data.stack(transforms)
        reduced = data.reduce(stacked)
        columns = stacked.reshape(-1, 4, n_bones)
        gram = np.einsum("tdj,tej->jde", columns, columns)

        def work(_: int, i: int, k: int) -> None:
            part = rows[i:k]
            y = (data.z[part] @ reduced).reshape(k - i, 4, n_bones)
            p = np.concatenate([rest[part], np.ones((k - i, 1))], axis=1)
            f = np.einsum("idj,id->ij", y, p)
            h = np.einsum("id,ie->ide", p, p).reshape(k - i, 16) @ gram.reshape(-1, 16).T
            out[i:k] = data.x2[part, None] - 2.0 * f + h

        run_chunks(work, chunk_bounds(len(rows), CHUNK))
    return np.maximum(out, 0.0, out=out)


def facility_location(cost: Array, importance: Array, count: int) -> list[int]:
    """Choose up to `count` columns j, one by one, that each lower Σ_i u_i min_j cost_ij most.

    This is greedy facility location; u is `importance` (n,), and min_j is over the chosen columns.

    References
    ----------
    Minoux, "Accelerated greedy algorithms for maximizing submodular set functions", 1978.
    """
    column = np.ascontiguousarray(cost.T)
    chosen = [int((column @ importance).argmin())]
    best = column[chosen[0]].copy()

    def lowered(j: int) -> float:
        return float(importance @ np.maximum(best - column[j], 0.0))

    # what a column lowers only shrinks as others are chosen (submodularity): old values are bounds
    heap = [(-lowered(j), j) for j in range(len(column)) if j not in chosen]
    heapq.heapify(heap)
    while heap and len(chosen) < count:
        while True:
            _, j = heapq.heappop(heap)
            fresh = (-lowered(j), j)
            if not heap or fresh <= heap[0]:
                break
            heapq.heappush(heap, fresh)
        chosen.append(j)
        np.minimum(best, column[j], out=best)
    return chosen


def _few_of_each(part: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Mask (V,) of the first few vertices of each part."""
    order = np.argsort(part, kind="stable")
    first = np.searchsorted(part[order], part[order])
    mask = np.zeros(len(part), dtype=bool)
    mask[order] = np.arange(len(part)) < first + _OF_PART
    return mask


def _within_parts(label: NDArray[np.intp], part: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Labels (V,) of patches of which each lies in one part of the mesh, the largest ones first.

    A rigid part is one patch; in others, the patches `label` are divided.  Vertices of all patches
    after the first `most` get a negative label.
    """
    inside = np.flatnonzero((label >= 0) | (part >= 0))
    pair = part[inside] * (label.max() + 2) + label[inside]
    _, index, size = np.unique(pair, return_inverse=True, return_counts=True)
    rank = np.argsort(np.argsort(-size, kind="stable"), kind="stable")[index]
    out = np.full(len(part), -1, dtype=np.intp)
    out[inside] = np.where(rank < most, rank, -1)
    return out


def _share(cost: Array, part: NDArray[np.intp]) -> None:
    """Replace the costs (n, C) of the vertices of each rigid part by their mean (in place)."""
    inside = np.flatnonzero(part >= 0)
    if len(inside):
        _, index, size = np.unique(part[inside], return_inverse=True, return_counts=True)
        pick = coo_array((1.0 / size[index], (index, np.arange(len(inside))))).tocsr()
        cost[inside] = np.asarray(pick @ cost[inside])[index]


def nearest_bones(data: Trajectories, rest: Array, transforms: Array) -> NDArray[np.intp]:
    """Index (V,) of the bone that alone moves each vertex, or all of its rigid part, best."""
    cost = single_bone_errors(data, rest, transforms, np.arange(data.n_vertices))
    if data.parts is not None:
        _share(cost, data.parts)
    return np.asarray(cost.argmin(axis=1))


def start_model(
    data: Trajectories,
    rest: Array,
    bones: int,
    influences: int,
    rng: np.random.Generator,
    bone_model: BoneModel = "rigid",
    quick: bool = False,
) -> Model:
    """A first model, in which each vertex follows one bone.

    Vertices are divided into patches around farthest points, a bone is fitted to each patch, and
    the best of these bones are chosen.  Then vertices are assigned to bones, and bones fitted to
    their vertices, in turns.  No patch has vertices of several parts of the mesh, and the vertices
    of a rigid part are assigned together: if rigid parts are all there is, and their motions are no
    more than the bones, the model is exact.

    Parameters
    ----------
    data : Trajectories
    rest : (V, 3) array
    bones, influences : int
    rng : Generator
    bone_model : {"rigid", "similarity", "affine"}
    quick : bool
        Whether to try half as many patches, on a fifth of the vertices, without random numbers.
    """
    n = data.n_vertices
    rows = by_motion(data)
    patches_per_bone, sample = _PATCHES_PER_BONE, _SAMPLE
    if quick:
        patches_per_bone, sample = patches_per_bone // 2, sample // 5
        rows = rows[np.linspace(0, n - 1, min(n, sample)).astype(np.intp)]
    elif n > sample:
        rows = rows[np.sort(rng.choice(n, sample, replace=False))]
    part = np.full(n, -1) if data.parts is None else data.parts
    if data.parts is not None and len(rows) < n:
        chosen = _few_of_each(part)
        chosen[rows] = True
        rows = by_motion(data)
        rows = rows[chosen[rows]]
    free, label = rows[part[rows] < 0], np.full(n, -1, dtype=np.intp)
    if len(free):
        # scaled, so that vertices of little importance do not become seeds
        _, label[free] = farthest_points(
            data.z[free] * np.sqrt(data.importance[free])[:, None],
            patches_per_bone * bones,
            len(free) - 1 if quick else int(rng.integers(len(free))),
        )
    if data.parts is not None:
        label = _within_parts(label, part, patches_per_bone * bones + _MORE_PATCHES)
    patches = fit_patches(data, rest, label, int(label.max()) + 1, bone_model)
    cost = single_bone_errors(data, rest, patches, rows)
    _share(cost, part[rows])
    best = facility_location(cost, data.importance[rows], bones)
    # repeated where there are fewer patches than bones
    kept = np.ascontiguousarray(patches[:, np.resize(best, bones)])
    for _ in range(_REFITS):
        nearest = nearest_bones(data, rest, kept)
        refit = fit_patches(data, rest, nearest, bones, bone_model)
        used = np.bincount(nearest, minlength=bones) >= 3
        kept[:, used] = refit[:, used]
    return Model.start(kept, rest, nearest_bones(data, rest, kept), influences)


_LEAST = 1e-9  # added to a system's diagonal, relative to its trace


@serial_blas()
def with_rest_normals(data: Trajectories, model: Model) -> Model:
    """A copy with the rest normals n_i that minimise Σ_t |Σ_j w_ij R_j^t n_i − n_i^t|²."""
    assert data.normals is not None
    assert data.n2 is not None
    out = model.copy()
    out.normals = np.zeros((data.n_vertices, 1, 3))
    _, _, gram, reduced = transform_sums(data, model.transforms)
    turns = np.ascontiguousarray(gram[..., :3, :3])
    normals, n2 = data.normals, data.n2

    def work(_: int, i: int, k: int) -> None:
        ids, w = model.indices[i:k], model.weights[i:k]
        y = (normals[i:k] @ reduced).reshape(k - i, 4, -1)[:, :3]
        right = np.einsum("vk,vck->vc", w, np.take_along_axis(y, ids[:, None].astype(int), axis=2))
        left = np.zeros((k - i, 3, 3))
        for q in range(w.shape[1]):
            for s in range(w.shape[1]):
                left += (w[:, q] * w[:, s])[:, None, None] * turns[ids[:, q], ids[:, s]]
        trace = np.einsum("vcc->v", left)
        held = left + (_LEAST * trace + 1e-300)[:, None, None] * np.eye(3)
        n: Array = np.linalg.solve(held, right[..., None])[..., 0]
        error = n2[i:k] - 2.0 * (right * n).sum(axis=1) + np.einsum("va,vab,vb->v", n, left, n)
        out.normals[i:k, 0], out.normal_error[i:k] = n, np.maximum(error, 0.0)

    run_chunks(work, chunk_bounds(data.n_vertices, CHUNK))
    return out


@serial_blas()
def central_frame(data: Trajectories, *, first: bool = False) -> int:
    """Index of the frame whose edges are nearest to their mean over up to 64 evenly spread frames.

    The strain between it and the others is least, so that a rest pose near it costs least.  Points
    without triangles are joined to their nearest neighbours.  If `first`, frame 0 is returned,
    unless parts of the mesh have no size in it.
    """
    few = np.unique(np.linspace(0, data.n_frames - 1, _FEW).round().astype(int))
    ends = triangle_edges(data.faces, data.n_vertices)
    if not len(ends):
        ends = _nearest(data, few[:: max(1, len(few) // _FEWER)])
    if not len(ends):
        return 0
    ends = ends[:: max(1, len(ends) // _MOST_EDGES)]
    along = [np.diff(data.frame(t)[ends], axis=1)[:, 0] for t in few]
    mean = np.mean(along, axis=0)
    squared = np.mean([(e**2).sum(axis=1) for e in along], axis=0)
    weight = 1.0 / np.maximum(squared + SHORT * squared.mean(), 1e-300)
    if first and ((along[0] ** 2).sum(axis=1) < _NO_SIZE * squared).mean() < _FEW_PARTS:
        return 0
    return int(few[np.argmin([weight @ ((e - mean) ** 2).sum(axis=1) for e in along])])


def _nearest(data: Trajectories, frames: NDArray[np.intp]) -> NDArray[np.intp]:
    """Index pairs (P, 2): each vertex of an evenly strided subset, and its nearest neighbour in it.

    Neighbours are nearest by their positions in all of `frames`.
    """
    some = np.arange(0, data.n_vertices, max(1, data.n_vertices // _MOST_EDGES))
    paths = np.concatenate([data.frame(t)[some] for t in frames], axis=1)
    if len(some) < 2:
        return np.zeros((0, 2), dtype=np.intp)
    return some[cKDTree(paths).query(paths, k=2)[1]]
