"""`ssdr render`."""

from __future__ import annotations

from PIL import Image

import ssdr
from helpers.command import model_of


def test_render_sheet_frame_and_film(run, clip, wave, tmp_path):
    ssdr.save(model_of(wave), tmp_path / "m.npz")
    sheet, one, film = (tmp_path / n for n in ("sheet.png", "one.jpg", "film.gif"))
    code, _, err = run(
        "render", tmp_path / "m.npz", "-r", clip, "-o", sheet, "--width", 500, "--frames", "0,-1"
    )
    assert code == 0, err
    assert run("render", clip, "-o", one, "--frame", 1, "--width", 80)[0] == 0
    flags = ("-s", "weights", "-s", "bones", "--width", 40, "-q")
    assert run("render", tmp_path / "m.npz", "-r", clip, "-o", film, *flags) == (0, "", "")
    with Image.open(sheet) as a, Image.open(one) as b, Image.open(film) as c:
        assert a.width == 500
        assert b.size == (80, 80)
        assert (c.size, c.n_frames) == ((120, 40), 4)
    assert run("render", clip, "-o", tmp_path / "x.png", "--style", "bones")[0] == 2
    assert run("render", clip, "-o", tmp_path / "x.png", "--frames", "many")[0] == 2
    assert not (tmp_path / "x.png").exists()
