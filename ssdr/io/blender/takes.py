"""Takes of a file that Blender has loaded: objects and their actions, frames and rates.

It runs inside Blender beside ``script.py`` and, like it, needs NumPy and Blender alone.
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
Pairs = list[tuple[Any, Any]]  # objects or shape keys, each with the action that moves it


@dataclasses.dataclass(frozen=True)
class Timeline:
    """Frames of a take on Blender's timeline: `count` from `first` on, `step` apart."""

    first: float
    step: float
    count: int
    fps: float

    def go(self, frame: int) -> Any:
        """Show a frame and return the evaluated scene."""
        time = self.first + frame * self.step
        whole = math.floor(time + 1e-6)
        part = min(max(time - whole, 0.0), 0.999999)
        bpy.context.scene.frame_set(whole, subframe=part if part > 1e-6 else 0.0)
        return bpy.context.evaluated_depsgraph_get()


def set_rate(fps: float) -> None:
    """Set the frames per second of the scene, which Blender stores as an integer over a float32."""
    render, ratio = bpy.context.scene.render, fractions.Fraction(fps).limit_denominator(1001)
    if 0 < ratio.numerator <= _LARGEST_RATE and float(ratio) == fps:
        render.fps, render.fps_base = ratio.numerator, ratio.denominator
    else:
        render.fps = max(1, min(round(fps), _LARGEST_RATE))
        render.fps_base = render.fps / fps


def stated_rate() -> float:
    """Frames per second of the scene, without the rounding of float32."""
    render = bpy.context.scene.render
    rate = float(render.fps / render.fps_base)
    simple = (round(rate, 3), round(rate * 1.001) / 1.001)  # the second is a rate of television
    return next((one for one in simple if abs(one - rate) <= 2e-7 * rate), rate)


def play(job: dict[str, Any], pairs: Pairs | None) -> Timeline:
    """Assign the actions of a take, if there is one, and return the frames at which to sample."""
    for item, action in pairs or []:
        item.animation_data.action = action
    scene, rate = bpy.context.scene, stated_rate()
    tempo = rate  # frames of the timeline in a second
    stamps = np.zeros(0)
    if job["path"].lower().endswith(".fbx"):
        tempo = float(scene.render.fps)  # its importer forgets fps_base where it places keys
        stamps = key_frames(pairs or [])
        first, last = (stamps[0], stamps[-1]) if len(stamps) else (1.0, 1.0)
    elif job["path"].lower().endswith((".glb", ".gltf")):
        actions = bpy.data.actions if pairs is None else [action for _, action in pairs]
        spans = np.array([action.frame_range for action in actions] or [(1, 1)])
        first, last = math.floor(spans.min() + 1e-3), math.ceil(spans.max() - 1e-3)
    else:
        moves = bpy.data.cache_files or bpy.data.actions
        first, last = scene.frame_start, scene.frame_end if moves else scene.frame_start
    if job["resample"]:
        rate = float(job["fps"])
    elif len(stamps):
        rate = rate_of((stamps - first) / tempo, rate)
    step = tempo / rate
    return Timeline(float(first), step, math.floor((last - first) / step + 1e-3) + 1, rate)


def rate_of(seconds: Any, stated: float) -> float:
    """Rate on whose frames all keys lie: the file's, that of the closest keys, or a usual one."""
    gaps = np.diff(seconds)
    closest = [round(1 / float(gaps.min()), 3)] if len(gaps) else []
    for rate in (stated, *closest, *_USUAL):
        ticks = seconds * rate
        if rate <= 1000 and np.abs(ticks - np.rint(ticks)).max() < 0.01:
            return float(rate)
    return stated


def key_frames(pairs: Pairs) -> Any:
    """Frames of Blender's timeline that have keys, each once."""
    found = [np.zeros(0, dtype=np.float32)]
    for action in {action for _, action in pairs if action}:
        bags = [action]
        if not hasattr(action, "fcurves"):  # Blender 5
            strips = [strip for layer in action.layers for strip in layer.strips]
            bags = [bag for strip in strips for bag in strip.channelbags]
        for curve in [curve for bag in bags for curve in bag.fcurves]:
            flat = np.empty(2 * len(curve.keyframe_points), dtype=np.float32)
            curve.keyframe_points.foreach_get("co", flat)
            found.append(flat[::2])
    stamps = np.unique(np.concatenate(found)).astype(np.float64)
    # Frames are float32: what differs by its rounding alone is one.
    return stamps[np.diff(stamps, prepend=-np.inf) > 1e-6 * np.maximum(1.0, np.abs(stamps))]


