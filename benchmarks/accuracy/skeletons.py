"""Bones that hang on joints: are known skeletons found, and what does a tree cost on real data?

    python benchmarks/accuracy/skeletons.py --parts exact real held_out given seeds --effort best

exact: skeletons that are known, from the vertices of their animation alone: game characters (glTF,
their own skinning, every clip), the body of garmentnet in a dance, random trees that this file
makes.  real: sequences whose skeleton nobody knows, against the flat model of the same bones.
held_out: a rig of every second frame explains the others by rotations alone.  given_exact: the true
skeleton handed over, and with joints off by 2 %.  given: a rig handed over, likewise, with extra
bones, and beside Dem Bones from the same start.  seeds: do
five seeds and renumbered vertices give the same tree?  Results are kept from run to run; what is
there is not run again, unless --again.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import (
    RESULTS,
    data_folder,
    error_e,
    load,
    machine,
    reskin,
    table,
    tell,
    write_json,
)

INFLUENCES = 4
ANIMALS = {"fox": "Fox.glb", "llama": "Llama.gltf", "pig": "Pig.gltf"}
RANDOM = {"tree-8": (8, 0), "tree-18": (18, 1), "tree-30": (30, 2)}  # bones, seed
REAL = {"horse_gallop": 20, "mannequin_rumba": 30, "samba": 20, "cow_elastic": 24}
_SAME = 1e-5  # of the diagonal: a gap of a known joint above this is none


@dataclasses.dataclass(frozen=True, eq=False)
class Truth:
    """An animation whose skeleton is known."""

    skinning: ssdr.Skinning
    frames: np.ndarray
    rest: np.ndarray
    weights: np.ndarray  # (V, B)

    @property
    def diagonal(self) -> float:
        return ssdr.MeshSequence(self.frames).diagonal()


def known(name: str) -> Truth:
    if name in ANIMALS:
        skinning = ssdr.load_skinning(data_folder() / "gltf" / ANIMALS[name])
    elif name == "body":
        skinning = dancing_body()
    else:
        skinning = random_tree(*RANDOM[name])
    weights = np.asarray(skinning.dense_weights(), dtype=np.float64)
    frames = reskin(skinning.rest, skinning.indices, skinning.weights, skinning.transforms)
    # vertices at seams are one vertex: they move alike in every frame
    size = 1e-6 * np.ptp(frames)
    way = np.round(frames.transpose(1, 0, 2).reshape(frames.shape[1], -1) / size)
    keep = np.sort(np.unique(way, axis=0, return_index=True)[1])
    return Truth(
        skinning, np.ascontiguousarray(frames[:, keep]), skinning.rest[keep], weights[keep]
    )


def dancing_body() -> ssdr.Skinning:
    from garmentnet.scenes.body import default_body
    from garmentnet.scenes.dance.choreography import dance

    body = default_body()
    motion = dance(body.skeleton, seed=5, frames=300, repertoire="wide")
    return dataclasses.replace(
        body.skinning,
        transforms=np.asarray(motion.joints, dtype=np.float64),
        clips=None,
        parents=np.asarray(body.skeleton.parents),
        joint_positions=np.asarray(body.skeleton.rest, dtype=np.float64),
    )


def random_tree(bones: int, seed: int, frames: int = 120) -> ssdr.Skinning:
    """Sticks with skin around them on a random tree; a vertex has up to four near bones."""
    rng = np.random.default_rng(seed)
    parents = np.array([-1, *[int(rng.integers(max(0, b - 3), b)) for b in range(1, bones)]])
    way, points = np.zeros((bones, 3)), np.zeros((bones, 3))
    for b in range(bones):
        direction = rng.normal(size=3) + (1.5 * way[parents[b]] if b else 0.0)
        way[b] = direction / np.linalg.norm(direction)
        if b:
            # children of one bone hang apart: at one point motion could not tell them from
            # children of each other
            points[b] = points[parents[b]] + rng.uniform(0.6, 1.0) * way[parents[b]]
            points[b] += 0.1 * rng.normal(size=3)
    along, angle = np.linspace(0, 1, 12, endpoint=False), np.linspace(0, 2 * np.pi, 10)[:-1]
    rest = []
    for b in range(bones):
        side = np.linalg.svd(way[b][None])[2][1:]
        ring = 0.18 * (np.cos(angle)[:, None] * side[0] + np.sin(angle)[:, None] * side[1])
        rest.append((points[b] + along[:, None] * way[b])[:, None] + ring)
    vertices = np.concatenate([part.reshape(-1, 3) for part in rest])
    across = np.clip(np.einsum("vbd,bd->vb", vertices[:, None] - points, way), 0.15, 0.85)
    away = np.linalg.norm(
        vertices[:, None] - points - across[..., None] * way, axis=-1
    )  # from each stick
    own = np.repeat(np.arange(bones), len(along) * len(angle))
    near = np.zeros((bones, bones), dtype=bool)
    for b in range(bones):
        near[b, b] = True
        if b:
            near[b, parents[b]] = near[parents[b], b] = True
    dense = np.where(near[own], np.exp(-((away / 0.25) ** 2)), 0.0)
    indices = np.argsort(-dense, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(dense, indices, axis=1)
    weights[weights < 0.02 * weights[:, :1]] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    clock = np.linspace(0, 4 * np.pi, frames)[:, None, None]
    pace, phase = rng.uniform(0.5, 2.5, (bones, 3)), rng.uniform(0, 6, (bones, 3))
    turns = 0.6 * np.sin(pace * clock + phase) * rng.uniform(0.2, 1, (bones, 3))
    still = np.broadcast_to(np.eye(3, 4), (1, bones, 3, 4))
    model = ssdr.Skinning(
        vertices, indices, weights, still, parents=parents, joint_positions=points
    )
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(frames, bones, 3, 3)
    return model.pose(local, 0.5 * np.sin(0.5 * clock + phase[0]))


# --- known skeletons -----------------------------------------------------------------------------


def groups_of(truth: Truth) -> np.ndarray:
    """Bones that never turn against each other are one to any method: a number each, −1 unused."""
    model = truth.skinning
    freedom, gaps = model.joint_freedom(0.2), model.joint_gaps().max(axis=0)
    group = np.arange(model.n_bones)
    for b in np.argsort([_depth(model.parents, b) for b in range(model.n_bones)], kind="stable"):
        a = model.parents[b]
        if a >= 0 and freedom[b] == "nothing" and gaps[b] < _SAME * truth.diagonal:
            group[b] = group[a]
    used = np.zeros(model.n_bones)
    np.add.at(used, group, (truth.weights**2).sum(axis=0))
    return np.where(used[group] > 0, group, -1)


def bones_of(truth: Truth) -> int:
    """As many as move apart."""
    group = groups_of(truth)
    return len(np.unique(group[group >= 0]))


def subject(name: str) -> tuple[np.ndarray, np.ndarray | None, int]:
    """Frames, faces where there are any, and the number of bones to ask for."""
    if name in REAL:
        return (*load(name), REAL[name])
    truth = known(name)
    return truth.frames, None, bones_of(truth)


def _depth(parents: np.ndarray, bone: int) -> int:
    count = 0
    while parents[bone] >= 0:
        bone, count = parents[bone], count + 1
    return count


def judge(truth: Truth, group: np.ndarray, found: ssdr.Skinning) -> dict[str, Any]:
    """Edges and joints of the truth in what was found."""
    model, diagonal = truth.skinning, truth.diagonal
    names = np.unique(group[group >= 0])
    merged = np.stack([truth.weights[:, group == g].sum(axis=1) for g in names], axis=1)
    overlap = merged.T @ found.dense_weights()
    rows, columns = linear_sum_assignment(-overlap)
    place = dict(zip(names[rows].tolist(), columns.tolist(), strict=True))
    freedom, gaps = model.joint_freedom(0.2), model.joint_gaps().max(axis=0)
    judged, right, away = [], [], []
    for b, a in enumerate(model.parents):
        if a < 0 or -1 in (group[a], group[b]) or group[a] == group[b]:
            continue
        if gaps[b] > _SAME * diagonal:
            continue
        judged.append(model.joint_names[b])
        x, y = place.get(int(group[b]), -1), place.get(int(group[a]), -1)
        child = x if found.parents[x] == y else y if found.parents[y] == x else -1
        if -1 in (x, y, child):
            continue
        right.append(model.joint_names[b])
        there = _carried(found.transforms[:, child], found.joint_positions[child])
        true = _carried(model.transforms[:, b], model.joint_positions[b])
        off = there - true
        if freedom[b] == "line":  # where along the axis nobody can tell
            relative = (
                np.swapaxes(model.transforms[:, a, :, :3], 1, 2) @ model.transforms[:, b, :, :3]
            )
            spread = relative - relative.mean(axis=0)
            _, vectors = np.linalg.eigh(np.einsum("tca,tcd->ad", spread, spread))
            axis = model.transforms[:, b, :, :3] @ vectors[:, 0]
            off -= np.einsum("ta,ta->t", off, axis)[:, None] * axis
        away.append(float(np.linalg.norm(off, axis=1).mean()) / diagonal)
    return {
        "joints": len(judged),
        "right": len(right),
        "wrong": sorted(set(judged) - set(right)),
        "joint error, median": float(np.median(away)) if away else None,
        "joint error, largest": max(away, default=None),
    }


def _carried(transforms: np.ndarray, point: np.ndarray) -> np.ndarray:
    return transforms[..., :3] @ point + transforms[..., 3]


def exact(name: str, effort: Any, seed: int) -> dict[str, Any]:
    truth = known(name)
    group, bones = groups_of(truth), bones_of(truth)
    began = time.perf_counter()
    result = ssdr.decompose(
        truth.frames,
        bones=bones,
        influences=max(INFLUENCES, truth.skinning.n_influences),
        effort=effort,
        hierarchy="rigid",
        rng=seed,
    )
    found = result.skinning
    again = reskin(found.rest, found.indices, found.weights, found.transforms)
    rmse = float(np.sqrt(((again - truth.frames) ** 2).sum(axis=-1).mean()))
    return {
        "bones": bones,
        "vertices": truth.frames.shape[1],
        "frames": len(truth.frames),
        "rmse / diagonal": rmse / truth.diagonal,
        "gap / diagonal": float(found.joint_gaps().max()) / truth.diagonal,
        "seconds": time.perf_counter() - began,
        **judge(truth, group, found),
    }


# --- sequences whose skeleton nobody knows -------------------------------------------------------


def real(name: str, effort: Any, seed: int) -> dict[str, Any]:
    frames, faces = load(name)
    bones = REAL[name]
    began = time.perf_counter()
    result = ssdr.decompose(frames, faces, bones=bones, effort=effort, hierarchy="rigid", rng=seed)
    seconds = time.perf_counter() - began
    flat = ssdr.decompose(frames, faces, bones=bones, rng=seed)
    loose = ssdr.decompose(frames, faces, bones=bones, rng=seed, hierarchy="loose").skinning
    e, e_flat = (_e(frames, model) for model in (result.skinning, flat.skinning))
    diagonal = ssdr.MeshSequence(frames).diagonal()
    below = loose.parents >= 0
    return {
        "bones": bones,
        "E": e,
        "flat, default": e_flat,
        "ratio": e / e_flat,
        "gap / diagonal": float(result.skinning.joint_gaps().max()) / diagonal,
        "loose, E is the flat one's": _e(frames, loose) == e_flat,
        "loose, median gap / diagonal": float(np.median(loose.joint_gaps()[:, below])) / diagonal,
        "seconds": seconds,
    }


def _e(frames: np.ndarray, model: ssdr.Skinning) -> float:
    return error_e(frames, reskin(model.rest, model.indices, model.weights, model.transforms))


# --- the rest ------------------------------------------------------------------------------------


def held_out(name: str, effort: Any, seed: int) -> dict[str, Any]:
    """A rig of every second frame; the others by rotations of its joints and its root alone."""
    frames, _, bones = subject(name)
    rig = ssdr.decompose(
        frames[::2], bones=bones, effort=effort, hierarchy="rigid", rng=seed
    ).skinning
    other = ssdr.decompose(
        frames[1::2],
        skeleton=rig,
        indices=rig.indices,
        weights=rig.weights,
        rest=rig.rest,
        effort="best",
    ).skinning
    moved = np.abs(other.joint_positions - rig.joint_positions)[rig.parents >= 0].max(initial=0)
    fitted, explained = _e(frames[::2], rig), _e(frames[1::2], other)
    return {
        "bones": bones,
        "E of the frames fitted": fitted,
        "E of the others": explained,
        "ratio": explained / fitted,
        "joints moved": float(moved),
    }


def seeds(name: str, effort: Any, seed: int) -> dict[str, Any]:
    """Five seeds, and renumbered vertices: which share of the joints agrees with the first."""
    frames, _, bones = subject(name)
    order = np.random.default_rng(0).permutation(frames.shape[1])
    models = [
        ssdr.decompose(frames, bones=bones, effort=effort, hierarchy="rigid", rng=k).skinning
        for k in range(seed, seed + 5)
    ]
    mixed = ssdr.decompose(
        frames[:, order], bones=bones, effort=effort, hierarchy="rigid", rng=seed
    ).skinning
    back = np.argsort(order)
    models.append(
        dataclasses.replace(
            mixed, rest=mixed.rest[back], indices=mixed.indices[back], weights=mixed.weights[back]
        )
    )
    first = models[0]
    shares = [agreement(first, other) for other in models[1:]]
    return {"bones": bones, "seeds": shares[:-1], "renumbered": shares[-1]}


def agreement(one: ssdr.Skinning, other: ssdr.Skinning) -> float:
    """Share of the joints of one that other has, bones matched by what they move."""
    rows, columns = linear_sum_assignment(-(one.dense_weights().T @ other.dense_weights()))
    place = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    theirs = {frozenset((b, int(a))) for b, a in enumerate(other.parents) if a >= 0}
    mine = [(b, int(a)) for b, a in enumerate(one.parents) if a >= 0]
    return float(np.mean([frozenset((place[b], place[a])) in theirs for b, a in mine]))


def given_exact(name: str, effort: Any, seed: int) -> dict[str, Any]:
    """The true skeleton as it stands in the first frame, and frames: weights, rest pose and motion.

    Also with joints 2 % off, and in its own rest pose, which is kept.
    """
    truth = known(name)
    model = truth.skinning
    # parents, joints and names alone, as of a rig of another mesh
    parts = {part: getattr(model, part)[:-1] for part in ("rest", "indices", "weights")}
    alone = dataclasses.replace(model, **parts, faces=None, surface=None, vertex_map=None)
    first = model.transforms[0]
    posed = np.einsum("bij,bj->bi", first[..., :3], model.joint_positions) + first[..., 3]
    off = np.random.default_rng(0).normal(size=(model.n_bones, 3)) / np.sqrt(3)
    moved = posed + 0.02 * truth.diagonal * off
    row: dict[str, Any] = {"bones": model.n_bones}
    for key, skeleton, rest in (
        ("rmse / diagonal", dataclasses.replace(alone, joint_positions=posed), None),
        ("rmse, joints 2 % off", dataclasses.replace(alone, joint_positions=moved), None),
        ("rmse, rest pose kept", alone, truth.rest),
    ):
        result = ssdr.decompose(
            truth.frames,
            skeleton=skeleton,
            rest=rest,
            influences=max(INFLUENCES, model.n_influences),
            effort=effort,
            rng=seed,
        )
        row[key] = result.rmse / truth.diagonal
    return row


def given(name: str, effort: Any, seed: int) -> dict[str, Any]:
    """A rig handed over: its joints off by 2 %, with extra bones, and beside Dem Bones.

    Dem Bones starts from the same rest pose and transforms, with the rig's weights or with its
    own for them; its joints may come apart, as those of our loose hierarchy.
    """
    frames, faces, bones = subject(name)
    options = {"effort": effort, "rng": seed}
    rig = ssdr.decompose(frames, faces, bones=bones, hierarchy="rigid", **options).skinning
    off = np.random.default_rng(0).normal(size=(bones, 3)) / np.sqrt(3)
    off *= 0.02 * ssdr.MeshSequence(frames).diagonal()
    moved = dataclasses.replace(rig, joint_positions=rig.joint_positions + off)

    def solved(skeleton: ssdr.Skinning, **more: Any) -> float:
        model = ssdr.decompose(frames, faces, skeleton=skeleton, **options, **more).skinning
        return _e(frames, model)

    row = {
        "bones": bones,
        "E of the rig": _e(frames, rig),
        "E": solved(rig),
        "E, joints 2 % off": solved(moved),
        **{f"E, {k} more": solved(rig, extra_bones=k) for k in (2, 4, 8)},
        "E, loose": solved(rig, hierarchy="loose"),
    }
    if faces is not None:
        row["E of Dem Bones, its own weights"] = _dem_bones(rig, frames, faces, weights=False)
        row["E of Dem Bones"] = _dem_bones(rig, frames, faces, weights=True)
    return row


def _dem_bones(
    rig: ssdr.Skinning, frames: np.ndarray, faces: np.ndarray, *, weights: bool
) -> float:
    """Least E of thirty iterations from a rig's rest pose and transforms, and its weights."""
    from py_dem_bones._py_dem_bones import DemBones
    from py_dem_bones.portable import _prepare_solver

    from benchmarks.peers.model_size import skinned_e

    solver, rest = DemBones(), np.asarray(rig.rest, dtype=np.float64)
    _prepare_solver(
        rest, frames, rig.n_bones, faces=faces, max_influences=rig.n_influences, solver=solver
    )
    m = np.zeros((len(frames), 4, rig.n_bones, 4))
    m[:, :3] = rig.transforms.transpose(0, 2, 1, 3)
    m[:, 3, :, 3] = 1.0
    if weights:
        solver.set_weights(np.ascontiguousarray(rig.dense_weights().T.astype(np.float64)))
    solver.m = m.reshape(4 * len(frames), -1)
    solver.init()
    best = np.inf
    for k in range(31):
        skin = np.asarray(solver.get_weights(), dtype=np.float64).T
        now = np.asarray(solver.m).reshape(m.shape).transpose(0, 2, 1, 3)[:, :, :3]
        e = skinned_e(frames, rest, skin, now)
        if weights and not k and abs(e - _e(frames, rig)) > 1e-3 * e:
            raise RuntimeError(
                f"Dem Bones starts at E {e:.4g}, the rig is at {_e(frames, rig):.4g}"
            )
        best = min(best, e) if np.isfinite(e) else best
        solver.computeTranformations()
        solver.computeWeights()
    return float(best)


