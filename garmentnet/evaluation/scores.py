"""Errors of methods on clips: the table of Pan et al. 2022, the chaos floor, distance to the body.

Low is G_LF against Ĝ_LF; high is Ĝ_LF + G_HF against Ĝ, the error of the detail alone; overall is
G against Ĝ.  The prediction of a method without two modules is split like the data: its smoothed
vertices are the low part, the rest is the high part.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import ssdr
from ssdr.metrics import compare

from ..data.clip import Clip
from ..data.motion import CLASSES
from ..data.virtual_bones import VirtualBones
from ..networks.checkpoint import Checkpoint
from ..networks.losses import BodyShape, collision_depth
from ..networks.network import Motion

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
    "table",
]

# Frames for which distances to the body are in memory at once.
_FRAMES_AT_ONCE = 64
_MM = 1e3  # from metres to millimetres
PARTS = ("low", "high", "overall")
Array = NDArray[np.float32]


@dataclasses.dataclass(frozen=True, eq=False)
class Answer:
    """A method's prediction for a clip: low and high part ``(F, V, 3)``, metres, to be added."""

    low: Array
    high: Array


Method = Callable[[Clip], Answer]


@dataclasses.dataclass(frozen=True)
class Score:
    """RMSE over vertices and frames and mean Hausdorff distance of vertices, mm, and STED."""

    rmse: float
    hausdorff: float
    sted: float


@dataclasses.dataclass(frozen=True, eq=False)
class Row:
    """Errors of one method.

    Attributes
    ----------
    name : str
    frames : int
    low, high, overall : Score
    per_class : dict
        Overall RMSE, mm, for each class of motion.
    per_vertex : (V,) float64
        Mean overall error, mm.
    inside : float
        Fraction of the vertices inside the body, over all frames.
    depth_mean, depth_max : float
        Their depth, mm.
    """

    name: str
    frames: int
    low: Score
    high: Score
    overall: Score
    per_class: dict[str, float]
    per_vertex: NDArray[np.float64]
    inside: float
    depth_mean: float
    depth_max: float

    def as_dict(self) -> dict[str, Any]:
        """Numbers and lists, for JSON."""
        plain = dataclasses.asdict(self)
        return plain | {"per_vertex": self.per_vertex.tolist()}


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
    """LBS with the fitted transforms, and the simulated detail: the bound for every network."""
    s = bones.skinning

    def answer(clip: Clip) -> Answer:
        fitted = bones.clip(clip.name)
        low = ssdr.skin(s.rest, s.joints, s.weights, fitted.transforms)
        return Answer(np.asarray(low, np.float32), fitted.read("high"))

    return answer


def evaluate(
    bones: VirtualBones,
    methods: Mapping[str, Method],
    names: Sequence[str],
    *,
    progress: Callable[[str, float], None] | None = None,
) -> list[Row]:
    """Score methods on clips that are not mirrored.

    Parameters
    ----------
    bones : VirtualBones
    methods : mapping from names to methods
    names : sequence of str
        Clips.
    progress : callable, optional
        Called with the method's name and the fraction that is done.

    Returns
    -------
    list of Row
        In the order of `methods`.
    """
    rows = []
    for m, (name, method) in enumerate(methods.items()):
        total = _Total(bones)
        for k, clip_name in enumerate(names):
            clip = bones.store.clip(clip_name)
            total.add(clip, method(clip))
            if progress:
                progress(name, (m + (k + 1) / len(names)) / len(methods))
        rows.append(total.row(name))
    return rows


