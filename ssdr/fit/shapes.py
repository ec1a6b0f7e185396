"""``ssdr.fit_shapes``: displacements of the rest pose that reproduce what bones do not."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import check_floats, check_whole, parse_tolerance
from ..errors import InputError
from ..frames.vector_fit import fit_vectors
from ..hierarchy.transforms import rest_diagonal
from ..parallel import serial_blas
from ..problem.check import check_problem
from ..search.solve import solve
from ..sequence import MeshSequence
from ..shapes import Shapes
from ..skinning import Skinning, check_skinning
from ..storage.size import key_bytes
from .fit import Fit, checked

Array = NDArray[np.float64]

_PULL = 1e-9  # pull towards displacements of 0, relative to the sum of squared amounts
_FLAT = 0.1  # singular values of a blended matrix below this share of the largest are not inverted
_ROUNDS = 8  # alternations
_SETTLED = 1e-3  # relative fall of the error below which they end
_MOST = 64  # shapes that are tried for a tolerance
_SURELY_BONES = 0.3  # a worth below this, found with half the bones, is not checked with more bones


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ShapeFit(Fit):
    """A model with shapes, or without them if bones use the bytes better, and its error.

    Attributes
    ----------
    max_error : float
        Largest distance of a vertex from its place in the sequence.
    displaced : int
        Number of displacements that are not 0.
    worth : float or None
        Number of bones that a shape replaces, divided by the number of bones that take the bytes of
        a shape.  Unless amounts are given, a model gets shapes only if this is above 1.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> fit = ssdr.fit_shapes(dancer, ssdr.initialize(dancer, bones=4), shapes=2)
    >>> (fit.skinning.shapes is None) == (fit.worth <= 1)
    True
    """

    max_error: float
    displaced: int
    worth: float | None = None


def fit_shapes(
    sequence: MeshSequence | Any,
    skinning: Skinning,
    *,
    tolerance: float | str | None = None,
    shapes: int | None = None,
    amounts: Any = None,
    names: Any = None,
) -> ShapeFit:
    """Fit shapes to a model: displacements of its rest pose, added before bones move it.

    If `amounts` are given, such as those of facial expressions, a shape may displace only those
    vertices whose error exceeds the tolerance in some frame where the shape's amount is not 0.
    Otherwise amounts and displacements are solved in turns.  They start from the principal
    components of the residual that bones leave, mapped back to the rest pose.

    A shape takes the bytes of many bones.  Without `amounts`, shapes are kept only if more bones
    of the same bytes would lower the error less.  Let s be the fraction of the squared residual
    that k shapes remove, and g the fall of the logarithm of the squared error per further bone.  A
    shape then replaces −ln(1 − s) / (k g) bones.  g is taken from a quick search with half the
    bones or, if that is not decisive, with additional bones that take as many bytes as the shapes.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
        Held in memory.
    skinning : Skinning
        A model of these frames without shapes.  Its bones and weights stay; its rest pose stays if
        amounts are given.
    tolerance : float or str, optional
        A length, or a share of the diagonal such as ``"0.1%"``.  With `amounts` it is the largest
        distance of a vertex from its place, without them the root mean square.
    shapes : int, optional
        Number of shapes; only without `amounts` and a tolerance.
    amounts : (F, S) array, optional
        Amount of each shape in every frame; that of an expression is 1 in the expression's frame.
    names : sequence of str, optional
        Names of the shapes.

    Returns
    -------
    ShapeFit
        Amounts that were found are between 0 and 1.

    Raises
    ------
    InputError
        If an argument is not usable, or the model has shapes already.

    References
    ----------
    Displacements by a threshold, as corrections of a skin: Kavan et al., "Compressed skinning for
    facial blendshapes", 2024, section 2.  Components of residuals mapped back to the rest pose:
    Kavan, Sloan and O'Sullivan, "Fast and efficient skinning of animated meshes", 2010.

    Examples
    --------
    A cube's corner moves on its own in the second frame:

    >>> rest = np.array(list(np.ndindex(2, 2, 2)), float)
    >>> frames = np.stack([rest, rest])
    >>> frames[1, 7] += 0.5
    >>> still = ssdr.Skinning.from_dense(rest, np.ones((8, 1)), np.tile(np.eye(3, 4), (2, 1, 1, 1)))
    >>> fit = ssdr.fit_shapes(frames, still, tolerance=0.1, amounts=[[0], [1]])
    >>> fit.displaced, round(fit.rmse, 6)
    (1, 0.0)
    """
    given = checked(sequence, check_skinning(skinning))
    model, n_frames = dataclasses.replace(given.skinning, rest=given.rest), given.n_frames
    given.transforms()
    truth = np.concatenate([np.asarray(s.frames(slice(None)), float) for s in given.sequences])
    limit = None
    if tolerance is not None:
        limit = parse_tolerance(tolerance, rest_diagonal(model.rest))
    left = truth - model.skin(dtype=np.float64)
    if amounts is not None:
        if limit is None or shapes is not None:
            raise InputError("tolerance", "one, and no number of shapes, beside amounts", tolerance)
        factors = check_floats(amounts, "amounts", (n_frames, "S"))
        check_whole(factors.shape[1], "amounts", 1, n_frames, " (shapes, no more than frames)")
        return _measured(truth, _displaced(model, left, factors, limit, names))
    if (limit is None) == (shapes is None):
        raise InputError("tolerance", "either a tolerance or a number of shapes", "both or none")
    rms = math.sqrt(float((left**2).sum()) / left[..., 0].size)
    if rms <= 1e-12 * (rest_diagonal(model.rest) or 1.0) or (limit is not None and rms <= limit):
        return _measured(truth, model)
    if limit is None:
        found = some_shapes(truth, model, check_whole(shapes, "shapes", 1, n_frames), names)
    else:
        found = shapes_within(truth, model, limit, names)
    worth = _worth(given.sequences, model, rms, found.rmse, found.skinning.n_shapes)
    found = found if worth > 1 else _measured(truth, model)
    return dataclasses.replace(found, worth=worth)


def some_shapes(truth: Array, model: Skinning, count: int, names: Any = None) -> ShapeFit:
    """Fit `count` shapes to a model, whether or not bones would use their bytes better."""
    left = truth - model.skin(dtype=np.float64)
    amounts = components(model, left)[0][:, :count]
    return _measured(truth, _alternated(model, left, amounts, names))


def shapes_within(truth: Array, model: Skinning, limit: float, names: Any = None) -> ShapeFit:
    """Fit as few shapes as bring the error of a model down to `limit`, but at most 64."""
    left = truth - model.skin(dtype=np.float64)
    amounts, errors = components(model, left)
    most = min(_MOST, len(errors))
    count = min(int((errors > limit).sum()) + 1, most)
    while True:
        found = _measured(truth, _alternated(model, left, amounts[:, :count], names))
        if found.rmse <= limit or count >= most:
            return found
        count = min(count + max(1, count // 8), most)


def _displaced(model: Skinning, left: Array, amounts: Any, limit: float, names: Any) -> Skinning:
    """Copy of a model with shapes, which displace only vertices whose error exceeds `limit`."""
    far = np.linalg.norm(left, axis=2) > limit
    keep = (np.abs(amounts) > 0).T.astype(np.float64) @ far > 0
    start = np.zeros((1 + len(keep), model.n_vertices, 3))
    bare = Shapes(start[1:], amounts, names=names)
    used = np.concatenate([np.zeros_like(keep[:1]), keep])
    found = _vectors(dataclasses.replace(model, shapes=bare), left, used, start)
    return dataclasses.replace(model, shapes=dataclasses.replace(bare, displacements=found[1:]))


def _vectors(model: Skinning, left: Array, used: NDArray[np.bool_], start: Array) -> Array:
    every = np.arange(model.n_frames)
    each = np.arange(model.n_vertices)
    return fit_vectors(model, every, left, vertex=each, used=used, start=start, pull=_PULL)


def _blended(model: Skinning) -> Array:
    """Blended 3×3 matrix of each vertex in every frame, ``(F, V, 3, 3)``."""
    weights = model.sparse_weights().astype(np.float64)
    linear = np.asarray(model.transforms, dtype=np.float64)[..., :3].swapaxes(0, 1)
    turns = weights @ linear.reshape(model.n_bones, -1)
    return np.asarray(turns).reshape(model.n_vertices, -1, 3, 3).swapaxes(0, 1)


@serial_blas()
def components(model: Skinning, left: Array) -> tuple[Array, Array]:
    """Amounts ``(F, P)`` of principal components, and the RMS error that the first of them leave.

    The components are those of the residual `left` (F, V, 3) of a model, mapped back to the rest
    pose.
    """
    turns = _blended(model)
    size = np.linalg.norm(turns, axis=(2, 3))[..., None] / math.sqrt(3)
    back = (np.linalg.pinv(turns, rcond=_FLAT) @ left[..., None])[..., 0]
    mean = (size**2 * back).sum(axis=0) / np.maximum((size**2).sum(axis=0), 1e-300)
    rows = (size * (back - mean)).reshape(len(left), -1)
    values, vectors = np.linalg.eigh(rows @ rows.T)
    values = np.maximum(values[::-1], 0.0)
    constant = float(((size * mean) ** 2).sum())
    lost = 1 - (constant + np.cumsum(values)) / max(constant + float(values.sum()), 1e-300)
    return vectors[:, ::-1], np.sqrt(3 * np.maximum(lost, 0) * (left**2).mean())


@serial_blas()
def _alternated(model: Skinning, left: Array, amounts: Array, names: Any) -> Skinning:
    """Copy of a model with shapes, found by solving for displacements and amounts in turns.

    Its rest pose may move.
    """
    turns, error = _blended(model), math.inf
    count = amounts.shape[1]
    used = np.ones((1 + count, model.n_vertices), dtype=bool)
    start = np.zeros((*used.shape, 3))
    for _ in range(_ROUNDS):
        shaped = dataclasses.replace(model, shapes=Shapes(start[1:], amounts, names=names))
        rest, *moved = _vectors(shaped, left, used, start)
        posed = np.stack([(turns @ d[..., None]).reshape(len(left), -1) for d in moved], axis=1)
        goal = (left - (turns @ rest[..., None])[..., 0]).reshape(len(left), -1, 1)
        gram = posed @ posed.swapaxes(1, 2)
        gram += 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(count)
        amounts = np.linalg.solve(gram + 1e-300 * np.eye(count), posed @ goal)[..., 0]
        before, error = error, float(((goal[..., 0] - (amounts[:, None] @ posed)[:, 0]) ** 2).sum())
        if error > (1 - _SETTLED) * before:
            break
    low, span = amounts.min(axis=0), np.ptp(amounts, axis=0)
    scale = np.where(span > 0, span, 1.0)
    both = np.stack(moved)
    shapes = Shapes(scale[:, None, None] * both, (amounts - low) / scale, names=names)
    rest = np.asarray(model.rest) + rest + np.tensordot(low, both, 1)
    return dataclasses.replace(model, rest=rest, shapes=shapes)


def _worth(
    sequences: list[MeshSequence], model: Skinning, rms: float, left: float, count: int
) -> float:
    """`worth` of :class:`ShapeFit` for `count` shapes that lower the RMSE from `rms` to `left`."""
    bones = model.n_bones
    each = float(key_bytes(model).mean()) * model.n_frames
    cost = (12 * model.n_vertices + 4 * model.n_frames) / each
    gain = 2 * math.log(rms / max(left, 1e-9 * rms)) / (count * cost)

    def error(number: int) -> float:
        options: dict[str, Any] = {"bones": number, "bone_model": model.bone_model}
        options |= {"influences": min(8, model.n_influences), "effort": "fast", "rng": 0}
        return min(solve(check_problem(sequences, None, **options)).rmse, 1e9 * rms)

    worth = math.inf
    if bones > 1:
        # squared errors fall about as a power of the number of bones, most steeply at first
        half = bones // 2
        power = 2 * math.log(max(error(half) / rms, 1.0)) / math.log(bones / half)
        worth = gain / max(power / bones, 1e-12)
    most = bones + max(1, round(count * cost))
    if _SURELY_BONES <= worth <= 1 or (bones == 1 and most <= model.n_vertices):
        fall = 2 * math.log(max(rms / max(error(most), 1e-9 * rms), 1.0))
        worth = gain / max(fall / (most - bones), 1e-12)
    return worth


def _measured(truth: Array, model: Skinning) -> ShapeFit:
    squares = ((model.skin(dtype=np.float64) - truth) ** 2).sum(axis=2)
    return ShapeFit(
        skinning=model,
        squared_error=squares.sum(axis=0),
        rmse=math.sqrt(float(squares.mean())),
        max_error=math.sqrt(float(squares.max())),
        displaced=0 if model.shapes is None else int(model.shapes.moved.sum()),
    )
