"""Virtual bones (Pan et al. 2022, section 4.1), and skinning with them (equation 1).

`ssdr.decompose` finds one rest pose and one set of skin weights from training frames; every clip's
transforms are then fitted to its low frequencies, which a Laplacian splits from the high ones.  The
results are stored in a folder beside the store, one file per clip, so that an interrupted run
continues and nothing is computed twice.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import logging
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import normalize

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.common.errors import FormatError, InputError
from ssdr.laplacian import LaplacianSmoother

from ..configs.config import BoneOptions
from ..data.clip_files import read_document
from ..data.outfit import mesh_identity
from ..data.parameters import SimulationParameters
from ..data.skin_weights import BodyBound, find_body_bound
from ..data.store import ClipStore
from ..data.subject import Subject
from ..io.files import Progress, kept, silent

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
        return np.array(found.skinning.transforms, np.float32)

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
        Garment and body of a trained network, whose bones are used, whatever clips these are from.
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
    place, record = _home(store, options)
    file = place / "bones.npz"
    foreign = None if subject is None or _holds(file, subject.garment) else subject
    if foreign is not None:
        options = dataclasses.replace(options, motions="")
        place, record = _home(store, options, foreign.garment)
    if not record["clips"]:
        of = f" of motions {options.motions}" if options.motions else ""
        raise InputError("store", f"training clips{of} of a training set", str(store.path))
    if foreign is not None:
        return VirtualBones(place, store, foreign.garment, options, record, foreign.bound)
    if not file.is_file():
        place.mkdir(parents=True, exist_ok=True)
        ssdr.save(_decompose(store, record["clips"], options, progress), file)
    bones = VirtualBones(place, store, ssdr.load_skinning(file).skinning, options, record)
    return dataclasses.replace(bones, bound=_body_bound(bones, record["clips"]))


def _home(
    store: ClipStore, options: BoneOptions, bones: Skinning | None = None
) -> tuple[Path, dict[str, Any]]:
    """Folder of bones with these options, or of given ones, and the record that names it."""
    roles = parameter_roles(store)
    names = [
        c.name
        for c in store.clips("train")
        if roles[c.parameters] == "train"
        and any(fnmatchcase(n, options.motions or "*") for n in (c.motion, c.name))
    ]
    record = dataclasses.asdict(options) | {
        "garment": store.garment_id,
        "clips": names,
        "source": _digest(store, names),
    }
    if bones is not None:
        record["bones"] = mesh_identity(bones.rest, bones.indices)
    key = hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()[:12]
    return store.path.with_name(store.path.name + ".bones") / key, record


def _holds(file: Path, bones: Skinning) -> bool:
    """Whether a file has these bones: what was fitted to clips with them need not be done again."""
    if not file.is_file():
        return False
    known = ssdr.load_skinning(file).skinning
    return mesh_identity(known.rest, known.indices) == mesh_identity(bones.rest, bones.indices)


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
) -> Skinning:
    smoother = LaplacianSmoother(store.rest, store.faces, options.length)
    sample = store.sample(names, options.frames)
    parts = [smoother.smooth(clip.sequence.frames(here)) for clip, here in sample]
    frames = np.concatenate(parts).astype(np.float32)

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
    _logger.info("%d bones, RMSE %.3g m on %d frames", s.n_bones, result.rmse, len(frames))
    return dataclasses.replace(s, transforms=still, fps=store.fps, keyframes=None)


def _digest(store: ClipStore, names: Sequence[str]) -> str:
    # A clip's document holds everything that it was made from, and measurements of the result.
    h = hashlib.sha256()
    for name in names:
        h.update(read_document(store.clip(name).path))
    return h.hexdigest()[:16]


class TorchSkinning(nn.Module):
    """Linear blend skinning with one matrix product (equation 1 of the paper).

    The dense weights ``(V, B)`` times the transforms ``(B, 12 F)`` of all frames side by side.  For
    about 80 bones this is faster than gathering K transforms per vertex, and its gradient is one
    product, too.

    Parameters
    ----------
    rest : (V, 3) array
    indices, weights : (V, K) arrays
    n_bones : int

    Examples
    --------
    >>> lbs = TorchSkinning([[0, 0, 0], [1, 0, 0]], [[0], [0]], [[1.0], [1.0]], n_bones=1)
    >>> lbs(torch.tensor([[[[1.0, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]]]])).tolist()
    [[[5.0, 0.0, 0.0], [6.0, 0.0, 0.0]]]
    """

    rest: Tensor
    weights: Tensor

    def __init__(self, rest: Any, indices: Any, weights: Any, n_bones: int) -> None:
        super().__init__()
        self.n_bones, count = n_bones, len(np.asarray(rest))
        dense = np.zeros((count, n_bones))
        np.add.at(dense, (np.arange(count)[:, None], np.asarray(indices)), np.asarray(weights))
        # Not in the state dict: a checkpoint has rest pose and weights, which determine them.
        self.register_buffer("rest", torch.from_numpy(np.array(rest, np.float32)), persistent=False)
        self.register_buffer("weights", torch.from_numpy(dense).float(), persistent=False)

    @classmethod
    def of(cls, skinning: Skinning) -> TorchSkinning:
        """Module with the rest pose and weights of a skinning; its transforms are not used."""
        return cls(skinning.rest, skinning.indices, skinning.weights, skinning.n_bones)

    def blend(self, transforms: Tensor) -> Tensor:
        """Columns ``(..., 4, 3, V)`` of the vertices' transforms, of those ``(..., B, 3, 4)``.

        Vertices come last, so that what follows works on whole rows of memory.
        """
        lead = transforms.shape[:-3]
        flat = transforms.transpose(-1, -2).reshape(-1, self.n_bones, 12).transpose(1, 2)
        blended = flat.reshape(-1, self.n_bones) @ self.weights.T
        return blended.view(*lead, 4, 3, -1)

    def forward(self, transforms: Tensor) -> Tensor:
        """Positions ``(..., V, 3)`` under transforms ``(..., B, 3, 4)``."""
        return moved(self.blend(transforms), self.rest)


def moved(blend: Tensor, points: Tensor, *, turned: bool = False) -> Tensor:
    """Points ``(V, 3)`` moved by columns ``(..., 4, 3, V)``, or `turned` alone: ``(..., V, 3)``."""
    a, b, c, t = blend.unbind(-3)
    x, y, z = points.T
    out = a * x + b * y + c * z
    return (out if turned else out + t).transpose(-1, -2)


def surface_frame(blend: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Orthonormal columns ``(..., 3, V)`` of a skinned surface, by Gram–Schmidt of the blend's.

    Detail turns with them: d = x a + y b + z c.
    """
    a, b = normalize(blend[..., 0, :, :], dim=-2), blend[..., 1, :, :]
    b = normalize(b - (a * b).sum(-2, keepdim=True) * a, dim=-2)
    # a × b in half of the time of torch.linalg.cross
    return a, b, _next(a * _next(b) - _next(a) * b)


