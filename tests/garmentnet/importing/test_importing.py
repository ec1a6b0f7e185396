"""Stores of other programs' files: what arrives, what is resampled, what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("pxr")

from typer.testing import CliRunner

import ssdr
from garmentnet.cli import app
from garmentnet.cli.importing import _files
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.store import ClipStore
from garmentnet.importing.importing import ImportOptions, import_clips
from garmentnet.importing.scene_files import Source, read_cloth
from helpers.measures import largest_gap
from helpers.walking_rig import FPS, FRAMES, JOINTS, NAMES, PARENTS, cloth, motion, rig
from ssdr import MeshSequence, Skinning
from ssdr.common.errors import InputError


def test_a_store_has_the_files_vertices_and_motion(files, tmp_path):
    said: list[str] = []
    store = import_clips([files], tmp_path / "a.clips", say=said.append)
    assert store.names() == ("walk",)
    assert (store.skeleton.names, store.fps) == (NAMES, FPS)
    np.testing.assert_allclose(store.skeleton.rest, JOINTS, atol=1e-6)
    clip = store.clip("walk")
    np.testing.assert_allclose(clip.sequence.frames(slice(None)), cloth().vertices, atol=1e-6)
    np.testing.assert_allclose(clip.joints, motion(), atol=1e-5)
    baked = ssdr.load(files[1]).vertices  # by the reader, which knows nothing of the store
    for t, body in enumerate(clip.body()):
        assert largest_gap(body, baked[t]) < 1e-5
    # The motion starts in the bind pose, where the cloth is as it was cut.
    np.testing.assert_allclose(store.rest, cloth().vertices[0], atol=1e-6)
    assert any("frame 0" in text for text in said)
    assert not any("warning" in text or "pushed" in text for text in said)


def test_the_rest_pose_is_found_later_in_a_clip_and_elsewhere(pair, tmp_path):
    moved = motion()[::-1]
    back = pair("back", cloth(moved), rig(moved))
    store = import_clips([back], tmp_path / "a.clips")
    np.testing.assert_allclose(store.rest, cloth(moved).vertices[-1], atol=1e-5)
    cut = MeshSequence(cloth().vertices[:1] * np.float32(1.01), cloth().faces)
    ssdr.save(cut, tmp_path / "cut.npz")  # which has no named meshes
    options = ImportOptions(cloth=Source("Mesh"))
    store = import_clips([back], tmp_path / "b.clips", options, rest=tmp_path / "cut.npz")
    np.testing.assert_allclose(store.rest, cut.vertices[0], atol=1e-6)


def test_the_rest_pose_lies_on_the_body_though_the_root_stands_still(pair, tmp_path):
    """As in rigs of engines, whose first bone stays at the origin and is left out."""
    away = np.add(motion(), [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 3]])
    still = np.concatenate([np.tile(np.eye(3, 4), (FRAMES, 1, 1, 1)), away], axis=1)
    rooted = rig(
        still,
        bone_names=("root", *NAMES),
        parents=[-1, 0, 1, 1],
        joint_positions=np.concatenate([np.zeros((1, 3)), JOINTS]),
    )
    rooted = dataclasses.replace(rooted, indices=rig().indices + 1)
    pairs = [pair(name, cloth(away), rooted) for name in ("walk", "again")]
    store = import_clips(pairs, tmp_path / "a.clips")
    assert (store.skeleton.names, len(store.names())) == (NAMES, 2)
    np.testing.assert_allclose(store.rest, cloth().vertices[0], atol=0.15)


def test_joints_that_the_first_rig_has_not_are_left_out(pair, files, tmp_path):
    """As when the model that a prediction wrote, with its virtual bones, is animated anew."""
    more = np.concatenate([motion(), motion(seed=1)[:, 1:2]], axis=1)
    dressed = rig(
        more,
        bone_names=(*NAMES, "virtual_00"),
        parents=[-1, 0, 0, 0],
        joint_positions=np.concatenate([JOINTS, JOINTS[:1]]),
    )
    import_clips([files], tmp_path / "a.clips")
    store = import_clips([pair("other", cloth(), dressed)], tmp_path / "a.clips")
    np.testing.assert_allclose(store.clip("other").joints, motion(), atol=1e-5)


def test_files_without_times_have_the_rate_that_is_stated(pair, tmp_path):
    ssdr.save(cloth(), tmp_path / "walk%04d.obj")
    said: list[str] = []
    files = tmp_path / "walk%04d.obj", pair()[1]
    store = import_clips([files], tmp_path / "a.clips", ImportOptions(fps=30.0), say=said.append)
    assert store.fps == 30
    assert "walk%04d.obj states no frame rate: 30 frames a second" in said
    assert store.clip("walk04d").n_frames == 60


@pytest.mark.parametrize("stems", [("take1", "take2", "take10"), ("walk", "walk2", "walk11")])
def test_files_of_two_patterns_are_paired_by_number(tmp_path, stems):
    pairs = [tmp_path / f"{stem}{end}" for end in (".abc", "_rig.fbx") for stem in stems]
    for path in pairs:
        path.touch()
    found = [_files("--cloth", [f"{tmp_path}/*{end}"]) for end in (".abc", ".fbx")]
    assert found == [pairs[:3], pairs[3:]]


def test_pieces_that_face_the_body_are_turned_round(pair, tmp_path):
    one, said = cloth(), []
    outer = one.vertices * [1.02, 1, 1.02]
    faces = np.concatenate([one.faces[:, ::-1], one.faces + one.n_vertices])
    two = MeshSequence(np.concatenate([one.vertices, outer], axis=1), faces, FPS)
    other = dataclasses.replace(two, faces=two.faces[:, ::-1])
    pairs = [pair("one", two), pair("other", other)]
    store = import_clips(pairs, tmp_path / "a.clips", say=said.append)
    assert len(store.names()) == 2
    half = len(one.faces)
    assert f"{half} of {2 * half} triangles face the body: they are turned round" in said
    a, b, c = store.rest[store.faces].swapaxes(0, 1)
    away = (a + b + c) / 3 * [1, 0, 1]  # from the axis of the tube
    assert (np.einsum("tc,tc->t", np.cross(b - a, c - a), away) > 0).all()


def test_clips_go_to_named_splits_and_are_added_once(pair, tmp_path):
    def other(name, seed):
        return pair(name, cloth(motion(seed=seed), seed), rig(motion(seed=seed)))

    pairs = [pair(), other("run", 1), other("jump", 2)]
    options = ImportOptions(test=("run",), parameters=SimulationParameters(bending=1.5))
    for _ in range(2):
        store = import_clips(pairs, tmp_path / "a.clips", options)
    assert store.names("test") == ("run",)
    assert (store.names("train"), store.names("validation")) == (("walk",), ("jump",))
    assert {c.parameters.bending for c in store.clips()} == {1.5}
    with pytest.raises(InputError, match=r"clip run is of .* imported with other files or options"):
        import_clips([other("run", 9)], tmp_path / "a.clips", options)
    with pytest.raises(InputError, match=r"or options \(bending 1\.5, density"):
        import_clips(pairs, tmp_path / "a.clips")


def test_another_rate_is_resampled_and_said(pair, tmp_path):
    fast = motion(frames=2 * FRAMES - 1, fps=2 * FPS)
    said: list[str] = []
    source = pair(new_rig=rig(fast, fps=2 * FPS))
    store = import_clips([source], tmp_path / "a.clips", say=said.append)
    assert any("resampled from 60 to 30" in text for text in said)
    np.testing.assert_allclose(store.clip("walk").joints, fast[::2], atol=1e-5)


TURNED = cloth().vertices[..., [0, 2, 1]] * np.float32([1, -1, 1])  # z up


@pytest.mark.parametrize(
    ("right", "vertices"),
    [
        ({"scale": 0.01}, cloth().vertices * np.float32(100)),
        ({"up": "z"}, TURNED),
        ({"scale": 0.01, "up": "z"}, TURNED * np.float32(100)),
    ],
)
def test_units_and_axes_are_asked_for_and_applied(pair, tmp_path, right, vertices):
    source = pair("c", MeshSequence(vertices, cloth().faces, FPS), cloth_as="npz")
    with pytest.raises(InputError, match=r"large, [\d.]+ m away from it; scale \(--cloth-scale"):
        import_clips([source], tmp_path / "a.clips")
    assert not (tmp_path / "a.clips").exists()
    options = ImportOptions(cloth=Source(**right))
    store = import_clips([source], tmp_path / "a.clips", options)
    np.testing.assert_allclose(store.rest, cloth().vertices[0], atol=1e-5)


def test_a_wrong_axis_and_a_cloth_far_away(pair, tmp_path):
    still = pair("c", cloth_as="npz")
    far = pair("far", MeshSequence(cloth().vertices + np.float32(3), cloth().faces, FPS))
    for source, options in (
        (still, {"cloth": Source(up="z")}),
        (still, {"rig": Source(up="z")}),
        (far, {}),
    ):
        with pytest.raises(InputError, match=r"got one 0\.\d+ m large, [\d.]+ m away from it"):
            import_clips([source], tmp_path / "a.clips", ImportOptions(**options))


def test_a_tiny_cloth_is_not_taken_in_silence(pair, tmp_path):
    """A twelfth of the right size lies close to the body, too."""
    said: list[str] = []
    m = motion()[:, 0]
    hips = (m[..., :3] @ JOINTS[0] + m[..., 3])[:, None].astype(np.float32)
    small = hips + (cloth().vertices - hips) / np.float32(12)
    import_clips(
        [pair("cape", MeshSequence(small, cloth().faces, FPS))],
        tmp_path / "a.clips",
        say=said.append,
    )
    assert any(text.startswith("warning: the garment is 0.") for text in said), said


@pytest.mark.parametrize(
    ("scale", "turn", "hint"),
    [(1.0, False, ""), (0.1, False, "--rig-scale"), (1.0, True, "--rig-up z")],
)
def test_a_skeleton_of_another_size_and_one_that_lies_are_two_messages(
    pair, tmp_path, scale, turn, hint
):
    def put(x):
        return (x[..., [0, 2, 1]] * [1, -1, 1] if turn else x) * scale

    tall = JOINTS * [1, 1, 1] - [[0, 0, 0], [0, 0.6, 0], [0, 0.6, 0]]
    body = rig(np.tile(np.eye(3, 4), (FRAMES, 3, 1, 1)), joint_positions=put(tall))
    body = dataclasses.replace(body, rest=put(body.rest))
    still = np.repeat(put(np.asarray(cloth().vertices[:1], float)), FRAMES, axis=0)
    still = MeshSequence(still.astype(np.float32), cloth().faces, FPS)
    said: list[str] = []
    source = pair("c", still, body, "npz", "npz")
    import_clips([source], tmp_path / "a.clips", say=said.append)
    warnings = " ".join(text for text in said if "warning" in text)
    assert (warnings == "") == (hint == "")
    assert {x for x in ("--rig-scale", "--rig-up z") if x in warnings} == {hint} - {""}


def test_usd_in_centimetres_with_z_up_is_read_in_metres_with_y_up(pair, tmp_path):
    from pxr import Usd, UsdGeom

    source = pair("cm", MeshSequence(TURNED * np.float32(100), cloth().faces, FPS))
    stage = Usd.Stage.Open(str(source[0]))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.Save()
    store = import_clips([source], tmp_path / "a.clips")
    np.testing.assert_allclose(store.rest, cloth().vertices[0], atol=1e-5)


def test_files_and_their_animations_may_have_spaces_in_their_names(pair, tmp_path):
    """The second of two animations has the name of the cloth; the clip that of both without it."""
    clips = (ssdr.Clip("Rig|walk", 0, 60, FPS), ssdr.Clip("Rig|Ä Go Back|BaseLayer", 60, 120, FPS))
    both = np.concatenate([motion(), motion()[::-1]])
    source = pair("ä go back", cloth(motion()[::-1]), rig(both, clips=clips, fps=None))
    store = import_clips([source], tmp_path / "a.clips", ImportOptions(test=("ä go back",)))
    assert store.names() == ("goback",)
    np.testing.assert_allclose(store.clip("goback").joints, motion()[::-1], atol=1e-5)
    with pytest.raises(InputError, match="cloth: expected one file or more, of different names"):
        import_clips([pair("ä")], tmp_path / "b.clips")
    with pytest.raises(InputError, match=r"animation with the name jump, got Rig\|walk, Rig\|Ä Go"):
        import_clips([(pair("jump")[0], source[1])], tmp_path / "b.clips")
    back = read_cloth(source[1], Source(), None, print)
    assert largest_gap(back.vertices[0], rig(motion()[::-1]).skin(0)) < 1e-5


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"cloth": Source(scale=-1.0)}, "cloth_scale: expected a positive number"),
        ({"rig": Source(scale=0.0)}, "rig_scale"),
        ({"fps": np.inf}, "fps"),
        ({"offset": np.nan}, "offset: expected a number of seconds"),
    ],
)
def test_numbers_are_checked(wrong, text):
    with pytest.raises(InputError, match=text):
        ImportOptions(**wrong)


def test_only_common_frames_are_taken(pair, tmp_path):
    late = motion()[10:]
    source = pair(new_cloth=cloth(late))
    store = import_clips([source], tmp_path / "b.clips", ImportOptions(offset=1 / 3))
    np.testing.assert_allclose(store.clip("walk").joints, late, atol=1e-5)


def test_a_skeleton_in_another_place_and_order_is_the_same(pair, tmp_path):
    turn, shift = Rotation.from_euler("y", 0.7).as_matrix(), [0.4, 0.0, -0.2]
    order, body, m = [0, 2, 1], rig(), motion()
    linear = m[..., :3] @ turn.T
    moved = np.concatenate([linear, (m[..., 3] - linear @ shift)[..., None]], axis=-1)[:, order]
    there = (JOINTS @ turn.T + shift)[order]
    other = rig(moved, bone_names=tuple(np.array(NAMES)[order]), joint_positions=there)
    indices = np.argsort(order)[body.indices]
    other = dataclasses.replace(other, rest=body.rest @ turn.T + shift, indices=indices)
    store = import_clips([pair(), pair("again", new_rig=other)], tmp_path / "a.clips")
    again, walk = (store.clip(name).joints for name in ("again", "walk"))
    np.testing.assert_allclose(again, walk, atol=1e-5)


def test_a_prop_and_an_open_body_do_no_harm(pair, tmp_path):
    body = rig()
    floor = np.array([[-2, 0, -2], [2, 0, -2], [0, 0, 2.0]])
    still = np.tile(np.eye(3, 4), (FRAMES, 1, 1, 1))
    model = Skinning(
        np.concatenate([body.rest, floor]),
        np.concatenate([body.indices, np.full((3, 1), 3)]),
        np.ones((21, 1)),
        np.concatenate([motion(), still], axis=1),
        faces=np.concatenate([body.faces[1:], [[18, 19, 20]]]),
        fps=FPS,
        bone_names=(*NAMES, "floor"),
        parents=[*PARENTS, -1],
        joint_positions=np.concatenate([JOINTS, np.zeros((1, 3))]),
    )
    said: list[str] = []
    source = pair("prop", new_rig=model, rig_as="npz")
    store = import_clips([source], tmp_path / "a.clips", say=said.append)
    assert (store.skeleton.names, store.body.n_vertices) == (NAMES, 18)
    assert any("not closed: nothing can be pushed out" in text for text in said)


@pytest.mark.slow
def test_a_rig_without_a_body_is_learned_and_drawn(tmp_path):
    """Its joints stand for the body: nothing is pushed out, and nothing counts as inside."""
    from pxr import Usd

    for name in "abc":
        ssdr.save(cloth(), tmp_path / f"{name}.usda")
    ssdr.save(rig(), tmp_path / "bones.usda")
    stage = Usd.Stage.Open(str(tmp_path / "bones.usda"))
    stage.RemovePrim("/body/Mesh")
    stage.Save()

    def call(*words):
        result = CliRunner().invoke(app, [str(w) for w in words], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return result

    store, run = tmp_path / "a.clips", tmp_path / "run"
    source = "--cloth", tmp_path / "?.usda", "--rig", tmp_path / "bones.usda"
    done = call("import", *source, "-o", store)
    assert "no body: nothing can be pushed out" in done.stderr
    assert len(ClipStore.open(store).body.faces) == 0
    small = "bones.count=6 low.hidden=8 high.hidden=8 train.epochs=1 train.high_epochs=1 "
    small += "train.threads=1 high.edge_features=[4]"
    call(
        "train",
        "tiny",
        "--store",
        store,
        "-o",
        run,
        *(w for s in small.split() for w in ("--set", s)),
    )
    network, clip = run / "checkpoint.safetensors", store / "clips" / "c.npz"
    done = call("predict", network, clip, "-o", tmp_path / "a.png", "-o", tmp_path / "a.npz")
    assert "nothing is pushed out: the body has no closed mesh" in done.stderr
    assert (tmp_path / "a.png").is_file()
    assert ssdr.load(tmp_path / "a.npz").vertices.shape == (60, 50, 3)
    table = call("evaluate", network, "--store", store, "-o", tmp_path / "e", "--no-baselines")
    assert "run" in table.stdout


def test_the_command_takes_patterns_and_one_rig_for_all(files, tmp_path):
    call = CliRunner().invoke
    ssdr.save(cloth(motion()[::-1]), tmp_path / "back.usda")
    clips = (ssdr.Clip("walk", 0, 60, FPS), ssdr.Clip("back", 60, 120, FPS))
    both = np.concatenate([motion(), motion()[::-1]])
    ssdr.save(rig(both, clips=clips, fps=None), tmp_path / "both.glb")
    words = ["import", "--cloth", f"{tmp_path}/*.usda", "--rig", f"{tmp_path}/both.glb"]
    words += ["-o", str(tmp_path / "a.clips"), "--test", "back"]
    result = call(app, [*words, "--parameters", "bending=2,density=0.3"])
    assert result.exit_code == 0, result.output
    store = ClipStore.open(tmp_path / "a.clips")
    assert (store.names("test"), store.names("train")) == (("back",), ("walk",))
    assert store.clip("walk").parameters == SimulationParameters(2.0, 0.3)
    np.testing.assert_allclose(store.clip("back").joints, motion()[::-1], atol=1e-5)
    for bad, text in (
        (["--parameters", "weight=2"], "weight"),
        (["--rig", "x.glb", "--rig", "y.glb"], "as cloths"),
    ):
        assert text in str(call(app, [*words, *bad]).exception)
