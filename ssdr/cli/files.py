"""Options of the files that commands read and write, and a file beside its reference."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..common.errors import InputError
from ..io import in_space, list_meshes, load, load_any, load_clips, load_skinning
from ..io.arrays.npy import read as read_vertices
from ..io.blender.fbx_writing import write_skinning as write_fbx
from ..io.formats import format_to_read, option_names
from ..io.gltf.gltf_writing import write_skinning as write_gltf
from ..io.inputs import clips_in
from ..io.outputs import check_file
from ..io.references import trust
from ..io.scene_file import SceneFile
from ..mesh.sequence import MeshSequence, joined
from ..model.shapes import Skinned
from ..model.skinning import Skinning
from .output import Output

PAGES = (".html", ".htm")
# Functions whose options every command has that reads files, and every command that writes models.
READ = load_clips, load, SceneFile.read_skinning, SceneFile.read, read_vertices
WRITTEN = write_gltf, write_fbx


def taken(options: dict[str, Any], *functions: Callable[..., Any]) -> dict[str, Any]:
    """Take the options of some functions out of those of a command."""
    known = {name for one in functions for name in inspect.signature(one).parameters}
    return {name: options.pop(name) for name in tuple(options) if name in known}


def files_of(
    options: dict[str, Any], inputs: Sequence[Path] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Take the options of files out of those of a command.

    Returns
    -------
    reading : dict
        Options of :func:`ssdr.load_clips` and :func:`ssdr.io.load_any`.
    writing : dict
        Options of :func:`ssdr.io.save_all`, with the inputs as templates where these fit: not if
        the mesh is scaled, or said to be elsewhere than the rest of its file.
    """
    reading, writing = taken(options, *READ), taken(options, *WRITTEN)
    if "faces" in reading:
        reading["faces"] = str(reading["faces"])  # a path, or "none"
    if "folder" in reading:
        trust(reading.pop("folder"))  # templates may refer to files below it, too
    placed = any(name in reading for name in ("scale", "units", "up"))
    if str(writing.get("template")) == "none":
        placed = writing.pop("template") == "none"
    if not placed:
        writing |= {"templates": inputs} | {k: v for k, v in reading.items() if k == "meshes"}
    return reading, writing


def load_rig(path: Path, shots: Sequence[MeshSequence]) -> Skinning:
    """The model of a file, or its joints alone, in frames like those of the inputs."""
    if "joints_alone" not in option_names(format_to_read(path).function("read_skinning")):
        return load_skinning(path).skinning
    fps = None if list_meshes(path) else shots[0].fps
    return load_skinning(path, joints_alone=True, fps=fps).skinning


def check_page(path: Path, others: Sequence[Path]) -> None:
    """Raise an InputError before the work if a page could not be written to `path` after it."""
    if path.suffix.lower() not in PAGES:
        raise InputError("--output", "a file ending in .html", str(path))
    check_file(path, "output", others=others)


def pair(
    source: Path, reference: Path | None, reading: dict[str, Any], *, scale: float = 1.0
) -> tuple[MeshSequence | Skinned, Any]:
    """What a file holds, and the sequence of its reference with the same clips, or None.

    What the file holds is multiplied by `scale` and comes into the space of the reference.
    """
    with Output.current.waiting(f"loading {source}"):
        names = reading.pop("clip", None)
        # a file with one clip has no choice
        own = names if len(clips_in(source, fps=reading.get("fps"))) > 1 else None
        thing = load_any(source, clip=own, **({"scale": scale} | reading))
        if reference is None:
            return thing, None
        if len(clips_in(reference, fps=reading.get("fps"))) < 2:
            names = None
        elif isinstance(thing, Skinned) and len(thing.clips) > 1:
            names = [clip.name for clip in thing.clips]
        truth = joined(load_clips(reference, clip=names, **reading))
    stated = thing.space
    thing = in_space(thing, truth.space)
    if thing.space != stated:
        said = f"{reference} is in {truth.space}, {source} in {stated}"
        Output.current.warn(f"{said}: both are taken to {thing.space}")
    return thing, truth
