"""Virtual bones of a garment, and the low and high frequencies of its clips.

`ssdr.decompose` finds one rest pose and one set of skin weights from training frames; every clip's
transforms are then fitted to its low frequencies.  The results are stored in a folder beside the
store, one clip at a time, so that an interrupted run continues and nothing is computed twice.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import json
import logging
import time
import zlib
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.errors import FormatError, InputError
from ssdr.io.registry import reading
from ssdr.laplacian import LaplacianSmoother

from ..configs.config import BoneOptions
from ..io.files import map_array, write_file, writing
from .clip import MIRRORED, Clip
from .parameters import SimulationParameters
from .skin_weights import BodyBound, find_body_bound
from .store import ClipStore
from .subject import Subject, mesh_identity

__all__ = ["ClipBones", "VirtualBones", "parameter_roles", "virtual_bones"]

# Refitting ends when a sweep lowers the error by less than this fraction: about 1 µm of 10 mm.
_TOLERANCE = 1e-4
_SWEEPS = 30  # at most

_logger = logging.getLogger(__name__)
Progress = Callable[[str, float], None]


def parameter_roles(store: ClipStore) -> dict[SimulationParameters, str]:
    """The split of every parameter set: "train", "validation" or "test".

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
class ClipBones:
    """Low and high frequencies of a clip and the transforms of its virtual bones.

    Attributes
    ----------
    low, high : (F, V, 3) float32, in world coordinates
        Memory maps of the clip that is not mirrored; see :meth:`read`.
    fit : callable
        Gives `transforms` and `rmse`, at the first call by fitting: losses need neither.
    permutation : (V,) int32 or None
        The vertex on the other side of each: :meth:`read` reflects the clip.
    """

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    fit: Callable[[], tuple[NDArray[np.float32], float]]
    permutation: NDArray[np.int32] | None = None

    @property
    def transforms(self) -> NDArray[np.float32]:
        """Of the virtual bones ``(F, B, 3, 4)``, fitted to `low`; likewise not mirrored."""
        return self.fit()[0]

    @property
    def rmse(self) -> float:
        """Of LBS against `low`, metres."""
        return self.fit()[1]

    def read(self, part: str, frames: Any = slice(None)) -> NDArray[np.float32]:
        """Frames of "low" or "high" in memory, reflected if the clip is mirrored."""
        block = np.array(getattr(self, part)[frames])  # a copy: the map cannot be written to
        if self.permutation is not None:
            # Smoothing commutes with the reflection, because the rest pose is symmetric.
            block = block[:, self.permutation] * np.array([-1, 1, 1], np.float32)
        return block


