"""glTF's animations: key times and values, sampled at the frames of a clip."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip, readable, unique_names
from ..rig import frame_rate, interpolate_quaternions
from .document import Document

__all__ = ["Animation", "animation_names", "mesh_name", "read_animation", "read_animations"]

_KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
_Channel = tuple[NDArray[np.float64], NDArray[np.float64], str]  # key times, values, interpolation


@dataclasses.dataclass(frozen=True, eq=False)
class Animation:
    """One clip: the keys of each channel, and the frames at which to sample them."""

    name: str
    fps: float
    times: NDArray[np.float64]
    channels: dict[tuple[int, str], _Channel]

    @property
    def clip(self) -> Clip:
        return Clip(self.name, 0, len(self.times), self.fps)

    def sample(self, node: int, path: str) -> NDArray[np.float64] | None:
        """Values ``(F, width)`` of a channel; None where it is not animated."""
        if (node, path) not in self.channels:
            return None
        return _interpolate(*self.channels[node, path], self.times, path == "rotation")


def mesh_name(document: Document) -> str:
    """Name of the only mesh of the file, else of the file."""
    names = {readable(mesh.get("name", "")) for mesh in document.items("meshes")}
    return (names.pop() if len(names) == 1 else "") or document.path.stem


def animation_names(document: Document) -> tuple[str, ...]:
    """Names of the clips, all different; that of the mesh where nothing is animated."""
    found = [animation.get("name") or "" for animation in document.items("animations")]
    names = [readable(name) or f"animation_{k}" for k, name in enumerate(found)]
    return unique_names(names or [mesh_name(document)])


def read_animations(document: Document, fps: float | None = None) -> list[Animation]:
    """All clips in the order of the file; without any, one still frame."""
    return [read_animation(document, k, fps) for k in range(len(animation_names(document)))]


def read_animation(document: Document, index: int, fps: float | None = None) -> Animation:
    """The clip of that number, sampled at its own frame rate or at `fps`."""
    name = animation_names(document)[index]
    if not document.items("animations"):
        return Animation(name, fps or 24.0, np.zeros(1), {})
    item = document.items("animations")[index]
    channels = _channels(document, item)
    stamps = [keys for keys, _, _ in channels.values()]
    first = min((float(keys[0]) for keys in stamps), default=0.0)
    last = max((float(keys[-1]) for keys in stamps), default=0.0)
    stated = item.get("extras", {}).get("ssdr", {})
    rate = fps or frame_rate(stamps) or 24.0
    count = math.floor(min((last - first) * rate, 1e15) + 1e-3) + 1
    if "fps" in stated and "frames" in stated:
        own = float(document.numbers({"fps": [stated["fps"]]}, "fps", [24.0])[0])
        if own <= 0:
            raise document.error(f"fps is {own}")
        if fps in (None, own):
            rate, count = own, document.integer(stated, "frames", f"the clip {name}")
            first = float(document.numbers({"start": [stated.get("start", 0)]}, "start", [0.0])[0])
    document.budget.spend(8 * count, f"{count} frames at {rate:g} per second")
    return Animation(name, rate, first + np.arange(count) / rate, channels)


def _channels(document: Document, item: dict[str, Any]) -> dict[tuple[int, str], _Channel]:
    channels = {}
    for channel in item.get("channels", []):
        path, node = channel["target"].get("path"), channel["target"].get("node")
        if node is None or path not in _KINDS:
            continue  # KHR_animation_pointer and the like move no vertex
        sampler = item["samplers"][document.integer(channel, "sampler", "a channel", 0)]
        how = sampler.get("interpolation", "LINEAR")
        if how not in ("LINEAR", "STEP", "CUBICSPLINE"):
            raise document.error(f"the interpolation {how!r}")
        keys = document.accessor(sampler["input"], "SCALAR", "key times")
        if (np.diff(keys) <= 0).any() or keys[0] < 0:
            raise document.error("key times do not rise from 0")
        values = document.accessor(sampler["output"], _KINDS[path], f"keys of {path}")
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
        return values[np.where(share == 1, right, left)]
    if how == "LINEAR" and rotation:
        return interpolate_quaternions(values[left], values[right], share)
    u, d = share[:, None], span[:, None]
    if how == "LINEAR":
        return np.asarray((1 - u) * values[left] + u * values[right])
    # Hermite spline; in-tangent, value and out-tangent follow each other.
    return np.asarray(
        (2 * u**3 - 3 * u**2 + 1) * values[3 * left + 1]
        + d * (u**3 - 2 * u**2 + u) * values[3 * left + 2]
        + (3 * u**2 - 2 * u**3) * values[3 * right + 1]
        + d * (u**3 - u**2) * values[3 * right]
    )
