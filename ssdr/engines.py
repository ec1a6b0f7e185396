"""Limits of game engines for skinned models, and what an engine does to a model beyond them.

The documentation's page on engines quotes the source of each limit.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .frames.error import motion_rms, share_of
from .hierarchy.transforms import rest_diagonal
from .lbs import skin
from .quantisation import WeightStorage, quantise, weight_values
from .sequence import MeshSequence
from .skinning import Skinning
from .space import METRES_Y_UP, Space

EngineName = Literal["unreal", "unity", "godot", "three", "bevy", "web"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Engine:
    """Limits of an engine for skinned models.

    Attributes
    ----------
    title : str
    suffixes : tuple of str
        Formats that it reads; the first is the one to write.
    influences : int
        Most influences of a vertex that the engine keeps with its default settings.
    influences_why : str
        Which setting or file format keeps more influences.
    bones : int or None
        Most bones of a mesh; None if no limit below that of the file format is known.
    still_bones : bool
        Whether bones that move no vertex count towards `bones`.
    bones_kind : {"refused", "cut off"}
        Whether the engine refuses a mesh with more bones, or cuts bones off.
    bones_why : str
        Explanation of `bones`.
    shapes : int or None
        Most shapes of a mesh; None if no limit is known.
    shapes_kind : {"refused", "cut off"}
        Whether the engine refuses a mesh with more shapes, or leaves shapes out.
    shapes_why : str
        Explanation of `shapes`.
    clamps_shapes : bool
        Whether it clamps amounts to [0, 1].
    stretch : bool
        Whether a bone may stretch along axes that do not rotate with it.
    storage : {"float32", "uint16", "uint8"}
        Type in which the engine stores weights with its default settings.
    rounds_down : bool
        Whether it divides weights by their sum in float32 and then rounds each down, so that they
        sum to less than 1 and draw vertices towards the origin; if not, their sum is kept.
    write : {"float32", "uint16", "uint8"}
        Type in which to write weights to a file: the finest that any of its settings keeps.
    space : Space
        Unit and up axis that a model has once it is imported.
    lost_in_names : str
        Regular expression of the part of a bone name that is lost on import.
    one_root : bool
        Whether all bones must descend from one root.
    ignores_case : bool
        Whether names that differ in case alone count as the same.
    """

    title: str
    suffixes: tuple[str, ...] = (".glb", ".gltf")
    influences: int = 4
    influences_why: str
    bones: int | None = None
    still_bones: bool = True
    bones_kind: Literal["refused", "cut off"] = "cut off"
    bones_why: str = ""
    shapes: int | None = None
    shapes_kind: Literal["refused", "cut off"] = "cut off"
    shapes_why: str = ""
    clamps_shapes: bool = False
    stretch: bool = True
    storage: WeightStorage = "float32"
    rounds_down: bool = False
    write: WeightStorage = "float32"
    space: Space = METRES_Y_UP
    lost_in_names: str = r"(?!)"
    one_root: bool = False
    ignores_case: bool = False


ENGINES: dict[EngineName, Engine] = {
    "unreal": Engine(
        title="Unreal Engine",
        suffixes=(".fbx", ".glb", ".gltf", ".usd", ".usda", ".usdc"),
        influences=8,
        influences_why="Unlimited Bone Influences keeps 12",
        bones=256,
        still_bones=False,
        stretch=False,
        bones_kind="refused",
        bones_why="for each material; not drawn unless Support 16-bit Bone Index is on",
        storage="uint8",
        write="uint16",
        space=Space(0.01, "z"),
        lost_in_names=r"^.*:",
        one_root=True,
        ignores_case=True,
    ),
    "unity": Engine(
        title="Unity",
        suffixes=(".fbx", ".glb", ".gltf"),
        influences_why="of .fbx, Skin Weights: Custom and Quality: Auto keep up to 255",
        clamps_shapes=True,
    ),
    "godot": Engine(
        title="Godot",
        suffixes=(".glb", ".gltf", ".fbx"),
        influences=8,
        influences_why="JOINTS_0 and JOINTS_1 are read",
        storage="uint16",
        rounds_down=True,
        write="uint16",
        lost_in_names=r"[:/]",
    ),
    "three": Engine(
        title="three.js",
        suffixes=(".glb", ".gltf", ".fbx"),
        influences_why="a vertex has one skinIndex and one skinWeight of 4",
        lost_in_names=r"[\s\[\].:/]",
    ),
    "bevy": Engine(
        title="Bevy",
        influences_why="JOINTS_0 alone is read",
        bones=256,
        bones_why="where the GPU has no storage buffers, as in WebGL 2",
        shapes=256,
        shapes_kind="refused",
        shapes_why="MAX_MORPH_WEIGHTS",
    ),
    "web": Engine(
        title="glTF viewers",
        influences_why="a viewer need not read more than JOINTS_0",
        bones=65535,
        bones_kind="refused",
        bones_why="JOINTS_0 is of 16 bits",
        shapes=4,
        shapes_why="a viewer need not add more than eight attributes, positions and normals",
        write="uint16",
    ),
}


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing that an engine does to a model: "refused", "cut off", "rounded" or "renamed"."""

    kind: Literal["refused", "cut off", "rounded", "renamed"]
    text: str


