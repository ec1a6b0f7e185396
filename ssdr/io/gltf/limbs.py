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
from ..rig import Rig, build_rig, quantise
from .writer import plain

__all__ = ["oriented", "write_limbs"]


def write_limbs(
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
        Of each bone, by its name.
    """
    model = turn_skinning_up(skinning, up, "y")
    rig = build_rig(model, influences=influences, most=8)
    assert rig.parents is not None
    indices, stored, values = quantise(rig.indices, rig.weights, "float32")
    ends = limb_ends(
        rig.centers, rig.parents, rig.rest, rig.indices, rig.weights, sliding=rig.translating
    )
    rig = oriented(rig, limb_axes(rig.centers, rig.parents, ends))
    error = rig.error(model, weights=values)
    between = rig.error(model, weights=values, between=True)
    notes = ["glTF takes the unit for metres"]
    size = plain(model, rig, indices, stored, name or skinning.name or path.stem, notes).save(path)
    report = SaveReport(
        path=path,
        bytes=size,
        influences=stored.shape[1],
        error=error.rmse,
        max_error=error.largest,
        between_frames=between.rmse,
        note="; ".join(notes),
    )
    lengths = np.linalg.norm(ends - rig.centers, axis=1)
    return report, dict(zip(rig.names, lengths.tolist(), strict=True))


def oriented(rig: Rig, axes: NDArray[np.float64]) -> Rig:
    """The same rig with joints that are turned so in the rest pose."""
    assert rig.parents is not None
    # of what a joint's transform is relative to
    above = np.where((rig.parents >= 0)[:, None, None], axes[rig.parents], np.eye(3))
    turn = matrix_from_quaternion(rig.rotations.astype(np.float64))
    turn = np.swapaxes(above, 1, 2) @ turn @ axes
    moved = np.einsum("bji,fbj->fbi", above, rig.translations.astype(np.float64))
    return dataclasses.replace(
        rig,
        rotations=unflip_quaternions(quaternion_from_matrix(turn)).astype(np.float32),
        translations=moved.astype(np.float32),
        offsets=np.einsum("bji,bj->bi", above, rig.offsets.astype(np.float64)).astype(np.float32),
        axes=axes,
    )
