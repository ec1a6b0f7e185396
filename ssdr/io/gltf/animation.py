"""glTF's animations, sampled at the frames of a clip, and the nodes that they move."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.clips import Clip, readable, unique_names
from ...model.rigid import matrix_from_quaternion
from ..file_errors import check
from ..frame_rates import DEFAULT_RATE, Frames, frame_rate, frames_between, off_frames
from ..played_model import interpolate_quaternions
from .document import Document
from .numbering import pointer_of

_KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
_KINDS["visible"] = "SCALAR"
_VISIBILITY = "KHR_node_visibility"
_VISIBLE = re.compile(rf"/nodes/(\d+)/extensions/{_VISIBILITY}/visible")
_AT_REST = {
    "translation": [0.0, 0.0, 0.0],
    "rotation": [0.0, 0.0, 0.0, 1.0],
    "scale": [1.0, 1.0, 1.0],
}
_Channel = tuple[NDArray[np.float64], NDArray[np.float64], str]  # key times, values, interpolation


@dataclasses.dataclass(frozen=True, eq=False)
class Animation:
    """An animation of a glTF file, and the frames at which to sample it.

    Attributes
    ----------
    name : str
    frames : Frames
        In seconds.
    times : (F,) float64
        Time of each frame.
    channels : dict
        Key times, values and interpolation of each channel, by the index of its node and its path
        ("translation", "rotation", "scale", "weights" or "visible").
    """

    name: str
    frames: Frames
    times: NDArray[np.float64]
    channels: dict[tuple[int, str], _Channel]

    @property
    def clip(self) -> Clip:
        return Clip(self.name, 0, self.frames.count, self.frames.rate)

    def sample(self, node: int, path: str) -> NDArray[np.float64] | None:
        """Values ``(F, width)`` of a node's property `path` at all frames.

        None if no channel animates the property.
        """
        if (node, path) not in self.channels:
            return None
        return _interpolate(*self.channels[node, path], self.times, path == "rotation")


def mesh_name(document: Document) -> str:
    """Name that all meshes of the file share, or else the name of the file without suffix."""
    names = {readable(mesh.get("name", "")) for mesh in document.items("meshes")}
    return (names.pop() if len(names) == 1 else "") or document.path.stem


def animation_names(document: Document) -> tuple[str, ...]:
    """Unique names of the file's animations, or only that of `mesh_name` if there are none."""
    found = [animation.get("name") or "" for animation in document.items("animations")]
    names = [readable(name) or f"animation_{k}" for k, name in enumerate(found)]
    return unique_names(names or [mesh_name(document)])


def read_animations(document: Document, fps: float | None = None) -> list[Animation]:
    """All animations in the order of the file, or one of a single still frame if it has none."""
    names = animation_names(document)
    return [read_animation(document, k, fps, name) for k, name in enumerate(names)]


def read_animation(document: Document, index: int, fps: float | None, name: str) -> Animation:
    """Animation with the index `index` in the file, with frames at its own rate or at `fps`.

    `name` is its entry of `animation_names`.
    """
    if not document.items("animations"):
        return still_frame(name, fps)
    item = document.items("animations")[index]
    channels = _channels(document, item)
    stamps = np.unique(np.concatenate([np.zeros(0), *(keys for keys, _, _ in channels.values())]))
    first, last = (float(stamps[0]), float(stamps[-1])) if len(stamps) else (0.0, 0.0)
    stated = item.get("extras", {}).get("ssdr", {})
    rate = fps or frame_rate(stamps) or DEFAULT_RATE
    frames = frames_between(stamps, first, last, rate, asked=fps is not None)
    if "fps" in stated and "frames" in stated:
        own = document.number(stated["fps"], "fps")
        check(own > 0, f"fps is {own}")
        if fps in (None, own):
            count = document.integer(stated, "frames", f"the clip {name}")
            first = document.number(stated.get("start", 0.0), "start")
            frames = Frames(first, own, count, off_frames(stamps, first, own, count))
    what = f"{frames.count} frames at {frames.rate:g} per second"
    document.budget.spend(24 * frames.count, what)
    with np.errstate(over="ignore"):
        times = frames.times
    check(np.isfinite(times[-1:]).all(), f"{what} from {frames.first:g} s on")
    return Animation(name, frames, times, channels)


