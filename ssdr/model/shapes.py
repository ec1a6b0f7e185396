"""Models with shapes (morph targets, blend shapes), added to the rest pose before it is skinned."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.checks import check_floats, check_frames
from ..common.errors import InputError
from ..common.parallel import serial_blas
from ..common.short_repr import notebook_html, short_repr
from ..mesh.clips import Clip, unique_names
from ..mesh.surface import Space, Surface, as_trimesh, protect
from .lbs import skin_each
from .skinning import Skinning

_AT_REST = 1e-5  # largest deviation from the identity of a bone at rest


@dataclasses.dataclass(frozen=True, eq=False)
class Shapes:
    """Displacements of the rest pose, and how much of each is added in every frame.

    The rest pose of frame t is p + Σ_s a_ts d_s, to which skinning is then applied.

    Parameters
    ----------
    displacements : (S, V, 3) array
        In the rest pose, in the mesh's units; files store only those that are not 0.
    amounts : (F, S) array
        Factor of each shape in every frame.  Blender and Unity clamp it to 0 to 1.
    names : tuple of str, optional
        ``shape_0``, ``shape_1``, ... by default.

    Raises
    ------
    InputError
        If displacements, amounts and names are not of the same number, or a value is not finite.

    Examples
    --------
    >>> smile = ssdr.Shapes(np.ones((1, 3, 3)), [[0], [0.5]], names=["smile"])
    >>> len(smile), smile.names
    (1, ('smile',))
    """

    displacements: Any
    amounts: Any
    _: dataclasses.KW_ONLY
    names: Any = None

    def __post_init__(self) -> None:
        moved = check_floats(self.displacements, "shapes.displacements", ("S", "V", 3), empty=True)
        amounts = check_floats(self.amounts, "shapes.amounts", ("F", "S"), empty=True)
        count = len(moved)
        if amounts.shape[1] != count:
            raise InputError("shapes.amounts", f"{count} columns", amounts.shape[1])
        names = [f"shape_{s}" for s in range(count)] if self.names is None else self.names
        if np.shape(names) != (count,):
            raise InputError("shapes.names", f"{count} names", repr(names)[:80])
        object.__setattr__(self, "displacements", moved)
        object.__setattr__(self, "amounts", amounts)
        object.__setattr__(self, "names", unique_names([str(name) for name in names], "shape"))
        protect(self)

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.displacements)

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Mask ``(S, V)`` of the vertices that each shape moves."""
        return np.asarray(np.any(self.displacements, axis=2))

    @serial_blas()
    def added(self, frames: Any = slice(None)) -> NDArray[np.floating]:
        """Displacement ``(f, V, 3)`` of the rest pose in the given frames."""
        return np.asarray(np.tensordot(self.amounts[frames], self.displacements, 1))

    def in_frames(self, frames: Any) -> Shapes:
        """Copy with only the amounts of the given frames, in the given order."""
        return dataclasses.replace(self, amounts=self.amounts[frames])


