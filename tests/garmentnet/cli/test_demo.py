"""The demo: the garment that ships."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from garmentnet.cli import main


@pytest.mark.slow
def test_the_dress_that_ships_dances(tmp_path, capsys):
    assert main(["demo", "-o", str(tmp_path)]) == 0
    sheet, vertices, film, _ = map(Path, capsys.readouterr().out.splitlines())
    with Image.open(sheet) as picture:
        assert len(picture.getcolors(1 << 24)) > 4096
    with np.load(vertices) as archive:
        moved = archive["vertices"]
    assert moved.shape == (120, 2100, 3)
    size = np.ptp(moved, axis=1)
    assert ((size > 0.3) & (size < 1.5)).all()  # a dress in every frame
    assert np.ptp(size, axis=0).max() > 0.1  # that swings
    assert film.stat().st_size > 20_000
