"""Rigs in the form that a store needs: skeleton, body at rest, and transforms of the joints."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ssdr import Skinning, kabsch, skin
from ssdr.common.errors import InputError
from ssdr.model.rigid import nearest_rotation
from ssdr.model.transforms import parents_first, rest_diagonal

from ..data.skeleton import Skeleton

# Largest difference of an entry from the nearest rotation's that counts as rounding.
_ROUNDING = 0.02
# Distance, relative to the skeleton's size, below which two joints at rest coincide.
_SAME_PLACE = 2e-3
_SAME_SKIN = 0.03  # likewise of skins, whose blend shapes may be held otherwise
_EXACT = 1e-4  # metres, or entries of a rotation, by which bones differ that are one joint
_LOOKED_AT = 8  # number of frames in which the cloth must be at the body
_FAR = 0.25  # largest median distance from the body, relative to the larger size of the two
_SMALLEST, _LARGEST = 0.05, 5.0  # bounds of a cloth's size, relative to the body's


@dataclasses.dataclass(frozen=True, eq=False)
class MovingBody:
    """A moving skeleton, and the body that it moves.

    Attributes
    ----------
    skeleton : Skeleton
    body : Skinning
        Skinning of one frame, at rest, with the skeleton's joints as bones.  If the file has no
        mesh, it has a vertex at every joint and no faces.
    joints : (F, J, 3, 4) float64
        World transforms from the rest pose.
    """

    skeleton: Skeleton
    body: Skinning
    joints: NDArray[np.float64]

    def is_lying(self) -> bool:
        """Whether the skeleton at rest is longest along z, so that z is probably up."""
        x, y, z = np.ptp(self.skeleton.rest, axis=0)
        return bool(z > 1.2 * max(x, y))

    def facing(self, rest: NDArray[np.floating], faces: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Mask ``(T,)`` of triangles whose piece of the garment at rest faces the body.

        The mean over the triangles of a piece, of one winding, decides for all of them.
        """
        a, b, c = np.asarray(rest, np.float64)[faces].swapaxes(0, 1)
        middle = (a + b + c) / 3
        away = middle - self.body.rest[cKDTree(self.body.rest).query(middle)[1]]
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        piece = _pieces(faces)
        return np.bincount(piece, (np.cross(b - a, c - a) * away).sum(axis=1))[piece] < 0

    def check_cloth(self, vertices: NDArray[np.floating], argument: str = "cloth") -> None:
        """Check that a cloth ``(F, V, 3)`` lies on the body and is of a size that fits it.

        Raises
        ------
        InputError
            If the cloth is far away or of another size.
        """
        body, size = self.body, rest_diagonal(self.body.rest)
        chosen = np.unique(np.linspace(0, len(self.joints) - 1, _LOOKED_AT).astype(int))
        posed = skin(body.rest, body.indices, body.weights, self.joints[chosen])
        pairs = zip(posed, vertices[chosen], strict=True)
        far = float(np.median([cKDTree(skinned).query(v)[0] for skinned, v in pairs]))
        large = rest_diagonal(vertices[chosen[0]])
        near = far < _FAR * max(size, large)
        if not (near and _SMALLEST * size < large < _LARGEST * size):
            raise InputError(
                argument,
                f"a garment on the body, which is {size:.3g} m large, in its unit, axes and place",
                f"one {large:.3g} m large, {far:.3g} m away from it; "
                "scale (--cloth-scale, --rig-scale) and axes (--cloth-up, --rig-up) can be given",
            )

    def matched(self, skeleton: Skeleton, body: Skinning) -> MovingBody:
        """This motion on another rig: a skeleton with some or all of these joints, and its body.

        Further joints of this one, such as those of a dressed character, are left out, also between
        a joint and its parent.  The rest poses may differ by a rigid motion.

        Raises
        ------
        InputError
            If joints are missing, or parents or rest pose differ, or that of a body with as many
            vertices.
        """
        own = self.skeleton
        theirs, ours = (_parents(s, skeleton.names) for s in (skeleton, own))
        if missing := sorted(joint for joint, _ in theirs.items() - ours.items()):
            expected = "the joints and parents of the first clip"
            raise InputError("rig", expected, f"none such: {', '.join(missing)}")
        order = [own.names.index(name) for name in skeleton.names]
        rest, near = own.rest[order], _SAME_PLACE * rest_diagonal(skeleton.rest)
        turn = np.eye(3, 4)
        if np.abs(rest - skeleton.rest).max() > near:
            turn = kabsch(skeleton.rest, rest)
        gap = np.linalg.norm(skeleton.rest @ turn[:, :3].T + turn[:, 3] - rest, axis=1)
        off = [(skeleton.names[int(gap.argmax())], gap.max(), near)]
        there, mine = body.rest @ turn[:, :3].T + turn[:, 3], self.body
        if len(body.faces) and len(mine.faces) and len(there) == mine.n_vertices:
            # The place of a joint at an end does not show its turn, the skin does.  Its vertices
            # may be in another order.
            far = np.max(cKDTree(mine.rest).query(there)[0])
            off.append(("the skin", far, _SAME_SKIN * rest_diagonal(skeleton.rest)))
        for what, far, most in off:
            if far > most:
                text = f"{what} {far:.3g} m from its place"
                raise InputError("rig", "the bind pose of the first clip", text)
        m = self.joints[:, order]
        shift = m[..., :3] @ turn[:, 3] + m[..., 3]
        moved = np.concatenate([m[..., :3] @ turn[:, :3], shift[..., None]], axis=-1)
        return MovingBody(skeleton, body, moved)

    def trimmed(self) -> MovingBody:
        """Rig without the joints at its top that stand still, such as the root of an engine.

        They are above all joints that move the body: a network that looks from there would read
        where in the world the body is.
        """
        body, parents = self.body, self.skeleton.parents
        below = np.eye(len(parents), dtype=bool)  # or the joint itself
        for j in range(len(parents) - 1, 0, -1):
            below[parents[j]] |= below[j]
        moving = np.unique(body.indices[body.weights > 0])
        path = np.flatnonzero(below[:, moving].all(axis=1))
        moves = np.ptp(self.joints[:, path], axis=0).max(axis=(1, 2)) > _EXACT
        kept = np.flatnonzero(below[path[moves.argmax()]])  # the first that moves, or the root
        place = np.zeros(len(parents), dtype=np.int32)
        place[kept] = np.arange(len(kept))
        above, names = place[parents[kept]], tuple(self.skeleton.names[j] for j in kept)
        above[0] = -1
        skeleton = Skeleton(names, above, self.skeleton.rest[kept])
        fewer = {"transforms": body.transforms[:, kept], "bone_names": names}
        body = dataclasses.replace(body, indices=place[body.indices], **fewer)
        return MovingBody(skeleton, body, self.joints[:, kept])


