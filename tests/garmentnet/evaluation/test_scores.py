# ruff: noqa: E402
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from garmentnet.evaluation.scores import (
    Answer,
    bones_themselves,
    by_looseness,
    chaos_floor,
    evaluate,
    looseness,
    network_method,
    plain_method,
    table,
)

CLIP = "base-test-0"


def truth_method(bones, *, low=0.0, high=0.0):
    def answer(clip):
        kept = bones.clip(clip.name)
        return Answer(kept.read("low") + np.float32(low), kept.read("high") + np.float32(high))

    return answer


def test_known_errors(toy_bones):
    # 3 mm along each axis in the low part, 4 mm in the high part.
    methods = {
        "truth": truth_method(toy_bones),
        "off": truth_method(toy_bones, low=3e-3, high=4e-3),
    }
    truth, off = evaluate(toy_bones, methods, [CLIP, "base-test-1"])
    assert truth.frames == 180
    for part in (truth.low, truth.high, truth.overall):
        assert (part.rmse, part.hausdorff, part.sted) == (0, 0, 0)
    root3 = np.sqrt(3)
    assert np.isclose(off.low.rmse, 3 * root3, rtol=1e-3)
    assert np.isclose(off.high.rmse, 4 * root3, rtol=1e-3)
    assert np.isclose(off.overall.rmse, 7 * root3, rtol=1e-3)
    assert off.overall.hausdorff <= 7 * root3 + 1e-2
    assert off.overall.sted < 1e-3  # one translation changes no edge
    assert np.allclose(off.per_vertex, 7 * root3, rtol=1e-3)
    assert set(off.per_class) == {"stand", "walk", "sway", "spin"}
    assert np.allclose(list(off.per_class.values()), 7 * root3, rtol=1e-3)
    assert "truth" in table([truth, off])


def test_low_and_high_add_up_to_the_clip(toy_bones, toy_store):
    clip, kept = toy_store.clip(CLIP), toy_bones.clip(CLIP)
    whole = clip.sequence.frames(slice(None))
    assert np.abs(kept.read("low") + kept.read("high") - whole).max() < 1e-6
    expected = toy_bones.smoother().smooth(whole)
    assert np.abs(kept.read("low") - expected).max() < 1e-6


def test_mirrored_parts_are_those_of_the_mirrored_clip(toy_bones, toy_store):
    mirrored = toy_store.clip(CLIP).mirrored()
    kept = toy_bones.clip(mirrored.name)
    whole = mirrored.sequence.frames(slice(None))
    expected = toy_bones.smoother().smooth(whole)
    assert np.abs(kept.read("low") - expected).max() < 1e-5
    assert np.abs(kept.read("high", slice(3, 9)) - (whole - expected)[3:9]).max() < 1e-5


def test_bones_are_a_bound(toy_bones, toy_network):
    methods = {"bones": bones_themselves(toy_bones), "network": network_method(toy_network)}
    bones, network = evaluate(toy_bones, methods, [CLIP])
    assert bones.high.rmse < 1e-3
    assert np.isclose(bones.low.rmse, 1e3 * toy_bones.clip(CLIP).rmse, rtol=1e-3)
    assert bones.overall.rmse < 0.5 * network.overall.rmse


def test_a_plain_method_is_split_like_the_data(toy_bones, toy_store):
    clip = toy_store.clip(CLIP)
    method = plain_method(toy_bones, lambda joints: clip.sequence.frames(slice(None)))
    (row,) = evaluate(toy_bones, {"all": method}, [CLIP])
    assert row.low.rmse < 1e-3
    assert row.high.rmse < 1e-3


def test_chaos_floor_of_known_noise(toy_bones):
    # 1 mm along each axis: the pair differs by √3 mm, each from the mean by that over √2.
    floor = chaos_floor(toy_bones)
    assert np.isclose(floor["all"]["overall"], np.sqrt(3 / 2), rtol=0.05)
    assert floor["all"]["low"] < floor["all"]["overall"]
    assert sum(v["frames"] for k, v in floor.items() if k != "all") == 90
    assert chaos_floor(toy_bones, []) == {}


def test_looseness_against_a_loop(toy_bones, toy_store):
    mean, deviation = looseness(toy_bones, [CLIP], every=30)
    clip = toy_store.clip(CLIP)
    gaps = []
    for t in (0, 30, 60):
        body, cloth = clip.body([t])[0], clip.sequence.frames(t)
        gaps.append(np.linalg.norm(cloth[:, None] - body, axis=-1).min(axis=1) * 1e3)
    assert np.allclose(mean, np.mean(gaps, axis=0), rtol=1e-4)
    assert np.allclose(deviation, np.std(gaps, axis=0), atol=1e-2)
    (row,) = evaluate(toy_bones, {"off": truth_method(toy_bones, low=1e-3)}, [CLIP])
    quarters = by_looseness(row, mean)
    assert [d for d, _ in quarters] == sorted(d for d, _ in quarters)


def test_cloth_in_the_body_is_counted(toy_bones, toy_store):
    clip = toy_store.clip(CLIP)
    axis = clip.outfit.skeleton.positions(clip.joints)[:, :1] - [0, 0.2, 0]

    def inside(joints):
        shape = (clip.n_frames, toy_store.n_vertices, 3)
        return np.broadcast_to(axis, shape).astype(np.float32)

    outside = plain_method(toy_bones, lambda joints: inside(joints) + np.float32(5))
    rows = evaluate(toy_bones, {"in": plain_method(toy_bones, inside), "out": outside}, [CLIP])
    assert rows[0].inside > 0.95
    assert rows[0].depth_max >= rows[0].depth_mean > 10
    assert rows[1].inside == 0
