"""A small exact model for tests of formats: a bending tube with seam, hard edges, two materials."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

import ssdr
from helpers.stages import items

FPS = 24.0


def checker() -> bytes:
    pixels = np.indices((16, 16)).sum(axis=0) % 2
    image = np.where(pixels[..., None] == 1, [230, 120, 40], [40, 60, 160]).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()


def tube(*, bones=5, frames=20, influences=4, rings=21, sides=12, scaled=False, offset=0.0):
    """A capped tube along y of exact skinning; its last bone turns more than a full circle."""
    height, angle = np.linspace(0, 4, rings), np.arange(sides) * 2 * np.pi / sides
    out = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    rest = (0.5 * out + height[:, None, None] * np.array([0, 1, 0])).reshape(-1, 3)
    rest = np.concatenate([rest, [[0, 0, 0], [0, 4, 0]]])
    # two triangles between neighbours of two rings, then one of either cap, by corners
    row = np.arange(rings - 1)[:, None, None, None] + np.array([[0, 1, 0], [0, 1, 1]])
    column = np.arange(sides)[:, None, None] + np.array([[0, 0, 1], [1, 0, 1]])
    row, column = np.broadcast_arrays(row, column)
    j, k, top = np.arange(sides), np.roll(np.arange(sides), -1), (rings - 1) * sides
    low, high = np.full(sides, rings * sides), np.full(sides, rings * sides + 1)
    caps = np.stack([low, j, k, high, top + k, top + j], axis=1).reshape(-1, 3)
    faces = np.concatenate([(row * sides + column % sides).reshape(-1, 3), caps])
    flat = np.tile([[0.5, 0.5], [0, 0], [1, 0]], (2 * sides, 1, 1))
    uv = np.stack([column / sides, height[row] / 4], axis=-1).reshape(-1, 3, 2)
    ends = np.tile(np.repeat([[0, -1, 0], [0, 1, 0]], 3, axis=0).reshape(2, 3, 3), (sides, 1, 1))
    upper = np.repeat(np.arange(rings - 1) >= rings // 2, 2 * sides)
    surface = ssdr.Surface(
        uv=np.concatenate([uv, flat]).astype(np.float32),
        normals=np.concatenate([out[column % sides].reshape(-1, 3, 3), ends]).astype(np.float32),
        material_index=np.concatenate([upper, np.tile([0, 1], sides)]).astype(np.int32),
        materials=(
            ssdr.Material(name="checker", base_color=(1, 1, 1, 1), texture=checker()),
            ssdr.Material(name="green", base_color=(0.1, 0.6, 0.2, 1.0), double_sided=True),
        ),
    )
    middle = (np.arange(bones) + 0.5) * 4 / bones
    dense = np.exp(-(((rest[:, 1:2] - middle) / (2.2 / bones * 2)) ** 2))
    indices = np.argsort(-dense, axis=1, kind="stable")[:, :influences]
    weights = np.take_along_axis(dense, indices, axis=1)
    weights /= weights.sum(axis=1, keepdims=True)
    transforms = np.zeros((frames, bones, 3, 4))
    phase = np.arange(frames) / max(1, frames - 1)
    motion, step = np.tile(np.eye(4), (2, frames, 1, 1))
    motion[:, :3, 3] = np.stack([phase, 0.2 * np.sin(6 * phase), 0 * phase + offset], axis=1)
    for b in range(bones):
        joint = np.array([0, 4 * b / bones, 0])
        turn, bend = 2.2 * np.pi * phase / bones, 0.5 * np.sin(2 * np.pi * phase + b)
        r = Rotation.from_euler("yx", np.stack([turn, bend], axis=1)).as_matrix()
        step[:, :3, :3], step[:, :3, 3] = r, joint - r @ joint
        motion = motion @ step
        transforms[:, b] = motion[:, :3]
        if scaled:
            size = 1 + 0.3 * np.sin(5 * phase + b)[:, None]
            transforms[:, b, :, :3] *= size[..., None]
            transforms[:, b, :, 3] += motion[:, :3, :3] @ joint * (1 - size)
    return ssdr.Skinning(
        rest,
        indices,
        weights,
        transforms,
        faces=faces,
        fps=FPS,
        bone_model="similarity" if scaled else "rigid",
        surface=surface,
        name="tube",
    )


def largest_distance(a, b):
    return float(np.sqrt(((np.asarray(a, dtype=float) - b) ** 2).sum(axis=-1)).max())


def baked_by_usd(path, times):
    """World points at each time, deformed by UsdSkel.BakeSkinning."""
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(path))
    assert UsdSkel.BakeSkinning(stage.Traverse())
    mesh = items(stage, UsdGeom.Mesh)[0]
    result = []
    for time in times:
        world = np.array(mesh.ComputeLocalToWorldTransform(time))
        points = np.array(mesh.GetPointsAttr().Get(time), dtype=float)
        result.append(points @ world[:3, :3] + world[3, :3])
    return np.array(result)
