"""Bones that hang on joints: are known skeletons found, and what does a tree cost on real data?

    python benchmarks/accuracy/skeletons.py                       # hours; --only takes words
    python benchmarks/accuracy/skeletons.py --only "exact fox" --set effort=balanced rng=1
    python benchmarks/accuracy/skeletons.py --only free           # free bones beside a tree's

exact: skeletons that are known, from the vertices of their animation alone: game characters (glTF,
their own skinning, every clip), the body of garmentnet in a dance, random trees.  free: as many
bones without joints, whose error is to be no larger than the tree's.  real: sequences whose
skeleton nobody knows, against free bones.  held_out: a rig of every second frame explains the
others by rotations alone.  given_exact: the true skeleton handed over, and with joints off by 2 %.
given: a rig handed over, likewise, with extra bones, and beside Dem Bones from the same start.
seeds: do five seeds and renumbered vertices give the same tree?
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.accuracy.known_skeletons import (
    ANIMALS,
    INFLUENCES,
    RANDOM,
    agreement,
    judge,
    known,
)
from benchmarks.common import Row, e_of

REAL = {"horse_gallop": 20, "mannequin_rumba": 30, "samba": 20, "cow_elastic": 24}


def subject(data: str) -> tuple[np.ndarray, np.ndarray | None, int]:
    """Frames, faces where there are any, and the number of bones to ask for."""
    if data in REAL:
        return (*common.load(data), REAL[data])
    truth = known(data)
    return truth.frames, None, truth.bones()


def exact(data: str, effort: Any, rng: int) -> Row:
    truth = known(data)
    influences = max(INFLUENCES, truth.skinning.n_influences)
    began = time.perf_counter()
    found = ssdr.decompose(
        truth.frames, bones=truth.bones(), influences=influences, effort=effort, rig="rigid",
        rng=rng,
    ).skinning  # fmt: skip
    return {
        "seconds": time.perf_counter() - began,
        "bones": found.n_bones,
        "vertices": truth.frames.shape[1],
        "frames": len(truth.frames),
        "rmse / diagonal": common.rmse_of(truth.frames, found) / truth.diagonal,
        "gap / diagonal": float(found.joint_gaps().max()) / truth.diagonal,
        **judge(truth, found),
    }


def free(data: str, effort: Any, rng: int, bones: int = 19) -> Row:
    """Error of free bones beside that of a rigid tree of as many bones."""
    frames, faces = common.load(data)
    diagonal = ssdr.MeshSequence(frames).diagonal()
    out: Row = {"bones": bones}
    for name, rig in (("rmse / diagonal", None), ("rigid tree, rmse / diagonal", "rigid")):
        began = time.perf_counter()
        found = ssdr.decompose(frames, faces, bones=bones, effort=effort, rng=rng, rig=rig)
        out[name] = common.rmse_of(frames, found.skinning) / diagonal
        out[f"{rig or 'free'}, seconds"] = time.perf_counter() - began
    return out


def real(data: str, effort: Any, rng: int) -> Row:
    frames, faces, bones = subject(data)
    began = time.perf_counter()
    tree = ssdr.decompose(frames, faces, bones=bones, effort=effort, rig="rigid", rng=rng).skinning
    seconds = time.perf_counter() - began
    flat = ssdr.decompose(frames, faces, bones=bones, rng=rng).skinning
    loose = ssdr.decompose(frames, faces, bones=bones, rng=rng, rig="loose").skinning
    e, e_flat = e_of(frames, tree), e_of(frames, flat)
    gaps = loose.joint_gaps()[:, loose.parents >= 0] / ssdr.MeshSequence(frames).diagonal()
    return {
        "bones": bones,
        "E": e,
        "free, balanced": e_flat,
        "ratio": e / e_flat,
        "loose, E is the free one's": e_of(frames, loose) == e_flat,
        "loose, median gap / diagonal": float(np.median(gaps)),
        "seconds": seconds,
    }


def held_out(data: str, effort: Any, rng: int) -> Row:
    """Fit a rig to every second frame and explain the others by its rotations and root alone."""
    frames, _, bones = subject(data)
    rig = ssdr.decompose(frames[::2], bones=bones, effort=effort, rig="rigid", rng=rng).skinning
    other = ssdr.decompose(
        frames[1::2], rig=ssdr.Skeleton(rig), start=kept(rig), effort=effort
    ).skinning
    fitted, explained = e_of(frames[::2], rig), e_of(frames[1::2], other)
    return {
        "bones": bones,
        "E of the frames fitted": fitted,
        "E of the others": explained,
        "ratio": explained / fitted,
    }


def kept(rig: ssdr.Skinning) -> ssdr.Start:
    """Start that keeps the rest pose and weights of a rig."""
    return ssdr.Start(rest=rig.rest, indices=rig.indices, weights=rig.weights)


def seeds(data: str, effort: Any, rng: int) -> Row:
    """Share of the edges that five seeds and renumbered vertices have in common with the first."""
    frames, _, bones = subject(data)
    order = np.random.default_rng(0).permutation(frames.shape[1])
    options: Row = {"bones": bones, "effort": effort, "rig": "rigid"}
    first, *others = (
        ssdr.decompose(frames, rng=k, **options).skinning for k in range(rng, rng + 5)
    )
    mixed = ssdr.decompose(frames[:, order], rng=rng, **options).skinning
    back = {
        part: getattr(mixed, part)[np.argsort(order)] for part in ("rest", "indices", "weights")
    }
    return {
        "bones": bones,
        "seeds": [agreement(first, other) for other in others],
        "renumbered": agreement(first, dataclasses.replace(mixed, **back)),
    }


def given_exact(data: str, effort: Any, rng: int) -> Row:
    """Fit weights, rest pose and motion to the true skeleton as it stands in the first frame.

    Also with joints 2 % off, and in its own rest pose, which is kept.
    """
    truth = known(data)
    model = truth.skinning
    # parents, joints and names alone, as of a rig of another mesh
    parts = {part: getattr(model, part)[:-1] for part in ("rest", "indices", "weights")}
    alone = dataclasses.replace(model, **parts, faces=None, surface=None, vertex_map=None)
    first = model.transforms[0]
    posed = np.einsum("bij,bj->bi", first[..., :3], model.joint_positions) + first[..., 3]
    row: Row = {"bones": model.n_bones}
    for key, joints, rest in (
        ("rmse / diagonal", posed, None),
        ("rmse, joints 2 % off", moved(posed, truth.diagonal), None),
        ("rmse, rest pose kept", model.joint_positions, truth.rest),
    ):
        result = ssdr.decompose(
            truth.frames,
            rig=ssdr.Skeleton(dataclasses.replace(alone, joint_positions=joints)),
            start=ssdr.Start(rest=rest),
            influences=max(INFLUENCES, model.n_influences),
            effort=effort,
            rng=rng,
        )
        row[key] = result.rmse / truth.diagonal
    return row


def moved(joints: np.ndarray, diagonal: float) -> np.ndarray:
    """Joints displaced by 2 % of the diagonal."""
    off = np.random.default_rng(0).normal(size=joints.shape) / np.sqrt(3)
    return np.asarray(joints + 0.02 * diagonal * off)


def given(data: str, effort: Any, rng: int) -> Row:
    """Fit a given rig: as it is, with joints 2 % off, with extra bones, and by Dem Bones.

    Dem Bones starts from the same rest pose and transforms, with the rig's weights or with its
    own for them; its joints may come apart, as those of a loose rig.
    """
    frames, faces, bones = subject(data)
    options: Row = {"effort": effort, "rng": rng}
    rig = ssdr.decompose(frames, faces, bones=bones, rig="rigid", **options).skinning
    joints = moved(rig.joint_positions, ssdr.MeshSequence(frames).diagonal())
    off = dataclasses.replace(rig, joint_positions=joints)

    def solved(skeleton: ssdr.Skeleton) -> float:
        return e_of(frames, ssdr.decompose(frames, faces, rig=skeleton, **options).skinning)

    return {
        "bones": bones,
        "E of the rig": e_of(frames, rig),
        "E": solved(ssdr.Skeleton(rig)),
        "E, joints 2 % off": solved(ssdr.Skeleton(off)),
        **{f"E, {k} more": solved(ssdr.Skeleton(rig, extra_bones=k)) for k in (2, 4, 8)},
        "E, loose": solved(ssdr.Skeleton(rig, joints="loose")),
        "E of Dem Bones, its own weights": dem_bones(rig, frames, faces, weights=False),
        "E of Dem Bones": dem_bones(rig, frames, faces, weights=True),
    }


def dem_bones(rig: ssdr.Skinning, frames: np.ndarray, faces: Any, *, weights: bool) -> float:
    """Least E of thirty iterations from a rig's rest pose and transforms, and its weights."""
    from benchmarks.peers.dem_bones import iterates, lowest, prepared

    solver = prepared(frames, faces, rig.n_bones, rig.n_influences, rest=rig.rest)
    m = np.zeros((len(frames), 4, rig.n_bones, 4))
    m[:, :3] = rig.transforms.transpose(0, 2, 1, 3)
    m[:, 3, :, 3] = 1.0
    if weights:
        solver.set_weights(np.ascontiguousarray(rig.dense_weights().T.astype(np.float64)))
    solver.m = m.reshape(4 * len(frames), -1)
    errors, _ = lowest(frames, np.asarray(rig.rest), iterates(solver, len(frames), 30))
    return float(np.nanmin(errors))


PARTS: dict[str, tuple[Any, list[str]]] = {
    "exact": (exact, [*ANIMALS, "body", *RANDOM]),
    "free": (free, ["fox"]),
    "real": (real, [*REAL]),
    "held_out": (held_out, ["fox", "tree-18", *REAL]),
    "given_exact": (given_exact, ["fox", "body", "tree-18"]),
    "given": (given, ["horse_gallop", "mannequin_rumba"]),
    "seeds": (seeds, ["fox", "tree-8", "horse_gallop"]),
}


def measure(part: str, data: str, effort: str = "best", rng: int = 0, **more: Any) -> Row:
    common.compile_kernels()
    return {"effort": effort, "rng": rng, **PARTS[part][0](data, effort, rng, **more)}


if __name__ == "__main__":
    cases = {
        f"{part} {data}": {"part": part, "data": data}
        for part, (_, names) in PARTS.items()
        for data in names
    }
    columns = (
        "bones", "rmse / diagonal", "rigid tree, rmse / diagonal", "joints", "right",
        "joint error, median", "E", "ratio", "seconds",
    )  # fmt: skip
    common.run(__file__, __doc__, cases, measure, columns)
