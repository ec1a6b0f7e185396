"""Clips through files: the same names, ranges, rates and vertices; each plays alone from 0 s."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import ssdr
from helpers import drawn
from helpers.rig_model import largest_distance, tube
from helpers.stages import items
from ssdr import Clip

SUFFIXES = [".npz", ".glb", ".gltf", ".usda", ".usdc"]
CLIPS = (Clip("walk", 0, 9, 24.0), Clip("jump/high", 9, 19, 60.0), Clip("death", 19, 20, 25.0))


@pytest.fixture(autouse=True)
def _usd_core(request):
    suffix = "suffix" in request.fixturenames and request.getfixturevalue("suffix")
    if "usd" in (suffix or request.node.name):
        pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")


def model_of(clips=CLIPS, **options):
    return dataclasses.replace(tube(**options), clips=clips)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_clips_are_read_alone(tmp_path, suffix):
    model = model_of()
    path = tmp_path / f"file{suffix}"
    ssdr.save(model, path)
    assert ssdr.list_clips(path) == CLIPS
    for k, clip in enumerate(CLIPS):
        alone = ssdr.load(path, clip=clip.name)
        assert (alone.clip, alone.fps, alone.name) == (clip.name, clip.fps, "tube")
        assert largest_distance(alone.vertices, model.skin(clip.frames)) < 4e-6
        assert ssdr.load(path, clip=k).clip == clip.name
        one = ssdr.load_skinning(path, clip=clip.name)
        assert one.clips == (dataclasses.replace(clip, start=0, stop=clip.n_frames),)
    assert ssdr.load(path).clip == "walk"
    two = ssdr.load_skinning(path, clip=("death", "walk"))
    assert [(c.name, c.start) for c in two.clips] == [("death", 0), ("walk", 1)]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_mesh_and_root_are_not_named_after_a_clip(tmp_path, suffix):
    walk, jump = (model_of().select(k) for k in (0, 1))
    shots = [
        ssdr.MeshSequence(m.skin(), m.faces, m.fps, name=m.clips[0].name) for m in (walk, jump)
    ]
    model = ssdr.initialize(shots, bones=2)
    ssdr.save(model, tmp_path / f"horse{suffix}")
    back = ssdr.load_skinning(tmp_path / f"horse{suffix}")
    assert back.name == ("" if suffix == ".npz" else "horse")
    assert [c.name for c in back.clips] == ["walk", "jump/high"]


def test_a_player_of_gltf_sees_each_clip_alone(tmp_path):
    keys = np.zeros((20, 5), dtype=bool)
    keys[[0, 4, 12, 19]] = True
    model = model_of()
    ssdr.save(dataclasses.replace(model, keyframes=keys), tmp_path / "keys.glb")
    for clip in ssdr.load_skinning(tmp_path / "keys.glb").clips:
        shown = ssdr.load(tmp_path / "keys.glb", clip=clip.name).vertices
        seconds = 0, (clip.n_frames - 1) / clip.fps
        file = tmp_path / "keys.glb"
        ((ends, _, _, vertex),) = drawn.from_gltf(file, clip=clip.name, seconds=seconds)
        assert largest_distance(ends, shown[[0, -1]][:, vertex]) < 1e-6 * 4


def test_usd_plays_each_clip_once_it_is_bound(tmp_path):
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

    model, path = model_of(), tmp_path / "a.usda"
    ssdr.save(model, path)
    for k, clip in enumerate(CLIPS):
        stage = Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(path)))  # baking writes into it
        found = [one.GetPrim() for one in items(stage, UsdSkel.Animation)]
        assert [p.GetName() for p in found] == ["walk", "jump_high", "death"]
        assert stage.GetDefaultPrim().GetName() == "tube"
        assert dict(found[k].GetCustomDataByKey("ssdr")) == {
            "name": clip.name,
            "fps": clip.fps,
            "frames": clip.n_frames,
        }
        (skeleton,) = items(stage, UsdSkel.Skeleton)
        source = UsdSkel.BindingAPI(skeleton).GetAnimationSourceRel()
        if k == 0:  # bound as it is written, over the range of the stage
            assert source.GetTargets() == [found[0].GetPath()]
            assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 8)
            assert stage.GetTimeCodesPerSecond() == 24
        source.SetTargets([found[k].GetPath()])
        codes = np.arange(clip.n_frames) / clip.fps * stage.GetTimeCodesPerSecond()
        samples = UsdSkel.Animation(found[k]).GetTranslationsAttr().GetTimeSamples()
        np.testing.assert_allclose(samples, codes, rtol=1e-12)
        interval = Gf.Interval(float(codes[0]) - 1e-6, float(codes[-1]) + 1e-6)
        assert UsdSkel.BakeSkinning(stage.Traverse(), interval)
        (mesh,) = items(stage, UsdGeom.Mesh)
        seen = [np.array(mesh.GetPointsAttr().Get(code)) for code in samples]
        assert largest_distance(seen, model.skin(clip.frames)) < 3e-6


def test_a_usd_file_whose_binding_was_changed(tmp_path):
    from pxr import Usd, UsdSkel

    model, path = model_of(), tmp_path / "a.usda"
    ssdr.save(model, path)
    stage = Usd.Stage.Open(str(path))
    skeleton = items(stage, UsdSkel.Skeleton)[0].GetPrim()
    other = skeleton.GetChild("jump_high").GetPath()
    UsdSkel.BindingAPI(skeleton).GetAnimationSourceRel().SetTargets([other])
    for prim in skeleton.GetChildren():
        prim.ClearCustomData()
    stage.GetRootLayer().Save()
    assert [c.name for c in ssdr.list_clips(path)] == ["jump_high", "walk", "death"]
    walk = ssdr.load(path, clip="walk")
    assert largest_distance(walk.vertices, model.skin(CLIPS[0].frames)) < 1e-6 * 4


@pytest.mark.parametrize(
    "stated", ["text", {"fps": -1.0}, {"fps": "24", "frames": 9}, {"fps": 24.0, "frames": 0}]
)
def test_usd_metadata_that_says_nothing_is_ignored(tmp_path, stated):
    from pxr import Usd, UsdSkel

    ssdr.save(model_of(), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    for animation in items(stage, UsdSkel.Animation):
        animation.GetPrim().ClearCustomData()
        animation.GetPrim().SetCustomDataByKey("ssdr", stated)
    stage.GetRootLayer().Save()
    names = ["walk", "jump_high", "death"]
    assert [c.name for c in ssdr.list_clips(tmp_path / "a.usda")] == names


def test_between_frames_leaves_out_what_is_between_clips(tmp_path):
    model = tube(frames=40)
    whole = ssdr.save(model, tmp_path / "a.glb").between_frames
    order = np.concatenate([np.arange(20, 40), np.arange(20)])  # a jump from 39 to 0
    cut = dataclasses.replace(
        model, transforms=model.transforms[order], clips=[Clip("b", 0, 20), Clip("a", 20, 40)]
    )
    assert ssdr.save(cut, tmp_path / "b.glb").between_frames == pytest.approx(whole, rel=0.1)


def test_a_format_without_clips_holds_one(tmp_path, wave):
    ssdr.save(wave, tmp_path / "w.npz")
    ssdr.save(dataclasses.replace(wave, clip="swell"), tmp_path / "c.npz")
    ssdr.save(wave, tmp_path / "w.npy")
    assert ssdr.list_clips(tmp_path / "w.npz") == (Clip("sheet", 0, 4, 25.0),)
    assert ssdr.list_clips(tmp_path / "c.npz") == (Clip("swell", 0, 4, 25.0),)
    assert ssdr.load(tmp_path / "c.npz").clip == "swell"
    assert ssdr.list_clips(tmp_path / "w.npy", fps=12) == (Clip("w", 0, 4, 12.0),)
    assert len(ssdr.load(tmp_path / "w.npy", clip="w")) == 4


def test_names_of_animations_that_are_missing_or_twice_the_same(tmp_path):
    ssdr.save(model_of(), tmp_path / "a.gltf")
    document = json.loads((tmp_path / "a.gltf").read_text())
    for animation, name in zip(document["animations"], ("x", None, "x\0"), strict=True):
        animation["name"] = name
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    names = [c.name for c in ssdr.list_clips(tmp_path / "a.gltf")]
    assert names == ["x", "animation_1", "x_1"]
    assert ssdr.load(tmp_path / "a.gltf", clip="x_1").n_frames == 1
    # one clip can be read though another is damaged
    document["animations"][1]["samplers"][0]["interpolation"] = "WAVY"
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    assert ssdr.load(tmp_path / "a.gltf", clip="x").n_frames == 9
    with pytest.raises(ssdr.FormatError, match="WAVY"):
        ssdr.load_skinning(tmp_path / "a.gltf")