def pose() -> list[tuple[Any, Any]]:
    """Transforms and values without any action; a take may leave some of them as they are."""
    found: list[tuple[Any, Any]] = [(o, o.matrix_basis.copy()) for o in bpy.data.objects]
    for item in bpy.data.objects:
        if item.type == "ARMATURE":
            found += [(bone, bone.matrix_basis.copy()) for bone in item.pose.bones]
    for keys in bpy.data.shape_keys:
        found += [(key, key.value) for key in keys.key_blocks]
    return found


def restore(values: list[tuple[Any, Any]]) -> None:
    for item, value in values:
        setattr(item, "value" if isinstance(value, float) else "matrix_basis", value)


def shortened(name: str, most: int = _LONGEST_NAME) -> str:
    """Name, shortened to the length that Blender allows."""
    return name.encode()[:most].decode("utf-8", "ignore")


def list_takes(path: str) -> list[tuple[str, Pairs]]:
    """Takes of a loaded FBX or glTF file: their names, and pairs of objects and actions."""
    moved = [o for o in (*bpy.data.objects, *bpy.data.shape_keys) if o.animation_data]
    tracks: dict[str, Pairs] = {}
    if path.lower().endswith((".glb", ".gltf")):
        for item in moved:
            for track in item.animation_data.nla_tracks:
                tracks.setdefault(track.name, []).append((item, track.strips[0].action))
    for name, layer in animation_stacks(path):
        tail = name if layer == name else f"{name}|{layer}"
        # as Blender's importer calls them, cut to what its names may have
        pairs = [(o, bpy.data.actions.get(shortened(f"{o.name}|{tail}"))) for o in moved]
        actions = {action for _, action in pairs if action}
        for other, earlier in tracks.items():
            if actions.intersection(action for _, action in earlier):
                raise ValueError(
                    f"takes that Blender can tell apart were expected: {other!r} and {name!r} "
                    f"have one name there, of {_LONGEST_NAME} bytes with that of the object"
                )
        if actions:
            known = [name, *(f"{name}_{k}" for k in range(1, len(tracks) + 1))]
            tracks[next(n for n in known if n not in tracks)] = pairs
    return list(tracks.items())


def parts_of(path: str) -> tuple[list[Any], list[Any]]:
    """Objects of an FBX file and the links between them; none of another file."""
    if not path.lower().endswith(".fbx"):
        return [], []
    from io_scene_fbx import parse_fbx

    parts = {e.id: e for e in parse_fbx.parse(path)[0].elems}
    objects = getattr(parts.get(b"Objects"), "elems", [])
    links = getattr(parts.get(b"Connections"), "elems", [])
    return objects, [e.props[1:3] for e in links if len(e.props) > 2]


def name_of(element: Any) -> str:
    return str(element.props[1].split(b"\0")[0].decode("utf-8", "replace"))


def animation_stacks(path: str) -> list[tuple[str, str]]:
    """Names of the animation stacks and their first layers in an FBX file, in its order."""
    objects, links = parts_of(path)
    layers = {e.props[0]: name_of(e) for e in objects if e.id == b"AnimationLayer"}
    found = []
    for stack in [e for e in objects if e.id == b"AnimationStack"]:
        own = [layers[a] for a, b in links if b == stack.props[0] and a in layers]
        found.append((name_of(stack), own[0] if own else name_of(stack)))
    return found


def skin_bone_names(path: str) -> set[str]:
    """Names of the bones that a skin of an FBX file lists, with or without weights."""
    objects, links = parts_of(path)
    models = {e.props[0]: name_of(e) for e in objects if e.id == b"Model"}
    clusters = {e.props[0] for e in objects if e.id == b"Deformer" and e.props[-1] == b"Cluster"}
    return {shortened(models[a], _LONGEST_BONE) for a, b in links if a in models and b in clusters}
