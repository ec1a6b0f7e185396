"""What a notebook shows: the page in a frame, or words, and never an error."""

from __future__ import annotations

from html.parser import HTMLParser

import numpy as np
import pytest

import ssdr
from helpers.page import Held
from ssdr.show.page import notebook
from ssdr.show.page.page import page_text

HINT = "Its page would be large here: ssdr.view(...) opens it by itself."


class Elements(HTMLParser):
    """Attributes of the elements of a text by name, and its words."""

    def __init__(self, text):
        super().__init__()
        self.found, self.words = {}, ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.found[tag] = dict(attributes)

    def handle_data(self, data):
        self.words += data


def elements(thing):
    return Elements(thing._repr_html_())


@pytest.fixture(scope="module")
def result(dancer):
    return ssdr.decompose(dancer, bones=4, effort="fast")


@pytest.mark.parametrize("kind", ["sequence", "skinning", "decomposition"])
def test_a_small_one_is_its_page_in_a_frame(dancer, result, kind):
    thing = {"sequence": dancer, "skinning": result.skinning, "decomposition": result}[kind]
    shown = elements(thing)
    page = shown.found["iframe"]["srcdoc"]
    assert page == page_text(thing)[0]
    assert shown.words == repr(thing)
    assert len(page) <= 3_000_000
    frames = Held(page).input() if kind == "sequence" else Held(page).vertices()
    truth = dancer.vertices if kind == "sequence" else result.reconstruct()
    np.testing.assert_allclose(frames, truth, atol=1e-4 * dancer.diagonal())


def test_a_page_above_the_limit_is_words(dancer, result, monkeypatch):
    monkeypatch.setattr(notebook, "_PAGE_BYTES", 1000)
    for thing in (dancer, result.skinning, result):
        shown = elements(thing)
        assert shown.found.keys() == {"div", "br", "code"}
        assert shown.words == repr(thing) + HINT


def test_frames_too_many_to_walk_over_are_not_read(dancer):
    class Watched:
        shape, dtype = (10**6, 799, 3), np.dtype(np.float32)
        read = 0

        def __getitem__(self, index):
            block = np.broadcast_to(dancer.vertices[0], self.shape)[index]
            self.read += block.size // (799 * 3)
            return block

    watched = Watched()
    shown = elements(ssdr.MeshSequence(watched, dancer.faces, validate=False))
    assert "iframe" not in shown.found
    assert watched.read == 0


def test_what_fails_is_left_out(dancer, monkeypatch):
    def broken(*_, **__):
        raise RuntimeError("no")

    monkeypatch.setattr("ssdr.show.page.page.page_text", broken)
    assert elements(dancer).words == repr(dancer) + HINT


def test_points_one_frame_and_names_that_mean_harm():
    name = '"></iframe><script>alert(1)</script>'
    for faces in (None, [[0, 1, 2]]):
        shown = elements(ssdr.MeshSequence(np.eye(3)[None], faces, name=name))
        assert set(shown.found) == {"div", "iframe"}
        assert Held(shown.found["iframe"]["srcdoc"]).document["title"] == name
