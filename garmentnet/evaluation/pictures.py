"""Pictures of simulation, prediction and error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssdr import MeshSequence
from ssdr.render import write_picture

from ..data.clip import Clip
from ..drawing.dressed import outfit_sheet

__all__ = ["draw_clip"]


def draw_clip(clip: Clip, prediction: NDArray[np.float32], path: Path) -> Path:
    """Draw truth, prediction ``(F, V, 3)`` and error of a clip, row by row, as a PNG.

    The error is coloured on the cloth alone, and the figures are RMSE over the cloth: of the clip
    in the head, of a frame in its column.
    """
    outfit = clip.outfit
    sheet = outfit_sheet(
        MeshSequence(clip.body(), outfit.body.faces, clip.fps),
        MeshSequence(prediction, outfit.faces, clip.fps, name=clip.name),
        clip.joints,
        outfit.skeleton.positions(clip.joints)[:, 0],
        truth=clip,
    )
    write_picture(sheet, path)
    return path
