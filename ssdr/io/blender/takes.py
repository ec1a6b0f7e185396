"""Reading of the takes of a file that Blender has loaded: their actions, frames and frame rates.

This module runs inside Blender beside ``script.py`` and needs only NumPy and Blender.
"""

import dataclasses
import importlib
import math
from typing import Any

import bpy
import numpy as np

frame_rates: Any = importlib.import_module("frame_rates")
_LONGEST_NAME = 255 if bpy.app.version >= (5, 0, 0) else 63  # bytes, of an object or action
_LONGEST_BONE = 63
Pairs = list[tuple[Any, Any]]  # objects or shape keys, each with the action that moves it


@dataclasses.dataclass(frozen=True)
class Timeline:
    """The `count` frames of a take, from `first` on Blender's timeline in steps of `step`.

    `missed` (N,) holds the times, in frames, of the keys that lie on no frame.
    """

    first: float
    step: float
    count: int
    fps: float
    missed: Any

    def go(self, frame: float) -> Any:
        """Show a frame of the take, counted from 0, and return Blender's evaluated scene."""
        time = self.first + frame * self.step
        whole = math.floor(time + 1e-6)
        part = min(max(time - whole, 0.0), 0.999999)
        bpy.context.scene.frame_set(whole, subframe=part if part > 1e-6 else 0.0)
        return bpy.context.evaluated_depsgraph_get()


def stated_rate() -> float:
    """Frame rate of the scene, corrected for Blender's rounding to float32."""
    render = bpy.context.scene.render
    rate = float(render.fps / render.fps_base)
    # the second is a television rate, such as 30 / 1.001
    simple = (round(rate, 3), round(rate * 1.001) / 1.001)
    return next((one for one in simple if abs(one - rate) <= 2e-7 * rate), rate)


def play(job: dict[str, Any], pairs: Pairs | None) -> Timeline:
    """Assign the actions of a take to its objects, and return the frames at which to sample it.

    `pairs` are the objects and actions; None if the file has no takes.
    """
    for item, action in pairs or []:
        item.animation_data.action = action
    scene, rate = bpy.context.scene, stated_rate()
    tempo = rate  # frames of Blender's timeline per second
    stamps = np.zeros(0)
    if job["path"].lower().endswith(".fbx"):
        tempo = float(scene.render.fps)  # its importer ignores fps_base when it places keys
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
        rate = frame_rates.frame_rate((stamps - first) / tempo, rate) or rate
    step = tempo / rate
    ticks, last = (stamps - first) / step, (last - first) / step
    frames = frame_rates.frames_between(ticks, 0.0, last, 1.0, asked=job["resample"])
    return Timeline(float(first), step, frames.count, rate, frames.missed)


def key_frames(pairs: Pairs) -> Any:
    """Frames of Blender's timeline at which the actions of a take have keys, ascending."""
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
    # Blender's frames are float32; those that differ only by its rounding are merged.
    return stamps[np.diff(stamps, prepend=-np.inf) > 1e-6 * np.maximum(1.0, np.abs(stamps))]


def pose() -> list[tuple[Any, Any]]:
    """Transforms of objects and bones, and values of shape keys, before any take is played.

    They are restored before each take, because a take need not set all of them.
    """
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
    """Name, cut to at most `most` bytes of UTF-8, as Blender does with long names."""
    return name.encode()[:most].decode("utf-8", "ignore")


def list_takes(path: str) -> list[tuple[str, Pairs]]:
    """Name of each take of a loaded FBX or glTF file, with its pairs of object and action."""
    moved = [o for o in (*bpy.data.objects, *bpy.data.shape_keys) if o.animation_data]
    tracks: dict[str, Pairs] = {}
    if path.lower().endswith((".glb", ".gltf")):
        for item in moved:
            for track in item.animation_data.nla_tracks:
                tracks.setdefault(track.name, []).append((item, track.strips[0].action))
    for name, layer in animation_stacks(path):
        tail = name if layer == name else f"{name}|{layer}"
        # Blender's importer gives actions these names, cut to the greatest length.
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
    """Objects of an FBX file and links (child id, parent id); both are empty for other files."""
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
    """Name of each animation stack of an FBX file and name of its first layer, in file order.

    A stack without a layer gets its own name for both.
    """
    objects, links = parts_of(path)
    layers = {e.props[0]: name_of(e) for e in objects if e.id == b"AnimationLayer"}
    found = []
    for stack in [e for e in objects if e.id == b"AnimationStack"]:
        own = [layers[a] for a, b in links if b == stack.props[0] and a in layers]
        found.append((name_of(stack), own[0] if own else name_of(stack)))
    return found


def skin_bone_names(path: str) -> set[str]:
    """Names of all bones that a skin of an FBX file lists, even those without weights."""
    objects, links = parts_of(path)
    models = {e.props[0]: name_of(e) for e in objects if e.id == b"Model"}
    clusters = {e.props[0] for e in objects if e.id == b"Deformer" and e.props[-1] == b"Cluster"}
    return {shortened(models[a], _LONGEST_BONE) for a, b in links if a in models and b in clusters}
