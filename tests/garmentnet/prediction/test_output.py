"""Files of predictions."""

import dataclasses
import types

import numpy as np
import pytest
from PIL import Image, ImageSequence

import ssdr
from garmentnet.data.parameters import SimulationParameters
from garmentnet.prediction.output import check_outputs, save_prediction
from garmentnet.prediction.prediction import predict
from helpers.page import Held


@pytest.mark.parametrize("suffix", ["npz", "pc2", "obj", "usda"])
def test_vertices_survive(toy_network, joints, tmp_path, suffix):
    if suffix == "usda":
        pytest.importorskip("pxr")
    p = predict(toy_network, joints)
    path = tmp_path / ("cloth%04d.obj" if suffix == "obj" else f"cloth.{suffix}")
    save_prediction(p, path)
    read = ssdr.load(path, **({"faces": p.cloth.faces} if suffix == "pc2" else {}))
    assert np.abs(np.asarray(read.vertices) - p.cloth.vertices).max() < 1e-5


@pytest.mark.parametrize("kind", ["toy_network", "pair"])
def test_glb_holds_rigid_bones(kind, request, joints, tmp_path):
    checkpoint = request.getfixturevalue(kind)
    parameters = SimulationParameters(bending=1.0) if kind == "pair" else None
    p = predict(checkpoint, joints, parameters)
    save_prediction(p, tmp_path / "cloth.glb")
    read = ssdr.load_skinning(tmp_path / "cloth.glb")
    low = np.concatenate([m.to_world(m.low) for m in checkpoint.motions(joints, parameters)])
    gap = float(np.sqrt(((read.skin() - low) ** 2).sum(-1).mean()))
    # The mixture of two networks is not rigid; what comes close is written.
    assert gap < (1e-4 if kind == "toy_network" else 2e-2)


def test_a_page_of_the_bones_beside_the_prediction(pair, joints, tmp_path):
    p = predict(pair, joints, SimulationParameters(bending=1.0))
    text = save_prediction(p, tmp_path / "a.html")
    assert text == (
        "a page of the virtual bones beside the prediction with all its detail, 12 frames"
    )
    page = Held((tmp_path / "a.html").read_text(encoding="utf-8"))
    assert page.document["rig"]["names"] == list(p.skinning.names())
    np.testing.assert_allclose(page.vertices(), p.skinning.skin(), atol=1e-5)
    np.testing.assert_allclose(page.input(), p.cloth.vertices, atol=1e-4)


def test_a_page_of_the_prediction_beside_the_simulation(toy_network, toy_store, tmp_path):
    clip = toy_store.clip("base-test-0")
    p = predict(toy_network, clip.joints)
    text = save_prediction(p, tmp_path / "a.html", truth=clip)
    assert text == "a page of the prediction beside the simulation, 90 frames"
    page = Held((tmp_path / "a.html").read_text(encoding="utf-8"))
    truth = clip.sequence.frames(slice(None))
    np.testing.assert_allclose(page.vertices(), p.cloth.vertices, atol=1e-5)
    np.testing.assert_allclose(page.input(), truth, atol=1e-4)
    largest = np.linalg.norm(p.cloth.vertices - truth, axis=2).max(axis=1)
    np.testing.assert_allclose(page.document["error"]["largest"], largest, rtol=1e-4)


def test_pictures_and_films(toy_network, joints, tmp_path):
    p = predict(toy_network, joints[:5])
    seen = []
    save_prediction(p, tmp_path / "a.png")
    # Of every second frame, at the same speed.
    options = {"size": 64, "every": 2, "progress": lambda _, done: seen.append(done)}
    save_prediction(p, tmp_path / "a.gif", **options)
    assert seen[-1] == 1
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 3
        assert film.info["duration"] == pytest.approx(2000 / 30, abs=10)
    save_prediction(p, tmp_path / "a.webp", size=97)
    frames = decoded(tmp_path / "a.webp")
    assert len(frames) == 5
    assert frames[0].shape == (96, 96, 3)
    assert frames[0].std() > 5


def decoded(path):
    with Image.open(path) as film:
        return [np.asarray(f.convert("RGB"), int) for f in ImageSequence.Iterator(film)]


def test_a_film_of_truth_beside_prediction(toy_network, toy_store, tmp_path):
    clip = toy_store.clip("base-test-0")
    p, cut = predict(toy_network, clip.joints[:4]), first_frames(clip, 4)
    text = save_prediction(p, tmp_path / "a.webp", size=96, truth=cut)
    assert text == "a film of truth and prediction, 4 frames"
    frames = decoded(tmp_path / "a.webp")
    assert len(frames) == 4
    height, width = frames[0].shape[:2]
    assert width == 72 * 2 + 2
    assert height > 96
    head = 10
    one, two = (frames[3][head : head + 96, k * 74 : k * 74 + 72] for k in (0, 1))
    assert (np.abs(one - two).sum(2) > 40).mean() > 0.003
    # Skin and cloth have colours of their own.
    reddish = one[..., 0] - one[..., 2]
    assert (reddish > 25).sum() > 10
    assert (reddish < -40).sum() > 50


def test_truth_that_does_not_fit_is_named(toy_network, toy_store, joints, tmp_path):
    p = predict(toy_network, joints)
    with pytest.raises(ssdr.InputError, match="truth"):
        save_prediction(p, tmp_path / "a.gif", size=64, truth=toy_store.clip("base-test-0"))
    assert list(tmp_path.iterdir()) == []


def test_what_is_read_is_not_written_over(tmp_path):
    motion = tmp_path / "walk.npz"
    np.savez(motion, joints=np.zeros(3))
    for same in (motion, tmp_path / "." / "walk.npz"):
        with pytest.raises(ssdr.InputError, match="output"):
            check_outputs([same], [motion])
    check_outputs([tmp_path / "dress.npz"], [motion])
    for twice in ([tmp_path / "a.png"] * 2, [tmp_path / "a.npz"] * 2):
        with pytest.raises(ssdr.InputError, match="output"):
            check_outputs(twice)
    check_outputs([tmp_path / "a.obj", tmp_path / "a%03d.obj"])
    with pytest.raises(ssdr.InputError, match=r"output: .* %04d.*a\.obj"):
        check_outputs([tmp_path / "a.obj"], frames=2)


def test_a_fast_motion_is_a_film_at_its_speed(toy_network, joints, tmp_path):
    p = predict(toy_network, joints)
    cloth = ssdr.MeshSequence(p.cloth.vertices, p.cloth.faces, 120.0)
    fast = dataclasses.replace(p, cloth=cloth)
    for suffix in ("gif", "webp"):
        save_prediction(fast, tmp_path / f"a.{suffix}", size=64)
        with Image.open(tmp_path / f"a.{suffix}") as film:
            lasting = []
            for frame in range(film.n_frames):
                film.seek(frame)
                film.load()
                lasting.append(film.info["duration"])
        assert sum(lasting) == pytest.approx(1000 * len(joints) / 120, abs=40)


def first_frames(clip, count):
    """A clip cut off, as far as films use it."""

    cloth = np.asarray(clip.sequence.vertices[:count])
    return types.SimpleNamespace(
        outfit=clip.outfit,
        n_frames=count,
        classes=clip.classes[:count],
        sequence=ssdr.MeshSequence(cloth, clip.outfit.faces, clip.fps),
    )
