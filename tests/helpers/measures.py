"""What the tests of decompositions share: two small motions, and measures by code of their own."""

from __future__ import annotations

import functools

import numpy as np

import ssdr
from helpers import motions
from ssdr.search.prescribed import Prescribed
from ssdr.search.run import Run, Stage
from ssdr.search.stages import Alternate, Start
from ssdr.solver.model import Fixed, Model
from ssdr.solver.trajectories import Trajectories


@functools.cache
def rig() -> motions.Rig:
    return motions.chain(bones=5, rows=14, frames=15)


@functools.cache
def frames() -> np.ndarray:
    """The rig's frames with a wobble that no bones can follow."""
    return motions.still(motions.wobble(rig(), 0.1))


@functools.cache
def wavy() -> np.ndarray:
    """The same with half the wobble."""
    return motions.still(motions.wobble(rig(), 0.05))


@functools.cache
def small() -> ssdr.Decomposition:
    return ssdr.decompose(wavy(), tolerance="0.8%", effort="fast")


def solved(
    data: Trajectories, bones: int, influences: int = 4, schedule: list[Stage] | None = None
) -> Model:
    run = Run(
        data,
        schedule or [Start(), Alternate(steps=8)],
        bones=bones,
        influences=influences,
        rng=np.random.default_rng(0),
        fixed=Fixed(),
        prescribed=Prescribed(),
    )
    run.drive()
    return run.best_model


def diagonal(array: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(array, axis=1), axis=1).max())


def pooled(frames: np.ndarray, again: np.ndarray) -> float:
    """RMSE over all vertices of all frames."""
    return float(np.sqrt(((frames - again) ** 2).sum(axis=-1).mean()))


def played(skinning: ssdr.Skinning) -> np.ndarray:
    """The frames of a model, by code of the tests alone."""
    s = skinning
    return motions.blend(s.rest, s.indices, s.weights, s.transforms)


def rmse_of(skinning: ssdr.Skinning, array: np.ndarray) -> float:
    return pooled(array, played(skinning))


def largest_of(skinning: ssdr.Skinning, array: np.ndarray) -> float:
    """The largest distance of a vertex from where it should be."""
    return float(np.sqrt(((played(skinning) - array) ** 2).sum(axis=-1).max()))


def bits(result: ssdr.Decomposition) -> list[bytes]:
    s = result.skinning
    return [a.tobytes() for a in (s.rest, s.indices, s.weights, s.transforms)]
