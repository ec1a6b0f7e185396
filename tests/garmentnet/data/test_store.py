"""The store of clips: what is read is what was written, and damage is named."""

from __future__ import annotations

import dataclasses
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from garmentnet.data.clip import MIRRORED, Clip
from garmentnet.data.outfit import Outfit
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.store import ClipStore
from helpers import cloth_scenes
from helpers import toy_store as toy
from ssdr.common.errors import FormatError, InputError

_, SKELETON = toy.body()
HEADS = SKELETON.rest


def body() -> ssdr.Skinning:
    rest = np.concatenate([HEADS, HEADS + np.array([0.0, 0.0, 0.1])]).astype(np.float32)
    joints = np.tile(np.arange(3), 2)
    rig = cloth_scenes.rigid(rest, [[0, 1, 2]], joints, 3)
    return dataclasses.replace(rig, bone_names=SKELETON.names)


# A strip, symmetric in x: 0 <-> 1, 2 <-> 3, 4 in the middle.
GARMENT = np.array([[1, 0, 0], [-1, 0, 0], [1, 1, 0], [-1, 1, 0], [0, 2, 0]], dtype=np.float32)
FACES = np.array([[0, 3, 1], [0, 2, 3], [2, 4, 3]])
SYMMETRIC_FACES = np.array([[2, 4, 3], [0, 2, 4], [1, 4, 3]])
MIRROR = np.array([1, 0, 3, 2, 4])
WORN = {"faces": SYMMETRIC_FACES, "pinned": [False, False, False, False, True]}


def outfit(rest: Any = GARMENT, **changes: Any) -> Outfit:
    given = {"faces": FACES, "body": body(), "skeleton": SKELETON, "fps": 30.0}
    return Outfit(rest, **(given | changes))


@pytest.fixture
def store(tmp_path: Path) -> ClipStore:
    return ClipStore.create(tmp_path / "clips", outfit(mirror_vertices=MIRROR, **WORN))


def arguments(rng: np.random.Generator, frames: int = 70, **changes: Any) -> dict[str, Any]:
    return {
        "vertices": rng.normal(size=(frames, 5, 3)).astype(np.float32),
        "joints": toy.random_pose(rng, SKELETON, frames).astype(np.float32),
        "classes": rng.integers(0, 5, frames),
        "split": "train",
        "motion": "dance-1",
        "parameters": SimulationParameters(),
        "seed": 7,
        "quality": {"accepted": True, "reason": ""},
        "provenance": {"scene": "strip"},
        **changes,
    }


def test_reads_what_was_written(store: ClipStore, rng: np.random.Generator) -> None:
    given = arguments(rng)
    store.add("a-1", **given)
    again = ClipStore.open(store.path)
    assert again.names() == ("a-1",)
    clip = again.clip("a-1")
    assert clip.sequence.is_lazy
    assert clip.sequence.fps == 30.0
    np.testing.assert_array_equal(clip.sequence.frames(slice(None)), given["vertices"])
    np.testing.assert_array_equal(clip.sequence.frames([33, 2]), given["vertices"][[33, 2]])
    np.testing.assert_array_equal(clip.joints, given["joints"])
    np.testing.assert_array_equal(clip.classes, given["classes"])
    assert (clip.split, clip.motion, clip.seed) == ("train", "dance-1", 7)
    assert clip.parameters == SimulationParameters()
    np.testing.assert_array_equal(again.rest, GARMENT)
    np.testing.assert_array_equal(again.pinned, [0, 0, 0, 0, 1])
    assert again.skeleton.names == SKELETON.names
    naive = np.einsum(
        "fvab,vb->fva",
        clip.joints[:, body().indices[:, 0]].astype(float),
        np.c_[body().rest, np.ones(6)],
    )
    np.testing.assert_allclose(clip.body(), naive, atol=1e-5)


def test_names_choose(store: ClipStore, rng: np.random.Generator) -> None:
    soft = SimulationParameters(bending=0.2)
    store.add("a", **arguments(rng, 3))
    store.add("b", **arguments(rng, 3, split="test", parameters=soft))
    store.add("c", **arguments(rng, 3, quality={"accepted": False, "reason": "stretch"}))
    store.add("a-moved", **arguments(rng, 3, perturbation=1e-3, provenance={"repeat_of": "a"}))
    assert store.names() == ("a", "b")
    assert store.names("test") == ("b",)
    assert store.names(parameters=soft) == ("b",)
    assert store.names(accepted=False) == ("c",)
    assert store.names(accepted=None, perturbed=None) == ("a", "a-moved", "b", "c")
    assert store.pairs() == (("a", "a-moved"),)
    assert set(store.parameters()) == {soft, SimulationParameters()}
    assert store.clip("c").quality["reason"] == "stretch"
    with pytest.raises(InputError, match="split"):
        store.names("all")  # type: ignore[arg-type]


