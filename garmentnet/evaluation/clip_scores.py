"""Errors of one method on one clip: over all vertices and over the free ones, by class of motion.

Pinned vertices follow the body exactly; a method that skins them scores 0 there, one that predicts
them may err where nothing need be predicted.  So every figure is taken a second time over the free
vertices.  Hausdorff distance and STED of the free part are those of the sub-mesh of the triangles
whose corners are all free.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.errors import FormatError, InputError
from ssdr.metrics import hausdorff, sted

from ..collision.push_out import PushOut
from ..data.clip import Clip
from ..data.motion import CLASSES
from ..data.subject import mesh_identity
from ..data.virtual_bones import VirtualBones
from ..io.tables import from_table

__all__ = [
    "PARTS",
    "VERTICES",
    "Answer",
    "ClassScore",
    "ClipScore",
    "Inside",
    "Later",
    "Method",
    "Parts",
    "Score",
    "Scorer",
]

# Metres below the skin from which a vertex counts as inside, as for simulated clips.
INSIDE = 5e-4
# Frames that are compared at once.
_FRAMES_AT_ONCE = 64
_MM = 1e3  # from metres to millimetres
PARTS = ("low", "high", "overall")
VERTICES = ("all", "free")
Array = NDArray[np.float32]
Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Answer:
    """A method's prediction for a clip: low and high part ``(F, V, 3)``, metres, to be added."""

    low: Array
    high: Array


Method = Callable[[Clip], Answer]


class Later:
    """A method that is fitted when it is first needed, which may never be.

    Parameters
    ----------
    fit : callable
        Returns the method.
    """

    def __init__(self, fit: Callable[[], Method]) -> None:
        self.fit = fit

    @functools.cached_property
    def method(self) -> Method:
        return self.fit()

    def __call__(self, clip: Clip) -> Answer:
        return self.method(clip)


@dataclasses.dataclass(frozen=True)
class Score:
    """RMSE over vertices and frames and mean Hausdorff distance of vertices, mm, and STED."""

    rmse: float
    hausdorff: float
    sted: float


@dataclasses.dataclass(frozen=True)
class Parts:
    """Errors of the low part, of the detail alone and overall."""

    low: Score
    high: Score
    overall: Score


@dataclasses.dataclass(frozen=True)
class Inside:
    """Vertices more than half a millimetre inside the body, counted over frames.

    Attributes
    ----------
    count : int
    depth : float
        Sum of their depths, mm.
    deepest : float
        mm.
    """

    count: int
    depth: float
    deepest: float


@dataclasses.dataclass(frozen=True)
class ClassScore:
    """Errors in the frames of one class of motion, over all and over free vertices.

    STED is that of the clip's vertices in these frames, with the speed of the whole clip as its
    scale.
    """

    name: str
    frames: int
    all: Parts
    free: Parts


@dataclasses.dataclass(frozen=True, eq=False)
class ClipScore:
    """Errors of one method on one clip.

    Attributes
    ----------
    clip : str
    frames : int
    all, free : Parts
        Over all vertices, and over those that are not pinned.
    classes : tuple of ClassScore
    inside, inside_free : Inside
    predicting, scoring : float
        Seconds.
    per_vertex : (V,) float64
        Mean overall error, mm.
    """

    clip: str
    frames: int
    all: Parts
    free: Parts
    classes: tuple[ClassScore, ...]
    inside: Inside
    inside_free: Inside
    predicting: float
    scoring: float
    per_vertex: Floats

    def as_dict(self, *, per_vertex: bool = False) -> dict[str, Any]:
        """Numbers and lists, for JSON."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        errors = values.pop("per_vertex")
        for key in ("all", "free", "inside", "inside_free"):
            values[key] = dataclasses.asdict(values[key])
        values["classes"] = [dataclasses.asdict(c) for c in self.classes]
        return values | ({"per_vertex": errors.tolist()} if per_vertex else {})

    @classmethod
    def of(cls, table: Any, n_vertices: int, *, file: str) -> ClipScore:
        """From what :meth:`as_dict` made, with the errors per vertex.

        Raises
        ------
        FormatError
            If a key is missing or a value is of another kind; the message names `file`.
        """
        if not isinstance(table, dict):
            raise FormatError(f"{file}: expected a table of scores")
        plain: Any = from_table(
            _Plain, {k: v for k, v in table.items() if k != "per_vertex"}, file=file
        )
        try:
            errors = np.asarray(table.get("per_vertex"), float)
        except (TypeError, ValueError) as error:
            raise FormatError(f"{file}: per_vertex: not numbers ({error})") from error
        if errors.shape != (n_vertices,):
            raise FormatError(f"{file}: per_vertex: expected {n_vertices} numbers")
        values = {f.name: getattr(plain, f.name) for f in dataclasses.fields(plain)}
        return cls(**values, per_vertex=errors)


# The same fields but for the array, which tables do not read.
_Plain = dataclasses.make_dataclass(
    "_Plain",
    [
        ("clip", str),
        ("frames", int),
        ("all", Parts),
        ("free", Parts),
        ("classes", tuple[ClassScore, ...]),
        ("inside", Inside),
        ("inside_free", Inside),
        ("predicting", float),
        ("scoring", float),
    ],
    frozen=True,
)


@dataclasses.dataclass(frozen=True, eq=False)
class _Surface:
    """Some of the vertices, and the mesh on which shapes are compared."""

    vertices: NDArray[np.intp] | slice
    corners: NDArray[np.intp] | slice
    faces: NDArray[np.int32]


@dataclasses.dataclass(frozen=True, eq=False)
class _Errors:
    """Errors of one part, frame by frame; STED in its two halves."""

    square: Floats
    hausdorff: Floats
    spatial: Floats
    temporal: Floats
    weight: float

    def over(self, frames: Any = slice(None)) -> Score:
        """The score of some frames; the step into a frame is that frame's."""
        steps = self.temporal[frames[1:] if isinstance(frames, np.ndarray) else frames]
        moved = float(steps.mean()) if len(steps) else 0.0
        return Score(
            _MM * math.sqrt(self.square[frames].mean()),
            _MM * float(self.hausdorff[frames].mean()),
            math.hypot(float(self.spatial[frames].mean()), self.weight * moved),
        )


