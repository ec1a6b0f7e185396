"""Files appear at once or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import stat

import pytest

import ssdr
from helpers.disks import small_files
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


def test_files_get_the_permissions_of_any_new_file(tmp_path, wave):
    (tmp_path / "plain").write_text("")
    ssdr.save(wave, tmp_path / "a.npz")
    assert (tmp_path / "a.npz").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_file_and_its_folder_reach_the_disk_before_it_is_called_written(
    tmp_path, wave, monkeypatch
):
    """A power cut after the rename must not leave an empty file of that name."""
    order, real = [], {"fsync": os.fsync, "replace": os.replace}

    def fsync(number):
        kind = os.fstat(number).st_mode
        order.append("folder" if stat.S_ISDIR(kind) else "file")
        real["fsync"](number)

    def replace(source, target):
        order.append("name")
        real["replace"](source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replace)
    ssdr.save(wave, tmp_path / "a.npz")
    assert order == ["file", "name", "folder"]


def test_a_link_stays_and_the_file_that_it_leads_to_is_replaced(tmp_path, wave):
    (tmp_path / "far").mkdir()
    real, link = tmp_path / "far" / "real.npz", tmp_path / "link.npz"
    real.write_bytes(b"old")
    link.symlink_to(real)
    ssdr.save(wave, link)
    assert link.is_symlink()
    assert ssdr.load(real).n_frames == wave.n_frames
    assert [p.name for p in (tmp_path / "far").iterdir()] == ["real.npz"]
    dangling = tmp_path / "dangling.npz"
    dangling.symlink_to(tmp_path / "far" / "new.npz")
    ssdr.save(wave, dangling)
    assert (tmp_path / "far" / "new.npz").is_file()
    for name, place in (("loop.npz", "loop.npz"), ("gone.npz", "no/a.npz"), ("z.npz", "/dev/null")):
        (tmp_path / name).symlink_to(place)
        with pytest.raises(InputError, match="path: expected"):
            ssdr.save(wave, tmp_path / name)
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


MODULES = {"usdc": "pxr.UsdSkel", "usda": "pxr.UsdSkel"}


@pytest.mark.parametrize("suffix", ["npz", "npy", "pc2", "mdd", "glb", *MODULES])
def test_an_error_of_the_system_comes_from_every_library(tmp_path, suffix):
    """As of a full disk; not pxr's own, which nobody catches."""
    pytest.importorskip(MODULES.get(suffix, "numpy"))
    sample, path = ssdr.samples.load("dancer_small"), tmp_path / f"a.{suffix}"
    thing = ssdr.initialize(sample, bones=1) if suffix == "glb" else sample
    with small_files(4000), pytest.raises(OSError, match="File too large") as caught:
        ssdr.save(thing, path)
    assert caught.value.errno == errno.EFBIG
    assert str(caught.value.filename).startswith(str(path.with_suffix("")))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("number", "fatal"), [(errno.ENOSPC, True), (errno.EINVAL, False)])
def test_a_disk_that_cannot_take_it_is_an_error_and_one_that_cannot_flush_is_none(
    tmp_path, wave, monkeypatch, number, fatal
):
    def fails(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fails)
    expected = pytest.raises(OSError, match="No space left") if fatal else contextlib.nullcontext()
    with expected:
        ssdr.save(wave, tmp_path / "a.npz")
    assert len([*tmp_path.iterdir()]) == 1 - fatal


def test_a_name_of_255_bytes_is_written_and_a_longer_one_refused(tmp_path, wave):
    for stem in ("n" * 251, "ü" * 125):
        ssdr.save(wave, tmp_path / f"{stem}.npz")
        assert ssdr.load(tmp_path / f"{stem}.npz").n_frames == wave.n_frames
        with pytest.raises(InputError, match="File name too long"):
            ssdr.save(wave, tmp_path / f"{stem}nn.npz")


def test_what_a_killed_process_left_goes_after_an_hour(tmp_path, wave):
    names = [".ssdr-0123abcd.npz", ".ssdr-4567cdef.npz", ".notes.npz"]
    for name in names:
        (tmp_path / name).write_bytes(b"")
        os.utime(tmp_path / name, (0, 0))
    os.utime(tmp_path / names[1])
    ssdr.save(wave, tmp_path / "a.npz")
    assert {f.name for f in tmp_path.iterdir()} == {"a.npz", *names[1:]}