def still_frame(name: str = "", fps: float | None = None) -> Animation:
    """Animation of one frame in which nothing moves."""
    frames = Frames(0.0, fps or DEFAULT_RATE, 1, np.zeros(0))
    return Animation(name, frames, frames.times, {})


def animated(target: dict[str, Any]) -> tuple[int, str] | None:
    """Node and path that a channel animates; None if it moves and hides no vertex."""
    if seen := _VISIBLE.fullmatch(pointer_of(target)):
        return int(seen[1]), "visible"
    node, path = target.get("node"), target.get("path")
    return (node, path) if node is not None and path in _KINDS else None


def every_track(document: Document) -> set[tuple[int, str]]:
    """Nodes and paths that some channel of the file animates."""
    items = document.items("animations")
    found = [animated(one["target"]) for item in items for one in item.get("channels", [])]
    return {track for track in found if track is not None}


def _channels(document: Document, item: dict[str, Any]) -> dict[tuple[int, str], _Channel]:
    channels = {}
    for channel in item.get("channels", []):
        if (moved := animated(channel["target"])) is None:
            continue
        path = moved[1]
        sampler = item["samplers"][document.integer(channel, "sampler", "a channel", 0)]
        how = sampler.get("interpolation", "LINEAR")
        check(how in ("LINEAR", "STEP", "CUBICSPLINE"), f"the interpolation {how!r}")
        keys = document.accessor(sampler["input"], "SCALAR", "key times")
        rising = keys[0] >= 0 and (np.diff(keys) > 0).all()
        check(rising, "key times do not rise from 0")
        values = document.accessor(sampler["output"], _KINDS[path], f"keys of {path}")
        rows = len(keys) * (3 if how == "CUBICSPLINE" else 1)
        fits = len(values) == rows if path != "weights" else values.size % rows == 0
        check(fits, f"{len(values)} keys of {path} for {rows}")
        channels[moved] = keys, values.reshape(rows, -1), how
    return channels


def _interpolate(
    keys: NDArray[np.float64],
    values: NDArray[np.float64],
    how: str,
    times: NDArray[np.float64],
    rotation: bool,
) -> NDArray[np.float64]:
    # Key times are float32, and their rounding must not put a frame just before its own key.
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
        return values[np.where(share == 1, right, left)]
    if how == "LINEAR" and rotation:
        return interpolate_quaternions(values[left], values[right], share)
    u, d = share[:, None], span[:, None]
    if how == "LINEAR":
        return np.asarray((1 - u) * values[left] + u * values[right])
    # Hermite spline: a key has three rows, its in-tangent, its value and its out-tangent.
    return np.asarray(
        (2 * u**3 - 3 * u**2 + 1) * values[3 * left + 1]
        + d * (u**3 - 2 * u**2 + u) * values[3 * left + 2]
        + (3 * u**2 - 2 * u**3) * values[3 * right + 1]
        + d * (u**3 - u**2) * values[3 * right]
    )


def descendants(nodes: Sequence[dict[str, Any]], roots: Iterable[int]) -> list[int]:
    """Indices of the nodes `roots` and of all nodes below them, each before its children."""
    order: dict[int, None] = {}
    stack = list(roots)[::-1]
    while stack:
        node = stack.pop()
        if node not in order:
            order[node] = None
            stack.extend(nodes[node].get("children", [])[::-1])
    return list(order)


