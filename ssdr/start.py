"""Input that a decomposition may begin from: parts of a model, and a skeleton."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from .skinning import Skinning

__all__ = ["JointKind", "Skeleton", "Start"]

JointKind = Literal["rigid", "loose"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Start:
    """Parts of a model to begin from, and what of them stays.

    A whole model of which nothing stays, such as a checkpoint, is handed over as a
    :class:`Skinning` instead.

    Parameters
    ----------
    rest : (V, 3) array, optional
        Rest pose; stays as it is.
    rest_frame : int
        Frame at which the rest pose starts where `rest` is not given.
    indices, weights : (V, K) arrays, optional
        Skin weights; they stay at `locked_vertices`.
    locked_vertices : mask or indices, optional
        Vertices whose given weights stay; all by default.
    transforms : (F, B0, 3, 4) array, optional
        Transforms of B0 bones, at most as many as asked for; those of `locked_bones` stay.
    locked_bones : mask or indices, optional
        Bones whose given transforms stay; all B0 by default.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.Start(rest=dancer.vertices[0])
    >>> result = ssdr.decompose(dancer, bones=4, effort="fast", start=start)
    >>> np.allclose(result.skinning.rest, dancer.vertices[0])
    True
    """

    rest: Any = None
    rest_frame: int = 0
    indices: Any = None
    weights: Any = None
    locked_vertices: Any = None
    transforms: Any = None
    locked_bones: Any = None


@dataclasses.dataclass(frozen=True, eq=False)
class Skeleton:
    """A skeleton whose bones, parents and names stay, while weights and motion are found.

    Parameters
    ----------
    skinning : Skinning
        A model with a hierarchy, such as :func:`load_skinning` reads.  If it moves another mesh,
        its joints are taken to lie in the rest frame and its weights are not used.
    joints : {"rigid", "loose"}
        "rigid": bone and parent carry the joint to the same point in every frame.  "loose": they
        may carry it to different points.
    extra_bones : int or mapping
        Number of bones to add to the skeleton, placed where the error is largest, or how many
        below which bone, by name: ``{"chest": 2, "hips": 1}``.
    locked_joints : sequence of str
        Joints whose rotation relative to their parent stays as in the skeleton: frame by frame if
        it has as many frames as the sequence, otherwise as in its only pose.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> rig = ssdr.decompose(dancer, bones=4, effort="fast", rig="rigid").skinning
    >>> again = ssdr.decompose(dancer, effort="fast", rig=ssdr.Skeleton(rig, extra_bones=1))
    >>> again.skinning.n_bones, again.skinning.bone_names[:4] == rig.bone_names
    (5, True)
    """

    skinning: Skinning
    _: dataclasses.KW_ONLY
    joints: JointKind = "rigid"
    extra_bones: int | Mapping[str, int] = 0
    locked_joints: Sequence[str] = ()
