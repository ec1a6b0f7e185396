"""Kernel that improves rounded weights by moving single steps of weight between bones."""

from __future__ import annotations

import numpy as np

from .policy import kernel
from .vertices import form_of, load_points, place, point_error, read_influences, store, store_points


@kernel
def move_units(
    y,
    x2,
    pairs,
    rest,
    indices,
    weights,
    error,
    normals,
    normal_error,
    hold,
    length,
    locked,
    move_rest,
    steps,
):
    """Move units of weight from bone to bone of each vertex while its error falls.

    y             (V, P, 4, B) float64  Σ_t M_j^tᵀ v_i^t of position and normal, in
    x2            (V, P)       float64  Σ_t |v_i^t|², in
    pairs         (B, B, 10)   float64  coefficients of p̃ᵀ G_jk p̃, in
    rest          (V, 3)       float64  rest positions, updated where `move_rest`
    indices       (V, K)       int32    bone of each influence, updated
    weights       (V, K)       float64  weights, multiples of a unit 1/steps, descending, updated
    error         (V,)         float64  squared error of the positions, out
    normals       (V, P-1, 3)  float64  rest normals, updated
    normal_error  (V,)         float64  squared error with respect to the unit normals, out
    hold          (V, 4)       float64  pull (μ, m) on each rest position, in
    length        float                 length of a normal treated as a point, in
    locked        (V,)         bool     vertices whose weights are not changed, in
    move_rest     bool                  whether each move is judged at its best rest position
    steps         int                   number of units of a vertex

    One unit moves at a time, from the influence and to the bone for which the error falls most,
    until no move lowers it.  A vertex never has more than K influences.
    """
    n_bones = pairs.shape[0]
    size = indices.shape[1]
    ids = np.empty(size, dtype=np.uint32)
    slot = np.empty(n_bones, dtype=np.int64)
    units = np.empty(size)
    w = np.empty(size)
    form = np.empty(10)
    m = np.empty(10)
    g = np.empty(4)
    a = np.empty((3, 3))
    b = np.empty(3)
    p = np.empty((x2.shape[1], 4))
    kept = np.empty((x2.shape[1], 4))
    for i in range(len(rest)):
        load_points(rest[i], normals[i], length, kept)
        n = read_influences(indices[i], weights[i], ids, w)
        for q in range(n):
            units[q] = np.rint(w[q] * steps)
            w[q] = units[q] / steps
        e = place(x2[i], y[i], pairs, hold[i], ids, w, n, move_rest, kept, form, g, m, a, b)
        better = not locked[i]
        while better:
            least = e - 1e-9 * abs(e)
            bone = down = -1
            for j in range(n_bones):
                slot[j] = -1
            for q in range(n):
                slot[ids[q]] = q
            for s in range(n):
                gone = ids[s]
                w[s] = (units[s] - 1.0) / steps
                for j in range(n_bones):
                    # a new bone needs a free place, or that of a bone which gives its last unit
                    q = slot[j] if slot[j] >= 0 else (s if units[s] == 1.0 else n)
                    if j == gone or q == size:
                        continue
                    if slot[j] < 0:
                        ids[q] = j
                        w[q] = 1.0 / steps
                    else:
                        w[q] = (units[q] + 1.0) / steps
                    count = n + 1 if q == n else n
                    p[:] = kept
                    trial = place(
                        x2[i], y[i], pairs, hold[i], ids, w, count, move_rest, p, form, g, m, a, b
                    )
                    if q == s:
                        ids[s] = gone
                        w[s] = 0.0
                    elif q < n:
                        w[q] = units[q] / steps
                    if trial < least:
                        least, bone, down = trial, j, s
                w[s] = units[s] / steps
            better = bone >= 0
            if better:
                units[down] -= 1.0
                up = slot[bone]
                if up < 0:
                    up = n
                    if units[down] == 0.0:
                        up = down
                    else:
                        n += 1
                    ids[up] = bone
                    units[up] = 0.0
                units[up] += 1.0
                left = 0
                for q in range(n):
                    if units[q] > 0.0:
                        ids[left] = ids[q]
                        units[left] = units[q]
                        w[left] = units[q] / steps
                        left += 1
                n = left
                e = place(x2[i], y[i], pairs, hold[i], ids, w, n, move_rest, kept, form, g, m, a, b)
        form_of(pairs, ids, w, n, form)
        error[i] = point_error(x2[i, 0], y[i, 0], form, ids, w, n, kept[0])
        if kept.shape[0] > 1 and length > 0.0:
            more = point_error(x2[i, 1], y[i, 1], form, ids, w, n, kept[1])
            normal_error[i] = more / (length * length)
        store_points(kept, length, rest[i], normals[i])
        store(ids, w, n, indices[i], weights[i])
