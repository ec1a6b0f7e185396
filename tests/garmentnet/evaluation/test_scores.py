# ruff: noqa: E402
import dataclasses
import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import ssdr
from garmentnet.evaluation.clip_scores import ClipScore
from garmentnet.evaluation.score_cache import ScoreCache
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
from ssdr.errors import FormatError, InputError
from ssdr.metrics import compare

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
    # What the body carries is exact; the others are where the fitted bones put them.
    s, fitted = toy_bones.skinning, toy_bones.clip(CLIP)
    gap = ssdr.skin(s.rest, s.indices, s.weights, fitted.transforms) - fitted.read("low")
    whole = np.sqrt((gap.astype(float) ** 2).sum(-1).mean())
    assert np.isclose(whole, fitted.rmse, rtol=1e-3)
    gap[:, toy_bones.bound.index] = 0
    assert np.isclose(bones.low.rmse, 1e3 * np.sqrt((gap**2).sum(-1).mean()), rtol=1e-3)
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


def with_pinned(bones, pinned):
    store = dataclasses.replace(bones.store, pinned=np.asarray(pinned, bool))
    return dataclasses.replace(bones, store=store)


def exact_where_pinned(bones, offset=3e-3):
    free = ~bones.store.pinned[:, None]

    def answer(clip):
        kept = bones.clip(clip.name)
        off = np.where(free, np.float32(offset), np.float32(0))
        return Answer(kept.read("low") + off, kept.read("high"))

    return answer


