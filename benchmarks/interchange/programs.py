"""Do other programs see the same vertices, clips and skeletons in what is written?

    python benchmarks/interchange/programs.py                       # --only takes words of names
    python benchmarks/interchange/programs.py --only tube.glb llama.usdc

Models are written as glTF, USD and (where Blender is found) FBX and opened by this package, by
three.js, by usd-core (its own queries and skin baking) and by Blender (its own importers, in a
process of its own).  Compared are all vertices of all frames, clip by clip at the clip's own times,
and of skeletons parents and names, joints in the rest pose, and transforms relative to the parents.
Lengths are over the diagonal.  Needs node and npm: three.js is installed into out/three.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.common import Row
from helpers.blender_scene import blender_shows
from helpers.rig_model import tube
from helpers.rig_tree import creature, tree_of
from ssdr.common.errors import MissingDependencyError
from ssdr.model.transforms import to_local

FORMATS: dict[str, tuple[str, Row]] = {
    "glb": (".glb", {}),
    "glb, uint16": (".glb", {"weights": "uint16"}),
    "glb, uint8": (".glb", {"weights": "uint8"}),
    "usdc": (".usdc", {}),
    "fbx": (".fbx", {}),
}


@dataclasses.dataclass
class Seen:
    """A model as a program shows it: vertices and local transforms by clip, and the skeleton."""

    points: dict[str, np.ndarray]
    index: np.ndarray | None = None  # (V',) vertex of the model behind each vertex
    seconds_off: float = 0.0
    tree: dict[str, str | None] | None = None
    joints: np.ndarray | None = None  # (B, 3), in the order of the tree, as local
    local: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)


# --- models --------------------------------------------------------------------------------------


def from_file(name: str) -> ssdr.Skinning:
    return ssdr.load_skinning(common.data_folder() / "gltf" / name)


def llama_clips() -> ssdr.Skinning:
    """Five clips, decomposed together."""
    path = common.data_folder() / "gltf" / "Llama.gltf"
    clips = [ssdr.load(path, clip=clip.name, weld=True) for clip in ssdr.list_clips(path)]
    model = ssdr.decompose(clips, bones=16, effort="fast").skinning
    return dataclasses.replace(model, clips=ssdr.load_skinning(path).clips)


def two_rates() -> ssdr.Skinning:
    mixed = [ssdr.Clip("slow", 0, 9, 24.0), ssdr.Clip("quick", 9, 20, 60.0)]
    return dataclasses.replace(tube(), clips=mixed)


def dancer() -> ssdr.Skinning:
    return ssdr.decompose(ssdr.samples.load("dancer"), bones=24, effort="fast").skinning


MODELS: dict[str, Callable[[], ssdr.Skinning]] = {
    "tube": tube,
    "tube_similarity": lambda: tube(scaled=True),
    "dancer": dancer,
    "llama_clips": llama_clips,
    "two_rates": two_rates,
    "rigid": lambda: creature(frames=24),
    "loose": lambda: creature(frames=24, loose=True),
    "fox": lambda: from_file("Fox.glb"),
    "llama": lambda: from_file("Llama.gltf"),
}


# --- programs ------------------------------------------------------------------------------------


def in_ssdr(path: Path, model: ssdr.Skinning) -> Seen:
    back = ssdr.load_skinning(path)
    points = {c.name: back.skin(c.frames, dtype=np.float64) for c in back.clips}
    if not has_tree(back):
        return Seen(points)
    local = {c.name: back.local_transforms()[c.frames] for c in back.clips}
    return Seen(points, None, 0.0, tree_of(back), back.joint_positions, local)


@functools.cache
def three_folder() -> Path:
    """Folder with three.js and the program that uses it."""
    folder = common.ROOT / "out" / "three"
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "node_modules").is_dir():
        subprocess.run(["npm", "install", "--silent", "--prefix", folder, "three"], check=True)
    for name in ("three.mjs", "shown.mjs"):
        shutil.copy(Path(__file__).with_name(name), folder)
    return folder


def in_three(path: Path, model: ssdr.Skinning) -> Seen:
    words = ["node", three_folder() / "three.mjs", path, json.dumps(wanted(model))]
    return told(json.loads(subprocess.run(words, check=True, capture_output=True).stdout), model)


def wanted(model: ssdr.Skinning) -> Row:
    """Clips of a model, as the other programs' scripts want them."""
    return {c.name: {"fps": c.fps, "frames": c.n_frames} for c in model.clips}