class Nodes:
    """The nodes of a file, with their transforms over the frames of an animation.

    Attributes
    ----------
    items : list of dict
        JSON of each node.
    order : list of int
        Indices of all nodes, each before its children.
    shown : list of int
        Indices of the nodes in the file's default scene; all nodes if the file has no scenes.
    meshes, hidden : list of int
        Those of them that hold a mesh and are shown at some time, and those that never are.

    Raises
    ------
    FormatError
        If a node has two parents or is its own ancestor.
    """

    def __init__(self, document: Document, animation: Animation) -> None:
        self.document, self.animation = document, animation
        self.items = document.items("nodes")
        self._cache: dict[int, NDArray[np.float64]] = {}
        self._reserved: set[int] = set()
        self._parent: dict[int, int] = {}
        for parent, node in enumerate(self.items):
            for child in node.get("children", []):
                check(child not in self._parent, f"node {child} has two parents")
                self._parent[child] = parent
        every = set(range(len(self.items)))
        self.order = descendants(self.items, sorted(every - self._parent.keys()))
        if len(self.order) < len(every):
            node = min(every.difference(self.order))
            raise FormatError(f"node {node} is its own ancestor, or is below one that is")
        moved = {node for node, path in animation.channels if path in _AT_REST}
        self._moving: set[int] = set()
        for node in self.order:
            own = node in moved and "matrix" not in self.items[node]
            if own or self._parent.get(node) in self._moving:
                self._moving.add(node)
        self.shown = self.order
        if document.items("scenes"):
            scene = document.items("scenes")[document.json.get("scene", 0)]
            self.shown = descendants(self.items, scene.get("nodes", []))
        held = [node for node in self.shown if "mesh" in self.items[node]]
        keyed = {node for node, path in every_track(document) if path == "visible"}
        dark = {k for k in range(len(self.items)) if k not in keyed and not self._visible(k)}
        self.hidden = [node for node in held if dark.intersection([node, *self.ancestors(node)])]
        self.meshes = [node for node in held if node not in self.hidden]

    def _visible(self, node: int) -> bool:
        stated = self.items[node].get("extensions", {}).get(_VISIBILITY, {}).get("visible", True)
        check(isinstance(stated, bool), f"visible of node {node} is {repr(stated)[:200]}")
        return bool(stated)

    def visible(self, node: int) -> NDArray[np.bool_]:
        """Mask (F,) of the frames in which neither a node nor one above it is hidden."""
        shown = np.ones(len(self.animation.times), dtype=bool)
        for one in (node, *self.ancestors(node)):
            keys = self.animation.sample(one, "visible")
            shown &= self._visible(one) if keys is None else keys[:, 0] >= 0.5
        return shown

    def ancestors(self, node: int) -> Iterator[int]:
        """Yield the indices of the nodes above a node, the nearest first."""
        while node in self._parent:
            node = self._parent[node]
            yield node

    def reserve(self, nodes: Iterable[int]) -> None:
        """Charge the budget for the transforms of these nodes and of all above them, in advance.

        Raises
        ------
        FormatError
            If the file needs more memory than the limit.
        """
        n_frames, spent = len(self.animation.times), 0
        for node in nodes:
            above: int | None = node
            while above is not None and above not in self._reserved:
                self._reserved.add(above)
                spent += 128 * (n_frames if above in self._moving else 1)
                above = self._parent.get(above)
        what = f"{len(self._reserved)} nodes over {n_frames} frames"
        self.document.budget.spend(spent, what)

    def matrices(self, node: int) -> NDArray[np.float64]:
        """Global transforms ``(F, 4, 4)`` of a node, or ``(1, 4, 4)`` if it does not move."""
        self.reserve([node])
        chain = [node]
        while chain[-1] not in self._cache and chain[-1] in self._parent:
            chain.append(self._parent[chain[-1]])
        for k in reversed(chain):
            if k not in self._cache:
                local = self._local(k)
                above = self._cache.get(self._parent.get(k, -1), np.eye(4)[None])
                self._cache[k] = above @ local
        return self._cache[node]

    def _local(self, index: int) -> NDArray[np.float64]:
        node, document = self.items[index], self.document
        if "matrix" in node:
            matrix = document.numbers(node, "matrix", [0.0] * 16).reshape(1, 4, 4)
            return np.swapaxes(matrix, 1, 2)
        tracks = {}
        for path, default in _AT_REST.items():
            keys = self.animation.sample(index, path)
            tracks[path] = document.numbers(node, path, default)[None] if keys is None else keys
        result = np.zeros((max(len(values) for values in tracks.values()), 4, 4))
        result[:, :3, :3] = matrix_from_quaternion(tracks["rotation"]) * tracks["scale"][:, None]
        result[:, :3, 3] = tracks["translation"]
        result[:, 3, 3] = 1
        return result
