"""Rest normals of a model, which engines turn with its bones to light it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..io.corners import corner_normals
from ..skinning import Skinning

__all__ = ["corner_normals", "rest_normals"]


def rest_normals(model: Skinning) -> NDArray[np.float32]:
    """Unit normals ``(T, 3, 3)`` of the rest pose at triangle corners.

    They are the model's own or, where it has none, those of its rest pose as a surface.
    """
    if model.surface is not None and model.surface.normals is not None:
        return model.surface.normals
    return corner_normals(model.rest, model.faces, None)
