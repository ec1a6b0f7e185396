"""A store: simulated clips of one garment on one body, in a folder.

Garment and body are stored once; each clip is a file with the garment's vertices, the body's joint
transforms and the class of motion of every frame.  A clip is on disk complete or not at all, and a
store that has lost one of its clips is refused.  Training, evaluation and prediction need nothing
else.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import ssdr
from ssdr.common.errors import InputError, check_choice
from ssdr.io.arrays.array_files import read_arrays, write_arrays
from ssdr.io.atomic import atomic_path, remove, write_bytes
from ssdr.io.file_errors import check, reading
from ssdr.mesh.sequence import MeshSequence

from ..io.tables import from_table
from .clip import CLASSES, MIRRORED, Clip, ClipDocument, spread
from .clip_files import Split, read_document, write_clip
from .outfit import Outfit, is_mirror
from .parameters import SimulationParameters
from .skeleton import Skeleton, check_finite, check_joints

_VERSION = 2
# Of garment and skeleton, and of the names of all clips, which are in the folder `clips`.
OUTFIT, _LIST = "outfit.npz", "clips.txt"
_ASYMMETRY = 0.02  # of a skeleton's size, up to which joints mirror each other
_ARRAYS = ("rest", "faces", "pinned", "mirror_vertices")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\-]*\Z")


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ClipStore(Outfit):
    """Folder of clips of one garment on one body; made by :meth:`create` or :meth:`open`.

    Attributes
    ----------
    path : Path

    It also has the attributes of :class:`~garmentnet.data.outfit.Outfit`.

    Examples
    --------
    >>> import tempfile
    >>> from ssdr import Skinning
    >>> triangle = np.eye(3, dtype=np.float32)
    >>> body = Skinning(
    ...     triangle, np.zeros((3, 1), int), np.ones((3, 1)), np.eye(3, 4)[None, None],
    ...     faces=[[0, 1, 2]], bone_names=("root",),
    ... )
    >>> skeleton = Skeleton(("root",), [-1], [[0, 0, 0]])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     outfit = Outfit(triangle, [[0, 1, 2]], body, skeleton, fps=30.0)
    ...     store = ClipStore.create(Path(folder) / "a.clips", outfit)
    ...     clip = store.add(
    ...         "still", vertices=[triangle] * 5, joints=[np.eye(3, 4)[None]] * 5,
    ...         classes=[0] * 5, split="train", motion="still", seed=0,
    ...         parameters=SimulationParameters(), quality={"accepted": True}, provenance={},
    ...     )
    ...     store.names("train"), clip.n_frames, clip.sequence.n_vertices
    (('still',), 5, 3)
    """

    path: Path

    def __repr__(self) -> str:
        return f"ClipStore({str(self.path)!r}, {len(self.names())} clips, V={self.n_vertices})"

    @classmethod
    def create(cls, path: str | os.PathLike[str], outfit: Outfit) -> ClipStore:
        """Make an empty store, or open an existing one of the same garment and body.

        Raises
        ------
        InputError
            If an array does not fit, or `path` is something else or a store of another
            garment, body or frame rate.
        """
        target, body, skeleton = Path(path), outfit.body, outfit.skeleton
        target.parent.mkdir(parents=True, exist_ok=True)
        MeshSequence(outfit.rest[None], outfit.faces, outfit.fps)
        if body.names() != skeleton.names:
            raise InputError("skeleton", f"the body's joints {body.names()}", skeleton.names)
        count, mirror = outfit.n_vertices, outfit.mirror_vertices
        if mirror is not None and not is_mirror(mirror, outfit.faces, count):
            expected = f"a permutation of {count}, its own inverse, of triangles to triangles"
            raise InputError("mirror_vertices", expected, "another")
        far = np.abs(skeleton.rest[skeleton.mirror()] * [-1, 1, 1] - skeleton.rest).max()
        if mirror is not None and far > _ASYMMETRY * np.ptp(skeleton.rest, axis=0).max():
            expected = "a skeleton that mirrors itself in x, its joints named _l and _r"
            raise InputError("mirror_vertices", expected, f"a joint {far:.3g} m off")
        if not target.exists():
            arrays = {k: x for k in _ARRAYS if (x := getattr(outfit, k)) is not None}
            arrays |= {"parents": skeleton.parents, "joint_rest": skeleton.rest, "fps": outfit.fps}
            arrays |= {"version": _VERSION, "classes": np.array(CLASSES)}
            with atomic_path(target, flush=False) as temporary:
                (temporary / "clips").mkdir(parents=True)
                (temporary / _LIST).touch()
                write_arrays(temporary / OUTFIT, arrays)
                ssdr.save(body, temporary / "body.npz")
        there = cls.open(target)
        if not there.is_like(outfit):
            expected = "a new folder or a store of this garment and body"
            raise InputError("path", expected, there.path)
        return there

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> ClipStore:
        """Open a store.

        Raises
        ------
        FormatError
            If `path` is not a store of clips, or a part of the store is missing or damaged.
        """
        target = Path(path)
        check(target.is_dir(), f"{target}: no such folder")
        file = target / OUTFIT
        check(file.is_file(), f"{target}: not a store of clips (no {OUTFIT})")
        stated = ("version", "classes", "fps", "parents", "joint_rest")
        d = read_arrays(file, required=(*stated, *_ARRAYS[:3]), optional=_ARRAYS[3:])
        with reading(file):
            check(d["version"] == _VERSION, f"version {d['version']}, this reads {_VERSION}")
            known = tuple(d["classes"].tolist())
            check(known == CLASSES[: len(known)], f"other classes of motion: {known}")
            MeshSequence(d["rest"][None], d["faces"])
            body = ssdr.load_skinning(target / "body.npz").skinning
            arrays: dict[str, Any] = {name: d.get(name) for name in _ARRAYS}
            return cls(
                **arrays,
                body=body,
                skeleton=Skeleton(body.names(), d["parents"], d["joint_rest"]),
                fps=float(d["fps"]),
                path=target,
            )

    def clips(
        self,
        split: Split | None = None,
        parameters: SimulationParameters | None = None,
        accepted: bool | None = True,
        perturbed: bool | None = False,
    ) -> Iterator[Clip]:
        """The clips, sorted by name, that meet all conditions.

        Parameters
        ----------
        split : {"train", "validation", "test"}, optional
        parameters : SimulationParameters, optional
        accepted : bool or None
            Whether the quality gate accepted them; None: either.
        perturbed : bool or None
            Whether their first frame was perturbed to measure chaos; None: either.
        """
        if split is not None:
            check_choice(split, "split", Split)
        for clip in map(self.clip, self._every()):
            if (
                split in (None, clip.split)
                and parameters in (None, clip.parameters)
                and accepted in (None, clip.accepted)
                and perturbed in (None, clip.perturbation > 0)
            ):
                yield clip

    def names(self, *args: Any, **kwargs: Any) -> tuple[str, ...]:
        """Names of the clips that :meth:`clips` chooses."""
        return tuple(clip.name for clip in self.clips(*args, **kwargs))

    def clip(self, name: str) -> Clip:
        """A clip by its name; it is reflected if the name ends in ``~mirrored``.

        Raises
        ------
        InputError
            If there is no clip of that name.
        FormatError
            If the clip is damaged.
        """
        if name.endswith(MIRRORED):
            return self.clip(name.removesuffix(MIRRORED)).mirrored()
        if name not in self:
            raise InputError("name", f"a clip of {self.path}", repr(name))
        path = self._file(name)
        text = read_document(path)
        with reading(path):
            stated = from_table(ClipDocument, json.loads(text), file="document")
            accepted = stated.quality.get("accepted")
            check(isinstance(accepted, bool), "quality does not state whether it was accepted")
            return Clip(**vars(stated), outfit=self, name=name, path=path)

    def sample(self, names: Sequence[str], count: int) -> Iterator[tuple[Clip, NDArray[np.int64]]]:
        """Clips and indices of frames of each, `count` in total (or all), evenly spread."""
        clips = [self.clip(n) for n in names]
        chosen = spread([c.n_frames for c in clips], count)
        return ((c, f) for c, f in zip(clips, chosen, strict=True) if len(f))

    def parameters(self) -> tuple[SimulationParameters, ...]:
        """Parameter sets of accepted clips, those with the most clips first."""
        count = Counter(clip.parameters for clip in self.clips())
        return tuple(sorted(count, key=lambda p: (-count[p], dataclasses.astuple(p))))

    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names of accepted clips, each with that of the same clip from a perturbed first frame."""
        named = []
        for twin in self.clips(perturbed=True):
            original = str(twin.provenance.get("repeat_of", ""))
            if original in self and self.clip(original).accepted:
                named.append((original, twin.name))
        return tuple(named)

    def refused(self) -> str:
        """Sentence on clips that the quality gate refused: how many, which and why; or nothing."""
        every = list(self.clips(accepted=None, perturbed=None))
        found = [f"{c.name} ({c.quality.get('reason')})" for c in every if not c.accepted]
        text = (
            f"{len(found)} of {len(every)} clips are refused and left out: {', '.join(found[:8])}"
        )
        return (text + ", ..." * (len(found) > 8)) if found else ""

    def __contains__(self, name: object) -> bool:
        known = isinstance(name, str) and _NAME.match(name)
        return bool(known) and self._file(str(name)).is_file()

    def _file(self, name: str) -> Path:
        return self.path / "clips" / f"{name}.npz"

    def _every(self) -> list[str]:
        """Names of all clips, sorted.

        Raises
        ------
        FormatError
            If a clip is not there that the list of clips has.
        """
        listed = self.path / _LIST
        check(listed.is_file(), f"{self.path}: no {_LIST}, the list of its clips")
        # Unfinished writes have hidden names.
        there = {p.stem for p in (self.path / "clips").glob("[!.]*.npz")}
        for name in listed.read_text("utf-8").split():
            lost = f"lost; to do without it, take its line out of {_LIST}"
            check(name in there, f"{self._file(name)}: {lost}")
        return sorted(there)

    def add(
        self,
        name: str,
        *,
        vertices: ArrayLike,
        joints: ArrayLike,
        split: Split,
        motion: str,
        parameters: SimulationParameters,
        provenance: Mapping[str, Any],
        classes: ArrayLike | None = None,
        seed: int = 0,
        quality: Mapping[str, Any] = {"accepted": True, "reason": ""},
        perturbation: float = 0.0,
        step: float = 0.0,
    ) -> Clip:
        """Write a clip; it is in the store when it is complete.

        Parameters
        ----------
        name : str
            Letters, digits, ``_``, ``.`` and ``-``.
        vertices : (F, V, 3) array
        joints : (F, J, 3, 4) array
            Transforms from the body's rest pose to the pose of each frame.
        classes : (F,) int array, optional
            By default all frames are recorded.
        split, motion, parameters, seed, quality, provenance, perturbation
            As in :class:`Clip`.  `quality` must hold a bool ``accepted``; only a clip that is not
            accepted may hold NaN or Inf.
        step : float
            Step, metres, to whose multiples the vertices are rounded, which takes an eighth of the
            space.  With 0 they are stored as float32; those of a clip that is not accepted always
            are.

        Raises
        ------
        InputError
            If the name is taken or has other characters, shapes do not match or numbers are
            not finite.
        """
        if not (isinstance(name, str) and _NAME.match(name)):
            raise InputError("name", "letters, digits, '_', '.' and '-'", repr(name))
        if name in self:
            raise InputError("name", "a clip that is not in the store", repr(name))
        check_choice(split, "split", Split)
        accepted = quality.get("accepted")
        if not isinstance(accepted, bool):
            raise InputError("quality", "a bool 'accepted'", quality)
        v = np.asarray(vertices, dtype=np.float32)
        if v.ndim != 3 or v.shape[1:] != (self.n_vertices, 3) or len(v) < 1:
            raise InputError("vertices", f"shape (F, {self.n_vertices}, 3)", f"shape {v.shape}")
        frames = len(v)
        m = check_joints(joints, self.skeleton.n_joints).astype(np.float32)
        if len(m) != frames:
            raise InputError("joints", f"as many frames as the vertices have ({frames})", len(m))
        recorded = np.full(frames, CLASSES.index("recorded"))
        c = np.asarray(recorded if classes is None else classes, dtype=np.int8)
        if c.shape != (frames,) or c.min() < 0 or c.max() >= len(CLASSES):
            raise InputError("classes", f"{frames} indices below {len(CLASSES)}", c)
        if accepted:
            check_finite(v, "vertices")
        document = ClipDocument(
            split=split,
            motion=str(motion),
            parameters=parameters,
            seed=int(seed),
            perturbation=float(perturbation),
            quality=dict(quality),
            provenance=dict(provenance),
            n_frames=frames,
            step=float(step) if accepted else 0.0,
        )
        stated = dataclasses.asdict(document)
        write_clip(self._file(name), stated, v, document.step, joints=m, classes=c)
        # The line is added to the list at once, whoever else adds clips.
        with (self.path / _LIST).open("a", encoding="utf-8") as listed:
            listed.write(f"{name}\n")
        return self.clip(name)

    def sweep(self) -> int:
        """Remove incomplete clips that killed writers left behind, and return their number.

        Whole ones that they did not list are listed.  It must not be called while another process
        writes to the store.
        """
        left = list((self.path / "clips").glob(".*"))
        for path in left:
            remove(path)
        write_bytes(self.path / _LIST, "".join(f"{name}\n" for name in self._every()).encode())
        return len(left)
