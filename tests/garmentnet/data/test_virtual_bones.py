"""What is kept beside a store: made once, checked as it is read, never of other clips."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from garmentnet.configs.config import BoneOptions
from garmentnet.data.clip_files import read_document, write_clip
from garmentnet.data.outfit import Outfit
from garmentnet.data.skin_weights import find_body_bound
from garmentnet.data.store import ClipStore
from garmentnet.paper.bones import virtual_bones
from ssdr.common.errors import FormatError
from ssdr.laplacian import LaplacianSmoother

NAME = "base-train-0"


@pytest.fixture
def copy(toy_store, toy_bones, tmp_path):
    """A store of its own, with the bones that were made for the other, and their folder."""
    store = ClipStore.open(shutil.copytree(toy_store.path, tmp_path / "store"))
    home = tmp_path / "store.bones" / toy_bones.folder.name
    home.mkdir(parents=True)
    shutil.copy(toy_bones.folder / "bones.npz", home)
    bones = virtual_bones(store, toy_bones.options)
    assert bones.folder == home
    bones.transforms(NAME)
    return bones


def again(bones):
    return virtual_bones(ClipStore.open(bones.store.path), bones.options)


def transforms_file(bones):
    (file,) = (bones.folder / "clips").glob(f"{NAME}-*.npz")
    return file


def test_parts_add_up_and_transforms_are_kept(copy):
    whole = copy.store.clip(NAME).sequence.frames(slice(None))
    np.testing.assert_allclose(sum(copy.split(NAME)), whole, atol=1e-6)
    before = transforms_file(copy).stat().st_mtime_ns
    again(copy).transforms(NAME)
    assert transforms_file(copy).stat().st_mtime_ns == before


def test_a_flipped_bit_is_found(copy):
    file = transforms_file(copy)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    with pytest.raises(FormatError, match=file.name):
        again(copy).transforms(NAME)
    file.unlink()
    again(copy).transforms(NAME)


def test_bones_are_fitted_when_they_are_asked_for(copy):
    name = next(n for n in copy.store.names() if n != NAME)
    high = copy.split(name)[1]
    assert not list((copy.folder / "clips").glob(f"{name}-*"))
    assert copy.transforms(name).shape == (len(high), copy.skinning.n_bones, 3, 4)
    assert list((copy.folder / "clips").glob(f"{name}-*"))


def test_other_clips_of_the_same_name_have_other_bones(copy):
    # As after a store was made anew with other settings.
    clip = copy.store.clip(NAME)
    arrays = {"joints": clip.joints, "classes": clip.classes}
    stated = json.loads(read_document(clip.path)) | {"provenance": {"solver": "another"}}
    write_clip(clip.path, stated, clip.sequence.frames(slice(None)), 0.0, **arrays)
    assert again(copy).folder != copy.folder


@pytest.mark.parametrize(("step", "off"), [(0.0, 0.0), (2.3e-4, 0.0), (0.0, 0.01)])
def test_what_the_body_carries_is_found_in_rounded_clips(toy_store, tmp_path, rng, step, off):
    """Two rings are skinned, one by all joints and from other places than at rest."""
    outfit = {k: getattr(toy_store, k) for k in ("rest", "faces", "body", "skeleton", "fps")}
    store = ClipStore.create(tmp_path / "a.clips", Outfit(**outfit))
    clip = toy_store.clip(NAME)
    vertices = clip.sequence.frames(slice(None)).copy()
    bound = np.arange(32)
    places = store.rest[bound] + off * rng.normal(size=(32, 3)) * (bound < 16)[:, None]
    for weights, ring in (((0.6, 0.3, 0.1), bound < 16), ((1, 0, 0), bound >= 16)):
        blend = np.einsum("j,fjab->fab", weights, clip.joints)
        moved = places @ blend[:, :, :3].swapaxes(1, 2) + blend[:, None, :, 3]
        vertices[:, bound[ring]] = moved[:, ring]
    store.add(
        NAME,
        vertices=vertices,
        joints=clip.joints,
        classes=clip.classes,
        split="train",
        motion="dance",
        parameters=clip.parameters,
        seed=0,
        quality={"accepted": True},
        provenance={},
        step=step,
    )
    found = find_body_bound(store, [NAME], LaplacianSmoother(store.rest, store.faces, 0.03))
    assert found.index.tolist() == bound.tolist()
    placed = found.place(vertices, clip.joints)[:, bound]
    assert np.abs(placed - vertices[:, bound]).max() < 2e-4 + step


def test_bones_of_named_clips_alone(toy_store):
    some = {"count": 4, "influences": 2, "effort": "fast", "frames": 40}
    for motions, expected in (("base-*", {"base"}), ("train-0", {"base", "set0", "set3"})):
        bones = virtual_bones(toy_store, BoneOptions(motions=motions, **some))
        assert expected <= {name.split("-")[0] for name in bones.report["clips"]}
        assert motions != "base-*" or all(n.startswith("base-") for n in bones.report["clips"])


def test_bones_of_a_network_that_the_store_has_share_what_was_fitted(copy):
    store, options, subject = copy.store, copy.options, copy.subject
    same = virtual_bones(store, options, subject=subject)
    assert same.folder == copy.folder
    assert np.array_equal(same.skinning.rest, subject.garment.rest)
    # Without the clips that they were made from they are elsewhere, and the same.
    other = dataclasses.replace(options, motions="elsewhere-*")
    there = virtual_bones(store, other, subject=subject)
    assert there.folder != copy.folder
    assert there.skinning is subject.garment
    assert set(there.report["clips"]) == set(copy.report["clips"])
