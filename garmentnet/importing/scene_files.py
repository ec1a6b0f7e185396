"""Reading of cloth and rigs from other programs' files, in metres, y up, at a given frame rate."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import ssdr
from ssdr import Clip, MeshSequence, Skinning
from ssdr.common.errors import InputError
from ssdr.io.spaces import in_space, transformed
from ssdr.mesh.surface import METRES_Y_UP, Up
from ssdr.model.shapes import skinning_and_shapes

Say = Callable[[str], None]
Model = TypeVar("Model", MeshSequence, Skinning)
_USD = (".usd", ".usda", ".usdc")
_GLTF = (".glb", ".gltf")
# Files that hold rigs.
RIGS = (*_USD, *_GLTF, ".fbx")
# Files that state times in seconds and can be sampled at any rate.
_SAMPLED = (*_USD, *_GLTF, ".abc", ".fbx")
# Files that state no rate.
_UNTIMED = (".obj", ".ply", ".pc2", ".npy")


@dataclasses.dataclass(frozen=True)
class Source:
    """Options for reading files of one kind, cloths or rigs.

    Parameters
    ----------
    mesh : str
        Name of the mesh, or of a node above it in the scene; empty: all meshes.
    scale : float
        Factor of lengths, applied after the unit that a file states.
    up : {"y", "z"}, optional
        Axis that points up, instead of what the file states.
    """

    mesh: str = ""
    scale: float = 1.0
    up: Up | None = None

    def options(self) -> dict[str, Any]:
        """Options of :func:`ssdr.load`."""
        return {"up": self.up} | ({"meshes": self.mesh} if self.mesh else {})

    def ready(self, model: Model) -> Model:
        """Sequence or skinning in metres, with y up."""
        return transformed(in_space(model, METRES_Y_UP), self.scale)


def read_cloth(path: Path, source: Source, rate: float | None, say: Say) -> MeshSequence:
    """An animated mesh at `rate` frames a second, or at the file's own rate.

    Copies of a vertex at the seams of a glTF file are merged.  Of several animations the one with
    the file's name is read.

    Parameters
    ----------
    path : Path
    source : Source
    rate : float, optional
    say : callable
        Called with a sentence for whatever the user should know.

    Raises
    ------
    InputError
        If the file has another rate and its format states no times, or several animations of which
        none, or more than one, has the name.
    SsdrError
        As :func:`ssdr.load`.
    """
    suffix, options = path.suffix.lower(), source.options()
    if suffix in RIGS:
        options["clip"] = _animation(ssdr.list_clips(path), path, path.stem)

    def read(fps: float | None) -> MeshSequence:
        return source.ready(ssdr.load(path, fps=fps, weld=suffix in _GLTF, **options))

    return _at_rate(read, path, rate, say)


def read_rig(path: Path, source: Source, rate: float | None, take: str, say: Say) -> Skinning:
    """A skinned body at `rate` frames a second, or at the file's own rate.

    Of several animations the one with the name `take` is read.  Blend shapes are left out, but for
    what they add in all frames.  Other arguments and errors are those of :func:`read_cloth`.
    """
    alone: dict[str, Any] = {"joints_alone": True} if path.suffix.lower() in _SAMPLED else {}

    def read(fps: float | None) -> Skinning:
        found = ssdr.load_skinning(path, fps=fps, **source.options(), **alone)
        model, shapes = skinning_and_shapes(found.select(_animation(found.clips, path, take)))
        if shapes is not None:
            say(f"{path.name}: {len(shapes)} blend shapes left out, but for what all frames have")
            a = shapes.amounts
            kept = a.min(axis=0).clip(min=0) + a.max(axis=0).clip(max=0)
            held = np.tensordot(kept, shapes.displacements, 1)
            model = dataclasses.replace(model, rest=model.rest + held)
        return source.ready(model)

    return _at_rate(read, path, rate, say)


def _animation(clips: Sequence[Clip], path: Path, take: str) -> int:
    """Index of the animation to read: a file's only one, or that with the name `take`.

    Programs join names by "|"; each part counts.
    """
    names = [clip.name for clip in clips]
    alike = [n for n in names if take.casefold() in n.casefold().split("|")]
    found = names if len(names) == 1 else [take] if take in names else alike
    if len(found) != 1:
        raise InputError(path.name, f"one animation with the name {take}", ", ".join(names))
    return names.index(found[0])


def _at_rate(
    read: Callable[[float | None], Model], path: Path, rate: float | None, say: Say
) -> Model:
    suffix = path.suffix.lower()
    found = read(None)
    if suffix in _UNTIMED and found.n_frames > 1:
        say(f"{path.name} states no frame rate: {rate or found.fps:g} frames a second")
        return read(rate)
    if rate is None or math.isclose(found.fps, rate, rel_tol=1e-4):
        return found
    if suffix not in _SAMPLED:
        text = f"{found.fps:g}; only {', '.join(_SAMPLED)} are resampled"
        raise InputError(path.name, f"{rate:g} frames a second", text)
    say(f"{path.name}: resampled from {found.fps:g} to {rate:g} frames a second")
    return read(rate)
