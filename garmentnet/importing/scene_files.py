"""Reading of cloth and rigs from other programs' files, in metres, y up, at a given frame rate."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.common.errors import InputError
from ssdr.io.spaces import in_space, transformed
from ssdr.mesh.surface import METRES_Y_UP, Up

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

    Copies of a vertex at the seams of a glTF file are merged.

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
        If the file has another rate and its format states no times.
    SsdrError
        As :func:`ssdr.load`.
    """
    weld = path.suffix.lower() in _GLTF

    def read(fps: float | None) -> MeshSequence:
        return source.ready(ssdr.load(path, fps=fps, weld=weld, **source.options()))

    return _at_rate(read, path, rate, say)


def read_rig(path: Path, source: Source, rate: float | None, take: str, say: Say) -> Skinning:
    """A skinned body at `rate` frames a second, or at the file's own rate.

    If the file has several clips, the one with the name `take` is read, or the first without such a
    name.  Other arguments and errors are those of :func:`read_cloth`.
    """
    alone: dict[str, Any] = {"joints_alone": True} if path.suffix.lower() in _SAMPLED else {}

    def read(fps: float | None) -> Skinning:
        model = ssdr.load_skinning(path, fps=fps, **source.options(), **alone).skinning
        names = [clip.name for clip in model.clips]
        if len(names) > 1:
            model = model.select(take if take in names else 0)
            say(f"{path.name}: clip {model.clips[0].name} of {', '.join(names)}")
        return source.ready(model)

    return _at_rate(read, path, rate, say)


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
