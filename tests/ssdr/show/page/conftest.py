"""A dancer, and a browser that opens pages of it."""

from __future__ import annotations

import pytest

import ssdr
from helpers.browser import Browser


@pytest.fixture(scope="session")
def dancer():
    return ssdr.samples.load("dancer_small")


@pytest.fixture(scope="module")
def model(dancer):
    return ssdr.decompose(dancer, bones=10, effort="fast", rig="rigid").skinning


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("browser")) as tab:
        yield tab


@pytest.fixture
def opened(browser, tmp_path):
    """Write a page and open it; nothing may go wrong, and nothing else may be asked for."""

    def call(*arguments, **options):
        page = ssdr.view(*arguments, path=tmp_path / "page.html", **options)
        browser.open(page.path)
        browser.value("ssdr.ready")
        if not isinstance(arguments[0], ssdr.MeshSequence):
            browser.value("ssdr.set({view: 'result'})")  # beside an input, pages begin with both
        return browser

    yield call
    assert browser.complaints() == []
    assert len(browser.requests()) == 1  # the page itself
