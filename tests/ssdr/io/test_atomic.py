"""Files appear at once or not at all."""

from __future__ import annotations

import pytest

import ssdr
from ssdr import InputError, MeshSequence


def test_a_failed_write_leaves_the_old_file_and_no_rubbish(tmp_path, wave):
    path = tmp_path / "a.npz"
    ssdr.save(wave, path)
    before = path.read_bytes()

    class Broken:
        shape, dtype = wave.vertices.shape, wave.vertices.dtype

        def __getitem__(self, key):
            raise OSError("the disk went away")

    broken = MeshSequence(Broken(), wave.faces, validate=False)
    for name in ("a.npz", "new.pc2", "new.mdd"):
        with pytest.raises(OSError, match="went away"):
            ssdr.save(broken, tmp_path / name)
    assert path.read_bytes() == before
    assert [f.name for f in tmp_path.iterdir()] == ["a.npz"]
    with pytest.raises(InputError, match="a file in a folder that exists"):
        ssdr.save(wave, tmp_path / "no" / "a.npz")
    (tmp_path / "d.npz").mkdir()
    with pytest.raises(InputError, match="the folder"):
        ssdr.save(wave, tmp_path / "d.npz")


def test_files_get_the_permissions_of_any_new_file(tmp_path, wave):
    (tmp_path / "plain").write_text("")
    ssdr.save(wave, tmp_path / "a.npz")
    assert (tmp_path / "a.npz").stat().st_mode == (tmp_path / "plain").stat().st_mode