@dataclasses.dataclass(frozen=True, eq=False)
class VirtualBones:
    """The virtual bones of a garment, and the folder with the parts of its clips.

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
        Vertices that the body carries.
    """

    folder: Path
    store: ClipStore
    skinning: Skinning
    options: BoneOptions
    report: dict[str, Any]
    bound: BodyBound | None = None

    @property
    def subject(self) -> Subject:
        """Garment and body, as a network takes them."""
        store = self.store
        identity = mesh_identity(store.rest, store.faces)
        return Subject(self.skinning, store.body, store.skeleton, store.fps, identity, self.bound)

    def smoother(self) -> LaplacianSmoother:
        """The Laplacian smoother that splits low from high frequencies, on the rest pose."""
        return LaplacianSmoother(self.store.rest, self.store.faces, self.options.length)

    def clip(self, name: str) -> ClipBones:
        """The parts of a clip, computed at the first call.

        Raises
        ------
        FormatError
            If a file is damaged or of another garment.
        """
        clip = self.store.clip(name)
        original = clip if not clip.is_mirrored else self.store.clip(str(clip.mirrored_of))
        base, v = self.folder / "clips", self.store.n_vertices
        files = {k: base / f"{original.name}.{k}.npy" for k in ("low", "high")}
        statement = base / f"{original.name}.json"
        if not all(f.is_file() for f in (*files.values(), statement)):
            self._split(original, files, statement)
        record = self._record(statement, original.name, "high_rms")
        parts = {
            k: map_array(f, (original.n_frames, v, 3), record.get("checksums", {}).get(k))
            for k, f in files.items()
        }
        return ClipBones(
            **parts,
            fit=functools.partial(self._fitted, original),
            permutation=self.store.mirror_vertices if clip.is_mirrored else None,
        )

    def fit(
        self, low: NDArray[np.float32], *, tolerance: float = _TOLERANCE
    ) -> tuple[NDArray[np.float32], float]:
        """Transforms ``(F, B, 3, 4)`` fitted to frames ``(F, V, 3)``, and their RMSE in metres.

        Sweeps end when one lowers the error by less than the fraction `tolerance`.
        """
        found = ssdr.fit_bones(low, self.skinning, tolerance=tolerance, max_sweeps=_SWEEPS)
        return np.asarray(found.skinning.transforms, np.float32), found.rmse

    def _fitted(self, clip: Clip) -> tuple[NDArray[np.float32], float]:
        base = self.folder / "clips"
        file, statement = base / f"{clip.name}.transforms.npy", base / f"{clip.name}.fit.json"
        if not (file.is_file() and statement.is_file()):
            found, rmse = self.fit(np.asarray(self.clip(clip.name).low))
            sums = {"transforms": _write_array(file, found)}
            self._state(statement, clip, {"rmse": rmse, "checksums": sums})
        record = self._record(statement, clip.name, "rmse")
        shape = (clip.n_frames, self.skinning.n_bones, 3, 4)
        transforms = map_array(file, shape, record.get("checksums", {}).get("transforms"))
        return transforms, float(record["rmse"])

    def _record(self, statement: Path, clip: str, number: str) -> dict[str, Any]:
        record = _document(statement, (number,))
        if record.get("source", "") not in ("", _digest(self.store, [clip])):
            raise InputError(
                "store",
                f"the clip {clip} that its bones were fitted to (remove {self.folder} to fit them "
                "again)",
                "another of that name",
            )
        return record

    def _split(self, clip: Clip, files: dict[str, Path], statement: Path) -> None:
        vertices = np.asarray(clip.sequence.frames(slice(None)), np.float32)
        low = np.asarray(self.smoother().smooth(vertices), np.float32)
        high = vertices - low
        sums = {k: _write_array(files[k], x) for k, x in (("low", low), ("high", high))}
        rms = float(np.sqrt((high.astype(np.float64) ** 2).sum(-1).mean()))
        self._state(statement, clip, {"high_rms": rms, "checksums": sums})

    def _state(self, statement: Path, clip: Clip, record: dict[str, Any]) -> None:
        record["source"] = _digest(self.store, [clip.name])
        write_file(statement, json.dumps(record).encode())

    def prepare(
        self, names: Sequence[str], progress: Progress | None = None, *, fit: bool = False
    ) -> dict[str, Any]:
        """Compute the parts of the named clips where they are missing.

        Parameters
        ----------
        names : sequence of str
        progress : callable, optional
        fit : bool
            Whether the bones are fitted, too, which takes much longer than the split.

        Returns
        -------
        dict
            Pooled over them: ``high_rms``, with `fit` the bones' ``rmse``, metres, and the number
            of ``frames``.
        """
        squares = {"high_rms": 0.0} | ({"rmse": 0.0} if fit else {})
        frames = 0
        for k, name in enumerate(names):
            plain = name.removesuffix(MIRRORED)
            parts = self.clip(plain)
            count = len(parts.low)
            frames += count
            record = self._record(self.folder / "clips" / f"{plain}.json", plain, "high_rms")
            squares["high_rms"] += count * float(record["high_rms"]) ** 2
            if fit:
                squares["rmse"] += count * parts.rmse**2
            if progress:
                progress("splitting the clips", (k + 1) / len(names))
        return {"frames": frames} | {
            key: float(np.sqrt(total / max(frames, 1))) for key, total in squares.items()
        }


