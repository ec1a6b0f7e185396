"""The loop over frames and substeps of a clip, one compiled function without the GIL."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssdr.kernels.closest import fit_boxes

from .chunks import Chunks
from .constraints import BUFFER_ROWS, bend, stretch
from .contact import find_contacts, push_out, skin_points
from .policy import INDEX, LANES, ONE, REAL, THREE, TWO, kernel

_GRAVITY = REAL(9.81)  # m/s², along -y


class BodyArrays(NamedTuple):
    """Arrays of the collider: its skin and the tree of its triangles."""

    skin: tuple[Any, ...]  # vertices of the body, as skin_points takes them
    triangles: NDArray[np.int32]  # (T, 3) in the tree's order
    corners: NDArray[np.uint64]  # (T, 3) 3 times the triangles' vertices
    beside: NDArray[np.int32]  # (T, 3) triangle beyond the edges 01, 12, 20; -1: none
    sides: NDArray[np.int8]  # (T,) 1 on the left limbs, -1 on the right ones, 0 elsewhere
    depth: int


class ClothArrays(NamedTuple):
    """Arrays of the garment and its constraints."""

    rest: NDArray[np.float32]  # (V, 3)
    sides: NDArray[np.int8]  # (V,) 1 on a left sleeve or leg, -1 on a right one, 0 elsewhere
    free: NDArray[np.uint64]
    clusters: NDArray[np.int64]  # (C, CLUSTER) free vertices near each other, see find_contacts
    pinned: NDArray[np.uint64]
    pins: tuple[Any, ...]  # pinned vertices, as skin_points takes them
    weights: NDArray[np.float32]  # (V,) inverse masses
    edges: Chunks
    hinges: Chunks


class Step(NamedTuple):
    """Numbers of a substep; lengths in metres, times in the cloth's seconds."""

    substeps: int  # in a frame
    blocks: int  # in a frame: the body is posed, and the nearest triangles are searched, in each
    h: Any  # length of a substep
    damping: Any  # γ of the hinges
    decay: Any  # factor of velocities in a substep, due to drag
    distance: Any  # distance of the cloth from the skin
    friction: Any
    push: Any  # the longest push out of the body in a substep
    reach: Any  # distance within which contact is searched


@kernel
def simulate_frames(
    body: Any,
    cloth: Any,
    joints: Any,
    roots: Any,
    step: Step,
    first: int,
    moved: Any,
    out: Any,
) -> None:
    """Simulate a clip from the rest shape at the first pose.

    joints  ((F - 1) * blocks + 1, J, 12) float64  transforms from rest, at the ends of blocks
    roots   (F, 3)                        float64  position of the root in every frame
    first                                 int      first frame that is written
    moved   (V, 3)                        float32  displacements added just before that frame
    out     (F - first, V, 3)             float32  out
    """
    n, free, n_pins = len(cloth.rest), cloth.free, len(cloth.pinned)
    x, v, previous = np.zeros(3 * n, REAL), np.zeros(3 * n, REAL), np.zeros(3 * n, REAL)
    buffer = np.zeros(BUFFER_ROWS * LANES, REAL)
    transforms = np.empty(joints.shape[1:], REAL)
    # Skin and pinned vertices at the start and the end of a block.
    skin0, pins0 = np.empty(3 * len(body.skin[0]), REAL), np.empty(3 * n_pins, REAL)
    skin1, pins1 = skin0.copy(), pins0.copy()
    boxes = np.empty((2 ** (body.depth + 1) - 1, 6), REAL)
    nearest, close = np.full(n, -1, np.int32), np.empty(n, INDEX)
    rate, per_block = REAL(1) / step.h, step.substeps // step.blocks
    share = REAL(1) / REAL(per_block)
    origin = roots[0].copy()

    _pose(body, cloth, joints[0], origin, transforms, skin1, pins1)
    for i in range(n):
        for r in range(3):
            x[3 * i + r] = transforms[0, 4 * r + 3]
            for k in range(3):
                x[3 * i + r] += transforms[0, 4 * r + k] * cloth.rest[i, k]
    for frame in range(len(roots)):
        if frame == first:
            for i in range(n):
                for k in range(3):
                    x[3 * i + k] += moved[i, k]
        if frame > 0:
            # The origin follows the root, one frame behind.
            for k in range(3):
                shift = REAL(roots[frame - 1, k] - origin[k])
                origin[k] = roots[frame - 1, k]
                x[k::3] -= shift
                skin1[k::3] -= shift
                pins1[k::3] -= shift
        for block in range(step.blocks if frame > 0 else 0):
            skin0, skin1, pins0, pins1 = skin1, skin0, pins1, pins0
            end = (frame - 1) * step.blocks + block + 1
            _pose(body, cloth, joints[end], origin, transforms, skin1, pins1)
            fit_boxes(skin0.reshape(-1, 3), body.triangles, body.depth, boxes)
            tree = (skin0, body.triangles, body.sides, body.depth, boxes)
            n_close = find_contacts(
                x, cloth.clusters, cloth.sides, step.reach, tree, nearest, close
            )
            for substep in range(per_block):
                fraction = REAL((substep + 1.0) / per_block)
                _predict(x, previous, v, cloth, step.h, pins0, pins1, fraction)
                bend(x, previous, cloth.hinges, step.damping, buffer)
                stretch(x, cloth.edges, buffer)
                for i in free:
                    if nearest[i] < 0:
                        o = THREE * i
                        v[o] = (x[o] - previous[o]) * rate
                        v[o + ONE] = (x[o + ONE] - previous[o + ONE]) * rate
                        v[o + TWO] = (x[o + TWO] - previous[o + TWO]) * rate
                skin = (body.corners, body.beside, skin0, skin1, fraction, share)
                limits = (step.distance, step.friction, step.push)
                push_out(x, previous, v, close, n_close, nearest, skin, limits, rate)
                for o in range(3 * n):
                    v[o] *= step.decay
        if frame >= first:
            for i in range(n):
                for k in range(3):
                    out[frame - first, i, k] = x[3 * i + k] + origin[k]


@kernel
def _pose(body, cloth, joints, origin, transforms, skin, pins):
    """Pose skin and pinned vertices by the transforms `joints` (J, 12), relative to `origin`."""
    for j in range(len(joints)):
        for k in range(12):
            transforms[j, k] = joints[j, k] - (origin[k // 4] if k % 4 == 3 else 0.0)
    skin_points(body.skin, transforms, skin)
    skin_points(cloth.pins, transforms, pins)


@kernel
def _predict(x, previous, v, cloth, h, pins0, pins1, fraction):
    """Move free vertices by their velocities and gravity, pinned ones with the body."""
    for q in range(len(cloth.pinned)):
        for k in range(3):
            o = THREE * cloth.pinned[q] + INDEX(k)
            previous[o] = x[o]
            x[o] = pins0[3 * q + k] + fraction * (pins1[3 * q + k] - pins0[3 * q + k])
    for i in cloth.free:
        o = THREE * i
        previous[o], previous[o + ONE], previous[o + TWO] = x[o], x[o + ONE], x[o + TWO]
        x[o] += h * v[o]
        x[o + ONE] += h * (v[o + ONE] - h * _GRAVITY)
        x[o + TWO] += h * v[o + TWO]