def rig_of(model: Skinning) -> MovingBody:
    """Skeleton, body and motion of a skinning.

    The skeleton is the largest tree of bones; roots of other trees become children of its root.
    A bone of another tree that has the name of a joint of the largest, but for a number, and moves
    as it does is that joint: some files have joints once for every mesh.
    Meshes without a skin are left out, and so are bones without relatives that move nothing.

    Raises
    ------
    InputError
        If there is no skeleton, or a joint is scaled or sheared.
    """
    if model.parents is None:
        text = f"{', '.join(model.names()[:5])} without parents"
        raise InputError("rig", "a skeleton: joints with parents", text)
    parents = np.array(model.parents)
    root = np.arange(model.n_bones)
    while (parents[root] >= 0).any():
        root = np.where(parents[root] >= 0, parents[root], root)
    size = np.bincount(root, minlength=model.n_bones)
    main = int(size.argmax())
    same, every = _same_joints(model, root == main)
    model = dataclasses.replace(model, indices=same[model.indices])
    parents = np.where(parents >= 0, same[parents], -1)
    moves = model.sparse_weights().toarray() > 0  # (V, B)
    shared = (moves & (moves.sum(axis=1) > 1)[:, None]).any(axis=0)
    hung = (parents < 0) & (np.arange(model.n_bones) != main)
    alone = (size == 1) & hung & ~shared
    parents[hung] = main
    order = np.array([b for b in parents_first(parents) if not alone[b] and same[b] == b])
    place = np.zeros(model.n_bones, dtype=np.int32)
    place[order] = np.arange(len(order))
    rest = np.asarray(model.joint_positions, np.float64)[order]
    names = tuple(every[b] for b in order)
    above = np.where(parents[order] >= 0, place[parents[order]], -1)
    transforms = np.asarray(model.transforms, np.float64)[:, order]
    return MovingBody(
        Skeleton(names, above, rest),
        _body(model, np.flatnonzero(moves[:, alone].any(axis=1)), place, rest, names),
        _rigid(transforms, rest, names),
    )


