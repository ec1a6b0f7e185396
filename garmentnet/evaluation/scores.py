"""Errors of methods on clips, overall and by class of motion.

Low is G_LF against Ĝ_LF; high is Ĝ_LF + G_HF against Ĝ, the error of the detail alone; overall is
G against Ĝ.  Beside the error of the detail stands the share of the detail's own RMS that it
is.  Modes of the cloth are the principal components of the training frames, seen from the root and
its heading: the first ones are its swing, the later ones its folds.

Pinned vertices follow the body exactly, which flatters every method that skins them.  So each
figure is computed over all vertices and over the free ones, which are not pinned.  Hausdorff
distance and STED of the free ones are those of the triangles whose corners are all free.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import InputError
from ssdr.metrics import hausdorff, sted

from ..data.clip import CLASSES, Clip
from ..io.files import Progress, kept, silent
from ..networks.features import HEADING, PoseFeatures
from ..paper.bones import VirtualBones, remove_frame
from ..training.shapes import ShapeBasis
from .methods import Method

# Last modes of the ranges whose errors are stated, and training frames that they are found from.
_MODES, _FRAMES = (10, 40, 192), 1000
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
    modes : dict of float
        RMSE in mm over all vertices by modes of the cloth, such as "1-10"; the squares of all add
        up to the square of the overall RMSE.
    clips : tuple of Scores
        The clips that were pooled.
    """

    name: str
    frames: int
    all: Parts
    free: Parts
    per_class: dict[str, ClassError]
    modes: dict[str, float]
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
    squares = {k: [c.modes[k] ** 2 for c in clips] for k in clips[0].modes}
    modes = {k: math.sqrt(np.average(s, weights=frames)) for k, s in squares.items()}
    return Scores(name, sum(frames), whole, free, per_class, modes, tuple(clips))


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


class _Scorer:
    """Comparison of predictions with the clips of a store."""

    def __init__(self, bones: VirtualBones) -> None:
        store = bones.store
        self.bones = bones
        self.free = ~bones.subject.carried
        inner = store.faces[self.free[store.faces].all(axis=1)]
        if len(inner) == 0:
            raise InputError("store", "a garment with free triangles", "one that is pinned")
        self.corners, numbered = np.unique(inner, return_inverse=True)
        self.free_faces = numbered.reshape(-1, 3).astype(np.int32)
        self.features = PoseFeatures(store.skeleton, HEADING, store.fps)
        found = kept(bones.folder / "modes.npz", lambda: dataclasses.asdict(self._fit()))
        self.modes = ShapeBasis(**found)

    def _fit(self) -> ShapeBasis:
        store = self.bones.store
        meshes = [
            remove_frame(self.features(clip.joints)[1][some], clip.sequence.frames(some))
            for clip, some in store.sample(self.bones.report["clips"], _FRAMES)
        ]
        return ShapeBasis.fit(np.concatenate(meshes), _MODES[-1])

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
        modes = self._by_mode(clip, predicted - truth)
        return Scores(clip.name, clip.n_frames, whole, free, per_class, modes)

    def _by_mode(self, clip: Clip, gap: Array) -> dict[str, float]:
        """RMSE in mm, by range of modes, of the errors ``(F, V, 3)`` of a clip."""
        frame = self.features(clip.joints)[1]
        rows = (gap @ frame[:, :3, :3]).reshape(len(gap), -1)
        numbers = rows @ self.modes.components.reshape(len(self.modes.components), -1).T
        count = len(gap) * gap.shape[1]
        found = np.square(numbers).sum(axis=0) / count
        rest = float(np.square(rows).sum() / count - found.sum())
        parts = np.split(found, _MODES[:-1])
        squares = [*(float(p.sum()) for p in parts), max(0.0, rest)]
        names = [f"{a + 1}-{b}" for a, b in zip((0, *_MODES), _MODES, strict=False)]
        named = zip([*names, "others"], squares, strict=True)
        return {k: _MM * math.sqrt(square) for k, square in named}

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
