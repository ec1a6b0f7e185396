"""Parts of a model that a decomposition keeps: rest pose and weights, or a skeleton."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

from ..common.short_repr import short_repr
from .skinning import Skinning

JointKind = Literal["rigid", "loose", "kept"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Kept:
    """Parts of a model that a decomposition keeps unchanged.

    To start from a whole model of which nothing is kept, such as a checkpoint, pass it as a
    :class:`Skinning` instead.

    Parameters
    ----------
    rest : (V, 3) array, optional
        Rest pose.
    indices, weights : (V, K) arrays, optional
        Skin weights.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> start = ssdr.Kept(rest=dancer.vertices[0])
    >>> result = ssdr.decompose(dancer, bones=4, effort="fast", start=start)
    >>> np.allclose(result.skinning.rest, dancer.vertices[0])
    True
    """

    rest: Any = None
    indices: Any = None
    weights: Any = None

    __repr__ = short_repr


@dataclasses.dataclass(frozen=True, eq=False)
class Skeleton:
    """A skeleton whose bones, parents and names are kept, while weights and motion are found.

    Parameters
    ----------
    skinning : Skinning, or a result that has one
        A model with a hierarchy, such as :func:`load_skinning` reads.  If it moves another mesh,
        its joints are taken to lie in the rest frame and its weights are not used.
    joints : {"rigid", "loose", "kept"}
        "rigid": bone and parent move the joint to the same point in every frame.  "loose": they
        may move it to different points.  "kept": bones move as those of the model do, which has
        the frames of the sequence; weights and rest pose alone are found.
    extra_bones : int or mapping
        Number of bones to add to the skeleton where the error is largest, or a mapping of bone
        names to the number to add below each: ``{"chest": 2, "hips": 1}``.

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

    def __post_init__(self) -> None:
        found = getattr(
            self.skinning, "skinning", self.skinning
        )  # of a result, which may have shapes
        object.__setattr__(self, "skinning", getattr(found, "skinning", found))
