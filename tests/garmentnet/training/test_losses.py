import numpy as np
import torch
import trimesh

from garmentnet.training.losses import (
    BodyShape,
    closest_vertices,
    collision_depth,
    frame_norm,
    mesh_laplacian,
)
from helpers import toy_store as toy


def test_frame_norm_is_the_rmse_of_a_frame():
    rng = np.random.default_rng(0)
    d = rng.normal(size=(4, 9, 3))
    expected = np.sqrt((d**2).sum(-1).mean(-1))
    assert np.isclose(float(frame_norm(torch.from_numpy(d))), expected.mean())


def test_an_exact_fit_has_a_gradient():
    d = torch.zeros(2, 5, 3, requires_grad=True)
    frame_norm(d).backward()
    assert bool(torch.isfinite(d.grad).all())


def test_laplacian_against_a_loop():
    _, faces, _ = toy.skirt(columns=8, rings=3)
    near = [set() for _ in range(24)]
    for f in faces:
        for k in range(3):
            near[f[k]] |= {int(i) for i in f if i != f[k]}
    x = np.random.default_rng(0).normal(size=(2, 24, 3))
    expected = np.stack([x[:, i] - x[:, sorted(near[i])].mean(axis=1) for i in range(24)], axis=1)
    got = np.stack([mesh_laplacian(faces, 24) @ a for a in x])
    assert np.abs(got - expected).max() < 1e-6


def test_body_shape_is_that_of_the_clip(toy_store):
    clip = toy_store.clip("base-test-0")
    body, normals = BodyShape(toy_store.body)(torch.from_numpy(clip.joints[:6]))
    assert np.abs(body.numpy() - clip.body(slice(0, 6))).max() < 1e-5
    # Outwards, and of unit length.
    outward = body - body.mean(dim=1, keepdim=True)
    assert float((outward * normals).sum(-1).mean()) > 0
    assert torch.allclose(normals.norm(dim=-1), torch.ones(()), atol=1e-5)


def test_closest_and_depth_against_a_loop():
    rng = np.random.default_rng(0)
    points, body = rng.normal(size=(3, 11, 3)), rng.normal(size=(3, 7, 3))
    normals = rng.normal(size=(3, 7, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    p, b, n = (torch.from_numpy(x) for x in (points, body, normals))
    index, depth = closest_vertices(p, b).numpy(), collision_depth(p, b, n).numpy()
    for f in range(3):
        for i in range(11):
            gaps = np.linalg.norm(body[f] - points[f, i], axis=1)
            assert index[f, i] == gaps.argmin()
            k = gaps.argmin()
            expected = max(0.0, -(normals[f, k] @ (points[f, i] - body[f, k])))
            assert np.isclose(depth[f, i], expected)


def test_a_point_inside_a_sphere_is_pushed_out():

    sphere = trimesh.creation.icosphere(subdivisions=2)
    body = torch.from_numpy(np.array(sphere.vertices))[None]
    p = torch.tensor([[[0.0, 0.9, 0.0], [0.0, 1.1, 0.0]]], dtype=torch.float64, requires_grad=True)
    depth = collision_depth(p, body, body)
    assert depth[0, 1] == 0
    assert abs(float(depth[0, 0].detach()) - 0.1) < 0.02
    depth.sum().backward()
    assert p.grad[0, 0, 1] < -0.9
