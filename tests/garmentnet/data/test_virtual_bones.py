"""What is kept beside a store: made once, checked as it is read, never of other clips."""

import json
import shutil

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("zarr")

from garmentnet.data.store import ClipStore
from garmentnet.data.virtual_bones import virtual_bones
from ssdr.errors import FormatError, InputError

NAME = "base-train-0"


@pytest.fixture
def copy(toy_store, toy_bones, tmp_path):
    """A store of its own, with the bones that were made for the other, and their folder."""
    store = ClipStore.open(shutil.copytree(toy_store.path, tmp_path / "store"))
    home = tmp_path / "store.bones" / toy_bones.folder.name
    (home / "clips").mkdir(parents=True)
    for name in ("bones.npz", "bones.json"):
        shutil.copy(toy_bones.folder / name, home)
    bones = virtual_bones(store, toy_bones.options)
    assert bones.folder == home
    bones.clip(NAME).fit()
    return bones


def again(bones):
    return virtual_bones(ClipStore.open(bones.store.path), bones.options)


def test_parts_add_up_and_are_kept(copy):
    kept = again(copy).clip(NAME)
    clip = copy.store.clip(NAME)
    np.testing.assert_allclose(
        kept.read("low") + kept.read("high"), clip.sequence.frames(slice(None)), atol=1e-6
    )
    files = sorted((copy.folder / "clips").iterdir())
    before = [f.stat().st_mtime_ns for f in files]
    again(copy).clip(NAME).fit()
    assert [f.stat().st_mtime_ns for f in files] == before


@pytest.mark.parametrize("part", ["low", "high", "transforms"])
def test_a_flipped_bit_is_found(copy, part):
    file = copy.folder / "clips" / f"{NAME}.{part}.npy"
    data = bytearray(file.read_bytes())
    data[-5] ^= 1
    file.write_bytes(data)
    with pytest.raises(FormatError, match=rf"{NAME}\.{part}\.npy.*checksum"):
        again(copy).clip(NAME).fit()
    file.unlink()
    again(copy).clip(NAME).fit()


def test_bones_are_fitted_when_they_are_asked_for(copy):
    name = next(n for n in copy.store.names() if n != NAME)
    fit = copy.folder / "clips" / f"{name}.fit.json"
    parts = copy.clip(name)
    assert copy.prepare([name]).keys() == {"frames", "high_rms"}
    assert not fit.is_file()
    assert parts.transforms.shape == (len(parts.low), copy.skinning.n_bones, 3, 4)
    assert fit.is_file()
    assert copy.prepare([name], fit=True)["rmse"] == pytest.approx(parts.rmse)


@pytest.mark.parametrize("file", [f"clips/{NAME}.json", f"clips/{NAME}.fit.json", "bones.json"])
@pytest.mark.parametrize("text", ["{", "[]", '{"rmse": "x", "high_rms": "x"}'])
def test_a_damaged_statement_is_named(copy, file, text):
    (copy.folder / file).write_text(text)
    with pytest.raises(FormatError, match=r"\.json"):
        again(copy).clip(NAME).fit()


def test_bones_of_other_clips_of_the_same_name(copy):
    # As after a store was made anew with other settings.
    path = copy.store.path / "clips" / NAME / "zarr.json"
    stated = json.loads(path.read_text())
    stated["attributes"]["provenance"]["solver"] = "another"
    path.write_text(json.dumps(stated))
    with pytest.raises(InputError, match=r"remove .*store\.bones"):
        again(copy)
    # Of a clip that only was refitted, when it is read.
    path.write_text(json.dumps(stated))
    made = copy.folder / "bones.json"
    known = json.loads(made.read_text())
    known.pop("source")
    made.write_text(json.dumps(known))
    with pytest.raises(InputError, match=f"the clip {NAME}"):
        again(copy).clip(NAME)
