"""Conversion of sequences and skinnings from one unit and up axis to another."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

import numpy as np

from ..mesh.sequence import MeshSequence
from ..mesh.surface import UNKNOWN, Space

Thing = TypeVar("Thing", bound=Any)  # MeshSequence, Skinning or ShapedSkinning

# rotation by 90° about x, which maps z up to y up
_Y_FROM_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def in_space(thing: Thing, space: Space) -> Thing:
    """Sequence or skinning in another unit and with another up axis.

    Parameters
    ----------
    thing : MeshSequence or Skinning
    space : Space
        Unit and up axis of the result.  If the unit or the axis is unknown in `space` or in
        `thing`, it does not change.

    Returns
    -------
    MeshSequence or Skinning
        Scaled if both units are known, and rotated about x if both up axes are known.

    Examples
    --------
    >>> points = np.array([[[0.0, 0.0, 180.0]]])
    >>> tall = ssdr.MeshSequence(points, space=ssdr.Space(0.01, "z"))
    >>> ssdr.io.in_space(tall, ssdr.Space(1.0, "y")).vertices.tolist()
    [[[0.0, 1.8, 0.0]]]
    """
    old: Space = thing.space
    new = old.but(Space(old.units and space.units, old.up and space.up))
    factor = old.units / new.units if old.units and new.units else 1.0
    turn = np.eye(3)
    if old.up and old.up != new.up:
        turn = _Y_FROM_Z if new.up == "y" else _Y_FROM_Z.T
    return with_space(transformed(thing, factor, turn), new)


def transformed(thing: Thing, factor: float, turn: Any = np.eye(3)) -> Thing:  # noqa: B008
    """Sequence or skinning whose points x are at `factor` Q x, with the rotation Q = `turn`.

    Bone transforms [R | T] become [Q R Qᵀ | `factor` Q T].
    """
    turned = not np.array_equal(turn, np.eye(3))
    if factor == 1 and not turned:
        return thing

    def at(points: Any) -> Any:
        return points @ (factor * turn.T).astype(points.dtype)

    surface = thing.surface
    if turned and surface is not None and surface.normals is not None:
        normals = surface.normals @ turn.T.astype(surface.normals.dtype)
        surface = dataclasses.replace(surface, normals=normals)
    if isinstance(thing, MeshSequence):
        vertices = np.concatenate([at(block) for _, block in thing.chunks()])
        return dataclasses.replace(thing, vertices=vertices, surface=surface)
    if hasattr(thing, "shapes"):  # asked by attribute, so that importing ssdr.io stays quick
        shapes = dataclasses.replace(thing.shapes, displacements=at(thing.shapes.displacements))
        bones = transformed(thing.skinning, factor, turn)
        return dataclasses.replace(thing, skinning=bones, shapes=shapes)
    m = np.asarray(thing.transforms, dtype=np.float64)
    moved = np.concatenate([turn @ m[..., :3] @ turn.T, at(m[..., 3])[..., None]], axis=-1)
    joints = thing.joint_positions
    return dataclasses.replace(
        thing,
        rest=at(thing.rest),
        joint_positions=None if joints is None else at(joints),
        transforms=moved.astype(thing.transforms.dtype),
        surface=surface,
    )


def scaled(thing: Thing, factor: float, space: Space) -> Thing:
    """Sequence or skinning scaled by `factor`, with the unit and up axis that `space` states.

    If `space` states no unit, that of the result is unknown unless `factor` is 1: scaling may have
    meant another unit or another size.
    """
    stated = thing.space if factor == 1 else Space(None, thing.space.up)
    return with_space(transformed(thing, factor), stated.but(space))


def with_space(thing: Thing, space: Space) -> Thing:
    """Sequence or skinning with the same coordinates, stated to be in another space."""
    if space == thing.space:
        return thing
    if hasattr(thing, "shapes"):  # asked by attribute, so that importing ssdr.io stays quick
        return dataclasses.replace(thing, skinning=with_space(thing.skinning, space))
    unread = {"validate": False} if isinstance(thing, MeshSequence) else {}
    return dataclasses.replace(thing, space=space, **unread)


def ready_to_write(thing: Thing, title: str, space: Space | None) -> tuple[Thing, str]:
    """Sequence or skinning converted to the space of a file, and a note on the conversion.

    Parameters
    ----------
    thing : MeshSequence or Skinning
    title : str
        Name of the file's format.
    space : Space or None
        Space that the file must have; None if it can state none.
    """
    own: Space = thing.space
    if space is None:
        return thing, f"{title} does not state {own}" if own != UNKNOWN else ""
    taken = space.but(own)
    notes = [f"{own}: taken for {taken}"] if taken != own else []
    ready = in_space(with_space(thing, taken), space)
    if ready.space != taken:
        notes.append(f"converted from {taken} to {ready.space}")
    return ready, "; ".join(notes)
