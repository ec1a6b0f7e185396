"""Vertices of a mesh object in every frame, as Blender evaluates them."""

import contextlib
import dataclasses
from collections.abc import Generator, Iterator
from typing import Any, NamedTuple

import bpy
import numpy as np
from mathutils import Matrix

from .process import AddonError

# Modifiers that move vertices; the bones replace all modifiers up to the last of these.
_MOVING = {
    *("ARMATURE", "CAST", "CORRECTIVE_SMOOTH", "CURVE", "DISPLACE", "HOOK", "LAPLACIANDEFORM"),
    *("LAPLACIANSMOOTH", "LATTICE", "MESH_DEFORM", "SHRINKWRAP", "SIMPLE_DEFORM", "SMOOTH"),
    *("SURFACE_DEFORM", "WARP", "WAVE", "CLOTH", "EXPLODE", "FLUID", "OCEAN", "SOFT_BODY"),
    *("BUILD", "MESH_CACHE", "MESH_SEQUENCE_CACHE", "NODES"),
}


class FrameRange(NamedTuple):
    """A part of the timeline: its first frame, and the frame after its last."""

    name: str
    first: int
    stop: int


def marked(scene: Any) -> list[FrameRange]:
    """Clips named by the scene's markers, each from its marker up to the next."""
    start, stop = scene.frame_start, scene.frame_end + 1
    marks = sorted((m.frame, m.name) for m in scene.timeline_markers if start <= m.frame < stop)
    ends = [*(frame for frame, _ in marks[1:]), stop]
    clips = [FrameRange(name, frame, end) for (frame, name), end in zip(marks, ends, strict=False)]
    if not clips or any(stop - first < 2 for _, first, stop in clips):
        raise AddonError(
            f"Set a marker where each clip starts, between the frames {start} and {stop - 1} of "
            "the scene and two or more frames before the next, or switch Clips from markers off"
        )
    return clips


@dataclasses.dataclass
class SampledObject:
    """An animation, relative to where the object is in the first frame.

    Attributes
    ----------
    vertices : (F, V, 3) float32 array
    faces : (T, 3) int array
    mesh : Mesh
        The evaluated mesh of the first frame, with its materials and layers.
    place : Matrix
        Transform from the sample's coordinates to the world, without shear.
    moves : bool
        Whether the object itself moves.
    """

    vertices: Any
    faces: Any
    mesh: Any
    place: Matrix
    moves: bool


def replaced(source: Any) -> list[Any]:
    """Modifiers that the bones replace: all up to the last one that moves vertices."""
    count = 0
    for number, one in enumerate(source.modifiers, 1):
        if one.type in _MOVING and one.show_viewport and not one.use_pin_to_last:
            count = number
    return list(source.modifiers)[:count]


@contextlib.contextmanager
def without_rest(source: Any) -> Iterator[None]:
    """Context in which the modifiers that the bones do not replace are switched off."""
    behind = list(source.modifiers)[len(replaced(source)) :]
    shown = [one for one in behind if one.show_viewport]
    for one in shown:
        one.show_viewport = False
    try:
        yield
    finally:
        for one in shown:
            one.show_viewport = True


@contextlib.contextmanager
def frame_kept(scene: Any, *, simulated: bool = False) -> Iterator[None]:
    """Context that restores the scene's current frame at its end.

    Blender discards a simulation that is not baked when a modifier is switched.  If the object is
    `simulated`, all frames up to the current one are therefore played again.
    """
    frame, part = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        for number in range(scene.frame_start, frame) if simulated else ():
            scene.frame_set(number)
        scene.frame_set(frame, subframe=part)


def check(source: Any) -> None:
    """Raise an AddonError if an object cannot be sampled."""
    if source is None:
        raise AddonError("Select a mesh object first: none is active")
    if source.type != "MESH":
        raise AddonError(f"Select a mesh object: {source.name} is of type {source.type.lower()}")
    if not source.visible_get():
        raise AddonError(f"{source.name} is hidden: show it, so that Blender evaluates it")
    if source.library or source.override_library:
        raise AddonError(f"{source.name} is linked from another file: make it local first")


def sample(
    context: Any, source: Any, first: int
) -> Generator[tuple[float, str], None, SampledObject]:
    """Play the frames of the scene, yield the fraction that is done, and return the sample.

    Frames before the `first` are played, since simulations need them, but not kept.
    """
    scene, frames, worlds, kept = context.scene, [], [], None
    simulated = any(one.type in ("CLOTH", "SOFT_BODY") for one in source.modifiers)
    try:
        with frame_kept(scene, simulated=simulated), without_rest(source):
            for number in range(scene.frame_start, scene.frame_end + 1):
                scene.frame_set(number)
                if number >= first:
                    graph = context.evaluated_depsgraph_get()
                    shown = source.evaluated_get(graph)
                    worlds.append(shown.matrix_world.copy())
                    kept = kept or bpy.data.meshes.new_from_object(
                        shown, preserve_all_data_layers=True, depsgraph=graph
                    )
                    frames.append(_points(shown))
                    if len(frames[-1]) != len(frames[0]):
                        raise AddonError(
                            f"{source.name} has {len(frames[0])} vertices in frame {first} and "
                            f"{len(frames[-1])} in frame {number}: their number must stay the same"
                        )
                yield len(frames) / (scene.frame_end + 1 - first), "reading the frames"
        place = Matrix.LocRotScale(*worlds[0].decompose())
        if not abs(place.determinant()) > 0:
            raise AddonError(f"{source.name} has the scale 0 in frame {first}")
        to_place = np.linalg.inv(np.array(place)) @ np.array(worlds)
        vertices = np.stack(frames) @ to_place[:, :3, :3].swapaxes(1, 2) + to_place[:, None, :3, 3]
        vertices = vertices.astype(np.float32)
        if (vertices == vertices[0]).all():
            raise AddonError(
                f"{source.name} does not move between the frames {first} and {scene.frame_end} of "
                "the scene"
            )
    except BaseException:
        if kept is not None:
            bpy.data.meshes.remove(kept)
        raise
    kept.calc_loop_triangles()
    faces = np.empty(3 * len(kept.loop_triangles), dtype=np.int32)
    kept.loop_triangles.foreach_get("vertices", faces)
    moves = any(world != worlds[0] for world in worlds)
    return SampledObject(vertices, faces.reshape(-1, 3), kept, place, moves)


def _points(shown: Any) -> Any:
    """Vertices (V, 3) of an evaluated object."""
    mesh = shown.to_mesh()
    flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", flat)
    shown.to_mesh_clear()
    return flat.reshape(-1, 3)
