"""Errors of methods on clips: the table of Pan et al. 2022, the chaos floor, distance to the body.

Low is G_LF against Ĝ_LF; high is Ĝ_LF + G_HF against Ĝ, the error of the detail alone; overall is
G against Ĝ.  The prediction of a method without two modules is split like the data: its smoothed
vertices are the low part, the rest is the high part.

Every figure is that of all vertices or of the free ones, which are not pinned to the body; see
:mod:`garmentnet.evaluation.clip_scores`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import ssdr

from ..data.clip import Clip
from ..data.motion import CLASSES
from ..data.virtual_bones import VirtualBones
from ..networks.checkpoint import Checkpoint
from ..networks.network import Motion
from .clip_scores import PARTS, VERTICES, Answer, ClipScore, Inside, Method, Parts, Score, Scorer
from .score_cache import ScoreCache

__all__ = [
    "Answer",
    "Row",
    "Score",
    "bones_themselves",
    "by_looseness",
    "chaos_floor",
    "evaluate",
    "looseness",
    "network_method",
    "plain_method",
    "pool",
    "table",
]

_MM = 1e3  # from metres to millimetres
Array = NDArray[np.float32]


@dataclasses.dataclass(frozen=True, eq=False)
class Row:
    """Errors of one method, pooled over clips.

    RMSE is pooled over frames; Hausdorff distance and STED are means, weighted by frames.

    Attributes
    ----------
    name : str
    frames : int
    low, high, overall : Score
        Over all vertices.
    free : Parts
        Over those that are not pinned.
    per_class, per_class_free : dict
        Overall RMSE, mm, for each class of motion.
    per_vertex : (V,) float64
        Mean overall error, mm.
    inside, inside_free : float
        Fraction of the vertices inside the body, over all frames.
    depth_mean, depth_max : float
        Their depth, mm.
    clips : tuple of ClipScore
        The figures of each clip.
    """

    name: str
    frames: int
    low: Score
    high: Score
    overall: Score
    free: Parts
    per_class: dict[str, float]
    per_class_free: dict[str, float]
    per_vertex: NDArray[np.float64]
    inside: float
    inside_free: float
    depth_mean: float
    depth_max: float
    clips: tuple[ClipScore, ...]

    def parts(self, vertices: str = "all") -> Parts:
        """Scores over "all" or "free" vertices."""
        return self.free if vertices == "free" else Parts(self.low, self.high, self.overall)

    def as_dict(self) -> dict[str, Any]:
        """Numbers and lists, for JSON."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        for key in ("low", "high", "overall", "free"):
            values[key] = dataclasses.asdict(values[key])
        values["per_vertex"] = self.per_vertex.tolist()
        return values | {"clips": [c.as_dict() for c in self.clips]}


def network_method(checkpoint: Checkpoint) -> Method:
    """A checkpoint as a method; with the clip's parameters if it reads them."""

    def answer(clip: Clip) -> Answer:
        motions = checkpoint.motions(clip.joints, clip.parameters)
        low = np.concatenate([m.to_world(m.low) for m in motions])
        return Answer(low, np.concatenate([_detail(m) for m in motions]))

    return answer


def plain_method(bones: VirtualBones, predict: Callable[[Any], Array]) -> Method:
    """A function from joints to vertices as a method; split by the smoother of the clips."""
    smoother = bones.smoother()

    def answer(clip: Clip) -> Answer:
        vertices = np.asarray(predict(clip.joints), np.float32)
        low = np.asarray(smoother.smooth(vertices), np.float32)
        return Answer(low, vertices - low)

    return answer


def bones_themselves(bones: VirtualBones) -> Method:
    """LBS with the fitted transforms, and the simulated detail: the bound for every network.

    Vertices that the body carries are where they belong, as in a network.
    """
    s, bound = bones.skinning, bones.bound

    def answer(clip: Clip) -> Answer:
        fitted = bones.clip(clip.name)
        low = ssdr.skin(s.rest, s.indices, s.weights, fitted.transforms)
        low = np.asarray(low, np.float32)
        if bound is not None:
            low[:, bound.index] = fitted.read("low")[:, bound.index]
        return Answer(low, fitted.read("high"))

    return answer