def bare_body(joints: NDArray[np.float64], names: tuple[str, ...]) -> Skinning:
    """Body without triangles: one vertex at each joint ``(J, 3)``, which moves it."""
    each, still = np.arange(len(names))[:, None], np.tile(np.eye(3, 4), (1, len(names), 1, 1))
    return Skinning(joints, each, np.ones(each.shape), still, bone_names=names, name="body")


def _body(
    model: Skinning,
    dropped: NDArray[np.int64],
    place: NDArray[np.int32],
    joints: NDArray[np.float64],
    names: tuple[str, ...],
) -> Skinning:
    """Body at rest, without the faces that use `dropped` vertices.

    Vertices that lie in the same place and have the same weights are merged.
    """
    bare = bare_body(joints, names)
    faces = model.faces[~np.isin(model.faces, dropped).any(axis=1)]
    if not len(faces):
        return bare
    rest = np.asarray(model.rest, np.float32)
    key = np.concatenate([rest, model.dense_weights().round(3)], axis=1)
    _, first, merged = np.unique(key, axis=0, return_index=True, return_inverse=True)
    triangles = merged.reshape(-1)[faces]
    solid = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    if not solid.any():
        return bare
    used, triangles = np.unique(triangles[solid], return_inverse=True)
    chosen, triangles = first[used], triangles.reshape(-1, 3)
    piece = _pieces(triangles)
    corners = rest[chosen][triangles].astype(np.float64)
    # From its middle, that of a piece with holes has the sign of the closed one.
    middle = [np.bincount(piece, x) / np.bincount(piece) for x in corners.mean(axis=1).T]
    a, b, c = (corners - np.transpose(middle)[piece, None]).swapaxes(0, 1)
    volume = np.bincount(piece, np.einsum("tc,tc->t", a, np.cross(b, c)))
    triangles = np.where(volume[piece, None] < 0, triangles[:, ::-1], triangles)
    indices = np.where(model.weights > 0, place[model.indices], 0)
    return dataclasses.replace(
        bare,
        rest=rest[chosen],
        indices=indices[chosen],
        weights=model.weights[chosen],
        faces=triangles,
    )


def _rigid(
    transforms: NDArray[np.float64], rest: NDArray[np.float64], names: tuple[str, ...]
) -> NDArray[np.float64]:
    """Transforms with exact rotations in place of rounded ones; no joint moves."""
    linear = transforms[..., :3]
    rotation = nearest_rotation(linear)
    off = np.abs(rotation - linear).max(axis=(2, 3))
    if off.max() > _ROUNDING:
        t, j = (int(k) for k in np.unravel_index(int(off.argmax()), off.shape))
        raise InputError("rig", "joints that turn and move", f"{names[j]} scaled in frame {t}")
    shift = transforms[..., 3] + np.einsum("fjab,jb->fja", linear - rotation, rest)
    return np.concatenate([rotation, shift[..., None]], axis=-1)


def _pieces(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """Number of the connected piece of each triangle ``(T,)``; a piece has one winding."""
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).ravel()
    size = faces.max() + 1
    _, i, j = np.intersect1d(start * size + end, end * size + start, return_indices=True)
    pairs = np.stack([i, j], axis=1) // 3
    return np.asarray(trimesh.graph.connected_component_labels(pairs, len(faces)))


def _parents(skeleton: Skeleton, kept: tuple[str, ...]) -> dict[str, str]:
    """Nearest ancestor of every joint among those that are kept, by name; empty for a root."""
    above, names = {"": ""}, skeleton.names
    for name, p in zip(names, skeleton.parents, strict=True):
        parent = names[p] if p >= 0 else ""
        above[name] = parent if parent in kept else above[parent]
    return above


def _same_joints(model: Skinning, main: NDArray[np.bool_]) -> tuple[NDArray[np.int64], list[str]]:
    """Index of the joint that each bone ``(B,)`` stands for, and the names of all bones.

    That is the bone itself, or one of the main tree with its place, motion and name.  A joint has
    the shortest of its names: readers number those that are taken.  They must agree, as a floor
    that stands as still as the root is no joint.
    """
    same, names = np.arange(model.n_bones), list(model.names())
    plain = [re.sub(r"_\d+\Z", "", name) for name in names]
    place, moves = np.asarray(model.joint_positions), np.asarray(model.transforms)
    for b in np.flatnonzero(~main):
        near = np.flatnonzero(main & (np.abs(place - place[b]).max(axis=1) < _EXACT))
        for j in near:
            alike = np.allclose(moves[:, j], moves[:, b], atol=_EXACT)
            if alike and plain[j] == plain[b]:
                same[b], names[j] = j, min(names[j], names[b], key=len)
    return same, names
