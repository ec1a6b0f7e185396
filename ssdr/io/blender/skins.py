"""Skins as Blender has them: rest pose, weights and transforms of the bones.

It runs inside Blender beside ``script.py`` and, like it, knows NumPy and Blender alone.
"""

import json
from typing import Any

import numpy as np

_LEAST_TOTAL = 1e-4  # where the weights of a vertex sum to less, Blender leaves it where it is
_SAME_PLACE = 1e-6  # of the size of a mesh: what float32 matrices make of a motion that is none


def matrix(value: Any) -> Any:
    return np.array(value, dtype=np.float64)


class Skin:
    """One mesh and what moves it."""

    def __init__(self, item: Any) -> None:
        self.item = item
        self.armature: Any = None
        self.modifiers = [m for m in item.modifiers if m.type == "ARMATURE" and m.object]
        if len(self.modifiers) > 1:
            names = ", ".join(m.object.name for m in self.modifiers)
            raise ValueError(f"{item.name} hangs on several armatures ({names}), one was expected")
        if self.modifiers:
            self.armature = self.modifiers[0].object
        self.keys: Any = None  # values of the shape keys, which must stay

    def groups(self) -> set[str]:
        return {group.name for group in self.item.vertex_groups}

    def show(self, skinned: bool) -> None:
        for modifier in self.modifiers:
            modifier.show_viewport = skinned

    def read_rest(self, graph: Any) -> None:
        """Vertices in world space, not skinned, and where the mesh stands."""
        shown = self.item.evaluated_get(graph)
        mesh = shown.to_mesh()
        points = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
        mesh.vertices.foreach_get("co", points)
        shown.to_mesh_clear()
        place = matrix(shown.matrix_world)
        if not np.linalg.cond(place) < 1e9:
            raise ValueError(f"{self.item.name} is scaled to nothing, which no rest pose can be")
        self.rest = points.reshape(-1, 3).astype(np.float64) @ place[:3, :3].T + place[:3, 3]
        self.place = place
        if len(self.rest) != len(self.item.data.vertices):
            raise ValueError(f"{self.item.name}: a modifier changes the number of its vertices")

    def place_at(self, graph: Any) -> Any:
        """What carries the rest pose along with the object itself."""
        keys = self.item.data.shape_keys
        if keys is not None:
            values = np.array([key.value for key in keys.key_blocks])
            if self.keys is not None and np.abs(values - self.keys).max() > 1e-6:
                raise ValueError(
                    f"shape keys move {self.item.name}, which no skinning holds; "
                    "ssdr.load bakes them"
                )
            self.keys = values
        return matrix(self.item.evaluated_get(graph).matrix_world) @ np.linalg.inv(self.place)

    def influences(self, names: list[str]) -> tuple[Any, Any]:
        """Bones ``(V, K)`` and weights; bone ``len(names)`` for what none of them moves."""
        number = {name: k for k, name in enumerate(names)}
        bone = {g.index: number[g.name] for g in self.item.vertex_groups if g.name in number}
        rows = [
            sorted(((g.weight, -bone[g.group]) for g in v.groups if g.group in bone), reverse=True)
            for v in self.item.data.vertices
        ]
        rows = [[pair for pair in row if pair[0] > 0] for row in rows]
        rows = [
            row if sum(w for w, _ in row) > _LEAST_TOTAL else [(1.0, -len(names))] for row in rows
        ]
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
    """One armature and the bones of it that its meshes name."""

    def __init__(self, item: Any, named: set[str]) -> None:
        self.item = item
        bones = [bone for bone in item.data.bones if bone.use_deform and bone.name in named]
        self.names = [bone.name for bone in bones]
        self.parents = [self._above(bone) for bone in bones]
        self.heads = matrix([bone.matrix_local.translation for bone in bones]).reshape(-1, 3)
        self._unrest = [np.linalg.inv(matrix(bone.matrix_local)) for bone in bones]

    def _above(self, bone: Any) -> int:
        """Number of the nearest bone above that counts, -1 where there is none."""
        above = bone.parent
        while above is not None and above.name not in self.names:
            above = above.parent
        return -1 if above is None else self.names.index(above.name)

    def pose(self, graph: Any) -> Any:
        """Transforms ``(B, 4, 4)`` from armature space at rest to world space."""
        shown = self.item.evaluated_get(graph)
        place, posed = matrix(shown.matrix_world), shown.pose.bones
        moved = [matrix(posed[n].matrix) @ u for n, u in zip(self.names, self._unrest, strict=True)]
        return place @ np.array(moved).reshape(-1, 4, 4)

    def place(self, graph: Any) -> Any:
        return matrix(self.item.evaluated_get(graph).matrix_world)


