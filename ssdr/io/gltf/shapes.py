"""Morph targets of a skinned mesh in a glTF document."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip
from ...frames.shaped_normals import ShapedNormals
from ...shapes import Shapes
from ..corners import Corners
from ..file_clips import seconds
from .builder import Builder


def add_targets(
    builder: Builder, shapes: Shapes, corners: Corners, normals: ShapedNormals | None
) -> list[Any]:
    """Add the morph targets of a mesh and return the "targets" of a primitive's JSON."""
    attributes = {"POSITION": shapes.displacements[:, corners.vertex]}
    if normals is not None:
        attributes["NORMAL"] = normals.added[:, corners.number]
    found = {name: builder.displaced(values) for name, values in attributes.items()}
    return [dict(zip(found, one, strict=True)) for one in zip(*found.values(), strict=True)]


def state_targets(mesh: dict[str, Any], shapes: Shapes) -> None:
    """Set, in the JSON of a mesh, the names of its targets and their amounts without an animation.

    The amounts are 0 if all are 0 in some frame, otherwise the means over the frames.
    """
    amounts = shapes.amounts * bool(shapes.amounts.any(axis=1).all())
    mesh["weights"] = amounts.mean(axis=0).tolist()
    mesh["extras"] = {"targetNames": list(shapes.names)}


def add_channel(
    builder: Builder, animation: dict[str, Any], shapes: Shapes, clip: Clip, start: float = 0.0
) -> None:
    """Add a channel with the amounts in the frames of a clip to an animation of node 0."""
    times = (start + seconds(np.arange(clip.n_frames), clip.fps)).astype(np.float32)
    amounts = shapes.amounts[clip.frames].reshape(-1)
    target = {"node": 0, "path": "weights"}
    animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
    output = builder.accessor(_stored_amounts(amounts), "SCALAR", normalized=True)
    stamps = builder.accessor(times, "SCALAR", bounds=True)
    animation["samplers"].append({"input": stamps, "output": output, "interpolation": "LINEAR"})


def _stored_amounts(amounts: NDArray[Any]) -> NDArray[Any]:
    """Amounts as stored: uint8 if all are multiples of 1/255 in [0, 1], otherwise float32."""
    inside = amounts.min(initial=0) >= 0 and amounts.max(initial=0) <= 1
    if inside and np.abs(255 * amounts - np.rint(255 * amounts)).max(initial=0) < 1e-5:
        return np.asarray(np.rint(255 * amounts), dtype=np.uint8)
    return np.asarray(amounts, dtype=np.float32)