def test_mirrored_twice_is_the_clip(store: ClipStore, rng: np.random.Generator) -> None:
    clip = store.add("a", **arguments(rng))
    other = clip.mirrored()
    assert other.name == "a" + MIRRORED
    assert other.is_mirrored
    assert not clip.is_mirrored
    given = clip.sequence.frames(slice(None))
    seen = store.clip("a" + MIRRORED).sequence.frames(slice(None))
    np.testing.assert_array_equal(seen, given[:, MIRROR] * [-1, 1, 1])
    np.testing.assert_array_equal(other.sequence.frames(40), seen[40])
    np.testing.assert_array_equal(other.sequence.vertices[3:5, 2], seen[3:5, 2])
    np.testing.assert_array_equal(other.mirrored().sequence.frames(slice(None)), given)
    np.testing.assert_array_equal(other.mirrored().joints, clip.joints)
    rotation = other.joints[..., :3].astype(float)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-5)
    # The body's mesh is symmetric under the joints' permutation, so its pose reflects as well.
    np.testing.assert_allclose(
        other.body(), clip.body()[:, [0, 2, 1, 3, 5, 4]] * [-1, 1, 1], atol=1e-6
    )


def test_mirror_needs_symmetry(tmp_path: Path, rng: np.random.Generator) -> None:
    plain = ClipStore.create(tmp_path / "plain", outfit())
    with pytest.raises(InputError, match="symmetric"):
        plain.add("a", **arguments(rng, 2)).mirrored()
    for bad in ([1, 0, 3, 2, 2], [1, 2, 3, 4, 0], MIRROR):
        with pytest.raises(InputError, match="mirror_vertices"):
            ClipStore.create(tmp_path / "other", outfit(mirror_vertices=bad))
    names = dataclasses.replace(body(), bone_names=("root", "LeftLeg", "RightLeg"))
    skeleton = type(SKELETON)(names.names(), SKELETON.parents, SKELETON.rest)
    other = outfit(mirror_vertices=MIRROR, body=names, skeleton=skeleton, **WORN)
    with pytest.raises(InputError, match=r"mirror_vertices: .* named _l and _r"):
        ClipStore.create(tmp_path / "other", other)
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"vertices": np.zeros((3, 4, 3))}, "vertices"),
        ({"vertices": np.full((3, 5, 3), np.nan)}, "vertices"),
        ({"joints": np.zeros((3, 3, 3, 3))}, "joints"),
        ({"joints": np.full((3, 3, 3, 4), np.inf)}, "joints"),
        ({"joints": np.full((3, 3, 3, 4), 2 * np.eye(3, 4))}, "rigid"),
        ({"classes": [0, 1]}, "classes"),
        ({"classes": [0, 1, 99]}, "classes"),
        ({"split": "all"}, "split"),
        ({"quality": {}}, "quality"),
    ],
)
def test_add_refuses(
    store: ClipStore, rng: np.random.Generator, change: dict[str, Any], word: str
) -> None:
    with pytest.raises(InputError, match=word):
        store.add("a", **{**arguments(rng, 3), **change})
    assert store.names(accepted=None, perturbed=None) == ()
    assert list((store.path / "clips").iterdir()) == []


def test_names_stay_in_the_folder(store: ClipStore, rng: np.random.Generator) -> None:
    for name in ("../a", ".a", "a/b", ""):
        with pytest.raises(InputError, match="name"):
            store.add(name, **arguments(rng, 2))
        with pytest.raises(InputError, match="name"):
            store.clip(name)
    store.add("a", **arguments(rng, 2))
    with pytest.raises(InputError, match="not in the store"):
        store.add("a", **arguments(rng, 2))


