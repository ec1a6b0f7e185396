"""``ssdr.decompose_expressions``: facial expressions as bones that are driven by weights."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .common.checks import BoneModel, check_floats, names_arguments, parse_tolerance
from .common.errors import InputError
from .common.short_repr import short_repr
from .mesh.clips import Clip, unique_names
from .mesh.sequence import MeshSequence
from .model.shaped_normals import fit_vectors
from .model.shapes import ShapedSkinning, Shapes, Skinned, shaped, skinning_and_shapes
from .model.skinning import Skinning, skinning_in
from .model.start import Kept
from .model.transforms import rest_diagonal
from .search.check_problem import check_problem
from .search.problem import Effort
from .search.schedules import follow_effort
from .search.solve import finished, solve

Array = NDArray[np.float64]

_MOST = 9.0  # importance of a vertex whose error is far beyond the tolerance
# A bone that moves no vertex by more than this share of the tolerance is left out of an expression.
_STILL = 0.2
_PULL = 1e-9  # pull towards displacements of 0, relative to the sum of squared amounts


@dataclasses.dataclass(frozen=True, eq=False)
class Expressions:
    """Facial expressions as a skinned model with one clip per expression, and the model's error.

    Attributes
    ----------
    skinning : ShapedSkinning
        A clip of two frames for each expression: the neutral face, and the expression.  Without a
        tolerance it has no shapes.
    rmse : float
        Root mean square distance of the vertices from those of the expressions.
    max_error : float
        Largest such distance.
    displaced : int
        Number of displaced vertices, summed over the shapes of the model.

    Examples
    --------
    >>> neutral = ssdr.samples.load("dancer_small").vertices[0]
    >>> faces = ssdr.decompose_expressions(neutral, [neutral + 1], bones=1, names=["shift"])
    >>> faces.names, faces.rmse < 1e-5
    (('shift',), True)
    """

    skinning: ShapedSkinning
    rmse: float
    max_error: float
    displaced: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the expressions."""
        return tuple(clip.name for clip in self.skinning.clips)

    __repr__ = short_repr


@names_arguments
def decompose_expressions(
    neutral: Any,
    expressions: Any = None,
    *,
    bones: int,
    influences: int = 8,
    tolerance: float | str | None = None,
    names: Sequence[str] | None = None,
    faces: Any = None,
    effort: Effort = "fast",
    bone_model: BoneModel = "rigid",
    rng: int | np.random.Generator = 0,
    time_limit: float | None = None,
) -> Expressions:
    """Find bones driven by the weights of facial expressions, and displacements for what they miss.

    The neutral face is the rest pose, and the transform of bone j in expression k is I + N_kj.
    With weights c it is I + Σ_k c_k N_kj (:func:`drive`), so that expressions add as those of
    blend shapes do.  Vertices that are farther than the tolerance from their target get
    displacements, which have the weight of the expression and are transformed by the bones.

    Parameters
    ----------
    neutral : (V, 3) array, MeshSequence, Skinning or ShapedSkinning
        The neutral face.  Shapes, as :func:`load_skinning` reads them from the morph targets of a
        file, are the expressions.
    expressions : (S, V, 3) array, MeshSequence, or mapping of names to (V, 3) arrays
        Vertices of the face in each expression.
    bones : int
    influences : int
        Largest number of bones that move a vertex.
    tolerance : float or str, optional
        Largest distance of a vertex from its target, as a length or a share of the diagonal such as
        ``"0.2%"``.  By default there are no displacements.
    names : sequence of str, optional
        Names of the expressions.
    faces : (T, 3) int array, optional
        Triangles, if `neutral` has none.
    effort, bone_model, rng, time_limit
        As in :func:`decompose`.

    Returns
    -------
    Expressions

    Raises
    ------
    InputError
        If an argument is not usable.

    References
    ----------
    Kavan et al., "Compressed skinning for facial blendshapes", 2024, for bones that are linear in
    the weights of the shapes.

    Examples
    --------
    >>> rest = ssdr.samples.load("dancer_small").vertices[0]
    >>> bent = {"lean": rest + 0.1 * rest[:, 1:2] * [1, 0, 0], "grow": 1.1 * rest}
    >>> face = ssdr.decompose_expressions(rest, bent, bones=4, tolerance="1%")
    >>> both = ssdr.drive(face, [[0.5, 1.0]]).skin()[0]
    >>> bool(abs(both - rest - 0.5 * (bent["lean"] - rest) - 0.1 * rest).max() < 0.03)
    True
    """
    frames, names = _frames(neutral, expressions, names, faces)
    count, rest = len(frames) - 1, np.asarray(frames.frames(0), dtype=np.float64)
    limit = None
    if tolerance is not None:
        limit = parse_tolerance(tolerance, rest_diagonal(rest))
    options: dict[str, Any] = {"bones": bones, "influences": influences, "effort": effort}
    options |= {"bone_model": bone_model, "rng": rng, "time_limit": time_limit, "normals": False}
    model = _solved(frames, options, None)
    if limit is not None:
        off = np.linalg.norm(model.skin(dtype=np.float64) - frames.vertices, axis=2).max(axis=0)
        if off.max() > limit:
            # Solve again, with more importance for the vertices that need displacements.
            options["vertex_importance"] = np.minimum(1 + (off / limit) ** 2, _MOST)
            model = _solved(frames, options, model)
    # mapping back from the solver's space has rounded the rest pose
    model = _at_rest(dataclasses.replace(model, rest=rest), _STILL * (limit or 0.0))
    amounts = np.eye(count + 1)[:, 1:]
    face: Skinned = model
    if limit is not None:
        face = displaced(model, frames.vertices, amounts, limit, names)
    gap = np.linalg.norm(face.skin(dtype=np.float64) - frames.vertices, axis=2)
    made = _as_clips(face, names)
    return Expressions(
        skinning=made,
        rmse=float(np.sqrt((gap[1:] ** 2).mean())),
        max_error=float(gap.max()),
        displaced=int(made.shapes.moved.sum()),
    )


