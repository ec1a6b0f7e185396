"""Virtual bones of a garment, and the low and high frequencies of its clips.

`ssdr.decompose` finds one rest pose and one set of skin weights from training frames; every clip's
transforms are then fitted to its low frequencies.  The results are stored in a folder beside the
store, one file per clip, so that an interrupted run continues and nothing is computed twice.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import logging
import time
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.common.errors import FormatError, InputError
from ssdr.io.file_errors import reading
from ssdr.laplacian import LaplacianSmoother

from ..configs.config import BoneOptions
from ..io.files import Progress, kept, silent, write_file, writing
from .outfit import mesh_identity
from .parameters import SimulationParameters
from .skin_weights import BodyBound, find_body_bound
from .store import ClipStore
from .subject import Subject

# Refitting ends when a sweep lowers the error by less than this fraction: about 1 µm of 10 mm.
_TOLERANCE = 1e-4
_SWEEPS = 30  # most sweeps of a fit
# Of the search for vertices bound to the body; what an earlier version found is not read.
_BOUND_VERSION = 2

_logger = logging.getLogger(__name__)


def parameter_roles(store: ClipStore) -> dict[SimulationParameters, str]:
    """The role of every parameter set, "train" or "test".

    It is stored as ``parameter_split`` in the clips' provenance; "train" where it is missing.

    Raises
    ------
    FormatError
        If clips of one parameter set disagree.
    """
    roles: dict[SimulationParameters, str] = {}
    for clip in store.clips():
        role = str(clip.provenance.get("parameter_split", "train"))
        if roles.setdefault(clip.parameters, role) != role:
            raise FormatError(f"{store.path}: {clip.name} puts its parameters into {role!r} too")
    return roles


@dataclasses.dataclass(frozen=True, eq=False)
class VirtualBones:
    """Virtual bones of a garment, and the folder of what is computed from its clips with them.

    Attributes
    ----------
    folder : Path
    store : ClipStore
    skinning : Skinning
        Rest pose, weights, faces; one frame, the rest pose.
    options : BoneOptions
    report : dict
        Frames used and error of the decomposition.
    bound : BodyBound or None
        Vertices bound to the body.
    """

    folder: Path
    store: ClipStore
    skinning: Skinning
    options: BoneOptions
    report: dict[str, Any]
    bound: BodyBound | None = None

    @property
    def subject(self) -> Subject:
        """Garment and body in the form that a network needs."""
        store = self.store
        body, identity = store.body, store.garment_id
        return Subject(self.skinning, body, store.skeleton, store.fps, identity, self.bound)

    @functools.cached_property
    def smoother(self) -> LaplacianSmoother:
        """The Laplacian smoother that splits low from high frequencies, on the rest pose."""
        return LaplacianSmoother(self.store.rest, self.store.faces, self.options.length)

    def split(
        self, name: str, frames: Any = slice(None)
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Low and high frequencies of a clip's frames, each ``(f, V, 3)``, in the world."""
        whole = np.asarray(self.store.clip(name).sequence.frames(frames), np.float32)
        low = np.asarray(self.smoother.smooth(whole), np.float32)
        return low, whole - low

    def transforms(self, name: str) -> NDArray[np.float32]:
        """Transforms ``(F, B, 3, 4)`` of a clip, fitted to its low frequencies once and kept."""
        found = self.kept("clips", name, lambda: {"transforms": self.fit(self.split(name)[0])})
        return np.asarray(found["transforms"])

    def fit(
        self, low: NDArray[np.float32], *, tolerance: float = _TOLERANCE
    ) -> NDArray[np.float32]:
        """Transforms ``(F, B, 3, 4)`` fitted to frames ``(F, V, 3)``.

        Sweeps end when one lowers the error by less than the fraction `tolerance`.
        """
        found = ssdr.fit_bones(low, self.skinning, tolerance=tolerance, max_sweeps=_SWEEPS)
        return np.asarray(found.skinning.transforms, np.float32)

    def kept(self, folder: str, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Arrays of a clip in the subfolder `folder`, which `make` computes if they are missing.

        They are computed anew for another clip of the same name.
        """
        return kept(self.folder / folder / f"{name}-{_digest(self.store, [name])}.npz", make)


def virtual_bones(
    store: ClipStore,
    options: BoneOptions,
    *,
    subject: Subject | None = None,
    progress: Progress = silent,
) -> VirtualBones:
    """Virtual bones of a store, which are read if they were computed before.

    They are kept in ``<store>.bones`` beside the store, in a subfolder for each set of options and
    training clips.

    Parameters
    ----------
    store : ClipStore
    options : BoneOptions
    subject : Subject, optional
        Garment and body of a trained network, whose bones are used.
    progress : callable, optional
        Called with a description of the current step and the fraction that is done.

    Raises
    ------
    InputError
        If the store has no training clips, or `subject` has another garment.
    """
    if subject is not None:
        if subject.garment_id != store.garment_id:
            raise InputError("subject", f"the garment of {store.path}", "another")
        options = dataclasses.replace(options, count=subject.garment.n_bones)
    roles = parameter_roles(store)
    names = [
        c.name
        for c in store.clips("train")
        if roles[c.parameters] == "train"
        and any(fnmatchcase(n, options.motions or "*") for n in (c.motion, c.name))
    ]
    if not names:
        of = f" of motions {options.motions}" if options.motions else ""
        raise InputError("store", f"training clips{of} of a training set", str(store.path))
    record = dataclasses.asdict(options) | {
        "garment": store.garment_id,
        "clips": names,
        "source": _digest(store, names),
    }
    if subject is not None:
        record["bones"] = mesh_identity(subject.garment.rest, subject.garment.indices)
    key = hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()[:12]
    place = store.path.with_name(store.path.name + ".bones") / key
    if subject is not None:
        return VirtualBones(place, store, subject.garment, options, record, subject.bound)
    place.mkdir(parents=True, exist_ok=True)
    skinning_file, report_file = place / "bones.npz", place / "bones.json"
    if not (skinning_file.is_file() and report_file.is_file()):
        skinning, found = _decompose(store, names, options, progress)
        with writing(skinning_file):
            ssdr.save(skinning, skinning_file)
        write_file(report_file, json.dumps(record | found, indent=1).encode())
    skinning = ssdr.load_skinning(skinning_file).skinning
    if skinning.n_vertices != store.n_vertices or skinning.n_bones != options.count:
        raise FormatError(f"{skinning_file}: bones of another garment, {skinning!r}")
    with reading(report_file):
        known: dict[str, Any] = json.loads(report_file.read_text("utf-8"))
    bones = VirtualBones(place, store, skinning, options, known)
    return dataclasses.replace(bones, bound=_body_bound(bones, names))


def _body_bound(bones: VirtualBones, names: Sequence[str]) -> BodyBound | None:
    fields = [f.name for f in dataclasses.fields(BodyBound)]

    def make() -> dict[str, Any]:
        found = find_body_bound(bones.store, names, bones.smoother)
        count = 0 if found is None else len(found.index)
        text = "%d of %d vertices move with the body; the others are predicted"
        _logger.info(text, count, bones.store.n_vertices)
        return {k: np.zeros(0) if found is None else getattr(found, k) for k in fields}

    found = kept(bones.folder / f"bound-{_BOUND_VERSION}.npz", make)
    return BodyBound(**found) if len(found["index"]) else None


def _decompose(
    store: ClipStore,
    names: Sequence[str],
    options: BoneOptions,
    progress: Progress,
) -> tuple[Skinning, dict[str, Any]]:
    began = time.perf_counter()
    smoother = LaplacianSmoother(store.rest, store.faces, options.length)
    parts = [
        np.asarray(smoother.smooth(clip.sequence.frames(here)), np.float32)
        for clip, here in store.sample(names, options.frames)
    ]
    frames = np.concatenate(parts)

    result = ssdr.decompose(
        MeshSequence(frames, store.faces, store.fps),
        bones=options.count,
        influences=options.influences,
        effort=options.effort,
        rng=options.seed,
        callback=lambda p: progress(f"decomposing: {p.phase}", p.fraction),
    )
    s = result.skinning
    still = np.tile(np.eye(3, 4), (1, s.n_bones, 1, 1))
    skinning = dataclasses.replace(s, transforms=still, fps=store.fps, keyframes=None)
    report = {
        "rmse": result.rmse,
        "seconds": time.perf_counter() - began,
        "stop_reason": result.stop_reason,
    }
    _logger.info("%d bones, RMSE %.3g m on %d frames", s.n_bones, result.rmse, len(frames))
    return skinning, report


def _digest(store: ClipStore, names: Sequence[str]) -> str:
    # A clip's attributes hold everything that it was made from, and measurements of the result.
    h = hashlib.sha256()
    for name in names:
        h.update((store.path / "clips" / name / "zarr.json").read_bytes())
    return h.hexdigest()[:16]
