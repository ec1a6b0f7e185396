import dataclasses
import types

import numpy as np
import pytest

import ssdr
from garmentnet.evaluation.methods import BonesThemselves, Chaos, Method, Network, VertexMethod
from garmentnet.evaluation.scores import evaluate
from garmentnet.evaluation.tables import score_table
from garmentnet.networks.features import HEADING, PoseFeatures
from ssdr.common.errors import InputError
from ssdr.metrics import compare

CLIP = "base-test-0"


class Plain(VertexMethod):
    """A method from a function that returns its vertices."""

    def __init__(self, function, name="plain"):
        self.function, self.name = function, name

    def predict(self, clip):
        return self.function(clip)


class Split(Method):
    """A method from a function that returns its low and high part."""

    def __init__(self, function, name="plain"):
        self.function, self.name = function, name

    def split(self, clip, bones):
        return self.function(clip)


def truth_method(bones, *, low=0.0, high=0.0, where=True):
    def parts(clip):
        true_low, true_high = bones.split(clip.name)
        return true_low + np.where(where, np.float32(low), np.float32(0)), true_high + np.float32(
            high
        )

    return Split(parts, "truth")


def test_known_errors(toy_bones):
    # 3 mm along each axis in the low part, 4 mm in the high part.
    methods = [truth_method(toy_bones), truth_method(toy_bones, low=3e-3, high=4e-3)]
    truth, off = evaluate(toy_bones, methods, [CLIP, "base-test-1"])
    assert truth.frames == 180
    for part in (truth.all.low, truth.all.high, truth.all.overall):
        assert (part.rmse, part.hausdorff, part.sted) == (0, 0, 0)
    root3 = np.sqrt(3)
    assert np.isclose(off.all.low.rmse, 3 * root3, rtol=1e-3)
    assert np.isclose(off.all.high.rmse, 4 * root3, rtol=1e-3)
    assert np.isclose(off.all.overall.rmse, 7 * root3, rtol=1e-3)
    assert off.all.overall.hausdorff <= 7 * root3 + 1e-2
    assert off.all.overall.sted < 1e-3  # one translation changes no edge
    assert set(off.per_class) == {"stand", "walk", "sway", "spin"}
    assert np.allclose([e.all for e in off.per_class.values()], 7 * root3, rtol=1e-3)
    assert "| truth " in score_table([truth, off])


def test_mirrored_parts_are_those_of_the_mirrored_clip(toy_bones, toy_store):
    mirrored = toy_store.clip(CLIP).mirrored()
    whole = mirrored.sequence.frames(slice(None))
    expected = toy_bones.smoother.smooth(whole)
    assert np.abs(toy_bones.split(mirrored.name)[0] - expected).max() < 1e-5
    some = toy_bones.split(mirrored.name, slice(3, 9))[1]
    assert np.abs(some - (whole - expected)[3:9]).max() < 1e-5


def test_bones_are_a_bound(toy_bones, toy_network):
    methods = [BonesThemselves(), Network("network", toy_network)]
    bones, network = evaluate(toy_bones, methods, [CLIP])
    assert bones.all.high.rmse < 1e-3
    # What the body carries is exact; the others are where the fitted bones put them.
    s, fitted = toy_bones.skinning, toy_bones.transforms(CLIP)
    gap = ssdr.skin(s.rest, s.indices, s.weights, fitted) - toy_bones.split(CLIP)[0]
    gap[:, toy_bones.bound.index] = 0
    assert np.isclose(bones.all.low.rmse, 1e3 * np.sqrt((gap**2).sum(-1).mean()), rtol=1e-3)
    assert bones.all.overall.rmse < 0.5 * network.all.overall.rmse


def test_a_plain_method_is_split_like_the_data(toy_bones):
    method = Plain(lambda c: c.sequence.frames(slice(None)))
    (row,) = evaluate(toy_bones, [method], [CLIP])
    assert row.all.low.rmse < 1e-3
    assert row.all.high.rmse < 1e-3


def test_chaos_of_known_noise(toy_bones):
    store = toy_bones.store
    (row,) = evaluate(toy_bones, [Chaos(store)], [CLIP])
    a, b = (
        store.clip(x).sequence.frames(slice(None)).astype(float) for x in (CLIP, f"{CLIP}-again")
    )
    moves = np.delete((b - a) / np.sqrt(2), toy_bones.bound.index, axis=1)  # the body places others
    square = (moves**2).sum() / a[..., 0].size
    assert row.all.overall.rmse == pytest.approx(1e3 * np.sqrt(square), rel=0.01)
    # 1 mm along each axis: the pair differs by √3 mm, each from the mean by that over √2.
    assert np.sqrt((moves**2).sum(-1).mean()) == pytest.approx(1e-3 * np.sqrt(3 / 2), rel=0.05)


