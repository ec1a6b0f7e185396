"""All metrics in one call; what every one of them refuses."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.surfaces import animation
from ssdr import MeshSequence
from ssdr.metrics import compare, distances, hausdorff, normals, rmse, sted


def test_chunks_and_files_give_the_same(monkeypatch, tmp_path):
    a, faces = animation(F=12)
    b, _ = animation(1, F=12)
    whole = compare(a, b, faces).as_dict(arrays=True)
    np.save(tmp_path / "a.npy", a)
    mapped = MeshSequence(np.load(tmp_path / "a.npy", mmap_mode="r"), faces)
    assert mapped.is_lazy
    monkeypatch.setattr("ssdr.metrics.matching._CHUNK_BYTES", 1)
    parts = compare(mapped, b).as_dict(arrays=True)

    def same(x, y):
        if isinstance(x, dict):
            assert x.keys() == y.keys()
            for key in x:
                same(x[key], y[key])
        else:
            np.testing.assert_allclose(x, y, rtol=1e-12)

    same(parts, whole)


def test_compare_has_them_all():
    a, faces = animation(F=5)
    b, _ = animation(1, F=5)
    result = compare(MeshSequence(a, faces), b)
    assert (result.n_frames, result.n_vertices) == a.shape[:2]
    d, h, s = distances(a, b), hausdorff(a, b, faces), sted(a, b, faces)
    plain = json.loads(json.dumps(result.as_dict()))
    full = json.loads(json.dumps(result.as_dict(arrays=True)))
    for part, name in ((d, ""), (h, "hausdorff"), (s, "sted")):
        found = getattr(result, name) if name else result
        for key, value in vars(part).items():
            table = full[name] if name else full
            np.testing.assert_array_equal(getattr(found, key), value)
            np.testing.assert_array_equal(table[key], value)
            assert (key in (plain[name] if name else plain)) == (not isinstance(value, np.ndarray))
    for text in (f"{d.rmse:.6g}", f"{h.surface_max:.6g}", f"{s.value:.4g}", str(result.normals)):
        assert text in str(result)


def test_no_share_of_a_diagonal_of_zero_in_json():
    result = compare(np.zeros((3, 4, 3)), np.ones((3, 4, 3)))
    assert result.percent_of_diagonal == math.inf
    assert json.loads(json.dumps(result.as_dict(), allow_nan=False))["percent_of_diagonal"] is None


def test_compare_of_parts_and_options():
    (a, _), (b, _) = animation(F=5), animation(1, F=5)
    bare = compare(a, b, hausdorff=False, sted=False)
    assert bare.hausdorff is bare.sted is None
    cloud = compare(a, b)
    assert cloud.hausdorff.surface_max is None
    assert cloud.sted.spatial == 0


@pytest.mark.parametrize("kind", ["skinning", "result"])
def test_every_metric_takes_a_model_for_its_frames(kind):
    chain = motions.chain(bones=3)
    frames = ssdr.MeshSequence(motions.wobble(chain), chain.faces)
    model = chain.skinning if kind == "skinning" else SimpleNamespace(skinning=chain.skinning)
    skinned = ssdr.MeshSequence(chain.frames, chain.faces)
    for measure in (distances, hausdorff, sted, normals, rmse):
        for a, b, c, d in (
            (frames, model, frames, skinned),
            (model, frames, skinned, frames),
        ):
            found, expected = measure(a, b), measure(c, d)
            if measure is normals and a is frames:  # drawn as engines do, not as a surface
                found, expected = found.surface, expected.mean
            if isinstance(found, float):
                assert found == pytest.approx(expected, rel=1e-9)
            else:
                for name, value in vars(expected).items():
                    if isinstance(value, float):
                        assert getattr(found, name) == pytest.approx(value, rel=1e-9), name
    found = ssdr.metrics.compare(model, frames)
    assert found.rmse == pytest.approx(rmse(chain.frames, frames), rel=1e-12)
    assert ssdr.metrics.compare(frames, model).normals.surface is not None