class Model:
    """All meshes of a scene with the bones that move them, sampled frame by frame.

    Blender moves a vertex p of a mesh that stands at O by A · Σ w P R⁻¹ · A⁻¹ O p, where the
    armature stands at A and a bone at P in its space, at R at rest.  With the rest pose O₀ p in
    world space, a bone's transform is A P R⁻¹ · A⁻¹ O O₀⁻¹.  Where the mesh goes with its armature
    the second factor is A₀⁻¹ in all frames, and meshes share the bones.
    """

    def __init__(self, items: list[Any], clustered: set[str]) -> None:
        self.skins = [Skin(item) for item in items]
        named: dict[str, set[str]] = {}
        for skin in self.skins:
            if skin.armature is not None:
                named.setdefault(skin.armature.name, set(clustered)).update(skin.groups())
        self.armatures = {
            skin.armature.name: Armature(skin.armature, named[skin.armature.name])
            for skin in self.skins
            if skin.armature is not None
        }
        self.poses: dict[str, list[Any]] = {name: [] for name in self.armatures}
        self.seats: list[list[Any]] = [[] for _ in self.skins]  # A⁻¹ O O₀⁻¹
        self.places: list[list[Any]] = [[] for _ in self.skins]  # O O₀⁻¹

    @property
    def n_bones(self) -> int:
        return sum(len(a.names) for a in self.armatures.values()) + len(self.skins)

    def show(self, skinned: bool) -> None:
        for skin in self.skins:
            skin.show(skinned)

    def read_rest(self, graph: Any) -> None:
        for skin in self.skins:
            skin.read_rest(graph)
        self._unplace = {n: np.linalg.inv(a.place(graph)) for n, a in self.armatures.items()}

    def sample(self, graph: Any) -> None:
        unplaced = {}
        for name, armature in self.armatures.items():
            self.poses[name].append(armature.pose(graph))
            unplaced[name] = np.linalg.inv(armature.place(graph))
        for k, skin in enumerate(self.skins):
            place = skin.place_at(graph)
            self.places[k].append(place)
            if skin.armature is not None:
                self.seats[k].append(unplaced[skin.armature.name] @ place)

    def _seat(self, k: int) -> Any:
        """A⁻¹ O O₀⁻¹ of all frames; one for all where the mesh goes with its armature."""
        skin = self.skins[k]
        still = self._unplace[skin.armature.name][None]
        seats = np.array(self.seats[k])
        corners = np.stack([skin.rest.min(axis=0), skin.rest.max(axis=0)])
        size = np.abs(corners).max() + 1e-30
        off = (seats - still)[:, :3]
        reach = np.abs(off[..., :3]).sum(axis=-1).max() * size + np.abs(off[..., 3]).max()
        scale = np.abs(still[:, :3, :3]).max()
        return still if reach <= _SAME_PLACE * size * scale else seats

    def arrays(self) -> dict[str, Any]:
        names: list[str] = []
        transforms: list[Any] = []
        parents: list[int] = []
        heads: list[Any] = []  # joints, where the rest pose is
        indices: list[Any] = []
        weights: list[Any] = []
        shared: dict[str, int] = {}
        for k, skin in enumerate(self.skins):
            own: list[str] = []
            start = 0
            if skin.armature is not None:
                key, seat = skin.armature.name, self._seat(k)
                own = self.armatures[key].names
                start = shared.get(key, -1) if len(seat) == 1 else -1
                if start < 0:
                    start = len(names)
                    names += own
                    transforms.append(np.array(self.poses[key]) @ seat[:, None])
                    armature = self.armatures[key]
                    parents += [start + a if a >= 0 else -1 for a in armature.parents]
                    back = np.linalg.inv(seat[0])
                    heads.append(armature.heads @ back[:3, :3].T + back[:3, 3])
                    if len(seat) == 1:
                        shared[key] = start
            bones, amounts = skin.influences(own)
            still = (bones == len(own)) & (amounts > 0)
            numbers = bones + start
            if still.any():
                numbers[still] = len(names)
                names.append(skin.item.name)
                transforms.append(np.array(self.places[k])[:, None])
                parents.append(-1)
                heads.append(skin.place[None, :3, 3])
            indices.append(np.where(amounts > 0, numbers, 0))
            weights.append(amounts)
        width = max(j.shape[1] for j in indices)

        def wide(values: Any) -> Any:
            return np.pad(values, ((0, 0), (0, width - values.shape[1])))

        return {
            "rest": np.concatenate([skin.rest for skin in self.skins]),
            "indices": np.concatenate([wide(j) for j in indices]).astype(np.int32),
            "weights": np.concatenate([wide(w) for w in weights]),
            "transforms": np.concatenate(transforms, axis=1)[:, :, :3],
            "bones": np.array(json.dumps(names)),
            "parents": np.array(parents),
            "joint_positions": np.concatenate(heads),
        }