def test_modes_are_principal_components_seen_from_the_heading(toy_bones):
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(90, toy_bones.store.n_vertices, 3)).astype(np.float32) * 1e-3
    off = Split(lambda clip: (toy_bones.split(clip.name)[0] + noise, toy_bones.split(clip.name)[1]))
    (row,) = evaluate(toy_bones, [off], [CLIP])
    assert list(row.modes) == ["1-10", "11-40", "41-192", "others"]
    total = np.sqrt(np.square(list(row.modes.values())).sum())
    assert total == pytest.approx(row.all.overall.rmse, rel=1e-5)
    # The naive way, with all training frames at once.
    features = PoseFeatures(toy_bones.store.skeleton, HEADING, toy_bones.store.fps)
    frames = []
    for name in toy_bones.report["clips"]:
        clip = toy_bones.store.clip(name)
        turn, place = np.split(features(clip.joints)[1], [3], axis=2)
        frames.append((clip.sequence.frames(slice(None)) - place[..., 0][:, None]) @ turn)
    rows = np.concatenate(frames).reshape(-1, noise[0].size)
    modes = np.linalg.svd(rows - rows.mean(axis=0), full_matrices=False)[2][:10]
    turn = features(toy_bones.store.clip(CLIP).joints)[1][..., :3]
    numbers = (noise @ turn).reshape(90, -1) @ modes.T
    naive = 1e3 * np.sqrt((numbers**2).sum() / noise[..., 0].size)
    assert row.modes["1-10"] == pytest.approx(naive, rel=1e-3)


def with_pinned(bones, pinned):
    bound = types.SimpleNamespace(index=np.flatnonzero(pinned))
    return dataclasses.replace(bones, bound=bound)


def test_exact_pinned_vertices_flatter_the_error_over_all(toy_bones):
    n = toy_bones.store.n_vertices
    bones = with_pinned(toy_bones, np.arange(n) < n // 4)
    (row,) = evaluate(
        bones,
        [truth_method(bones, low=3e-3, where=~bones.subject.carried[:, None])],
        [CLIP, "base-test-1"],
    )
    factor = np.sqrt(n / (n - n // 4))
    assert np.isclose(row.free.low.rmse, 3 * np.sqrt(3), rtol=1e-3)
    assert np.isclose(row.free.overall.rmse, row.all.overall.rmse * factor, rtol=1e-6)
    for error in row.per_class.values():
        assert np.isclose(error.free, error.all * factor, rtol=1e-6)
    # The free vertices moved as one body: no edge between them changed, those to the pinned did.
    assert row.free.low.sted < 1e-3 < row.all.low.sted


def test_free_shapes_are_those_of_the_free_triangles(toy_bones, toy_network):
    n, faces = toy_bones.store.n_vertices, toy_bones.store.faces
    bones = with_pinned(toy_bones, np.arange(n) < 16)
    method = Network("network", toy_network)
    (row,) = evaluate(bones, [method], [CLIP])
    inner = faces[(faces >= 16).all(axis=1)]
    used, numbered = np.unique(inner, return_inverse=True)
    truth = sum(toy_bones.split(CLIP))[:, used]
    other = toy_network.predict(toy_bones.store.clip(CLIP).joints)[:, used]
    c = compare(truth, other, numbered.reshape(-1, 3))
    assert np.isclose(row.free.overall.hausdorff, 1e3 * c.hausdorff.vertex_mean, rtol=1e-5)
    assert np.isclose(row.free.overall.sted, c.sted.value, rtol=1e-4)


def test_a_garment_that_is_pinned_is_refused(toy_bones):
    n = toy_bones.store.n_vertices
    with pytest.raises(InputError, match="free triangles"):
        evaluate(with_pinned(toy_bones, np.ones(n)), [], [CLIP])


def test_rows_are_pooled_from_clips_and_classes(toy_bones, toy_network):
    bones = dataclasses.replace(toy_bones, bound=None)
    (row,) = evaluate(bones, [Network("network", toy_network)], [CLIP, "base-test-1"])
    assert [c.name for c in row.clips] == [CLIP, "base-test-1"]
    frames = [c.frames for c in row.clips]
    pooled = np.sqrt(np.average([c.all.overall.rmse**2 for c in row.clips], weights=frames))
    assert np.isclose(row.all.overall.rmse, pooled)
    for scores in (row, *row.clips):
        counts = [e.frames for e in scores.per_class.values()]
        assert sum(counts) == scores.frames
        square = np.average([e.all**2 for e in scores.per_class.values()], weights=counts)
        assert np.isclose(scores.all.overall.rmse, np.sqrt(square))
        assert scores.free == scores.all
