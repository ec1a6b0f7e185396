"""Errors of methods on clips, overall and by class of motion.

Low is G_LF against Ĝ_LF; high is Ĝ_LF + G_HF against Ĝ, the error of the detail alone; overall is
G against Ĝ.  Beside the error of the detail stands the share of the detail's own RMS that it
is: a constant vector for each vertex (:class:`~garmentnet.evaluation.methods.MeanDetail`) leaves
what a network can learn.

Pinned vertices follow the body exactly, which flatters every method that skins them.  So each
figure is computed over all vertices and over the free ones, which are not pinned.  Hausdorff
distance and STED of the free ones are those of the triangles whose corners are all free.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError
from ssdr.metrics import hausdorff, sted

from ..data.clip import CLASSES, Clip
from ..io.files import Progress, silent
from ..paper.bones import VirtualBones
from .methods import Method

_MM = 1e3  # from metres to millimetres
PARTS = ("low", "high", "overall")
VERTICES = ("all", "free")
Array = NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class Score:
    """RMSE over vertices and frames (mm), mean Hausdorff distance of vertices (mm), and STED."""

    rmse: float
    hausdorff: float
    sted: float


@dataclasses.dataclass(frozen=True)
class Parts:
    """Errors of the low part, of the detail alone, and of the whole garment.

    `detail` is the RMS of the simulated detail, mm, over vertices and frames.
    """

    low: Score
    high: Score
    overall: Score
    detail: float

    @property
    def left(self) -> float:
        """Error of the detail as a fraction of its RMS: 1 without any, 0 without error."""
        return self.high.rmse / self.detail if self.detail else math.nan


@dataclasses.dataclass(frozen=True)
class ClassError:
    """Overall RMSE, mm, in the frames of one class of motion, over all and free vertices."""

    frames: int
    all: float
    free: float


@dataclasses.dataclass(frozen=True, eq=False)
class Scores:
    """Errors of a method on one clip, or pooled over clips.

    A pooled RMSE is the root of the mean square over clips; the other figures are means.  Clips are
    weighted by their numbers of frames.

    Attributes
    ----------
    name : str
        Name of the clip or, for pooled errors, of the method.
    frames : int
    all, free : Parts
        Over all vertices, and over those that are not pinned.
    per_class : dict of ClassError
        By class of motion.
    clips : tuple of Scores
        The clips that were pooled.
    """

    name: str
    frames: int
    all: Parts
    free: Parts
    per_class: dict[str, ClassError]
    clips: tuple[Scores, ...] = ()


def evaluate(
    bones: VirtualBones,
    methods: Sequence[Method],
    names: Sequence[str],
    *,
    progress: Progress = silent,
) -> list[Scores]:
    """Score methods on clips that are not mirrored; one clip is in memory at a time.

    Parameters
    ----------
    bones : VirtualBones
    methods : sequence of Method
    names : sequence of str
        Clips.
    progress : callable, optional
        Called with a method's name and the fraction that is done.

    Returns
    -------
    list of Scores
        Pooled over the clips, in the order of `methods`.

    Raises
    ------
    InputError
        If every vertex or a corner of every triangle is pinned.
    """
    scorer = _Scorer(bones)
    rows = []
    for m, method in enumerate(methods):
        scores = []
        for k, name in enumerate(names):
            scores.append(scorer.score(method, bones.store.clip(name)))
            progress(method.name, (m + (k + 1) / len(names)) / len(methods))
        rows.append(pool(method.name, scores))
    return rows


def pool(name: str, clips: Sequence[Scores]) -> Scores:
    """Errors of a method pooled over one or more clips."""
    frames, per_class = [c.frames for c in clips], {}
    for label in sorted({k for c in clips for k in c.per_class}):
        found = [c.per_class[label] for c in clips if label in c.per_class]
        per_class[label] = _pooled(found, [e.frames for e in found])
    whole, free = (_pooled([getattr(c, v) for c in clips], frames) for v in VERTICES)
    return Scores(name, sum(frames), whole, free, per_class, tuple(clips))


def _pooled(found: Sequence[Any], frames: Sequence[int]) -> Any:
    """Errors of one kind pooled over clips: each RMS by its square, other figures by the mean."""
    values: dict[str, Any] = {"frames": sum(frames)}
    for name in vars(found[0]).keys() - values:
        some = [getattr(x, name) for x in found]
        if dataclasses.is_dataclass(some[0]):
            values[name] = _pooled(some, frames)
        else:
            power = 1 if name in ("hausdorff", "sted") else 2
            mean = np.average(np.power(some, power), weights=frames)
            values[name] = float(mean ** (1 / power))
    return type(found[0])(**{name: values[name] for name in vars(found[0])})


def chaos_floor(bones: VirtualBones, pairs: Iterable[tuple[str, str]]) -> dict[str, float]:
    """RMSE / √2, mm, between clips and the same clips from a perturbed first frame.

    Two such runs differ by √2 times their distance from the mean of all runs, and no function of
    the motion can be expected to do better than that mean.

    Parameters
    ----------
    bones : VirtualBones
    pairs : pairs of names
        As of :meth:`ClipStore.pairs`.

    Returns
    -------
    dict
        RMSE / √2 ``low``, ``high`` and ``overall``, over free vertices ``low_free`` and so on, and
        the number of ``frames``.
    """
    free, squares, count = ~np.asarray(bones.store.pinned, bool), np.zeros(6), 0
    for first, second in pairs:
        a, b = bones.store.clip(first), bones.store.clip(second)
        frames = min(a.n_frames, b.n_frames)
        gap = a.sequence.frames(slice(0, frames)) - b.sequence.frames(slice(0, frames))
        # Smoothing is linear: the difference of the low parts is the smoothed difference.
        low = np.asarray(bones.smoother.smooth(gap))
        of_vertices = [(x.astype(np.float64) ** 2).sum(-1) for x in (low, gap - low, gap)]
        parts = [x[:, part] for part in (slice(None), free) for x in of_vertices]
        squares += [x.mean(-1).sum() for x in parts]
        count += frames
    keys = [part + end for end in ("", "_free") for part in PARTS]
    errors = _MM * np.sqrt(squares / count / 2)
    return dict(zip(keys, errors.tolist(), strict=True)) | {"frames": count}


class _Scorer:
    """Comparison of predictions with the clips of a store."""

    def __init__(self, bones: VirtualBones) -> None:
        store = bones.store
        self.bones = bones
        self.free = ~np.asarray(store.pinned, bool)
        inner = store.faces[self.free[store.faces].all(axis=1)]
        if len(inner) == 0:
            raise InputError("store", "a garment with free triangles", "one that is pinned")
        self.corners, numbered = np.unique(inner, return_inverse=True)
        self.free_faces = numbered.reshape(-1, 3).astype(np.int32)

    def score(self, method: Method, clip: Clip) -> Scores:
        """Predict a clip and compare the prediction with it."""
        low, high = method.split(clip, self.bones)
        true_low, true_high = self.bones.split(clip.name)
        truth, predicted = true_low + true_high, low + high
        pairs = (true_low, low), (truth, true_low + high), (truth, predicted)
        found = [self._compare(*pair) for pair in pairs]
        detail = _squares(truth, true_low)
        whole, free = (
            Parts(found[0][k], found[1][k], found[2][k], _rms(square))
            for k, square in enumerate((detail, detail.compress(self.free, axis=1)))
        )
        square = _squares(truth, predicted)
        per_class = {}
        for label in np.unique(clip.classes):
            s = square[clip.classes == label]
            errors = (_rms(x) for x in (s, s[:, self.free]))
            per_class[CLASSES[int(label)]] = ClassError(len(s), *errors)
        return Scores(clip.name, clip.n_frames, whole, free, per_class)

    def _compare(self, truth: Array, other: Array) -> tuple[Score, Score]:
        """Scores over all and over free vertices."""
        square = _squares(truth, other)
        whole = _score(square, truth, other, self.bones.store.faces)
        if self.free.all():
            return whole, whole
        a, b = truth[:, self.corners], other[:, self.corners]
        return whole, _score(square[:, self.free], a, b, self.free_faces)


def _squares(truth: Array, other: Array) -> NDArray[np.float64]:
    """Squared distances ``(F, V)``."""
    gap = other - truth
    return np.einsum("fvc,fvc->fv", gap, gap, dtype=np.float64)


def _rms(square: NDArray[np.float64]) -> float:
    return _MM * float(np.sqrt(square.mean()))


def _score(square: NDArray[np.float64], truth: Array, other: Array, faces: Any) -> Score:
    return Score(
        _rms(square),
        _MM * float(hausdorff(truth, other, surface=False).vertex_per_frame.mean()),
        sted(truth, other, faces).value,
    )