def evaluate(
    bones: VirtualBones,
    methods: Mapping[str, Method],
    names: Sequence[str],
    *,
    cache: ScoreCache | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> list[Row]:
    """Score methods on clips that are not mirrored.

    One clip of one method is in memory at a time.

    Parameters
    ----------
    bones : VirtualBones
    methods : mapping from names to methods
    names : sequence of str
        Clips.
    cache : ScoreCache, optional
        Where scores are looked up, and stored as soon as they are known.
    progress : callable, optional
        Called with the method's name and the fraction that is done.

    Returns
    -------
    list of Row
        In the order of `methods`.
    """
    scorer = Scorer(bones)
    rows = []
    for m, (name, method) in enumerate(methods.items()):
        scores = []
        for k, clip_name in enumerate(names):
            clip = bones.store.clip(clip_name)
            known = cache.get(name, clip) if cache else None
            score = known or scorer.score(clip, method)
            if cache and known is None:
                cache.put(name, clip, score)
            scores.append(score)
            if progress:
                progress(name, (m + (k + 1) / len(names)) / len(methods))
        rows.append(pool(name, scores, scorer.n_free))
    return rows


def pool(name: str, clips: Sequence[ClipScore], n_free: int) -> Row:
    """The errors of a method from those of each clip.

    Parameters
    ----------
    name : str
    clips : sequence of ClipScore
        At least one.
    n_free : int
        Vertices that are not pinned.
    """
    frames = sum(c.frames for c in clips)
    n_vertices = len(clips[0].per_vertex)
    per_vertex = sum(c.frames * c.per_vertex for c in clips) / frames
    whole, free = _parts(clips, "all"), _parts(clips, "free")
    inside = _inside([c.inside for c in clips])
    return Row(
        name,
        frames,
        whole.low,
        whole.high,
        whole.overall,
        free,
        per_class=_by_class(clips, "all"),
        per_class_free=_by_class(clips, "free"),
        per_vertex=np.asarray(per_vertex),
        inside=inside.count / (frames * n_vertices),
        inside_free=_inside([c.inside_free for c in clips]).count / (frames * n_free),
        depth_mean=inside.depth / max(inside.count, 1),
        depth_max=inside.deepest,
        clips=tuple(clips),
    )


def _parts(clips: Sequence[ClipScore], vertices: str) -> Parts:
    scores = {}
    for part in PARTS:
        pairs = [(c.frames, getattr(getattr(c, vertices), part)) for c in clips]
        scores[part] = Score(
            _root_mean((n, s.rmse) for n, s in pairs),
            sum(n * s.hausdorff for n, s in pairs) / sum(n for n, _ in pairs),
            sum(n * s.sted for n, s in pairs) / sum(n for n, _ in pairs),
        )
    return Parts(**scores)


def _by_class(clips: Sequence[ClipScore], vertices: str) -> dict[str, float]:
    found: dict[str, list[tuple[int, float]]] = {}
    for clip in clips:
        for c in clip.classes:
            pair = (c.frames, getattr(c, vertices).overall.rmse)
            found.setdefault(c.name, []).append(pair)
    return {name: _root_mean(pairs) for name, pairs in sorted(found.items())}


def _root_mean(pairs: Iterable[tuple[int, float]]) -> float:
    frames, squares = np.array(list(pairs), float).T
    return math.sqrt(float(frames @ squares**2) / float(frames.sum()))


def _inside(parts: Sequence[Inside]) -> Inside:
    deepest = max(p.deepest for p in parts)
    return Inside(sum(p.count for p in parts), sum(p.depth for p in parts), deepest)


def chaos_floor(
    bones: VirtualBones, pairs: Iterable[tuple[str, str]] | None = None
) -> dict[str, dict[str, float]]:
    """RMSE / √2, mm, between clips and the same clips from a perturbed first frame.

    Two such runs differ by √2 times their distance from the mean of all runs, and no function of
    the motion can be expected to do better than that mean.

    Parameters
    ----------
    bones : VirtualBones
    pairs : pairs of names, optional
        :meth:`ClipStore.pairs` by default.

    Returns
    -------
    dict
        For each class of motion and for "all": RMSE / √2 ``low`` and ``overall``, over free
        vertices ``low_free`` and ``overall_free``, and the number of ``frames``; empty without
        pairs.
    """
    keys = ("low", "overall", "low_free", "overall_free")
    free = ~np.asarray(bones.store.pinned, bool)
    sums: dict[str, NDArray[np.float64]] = {}
    smoother = bones.smoother()
    for first, second in bones.store.pairs() if pairs is None else pairs:
        a, b = bones.store.clip(first), bones.store.clip(second)
        frames = min(a.n_frames, b.n_frames)
        gap = a.sequence.frames(slice(0, frames)) - b.sequence.frames(slice(0, frames))
        # Smoothing is linear: the difference of the low parts is the smoothed difference.
        low = np.asarray(smoother.smooth(gap))
        of_vertices = [(x.astype(np.float64) ** 2).sum(-1) for x in (low, gap)]
        means = [x[:, part].mean(-1) for part in (slice(None), free) for x in of_vertices]
        squares = np.stack([*means, np.ones(frames)])
        for label in [-1, *np.unique(a.classes[:frames])]:
            chosen = a.classes[:frames] == label if label >= 0 else slice(None)
            key = CLASSES[int(label)] if label >= 0 else "all"
            sums[key] = sums.get(key, np.zeros(5)) + squares[:, chosen].sum(axis=1)
    return {
        name: {k: _MM * math.sqrt(x / s[4] / 2) for k, x in zip(keys, s[:4], strict=True)}
        | {"frames": float(s[4])}
        for name, s in sums.items()
    }


def looseness(
    bones: VirtualBones, names: Sequence[str], *, every: int = 5
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and deviation, mm, of every vertex's distance to the closest body vertex.

    Parameters
    ----------
    bones : VirtualBones
    names : sequence of str
        Clips.
    every : int
        Only every so many frames are measured.
    """
    total = square = np.zeros(bones.store.n_vertices)
    count = 0
    for name in names:
        clip = bones.store.clip(name)
        chosen = np.arange(0, clip.n_frames, every)
        body, cloth = clip.body(chosen), clip.sequence.frames(chosen)
        for b, v in zip(body, cloth, strict=True):
            distance = _MM * cKDTree(b).query(v)[0]
            total, square, count = total + distance, square + distance**2, count + 1
    mean = total / count
    return mean, np.sqrt(np.maximum(square / count - mean**2, 0))


def by_looseness(
    row: Row, mean: NDArray[np.float64], *, bins: int = 4
) -> list[tuple[float, float]]:
    """Mean distance to the body and mean error, mm, of equally many vertices, closest first."""
    parts = np.array_split(np.argsort(mean), bins)
    return [(float(mean[p].mean()), float(row.per_vertex[p].mean())) for p in parts]


def table(rows: Sequence[Row], vertices: str = "all") -> str:
    """The paper's table as text: mm, mm and STED for low, high and overall.

    Parameters
    ----------
    rows : sequence of Row
    vertices : {"all", "free"}
    """
    assert vertices in VERTICES
    width = max([8, *(len(r.name) for r in rows)])
    head = f"{'':<{width}}" + "".join(
        f" | {p + ' RMSE':>12} {'Hausd.':>7} {'STED':>7}" for p in PARTS
    )
    lines = [head + " | inside", "-" * (len(head) + 9)]
    for r in rows:
        cells = [getattr(r.parts(vertices), p) for p in PARTS]
        text = "".join(f" | {c.rmse:12.2f} {c.hausdorff:7.1f} {c.sted:7.4f}" for c in cells)
        inside = r.inside_free if vertices == "free" else r.inside
        lines.append(f"{r.name:<{width}}{text} | {100 * inside:5.2f}%")
    return "\n".join(lines)


def _detail(motion: Motion) -> Array:
    if motion.high is None:
        return np.zeros(motion.low.shape, np.float32)
    turned = motion.high.double().cpu().numpy() @ motion.frame[..., :3].transpose(0, 2, 1)
    return np.asarray(turned, np.float32)
