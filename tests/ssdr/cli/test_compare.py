"""`ssdr compare`: measures, welded models, files in other units."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.command import model_of
from helpers.page import Held

QUICK = ("--no-sted", "--no-hausdorff")


def test_measures(run, done, clip, wave, tmp_path):
    moved = dataclasses.replace(wave, vertices=wave.vertices + np.float32([0, 0, 0.5]))
    ssdr.save(moved, tmp_path / "b.npz")
    assert done("compare", clip, tmp_path / "b.npz", "--no-sted")["rmse"] == pytest.approx(0.5)
    code, out, _ = run("compare", clip, tmp_path / "b.npz", *QUICK)
    assert code == 0
    assert "0.5" in out


def test_a_welded_model_is_spread_back(done, refused, seam, tmp_path):
    welded, _ = seam.weld()
    ssdr.save(seam, tmp_path / "a.npz")
    ssdr.save(welded, tmp_path / "b.npz")
    for pair in (("a.npz", "b.npz"), ("b.npz", "a.npz")):
        assert done("compare", *(tmp_path / p for p in pair))["rmse"] == 0
    ssdr.save(ssdr.MeshSequence(seam.vertices[:, :7]), tmp_path / "c.npz")
    assert "18 vertices, as the reference has" in refused(
        "compare", tmp_path / "a.npz", tmp_path / "c.npz"
    )


def test_a_page_shows_what_is_compared(done, run, refused, clip, wave, tmp_path):
    moved = dataclasses.replace(wave, vertices=wave.vertices + np.float32([0, 0, 0.5]))
    ssdr.save(moved, tmp_path / "b.npz")
    ssdr.save(model_of(wave), tmp_path / "m.npz")
    for b, bones in (("b.npz", None), ("m.npz", 2)):
        page = tmp_path / f"{b}.html"
        found = done("compare", clip, tmp_path / b, *QUICK, "-o", page)
        assert found["output"] == str(page)
        held = Held(page.read_text(encoding="utf-8"))
        rig, error = held.document["rig"], held.document["error"]
        assert bones == (rig and len(rig["names"]))
        assert error["max"] == pytest.approx(found["max"], rel=1e-4)
        assert (error["frame"], held.document["title"]) == (
            found["max_frame"],
            f"{b} beside clip.npz",
        )
        np.testing.assert_allclose(held.input(), wave.vertices, atol=1e-4)
    _, out, _ = run("compare", clip, tmp_path / "b.npz", *QUICK, "-o", page)
    assert f"page  {page}" in out
    same = ("compare", clip, tmp_path / "b.npz", *QUICK, "-o")
    assert "ending in .html" in refused(*same, tmp_path / "page.png")


def test_the_page_of_a_welded_model_beside_what_it_was_welded_from(done, seam, tmp_path):
    welded, _ = seam.weld()
    ssdr.save(seam, tmp_path / "a.npz")
    ssdr.save(model_of(welded), tmp_path / "m.npz")
    page = tmp_path / "page.html"
    found = done("compare", tmp_path / "a.npz", tmp_path / "m.npz", *QUICK, "-o", page)
    held = Held(page.read_text(encoding="utf-8"))
    assert held.document["vertices"] == welded.n_vertices < seam.n_vertices
    assert held.document["error"]["max"] == pytest.approx(found["max"], rel=1e-4)


@pytest.fixture
def pair(wave, tmp_path):
    ssdr.save(wave, tmp_path / "metres.npz")
    large = dataclasses.replace(wave, vertices=wave.vertices * np.float32(100))
    ssdr.save(large, tmp_path / "centimetres.npz")
    return tmp_path / "metres.npz", tmp_path / "centimetres.npz"


def test_metres_and_centimetres_get_a_hint(done, pair, wave, tmp_path):
    metres, centimetres = pair
    (hint,) = done("compare", metres, centimetres, *QUICK)["warnings"]
    assert "the diagonal of B is about 100 times that of A" in hint
    scale = ("--read", "B:scale=0.01")
    assert " ".join(scale) + " brings B to A" in hint
    found = done("compare", metres, centimetres, *scale, *QUICK)
    assert found["warnings"] == []
    assert found["rmse"] == pytest.approx(0, abs=1e-6)
    (hint,) = done("compare", centimetres, metres, *QUICK)["warnings"]
    assert "the diagonal of A is about 100 times that of B" in hint
    assert "B:scale=100 brings" in hint
    # A mesh of another size is no mesh in another unit.
    other = dataclasses.replace(wave, vertices=wave.vertices * np.float32(30))
    ssdr.save(other, tmp_path / "other.npz")
    assert done("compare", metres, tmp_path / "other.npz", *QUICK)["warnings"] == []


def test_a_scale_that_is_none_is_refused(refused, pair):
    for wrong in ("0", "-1", "NaN", "Infinity", '"2"'):
        assert "scale: expected" in refused("compare", *pair, "--read", f"scale={wrong}")


def test_normals_are_those_that_engines_draw_of_a_model(done, run, clip, wave, tmp_path):
    model = model_of(wave)
    surface = ssdr.Surface(normals=np.tile(np.float32([0, 0.6, 0.8]), (len(wave.faces), 3, 1)))
    model = dataclasses.replace(model, surface=surface)
    ssdr.save(model, tmp_path / "m.npz")
    ssdr.save(ssdr.MeshSequence(model.skin(), model.faces), tmp_path / "b.npz")
    found = done("compare", clip, tmp_path / "m.npz", *QUICK)["normals"]
    assert found == pytest.approx(ssdr.metrics.normals(wave, model).as_dict())
    baked = done("compare", clip, tmp_path / "b.npz", *QUICK)["normals"]
    assert baked["mean"] == pytest.approx(found["surface"])
    assert "surface" not in baked
    for name, words in (("m.npz", "as engines draw them"), ("b.npz", "of the surface")):
        assert words in run("compare", clip, tmp_path / name, *QUICK)[1]