PARTS: dict[str, tuple[Any, list[str]]] = {
    "exact": (exact, [*ANIMALS, "body", *RANDOM]),
    "real": (real, list(REAL)),
    "held_out": (held_out, ["fox", "tree-18", *REAL]),
    "given_exact": (given_exact, ["fox", "body", "tree-18"]),
    "given": (given, ["horse_gallop", "mannequin_rumba"]),
    "seeds": (seeds, ["fox", "tree-8", "horse_gallop"]),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--data", nargs="+", help="of them alone")
    parser.add_argument("--effort", default="best", choices=["fast", "balanced", "best"])
    parser.add_argument("--rng", type=int, default=0)
    parser.add_argument("--again", action="store_true", help="also what is there already")
    parser.add_argument("--out", type=Path, default=RESULTS / "skeletons.json")
    args = parser.parse_args()
    kept = json.loads(args.out.read_text()) if args.out.exists() else {}
    rates = machine()
    for part in args.parts:
        run, names = PARTS[part]
        rows = kept.setdefault(part, {})
        for name in names if args.data is None else [n for n in names if n in args.data]:
            key = f"{name} {args.effort} {args.rng}"
            if key in rows and not args.again:
                continue
            row = run(name, args.effort, args.rng)
            rows[key] = {"data": name, "effort": args.effort, "seed": args.rng} | row | rates
            write_json(args.out, kept)
            print(key, json.dumps(row), flush=True)
    print(tell(rates))
    for part, rows in kept.items():
        shown = list(rows.values())
        columns = [c for c in shown[0] if c not in rates and c != "wrong"] if shown else []
        print(f"\n{part}\n{table(shown, columns)}")


if __name__ == "__main__":
    main()
