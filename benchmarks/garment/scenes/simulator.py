"""Simulation of a clip: cloth on a moving body, with its quality measured.

A clip runs on one core and gives the same bits every time.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from garmentnet.data.outfit import Outfit, neighbours
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.skeleton import Skeleton
from garmentnet.data.skin_weights import BodyBound
from garmentnet.importing.quality import LIMITS, judge
from ssdr.common.errors import InputError

from .body import Body
from .cloth import Cloth
from .garments import Garment
from .motion import Motion, interpolate

# Version of the simulator, raised when a scene gives another clip; part of a clip's provenance.
VERSION = 3
# Number of averages with the neighbours that make a perturbation smooth over a few edges.
_SMOOTHINGS = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated clip.

    Attributes
    ----------
    vertices : (F, V, 3) float32
        The garment in every frame of the motion.
    quality : dict
        Of :func:`garmentnet.importing.quality.judge`.
    """

    vertices: NDArray[np.float32]
    quality: dict[str, Any]


def simulate(
    cloth: Cloth,
    motion: Motion,
    parameters: SimulationParameters,
    *,
    limits: Mapping[str, float] = LIMITS,
    seed: int = 0,
    perturbation: float = 0.0,
) -> Simulated:
    """Simulate a garment on a moving body.

    The body moves from rest to its first pose and waits there before the first frame.

    Parameters
    ----------
    cloth : Cloth
    motion : Motion
    parameters : SimulationParameters
    limits : mapping, optional
        Of the clip's quality, by name.
    seed : int
        Seed of the perturbation.
    perturbation : float
        RMS length, metres, of smooth random displacements of the settled garment before the first
        frame; the difference of the resulting clip from the unperturbed one measures chaos.

    Returns
    -------
    Simulated

    Raises
    ------
    InputError
        If the motion is that of another skeleton or a number is not usable.
    """
    body, garment, solver = cloth.body, cloth.garment, cloth.solver
    if motion.joints.shape[1] != body.skeleton.n_joints:
        raise InputError("motion", f"{body.skeleton.n_joints} joints", motion.joints.shape[1])
    if not (math.isfinite(perturbation) and 0 <= perturbation <= 0.1):
        raise InputError("perturbation", "0 to 0.1 m", perturbation)
    before = lead_in(body.skeleton, motion.joints, solver.approach, solver.settle)
    joints = np.concatenate([before, motion.joints])
    # Rounded to float32 as in the store, so that a clip can be simulated again from its store.
    joints = joints.astype(np.float32).astype(np.float64)
    moved = perturbation_field(garment, perturbation, seed) if perturbation > 0 else None
    vertices = cloth.simulate(joints, motion.fps, parameters, first=len(before), moved=moved)
    outfit, bound = outfit_of(body, garment, motion.fps), pins_of(garment)
    quality = judge(outfit, motion.joints, vertices, bound=bound, limits=limits)
    return Simulated(vertices, quality)


def pins_of(garment: Garment) -> BodyBound:
    """Pinned vertices of a garment, and how the body carries them."""
    index = np.flatnonzero(garment.pinned).astype(np.int32)
    rest = garment.rest[index].astype(np.float64)
    return BodyBound(index, rest, rest, garment.indices[index], garment.weights[index])


def outfit_of(body: Body, garment: Garment, fps: float) -> Outfit:
    """Garment and body as clips share them."""
    return Outfit(
        rest=garment.rest,
        faces=garment.faces,
        body=body.skinning,
        skeleton=body.skeleton,
        fps=fps,
        pinned=garment.pinned,
        mirror_vertices=garment.mirror,
    )


def lead_in(
    skeleton: Skeleton, joints: NDArray[np.float64], moving: int, still: int
) -> NDArray[np.float64]:
    """Transforms ``(moving + still, J, 3, 4)`` that move the body from rest to its first pose.

    The motion starts in the rest pose, at the place and with the heading of the first frame,
    reaches the first pose after `moving` frames and holds it for `still` frames.

    Examples
    --------
    >>> body = Skeleton(("root",), [-1], [[0, 1, 0]])
    >>> joints = body.transforms([[2.0, 1.5, 0.0]], np.eye(3)[None, None])
    >>> body.positions(lead_in(body, joints, 2, 1))[:, 0].tolist()
    [[2.0, 1.0, 0.0], [2.0, 1.25, 0.0], [2.0, 1.5, 0.0]]
    """
    root, local = skeleton.pose(joints[:1])
    forward = local[0, 0] @ [0.0, 0.0, 1.0]
    heading = math.atan2(forward[0], forward[2])
    rest_root = np.array([root[0, 0], skeleton.rest[0, 1], root[0, 2]])
    rest_local = np.broadcast_to(np.eye(3), local.shape[1:]).copy()
    rest_local[0] = Rotation.from_euler("y", heading).as_matrix()
    start = skeleton.transforms(rest_root[None], rest_local[None])
    t = np.arange(moving) / max(1, moving)
    t = t * t * (3 - 2 * t)  # starts and ends at rest
    both = np.concatenate([start, joints[:1]])
    return np.concatenate([interpolate(skeleton, both, t), np.repeat(joints[:1], still, axis=0)])


def perturbation_field(garment: Garment, size: float, seed: int) -> NDArray[np.float32]:
    """Smooth random displacements ``(V, 3)`` of free vertices; their RMS length is `size`."""
    rng = np.random.default_rng([seed, 0xC4A05])
    n = garment.n_vertices
    noise = rng.normal(size=(n, 3))
    starts, others = neighbours(garment.faces, n)
    near, degree = csr_array((np.ones(len(others)), others, starts), (n, n)), np.diff(starts)
    free = ~garment.pinned
    for _ in range(_SMOOTHINGS):
        # Displacements of single vertices would only stretch edges and vanish at once; smooth ones
        # change folds.
        noise = 0.5 * noise + 0.5 * np.asarray(near @ noise) / degree[:, None]
        noise[~free] = 0.0
    noise *= size / math.sqrt(float((noise[free] ** 2).sum(axis=1).mean()))
    return noise.astype(np.float32)