def told(answer: Row, model: ssdr.Skinning) -> Seen:
    """What such a script says."""
    n_bones = len(answer["bones"])
    points, local, off = {}, {}, 0.0
    for clip in model.clips:
        seen = answer["clips"][clip.name]
        points[clip.name] = np.array(seen["points"]).reshape(clip.n_frames, -1, 3)
        matrices = np.array(seen["locals"]).reshape(clip.n_frames, n_bones, 4, 4)
        local[clip.name] = np.swapaxes(matrices, -1, -2)[..., :3, :]
        off = max(off, abs(seen["duration"] - (clip.n_frames - 1) / clip.fps))
    index = np.array(answer["index"], dtype=int) if answer["index"] else None
    return Seen(points, index, off, dict(answer["bones"]), np.array(answer["joints"]), local)


def in_usd(path: Path, model: ssdr.Skinning) -> Seen:
    """The model by UsdSkel's queries and baking, with each animation bound in turn."""
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

    seen = Seen({})
    for k, clip in enumerate(model.clips):
        stage = Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(path)))
        skeleton = next(UsdSkel.Skeleton(p) for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton))
        animation = [p for p in stage.Traverse() if p.IsA(UsdSkel.Animation)][k]
        binding = UsdSkel.BindingAPI(skeleton.GetPrim())
        binding.GetAnimationSourceRel().SetTargets([animation.GetPath()])
        cache = UsdSkel.Cache()
        cache.Populate(UsdSkel.Root(stage.GetDefaultPrim()), Usd.PrimDefaultPredicate)
        query = cache.GetSkelQuery(skeleton)
        codes = UsdSkel.Animation(animation).GetTranslationsAttr().GetTimeSamples()
        times = np.array(codes) / stage.GetTimeCodesPerSecond()
        off = np.abs(times - times[0] - np.arange(clip.n_frames) / clip.fps).max()
        seen.seconds_off = max(seen.seconds_off, float(off))
        paths = [str(joint) for joint in query.GetJointOrder()]
        said = [str(name) for name in skeleton.GetJointNamesAttr().Get() or ()]
        names = said or [joint.rsplit("/", 1)[-1] for joint in paths]
        parents = query.GetTopology().GetParentIndices()
        seen.tree = {n: names[p] if p >= 0 else None for n, p in zip(names, parents, strict=True)}
        seen.joints = np.array(query.GetJointWorldBindTransforms())[:, 3, :3]
        local = np.array([np.array(query.ComputeJointLocalTransforms(code)) for code in codes])
        seen.local[clip.name] = np.swapaxes(local, -1, -2)[..., :3, :]
        UsdSkel.BakeSkinning(stage.Traverse(), Gf.Interval(codes[0], codes[-1]))
        mesh = next(UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
        points = [np.array(mesh.GetPointsAttr().Get(code)) for code in codes]
        seen.points[clip.name] = np.stack(points)
    return seen


def in_blender(path: Path, model: ssdr.Skinning) -> Seen:
    """The model as Blender evaluates it, in scenes of the clips' frame rates.

    Of USD, whose importer renames bones and shows the first clip alone, only the vertices.
    """
    seen, turn = Seen({}), np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from z up to y up
    for clip in model.clips[:1] if path.suffix == ".usdc" else model.clips:
        shown = blender_shows(path, clip.n_frames, clip.fps, clip.name)
        seen.points[clip.name], arrays = shown
        seen.index = arrays.get("vertex")
        if path.suffix == ".usdc" or not has_tree(model):
            continue
        names, parents = json.loads(str(arrays["bones"])), arrays["parents"]
        seen.tree = {n: names[p] if p >= 0 else None for n, p in zip(names, parents, strict=True)}
        seen.joints = arrays["joints"] @ turn.T
        m = arrays["transforms"]
        m = np.concatenate([turn @ m[..., :3] @ turn.T, turn @ m[..., 3:]], axis=-1)
        seen.local[clip.name] = to_local(m, parents, seen.joints)
    return seen


PROGRAMS: dict[str, Callable[[Path, ssdr.Skinning], Seen]] = {
    "ssdr": in_ssdr,
    "three.js": in_three,
    "usd-core": in_usd,
    "Blender": in_blender,
}
OPENS = {
    ".glb": ["ssdr", "three.js", "Blender"],
    ".usdc": ["ssdr", "usd-core", "Blender"],
    ".fbx": ["Blender"],
}


# --- comparison ----------------------------------------------------------------------------------


def has_tree(model: ssdr.Skinning) -> bool:
    return model.parents is not None


def compared(seen: Seen, model: ssdr.Skinning) -> Row:
    """Largest differences between a model and what a program shows of it."""
    clips = [clip for clip in model.clips if clip.name in seen.points]
    truth = {clip.name: model.skin(clip.frames, dtype=np.float64) for clip in clips}
    diagonal = max(ssdr.MeshSequence(p, validate=False).diagonal() for p in truth.values())
    index = seen.index
    if index is None and len(seen.points[clips[0].name][0]) != model.n_vertices:
        index = matched(seen.points, truth)
    index = slice(None) if index is None else index
    off = [np.linalg.norm(seen.points[n] - p[:, index], axis=-1).max() for n, p in truth.items()]
    row: Row = {"vertices": float(max(off)) / diagonal, "seconds off": seen.seconds_off}
    if seen.tree is None or not has_tree(model):
        return row
    row["same tree"] = seen.tree == tree_of(model)
    if row["same tree"]:
        order = [model.names().index(name) for name in seen.tree]
        row["joints"] = float(np.abs(seen.joints - model.joint_positions[order]).max()) / diagonal
        every = model.local_transforms()
        gone = [np.abs(seen.local[c.name] - every[c.frames][:, order]) for c in clips]
        row["rotations"] = float(max(g[..., :3].max() for g in gone))
        row["translations"] = float(max(g[..., 3].max() for g in gone)) / diagonal
    return row


def matched(points: dict[str, np.ndarray], truth: dict[str, np.ndarray]) -> np.ndarray:
    """Vertex of the model nearest to each vertex of an importer that does not number them."""
    # vertices that coincide in one frame differ in another
    pick = [(name, k) for name, p in truth.items() for k in (0, len(p) // 2)]
    ours = np.concatenate([truth[name][k] for name, k in pick], axis=1)
    theirs = np.concatenate([points[name][k] for name, k in pick], axis=1)
    return np.asarray(cKDTree(ours).query(theirs)[1])


def measure(model: str, file: str, program: str) -> Row:
    suffix, options = FORMATS[file]
    written = MODELS[model]()
    if suffix == ".fbx":  # all takes of a file have the same rate
        rate = written.clips[0].fps
        written = written.select(*(c.name for c in written.clips if c.fps == rate))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{model}{suffix}")
        try:
            report = ssdr.save(written, path, **options)
            found = compared(PROGRAMS[program](path, written), written)
        except MissingDependencyError as error:
            return {"missing": str(error)}
    return {"bytes": report.bytes, "stated": report.max_error, **found}


if __name__ == "__main__":
    cases: dict[str, Any] = {
        f"{model}.{file} in {program}": {"model": model, "file": file, "program": program}
        for model in MODELS
        for file, (suffix, _) in FORMATS.items()
        for program in OPENS[suffix]
        if "," not in file or model == "tube"
    }
    columns = ("vertices", "seconds off", "same tree", "joints", "rotations", "translations")
    common.run(__file__, __doc__, cases, measure, columns)
