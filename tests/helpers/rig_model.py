"""A small exact model for tests of formats: a bending tube with seam, hard edges, two materials."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

import ssdr
from ssdr.model.rigid import matrix_from_quaternion

FPS = 24.0


def checker() -> bytes:
    pixels = np.indices((16, 16)).sum(axis=0) % 2
    image = np.where(pixels[..., None] == 1, [230, 120, 40], [40, 60, 160]).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()


def tube(*, bones=5, frames=20, influences=4, rings=21, sides=12, scaled=False, offset=0.0):
    """A capped tube along y of exact skinning; its last bone turns more than a full circle."""
    height = np.linspace(0, 4, rings)
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([0.5 * np.cos(angle), 0 * angle, 0.5 * np.sin(angle)], axis=1)
    rest = (ring[None] + height[:, None, None] * np.array([0, 1, 0])).reshape(-1, 3)
    rest = np.concatenate([rest, [[0, 0, 0], [0, 4, 0]]])
    faces, uv, normals, material = [], [], [], []

    def add(corner_ids, corner_uv, corner_normals, k):
        faces.append(corner_ids)
        uv.append(corner_uv)
        normals.append(corner_normals)
        material.append(k)

    def out(j):
        return [np.cos(angle[j % sides]), 0, np.sin(angle[j % sides])]

    for i in range(rings - 1):
        for j in range(sides):
            a, b = i * sides + j, i * sides + (j + 1) % sides
            c, d = a + sides, b + sides
            u0, u1, v0, v1 = j / sides, (j + 1) / sides, height[i] / 4, height[i + 1] / 4
            k = int(i >= rings // 2)
            add([a, c, b], [[u0, v0], [u0, v1], [u1, v0]], [out(j), out(j), out(j + 1)], k)
            add([b, c, d], [[u1, v0], [u0, v1], [u1, v1]], [out(j + 1), out(j), out(j + 1)], k)
    for j in range(sides):
        a, b = j, (j + 1) % sides
        low, high = rings * sides, rings * sides + 1
        top = (rings - 1) * sides
        add([low, a, b], [[0.5, 0.5], [0, 0], [1, 0]], [[0, -1, 0]] * 3, 0)
        add([high, top + b, top + a], [[0.5, 0.5], [0, 0], [1, 0]], [[0, 1, 0]] * 3, 1)
    surface = ssdr.Surface(
        uv=np.array(uv, dtype=np.float32),
        normals=np.array(normals, dtype=np.float32),
        material_index=np.array(material, dtype=np.int32),
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
    for t in range(frames):
        phase = t / max(1, frames - 1)
        motion = np.eye(4)
        motion[:3, 3] = [phase, 0.2 * np.sin(6 * phase), offset]
        for b in range(bones):
            joint = np.array([0, 4 * b / bones, 0])
            bend = 0.5 * np.sin(2 * np.pi * phase + b)
            turn = 2.2 * np.pi * phase / bones
            q = np.array([0, np.sin(turn / 2), 0, np.cos(turn / 2)])
            r = matrix_from_quaternion(q)
            q = np.array([np.sin(bend / 2), 0, 0, np.cos(bend / 2)])
            r = matrix_from_quaternion(q) @ r
            step = np.eye(4)
            step[:3, :3] = r
            step[:3, 3] = joint - r @ joint
            motion = motion @ step
            transforms[t, b] = motion[:3]
            if scaled:
                size = 1 + 0.3 * np.sin(5 * phase + b)
                transforms[t, b, :, :3] *= size
                transforms[t, b, :, 3] += motion[:3, :3] @ joint * (1 - size)
    return ssdr.Skinning(
        rest,
        indices,
        weights,
        transforms,
        faces=np.array(faces),
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
    mesh = next(UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    result = []
    for time in times:
        world = np.array(mesh.ComputeLocalToWorldTransform(time))
        points = np.array(mesh.GetPointsAttr().Get(time), dtype=float)
        result.append(points @ world[:3, :3] + world[3, :3])
    return np.array(result)
