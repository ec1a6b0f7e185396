"""glTF whose joints have their y axis along their bone, for programs that draw bones so."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...hierarchy.bone_ends import limb_axes, limb_ends
from ...rigid import matrix_from_quaternion, quaternion_from_matrix, unflip_quaternions
from ...skinning import Skinning
from ..axes import Up, turn_skinning_up
from ..registry import SaveReport
from ..rig import Rig, build_rig
from .writer import save_rig

__all__ = ["orient_joints", "write_along_bones"]


def write_along_bones(
    skinning: Skinning,
    path: Path,
    *,
    influences: int | None = None,
    up: Up = "y",
    name: str | None = None,
) -> tuple[SaveReport, dict[str, float]]:
    """Write a model with a hierarchy whose joints have their y axis along their bone.

    Programs that draw bones along an axis of their own, Blender among them, then draw them from
    joint to joint.

    Parameters
    ----------
    skinning, path, influences, up, name
        As for :func:`write_skinning`.

    Returns
    -------
    SaveReport
    lengths : dict
        Length of each bone by its name.
    """
    model = turn_skinning_up(skinning, up, "y")
    rig = build_rig(model, influences=influences, most=8)
    assert rig.parents is not None
    ends = limb_ends(
        rig.centers, rig.parents, rig.rest, rig.indices, rig.weights, sliding=rig.translating
    )
    rig = orient_joints(rig, limb_axes(rig.centers, rig.parents, ends))
    lengths = np.linalg.norm(ends - rig.centers, axis=1).tolist()
    report = save_rig(model, rig, path, name or skinning.name or path.stem)
    return report, dict(zip(rig.names, lengths, strict=True))


def orient_joints(rig: Rig, axes: NDArray[np.float64]) -> Rig:
    """The same rig whose joints have the orientations `axes` (B, 3, 3) in the rest pose."""
    assert rig.parents is not None
    parent_axes = np.where((rig.parents >= 0)[:, None, None], axes[rig.parents], np.eye(3))
    turn = matrix_from_quaternion(rig.rotations.astype(np.float64))
    turn = np.swapaxes(parent_axes, 1, 2) @ turn @ axes

    def turned(points: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.einsum("bji,...bj->...bi", parent_axes, points).astype(np.float32)

    return dataclasses.replace(
        rig,
        rotations=unflip_quaternions(quaternion_from_matrix(turn)).astype(np.float32),
        translations=turned(rig.translations),
        offsets=turned(rig.offsets),
        axes=axes,
    )