class _Total:
    """Sums over clips: squared errors for RMSE, means over frames for the other figures."""

    def __init__(self, bones: VirtualBones) -> None:
        self.bones = bones
        self.frames = 0
        self.parts = {p: np.zeros(3) for p in PARTS}
        self.classes: dict[str, list[float]] = {}
        self.error = np.zeros(bones.store.n_vertices)
        self.body = BodyShape(bones.store.body)
        self.inside, self.depth, self.deepest = 0, 0.0, 0.0

    def add(self, clip: Clip, answer: Answer) -> None:
        fitted = self.bones.clip(clip.name)
        low, high = fitted.read("low"), fitted.read("high")
        truth = low + high
        pairs = {
            "low": (low, answer.low),
            "high": (truth, low + answer.high),
            "overall": (truth, answer.low + answer.high),
        }
        faces, count = self.bones.store.faces, clip.n_frames
        for part, (reference, other) in pairs.items():
            c = compare(reference, other, faces, hausdorff_options={"surface": False})
            assert c.hausdorff is not None
            assert c.sted is not None
            figures = [c.rmse**2, c.hausdorff.vertex_mean, c.sted.value]
            self.parts[part] += count * np.array(figures)
            if part == "overall":
                self._by_class(clip, c.distances.per_frame)
        self.frames += count
        answered = answer.low + answer.high
        self.error += np.linalg.norm(answered - truth, axis=-1).astype(np.float64).sum(axis=0)
        self._penetration(clip, answered)

    def _by_class(self, clip: Clip, per_frame: Any) -> None:
        for label in np.unique(clip.classes):
            chosen = np.asarray(per_frame)[clip.classes == label]
            slot = self.classes.setdefault(CLASSES[int(label)], [0.0, 0.0])
            slot[0] += float((chosen**2).sum())
            slot[1] += len(chosen)

    def _penetration(self, clip: Clip, vertices: Array) -> None:
        with torch.no_grad():
            for i in range(0, len(vertices), _FRAMES_AT_ONCE):
                part = slice(i, i + _FRAMES_AT_ONCE)
                joints = torch.from_numpy(np.asarray(clip.joints[part], np.float32))
                body, normals = self.body(joints)
                depth = collision_depth(torch.from_numpy(vertices[part]), body, normals)
                self.inside += int((depth > 0).sum())
                self.depth += float(depth.double().sum())
                self.deepest = max(self.deepest, float(depth.max()))

    def row(self, name: str) -> Row:
        n = max(self.frames, 1)
        scores = {}
        for part, sums in self.parts.items():
            square, hausdorff, sted = sums / n
            scores[part] = Score(_MM * math.sqrt(square), _MM * float(hausdorff), float(sted))
        return Row(
            name,
            self.frames,
            **scores,
            per_class={k: _MM * math.sqrt(s / c) for k, (s, c) in sorted(self.classes.items())},
            per_vertex=_MM * self.error / n,
            inside=self.inside / (n * self.bones.store.n_vertices),
            depth_mean=_MM * self.depth / max(self.inside, 1),
            depth_max=_MM * self.deepest,
        )


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
        For each class of motion and for "all": RMSE / √2 ``low`` and ``overall``, and the number of
        ``frames``; empty without pairs.
    """
    sums: dict[str, NDArray[np.float64]] = {}
    smoother = bones.smoother()
    for first, second in bones.store.pairs() if pairs is None else pairs:
        a, b = bones.store.clip(first), bones.store.clip(second)
        frames = min(a.n_frames, b.n_frames)
        gap = a.sequence.frames(slice(0, frames)) - b.sequence.frames(slice(0, frames))
        # Smoothing is linear: the difference of the low parts is the smoothed difference.
        low = np.asarray(smoother.smooth(gap))
        squares = [(x.astype(np.float64) ** 2).sum(-1).mean(-1) for x in (low, gap)]
        for label in [-1, *np.unique(a.classes[:frames])]:
            chosen = a.classes[:frames] == label if label >= 0 else slice(None)
            key = CLASSES[int(label)] if label >= 0 else "all"
            part = np.array([squares[0][chosen].sum(), squares[1][chosen].sum(), 0.0])
            part[2] = len(squares[0][chosen])
            sums[key] = sums.get(key, np.zeros(3)) + part
    return {
        key: {
            "low": _MM * math.sqrt(s[0] / s[2] / 2),
            "overall": _MM * math.sqrt(s[1] / s[2] / 2),
            "frames": float(s[2]),
        }
        for key, s in sums.items()
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


def table(rows: Sequence[Row]) -> str:
    """The paper's table as text: mm, mm and STED for low, high and overall."""
    width = max([8, *(len(r.name) for r in rows)])
    head = f"{'':<{width}}" + "".join(
        f" | {p + ' RMSE':>12} {'Hausd.':>7} {'STED':>7}" for p in PARTS
    )
    lines = [head + " | inside", "-" * (len(head) + 9)]
    for r in rows:
        cells = [getattr(r, p) for p in PARTS]
        text = "".join(f" | {c.rmse:12.2f} {c.hausdorff:7.1f} {c.sted:7.4f}" for c in cells)
        lines.append(f"{r.name:<{width}}{text} | {100 * r.inside:5.2f}%")
    return "\n".join(lines)


def _detail(motion: Motion) -> Array:
    if motion.high is None:
        return np.zeros(motion.low.shape, np.float32)
    turned = motion.high.double().cpu().numpy() @ motion.frame[..., :3].transpose(0, 2, 1)
    return np.asarray(turned, np.float32)