def test_exact_pinned_vertices_flatter_the_error_over_all(toy_bones):
    n = toy_bones.store.n_vertices
    bones = with_pinned(toy_bones, np.arange(n) < n // 4)
    (row,) = evaluate(bones, {"exact": exact_where_pinned(bones)}, [CLIP, "base-test-1"])
    factor = np.sqrt(n / (n - n // 4))
    assert np.isclose(row.free.low.rmse, 3 * np.sqrt(3), rtol=1e-3)
    assert np.isclose(row.free.overall.rmse, row.overall.rmse * factor, rtol=1e-6)
    for label, error in row.per_class.items():
        assert np.isclose(row.per_class_free[label], error * factor, rtol=1e-6)
    # The free vertices moved as one body: no edge between them changed, those to the pinned did.
    assert row.free.low.sted < 1e-3 < row.low.sted


def test_free_shapes_are_those_of_the_free_triangles(toy_bones, toy_network):
    n, faces = toy_bones.store.n_vertices, toy_bones.store.faces
    bones = with_pinned(toy_bones, np.arange(n) < 16)
    method = network_method(toy_network)
    (row,) = evaluate(bones, {"network": method}, [CLIP])
    inner = faces[(faces >= 16).all(axis=1)]
    used, numbered = np.unique(inner, return_inverse=True)
    kept, answer = toy_bones.clip(CLIP), method(toy_bones.store.clip(CLIP))
    truth = (kept.read("low") + kept.read("high"))[:, used]
    other = (answer.low + answer.high)[:, used]
    c = compare(truth, other, numbered.reshape(-1, 3))
    assert np.isclose(row.free.overall.hausdorff, 1e3 * c.hausdorff.vertex_mean, rtol=1e-5)
    assert np.isclose(row.free.overall.sted, c.sted.value, rtol=1e-4)


def test_a_garment_that_is_pinned_is_refused(toy_bones):
    n = toy_bones.store.n_vertices
    with pytest.raises(InputError, match="free triangles"):
        evaluate(with_pinned(toy_bones, np.ones(n)), {}, [CLIP])


def test_rows_are_pooled_from_clips_and_classes(toy_bones, toy_network):
    methods = {"network": network_method(toy_network)}
    (row,) = evaluate(toy_bones, methods, [CLIP, "base-test-1"])
    assert [c.clip for c in row.clips] == [CLIP, "base-test-1"]
    frames = [c.frames for c in row.clips]
    pooled = np.sqrt(np.average([c.all.overall.rmse**2 for c in row.clips], weights=frames))
    assert np.isclose(row.overall.rmse, pooled)
    for clip in row.clips:
        counts = [k.frames for k in clip.classes]
        assert sum(counts) == clip.frames
        square = np.average([k.all.low.rmse**2 for k in clip.classes], weights=counts)
        assert np.isclose(clip.all.low.rmse, np.sqrt(square))
        mean = np.average([k.all.high.hausdorff for k in clip.classes], weights=counts)
        assert np.isclose(clip.all.high.hausdorff, mean)
        assert all(k.free == k.all for k in clip.classes)  # no vertex of the toy is pinned


def test_clips_come_back_from_json(toy_bones):
    (row,) = evaluate(toy_bones, {"off": truth_method(toy_bones, low=1e-3)}, [CLIP])
    (clip,) = row.clips
    table = json.loads(json.dumps(clip.as_dict(per_vertex=True)))
    again = ClipScore.of(table, toy_bones.store.n_vertices, file="x.json")
    assert again.as_dict(per_vertex=True) == clip.as_dict(per_vertex=True)
    with pytest.raises(FormatError, match=r"x\.json: free"):
        ClipScore.of(table | {"free": {}}, toy_bones.store.n_vertices, file="x.json")
    with pytest.raises(FormatError, match=r"x\.json: per_vertex"):
        ClipScore.of(table, 5, file="x.json")


def counted(method):
    calls = []

    def answer(clip):
        calls.append(clip.name)
        return method(clip)

    return answer, calls


def test_nothing_is_scored_twice(toy_bones, tmp_path):
    names = [CLIP, "base-test-1"]

    def run(methods, digests, **options):
        cache = ScoreCache(tmp_path / "scores", digests, identity="toy", n_vertices=112, **options)
        return evaluate(toy_bones, methods, names, cache=cache), cache

    one, calls = counted(truth_method(toy_bones, low=1e-3))
    two, others = counted(truth_method(toy_bones, low=2e-3))
    (first,), cache = run({"one": one}, {"one": "a"})
    assert (calls, cache.written, cache.read) == (names, 2, 0)
    both, cache = run({"one": one, "two": two}, {"one": "a", "two": "b"})
    assert (calls, others, cache.written, cache.read) == (names, names, 2, 2)
    assert both[0].as_dict() == first.as_dict()
    # Another checkpoint under the same name; a method without a digest; --rescore.
    for digests, options in (({"one": "c"}, {}), ({}, {}), ({"one": "a"}, {"renew": True})):
        calls.clear()
        run({"one": one}, digests, **options)
        assert calls == names


def test_an_interrupted_evaluation_goes_on(toy_bones, tmp_path):
    def cache():
        return ScoreCache(tmp_path, {"m": "a"}, identity="toy", n_vertices=112)

    method, calls = counted(truth_method(toy_bones))

    def stops(clip):
        if clip.name == "base-test-1":
            raise KeyboardInterrupt
        return method(clip)

    with pytest.raises(KeyboardInterrupt):
        evaluate(toy_bones, {"m": stops}, [CLIP, "base-test-1"], cache=cache())
    evaluate(toy_bones, {"m": method}, [CLIP, "base-test-1"], cache=cache())
    assert calls == [CLIP, "base-test-1"]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda b: b[: len(b) // 2], "damaged"),
        (lambda b: b"", "damaged"),
        (lambda b: b"[]", "damaged"),
        (lambda b: b.replace(b'"rmse": ', b'"rmse": 1', 1), "digest differs"),
        (lambda b: b.replace(b'"version": 1', b'"version": 9'), "version 9"),
    ],
)
def test_a_damaged_score_is_computed_again(toy_bones, tmp_path, caplog, damage, words):
    def run():
        cache = ScoreCache(tmp_path, {"m": "a"}, identity="toy", n_vertices=112)
        return evaluate(toy_bones, {"m": method}, [CLIP], cache=cache), cache

    method, calls = counted(truth_method(toy_bones, low=1e-3))
    (row,), _ = run()
    (file,) = tmp_path.glob("*.json")
    file.write_bytes(damage(file.read_bytes()))
    (again,), cache = run()
    assert calls == [CLIP, CLIP]
    assert again.overall == row.overall
    (notice,) = cache.notices
    assert file.name in notice
    assert words in notice
    assert notice in caplog.text
    run()
    assert calls == [CLIP, CLIP]  # the file is whole again


def test_chaos_floor_of_free_vertices(toy_bones):
    n = toy_bones.store.n_vertices
    assert chaos_floor(toy_bones)["all"]["overall_free"] == chaos_floor(toy_bones)["all"]["overall"]
    half = with_pinned(toy_bones, np.arange(n) < n // 2)
    a, b = (toy_bones.store.clip(x).sequence.frames(slice(None)) for x in (CLIP, f"{CLIP}-again"))
    gap = (a - b)[:, n // 2 :].astype(float)
    expected = 1e3 * np.sqrt((gap**2).sum(-1).mean() / 2)
    assert np.isclose(chaos_floor(half)["all"]["overall_free"], expected, rtol=1e-5)
