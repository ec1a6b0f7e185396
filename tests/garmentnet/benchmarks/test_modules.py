"""The comparison of high-frequency modules: what they see, and the rows that need no training."""

# ruff: noqa: E402
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from benchmarks.garment import detail
from benchmarks.garment.modules import Comparison
from garmentnet.configs.config import override
from garmentnet.networks.features import PoseFeatures


@pytest.fixture(scope="module")
def run(toy_bones, toy_config, tmp_path_factory):
    settings = ["high.hidden=8", "high.collision=0.0", "train.high_epochs=2", "train.batch=5"]
    config = override(toy_config(), settings)
    return Comparison(toy_bones, config, 3, tmp_path_factory.mktemp("modules"))


def test_modules_see_the_simulation(run, toy_store):
    (clip, *_), bones = run.clips["test"], run.bones
    free = np.flatnonzero(~toy_store.pinned)[:: detail.SPARSE]
    joints = toy_store.clip(clip.name).joints
    frame = PoseFeatures(toy_store.skeleton, run.config.features, toy_store.fps)(joints)[1][::3]
    low, high = (x[::3, free] for x in bones.split(clip.name))
    mesh, turned = run.vertices(clip).numpy().swapaxes(0, 1)
    assert np.abs(turned @ frame[..., :3].swapaxes(1, 2) - high).max() < 1e-5
    world = mesh @ frame[..., :3].swapaxes(1, 2) + frame[:, None, :, 3]
    # But for what skinning leaves.
    assert np.sqrt(np.square(world - low).sum(-1).mean()) < 0.01
    turn = run.turns(torch.from_numpy(clip.local).float()).numpy()
    left = (turn @ clip.left[..., None])[..., 0] @ frame[..., :3].swapaxes(1, 2)
    assert np.abs(world + left - low - high).max() < 1e-5


def test_rows_without_training(run):
    known = np.concatenate([c.detail for c in run.clips["train"]])
    found, _ = run.mean()
    assert np.abs(found[0] - known.mean(axis=0)).max() < 1e-7
    test, run.clips["test"] = run.clips["test"], run.clips["train"]
    try:
        (first, *_), _ = run.matching(1)
        # Motions may begin alike, from rest.
        own = run.clips["train"][0].detail
        assert np.abs(first - own)[8:].max() < 1e-7
    finally:
        run.clips["test"] = test


def test_what_a_module_predicts_is_what_it_is_scored_by(run):
    found, module = run.edges((4, 4, 4))
    clip = run.clips["test"][0]
    assert len(module.edges) == 3
    assert found[0].shape == clip.detail.shape
    assert run.components["basis"].shape[1] == clip.detail[0].size
    again, _ = run.edges((4, 4, 4))  # read, not trained again
    assert np.array_equal(found[0], again[0])
