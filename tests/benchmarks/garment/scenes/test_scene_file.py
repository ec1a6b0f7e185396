"""Scene files: what they expand to, and what is said of those that cannot be read."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

from benchmarks.garment.scenes.cut import Cut
from benchmarks.garment.scenes.dataset import recorded_motions
from benchmarks.garment.scenes.motion_sources import SPLITS
from benchmarks.garment.scenes.scene_file import DataSet, MeshGarment, load_data_set
from garmentnet.data.parameters import SimulationParameters
from ssdr.common.errors import FormatError

SCENE = """
name = "one"
seed = 3
[garment]
vertices = 300
[motion]
seed = 4
frames = 20
classes = ["spin", "stop"]
[base]
bending = 1.0
"""


def load(tmp_path: Path, text: str) -> DataSet:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    return load_data_set(path)


def test_a_scene(tmp_path: Path) -> None:
    data_set = load(tmp_path, SCENE)
    (scene,) = data_set.scenes()
    assert data_set.garment == Cut(vertices=300)
    assert scene.parameters.parameters == SimulationParameters(bending=1.0)
    assert scene.name == "base-dance-0004"
    assert scene.seed == 7
    motion = scene.motion.make(data_set.make_body(), data_set.fps)
    assert motion.n_frames == 20
    assert scene.provenance()["motion"]["classes"] == ("spin", "stop")


FRAMES = {"large": 1_000_000, "live": 180_000, "small": 7_800, "tiny": 1_000}
GARMENTS = ("dress", "soft_dress", "gown", "a_line", "t_shirt", "trousers", "skirt")


@pytest.mark.parametrize("name", [*FRAMES, *GARMENTS, "parameters"])
def test_nothing_is_tested_that_a_preset_learns(name: str) -> None:
    data_set, large = load_data_set(name), load_data_set("large")
    motions = data_set.sources[0]
    assert sum(m.frames for m in motions if m.split == "train") >= FRAMES.get(name, 40_000)
    splits: dict[int, set[str]] = {}
    for m in itertools.chain(*data_set.sources, large.sources[0] if name in GARMENTS else ()):
        splits.setdefault(m.seed, set()).add(m.split)
    assert all(len(of_seed) == 1 for of_seed in splits.values())
    assert {m.split for m in motions} == set(SPLITS)
    names = [s.name for s in data_set.scenes()]
    assert len(set(names)) == len(names)
    if name in GARMENTS:  # compared with one another, and with large
        assert motions == load_data_set("dress").sources[0]
        assert set(motions) < set(large.sources[0])
        assert data_set.base == large.base
    # Training sets reach every end of the range; tests lie between.
    sets = {k: [s.parameters for s in data_set.sets if s.split == k] for k in SPLITS}
    if asked := sets["test"]:
        learnt = np.array([p.normalised() for p in sets["train"]])
        np.testing.assert_allclose(learnt.min(axis=0), -1, atol=1e-9)
        np.testing.assert_allclose(learnt.max(axis=0), 1, atol=1e-9)
        assert not set(asked) & set(sets["train"])
        assert all(np.abs(p.normalised()).max() < 1 for p in asked)


def test_a_file_like_a_preset(tmp_path: Path) -> None:
    found = load(tmp_path, 'like = "trousers"\n[garment]\nhem = 0.2\n')
    trousers = load_data_set("trousers")
    assert isinstance(trousers.garment, Cut)
    assert found.name == "scene"
    assert found.garment == dataclasses.replace(trousers.garment, hem=0.2)
    assert dataclasses.replace(found, name="trousers", garment=trousers.garment) == trousers
    with pytest.raises(FormatError, match="like"):
        load(tmp_path, 'like = "kilt"')


def test_test_clips_are_paired() -> None:
    tiny = load_data_set("tiny")
    moved = [s for s in tiny.scenes() if s.perturbation > 0]
    assert [s.name for s in moved] == ["base-dance-2000-moved"]
    names = {s.name: s for s in tiny.scenes()}
    for scene in moved:
        assert names[scene.repeat_of].motion == scene.motion
        assert names[scene.repeat_of].perturbation == 0


def test_recorded_motions_reach_every_split(data_dir: Path) -> None:
    folder = data_dir / "motion"
    if not folder.is_dir():
        pytest.skip(f"no motion capture at {folder}")
    tiny = load_data_set("tiny")
    found = recorded_motions(folder, tiny, frames=300)
    assert {m.split for m in found} == {"train", "validation", "test"}
    by_file: dict[str, set[str]] = {}
    for m in found:
        by_file.setdefault(m.file, set()).add(m.split)
    assert all(len(splits) == 1 for splits in by_file.values())
    motion = found[1].make(tiny.make_body(), tiny.fps)
    assert motion.n_frames == found[1].frames
    assert len(tiny.scenes(found)) > len(tiny.scenes())
    # No path of the machine in what is stored.
    scene = tiny.scenes(found)[len(tiny.sources[0])]
    assert str(folder) not in str(scene.provenance())


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("seed = 3", "sead = 3", "sead"),
        ("vertices = 300", "vertices = 3", "garment.vertices"),
        ("vertices = 300", 'mesh = "a.obj"', "garment: .*pinned_above"),
        ("frames = 20", "frames = 0", "motion"),
        ('"spin"', '"fly"', "fly"),
        ('["spin", "stop"]', '"spin"', "motion.classes"),
        ("bending = 1.0", "bending = -1.0", "base.bending"),
        ("bending = 1.0", "bending = nan", "base.bending"),
        ("[base]", "[solver]\nsubsteps = 0\n[base]", "solver.substeps"),
        ("[base]", "[motions]\ntrain = 1\n[base]", "motion"),
        ("[base]", '[[set]]\nsplit = "all"\n[base]', "set\\[0\\].split"),
        ("seed = 3", "seed = -3", "seed"),
        ("seed = 3", "fps = 0", "fps"),
    ],
)
def test_bad_files_say_where(tmp_path: Path, old: str, new: str, word: str) -> None:
    assert old in SCENE
    with pytest.raises(FormatError, match=word) as caught:
        load(tmp_path, SCENE.replace(old, new))
    assert "scene.toml" in str(caught.value)


def test_missing_files_name_the_presets() -> None:
    with pytest.raises(FormatError, match="large, live, parameters"):
        load_data_set("huge")


def test_a_mesh_in_place_of_the_cut_of_a_preset(tmp_path):
    (tmp_path / "coat.toml").write_text(
        'like = "dress"\n[garment]\nmesh = "coat.obj"\npinned_above = 1.2\n'
    )
    found = load_data_set(tmp_path / "coat.toml").garment
    assert found == MeshGarment(str(tmp_path / "coat.obj"), 1.2)
