"""One model in several files: checked before the work, kept after it, a glTF file around it."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

import ssdr
from helpers.disks import fill
from helpers.gltf_asset import make_asset
from helpers.gltf_difference import NEW_SKIN, difference
from ssdr.io import check_outputs, list_meshes, load_clips, save_all

DATA = Path(os.environ.get("SSDR_TEST_DATA", "missing")) / "gltf"


def test_what_could_not_be_written_is_said_before_the_work(wave, tmp_path, monkeypatch):
    check_outputs([tmp_path / "a.glb", tmp_path / "new" / "a_%02d.obj"])
    check_outputs([tmp_path / "a.glb", tmp_path / "a.npz"], weights="uint8", templates=["a.glb"])

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "touch", full)  # permissions do not tell where no inodes are left
    with pytest.raises(ssdr.InputError, match="No space left on device"):
        check_outputs([tmp_path / "a.npz"])
    assert list(tmp_path.iterdir()) == []


def test_a_model_is_kept_where_no_file_could_be_written(wave, tmp_path, monkeypatch):
    model = ssdr.initialize(wave, bones=2)
    full, other = tmp_path / "full", tmp_path / "other"
    full.mkdir()
    other.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(other))
    fill(full, monkeypatch)
    for _ in range(2):  # what was kept is not overwritten
        with pytest.raises(OSError, match="No space"), pytest.warns(match="the model is kept in"):
            save_all(model, [full / "a.glb"])
    kept = sorted(other.iterdir())
    assert len(kept) == 2
    assert all(ssdr.load_skinning(path).n_bones == 2 for path in kept)
    with pytest.raises(OSError, match="No space"):
        save_all(model, [full / "a.glb", other / "good.npz"])
    assert ssdr.load_skinning(other / "good.npz").n_bones == 2
    with pytest.raises(OSError, match="No space"), pytest.warns(match="the model is kept in"):
        save_all(model, [full / "a.glb", other / "w_%d.obj"])  # vertices are no model
    fill(other, monkeypatch)
    with pytest.raises(OSError, match="No space"), pytest.warns(match="the model is lost"):
        save_all(model, [full / "a.glb"])


def test_a_template_is_given_to_the_files_that_take_one(tmp_path):
    source, out, meshes = make_asset(tmp_path / "all.gltf"), tmp_path / "o.glb", ["Body", "Coat"]
    model = ssdr.initialize(load_clips(source, clip="Dance", meshes=meshes), bones=3)
    for templates, count in (([source], 3), ([], 1)):
        save_all(model, [out, tmp_path / "o.npz"], templates=templates, meshes=meshes)
        assert len(list_meshes(out)) == count


@pytest.mark.skipif(not DATA.is_dir(), reason="no files in SSDR_TEST_DATA")
@pytest.mark.filterwarnings("ignore:.*lie between its frames:ssdr.SsdrWarning")
@pytest.mark.parametrize("name", ["Fox.glb", "Llama.gltf"])
def test_skinned_files_get_a_new_skin_alone(tmp_path, name):
    source, out = DATA / name, tmp_path / "o.glb"
    model = ssdr.initialize(load_clips(source, clip="all"), bones=3)
    save_all(model, [out, tmp_path / "o.npz"], templates=[source])
    found = [p for p in difference(source, out) if not NEW_SKIN.match(p)]
    # Old joints are gone, and their tracks.
    assert all(p.startswith(("animations/", "scenes/0/")) for p in found)
    assert all("-" in p or "_skeleton" in p or p.endswith("+ssdr") or "extras" in p for p in found)
    assert ssdr.list_clips(out) == ssdr.list_clips(source)
    for clip in model.clips:
        seen = ssdr.load(out, clip=clip.name).vertices
        truth = model.select(clip.name).skin()
        assert np.abs(seen - truth).max() < 1e-5 * np.abs(truth).max()
