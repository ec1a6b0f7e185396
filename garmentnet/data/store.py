"""A store: simulated clips of one garment on one body, in a folder.

Garment and body are stored once; each clip is a zarr group with the garment's vertices, the body's
joint transforms and the class of motion of every frame.  A clip is on disk complete or not at all.
Training, evaluation and prediction need nothing else.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import zarr
from numpy.typing import ArrayLike, NDArray

import ssdr
from ssdr.common.checks import check_mask
from ssdr.common.errors import FormatError, InputError, check_choice
from ssdr.io.atomic import atomic_path, remove
from ssdr.io.file_errors import check, reading
from ssdr.mesh.sequence import MeshSequence
from ssdr.model.skinning import Skinning

from .clip import MIRRORED, Clip, spread
from .clip_files import Split, compressors, write_clip
from .motion import CLASSES
from .outfit import Outfit, is_mirror
from .parameters import SimulationParameters
from .skeleton import Skeleton, check_finite

_FORMAT, _VERSION = "garmentnet clips", 1
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
    ...     store = ClipStore.create(
    ...         Path(folder) / "a.clips", rest=triangle, faces=[[0, 1, 2]], body=body,
    ...         skeleton=skeleton,
    ...     )
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
    def create(
        cls,
        path: str | os.PathLike[str],
        *,
        rest: ArrayLike,
        faces: ArrayLike,
        body: Skinning,
        skeleton: Skeleton,
        fps: float = 30.0,
        mirror_vertices: ArrayLike | None = None,
        pinned: ArrayLike | None = None,
    ) -> ClipStore:
        """Make an empty store, or open an existing one of the same garment and body.

        Parameters
        ----------
        path : path
        rest : (V, 3) array
            The garment on the body at rest, metres.
        faces : (T, 3) int array
        body : Skinning
        skeleton : Skeleton
            Skeleton whose joints have the names of the body's bones.
        fps : float
        mirror_vertices : (V,) int array, optional
        pinned : (V,) bool array, optional
            Mask of the vertices that follow the body; by default none does.

        Raises
        ------
        InputError
            If an array does not fit, or `path` is something else or a store of another
            garment, body or frame rate.
        """
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        garment = MeshSequence(np.asarray(rest, dtype=np.float32)[None], faces, fps)
        if body.names() != skeleton.names:
            raise InputError("skeleton", f"the body's joints {body.names()}", skeleton.names)
        count = garment.n_vertices
        mask = check_mask(pinned, "pinned", count)
        mirror = None
        if mirror_vertices is not None:
            mirror = np.asarray(mirror_vertices, dtype=np.int32)
            if not is_mirror(mirror, garment.faces, count):
                expected = f"a permutation of {count}, its own inverse, of triangles to triangles"
                raise InputError("mirror_vertices", expected, "another")
        outfit = Outfit(
            rest=np.asarray(garment.vertices[0]),
            faces=garment.faces,
            body=body,
            skeleton=skeleton,
            fps=garment.fps,
            pinned=np.zeros(count, bool) if mask is None else mask,
            mirror_vertices=mirror,
        )
        if target.exists():
            return cls._same(target, outfit)
        metadata = {
            "format": _FORMAT,
            "version": _VERSION,
            "fps": outfit.fps,
            "parents": skeleton.parents.tolist(),
            "joint_rest": skeleton.rest.tolist(),
            "classes": list(CLASSES),
        }
        try:
            with atomic_path(target, flush=False) as temporary:
                group = zarr.create_group(store=str(temporary), attributes=metadata)
                for name in _ARRAYS:
                    values = getattr(outfit, name)
                    if values is not None:
                        group.create_array(name, data=values, compressors=compressors())
                (temporary / "clips").mkdir()
                ssdr.save(body, temporary / "body.npz")
        except OSError:
            # Another process may have made the store in the meantime.
            if not (target / "zarr.json").is_file():
                raise
        return cls._same(target, outfit)

    @classmethod
    def _same(cls, path: Path, outfit: Outfit) -> ClipStore:
        there = cls.open(path)
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
        check((target / "zarr.json").is_file(), f"{target}: not a store of clips (no zarr.json)")
        with reading(target):
            group: Any = zarr.open_group(str(target), mode="r")
            attributes = dict(group.attrs)
            if attributes.get("format") != _FORMAT:
                raise FormatError("not a store of clips (no such attribute format)")
            if attributes.get("version") != _VERSION:
                raise FormatError(f"version {attributes.get('version')}, this reads {_VERSION}")
            arrays: dict[str, Any] = {
                name: np.asarray(group[name][:])
                for name in _ARRAYS
                if name in group or name != "mirror_vertices"
            }
            MeshSequence(arrays["rest"][None], arrays["faces"])
            body = ssdr.load_skinning(target / "body.npz").skinning
            if list(attributes["classes"]) != list(CLASSES[: len(attributes["classes"])]):
                raise FormatError(f"other classes of motion: {attributes['classes']}")
            joint_rest = np.asarray(attributes["joint_rest"])
            return cls(
                **arrays,
                body=body,
                skeleton=Skeleton(body.names(), attributes["parents"], joint_rest),
                fps=float(attributes["fps"]),
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
        folder = self.path / "clips"
        check(folder.is_dir(), f"{self.path}: no folder clips")
        # Unfinished writes have hidden names; whatever else is there must be a clip.
        names = sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
        for clip in map(self.clip, names):
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
        path = self.path / "clips" / name
        with reading(path):
            metadata = json.loads((path / "zarr.json").read_text())["attributes"]
            check(metadata["split"] in get_args(Split), f"split {metadata['split']!r}")
            accepted = metadata["quality"].get("accepted")
            check(isinstance(accepted, bool), "quality does not state whether it was accepted")
            return Clip(
                outfit=self,
                name=name,
                split=metadata["split"],
                motion=str(metadata["motion"]),
                parameters=SimulationParameters(**metadata["parameters"]),
                seed=int(metadata["seed"]),
                perturbation=float(metadata["perturbation"]),
                quality=dict(metadata["quality"]),
                provenance=dict(metadata["provenance"]),
                n_frames=int(metadata["frames"]),
                step=float(metadata.get("step", 0.0)),
                is_mirrored=False,
                path=path,
            )

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

    def __contains__(self, name: object) -> bool:
        return (
            isinstance(name, str)
            and bool(_NAME.match(name))
            and (self.path / "clips" / name).exists()
        )

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
        target = self.path / "clips" / name
        if target.exists():
            raise InputError("name", "a clip that is not in the store", repr(name))
        check_choice(split, "split", Split)
        accepted = quality.get("accepted")
        if not isinstance(accepted, bool):
            raise InputError("quality", "a bool 'accepted'", quality)
        v = np.asarray(vertices, dtype=np.float32)
        if v.ndim != 3 or v.shape[1:] != (self.n_vertices, 3) or len(v) < 1:
            raise InputError("vertices", f"shape (F, {self.n_vertices}, 3)", f"shape {v.shape}")
        frames = len(v)
        m = np.asarray(joints, dtype=np.float32)
        shape = (frames, self.skeleton.n_joints, 3, 4)
        if m.shape != shape or not np.isfinite(m).all():
            raise InputError("joints", f"finite numbers of shape {shape}", f"shape {m.shape}")
        recorded = np.full(frames, CLASSES.index("recorded"))
        c = np.asarray(recorded if classes is None else classes, dtype=np.int8)
        if c.shape != (frames,) or c.min() < 0 or c.max() >= len(CLASSES):
            raise InputError("classes", f"{frames} indices below {len(CLASSES)}", c)
        if accepted:
            check_finite(v, "vertices")
        metadata = {
            "frames": frames,
            "fps": self.fps,
            "split": split,
            "motion": str(motion),
            "parameters": dataclasses.asdict(parameters),
            "seed": int(seed),
            "perturbation": float(perturbation),
            "quality": json.loads(json.dumps(dict(quality))),
            "provenance": json.loads(json.dumps(dict(provenance))),
        }
        arrays: dict[str, NDArray[Any]] = {"vertices": v, "joints": m, "classes": c}
        write_clip(target, arrays, metadata, step if accepted else 0.0)
        return self.clip(name)

    def sweep(self) -> int:
        """Remove incomplete clips that killed writers left behind, and return their number.

        It must not be called while another process writes to the store.
        """
        left = list((self.path / "clips").glob(".*"))
        for path in left:
            remove(path)
        return len(left)
