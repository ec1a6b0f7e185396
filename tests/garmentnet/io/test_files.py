"""Errors of writing."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")


from garmentnet.io.files import writing
from ssdr.common.errors import SsdrError


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full")
def test_full_disk_names_the_file():
    with (
        pytest.raises(SsdrError, match=r"/dev/full: could not be written: No space left on device"),
        writing(Path("/dev/full")),
        open("/dev/full", "wb") as file,
    ):
        file.write(b"x" * 100_000)
