"""Takes of a file that Blender has loaded: what acts on what, at which frames and how fast.

It runs inside Blender beside ``script.py`` and, like it, knows NumPy and Blender alone.
"""

import dataclasses
import fractions
import math
from typing import Any

import bpy
import numpy as np

_LONGEST_NAME = 255 if bpy.app.version >= (5, 0, 0) else 63  # bytes, of an object or action
_LONGEST_BONE = 63
_LARGEST_RATE = 32767  # what Blender's integer holds
_USUAL = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 100.0, 120.0)
Pairs = list[tuple[Any, Any]]


@dataclasses.dataclass(frozen=True)
class Clock:
    """Frames of a take on Blender's timeline: `count` from `first` on, `step` apart."""

    first: float
    step: float
    count: int
    fps: float

    def go(self, frame: int) -> Any:
        """Show a frame; the evaluated scene."""
        time = self.first + frame * self.step
        whole = math.floor(time + 1e-6)
        part = min(max(time - whole, 0.0), 0.999999)
        bpy.context.scene.frame_set(whole, subframe=part if part > 1e-6 else 0.0)
        return bpy.context.evaluated_depsgraph_get()


def set_rate(fps: float) -> None:
    """Frames per second of the scene: Blender divides an integer by a float32."""
    render, ratio = bpy.context.scene.render, fractions.Fraction(fps).limit_denominator(1001)
    if 0 < ratio.numerator <= _LARGEST_RATE and float(ratio) == fps:
        render.fps, render.fps_base = ratio.numerator, ratio.denominator
    else:
        render.fps = max(1, min(round(fps), _LARGEST_RATE))
        render.fps_base = render.fps / fps


def stated_rate() -> float:
    """Frames per second of the scene, without what float32 made of them."""
    render = bpy.context.scene.render
    rate = float(render.fps / render.fps_base)
    simple = (round(rate, 3), round(rate * 1.001) / 1.001)  # the latter those of television
    return next((one for one in simple if abs(one - rate) <= 2e-7 * rate), rate)


def is_fbx(path: str) -> bool:
    return path.lower().endswith(".fbx")


def clock(job: dict[str, Any], pairs: Pairs | None = None) -> Clock:
    """Where to sample a take, or what was loaded if it has none."""
    rate = stated_rate()
    tempo = rate  # frames of the timeline in a second
    stamps = np.zeros(0)
    if is_fbx(job["path"]):
        tempo = float(
            bpy.context.scene.render.fps
        )  # its importer forgets fps_base where it places keys
        stamps = key_frames(pairs or [])
        first, last = (stamps[0], stamps[-1]) if len(stamps) else (1.0, 1.0)
    else:
        first, last = frames_of(job["path"], pairs)
    if job["resample"]:
        rate = float(job["fps"])
    elif len(stamps):
        rate = rate_of((stamps - first) / tempo, rate)
    step = tempo / rate
    return Clock(float(first), step, math.floor((last - first) / step + 1e-3) + 1, rate)


def rate_of(seconds: Any, stated: float) -> float:
    """The rate on whose frames all keys lie: that of the file, of the closest keys, a usual one."""
    gaps = np.diff(seconds)
    closest = [round(1 / float(gaps.min()), 3)] if len(gaps) else []
    for rate in (stated, *closest, *_USUAL):
        ticks = seconds * rate
        if rate <= 1000 and np.abs(ticks - np.rint(ticks)).max() < 0.01:
            return float(rate)
    return stated


def frames_of(path: str, pairs: Pairs | None) -> tuple[int, int]:
    scene = bpy.context.scene
    if path.lower().endswith((".abc", ".usd", ".usda", ".usdc")):
        moving = bpy.data.cache_files or bpy.data.actions
        return (scene.frame_start, scene.frame_end) if moving else (scene.frame_start,) * 2
    actions = bpy.data.actions if pairs is None else [action for _, action in pairs if action]
    spans = [action.frame_range for action in actions] or [(1, 1)]
    return math.floor(min(s[0] for s in spans) + 1e-3), math.ceil(max(s[1] for s in spans) - 1e-3)


def key_frames(pairs: Pairs) -> Any:
    """Frames of Blender's timeline at which there are keys, each once."""
    found = [np.zeros(0, dtype=np.float32)]
    for action in {action for _, action in pairs if action}:
        for curve in curves(action):
            flat = np.empty(2 * len(curve.keyframe_points), dtype=np.float32)
            curve.keyframe_points.foreach_get("co", flat)
            found.append(flat[::2])
    stamps = np.unique(np.concatenate(found)).astype(np.float64)
    # Frames are float32: what differs by its rounding alone is one.
    return stamps[np.diff(stamps, prepend=-np.inf) > 1e-6 * np.maximum(1.0, np.abs(stamps))]