def test_half_written_clips_are_not_seen(
    store: ClipStore, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = arguments(rng)

    def full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("garmentnet.data.store.os.replace", full)
    with pytest.raises(OSError, match="No space"):
        store.add("a", **given)
    monkeypatch.undo()
    assert list((store.path / "clips").iterdir()) == []
    # What a killed process leaves: a temporary name, whole or not.
    store.add("b", **given)
    shutil.copy(store.clip("b").path, store.path / "clips" / ".ssdr-123.npz")
    (store.path / "clips.txt").write_text("")
    assert store.names() == ("b",)
    assert store.sweep() == 1
    assert store.names() == ("b",)
    assert (store.path / "clips.txt").read_text() == "b\n"


def test_the_same_bytes_twice(tmp_path: Path) -> None:
    def make(name: str) -> dict[str, bytes]:
        rng = np.random.default_rng(3)
        made = ClipStore.create(tmp_path / name, outfit())
        made.add("a", **arguments(rng))
        folder = made.path / "clips"
        return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.*")}

    assert make("one") == make("two")


def read_whole(clip: Clip) -> None:
    assert clip.classes.shape == clip.joints.shape[:1] == (70,)
    clip.sequence.frames(slice(None))


STEP = 2.3e-4


def test_vertices_in_steps_are_near(store: ClipStore, rng: np.random.Generator) -> None:
    smooth = rng.normal(size=(1, 5, 3)) + np.cumsum(rng.normal(0, 0.01, (70, 5, 3)), axis=0)
    given = arguments(rng, 70, vertices=smooth.astype(np.float32))
    exact = store.add("exact", **given)
    near = store.add("near", **given, step=STEP)
    assert (exact.step, near.step) == (0.0, STEP)
    whole = near.sequence.frames(slice(None))
    gap = np.linalg.norm(whole - given["vertices"], axis=-1)
    assert 0 < gap.max() <= 0.2e-3
    for index in (5, slice(10, 60, 7), [66, 3, 33]):
        np.testing.assert_array_equal(near.sequence.frames(index), whole[index])
    rejected = arguments(rng, 3, quality={"accepted": False, "reason": "NaN"})
    rejected["vertices"][1] = np.nan
    assert store.add("broken", **rejected, step=STEP).step == 0.0


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def rewrite(path: Path, left_out: str = "", **changed: bytes) -> None:
    """Write the archive anew, with valid checksums, without a member or with others in place."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            if name != f"{left_out}.npy":
                archive.writestr(name, changed.get(name.removesuffix(".npy"), data))


def state(path: Path, old: str, new: str) -> None:
    """Change what the clip's own file states of it."""
    with zipfile.ZipFile(path) as archive:
        data = archive.read("document.npy")
    assert old.encode() in data
    rewrite(path, document=data.replace(old.encode(), new.encode()))


DAMAGE: dict[str, Callable[[Path], object]] = {
    "a flipped bit": flip,
    "half a file": lambda path: path.write_bytes(path.read_bytes()[:2000]),
    "no vertices of some frames": lambda path: rewrite(path, "vertices-32"),
    "no joints": lambda path: rewrite(path, "joints"),
    "no classes": lambda path: rewrite(path, "classes"),
    "no statement": lambda path: rewrite(path, "document"),
    "half a statement": lambda path: state(path, '"seed": 7', '"seed",7 '),
    "other frames": lambda path: state(path, '"n_frames": 70', '"n_frames": 71'),
    "fewer frames": lambda path: state(path, '"n_frames": 70', '"n_frames": 69'),
    "another key": lambda path: state(path, '"motion"', '"notion"'),
    "another split": lambda path: state(path, '"train"', '"trial"'),
    "a negative parameter": lambda path: state(path, '"bending": 0.5', '"bending": -50'),
    "no file": lambda path: path.unlink(),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_named(store: ClipStore, rng: np.random.Generator, damage: str) -> None:
    store.add("a", **arguments(rng))
    DAMAGE[damage](store.clip("a").path)
    with pytest.raises(FormatError, match=re.escape(str(store.path / "clips" / "a"))):
        list(map(read_whole, ClipStore.open(store.path).clips()))  # not one clip fewer


def test_foreign_folders(tmp_path: Path, store: ClipStore) -> None:
    with pytest.raises(FormatError, match="no such folder"):
        ClipStore.open(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FormatError, match="empty"):
        ClipStore.open(tmp_path / "empty")
    (store.path / "clips.txt").unlink()
    with pytest.raises(FormatError, match=r"clips\.txt, the list"):
        store.names()
    (store.path / "body.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(FormatError, match="body"):
        ClipStore.open(store.path)


def test_create_again_opens_the_same_garment(store: ClipStore) -> None:
    assert ClipStore.create(store.path, outfit(**WORN)).names() == ()
    with pytest.raises(InputError, match="this garment"):
        ClipStore.create(store.path, outfit(GARMENT * 2, **WORN))
