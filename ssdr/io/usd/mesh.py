"""One mesh of a stage: its points, and what moves them."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...skinning import skin
from .surface import Polygons

__all__ = ["Mesh"]

_log = logging.getLogger(__name__)


class Mesh:
    """One mesh prim and what moves it."""

    def __init__(self, path: Path, prim: Any, skeleton: Any, query: Any) -> None:
        from pxr import Usd, UsdGeom, UsdSkel

        self.path, self.prim = path, prim
        self.polygons = Polygons(path, prim)
        self._attribute = UsdGeom.Mesh(prim).GetPointsAttr()
        self._skeleton: Any = skeleton if query is not None and query.HasJointInfluences() else None
        self._query = query
        self._shapes = None
        if query is not None and query.HasBlendShapes() and skeleton.GetAnimQuery():
            self._shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
            self._shaper = skeleton.GetAnimQuery()
        self.n_points = len(self._raw(Usd.TimeCode.EarliestTime()))
        self.polygons.check(self.n_points)
        self.bones_key: Any = str(prim.GetPath())
        self.bone_names = [str(prim.GetName())]
        self.indices = np.zeros((self.n_points, 1), dtype=np.int32)
        self.weights = np.ones((self.n_points, 1))
        if self._skeleton is not None:
            self._read_influences()

    def _fail(self, what: str) -> FormatError:
        return FormatError(f"{self.path}: {self.prim.GetPath()}: {what}")

    def _read_influences(self) -> None:
        query = self._query
        if str(query.GetSkinningMethod()) == "dualQuaternion":
            raise self._fail("dual quaternion skinning; linear blend skinning is read")
        found = query.ComputeVaryingJointInfluences(self.n_points)
        if not found:
            raise self._fail("its joint influences do not match its points")
        indices = np.array(found[0], dtype=np.int64).reshape(self.n_points, -1)
        weights = np.array(found[1], dtype=np.float64).reshape(self.n_points, -1)
        order = query.GetJointOrder() or self._skeleton.GetJointOrder()
        if not indices.shape[1] or indices.min() < 0 or indices.max() >= len(order):
            raise self._fail(f"a joint index outside 0 to {len(order) - 1}")
        total = weights.sum(axis=1, keepdims=True)
        if not np.isfinite(weights).all() or (weights < 0).any() or (total <= 0).any():
            raise self._fail("skin weights that are negative, not finite or all zero")
        if np.abs(total - 1).max() > 1e-3:
            _log.warning("%s: skin weights that do not sum to 1 are scaled", self.prim.GetPath())
        self.indices = np.where(weights > 0, indices, 0).astype(np.int32)
        self.weights = weights / total
        self._bind = np.array(query.GetGeomBindTransform(), dtype=np.float64).T
        self._order = [str(token) for token in order]
        known = {str(token): k for k, token in enumerate(self._skeleton.GetJointOrder())}
        if not known.keys() >= set(self._order):
            raise self._fail("it names joints that its skeleton does not have")
        self._rows = [known[token] for token in self._order]
        self.bone_names = self._names()
        place = str(self._skeleton.GetSkeleton().GetPrim().GetPath())
        self.bones_key = (place, tuple(map(str, order)), self._bind.tobytes())

    def _names(self) -> list[str]:
        """What the skeleton calls its joints, else the last part of their paths."""
        skeleton = self._skeleton.GetSkeleton()
        said = [str(name) for name in skeleton.GetJointNamesAttr().Get() or ()]
        if len(said) == len(self._skeleton.GetJointOrder()):
            return [said[k] for k in self._rows]
        return [token.rsplit("/", 1)[-1] for token in self._order]

    def _binds(self) -> NDArray[np.float64]:
        """Joints' frames (B, 4, 4) of the bind pose, in the space of the points."""
        found = self._skeleton.GetJointWorldBindTransforms()
        if found is None or len(found) != len(self._skeleton.GetJointOrder()):
            raise self._fail("its skeleton has no usable bind or rest transforms")
        frames = np.swapaxes(np.array(found, dtype=np.float64).reshape(-1, 4, 4), 1, 2)
        try:
            return np.asarray(np.linalg.solve(self._bind, frames[self._rows]))
        except np.linalg.LinAlgError:
            raise self._fail("its geomBindTransform is flat") from None

    def hierarchy(self) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Parents (B,) and joints (B, 3) among the points: a mesh without a skin hangs on none."""
        if self._skeleton is None:
            return np.full(1, -1, dtype=np.int32), np.zeros((1, 3))
        number = {token: k for k, token in enumerate(self._order)}
        parents = []
        for token in self._order:
            above = token.rpartition("/")[0]
            while above and above not in number:
                above = above.rpartition("/")[0]
            parents.append(number[above] if above else -1)
        return np.array(parents, dtype=np.int32), self._binds()[:, :3, 3]

    @property
    def has_axes(self) -> bool:
        """True where joints of the bind pose are turned against the axes of the points."""
        if self._skeleton is None:
            return False
        return bool(np.abs(self._binds()[:, :3, :3] - np.eye(3)).max() > 1e-6)

    @property
    def deforms(self) -> bool:
        if len(self._attribute.GetTimeSamples()) > 1:
            return True
        return self._shapes is not None and self._shaper.BlendShapeWeightsMightBeTimeVarying()

    def stamps(self) -> NDArray[np.float64]:
        """Time codes at which anything about this mesh is sampled."""
        from pxr import UsdGeom

        found = list(self._attribute.GetTimeSamples())
        if self._skeleton is not None and self._skeleton.GetAnimQuery():
            found += self._skeleton.GetAnimQuery().GetJointTransformTimeSamples()
        if self._shapes is not None:
            found += self._shaper.GetBlendShapeWeightTimeSamples()
        prim = self.prim if self._skeleton is None else self._skeleton.GetPrim()
        while prim and not prim.IsPseudoRoot():
            if prim.IsA(UsdGeom.Xformable):
                found += UsdGeom.Xformable(prim).GetTimeSamples()
            prim = prim.GetParent()
        return np.array(found, dtype=np.float64)

    def _raw(self, code: Any) -> NDArray[np.float64]:
        values = self._attribute.Get(code)
        if values is None or not len(values):
            raise self._fail("no points")
        return np.array(values, dtype=np.float64)

    def points(self, code: float) -> NDArray[np.float64]:
        """Points before skinning ``(V, 3)``, blend shapes applied."""
        points = self._raw(code)
        if len(points) != self.n_points:
            raise self._fail(f"{self.n_points} points at first, {len(points)} at {code:g}")
        if self._shapes is None:
            return points
        weights = self._shaper.ComputeBlendShapeWeights(code)
        mapper = self._query.GetBlendShapeMapper()
        if mapper:
            weights = mapper.Remap(weights)
        amounts, shapes, parts = self._shapes.ComputeSubShapeWeights(weights)
        rows, offsets = (
            self._shapes.ComputeBlendShapePointIndices(),
            self._shapes.ComputeSubShapePointOffsets(),
        )
        for amount, shape, part in zip(amounts, shapes, parts, strict=True):
            moved = np.array(offsets[part], dtype=np.float64).reshape(-1, 3)
            row = np.array(rows[shape], dtype=np.int64)
            row = row if len(row) else np.arange(self.n_points)
            if len(row) != len(moved) or row.min() < 0 or row.max() >= self.n_points:
                raise self._fail("a blend shape that does not match its points")
            np.add.at(points, row, amount * moved)
        return points

    def transforms(self, codes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transforms ``(F, B, 3, 4)`` from points to world space."""
        return np.stack([self._transforms_at(code) for code in codes])

    def _transforms_at(self, code: float) -> NDArray[np.float64]:
        from pxr import UsdGeom

        world = UsdGeom.XformCache(code)
        if self._skeleton is None:
            return np.array(world.GetLocalToWorldTransform(self.prim)).T[None, :3]
        found = self._skeleton.ComputeSkinningTransforms(code)
        if not found:
            raise self._fail("its skeleton has no usable bind or rest transforms")
        place = np.array(world.GetLocalToWorldTransform(self._skeleton.GetPrim())).T
        matrices = np.swapaxes(np.array(found, dtype=np.float64).reshape(-1, 4, 4), 1, 2)
        return np.asarray((place @ matrices[self._rows] @ self._bind)[:, :3])

    def bake(self, codes: NDArray[np.float64], out: NDArray[np.float32]) -> None:
        """Points in world space at each time code."""
        for frame, code in enumerate(codes):
            out[frame] = skin(
                self.points(float(code)),
                self.indices,
                self.weights,
                self._transforms_at(float(code)),
                dtype=np.float64,
            )
