"""Simulation of a garment on a moving body: vertex block descent, few iterations, many substeps.

A clip runs on one core and gives the same bits every time.  Its quality is measured before it is
used for training.

References
----------
Chen et al., "Vertex Block Descent", SIGGRAPH 2024; the solver is newton's ``SolverVBD``, which
its authors mark experimental: its version is pinned.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from ssdr.errors import InputError

from ..data.motion import Motion, interpolate, lead_in
from ..data.parameters import SimulationParameters
from .body import Body
from .cloth import Cloth, Solver
from .garments import Garment
from .quality import Gate, Quality, judge

__all__ = ["Simulated", "simulate", "versions"]

# Averages with the neighbours, after which a perturbation is smooth over a few edges.
_SMOOTHINGS = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated clip.

    Attributes
    ----------
    vertices : (F, V, 3) float32
        The garment in every frame of the motion.
    quality : Quality
    """

    vertices: NDArray[np.float32]
    quality: Quality


def versions() -> dict[str, str]:
    """Versions of the packages that decide the bits of a clip."""
    return {p: importlib.metadata.version(p) for p in ("newton", "warp-lang")}


def simulate(
    body: Body,
    garment: Garment,
    motion: Motion,
    parameters: SimulationParameters,
    *,
    solver: Solver | None = None,
    gate: Gate | None = None,
    seed: int = 0,
    perturbation: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> Simulated:
    """Simulate a garment on a moving body.

    Parameters
    ----------
    body : Body
    garment : Garment
        Cut on this body.
    motion : Motion
    parameters : SimulationParameters
    solver : Solver, optional
    gate : Gate, optional
    seed : int
        Of the perturbation.
    perturbation : float
        RMS displacement in metres, smooth and random, of the settled garment before the first
        frame; the difference that results measures chaos.
    progress : callable, optional
        Called with the frames done and all frames, settling included.

    Returns
    -------
    Simulated

    Raises
    ------
    InputError
        If the motion is of another skeleton or a number is not usable.
    MissingDependencyError
        Without newton or warp.
    """
    how = solver or Solver()
    if motion.joints.shape[1] != body.skeleton.n_joints:
        raise InputError("motion", f"{body.skeleton.n_joints} joints", motion.joints.shape[1])
    if not (math.isfinite(perturbation) and 0 <= perturbation <= 0.1):
        raise InputError("perturbation", "0 to 0.1 m", perturbation)
    tree = body.skeleton
    before = lead_in(tree, motion.joints, how.approach, how.settle)
    joints = np.concatenate([before, motion.joints])
    first = len(before)
    # Rounded to float32 as in the store, so that a clip can be simulated again from its store.
    joints = joints.astype(np.float32).astype(np.float64)
    cloth = Cloth(body, garment, parameters, how, motion.fps, joints[0])
    out = np.empty((motion.n_frames, garment.n_vertices, 3), dtype=np.float32)
    for frame in range(len(joints)):
        if frame == first and perturbation > 0:
            cloth.move(_unrest(garment, perturbation, seed))
        if frame > 0:
            steps = frame - 1 + np.arange(1, how.substeps + 1) / how.substeps
            cloth.advance(_between(tree, joints, frame, steps))
        if frame >= first:
            out[frame - first] = cloth.positions()
        if progress is not None:
            progress(frame + 1, len(joints))
        if not np.isfinite(cloth.positions()).all():
            # It does not come back: the rest would be NaN as well.
            out[max(0, frame - first) :] = np.nan
            break
    return Simulated(out, judge(body, garment, motion, out, gate))


def _between(
    tree: Any, joints: NDArray[np.float64], frame: int, steps: NDArray[np.float64]
) -> NDArray[np.float64]:
    return interpolate(tree, joints[frame - 1 : frame + 1], steps - (frame - 1))


def _unrest(garment: Garment, size: float, seed: int) -> NDArray[np.float32]:
    """Smooth random displacements ``(V, 3)`` of free vertices; their RMS length is `size`."""
    rng = np.random.default_rng([seed, 0xC4A05])
    noise = rng.normal(size=(garment.n_vertices, 3))
    e = garment.edges()
    n = garment.n_vertices
    ones = np.ones(len(e))
    near = coo_array((ones, (e[:, 0], e[:, 1])), (n, n)).tocsr()
    near = near + near.T
    degree: NDArray[np.float64] = np.asarray(near.sum(axis=1)).ravel()[:, None]
    free = ~garment.pinned
    for _ in range(_SMOOTHINGS):
        # Displacements of single vertices would only stretch edges and vanish at once; smooth ones
        # change folds.
        noise = 0.5 * noise + 0.5 * np.asarray(near @ noise) / degree
        noise[~free] = 0.0
    noise *= size / math.sqrt(float((noise[free] ** 2).sum(axis=1).mean()))
    return noise.astype(np.float32)
