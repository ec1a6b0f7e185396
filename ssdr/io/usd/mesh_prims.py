"""Reading of one mesh of a stage: polygons as triangles, skin, blend shapes and transforms."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from ...mesh.normals import unit
from ...model.shapes import Shapes
from ..file_errors import check
from ..meshes.polygons import at_corners, check_polygons, cut, opaque
from ..scene import Bones, Shape, facing, file_weights, vertices_at_joints

_FIRST = Usd.TimeCode.EarliestTime()
_MOST_LOOKS = 64  # largest number of times at which it is checked whether a mesh is mirrored


def upwards(prim: Any, kind: Any = UsdGeom.Imageable) -> Iterator[Any]:
    """Yield a prim and those above it, as far as they are of the schema `kind`."""
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(kind):
            yield kind(prim)
        prim = prim.GetParent()


def visibility_codes(prim: Any) -> list[float]:
    """Time codes at which the visibility of a prim or of one above it has samples."""
    return [code for one in upwards(prim) for code in one.GetVisibilityAttr().GetTimeSamples()]


class MeshPrim:
    """A mesh prim with its skin and blend shapes, as a `ScenePart`.

    Polygons are cut into triangles.

    Parameters
    ----------
    path : Path
        File of the stage, for error messages.
    prim : Usd.Prim
    skeleton : UsdSkel.SkeletonQuery, optional
        The skeleton that the mesh is bound to.
    query : UsdSkel.SkinningQuery, optional
        The binding of the mesh to `skeleton`.

    Attributes
    ----------
    counts : (P,) int array
        Number of corners of each polygon.
    corners : (T, 3) int array
        Corners of each triangle, as indices into the corners of all polygons.
    polygon : (T,) int array
        Index of the polygon that each triangle is a piece of.
    material : (T,) int array
        As in `ScenePart`, once :func:`~ssdr.io.usd.usd_materials.read_materials` has set it.
    """

    faces: NDArray[np.int64]
    corners: NDArray[np.int64]
    material: NDArray[np.int64]

    def __init__(self, path: Path, prim: Any, skeleton: Any = None, query: Any = None) -> None:
        self.path, self.prim, self.name = path, prim, str(prim.GetName())
        self.attribute = UsdGeom.Mesh(prim).GetPointsAttr()
        self.n_points = len(self.raw_points(_FIRST))
        self._read_polygons()
        self.joints: Any = skeleton if query is not None and query.HasJointInfluences() else None
        self._query = query
        self._shapes: Any = None
        if query is not None and query.HasBlendShapes() and skeleton.GetAnimQuery():
            self._shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
            self._shaper = skeleton.GetAnimQuery()
        self.skeleton: Any = str(prim.GetPath())
        self.n_bones = 1
        self.indices = np.zeros((self.n_points, 1), dtype=np.int32)
        self.weights = np.ones((self.n_points, 1))
        if self.joints is not None:
            self._read_influences()
        elif self._is_mirrored():
            # a mirroring transform turns triangles inside out
            self.corners, self.faces = self.corners[:, ::-1], self.faces[:, ::-1]

    def _is_mirrored(self) -> bool:
        """Whether the mesh's own transform mirrors it in the majority of samples."""
        codes = np.unique(self._moves())
        chosen = np.linspace(0, len(codes) - 1, min(len(codes), _MOST_LOOKS)).astype(int)
        times = codes[chosen].tolist() or [_FIRST]
        linear = np.stack([self._transforms_at(t)[0, :, :3] for t in times])
        self._check(np.isfinite(linear).all(), "a transform that is not finite")
        return facing(linear)[1]

    def _check(self, valid: Any, problem: str) -> None:
        """Raise a FormatError with the text `problem` unless `valid` is true."""
        check(valid, f"{self.prim.GetPath()}: {problem}")

    def _read_polygons(self) -> None:
        mesh = UsdGeom.Mesh(self.prim)
        found = []
        for attribute in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()):
            self._check(len(attribute.GetTimeSamples()) < 2, "its topology changes over time")
            found.append(np.array(attribute.Get(_FIRST) or [], dtype=np.int64))
        self.counts, indices = found
        check_polygons(self.counts, indices, self.n_points, str(self.prim.GetPath()))
        self.corners, self.polygon = cut(self.counts, indices, self.raw_points(_FIRST))
        if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            self.corners = self.corners[:, ::-1]
        self.faces = indices[self.corners]

    def _at_corners(self, primvar: Any, width: int) -> Any:
        """Values (T, 3, `width`) of a primvar, or None if there are none that match the mesh."""
        if not (primvar and primvar.HasValue()):
            return None
        values = np.array(primvar.ComputeFlattened(_FIRST), dtype=np.float32).reshape(-1, width)
        what = f"{self.prim.GetPath()}: {primvar.GetPrimvarName()}"
        return at_corners(self, values, str(primvar.GetInterpolation()), what)

    @property
    def uv(self) -> NDArray[np.float32] | None:
        api = UsdGeom.PrimvarsAPI(self.prim)
        types = (Sdf.ValueTypeNames.TexCoord2fArray, Sdf.ValueTypeNames.Float2Array)
        usable = [p for p in api.GetPrimvarsWithValues() if p.GetTypeName() in types]
        usable.sort(key=lambda primvar: primvar.GetPrimvarName() != "st")
        found: NDArray[np.float32] | None = self._at_corners(usable[0], 2) if usable else None
        return found

    @property
    def colors(self) -> NDArray[np.float32] | None:
        api = UsdGeom.PrimvarsAPI(self.prim)
        found = self._at_corners(api.GetPrimvar("displayColor"), 3)
        if found is None:
            return None
        alpha = self._at_corners(api.GetPrimvar("displayOpacity"), 1)
        return opaque(found if alpha is None else np.concatenate([found, alpha], axis=2))

    @property
    def normals(self) -> NDArray[np.float32] | None:
        found = self._at_corners(UsdGeom.PrimvarsAPI(self.prim).GetPrimvar("normals"), 3)
        values = UsdGeom.Mesh(self.prim).GetNormalsAttr().Get(_FIRST)
        if found is None and values is not None:
            how = str(UsdGeom.Mesh(self.prim).GetNormalsInterpolation())
            rows = np.array(values, dtype=np.float32).reshape(-1, 3)
            found = at_corners(self, rows, how, f"{self.prim.GetPath()}: normals")
        return None if found is None else unit(found).astype(np.float32)

    def shown(self, codes: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Mask (F,) of the frames in which the mesh is visible."""
        seen = UsdGeom.Imageable(self.prim)
        if not visibility_codes(self.prim):
            return np.ones(len(codes), dtype=bool)
        states = [seen.ComputeVisibility(float(code)) for code in codes]
        return np.array([one != UsdGeom.Tokens.invisible for one in states])

    def _read_influences(self) -> None:
        query = self._query
        linear = str(query.GetSkinningMethod()) != "dualQuaternion"
        self._check(linear, "dual quaternion skinning; linear blend skinning is read")
        found = query.ComputeVaryingJointInfluences(self.n_points)
        self._check(found, "its joint influences do not match its points")
        indices = np.array(found[0], dtype=np.int64).reshape(self.n_points, -1)
        weights = np.array(found[1], dtype=np.float64).reshape(self.n_points, -1)
        joints = [str(token) for token in self.joints.GetJointOrder()]
        self._order = [str(token) for token in query.GetJointOrder() or ()] or joints
        what = f"{self.path}: {self.prim.GetPath()}"
        self.indices, self.weights = file_weights(indices, weights, len(self._order), what)
        self.n_bones = len(self._order)
        self._bind = np.array(query.GetGeomBindTransform(), dtype=np.float64).T
        known = set(joints) >= set(self._order)
        self._check(known, "it names joints that its skeleton does not have")
        self._rows = [joints.index(token) for token in self._order]
        place = str(self.joints.GetSkeleton().GetPrim().GetPath())
        self.skeleton = place, tuple(self._order), self._bind.tobytes()

    def _frames(self, transforms: Any) -> NDArray[np.float64]:
        """Matrices (B, 4, 4) of this mesh's joints, for column vectors.

        `transforms` holds USD's matrices of all the skeleton's joints, which are for row vectors.
        """
        usable = transforms and len(transforms) == len(self.joints.GetJointOrder())
        self._check(usable, "its skeleton has no usable bind or rest transforms")
        frames = np.array(transforms, dtype=np.float64).reshape(-1, 4, 4)
        return np.swapaxes(frames, 1, 2)[self._rows]

    def _binds(self) -> NDArray[np.float64]:
        """Matrices (B, 4, 4) of the joints in the bind pose, in the space of the mesh's points."""
        frames = self._frames(self.joints.GetJointWorldBindTransforms())
        flat = np.linalg.det(self._bind) == 0
        self._check(not flat, "its geomBindTransform is flat")
        return np.asarray(np.linalg.solve(self._bind, frames))

    def bones(self, transforms: NDArray[np.float64]) -> Bones:
        """Bones of the mesh with the given `transforms`; without a skin, one without a parent."""
        if self.joints is None:
            name = str(self.prim.GetName())
            return Bones([name], np.full(1, -1), np.zeros((1, 3)), transforms)
        parents = UsdSkel.Topology(self._order).GetParentIndices()
        # The skeleton may name its joints; if it does not, names are the last parts of their paths.
        names = [token.rsplit("/", 1)[-1] for token in self._order]
        stated = self.joints.GetSkeleton().GetJointNamesAttr().Get() or ()
        if len(stated) == len(self.joints.GetJointOrder()):
            names = [str(stated[k]) for k in self._rows]
        return Bones(names, np.array(parents), self._binds()[:, :3, 3], transforms)

    def stamps(self) -> NDArray[np.float64]:
        """Time codes of all samples of the points, joints, blend shapes and transforms."""
        found = list(self.attribute.GetTimeSamples())
        if self.joints is not None and self.joints.GetAnimQuery():
            found += self.joints.GetAnimQuery().GetJointTransformTimeSamples()
        if self._shapes is not None:
            found += self._shaper.GetBlendShapeWeightTimeSamples()
        return np.array(found + self._moves(), dtype=np.float64)

    def _moves(self) -> list[float]:
        """Time codes at which the transform of the mesh has samples, or that of a prim above it.

        With a skin, these are the transforms of the skeleton and of the prims above it.
        """
        prim = self.prim if self.joints is None else self.joints.GetPrim()
        moved = upwards(prim, UsdGeom.Xformable)
        return [code for one in moved for code in one.GetTimeSamples()]

    def raw_points(self, code: Any) -> NDArray[np.float64]:
        """Points ``(V, 3)`` at the time `code`, without blend shapes."""
        values = self.attribute.Get(code)
        self._check(values is not None and len(values), "no points")
        return np.array(values, dtype=np.float64)

    def shape(self, codes: NDArray[np.float64]) -> Shape:
        """Points before skinning; if they change, a function from frame to points.

        `codes` (F,) are the time codes of the frames.
        """
        moving = len(self.attribute.GetTimeSamples()) > 1
        if self._shapes is not None:
            moving |= self._shaper.BlendShapeWeightsMightBeTimeVarying()
        if moving:
            return lambda frame: self._points(float(codes[frame]))
        return self._points(float(codes[0]))

    def at_rest(self, codes: NDArray[np.float64]) -> tuple[NDArray[np.float64], Shapes | None]:
        """Points before blend shapes and skinning, and the blend shapes with their amounts.

        An inbetween is a separate shape.
        """
        if self._shapes is None:
            points = self.shape(codes)
            self._check(not callable(points), "its points move; ssdr.load bakes them")
            return points, None  # type: ignore[return-value]  # an array, as was checked
        still = len(self.attribute.GetTimeSamples()) < 2
        self._check(still, "its points move beside blend shapes; ssdr.load bakes them")
        offsets, points = self._shapes.ComputeSubShapePointOffsets(), self.raw_points(_FIRST)
        used = [part for part, blend in enumerate(offsets) if len(blend)]  # some stand for weight 0
        amounts = np.zeros((len(codes), len(offsets)))
        for row, code in zip(amounts, codes, strict=True):
            for amount, _, part in self._amounts(float(code)):
                row[part] += amount
        moved = np.zeros((len(used), *points.shape))
        for into, part in zip(moved, used, strict=True):
            self._displace(into, 1.0, self._shapes.GetBlendShapeIndex(part), offsets[part])
        names = [self._shape_name(part) for part in used]
        return points, Shapes(moved, amounts[:, used], names=names) if used else None

    def _shape_name(self, part: int) -> str:
        """Name of a subshape: that of its blend shape or, for an inbetween, its own."""
        inbetween = self._shapes.GetInbetween(part)
        if inbetween:
            return str(inbetween.GetAttr().GetBaseName())
        return str(
            self._shapes.GetBlendShape(self._shapes.GetBlendShapeIndex(part)).GetPrim().GetName()
        )

    def _points(self, code: float) -> NDArray[np.float64]:
        points = self.raw_points(code)
        problem = f"{self.n_points} points at first, {len(points)} at {code:g}"
        self._check(len(points) == self.n_points, problem)
        if self._shapes is None:
            return points
        offsets = self._shapes.ComputeSubShapePointOffsets()
        for amount, shape, part in self._amounts(code):
            self._displace(points, amount, shape, offsets[part])
        return points

    def _amounts(self, code: float) -> list[tuple[float, int, int]]:
        """Amount, blend-shape index and subshape index of each active subshape at time `code`."""
        weights = self._shaper.ComputeBlendShapeWeights(code)
        mapper = self._query.GetBlendShapeMapper()
        if mapper:
            weights = mapper.Remap(weights)
        return list(zip(*self._shapes.ComputeSubShapeWeights(weights), strict=True))

    def _displace(self, points: NDArray[np.float64], amount: float, shape: int, by: Any) -> None:
        """Add `amount` times a subshape's offsets `by` to `points`; `shape` is its blend shape."""
        moved = np.array(by, dtype=np.float64).reshape(-1, 3)
        row = np.array(self._shapes.ComputeBlendShapePointIndices()[shape], dtype=np.int64)
        row = row if len(row) else np.arange(self.n_points)
        fits = len(row) == len(moved) and 0 <= row.min() <= row.max() < self.n_points
        self._check(fits, "a blend shape that does not match its points")
        np.add.at(points, row, amount * moved)

    def transforms(self, codes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transforms ``(F, B, 3, 4)`` of the bones, from the space of the points to world space."""
        if len(np.unique(self.stamps())) < 2:  # nothing moves, however long the clip is
            still = self._transforms_at(float(codes[0]))
            return np.broadcast_to(still, (len(codes), *still.shape))
        return np.stack([self._transforms_at(float(code)) for code in codes])

    def _transforms_at(self, code: float) -> NDArray[np.float64]:
        world = UsdGeom.XformCache(code)
        if self.joints is None:
            return np.array(world.GetLocalToWorldTransform(self.prim)).T[None, :3]
        place = np.array(world.GetLocalToWorldTransform(self.joints.GetPrim())).T
        frames = self._frames(self.joints.ComputeSkinningTransforms(code))
        return np.asarray((place @ frames @ self._bind)[:, :3])


class SkeletonPoints(MeshPrim):
    """The joints of a skeleton that moves no mesh, with a vertex at each, as a `ScenePart`."""

    def __init__(self, path: Path, skeleton: Any) -> None:
        self.path, self.prim, self.joints = path, skeleton.GetPrim(), skeleton
        self.name = str(self.prim.GetName())
        self.attribute = skeleton.GetSkeleton().GetJointsAttr()
        self._order = [str(token) for token in skeleton.GetJointOrder()]
        self.n_points = self.n_bones = len(self._order)
        self._rows, self._bind, self._shapes = list(range(self.n_bones)), np.eye(4), None
        self.skeleton = str(self.prim.GetPath())
        self.indices, self.weights, self.faces = vertices_at_joints(self.n_bones)
        self.corners = self.faces
        self.counts = self.polygon = np.zeros(0, dtype=np.int64)

    def shape(self, codes: NDArray[np.float64]) -> Shape:
        """Joints in the bind pose."""
        return np.asarray(self._binds()[:, :3, 3])
