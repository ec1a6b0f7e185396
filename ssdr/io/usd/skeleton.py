"""Writing of UsdSkel: a skeleton with its animations, and the skin of a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Tf, UsdSkel, Vt

from ...clips import Clip, readable, unique_names
from ...hierarchy.transforms import parents_first
from ...shapes import Shapes
from ..rig import Rig


def put_skeleton(stage: Any, place: Any, rig: Rig, title: str) -> list[str] | None:
    """Define a skeleton with an animation for each clip at a path, and bind the first animation.

    Parameters
    ----------
    stage : Usd.Stage
    place : Sdf.Path
        Path of the skeleton.
    rig : Rig
    title : str
        Name of the model. If a single clip has the same name, its name is not stored.

    Returns
    -------
    list of str or None
        Paths of the joints that move vertices, in the order of the model's bones. None if these are
        all joints, in the skeleton's order. The order differs if a bone of the model comes before
        its parent, which USD forbids.
    """
    plain = unique_names([identifier(bone) for bone in rig.names])
    order = np.arange(rig.n_bones)
    paths = list(plain)
    if rig.parents is not None:
        if (rig.parents >= order).any():
            order = parents_first(rig.parents)
        for bone in order:
            if rig.parents[bone] >= 0:
                paths[bone] = f"{paths[rig.parents[bone]]}/{plain[bone]}"
    tokens = [paths[bone] for bone in order]
    skeleton = UsdSkel.Skeleton.Define(stage, place)
    skeleton.CreateJointsAttr(tokens)
    if plain != rig.names:
        skeleton.CreateJointNamesAttr([readable(rig.names[bone]) for bone in order])

    def translations(points: NDArray[np.float32]) -> Any:
        moves = [Gf.Vec3d(*map(float, point)) for point in points[order]]
        return Vt.Matrix4dArray([Gf.Matrix4d(1.0).SetTranslate(move) for move in moves])

    skeleton.CreateBindTransformsAttr(translations(rig.centers))
    skeleton.CreateRestTransformsAttr(translations(rig.offsets))
    alone = len(rig.clips) == 1 and rig.clips[0].name in ("", title)
    names = unique_names(["Animation" if alone else identifier(c.name) for c in rig.clips])
    places = [skeleton.GetPath().AppendChild(name) for name in names]
    for where, clip in zip(places, rig.clips, strict=True):
        animation = UsdSkel.Animation.Define(stage, where)
        animation.CreateJointsAttr(tokens)
        _put_keys(animation, rig, order, clip)
        stated: dict[str, Any] = {"fps": clip.fps, "frames": clip.n_frames}
        if not alone:
            stated["name"] = clip.name
        animation.GetPrim().SetCustomDataByKey("ssdr", stated)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([places[0]])
    if rig.moving is not None:
        return [paths[bone] for bone in rig.moving]
    return paths if (order != np.arange(rig.n_bones)).any() else None


def _put_keys(animation: Any, rig: Rig, order: NDArray[np.int64], clip: Clip) -> None:
    """Add the keys of a clip to a SkelAnimation, with the first frame at the time code 0.

    `order` (B,) holds the bone indices in the order of the skeleton's joints. The stage has as many
    time codes per second as the first clip has frames.
    """
    tempo = rig.clips[0].fps
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    scales = animation.CreateScalesAttr()
    ones = np.ones((rig.n_bones, 3), dtype=np.float16)
    if rig.scales is None:
        scales.Set(Vt.Vec3hArray.FromNumpy(ones))
    for frame in clip.start + np.flatnonzero(rig.keys[clip.frames, 0]):
        code = float(frame - clip.start) * (tempo / clip.fps)
        translations.Set(Vt.Vec3fArray.FromNumpy(rig.translations[frame, order]), code)
        rotations.Set(Vt.QuatfArray.FromNumpy(rig.rotations[frame, order]), code)
        if rig.scales is not None:
            scales.Set(Vt.Vec3hArray.FromNumpy(rig.scales[frame, order].astype(np.float16)), code)
    if rig.shapes is not None:
        animation.CreateBlendShapesAttr(_shape_tokens(rig.shapes))
        weights = animation.CreateBlendShapeWeightsAttr()
        for frame in np.arange(clip.start, clip.stop):
            code = float(frame - clip.start) * (tempo / clip.fps)
            weights.Set(Vt.FloatArray.FromNumpy(rig.shapes.amounts[frame]), code)


def bind_shapes(stage: Any, prim: Any, shapes: Shapes) -> None:
    """Define blend shapes below a mesh that is bound to a skeleton, with the points they move."""
    tokens = _shape_tokens(shapes)
    places = [prim.GetPath().AppendChild(token) for token in tokens]
    for place, displacements in zip(places, shapes.displacements, strict=True):
        rows = np.flatnonzero(displacements.any(axis=1))
        shape = UsdSkel.BlendShape.Define(stage, place)
        # a blend shape without point indices would apply to all points
        rows = rows if len(rows) else np.zeros(1, dtype=np.int64)
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(displacements[rows].astype(np.float32)))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(rows.astype(np.int32)))
    binding = UsdSkel.BindingAPI(prim)
    binding.CreateBlendShapesAttr(tokens)
    binding.CreateBlendShapeTargetsRel().SetTargets(places)


def _shape_tokens(shapes: Shapes) -> list[str]:
    return list(unique_names([identifier(name) for name in shapes.names], "shape"))


def bind(
    prim: Any,
    indices: NDArray[np.int32],
    weights: NDArray[np.float32],
    skeleton: Any,
    tokens: Sequence[str] | None,
) -> None:
    """Bind a mesh to the skeleton at the path `skeleton`, with skin weights `weights` (V, K).

    `indices` (V, K) are bones of the rig. `tokens` are the joints in the order of the bones; None
    if the skeleton has its joints in that order.
    """
    binding = UsdSkel.BindingAPI.Apply(prim)
    width = indices.shape[1]
    binding.CreateJointIndicesPrimvar(False, width).Set(Vt.IntArray.FromNumpy(indices.reshape(-1)))
    binding.CreateJointWeightsPrimvar(False, width).Set(
        Vt.FloatArray.FromNumpy(weights.reshape(-1))
    )
    binding.CreateSkeletonRel().SetTargets([skeleton])
    if tokens is not None:
        binding.CreateJointsAttr(tokens)
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))


def identifier(name: str) -> str:
    """Identifier that USD accepts, made from a name by replacing other characters."""
    return str(Tf.MakeValidIdentifier(readable(name)))
