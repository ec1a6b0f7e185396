"""Reading of skins from Blender: rest pose, weights and transforms of the bones.

This module runs inside Blender beside ``script.py`` and needs only NumPy and Blender.
"""

import json
from typing import Any

import numpy as np

_LEAST_TOTAL = 1e-4  # Blender does not move a vertex whose weights sum to less
_MOST_LOOKS = 100  # largest number of keys at which vertices are compared
_SAME_PLACE = 1e-6  # of a mesh's size; float32 rounding of matrices moves a still mesh by less


def matrix(value: Any) -> Any:
    return np.array(value, dtype=np.float64)


def world_points(item: Any, graph: Any) -> tuple[Any, Any]:
    """Evaluated vertices (V, 3) of a mesh in world space, and the mesh's matrix to world space."""
    shown = item.evaluated_get(graph)
    mesh = shown.to_mesh()
    points = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", points)
    shown.to_mesh_clear()
    place = matrix(shown.matrix_world)
    return points.reshape(-1, 3).astype(np.float64) @ place[:3, :3].T + place[:3, 3], place


def lost_between(items: list[Any], timeline: Any) -> tuple[float, float]:
    """Largest error of vertices, and largest diagonal, at the keys that a timeline misses.

    The error is the distance between the vertices at a key and those interpolated linearly between
    the two frames around it. At most 100 keys are compared.
    """
    ticks, distance, diagonal = timeline.missed, 0.0, 0.0

    def vertices(frame: float) -> Any:
        graph = timeline.go(frame)
        return np.concatenate([world_points(item, graph)[0] for item in items])

    for tick in ticks[np.linspace(0, len(ticks) - 1, min(len(ticks), _MOST_LOOKS)).astype(int)]:
        known = min(tick, timeline.count - 1)
        before, after = np.floor(known), np.ceil(known)
        there, share = vertices(tick), known - before
        shown = (1 - share) * vertices(before) + share * vertices(after)
        distance = max(distance, float(np.linalg.norm(there - shown, axis=1).max()))
        diagonal = max(diagonal, float(np.linalg.norm(np.ptp(there, axis=0))))
    return distance, diagonal


class SkinnedObject:
    """A mesh, its armature, and its motion relative to the first frame.

    The symbols are those of `SkinnedMeshes`.
    """

    def __init__(self, item: Any) -> None:
        self.item = item
        self.modifiers = [m for m in item.modifiers if m.type == "ARMATURE" and m.object]
        if len(self.modifiers) > 1:
            names = ", ".join(m.object.name for m in self.modifiers)
            raise ValueError(f"{item.name} has several armatures ({names}), one was expected")
        self.armature: Any = self.modifiers[0].object if self.modifiers else None
        self.keys: Any = None  # values of the shape keys, which must not change
        self.motions: list[Any] = []  # O O₀⁻¹ of each frame
        self.relative: list[Any] = []  # A⁻¹ O O₀⁻¹ of each frame

    def read_rest(self, graph: Any) -> None:
        """Read the rest pose (unskinned vertices in world space) and the mesh's world matrix O₀."""
        self.rest, self.place = world_points(self.item, graph)
        if not np.linalg.cond(self.place) < 1e9:
            raise ValueError(f"{self.item.name} is scaled to size 0, which no rest pose can have")
        if len(self.rest) != len(self.item.data.vertices):
            raise ValueError(f"{self.item.name}: a modifier changes the number of its vertices")

    def sample(self, graph: Any, armature_places: dict[str, Any]) -> None:
        """Record the motion of the object in one frame, in the world and relative to its armature.

        `armature_places` are the world matrices A of the armatures, by name.
        """
        keys = self.item.data.shape_keys
        if keys is not None:
            values = np.array([key.value for key in keys.key_blocks])
            if self.keys is not None and np.abs(values - self.keys).max() > 1e-6:
                raise ValueError(
                    f"shape keys move {self.item.name}, which no skinning holds; "
                    "ssdr.load bakes them"
                )
            self.keys = values
        motion = matrix(self.item.evaluated_get(graph).matrix_world) @ np.linalg.inv(self.place)
        self.motions.append(motion)
        if self.armature is not None:
            self.relative.append(np.linalg.inv(armature_places[self.armature.name]) @ motion)

    def influences(self, names: list[str]) -> tuple[Any, Any]:
        """Bone indices and weights ``(V, K)``, for bones with the given names.

        A vertex that no bone moves gets the index ``len(names)`` with weight 1.
        """
        number = {name: k for k, name in enumerate(names)}
        bone = {g.index: number[g.name] for g in self.item.vertex_groups if g.name in number}
        rows = []
        for vertex in self.item.data.vertices:
            pairs = [(g.weight, -bone[g.group]) for g in vertex.groups if g.group in bone]
            pairs = sorted((pair for pair in pairs if pair[0] > 0), reverse=True)
            if sum(weight for weight, _ in pairs) <= _LEAST_TOTAL:
                pairs = [(1.0, -len(names))]
            rows.append(pairs)
        indices = np.zeros((len(rows), max(map(len, rows))), dtype=np.int32)
        weights = np.zeros(indices.shape, dtype=np.float32)
        for k, row in enumerate(rows):
            indices[k, : len(row)] = [-b for _, b in row]
            weights[k, : len(row)] = [w for w, _ in row]
        total = weights.sum(axis=1, dtype=np.float64, keepdims=True)
        # Weights that do sum to 1 stay as they are, to the bit.
        scaled = (weights / total).astype(np.float32)
        return indices, np.where(np.abs(total - 1) > 1e-6, scaled, weights)