def findings(model: Skinning, engine: Engine, suffix: str) -> tuple[Finding, ...]:
    """Findings that say what an engine would refuse, cut off, round or rename in a model.

    Parameters
    ----------
    model : Skinning
    engine : Engine
    suffix : str
        Suffix of the model's file, such as ``".glb"``.

    Returns
    -------
    tuple of Finding
        Empty if the engine keeps the model as it is.
    """
    return tuple(_findings(model, engine, suffix))


def _findings(model: Skinning, engine: Engine, suffix: str) -> Iterator[Finding]:
    if suffix not in engine.suffixes:
        yield Finding("refused", f"format {suffix}: reads {', '.join(engine.suffixes)}")
    count = model.n_bones if engine.still_bones else len(np.unique(model.sparse_weights().indices))
    if engine.bones is not None and count > engine.bones:
        text = f"{count} bones: takes {engine.bones} ({engine.bones_why})"
        yield Finding(engine.bones_kind, text)
    roots = n_roots(model)
    if engine.one_root and roots > 1:
        text = f"{roots} root bones: takes 1, unless it counts a node above them as one"
        yield Finding("refused", text)
    if model.bone_model == "affine" and not engine.stretch:
        text = "stretch of bones: a transform holds one rotation, so that shear is lost"
        yield Finding("cut off", text)
    yield from _of_shapes(model, engine)
    kept = model
    used = (model.weights > 0).sum(axis=1)
    if used.max() > engine.influences:
        kept = model.prune(engine.influences)
        text = (
            f"{int(used.max())} influences, of {int((used > engine.influences).sum()):,} vertices "
            f"more than {engine.influences}: keeps {engine.influences} ({engine.influences_why}); "
            f"{_moved(model, kept.indices, kept.weights)}"
        )
        yield Finding("cut off", text)
    if engine.storage != "float32":
        indices, weights = _rounded(kept, engine)
        off = float(np.abs(weights - kept.weights).max())
        if off > 1e-7:  # more than float32 rounds
            text = f"weights, to {8 * np.dtype(engine.storage).itemsize} bits"
            if engine.rounds_down:
                text += ", down"
            moved = _moved(kept, indices, weights)
            yield Finding("rounded", f"{text}: off by up to {off:.2g}; {moved}")
    yield from _renamed(model.names(), engine)


def _of_shapes(model: Skinning, engine: Engine) -> Iterator[Finding]:
    if model.shapes is None:
        return
    if engine.shapes is not None and len(model.shapes) > engine.shapes:
        text = f"{len(model.shapes)} shapes: takes {engine.shapes} ({engine.shapes_why})"
        yield Finding(engine.shapes_kind, text)
    low, high = (float(f(model.shapes.amounts)) for f in (np.min, np.max))
    if engine.clamps_shapes and (low < -1e-6 or high > 1 + 1e-6):
        text = f"amounts of shapes, from {low:.3g} to {high:.3g}: clamped to 0 to 1"
        yield Finding("cut off", text)


def _rounded(model: Skinning, engine: Engine) -> tuple[NDArray[np.integer], NDArray[np.floating]]:
    """Indices and weights as the engine stores them."""
    if not engine.rounds_down:
        indices, stored = quantise(model.indices, model.weights.astype(float), engine.storage)
        return indices, weight_values(stored)
    weights = model.weights.astype(np.float32)
    # Where rounding makes this sum exceed 1, weights that were whole steps round down by one step.
    weights /= np.cumsum(weights, axis=1, dtype=np.float32)[:, -1:]
    steps = np.float32(np.iinfo(engine.storage).max)
    return model.indices, np.floor(weights * steps) / float(steps)


def _renamed(names: tuple[str, ...], engine: Engine) -> Iterator[Finding]:
    changed = [name for name in names if re.search(engine.lost_in_names, name)]
    if changed:
        yield Finding("renamed", f"{len(changed)} bones, as {changed[0]!r}")
    seen = [name.casefold() if engine.ignores_case else name for name in names]
    same = [name for name, key in zip(names, seen, strict=True) if seen.count(key) > 1]
    if same:
        yield Finding("renamed", f"{len(same)} bones whose names are the same, as {same[0]!r}")


def n_roots(model: Skinning) -> int:
    """Number of bones that have no parent."""
    return model.n_bones if model.parents is None else int((model.parents < 0).sum())


def _moved(model: Skinning, indices: NDArray[np.integer], weights: NDArray[np.floating]) -> str:
    """Text that states the largest distance by which other influences would move a vertex."""
    far, squares = 0.0, 0.0
    for frame in range(model.n_frames):
        rest = model.rest if model.shapes is None else model.rest + model.shapes.added(frame)
        other = skin(rest, indices, weights, model.transforms[frame], dtype=float)
        apart = model.skin([frame], dtype=float)[0] - other
        far = max(far, float(np.linalg.norm(apart, axis=-1).max()))
        squares += float((apart**2).sum())
    share = 100 * far / (rest_diagonal(model.rest) or 1.0)
    motion = motion_rms([MeshSequence(model.skin(), validate=False)])
    lost = share_of(math.sqrt(squares / (model.n_frames * model.n_vertices)), motion)
    of_motion = "" if math.isnan(lost) else f"; RMSE {100 * lost:.2g} % of the motion"
    return f"a vertex moves by {far:.3g}, {share:.2g} % of the diagonal, or less{of_motion}"
