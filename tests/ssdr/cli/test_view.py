"""`ssdr view` and the page of `ssdr decompose`."""

from __future__ import annotations

import ssdr
from helpers.command import model_of
from helpers.page import Held


def document(path):
    return Held(path.read_text(encoding="utf-8")).document


def test_view_writes_a_page(done, run, refused, clip, wave, tmp_path):
    model, page = tmp_path / "m.npz", tmp_path / "page.html"
    ssdr.save(model_of(wave), model)
    found = done("view", model, clip, "-o", page)
    assert (found["path"], found["frames"], found["notes"]) == (str(page), wave.n_frames, [])
    assert found["bytes"] == page.stat().st_size
    held = document(page)
    assert held["title"] == wave.name or held["title"] == "m"
    rows = {name: note for name, _, note in held["figures"]}
    assert rows["File"] == "m.npz"
    assert "clip.npz" in rows["RMSE"]
    assert run("view", model, clip, "-o", page, "--no-input", "--up", "z", "-q")[0] == 0
    assert document(page)["input"] is None
    assert "ending in .html" in refused("view", model, "-o", tmp_path / "page.png")
    assert "max_bytes" in refused("view", model, "-o", page, "--max-mb", "0.01")


def test_view_without_an_output_opens_the_browser(run, clip, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert run("view", clip, "-q")[0] == 0
    assert opened[0].startswith("file:")


def test_decompose_writes_a_page_beside_its_result(done, faked, refused, clip, tmp_path):
    page = tmp_path / "page.html"
    found = done("decompose", clip, "-o", page, "-o", tmp_path / "m.npz", "-b", 2)
    assert found["outputs"][1]["path"] == str(page)
    assert found["outputs"][1]["bytes"] == page.stat().st_size
    held = document(page)
    assert held["title"] == "clip"
    assert ["File", "m.npz"] in [list(row)[::2] for row in held["figures"]]
    line = ("decompose", clip, "-b", 2, "-o", page)
    assert "--output: expected a file for the model, too" in refused(*line)
