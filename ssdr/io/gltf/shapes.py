"""Morph targets of a skinned mesh in a glTF document."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import check_floats
from ...errors import InputError
from ...normals import corner_normals
from ...skinning import Skinning
from ..corners import Corners
from .builder import ARRAY, Builder


@dataclasses.dataclass(frozen=True, eq=False)
class Shapes:
    """Displacements of the rest pose, added before it is skinned.

    Parameters
    ----------
    displacements : (M, V, 3) array
        Metres, y up.
    amounts : (F, M) array
        Factor of each displacement in every frame.  Programs that show the mesh without its
        animation use the mean over the frames.  Blender and Unity clamp factors to 0 to 1.

    Raises
    ------
    InputError
        If shapes do not match or a number is not finite.
    """

    displacements: Any
    amounts: Any

    def __post_init__(self) -> None:
        moved = check_floats(self.displacements, "displacements", ("M", "V", 3))
        amounts = check_floats(self.amounts, "amounts", ("F", "M"))
        object.__setattr__(self, "displacements", moved)
        object.__setattr__(self, "amounts", amounts)
        if len(moved) != amounts.shape[1]:
            raise InputError("amounts", f"{len(moved)} columns", amounts.shape[1])

    def check(self, model: Skinning) -> None:
        """Raise InputError if the numbers of vertices and frames differ from the model's."""
        expected = model.n_frames, model.n_vertices
        found = len(self.amounts), self.displacements.shape[1]
        if expected != found:
            text = "{} frames and {} vertices".format
            raise InputError("shapes", text(*expected), text(*found))

    def add_targets(self, builder: Builder, model: Skinning, corners: Corners) -> list[Any]:
        """Add positions and normals of the targets; return the "targets" of a primitive's JSON."""

        def put(array: NDArray[Any], **fields: Any) -> int:
            return builder.accessor(array.astype(np.float32), "VEC3", target=ARRAY, **fields)

        targets = []
        for moved in self.displacements:
            target = {"POSITION": put(moved[corners.vertex], bounds=True)}
            if corners.normals is not None:
                found = corner_normals(model.rest + moved, model.faces, model.surface)
                turned = np.array(corners.normals)
                turned[corners.faces.reshape(-1)] = found.reshape(-1, 3)
                target["NORMAL"] = put(turned - corners.normals)
            targets.append(target)
        return targets

    def add_channel(
        self, builder: Builder, animation: dict[str, Any], frames: slice, times: int
    ) -> None:
        """Add the amounts in `frames` to an animation of node 0; `times` is an accessor."""
        amounts = self.amounts[frames].astype(np.float32)
        target = {"node": 0, "path": "weights"}
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
        output = builder.accessor(amounts.reshape(-1), "SCALAR")
        animation["samplers"].append({"input": times, "output": output, "interpolation": "LINEAR"})
