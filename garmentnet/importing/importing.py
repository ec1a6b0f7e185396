"""Import of a user's own simulations: files of animated cloth and of the rigs that drove it."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr import MeshSequence
from ssdr.common.errors import InputError, is_real
from ssdr.io import list_meshes
from ssdr.io.atomic import check_writable
from ssdr.model.lbs import skin
from ssdr.model.rigid import kabsch
from ssdr.model.transforms import rest_diagonal

from ..collision.body_tree import is_closed
from ..data.clip import spread
from ..data.clip_files import Split
from ..data.outfit import Outfit
from ..data.parameters import SimulationParameters
from ..data.skin_weights import BodyBound, find_body_bound
from ..data.store import ClipStore
from .quality import judge
from .rig import MovingBody, rig_of
from .scene_files import Say, Source, read_cloth, read_rig

_SMALL = 0.12  # size of a garment, relative to the body's, below which its unit is doubted
_PIN_FRAMES, _MOST_PINS = 240, 0.6  # frames in which pins are looked for; their largest share
_LEAST_KEPT = 0.1  # share of the pins of a single clip that the next one must have
# Vertices that show where the body is; radians, in the mean, up to which a pose is the bind pose.
_BODY_POINTS, _BIND_POSE = 500, 2e-3
PathLike = str | os.PathLike[str]


@dataclasses.dataclass(frozen=True)
class ImportOptions:
    """Options of an import: how files are read, and to which split clips belong.

    Parameters
    ----------
    fps : float, optional
        Frame rate of a new store; by default that of the first cloth.
    offset : float
        Seconds from the first frame of a rig to the first of its cloth.
    cloth, rig : Source, optional
        Mesh, unit and axes of the cloths' and the rigs' files.
    parameters : SimulationParameters
        Parameters with which the cloths were simulated.
    test, validation : sequence of str
        Names of the clips of these splits.  If none is named for testing, the last tenth of the
        others in a call is, at least one; if none for validation, the tenth before it.  One is left
        for training.

    Raises
    ------
    InputError
        If the frame rate or a scale is no positive number, or the offset no number.
    """

    fps: float | None = None
    offset: float = 0.0
    cloth: Source = dataclasses.field(default_factory=Source)
    rig: Source = dataclasses.field(default_factory=Source)
    parameters: SimulationParameters = dataclasses.field(default_factory=SimulationParameters)
    test: Sequence[str] = ()
    validation: Sequence[str] = ()

    def __post_init__(self) -> None:
        scales = {"cloth_scale": self.cloth.scale, "rig_scale": self.rig.scale}
        for name, value in (scales | {"fps": 1.0 if self.fps is None else self.fps}).items():
            if not (is_real(value) and value > 0):
                raise InputError(name, "a positive number", value)
        if not is_real(self.offset):
            raise InputError("offset", "a number of seconds", self.offset)


def import_clips(
    pairs: Sequence[tuple[PathLike, PathLike]],
    path: PathLike,
    options: ImportOptions | None = None,
    *,
    rest: PathLike | None = None,
    say: Say = lambda _: None,
) -> ClipStore:
    """Add simulated cloths and their rigs to a store, which is made if it does not exist.

    Clips are named after the cloths' files.  A clip that is in the store already is not added
    again and keeps its split, so that a call that was interrupted can be repeated.

    Parameters
    ----------
    pairs : sequence of (path, path)
        File of each cloth, which :func:`ssdr.load` can read, and file of its rig, which
        :func:`ssdr.load_skinning` can read.
    path : path
        Path of the store.
    options : ImportOptions, optional
    rest : path, optional
        File of the garment as it was cut, on the body in its bind pose, for a new store.  By
        default it is the cloth of the first clip in the frame whose pose is closest to the bind
        pose, moved to the bind pose as the body is as a whole.
    say : callable, optional
        Called with a sentence for whatever the user should know.

    Raises
    ------
    InputError
        If a rig has no skeleton or another than the first, a cloth has other triangles, the two
        have no common frames or are apart, a file has several animations of other names, or the
        store has a clip of that name from other files, or in another split than the one named.
    SsdrError
        If a file cannot be read.
    """
    o, target = options or ImportOptions(), Path(path)
    say = functools.cache(say)  # of what is read more than once
    names = [_clip_name(Path(cloth).stem) for cloth, _ in pairs]
    if not names or not all(names) or len(set(names)) < len(names):
        expected = "one file or more, of different names with letters a to z or digits"
        raise InputError("cloth", expected, ", ".join(str(cloth) for cloth, _ in pairs))
    test, validation = ([_clip_name(n) for n in some] for some in (o.test, o.validation))
    o = dataclasses.replace(o, test=test, validation=validation)
    for name in (*test, *validation):
        if name not in names or (name in test and name in validation):
            raise InputError("test, validation", f"some of {', '.join(names)}, each once", name)
    store = ClipStore.open(target) if target.exists() else None
    if store is None:
        # Before anything is read, which may take long.
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            found = f"{target.parent} ({error.strerror})"
            raise InputError("path", "a store in a folder that can be made", found) from error
        check_writable(target)
    else:
        store.sweep()
        if o.fps not in (None, store.fps):
            raise InputError("fps", f"{store.fps:g}, as the store has", o.fps)
    splits = _splits(names, o, store, say)
    for (cloth_file, rig_file), name in zip(pairs, names, strict=True):
        files = Path(cloth_file), Path(rig_file)
        try:
            cloth, rig = _read(*files, o, o.fps if store is None else store.fps, say)
            if store is None:
                rig = rig.trimmed()
                say(f"the skeleton begins at {rig.skeleton.names[0]}")
            else:
                _check_mesh("cloth", cloth, store.faces, len(store.rest))
                rig = rig.matched(store.skeleton, store.body)
            vertices = np.asarray(cloth.vertices, np.float32)
            rig.check_cloth(vertices)
        except InputError as error:
            raise InputError(error.argument, error.expected, f"{error.got} ({name})") from error
        cut = None
        if rest is not None:
            cut, rest = _rest_of(Path(rest), cloth, rig, o, say), None  # read once
            if store is not None and not np.allclose(cut, store.rest, atol=1e-5):
                raise InputError("rest", "the garment at rest that the store has", "another")
        if store is None:
            store = _create(target, cloth, rig, o, cut, say)
        _add(store, name, splits[name], vertices, rig.joints, o, files, say)
    assert store is not None  # there is one pair at least
    return store


def _read(
    cloth_file: Path, rig_file: Path, o: ImportOptions, rate: float | None, say: Say
) -> tuple[MeshSequence, MovingBody]:
    """Cloth and rig at one rate, cut to the frames that both have."""
    name = cloth_file.stem
    model = read_rig(rig_file, o.rig, rate, name, say)
    cloth = read_cloth(cloth_file, o.cloth, rate, say)
    if rate is None and model.fps != cloth.fps:
        model = read_rig(rig_file, o.rig, cloth.fps, name, say)
    rig, start = rig_of(model), round(o.offset * cloth.fps)
    first, stop = max(0, -start), min(cloth.n_frames, len(rig.joints) - start)
    counts = f"{cloth.n_frames} frames of cloth, {len(rig.joints)} of the rig"
    if stop - first < 2:
        expected = "a time that cloth and rig have in common"
        raise InputError("offset", expected, f"{counts}, the first of the cloth at {start}")
    if (first, stop - first) != (0, max(cloth.n_frames, len(rig.joints))):
        say(f"{name}: {stop - first} frames in common of {counts}")
    cut = MeshSequence(cloth.vertices[first:stop], cloth.faces, cloth.fps, name=name)
    return cut, dataclasses.replace(rig, joints=rig.joints[first + start : stop + start])


def _check_mesh(argument: str, mesh: MeshSequence, faces: NDArray[np.int32], count: int) -> None:
    """Raise an error unless a mesh has the vertices and triangles of the first clip.

    Its triangles may face either way.
    """
    if mesh.n_vertices != count or not np.array_equal(np.sort(mesh.faces), np.sort(faces)):
        expected = f"the mesh of the first clip, {count} vertices and {len(faces)} triangles"
        own = mesh.n_vertices, len(mesh.faces)
        alike = own == (count, len(faces))
        found = "as many in another order" if alike else f"{own[0]} and {own[1]}"
        raise InputError(argument, expected, found)


def _rest_of(
    path: Path, cloth: MeshSequence, rig: MovingBody, o: ImportOptions, say: Say
) -> NDArray[Any]:
    """Rest pose of the garment from its file, checked against the cloth and the body."""
    # A garment as it was cut is often alone in its file.
    alone = len(list_meshes(path)) < 2
    mesh = read_cloth(path, dataclasses.replace(o.cloth, mesh="") if alone else o.cloth, None, say)
    _check_mesh("rest", mesh, cloth.faces, cloth.n_vertices)
    bind = np.tile(np.eye(3, 4), (1, rig.joints.shape[1], 1, 1))
    dataclasses.replace(rig, joints=bind).check_cloth(mesh.vertices[:1], "rest")
    return np.asarray(mesh.vertices[0])


def _clip_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.\-]", "", text).lstrip("_.-")


def _create(
    path: Path, cloth: MeshSequence, rig: MovingBody, o: ImportOptions, rest: Any, say: Say
) -> ClipStore:
    if rest is None:
        # Not by the root, which may stand still.
        body, some = rig.body, np.s_[:: 1 + rig.body.n_vertices // _BODY_POINTS]
        points = body.rest[some], body.indices[some], body.weights[some]
        back = kabsch(skin(*points, rig.joints), points[0])
        turn = back[:, None, :, :3] @ rig.joints[..., :3]
        cosine = (np.trace(turn, axis1=-2, axis2=-1) - 1) / 2
        angle = np.arccos(cosine.clip(-1, 1)).mean(axis=1)
        t = int((angle <= angle.min() + _BIND_POSE).argmax())
        rest = np.asarray(cloth.vertices[t]) @ back[t, :, :3].T + back[t, :, 3]
        off = f", off by {np.degrees(angle[t]):.0f}° a joint: better give --rest"
        say(
            f"the cloth at rest is that of frame {t}, whose pose is closest to the bind pose"
            f"{off if angle[t] > _BIND_POSE else ''}"
        )
    if not is_closed(rig.body.faces):
        mesh_of = "a mesh of the body that is not closed" if len(rig.body.faces) else "no body"
        say(f"the rig has {mesh_of}: nothing can be pushed out of it")
    inward = rig.facing(rest, cloth.faces)
    if inward.any():
        say(f"{inward.sum()} of {len(inward)} triangles face the body: they are turned round")
    faces = np.where(inward[:, None], cloth.faces[:, ::-1], cloth.faces)
    large, size = rest_diagonal(rest), rest_diagonal(rig.body.rest)
    likely = large > _SMALL * size and 0.2 < size < 20
    text = f"the garment is {large:.3g} m large, the body {size:.3g} m"
    say(text if likely else f"warning: {text}; --cloth-scale and --rig-scale make metres")
    if rig.is_lying():
        up = "y" if o.rig.up == "z" else "z"
        say(f"warning: the skeleton is longest along z; if it should stand, --rig-up {up}")
    return ClipStore.create(path, Outfit(rest, faces, rig.body, rig.skeleton, cloth.fps))


def _splits(
    names: list[str], o: ImportOptions, store: ClipStore | None, say: Say
) -> dict[str, Split]:
    """Split of every clip of a call; those that the store has keep theirs."""
    there = {n: store.clip(n).split for n in names if store is not None and n in store}
    named: dict[Split, Sequence[str]] = {"test": o.test, "validation": o.validation}
    splits: dict[str, Split] = {n: split for split, some in named.items() for n in some}
    for name, split in there.items():
        if splits.get(name, split) != split:
            expected = f"the split in which the store has {name} ({split})"
            raise InputError("test, validation", expected, "another, for which make a new store")
    tenth = max(1, sum(n not in splits for n in names) // 10)
    splits |= there
    left, known = [n for n in names if n not in splits], list(there.values())
    short = {s: tenth - known.count(s) for s, some in named.items() if not some}
    short = {s: count for s, count in short.items() if count > 0}
    for k, (split, count) in enumerate(short.items()):
        if len(left) + ("train" in known) > len(short) - k:
            splits |= dict.fromkeys(left[-count:], split)
            del left[-count:]
        elif store is None or not store.names(split, o.parameters):
            say(f"no clip is left for {split}: --{split} NAME names one")
    return {n: splits.get(n, "train") for n in names}


def _pins(
    store: ClipStore, name: str, vertices: NDArray[Any], joints: NDArray[Any], say: Say
) -> BodyBound | None:
    """Pins of a clip: vertices that the body carries in it and in the store's other clips.

    Their weights are those of all these frames: the other clips may leave open between which joints
    a vertex hangs.  Of what the body carried in a single clip some may have been still by chance;
    what it carried in more must be carried in this one.
    """
    names, (some,) = store.names(), spread([len(vertices)], _PIN_FRAMES)
    found = find_body_bound(store, names, also=(vertices[some], joints[some]))
    if names and (before := find_body_bound(store, names)) is not None:
        kept = 0 if found is None else np.isin(before.index, found.index).mean()
        if kept < (_LEAST_KEPT if len(names) == 1 else 1):
            found = before
        elif kept < 1:
            say(f"{name}: {1 - kept:.0%} of the vertices that the body carried before are free")
    # If nearly all follow the body, it has hardly moved.
    few = found is not None and len(found.index) < _MOST_PINS * store.n_vertices
    return found if few else None


def _add(
    store: ClipStore,
    name: str,
    split: Split,
    vertices: NDArray[np.float32],
    joints: NDArray[np.float64],
    o: ImportOptions,
    files: tuple[Path, Path],
    say: Say,
) -> None:
    m = joints.astype(np.float32)
    provenance = {"cloth": files[0].name, "rig": files[1].name, "parameter_set": "imported"}
    if any(c.motion == name != c.name for c in store.clips(accepted=None)):
        raise InputError("path", f"a store without parts of {name}", "one that has some")
    provenance["sha256"] = hashlib.sha256(vertices.tobytes() + m.tobytes()).hexdigest()
    if name in store:
        there = store.clip(name)
        if (there.provenance, there.parameters) != (provenance, o.parameters):
            found = f"one that was imported with other files or options ({there.parameters})"
            raise InputError("path", f"a store whose clip {name} is of {files[0]}", found)
    else:
        bound = _pins(store, name, vertices, joints, say)
        quality = judge(store, joints, vertices, bound=bound)
        known: dict[str, Any] = {"parameters": o.parameters, "provenance": provenance}
        known |= {"split": split, "motion": name, "quality": quality}
        store.add(name, vertices=vertices, joints=m, **known)
    frames, count, _ = vertices.shape
    say(f"{name}, with {files[1].name}: {count} vertices, {frames} frames for {split}")
