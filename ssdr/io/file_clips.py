"""Clips of files: the one to read, one frame rate for all, and frames as times or vertices."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import InputError
from ..mesh.clips import Clip, one_rate, pick
from ..mesh.sequence import MeshSequence

if TYPE_CHECKING:
    from ..model.shapes import Skinned


_log = logging.getLogger(__name__)


def pick_clip(names: Sequence[str], clip: Any, path: Path) -> int:
    """Index of the clip that a name or index chooses, by :func:`~ssdr.mesh.clips.pick`.

    If there are several clips, the log names the chosen one.
    """
    index = pick(names, clip)
    if len(names) > 1:
        _log.info("%s: clip %r of %s", path, names[index], list(names))
    return index


def check_one_rate(clips: Sequence[Clip], where: str) -> None:
    """Raise an InputError, ending with the reason `where`, if clips differ in their frame rates."""
    if not one_rate(clips):
        rates = ", ".join(f"{clip.name} at {clip.fps:g}" for clip in clips)
        raise InputError("thing", f"clips of one frame rate {where}", rates)


def bake(skinning: Skinned) -> MeshSequence:
    """Sequence of a skinning's vertices in every frame.

    Raises
    ------
    InputError
        If clips have different frame rates, or a coordinate overflows.
    """
    from ..mesh.normals import corner_normals

    hint = "skinning.select(name) takes one out"
    check_one_rate(skinning.clips, f"where vertices are stored, which have one; {hint}")
    with np.errstate(over="ignore", invalid="ignore"):  # MeshSequence reports these
        frames, surface = skinning.skin(), skinning.surface
    if surface is not None and surface.normals is not None:
        # those of a skinning belong to its rest pose, which need not be a frame
        normals = corner_normals(frames[0], skinning.faces, surface)
        surface = dataclasses.replace(surface, normals=normals)
    return MeshSequence(
        frames,
        skinning.faces,
        skinning.fps,
        name=skinning.name,
        clip=skinning.clips[0].name if len(skinning.clips) == 1 else "",
        surface=surface,
        vertex_map=skinning.vertex_map,
        space=skinning.space,
    )