def curves(action: Any) -> list[Any]:
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    strips = [strip for layer in action.layers for strip in layer.strips]  # Blender 5
    return [curve for strip in strips for bag in strip.channelbags for curve in bag.fcurves]


def play(job: dict[str, Any], pairs: Pairs) -> Clock:
    """Let the actions of a take act; its frames."""
    for item, action in pairs:
        item.animation_data.action = action
    return clock(job, pairs)


def pose() -> list[tuple[Any, Any]]:
    """Where everything stands while nothing acts on it; a take need not move all of it."""
    found: list[tuple[Any, Any]] = [(o, o.matrix_basis.copy()) for o in bpy.data.objects]
    for item in bpy.data.objects:
        if item.type == "ARMATURE":
            found += [(bone, bone.matrix_basis.copy()) for bone in item.pose.bones]
    for keys in bpy.data.shape_keys:
        found += [(key, key.value) for key in keys.key_blocks]
    return found


def restore(values: list[tuple[Any, Any]]) -> None:
    for item, value in values:
        if isinstance(value, float):
            item.value = value
        else:
            item.matrix_basis = value


def cut(name: str, most: int = _LONGEST_NAME) -> str:
    return name.encode()[:most].decode("utf-8", "ignore")


def listed(path: str) -> list[tuple[str, Pairs]]:
    """The clips of an FBX or glTF file that was loaded: what acts on what."""
    moved = [o for o in (*bpy.data.objects, *bpy.data.shape_keys) if o.animation_data]
    if path.lower().endswith((".glb", ".gltf")):
        tracks: dict[str, Pairs] = {}
        for item in moved:
            for track in item.animation_data.nla_tracks:
                tracks.setdefault(track.name, []).append((item, track.strips[0].action))
        return list(tracks.items())
    if not is_fbx(path):
        return []
    found: list[tuple[str, Pairs]] = []
    for name, layer in stacks(path):
        tail = name if layer == name else f"{name}|{layer}"
        # as Blender's importer calls them, cut to what its names may have
        pairs = [(o, bpy.data.actions.get(cut(f"{o.name}|{tail}"))) for o in moved]
        if any(action for _, action in pairs):
            _refuse_shared(name, pairs, found)
            names = [other for other, _ in found]
            known = [name, *(f"{name}_{k}" for k in range(1, len(names) + 1))]
            found.append((next(n for n in known if n not in names), pairs))
    return found


def _refuse_shared(name: str, pairs: Pairs, found: list[tuple[str, Pairs]]) -> None:
    actions = {action for _, action in pairs if action}
    for other, earlier in found:
        if any(action in actions for _, action in earlier):
            raise ValueError(
                f"takes that Blender can tell apart were expected: {other!r} and {name!r} have "
                f"one name there, of {_LONGEST_NAME} bytes with that of the object"
            )


def parts_of(path: str) -> tuple[list[Any], list[Any]]:
    """Objects of an FBX file and the links between them."""
    from io_scene_fbx import parse_fbx

    parts = {e.id: e for e in parse_fbx.parse(path)[0].elems}
    objects = getattr(parts.get(b"Objects"), "elems", [])
    links = getattr(parts.get(b"Connections"), "elems", [])
    return objects, [e.props[1:3] for e in links if len(e.props) > 2]


def called(element: Any) -> str:
    return str(element.props[1].split(b"\0")[0].decode("utf-8", "replace"))


def stacks(path: str) -> list[tuple[str, str]]:
    """Names of the animation stacks and their layers in an FBX file, in its order."""
    objects, links = parts_of(path)
    layers = {e.props[0]: called(e) for e in objects if e.id == b"AnimationLayer"}
    return [
        (called(e), next((layers[a] for a, b in links if b == e.props[0] and a in layers), name))
        for e in objects
        if e.id == b"AnimationStack"
        for name in [called(e)]
    ]


def clustered(path: str) -> set[str]:
    """Names of the bones that a skin of an FBX file counts as its own, weights or none."""
    if not is_fbx(path):
        return set()
    objects, links = parts_of(path)
    models = {e.props[0]: called(e) for e in objects if e.id == b"Model"}
    clusters = {e.props[0] for e in objects if e.id == b"Deformer" and e.props[-1] == b"Cluster"}
    return {cut(models[a], _LONGEST_BONE) for a, b in links if a in models and b in clusters}
