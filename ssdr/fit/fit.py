"""Result of fitting one part of a model, and checks of the arguments."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.checks import (
    BoneModel,
    as_array,
    check_bone_model,
    check_dense,
    check_floats,
    check_squarable,
    check_transforms,
)
from ..common.errors import InputError
from ..common.short_repr import short_repr
from ..mesh.clips import names_of
from ..mesh.sequence import MeshSequence, as_sequences, labels_of, without_copies
from ..mesh.surface import told_apart
from ..model.drawn_normals import with_fitted_normals
from ..model.frame_error import rmse_of, squared_error
from ..model.skinning import Skinning, skinning_in
from ..solver.trajectories import Array, Trajectories, gather

_MOST_BONES = 1 << 16  # bound of the number that the largest index implies, as each takes memory


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A model of which one part was fitted, and its error.

    Attributes
    ----------
    skinning : Skinning
    squared_error : (V,) float64
        Squared distance of each vertex from its place in the sequence, summed over the frames.
    rmse : float
        Square root of the mean squared distance over all vertices and frames.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> fit = ssdr.fit_rest_pose(dancer, ssdr.initialize(dancer, bones=4))
    >>> np.allclose(fit.rmse, np.sqrt(fit.squared_error.sum() / (24 * 799)))
    True
    """

    skinning: Skinning
    squared_error: NDArray[np.float64]
    rmse: float

    __repr__ = short_repr


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FitInput:
    """Checked arguments of a fit.

    Attributes
    ----------
    sequences : list of MeshSequence
        The shots.
    skinning : Skinning
        The model; the parts to be fitted have arbitrary values if arrays were given.
    rest, indices, weights : (V, 3) float64, (V, K) int32, (V, K) float64
        Those of the model; rows of weights sum to 1.
    faces : (T, 3) int32
        Triangles of the sequence or, if it has none, of the model.
    prefix : str
        Prefix of the names of the model's arrays in error messages.
    """

    sequences: list[MeshSequence]
    skinning: Skinning
    rest: Array
    indices: NDArray[np.int32]
    weights: Array
    faces: NDArray[np.int32]
    prefix: str

    @property
    def n_frames(self) -> int:
        return sum(len(s) for s in self.sequences)

    def transforms(self) -> Array:
        """Check that the transforms suit the bone model and these frames, and return them."""
        kind = self.skinning.bone_model
        return check_transforms(self.skinning.transforms, self.n_frames, kind, self.prefix)

    def without_copies(
        self, importance: Array | None, *kept: NDArray[Any] | None
    ) -> tuple[FitInput, Array | None, NDArray[np.intp], NDArray[np.intp]]:
        """The arguments for the distinct vertices alone.

        Vertices are distinct if they differ in some frame, or in one of `kept` (V, ...).  Also
        returns the importance of these U vertices, their indices (U,), and for each of the V
        vertices the position, among the U, of the vertex that stands for it.
        """
        label = told_apart(labels_of(self.sequences), *kept)
        sequences, importance, first, row = without_copies(self.sequences, label, importance)
        few = {name: getattr(self, name)[first] for name in ("rest", "indices", "weights")}
        faces = row[self.faces].astype(np.int32)
        given = dataclasses.replace(self, sequences=sequences, faces=faces, **few)
        return given, importance, first, row

    def gathered(
        self, vertex_importance: Array | None = None, frame_importance: Array | None = None
    ) -> tuple[Trajectories, Array, Array]:
        """Trajectories of the shots, and rest pose and transforms, in the solver's space."""
        world = self.transforms()
        data = gather(
            self.sequences,
            bones=world.shape[1],
            vertex_importance=vertex_importance,
            frame_importance=frame_importance,
        )
        inner = data.alignment.points_from_world(self.rest, f"{self.prefix}rest")
        return data, inner, data.alignment.moves_from_world(world, f"{self.prefix}transforms")


