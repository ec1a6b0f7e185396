"""Vertices of a mesh object in every frame, as Blender evaluates them."""

import contextlib
import dataclasses
from collections.abc import Generator, Iterator
from pathlib import Path
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
    if not marks:
        raise AddonError(
            f"There is no marker between the frames {start} and {stop - 1} of the scene: set one "
            "where each clip starts, or switch Clips from markers off"
        )
    ends = [frame for frame, _ in marks[1:]] + [stop]
    clips = [FrameRange(name, frame, end) for (frame, name), end in zip(marks, ends, strict=True)]
    for name, first, end in clips:
        if end - first < 2:
            count = "1 frame" if end - first else "no frames"
            raise AddonError(
                f"The clip {name}, from its marker at frame {first} on, has {count}: move a "
                "marker, so that it has two or more"
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
    first : int
        Number of the first frame in the scene.
    fps : float
    clips : list of FrameRange
        Empty: all frames are one animation.
    """

    vertices: Any
    faces: Any
    mesh: Any
    place: Matrix
    moves: bool
    first: int
    fps: float
    clips: list[FrameRange]

    def frames(self, clip: FrameRange) -> slice:
        """Slice of `vertices` that holds the frames of a clip."""
        return slice(clip.first - self.first, clip.stop - self.first)

    def save(self, folder: Path, unit: float) -> list[str]:
        """Write files that ssdr reads, one for each clip, and return their paths.

        ``input.npz`` always holds all frames, for the page.  `unit` is the length of Blender's unit
        in metres.
        """
        self._save(folder / "input.npz", unit, "", slice(None))
        files = [folder / f"clip_{k}.npz" for k in range(len(self.clips))]
        for path, clip in zip(files, self.clips, strict=True):
            self._save(path, unit, clip.name, self.frames(clip))
        return list(map(str, files or [folder / "input.npz"]))

    def _save(self, path: Path, unit: float, clip: str, frames: slice) -> None:
        np.savez(
            path,
            vertices=self.vertices[frames],
            clip=np.array(clip),
            faces=self.faces,
            fps=np.array(self.fps),
            units=np.array(unit),
            up=np.array("z"),
        )


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
    context: Any, source: Any, clips: list[FrameRange]
) -> Generator[float, None, SampledObject]:
    """Play the frames of the scene, yield the fraction that is done, and return the sample.

    Frames before the first clip are played, since simulations need them, but not kept.
    """
    scene = context.scene
    first = clips[0].first if clips else scene.frame_start
    numbers = range(first, scene.frame_end + 1)
    frames: list[Any] = []
    kept, place, moves = None, Matrix(), False
    simulated = any(one.type in ("CLOTH", "SOFT_BODY") for one in source.modifiers)
    try:
        with frame_kept(scene, simulated=simulated), without_rest(source):
            for number in range(scene.frame_start, first):
                scene.frame_set(number)
                yield 0.0
            for number in numbers:
                scene.frame_set(number)
                graph = context.evaluated_depsgraph_get()
                shown = source.evaluated_get(graph)
                world = shown.matrix_world.copy()
                if kept is None:
                    kept = bpy.data.meshes.new_from_object(
                        shown, preserve_all_data_layers=True, depsgraph=graph
                    )
                    at_first, place = world, Matrix.LocRotScale(*world.decompose())
                    if not abs(place.determinant()) > 0:
                        raise AddonError(f"{source.name} has the scale 0 in frame {number}")
                points = _points(shown)
                if frames and points.shape != frames[0].shape:
                    raise AddonError(
                        f"{source.name} has {len(frames[0])} vertices in frame {numbers[0]} and "
                        f"{len(points)} in frame {number}: their number must stay the same"
                    )
                moves = moves or world != at_first
                to_place = np.linalg.inv(np.array(place)) @ np.array(world)
                points = points @ to_place[:3, :3].T + to_place[:3, 3]
                frames.append(points.astype(np.float32))
                yield len(frames) / len(numbers)
        vertices = np.stack(frames)
        if (vertices == vertices[0]).all():
            raise AddonError(
                f"{source.name} does not move between the frames {numbers[0]} and {numbers[-1]} of "
                "the scene"
            )
    except BaseException:
        if kept is not None:
            bpy.data.meshes.remove(kept)
        raise
    kept.calc_loop_triangles()
    faces = np.empty(3 * len(kept.loop_triangles), dtype=np.int32)
    kept.loop_triangles.foreach_get("vertices", faces)
    fps = scene.render.fps / scene.render.fps_base
    return SampledObject(vertices, faces.reshape(-1, 3), kept, place, moves, first, fps, clips)


def _points(shown: Any) -> Any:
    """Vertices (V, 3) of an evaluated object."""
    mesh = shown.to_mesh()
    flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", flat)
    shown.to_mesh_clear()
    return flat.reshape(-1, 3)
