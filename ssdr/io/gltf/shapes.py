"""Morph targets of a skinned mesh in a glTF document."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import check_floats
from ...errors import InputError
from ...normals import normal_holders, surface_normals
from ...parallel import chunk_bounds, run_chunks, serial_blas
from ...skinning import Skinning, skin
from ..corners import Corners
from .builder import ARRAY, Builder

_PULL = 1e-3  # towards the normals to begin with, relative to the sum of squared amounts
_LEAST = 1e-6  # length of a fitted normal: less has no direction
_MOST = 500  # frames that normals are fitted to
_NUMBERS = 1 << 22  # in an array of a task


@dataclasses.dataclass(frozen=True, eq=False)
class Shapes:
    """Displacements of the rest pose, added before it is skinned.

    Parameters
    ----------
    displacements : (M, V, 3) array
        Metres, y up.
    amounts : (F, M) array
        Factor of each displacement in every frame.  Programs that show the mesh without its
        animation use the mean over the frames.  Blender and Unity clamp factors to 0 to 1.

    Raises
    ------
    InputError
        If shapes do not match or a number is not finite.
    """

    displacements: Any
    amounts: Any

    def __post_init__(self) -> None:
        moved = check_floats(self.displacements, "displacements", ("M", "V", 3))
        amounts = check_floats(self.amounts, "amounts", ("F", "M"))
        object.__setattr__(self, "displacements", moved)
        object.__setattr__(self, "amounts", amounts)
        if len(moved) != amounts.shape[1]:
            raise InputError("amounts", f"{len(moved)} columns", amounts.shape[1])

    def check(self, model: Skinning) -> None:
        """Raise InputError if the numbers of vertices and frames differ from the model's."""
        expected = model.n_frames, model.n_vertices
        found = len(self.amounts), self.displacements.shape[1]
        if expected != found:
            text = "{} frames and {} vertices".format
            raise InputError("shapes", text(*expected), text(*found))

    @serial_blas()
    def normals(
        self, model: Skinning, given: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Normals ``(T, 3, 3)`` of the rest pose, and what each shape adds to them (M, T, 3, 3).

        With a_t the amounts in frame t, an engine draws the direction A_t (n + Σ_s a_ts d_s), where
        A_t is the blended 3×3 matrix.  n and d come as close as they can, by least squares, to the
        normals of the model's own surface in all frames, or in 500 of them.  Where these leave n
        and d open, `given` normals are kept, and each shape adds the change of the rest pose's own.
        """
        holders = normal_holders(model.faces, model.n_vertices, model.surface)
        rest, count = np.asarray(model.rest, dtype=np.float64), len(holders.vertex)
        posed = surface_normals(np.concatenate([rest[None], rest + self.displacements]), holders)
        start = posed - posed[:1]
        start[0, holders.corner] = given
        frames = np.linspace(0, model.n_frames - 1, min(_MOST, model.n_frames)).astype(int)
        factors = np.concatenate([np.ones((len(frames), 1)), self.amounts[frames]], axis=1)
        transforms = np.asarray(model.transforms, dtype=np.float64)[frames]
        targets = np.empty((len(frames), count, 3))
        for t, amounts in enumerate(self.amounts[frames]):
            shaped = rest + np.tensordot(amounts, self.displacements, 1)
            moved = skin(shaped, model.indices, model.weights, transforms[t])
            targets[t] = surface_normals(moved[None], holders)[0]
        pairs = (factors[:, :, None] * factors[:, None]).reshape(len(frames), -1).T
        squares, n_unknown = (factors**2).sum(axis=0), factors.shape[1]
        pull = _PULL * np.where(squares > 0, squares, 1.0)
        turns = transforms[..., :3].swapaxes(0, 1)
        turns, weights = turns.reshape(model.n_bones, -1), model.sparse_weights()
        found = np.empty((n_unknown, count, 3))

        def work(_: int, i: int, k: int) -> None:
            turn = (weights[holders.vertex[i:k]] @ turns).reshape(k - i, -1, 3, 3).swapaxes(0, 1)
            turn = np.where(np.any(targets[:, i:k], axis=2)[..., None, None], turn, 0.0)
            back = turn.swapaxes(2, 3)
            grams = pairs @ (back @ turn).reshape(len(turn), -1)
            grams = grams.reshape(n_unknown, n_unknown, k - i, 3, 3).transpose(2, 0, 3, 1, 4)
            right = factors.T @ (back @ targets[:, i:k, :, None]).reshape(len(turn), -1)
            right = right.reshape(n_unknown, k - i, 3) + pull[:, None, None] * start[:, i:k]
            system = grams.reshape(k - i, 3 * n_unknown, -1) + np.diag(np.repeat(pull, 3))
            right = right.swapaxes(0, 1).reshape(k - i, -1, 1)
            found[:, i:k] = np.linalg.solve(system, right).reshape(k - i, -1, 3).swapaxes(0, 1)

        run_chunks(work, chunk_bounds(count, max(1, _NUMBERS // (9 * pairs.size))))
        size = np.linalg.norm(found[0], axis=1)
        usable = size > _LEAST
        found[:, usable] /= size[usable, None]
        found[:, ~usable] = start[:, ~usable]
        added = found[:, holders.corner].astype(np.float32)
        return added[0], added[1:]

    def add_targets(
        self, builder: Builder, corners: Corners, normals: NDArray[np.float32]
    ) -> list[Any]:
        """Add the targets and return the "targets" of a primitive's JSON.

        `normals` (M, T, 3, 3) are what each shape adds at the corners.
        """

        def put(array: NDArray[Any], **fields: Any) -> int:
            return builder.accessor(array.astype(np.float32), "VEC3", target=ARRAY, **fields)

        targets = []
        for moved, turned in zip(self.displacements, normals, strict=True):
            added = np.zeros((len(corners.vertex), 3))
            added[corners.faces] = turned
            target = {"POSITION": put(moved[corners.vertex], bounds=True), "NORMAL": put(added)}
            targets.append(target)
        return targets

    def add_channel(
        self, builder: Builder, animation: dict[str, Any], frames: slice, times: int
    ) -> None:
        """Add the amounts in `frames` to an animation of node 0; `times` is an accessor."""
        amounts = self.amounts[frames].astype(np.float32)
        target = {"node": 0, "path": "weights"}
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
        output = builder.accessor(amounts.reshape(-1), "SCALAR")
        animation["samplers"].append({"input": times, "output": output, "interpolation": "LINEAR"})