class Scorer:
    """Compares answers with the clips of a store.

    Parameters
    ----------
    bones : VirtualBones

    Raises
    ------
    InputError
        If every vertex or a corner of every triangle is pinned.
    """

    def __init__(self, bones: VirtualBones) -> None:
        store = bones.store
        self.bones = bones
        self.skin = PushOut(store.body, store.faces, n_vertices=store.n_vertices)
        self.surfaces = {"all": _Surface(slice(None), slice(None), store.faces)}
        self.free = ~np.asarray(store.pinned, bool)
        if not self.free.all():
            self.surfaces["free"] = self._free_part()

    @property
    def n_free(self) -> int:
        """Number of vertices that are not pinned."""
        return int(self.free.sum())

    def identity(self) -> str:
        """What scores depend on besides clip and method."""
        store = self.bones.store
        pinned = np.flatnonzero(store.pinned).tolist()
        mesh = mesh_identity(store.rest, store.faces)
        body = self.bones.subject.body_id
        return repr((mesh, body, self.bones.options.length, pinned))

    def score(self, clip: Clip, method: Method) -> ClipScore:
        """Predict a clip and compare the prediction with it."""
        if isinstance(method, Later):
            method = method.method  # fitting is no part of the prediction's time
        began = time.perf_counter()
        answer = method(clip)
        answered = time.perf_counter()
        fitted = self.bones.clip(clip.name)
        low, truth = fitted.read("low"), fitted.read("high")
        truth += low
        answered_all = answer.low + answer.high
        pairs = {
            "low": (low, answer.low),
            "high": (truth, low + answer.high),
            "overall": (truth, answered_all),
        }
        errors = {
            part: {name: _compare(*pair, surface) for name, surface in self.surfaces.items()}
            for part, pair in pairs.items()
        }

        def over(vertices: str, frames: Any = slice(None)) -> Parts:
            name = vertices if vertices in self.surfaces else "all"
            return Parts(**{p: errors[p][name].over(frames) for p in PARTS})

        classes = []
        for label in np.unique(clip.classes):
            inside = clip.classes == label
            count = int(inside.sum())
            split = {v: over(v, inside) for v in VERTICES}
            classes.append(ClassScore(CLASSES[int(label)], count, **split))
        per_vertex = np.zeros(len(self.free))
        for i in range(0, clip.n_frames, _FRAMES_AT_ONCE):
            at = slice(i, i + _FRAMES_AT_ONCE)
            gap = answered_all[at].astype(np.float64) - truth[at]
            per_vertex += np.sqrt((gap**2).sum(axis=-1)).sum(axis=0)
        inside_all, inside_free = self._penetration(clip, answered_all)
        return ClipScore(
            clip=clip.name,
            frames=clip.n_frames,
            all=over("all"),
            free=over("free"),
            classes=tuple(sorted(classes, key=lambda c: c.name)),
            inside=inside_all,
            inside_free=inside_free,
            predicting=answered - began,
            scoring=time.perf_counter() - answered,
            per_vertex=_MM * per_vertex / clip.n_frames,
        )

    def _free_part(self) -> _Surface:
        faces = np.asarray(self.bones.store.faces)
        inner = faces[self.free[faces].all(axis=1)]
        if len(inner) == 0:
            raise InputError("store", "a garment with free triangles", "one that is pinned")
        corners, numbered = np.unique(inner, return_inverse=True)
        return _Surface(
            np.flatnonzero(self.free),
            corners.astype(np.intp),
            numbered.reshape(-1, 3).astype(np.int32),
        )

    def _penetration(self, clip: Clip, vertices: Array) -> tuple[Inside, Inside]:
        counts, sums, deepest = np.zeros(2, int), np.zeros(2), np.zeros(2)
        for i in range(0, len(vertices), _FRAMES_AT_ONCE):
            part = slice(i, i + _FRAMES_AT_ONCE)
            depth = -self.skin.signed_distance(vertices[part], clip.joints[part])
            depth = np.where(depth > INSIDE, depth, 0.0)
            for k, d in enumerate((depth, depth[:, self.free])):
                counts[k] += int((d > 0).sum())
                sums[k] += float(d.sum())
                deepest[k] = max(deepest[k], float(d.max()))
        whole, free = (Inside(int(counts[k]), _MM * sums[k], _MM * deepest[k]) for k in (0, 1))
        return whole, free


def _compare(truth: Array, other: Array, surface: _Surface) -> _Errors:
    square = np.empty(len(truth))
    for i in range(0, len(truth), _FRAMES_AT_ONCE):
        part = slice(i, i + _FRAMES_AT_ONCE)
        gap = other[part, surface.vertices].astype(np.float64) - truth[part, surface.vertices]
        square[part] = (gap**2).sum(axis=-1).mean(axis=-1)
    a, b = truth[:, surface.corners], other[:, surface.corners]
    shape = sted(a, b, surface.faces)
    return _Errors(
        square,
        hausdorff(a, b, surface=False).vertex_per_frame,
        shape.spatial_per_frame,
        shape.temporal_per_frame,
        shape.c,
    )