@dataclasses.dataclass(frozen=True, eq=False)
class ShapedSkinning:
    """A skinned model with shapes, which are added to its rest pose in every frame.

    Parameters
    ----------
    skinning : Skinning
    shapes : Shapes
        As many amounts as the skinning has frames, and displacements of its vertices; there may be
        none.
    driven : bool
        Whether each clip is an expression that a weight drives (:func:`drive`): two frames, of
        which the first is the rest pose.

    Raises
    ------
    InputError
        If the shapes are of another mesh or of other frames, or the clips are not expressions.

    Examples
    --------
    >>> still = np.tile(np.eye(3, 4), (2, 1, 1, 1))
    >>> one = ssdr.Skinning.from_dense(np.eye(3), np.ones((3, 1)), still)
    >>> smile = ssdr.Shapes(np.ones((1, 3, 3)), [[0], [0.5]], names=["smile"])
    >>> ssdr.ShapedSkinning(one, smile).skin()[1, 0]
    array([1.5, 0.5, 0.5])
    """

    skinning: Skinning
    shapes: Shapes
    _: dataclasses.KW_ONLY
    driven: bool = False

    def __post_init__(self) -> None:
        for name, kind in (("skinning", Skinning), ("shapes", Shapes)):
            if not isinstance(getattr(self, name), kind):
                raise InputError(name, kind.__name__, type(getattr(self, name)).__name__)
        model, shapes, text = self.skinning, self.shapes, "{} frames, {} vertices"
        size = len(shapes.amounts), shapes.displacements.shape[1]
        if size != (model.n_frames, model.n_vertices):
            wanted = text.format(model.n_frames, model.n_vertices)
            raise InputError("shapes", wanted, text.format(*size))
        if self.driven and not self._starts_at_rest():
            wanted = "a clip of two frames for each expression, the first of them the rest pose"
            raise InputError(
                "skinning", wanted, f"{len(model.clips)} clips, {model.n_frames} frames"
            )

    def _starts_at_rest(self) -> bool:
        """Whether each clip has two frames, of which the first is the rest pose."""
        model = self.skinning
        if any(clip.n_frames != 2 for clip in model.clips) or self.shapes.amounts[::2].any():
            return False
        return bool(np.abs(model.transforms[::2] - np.eye(3, 4)).max() <= _AT_REST)

    @property
    def n_frames(self) -> int:
        return self.skinning.n_frames

    @property
    def n_vertices(self) -> int:
        return self.skinning.n_vertices

    @property
    def faces(self) -> NDArray[np.int32]:
        return np.asarray(self.skinning.faces)

    @property
    def surface(self) -> Surface | None:
        return self.skinning.surface

    @property
    def vertex_map(self) -> Any:
        return self.skinning.vertex_map

    @property
    def clips(self) -> tuple[Clip, ...]:
        return self.skinning.clips

    @property
    def fps(self) -> float:
        return self.skinning.fps

    @property
    def name(self) -> str:
        return self.skinning.name

    @property
    def space(self) -> Space:
        return self.skinning.space

    def __repr__(self) -> str:
        return f"ShapedSkinning(S={len(self.shapes)}, {self.skinning!r})"

    _repr_html_ = notebook_html

    def skin(self, frames: Any = None, *, dtype: Any = None) -> NDArray[np.floating]:
        """Vertex positions ``(f, V, 3)`` in some frames, by default all; ``(V, 3)`` in one."""
        model = self.skinning
        if not len(self.shapes):
            return model.skin(frames, dtype=dtype)
        index = slice(None) if frames is None else check_frames(frames, model.n_frames)
        if isinstance(index, int):
            return np.asarray(self.skin([index], dtype=dtype)[0])
        rests, moves = model.rest + self.shapes.added(index), model.transforms[index]
        return skin_each(rests, model.indices, model.weights, moves, dtype=dtype)

    def mesh(self, frame: int | None = None) -> Any:
        """One frame, or the rest pose, as a ``trimesh.Trimesh`` of copies."""
        points = self.skinning.rest if frame is None else self.skin(int(frame))
        return as_trimesh(points, self.faces)

    def select(self, *clips: str | int, **options: Any) -> ShapedSkinning:
        """A copy with only the given clips, as :meth:`Skinning.select` has them."""
        _, index = self.skinning.frames_of(*clips, **options)
        shapes, skinning = self.shapes.in_frames(index), self.skinning.select(*clips, **options)
        return dataclasses.replace(self, skinning=skinning, shapes=shapes)


Skinned = Skinning | ShapedSkinning


def skinning_and_shapes(model: Skinned) -> tuple[Skinning, Shapes | None]:
    """The skinning of a model, and its shapes, or None if it has none."""
    if isinstance(model, Skinning) or not len(model.shapes):
        return model.skinning, None
    return model.skinning, model.shapes


def shaped(model: Skinned) -> ShapedSkinning:
    """A model as one with shapes, of which there may be none."""
    if isinstance(model, ShapedSkinning):
        return model
    none = Shapes(np.zeros((0, model.n_vertices, 3)), np.zeros((model.n_frames, 0)))
    return ShapedSkinning(model, none)


def without_shapes(model: Skinned, where: str) -> Skinning:
    """The skinning of a model, which must have no shapes, since `where` cannot hold them.

    Raises
    ------
    InputError
        If it has shapes.
    """
    skinning, shapes = skinning_and_shapes(model)
    if shapes is not None:
        wanted = f"no shapes in {where} (thing.skinning leaves them out)"
        raise InputError("thing", wanted, f"{len(shapes)} of them")
    return skinning
