"""glTF's nodes and their animation, sampled at frames."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import pick, readable, unique_names
from ...rigid import matrix_from_quaternion
from ..registry import reading
from ..rig import MAX_BYTES, check_size, frame_rate, interpolate_quaternions
from .document import Document

__all__ = ["Animation", "World", "choose", "every", "title"]

_log = logging.getLogger(__name__)
_WIDTH = {"translation": 3, "rotation": 4, "scale": 3}
_PATHS = (*_WIDTH, "weights")


@dataclasses.dataclass(frozen=True, eq=False)
class Animation:
    """One clip: key times and values of each channel, and the frames at which to sample them."""

    name: str
    fps: float
    times: NDArray[np.float64]
    channels: dict[tuple[int, str], tuple[NDArray[np.float64], NDArray[np.float64], str]]

    @property
    def n_frames(self) -> int:
        return len(self.times)

    def sample(self, node: int, path: str) -> NDArray[np.float64] | None:
        """Values ``(F, width)`` of a channel, None where it is not animated."""
        if (node, path) not in self.channels:
            return None
        keys, values, how = self.channels[node, path]
        return _interpolate(keys, values, how, self.times, path == "rotation")


def title(document: Document) -> str:
    """What the mesh is called: as the file's one mesh, else as the file."""
    names = {readable(mesh.get("name", "")) for mesh in document.items("meshes")}
    return (names.pop() if len(names) == 1 else "") or document.path.stem


def names_of_clips(document: Document) -> tuple[str, ...]:
    """Names that differ; that of the mesh where nothing is animated."""
    clips = [document.item("animations", k) for k in range(len(document.items("animations")))]
    names = [readable(clip.get("name") or "") or f"animation_{k}" for k, clip in enumerate(clips)]
    return unique_names(names or [title(document)])


def every(document: Document, fps: float | None = None) -> list[Animation]:
    """All clips in the order of the file; without any, one still frame."""
    names = names_of_clips(document)
    return [_clip(document, k, name, fps) for k, name in enumerate(names)]


def _clip(document: Document, index: int, name: str, fps: float | None) -> Animation:
    if not document.items("animations"):
        return Animation(name, 24.0 if fps is None else fps, np.zeros(1), {})
    clip = document.item("animations", index)
    return _framed(document, name, clip, _channels(document, clip), fps)


def choose(
    document: Document, clip: int | str | None, fps: float | None, argument: str = "clip"
) -> Animation:
    """The clip of that number or name, the first by default.

    Raises
    ------
    InputError
        If there is no such clip.
    """
    with reading(document.path):
        names = names_of_clips(document)
    index = pick(names, clip, argument)
    if len(names) > 1:
        _log.info("%s: clip %r of %s", document.path, names[index], names)
    with reading(document.path):
        return _clip(document, index, names[index], fps)


def _framed(
    document: Document, name: str, clip: dict[str, Any], channels: dict[Any, Any], fps: float | None
) -> Animation:
    stamps = [keys for keys, _, _ in channels.values()]
    first = min((float(keys[0]) for keys in stamps), default=0.0)
    last = max((float(keys[-1]) for keys in stamps), default=0.0)
    own = document.dictionary(document.dictionary(clip, "extras"), "ssdr")
    rate, count = fps, None
    if "fps" in own and "frames" in own:
        stated = document.number(own["fps"], "fps")
        if stated <= 0:
            raise document.error(f"fps is {stated}")
        if fps is None or fps == stated:
            rate, first = stated, document.number(own.get("start", 0.0), "start")
            count = document.integer(own["frames"], "frames", least=1)
    if rate is None:
        rate = frame_rate(stamps) or 24.0
    if count is None:
        need = (last - first) * rate
        check_size(int(min(need, 1e15)), 1, MAX_BYTES)
        count = int(np.floor(need + 1e-3)) + 1
    check_size(count, 1, MAX_BYTES)
    return Animation(name, rate, first + np.arange(count) / rate, channels)


def _channels(document: Document, clip: dict[str, Any]) -> dict[Any, Any]:
    samplers = document.array(clip, "samplers")
    channels = {}
    for channel in document.array(clip, "channels"):
        target = document.dictionary(channel, "target")
        path = target.get("path")
        if "node" not in target or path not in _PATHS:
            continue  # KHR_animation_pointer and the like move no vertex
        node = document.integer(target["node"], "a node", len(document.items("nodes")))
        sampler = samplers[document.integer(channel.get("sampler"), "a sampler", len(samplers))]
        how = sampler.get("interpolation", "LINEAR")
        if how not in ("LINEAR", "STEP", "CUBICSPLINE"):
            raise document.error(f"the interpolation {how!r}")
        keys = document.accessor(sampler.get("input"), ("SCALAR",), "key times")
        if (np.diff(keys) <= 0).any() or keys[0] < 0:
            raise document.error("key times do not rise from 0")
        kind = {"rotation": "VEC4", "weights": "SCALAR"}.get(path, "VEC3")
        values = document.accessor(sampler.get("output"), (kind,), f"keys of {path}")
        rows = len(keys) * (3 if how == "CUBICSPLINE" else 1)
        if values.size % rows or (path != "weights" and len(values) != rows):
            raise document.error(f"{len(values)} keys of {path} for {rows}")
        channels[node, path] = keys, values.reshape(rows, -1), how
    return channels