class Armature:
    """An armature with its deforming bones whose names are in `named`, and their motion."""

    def __init__(self, item: Any, named: set[str]) -> None:
        self.item = item
        bones = [bone for bone in item.data.bones if bone.use_deform and bone.name in named]
        self.names = [bone.name for bone in bones]
        self.parents = [self._parent(bone) for bone in bones]
        self.heads = matrix([bone.matrix_local.translation for bone in bones]).reshape(-1, 3)
        self._unrest = [np.linalg.inv(matrix(bone.matrix_local)) for bone in bones]
        self.poses: list[Any] = []

    def _parent(self, bone: Any) -> int:
        """Index in `names` of a bone's nearest ancestor that is in `names`, or -1."""
        above = bone.parent
        while above is not None and above.name not in self.names:
            above = above.parent
        return -1 if above is None else self.names.index(above.name)

    def place(self, graph: Any) -> Any:
        return matrix(self.item.evaluated_get(graph).matrix_world)

    def sample(self, graph: Any) -> None:
        """Record the bones' transforms A P R⁻¹ ``(B, 4, 4)`` in one frame (see `SkinnedMeshes`)."""
        posed = self.item.evaluated_get(graph).pose.bones
        moved = [matrix(posed[n].matrix) @ u for n, u in zip(self.names, self._unrest, strict=True)]
        self.poses.append(self.place(graph) @ np.array(moved).reshape(-1, 4, 4))