def _next(columns: Tensor) -> Tensor:
    return columns.roll(-1, -2)


def turn(blend: Tensor, local: Tensor) -> Tensor:
    """Detail ``(..., V, 3)`` of the frame of the surface, in the space of the transforms.

    Examples
    --------
    >>> turn(2 * torch.eye(4, 3)[..., None], torch.tensor([[1.0, 2, 3]])).tolist()
    [[1.0, 2.0, 3.0]]
    """
    x, y, z = local.unbind(-1)
    a, b, c = surface_frame(blend)
    every = a * x[..., None, :] + b * y[..., None, :] + c * z[..., None, :]
    return every.transpose(-1, -2)


def turn_back(blend: Tensor, detail: Tensor) -> Tensor:
    """Detail ``(..., V, 3)`` in the frame of the surface; the inverse of :func:`turn`."""
    d = detail.transpose(-1, -2)
    return torch.stack([(column * d).sum(-2) for column in surface_frame(blend)], dim=-1)


def matrix_from_euler(degrees: Tensor) -> Tensor:
    """Rotation matrices ``(..., 3, 3)`` of Euler angles ``(..., 3)`` in degrees: Rz Ry Rx.

    Examples
    --------
    >>> matrix_from_euler(torch.tensor([0.0, 0.0, 90.0])).round().abs().tolist()
    [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    angles = torch.deg2rad(degrees)
    (sx, sy, sz), (cx, cy, cz) = angles.sin().unbind(-1), angles.cos().unbind(-1)
    rows = [
        cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz,
        cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz,
        -sy, sx * cy, cx * cy,
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(*degrees.shape, 3)


def matrix_from_sixd(sixd: Tensor) -> Tensor:
    """Rotation matrices ``(..., 3, 3)`` from two columns ``(..., 6)`` (Zhou et al. 2019).

    The columns are made orthonormal by Gram–Schmidt.

    Examples
    --------
    >>> matrix_from_sixd(torch.tensor([2.0, 0, 0, 1, 3, 0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    a, other = normalize(sixd[..., :3], dim=-1), sixd[..., 3:]
    b = normalize(other - (a * other).sum(-1, keepdim=True) * a, dim=-1)
    return torch.stack([a, b, torch.linalg.cross(a, b, dim=-1)], dim=-1)


def apply_frame(frame: Any, points: Any) -> Any:
    """Points ``(..., V, 3)`` from a moving frame ``(..., 3, 4)`` to the world; tensors or arrays.

    Examples
    --------
    >>> frame = torch.eye(3, 4) + torch.tensor([0.0, 0, 0, 2])
    >>> apply_frame(frame, torch.zeros(1, 3)).tolist()
    [[2.0, 2.0, 2.0]]
    """
    return points @ frame[..., :3].swapaxes(-1, -2) + frame[..., None, :, 3]


def remove_frame(frame: Any, points: Any) -> Any:
    """Points ``(..., V, 3)`` from the world to a moving frame ``(..., 3, 4)``; tensors or arrays.

    Examples
    --------
    >>> frame = torch.eye(3, 4) + torch.tensor([0.0, 0, 0, 2])
    >>> remove_frame(frame, torch.zeros(1, 3)).tolist()
    [[-2.0, -2.0, -2.0]]
    """
    return (points - frame[..., None, :, 3]) @ frame[..., :3]