def checked(
    sequence: Any, rest: Any, bone_model: BoneModel | None = None, /, **arrays: Any
) -> FitInput:
    """Check the arguments of a fit, and return them as a FitInput.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    rest : (V, 3) array, Skinning, or a result that has one
    bone_model : str, optional
        By default that of the model, or rigid without one.
    **arrays
        Further parts of a model that the fit needs: `indices` and `weights`, `transforms`, or all
        of these; None if `rest` is a model.  Without `indices`, weights are those of all bones.
    """
    sequences = as_sequences(sequence)
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    kind = None if bone_model is None else check_bone_model(bone_model)
    model, prefix = skinning_in(rest), ""
    if isinstance(model, Skinning):
        for name, value in arrays.items():
            if value is not None:
                raise InputError(name, "None beside a Skinning, which has its own", "an array")
        if model.n_vertices != n:
            raise InputError("skinning", f"{n} vertices, as the sequence has", model.n_vertices)
        model, prefix = dataclasses.replace(model, bone_model=kind or model.bone_model), "skinning."
    else:
        if as_array(rest, "rest", "an array (V, 3) or a Skinning").dtype.kind not in "fiu":
            raise InputError("rest", "an array (V, 3) or a Skinning", type(rest).__name__)
        place = check_floats(rest, "rest", (n, 3))
        model = _model(sequences, place, arrays, n_frames, kind or "rigid")
    position = np.asarray(check_floats(model.rest, f"{prefix}rest", (n, 3), copy=True), np.float64)
    check_squarable(position, f"{prefix}rest")
    weights = np.array(model.weights, dtype=np.float64)
    return FitInput(
        sequences=sequences,
        skinning=model,
        rest=position,
        indices=model.indices,
        weights=weights / weights.sum(axis=1, keepdims=True),
        faces=sequences[0].faces if len(sequences[0].faces) else model.faces,
        prefix=prefix,
    )


def _model(
    sequences: list[MeshSequence],
    rest: NDArray[np.floating],
    arrays: dict[str, Any],
    n_frames: int,
    bone_model: BoneModel,
) -> Skinning:
    """A model of the given arrays; missing parts have arbitrary values."""
    for name, value in arrays.items():
        if value is None and name != "indices":
            wanted = "an array beside the rest pose, or a Skinning for it"
            if name == "weights" and arrays["indices"] is not None:
                wanted = "an array beside indices; dense weights (V, B) go in by name, weights="
            raise InputError(name, wanted, "None")
    options: dict[str, Any] = {"faces": sequences[0].faces, "bone_model": bone_model}
    options |= names_of(sequences)
    weights, indices = arrays.get("weights"), arrays.get("indices")
    moves = arrays.get("transforms")
    if moves is not None:
        moves = check_floats(moves, "transforms", (n_frames, "B", 3, 4))
    if weights is None:
        one = np.zeros((len(rest), 1), dtype=np.int32)
        return Skinning(rest, one, np.ones(one.shape), moves, **options)
    if moves is None:
        if indices is None:
            count = check_dense(weights, len(rest)).shape[1]
        else:
            j = as_array(indices, "indices", "integers of shape (V, K)")
            count = int(j.max()) + 1 if j.size and j.dtype.kind in "iu" else 1
            if count > _MOST_BONES:
                raise InputError("indices", f"indices of at most {_MOST_BONES:,} bones", count - 1)
        moves = np.broadcast_to(np.eye(3, 4), (n_frames, max(count, 1), 3, 4))
    if indices is None:
        return Skinning.from_dense(rest, weights, moves, **options)
    return Skinning(rest, indices, weights, moves, **options)


def fit_of(sequences: list[MeshSequence], skinning: Skinning) -> Fit:
    """Fit normals to a model, measure its error on the frames, and return both as a Fit."""
    rest, weights, transforms = (
        np.asarray(a, dtype=np.float64)
        for a in (skinning.rest, skinning.weights, skinning.transforms)
    )
    squared = squared_error(sequences, rest, skinning.indices, weights, transforms)
    return Fit(
        skinning=with_fitted_normals(sequences, skinning),
        squared_error=squared,
        rmse=rmse_of(squared, len(transforms)),
    )