class SkinnedMeshes:
    """All meshes of a scene with the bones that move them, sampled frame by frame.

    Let O and A be the world matrices of a mesh and its armature, P and R the pose and rest matrices
    of a bone in armature space, and w the weight of the bone at a vertex p of the mesh. Blender
    moves p to A (Σ w P R⁻¹) A⁻¹ O p in world space, where the sum is over the bones.

    The rest pose is O₀ p in world space, where ₀ marks the first frame. The transform of a bone
    from the rest pose is therefore (A P R⁻¹) (A⁻¹ O O₀⁻¹). If the mesh follows its armature, the
    second factor is A₀⁻¹ in all frames, so that all such meshes share the armature's bones.
    """

    what = "transforms"

    def __init__(self, items: list[Any], clustered: set[str]) -> None:
        self.skins = [SkinnedObject(item) for item in items]
        named: dict[str, set[str]] = {}
        for skin in self.skins:
            if skin.armature is not None:
                groups = {group.name for group in skin.item.vertex_groups}
                named.setdefault(skin.armature.name, set(clustered)).update(groups)
        self.armatures = {
            skin.armature.name: Armature(skin.armature, named[skin.armature.name])
            for skin in self.skins
            if skin.armature is not None
        }
        n_bones = sum(len(a.names) for a in self.armatures.values()) + len(self.skins)
        self.bytes_per_frame = 96 * n_bones

    def read_rest(self, timeline: Any) -> None:
        """Read the rest pose in the first frame, with the meshes' armature modifiers disabled."""
        modifiers = [modifier for skin in self.skins for modifier in skin.modifiers]
        for modifier in modifiers:
            modifier.show_viewport = False
        graph = timeline.go(0)
        for skin in self.skins:
            skin.read_rest(graph)
        self._rest_places = {n: a.place(graph) for n, a in self.armatures.items()}
        for modifier in modifiers:
            modifier.show_viewport = True

    def sample(self, graph: Any) -> None:
        for armature in self.armatures.values():
            armature.sample(graph)
        places = {name: armature.place(graph) for name, armature in self.armatures.items()}
        for skin in self.skins:
            skin.sample(graph, places)

    def _relative_motion(self, skin: SkinnedObject) -> Any:
        """Motion (F, 4, 4) of a mesh relative to its armature, or (1, 4, 4) if it follows that.

        They are A⁻¹ O O₀⁻¹ and A₀⁻¹ in the symbols of :class:`SkinnedMeshes`.
        """
        still = np.linalg.inv(self._rest_places[skin.armature.name])[None]
        moved = np.array(skin.relative)
        size = np.abs(skin.rest).max() + 1e-30
        off = (moved - still)[:, :3]
        reach = np.abs(off[..., :3]).sum(axis=-1).max() * size + np.abs(off[..., 3]).max()
        scale = np.abs(still[:, :3, :3]).max()
        return still if reach <= _SAME_PLACE * size * scale else moved

    def arrays(self) -> dict[str, Any]:
        names: list[str] = []
        transforms: list[Any] = []
        parents: list[int] = []
        heads: list[Any] = []  # joints in the rest pose
        indices: list[Any] = []
        weights: list[Any] = []
        shared: dict[str, int] = {}  # first bone of each armature whose bones are shared
        for skin in self.skins:
            own: list[str] = []
            start = 0
            if skin.armature is not None:
                key, relative = skin.armature.name, self._relative_motion(skin)
                armature = self.armatures[key]
                own = armature.names
                start = shared.get(key, -1) if len(relative) == 1 else -1
                if start < 0:
                    start = len(names)
                    names += own
                    transforms.append(np.array(armature.poses) @ relative[:, None])
                    parents += [start + a if a >= 0 else -1 for a in armature.parents]
                    back = np.linalg.inv(relative[0])
                    heads.append(armature.heads @ back[:3, :3].T + back[:3, 3])
                    if len(relative) == 1:
                        shared[key] = start
            bones, amounts = skin.influences(own)
            still = (bones == len(own)) & (amounts > 0)
            numbers = bones + start
            if still.any():
                numbers[still] = len(names)
                names.append(skin.item.name)
                transforms.append(np.array(skin.motions)[:, None])
                parents.append(-1)
                heads.append(skin.place[None, :3, 3])
            indices.append(np.where(amounts > 0, numbers, 0))
            weights.append(amounts)
        width = max(j.shape[1] for j in indices)

        def joined(blocks: list[Any]) -> Any:
            return np.concatenate([np.pad(b, ((0, 0), (0, width - b.shape[1]))) for b in blocks])

        return {
            "rest": np.concatenate([skin.rest for skin in self.skins]),
            "indices": joined(indices).astype(np.int32),
            "weights": joined(weights),
            "transforms": np.concatenate(transforms, axis=1)[:, :, :3],
            "bones": np.array(json.dumps(names)),
            "parents": np.array(parents),
            "joint_positions": np.concatenate(heads),
        }


class BareArmatures:
    """The bones of armatures that move no mesh."""

    what = "transforms"

    def __init__(self, items: list[Any]) -> None:
        found = [Armature(item, {bone.name for bone in item.data.bones}) for item in items]
        self.armatures = [armature for armature in found if armature.names]
        self.bytes_per_frame = 96 * sum(len(a.names) for a in self.armatures)

    def read_rest(self, timeline: Any) -> None:
        """Read the armatures' world matrices in the first frame."""
        graph = timeline.go(0)
        self._places = [armature.place(graph) for armature in self.armatures]

    def sample(self, graph: Any) -> None:
        for armature in self.armatures:
            armature.sample(graph)

    def arrays(self) -> dict[str, Any]:
        pairs = list(zip(self.armatures, self._places, strict=True))
        starts = np.cumsum([0, *(len(a.names) for a in self.armatures)])
        heads = np.concatenate([a.heads @ at[:3, :3].T + at[:3, 3] for a, at in pairs])
        parents = [
            start + above if above >= 0 else -1
            for armature, start in zip(self.armatures, starts, strict=False)
            for above in armature.parents
        ]
        moved = [np.array(a.poses) @ np.linalg.inv(at) for a, at in pairs]
        return {
            "transforms": np.concatenate(moved, axis=1)[:, :, :3],
            "bones": np.array(json.dumps([name for a in self.armatures for name in a.names])),
            "parents": np.array(parents),
            "joint_positions": heads,
        }