def _frames(
    neutral: Any, expressions: Any, names: Any, faces: Any
) -> tuple[MeshSequence, tuple[str, ...]]:
    """Sequence of the neutral face and the expressions, and the names of the expressions."""
    surface, rest = None, neutral
    if isinstance(neutral, Skinned):
        model, shapes = skinning_and_shapes(neutral)
        surface, rest = model.surface, model.rest
        faces = model.faces if faces is None else faces
        if expressions is None and shapes is not None:
            names = shapes.names if names is None else names
            expressions = rest + shapes.displacements
    elif isinstance(neutral, MeshSequence):
        surface, rest = neutral.surface, neutral.frames(0)
        faces = neutral.faces if faces is None else faces
    if isinstance(expressions, Mapping):
        names = list(expressions) if names is None else names
        expressions = list(expressions.values())
    if isinstance(expressions, MeshSequence):
        expressions = expressions.vertices
    if expressions is None:
        raise InputError("expressions", "vertices (S, V, 3), or a neutral face with shapes", "None")
    rest = check_floats(rest, "neutral", ("V", 3))
    moved = check_floats(expressions, "expressions", ("S", len(rest), 3))
    names = [f"expression_{k}" for k in range(len(moved))] if names is None else names
    if np.shape(names) != (len(moved),):
        raise InputError("names", f"{len(moved)} names", repr(names)[:80])
    both = np.concatenate([rest[None], moved])
    return MeshSequence(both, faces, surface=surface), unique_names([str(n) for n in names], "face")


def _solved(frames: MeshSequence, options: dict[str, Any], guess: Skinning | None) -> Skinning:
    """Model of the frames with the neutral face as rest pose; bones and weights start from `guess`.

    The neutral face is the first frame.
    """
    rest = np.asarray(frames.frames(0), dtype=np.float64)
    start = Kept(rest=rest) if guess is None else dataclasses.replace(guess, rest=rest)
    problem = check_problem(frames, None, start=start, **options)
    initial = dataclasses.replace(problem.initial, is_model=False)
    constraints = dataclasses.replace(problem.constraints, lock_rest=True)
    problem = dataclasses.replace(problem, start=None, initial=initial, constraints=constraints)
    # bones that start from a guess are in place
    schedule = partial(
        follow_effort,
        effort=problem.effort,
        rig=problem.rig,
        bones_placed=guess is not None,
        tries_model=False,
    )
    return finished(problem, partial(solve, schedule=schedule)).skinning


def _at_rest(model: Skinning, least: float) -> Skinning:
    """Copy of a model in which every bone's transform is the identity in the neutral frame.

    It is also the identity in each expression in which the bone moves no vertex by more than
    `least`.
    """
    rest = np.asarray(model.rest, dtype=np.float64)
    moves = np.array(model.transforms, dtype=np.float64)
    moves[0] = np.eye(3, 4)
    weights = model.sparse_weights().astype(np.float64).tocsc()
    for bone in range(model.n_bones):
        part = slice(*weights.indptr[bone : bone + 2])
        points, share = rest[weights.indices[part]], weights.data[part]
        change = moves[:, bone] - np.eye(3, 4)
        moved = points @ change[..., :3].swapaxes(1, 2) + change[:, None, :, 3]
        reach = (np.linalg.norm(moved, axis=2) * share).max(axis=1, initial=0.0)
        moves[reach <= least, bone] = np.eye(3, 4)
    return dataclasses.replace(model, transforms=moves)