def _interpolate(
    keys: NDArray[np.float64],
    values: NDArray[np.float64],
    how: str,
    times: NDArray[np.float64],
    rotation: bool,
) -> NDArray[np.float64]:
    # Key times are float32: a frame must not fall just before its own key.
    slack = 1e-6 * max(1.0, float(keys[-1]))
    right = np.clip(np.searchsorted(keys, times + slack, side="right"), 1, max(1, len(keys) - 1))
    left = right - 1
    if len(keys) == 1:
        right = left
    span = keys[right] - keys[left]
    share = np.clip((times - keys[left]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
    share = np.where(times + slack >= keys[right], 1.0, share)
    share = np.where(times - slack <= keys[left], 0.0, share)
    if how == "STEP":
        return values[np.where(times + slack >= keys[right], right, left)]
    if how == "LINEAR":
        if rotation:
            return interpolate_quaternions(values[left], values[right], share)
        return (1 - share[:, None]) * values[left] + share[:, None] * values[right]
    # Hermite spline; in-tangent, value and out-tangent stand behind each other.
    u, d = share[:, None], span[:, None]
    result: NDArray[np.float64] = (
        (2 * u**3 - 3 * u**2 + 1) * values[3 * left + 1]
        + d * (u**3 - 2 * u**2 + u) * values[3 * left + 2]
        + (3 * u**2 - 2 * u**3) * values[3 * right + 1]
        + d * (u**3 - u**2) * values[3 * right]
    )
    return result


class World:
    """Transforms of nodes over the frames of a clip."""

    def __init__(self, document: Document, clip: Animation) -> None:
        self.document = document
        self.clip = clip
        self.nodes = [document.item("nodes", k) for k in range(len(document.items("nodes")))]
        self._cache: dict[int, NDArray[np.float64]] = {}
        self._parent: dict[int, int] = {}
        for parent, node in enumerate(self.nodes):
            for child in document.array(node, "children"):
                child = document.integer(child, "a child node", len(self.nodes))
                if child in self._parent:
                    raise document.error(f"node {child} has two parents")
                self._parent[child] = parent
        self._refuse_cycles()
        self.visible = self._visible()

    def _refuse_cycles(self) -> None:
        done: set[int] = set()
        for start in range(len(self.nodes)):
            walk: set[int] = set()
            node: int | None = start
            while node is not None and node not in done:
                if node in walk:
                    raise self.document.error(f"node {node} is its own ancestor")
                walk.add(node)
                node = self._parent.get(node)
            done |= walk

    def _visible(self) -> list[int]:
        document = self.document
        if document.items("scenes"):
            scene = document.item("scenes", document.json.get("scene", 0))
            stack = list(reversed(document.array(scene, "nodes")))
        else:
            stack = [k for k in reversed(range(len(self.nodes))) if k not in self._parent]
        order: list[int] = []
        seen: set[int] = set()
        while stack:
            node = document.integer(stack.pop(), "a node of the scene", len(self.nodes))
            if node not in seen:
                seen.add(node)
                order.append(node)
                stack.extend(reversed(document.array(self.nodes[node], "children")))
        return order

    def above(self, node: int) -> Iterator[int]:
        """The ancestors of a node, the nearest first."""
        while node in self._parent:
            node = self._parent[node]
            yield node

    def matrices(self, node: int) -> NDArray[np.float64]:
        """Global transforms ``(F, 4, 4)`` of a node, or ``(1, 4, 4)`` of one that stands still."""
        chain = [node]
        while chain[-1] not in self._cache and chain[-1] in self._parent:
            chain.append(self._parent[chain[-1]])
        for k in reversed(chain):
            if k not in self._cache:
                local = self._local(k)
                above = self._parent.get(k)
                self._cache[k] = local if above is None else self._cache[above] @ local
        return self._cache[node]

    def _local(self, index: int) -> NDArray[np.float64]:
        node, document = self.nodes[index], self.document
        if "matrix" in node:
            matrix = document.numbers(node, "matrix", [0.0] * 16).reshape(1, 4, 4)
            return np.swapaxes(matrix, 1, 2)
        tracks = {}
        for path, default in (
            ("translation", [0.0, 0.0, 0.0]),
            ("rotation", [0.0, 0.0, 0.0, 1.0]),
            ("scale", [1.0, 1.0, 1.0]),
        ):
            values = self.clip.sample(index, path)
            if values is None:
                values = document.numbers(node, path, default)[None]
            if values.shape[1] != _WIDTH[path]:
                raise document.error(f"keys of {path} are {values.shape[1]} wide")
            tracks[path] = values
        count = max(len(values) for values in tracks.values())
        result = np.zeros((count, 4, 4))
        result[:, :3, :3] = matrix_from_quaternion(tracks["rotation"]) * tracks["scale"][:, None]
        result[:, :3, 3] = tracks["translation"]
        result[:, 3, 3] = 1
        return result
