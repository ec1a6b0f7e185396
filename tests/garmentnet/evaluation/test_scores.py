# ruff: noqa: E402
import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import ssdr
from garmentnet.evaluation.methods import BonesThemselves, MeanDetail, Method, Network
from garmentnet.evaluation.scores import chaos_floor, evaluate
from garmentnet.evaluation.tables import score_table
from ssdr.common.errors import InputError
from ssdr.metrics import compare

CLIP = "base-test-0"


class Plain(Method):
    """A method from a function that returns its vertices."""

    def __init__(self, function, name="plain"):
        self.function, self.name = function, name

    def predict(self, clip):
        return self.function(clip)


class Split(Plain):
    """A method from a function that returns its low and high part."""

    def predict(self, clip):
        return sum(self.function(clip))

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
    methods = [BonesThemselves(toy_bones), Network("network", toy_network)]
    bones, network = evaluate(toy_bones, methods, [CLIP])
    assert bones.all.high.rmse < 1e-3
    # What the body carries is exact; the others are where the fitted bones put them.
    s, fitted = toy_bones.skinning, toy_bones.transforms(CLIP)
    gap = ssdr.skin(s.rest, s.indices, s.weights, fitted) - toy_bones.split(CLIP)[0]
    gap[:, toy_bones.bound.index] = 0
    assert np.isclose(bones.all.low.rmse, 1e3 * np.sqrt((gap**2).sum(-1).mean()), rtol=1e-3)
    assert bones.all.overall.rmse < 0.5 * network.all.overall.rmse


def test_a_constant_leaves_of_the_detail_what_moves(toy_bones, toy_store):
    """Detail c ± a, in turn, that turns with a rigid cloth: √(a² / (c² + a²)) is left."""
    n = toy_store.n_vertices
    rng = np.random.default_rng(0)
    constant, wave = rng.normal(size=(2, n, 3)) * 1e-3
    skinning = toy_bones.skinning

    class Rigid(type(toy_bones)):
        def transforms(self, name):
            root = toy_store.clip(name).joints[:, :1]
            return np.repeat(root, skinning.n_bones, axis=1).astype(np.float32)

        def fit(self, low):
            return self.moved

        def split(self, name, frames=slice(None)):
            moved = self.transforms(name)[frames]
            object.__setattr__(self, "moved", moved)
            sign = (-1.0) ** np.arange(toy_store.clip(name).n_frames)[frames]
            local = constant + sign[:, None, None] * wave
            high = np.einsum("fij,fvj->fvi", moved[:, 0, :, :3], local)
            s = skinning
            low = ssdr.skin(s.rest, s.indices, s.weights, moved)
            return low.astype(np.float32), high.astype(np.float32)

    rigid = Rigid(**{f.name: getattr(toy_bones, f.name) for f in dataclasses.fields(toy_bones)})
    (row,) = evaluate(rigid, [MeanDetail(rigid)], [CLIP, "base-test-1"])
    a, c = np.square(wave).sum(), np.square(constant).sum()
    assert row.all.detail == pytest.approx(1e3 * np.sqrt((a + c) / n), rel=1e-3)
    assert row.all.left == pytest.approx(np.sqrt(a / (a + c)), rel=1e-3)
    assert f" {100 * row.all.left:.0f} % " in score_table([row])
    nothing = Split(lambda clip: (rigid.split(clip.name)[0], np.zeros((90, n, 3), np.float32)))
    (row,) = evaluate(rigid, [nothing], [CLIP])
    assert row.all.left == pytest.approx(1)


def test_a_plain_method_is_split_like_the_data(toy_bones):
    method = Plain(lambda c: c.sequence.frames(slice(None)))
    (row,) = evaluate(toy_bones, [method], [CLIP])
    assert row.all.low.rmse < 1e-3
    assert row.all.high.rmse < 1e-3


def test_chaos_floor_of_known_noise(toy_bones):
    # 1 mm along each axis: the pair differs by √3 mm, each from the mean by that over √2.
    floor = chaos_floor(toy_bones, toy_bones.store.pairs())
    assert np.isclose(floor["overall"], np.sqrt(3 / 2), rtol=0.05)
    assert floor["low"] < floor["overall"]
    a, b = (toy_bones.split(n)[1].astype(float) for n in (CLIP, f"{CLIP}-again"))
    expected = 1e3 * np.sqrt(((a - b) ** 2).sum(-1).mean() / 2)
    assert floor["high"] == pytest.approx(expected, rel=1e-3)
    assert floor["overall_free"] == floor["overall"]
    assert floor["frames"] == 90
    free = slice(toy_bones.store.n_vertices // 2, None)
    half = with_pinned(toy_bones, np.arange(toy_bones.store.n_vertices) < free.start)
    a, b = (toy_bones.store.clip(x).sequence.frames(slice(None)) for x in (CLIP, f"{CLIP}-again"))
    expected = 1e3 * np.sqrt(((a - b)[:, free].astype(float) ** 2).sum(-1).mean() / 2)
    found = chaos_floor(half, toy_bones.store.pairs())["overall_free"]
    assert np.isclose(found, expected, rtol=1e-5)


def with_pinned(bones, pinned):
    store = dataclasses.replace(bones.store, pinned=np.asarray(pinned, bool))
    return dataclasses.replace(bones, store=store)


def test_exact_pinned_vertices_flatter_the_error_over_all(toy_bones):
    n = toy_bones.store.n_vertices
    bones = with_pinned(toy_bones, np.arange(n) < n // 4)
    (row,) = evaluate(
        bones,
        [truth_method(bones, low=3e-3, where=~bones.store.pinned[:, None])],
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
    other = method.predict(toy_bones.store.clip(CLIP))[:, used]
    c = compare(truth, other, numbered.reshape(-1, 3))
    assert np.isclose(row.free.overall.hausdorff, 1e3 * c.hausdorff.vertex_mean, rtol=1e-5)
    assert np.isclose(row.free.overall.sted, c.sted.value, rtol=1e-4)


def test_a_garment_that_is_pinned_is_refused(toy_bones):
    n = toy_bones.store.n_vertices
    with pytest.raises(InputError, match="free triangles"):
        evaluate(with_pinned(toy_bones, np.ones(n)), [], [CLIP])


def test_rows_are_pooled_from_clips_and_classes(toy_bones, toy_network):
    (row,) = evaluate(toy_bones, [Network("network", toy_network)], [CLIP, "base-test-1"])
    assert [c.name for c in row.clips] == [CLIP, "base-test-1"]
    frames = [c.frames for c in row.clips]
    pooled = np.sqrt(np.average([c.all.overall.rmse**2 for c in row.clips], weights=frames))
    assert np.isclose(row.all.overall.rmse, pooled)
    for scores in (row, *row.clips):
        counts = [e.frames for e in scores.per_class.values()]
        assert sum(counts) == scores.frames
        square = np.average([e.all**2 for e in scores.per_class.values()], weights=counts)
        assert np.isclose(scores.all.overall.rmse, np.sqrt(square))
        assert scores.free == scores.all  # no vertex of the toy is pinned