def displaced(
    model: Skinning, goal: Array, amounts: Array, limit: float, names: Any = None
) -> ShapedSkinning:
    """A model with shapes, which displace only vertices that would miss their goal.

    A shape displaces the vertices that are farther than `limit` from their goal (F, V, 3) in some
    frame where the shape's amount is not 0, as Kavan et al. 2024, section 2.

    Parameters
    ----------
    model : Skinning
    goal : (F, V, 3) array
    amounts : (F, S) array
    limit : float
    names : sequence of str, optional
    """
    left = goal - model.skin(dtype=np.float64)
    far = np.linalg.norm(left, axis=2) > limit
    keep = (np.abs(amounts) > 0).T.astype(np.float64) @ far > 0
    start = np.zeros((1 + len(keep), model.n_vertices, 3))
    bare = Shapes(start[1:], amounts, names=names)
    found = fit_vectors(
        ShapedSkinning(model, bare),
        np.arange(model.n_frames),
        left,
        vertex=np.arange(model.n_vertices),
        used=np.concatenate([np.zeros_like(keep[:1]), keep]),
        start=start,
        pull=_PULL,
    )
    return ShapedSkinning(model, dataclasses.replace(bare, displacements=found[1:]))


def _as_clips(face: Skinned, names: tuple[str, ...]) -> ShapedSkinning:
    """Copy of a model in which each frame but the first becomes a clip: neutral frame, expression.

    Shapes that move no vertex are left out.
    """
    index = np.stack([np.zeros(len(names), dtype=int), 1 + np.arange(len(names))], axis=1).ravel()
    face = shaped(face)
    model, shapes = face.skinning, face.shapes
    used = np.flatnonzero(shapes.moved.any(axis=1))
    clips = tuple(Clip(name, 2 * k, 2 * k + 2, model.fps) for k, name in enumerate(names))
    return ShapedSkinning(
        dataclasses.replace(model, transforms=model.transforms[index], clips=clips),
        Shapes(
            shapes.displacements[used],
            shapes.amounts[np.ix_(index, used)],
            names=[shapes.names[k] for k in used],
        ),
        driven=True,
    )


def drive(face: Any, weights: Any) -> ShapedSkinning:
    """Pose a model by weights c of its expressions.

    Bone j becomes I + Σ_k c_k N_kj, where I + N_kj is its transform in expression k. The amounts of
    the shapes are summed with the same weights.

    Parameters
    ----------
    face : ShapedSkinning, or a result that has one
        Its `driven` is true: each clip is an expression.
    weights : (F, S) array
        Weight of each of the S expressions, in the order of the clips, in every frame.

    Returns
    -------
    ShapedSkinning
        One clip of F frames, whose bones are affine.

    Raises
    ------
    InputError
        If the model has no expressions, or the weights do not match.

    Examples
    --------
    >>> rest = ssdr.samples.load("dancer_small").vertices[0]
    >>> face = ssdr.decompose_expressions(rest, [rest + 1, rest - 1], bones=1)
    >>> still = ssdr.drive(face, [[1, 1], [0, 0]]).skin()
    >>> np.allclose(still[0], rest, atol=1e-5), np.array_equal(still[1], rest)
    (True, True)
    """
    face = skinning_in(face)
    if not (isinstance(face, ShapedSkinning) and face.driven):
        raise InputError("face", "a ShapedSkinning whose clips are expressions", repr(face)[:80])
    model, shapes = face.skinning, face.shapes
    factors = check_floats(weights, "weights", ("F", len(model.clips)))
    moves = np.asarray(model.transforms, dtype=np.float64)
    identity = np.eye(3, 4)
    moves = identity + np.tensordot(factors, moves[1::2] - identity, 1)
    posed = dataclasses.replace(
        model,
        transforms=moves,
        keyframes=None,
        bone_model="affine",
        clips=(Clip("driven", 0, len(moves), model.fps),),
    )
    amounts = factors @ shapes.amounts[1::2]
    return ShapedSkinning(posed, dataclasses.replace(shapes, amounts=amounts))