def virtual_bones(
    store: ClipStore,
    options: BoneOptions,
    *,
    folder: Path | str | None = None,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> VirtualBones:
    """The virtual bones of a store; read if they were computed before.

    Parameters
    ----------
    store : ClipStore
    options : BoneOptions
    folder : path, optional
        ``<store>.bones`` beside the store by default, with one folder inside for each set of
        options and training clips.
    time_limit : float, optional
        Seconds that the decomposition may take.
    progress : callable, optional
        Called with a description of the current step and the fraction that is done.

    Raises
    ------
    InputError
        If the store has no training clips.
    """
    roles = parameter_roles(store)
    names = [
        c.name
        for c in store.clips("train")
        if roles[c.parameters] == "train"
        and (not options.motions or fnmatchcase(c.motion, options.motions))
    ]
    if not names:
        of = f" of motions {options.motions}" if options.motions else ""
        raise InputError("store", f"training clips{of} of a training set", str(store.path))
    record = dataclasses.asdict(options) | {
        "garment": mesh_identity(store.rest, store.faces),
        "clips": names,
    }
    key = hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()[:12]
    home = Path(folder) if folder else store.path.with_name(store.path.name + ".bones")
    place = home / key
    (place / "clips").mkdir(parents=True, exist_ok=True)
    skinning_file, report_file = place / "bones.npz", place / "bones.json"
    if not (skinning_file.is_file() and report_file.is_file()):
        skinning, report = _decompose(store, names, options, time_limit, progress)
        with writing(skinning_file):
            ssdr.save(skinning, skinning_file)
        made = record | report | {"source": _digest(store, names)}
        write_file(report_file, json.dumps(made, indent=1).encode())
    skinning = ssdr.load_skinning(skinning_file)
    if skinning.n_vertices != store.n_vertices or skinning.n_bones != options.count:
        raise FormatError(f"{skinning_file}: bones of another garment, {skinning!r}")
    known = _document(report_file, ("rmse", "high_rms"))
    if known.get("source", "") not in ("", _digest(store, names)):
        raise InputError(
            "store",
            f"the clips that its virtual bones were made from (remove {place} to make them again)",
            "others of the same names",
        )
    bones = VirtualBones(place, store, skinning, options, known)
    return dataclasses.replace(bones, bound=_body_bound(bones, names))


def _body_bound(bones: VirtualBones, names: Sequence[str]) -> BodyBound | None:
    file = bones.folder / "bound.npz"
    fields = [f.name for f in dataclasses.fields(BodyBound)]
    if not file.is_file():
        found = find_body_bound(bones.store, names, bones.smoother())
        packed = io.BytesIO()
        none = dict.fromkeys(fields, np.zeros(0))
        np.savez(packed, **(none if found is None else {k: getattr(found, k) for k in fields}))
        write_file(file, packed.getvalue())
    with reading(file), np.load(file, allow_pickle=False) as arrays:
        bound = BodyBound(**{k: arrays[k] for k in fields})
        if not len(bound.index):
            return None
        if bound.rest.shape != (len(bound.index), 3) or bound.index.max() >= bones.store.n_vertices:
            raise FormatError("vertices of another garment")
    return bound


def _decompose(
    store: ClipStore,
    names: Sequence[str],
    options: BoneOptions,
    time_limit: float | None,
    progress: Progress | None,
) -> tuple[Skinning, dict[str, Any]]:
    began = time.perf_counter()
    clips = [store.clip(n) for n in names]
    total = sum(c.n_frames for c in clips)
    chosen = np.unique(np.linspace(0, total - 1, min(total, options.frames)).astype(int))
    smoother = LaplacianSmoother(store.rest, store.faces, options.length)
    parts, squares, first = [], 0.0, 0
    for clip in clips:
        here = chosen[(chosen >= first) & (chosen < first + clip.n_frames)] - first
        first += clip.n_frames
        if len(here):
            block = clip.sequence.frames(here)
            parts.append(np.asarray(smoother.smooth(block), np.float32))
            squares += float(((block - parts[-1]).astype(np.float64) ** 2).sum())
    frames = np.concatenate(parts)

    def follow(p: Any) -> None:
        if progress:
            progress(f"decomposing: {p.phase}", p.fraction)

    result = ssdr.decompose(
        MeshSequence(frames, store.faces, store.fps),
        bones=options.count,
        influences=options.influences,
        effort=options.effort,
        rng=options.seed,
        time_limit=time_limit,
        callback=follow,
    )
    s = result.skinning
    still = np.tile(np.eye(3, 4), (1, s.n_bones, 1, 1))
    skinning = dataclasses.replace(s, transforms=still, fps=store.fps, keyframes=None)
    report = {
        "decomposed_frames": len(frames),
        "rmse": result.rmse,
        "high_rms": float(np.sqrt(squares / (len(frames) * store.n_vertices))),
        "seconds": time.perf_counter() - began,
        "stop_reason": result.stop_reason,
    }
    _logger.info("%d bones, RMSE %.3g m on %d frames", s.n_bones, result.rmse, len(frames))
    return skinning, report


def _write_array(file: Path, values: NDArray[np.float32]) -> int:
    """Write a ``.npy`` file; its CRC-32."""
    packed = io.BytesIO()
    np.save(packed, values, allow_pickle=False)
    write_file(file, packed.getvalue())
    return zlib.crc32(packed.getbuffer())


def _document(path: Path, keys: Sequence[str]) -> dict[str, Any]:
    with reading(path):
        try:
            document = json.loads(path.read_text("utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise FormatError(f"{path}: missing or not text ({error})") from error
        for key in keys:
            document[key] = float(document[key])
        return dict(document)


def _digest(store: ClipStore, names: Sequence[str]) -> str:
    # A clip's attributes hold everything that it was made from, and measurements of the result.
    h = hashlib.sha256()
    for name in names:
        h.update((store.path / "clips" / name / "zarr.json").read_bytes())
    return h.hexdigest()[:16]
