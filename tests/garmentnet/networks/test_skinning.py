import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import ssdr
from garmentnet.paper.bones import (
    TorchSkinning,
    apply_frame,
    matrix_from_euler,
    matrix_from_sixd,
    remove_frame,
)


def random_model(rng, frames=4, vertices=13, bones=5, influences=3):
    rest = rng.normal(size=(vertices, 3))
    indices = rng.integers(0, bones, size=(vertices, influences))
    weights = rng.random((vertices, influences))
    weights /= weights.sum(axis=1, keepdims=True)
    r = Rotation.random(frames * bones, rng=rng).as_matrix().reshape(frames, bones, 3, 3)
    return rest, indices, weights, np.concatenate([r, rng.normal(size=(frames, bones, 3, 1))], -1)


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_same_as_ssdr(seed):
    # Joints may repeat within a vertex: their weights add up.
    rest, indices, weights, transforms = random_model(np.random.default_rng(seed))
    expected = ssdr.skin(rest, indices, weights, transforms)
    module = TorchSkinning(rest, indices, weights, 5)
    single = module(torch.from_numpy(transforms).float()).numpy()
    assert np.abs(single - expected).max() < 4e-6
    lead = module(torch.from_numpy(transforms).float().reshape(2, 2, 5, 3, 4))
    assert lead.shape == (2, 2, 13, 3)
    assert np.abs(lead.reshape(4, 13, 3).numpy() - expected).max() < 4e-6


def test_gradient():
    rest, indices, weights, transforms = random_model(np.random.default_rng(1))
    module = TorchSkinning(rest, indices, weights, 5).double()
    m = torch.from_numpy(transforms).requires_grad_()
    assert torch.autograd.gradcheck(module, (m,))


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_rotations(seed):
    degrees = np.random.default_rng(seed).uniform(-180, 180, size=(3, 3))
    expected = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    assert np.abs(matrix_from_euler(torch.from_numpy(degrees)).numpy() - expected).max() < 1e-12
    columns = torch.from_numpy(np.concatenate([expected[..., 0], expected[..., 1]], -1))
    assert np.abs(matrix_from_sixd(2.5 * columns).numpy() - expected).max() < 1e-12


def test_frames_undo_each_other():
    rng = np.random.default_rng(3)
    frame = torch.from_numpy(random_model(rng)[3][0])
    points = torch.from_numpy(rng.normal(size=(5, 7, 3)))
    assert torch.allclose(remove_frame(frame, apply_frame(frame, points)), points, atol=1e-12)
    one = frame[0, :, :3].numpy() @ points[0, 0].numpy() + frame[0, :, 3].numpy()
    assert np.allclose(apply_frame(frame, points)[0, 0], one)
