"""Stores of other programs' files: what arrives, what is resampled, what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

pytest.importorskip("torch")
pytest.importorskip("zarr")
pytest.importorskip("pxr")

from typer.testing import CliRunner

import ssdr
from garmentnet.cli import app
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.store import ClipStore
from garmentnet.importing.importing import ImportOptions, import_clips
from garmentnet.importing.scene_files import Source
from ssdr import MeshSequence, Skinning
from ssdr.common.errors import FormatError, InputError, SsdrError

FRAMES, FPS = 60, 30.0
NAMES, PARENTS = ("hips", "leg_l", "leg_r"), [-1, 0, 0]
JOINTS = np.array([[0, 1.0, 0], [0.1, 0.9, 0], [-0.1, 0.9, 0]])
CORNERS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
SIDES = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]


def motion(frames=FRAMES, fps=FPS, seed=0):
    """Transforms (F, 3, 3, 4) of hips that turn and walk and legs that swing; first at rest."""
    t = np.arange(frames)[:, None] / fps
    phase = np.random.default_rng(seed).uniform(0, 3, 3)
    angle = 0.8 * (np.sin(3 * t + phase) - np.sin(phase)) * [1, 0.6, 0.6]
    turn = Rotation.from_euler("y", angle[:, [0]]).as_matrix()
    hips = np.concatenate([turn, (JOINTS[0] - turn @ JOINTS[0])[..., None]], axis=-1)
    hips[:, :, 3] += np.sin(2 * t) * [0.5, 0, 0.3]
    out = [hips]
    for k in (1, 2):
        swing = turn @ Rotation.from_euler("x", angle[:, [k]]).as_matrix()
        at = turn @ JOINTS[k] + hips[..., 3]
        out.append(np.concatenate([swing, (at - swing @ JOINTS[k])[..., None]], axis=-1))
    return np.stack(out, axis=1)


def rig(moved=None, **changes):
    """An octahedron around every joint."""
    rest = np.concatenate([j + [0, -0.2, 0] + CORNERS * [0.08, 0.25, 0.08] for j in JOINTS])
    faces = np.concatenate([np.array(SIDES) + 6 * k for k in range(3)])
    fields = {
        "faces": faces,
        "fps": FPS,
        "bone_names": NAMES,
        "parents": PARENTS,
        "joint_positions": JOINTS,
        "name": "body",
    }
    index = np.repeat(np.arange(3), 6)[:, None]
    moved = motion() if moved is None else moved
    return Skinning(rest, index, np.ones((18, 1)), moved, **(fields | changes))


def cloth(moved=None, seed=0):
    """A tube whose upper ring the hips carry and whose lower rings wave."""
    around, rings = 10, 5
    turn, down = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(rings))
    radius = 0.15 + 0.03 * down
    rest = np.stack([radius * np.cos(turn), 1 - 0.12 * down, radius * np.sin(turn)], -1)
    rest = rest.reshape(-1, 3)
    k = np.arange(around * (rings - 1))
    n = k - k % around + (k + 1) % around
    faces = np.concatenate(
        [np.stack([k, k + around, n + around], 1), np.stack([k, n + around, n], 1)]
    )
    m = motion() if moved is None else moved
    t = np.arange(len(m))[:, None, None] / FPS
    wave = 0.02 * down.reshape(-1, 1) * np.sin(5 * t + seed + turn.reshape(-1, 1)) * [1, 0, 1]
    wave -= wave[:1]
    v = (rest + wave) @ m[:, 0, :, :3].swapaxes(1, 2) + m[:, None, 0, :, 3]
    return MeshSequence(v.astype(np.float32), faces, FPS, name="skirt")


@pytest.fixture
def files(tmp_path):
    """A cloth as USD and its rig as glTF."""
    ssdr.save(cloth(), tmp_path / "walk.usda")
    ssdr.save(rig(), tmp_path / "walk.glb")
    return tmp_path / "walk.usda", tmp_path / "walk.glb"


def largest_gap(a, b):
    """Of every point of either set to the nearest of the other."""
    return max(cKDTree(x).query(y)[0].max() for x, y in ((a, b), (b, a)))


def test_a_store_has_the_files_vertices_and_motion(files, tmp_path):
    said: list[str] = []
    store = import_clips([files], tmp_path / "a.clips", say=said.append)
    assert store.names() == ("walk-test", "walk-train", "walk-validation")
    assert [store.clip(n).n_frames for n in store.names()] == [6, 48, 6]
    assert (store.skeleton.names, store.fps) == (NAMES, FPS)
    np.testing.assert_allclose(store.skeleton.rest, JOINTS, atol=1e-6)
    order = ("walk-train", "walk-validation", "walk-test")
    clips = [store.clip(n) for n in order]
    vertices = np.concatenate([c.sequence.frames(slice(None)) for c in clips])
    np.testing.assert_allclose(vertices, cloth().vertices, atol=1e-6)
    joints = np.concatenate([c.joints for c in clips])
    np.testing.assert_allclose(joints, motion(), atol=1e-5)
    baked = ssdr.load(files[1]).vertices  # by the reader, which knows nothing of the store
    for t, body in enumerate(np.concatenate([c.body() for c in clips])):
        assert largest_gap(body, baked[t]) < 1e-5
    # The motion starts in the bind pose, where the cloth is as it was cut.
    np.testing.assert_allclose(store.rest, cloth().vertices[0], atol=1e-6)
    assert any("frame 0" in text for text in said)
    assert not any("warning" in text or "pushed" in text for text in said)


def test_the_rest_pose_is_found_later_in_a_clip_and_elsewhere(files, tmp_path):
    moved = motion()[::-1]
    ssdr.save(cloth(moved), tmp_path / "back.usda")
    ssdr.save(rig(moved), tmp_path / "back.glb")
    pair = tmp_path / "back.usda", tmp_path / "back.glb"
    store = import_clips([pair], tmp_path / "a.clips")
    expected = cloth(moved).vertices[-1]
    np.testing.assert_allclose(store.rest, expected, atol=1e-5)
    cut = MeshSequence(cloth().vertices[:1] * np.float32(1.01), cloth().faces)
    ssdr.save(cut, tmp_path / "cut.npz")
    store = import_clips([pair], tmp_path / "b.clips", rest=tmp_path / "cut.npz")
    np.testing.assert_allclose(store.rest, cut.vertices[0], atol=1e-6)


def test_triangles_that_face_the_body_are_turned_round(files, tmp_path):
    tube = cloth()
    inside_out = MeshSequence(tube.vertices, tube.faces[:, ::-1], FPS)
    for name, mesh in (("one", inside_out), ("other", tube)):
        ssdr.save(mesh, tmp_path / f"{name}.npz")
    said: list[str] = []
    pairs = [(tmp_path / f"{name}.npz", files[1]) for name in ("one", "other")]
    store = import_clips(pairs, tmp_path / "a.clips", say=said.append)
    a, b, c = store.rest[store.faces].swapaxes(0, 1)
    away = (a + b + c) / 3 * [1, 0, 1]  # from the axis of the tube
    assert (np.einsum("tc,tc->t", np.cross(b - a, c - a), away) > 0).all()
    assert sum("turned round" in text for text in said) <= 1
    assert "other: warning: its rig moves as that of one does" in said
    assert len(store.names()) == 6


def test_clips_go_to_named_splits_and_are_added_once(files, tmp_path):
    pairs = [files]
    for seed, name in enumerate(("run", "jump"), start=1):
        moved = motion(seed=seed)
        ssdr.save(cloth(moved, seed), tmp_path / f"{name}.usda")
        ssdr.save(rig(moved), tmp_path / f"{name}.glb")
        pairs.append((tmp_path / f"{name}.usda", tmp_path / f"{name}.glb"))
    options = ImportOptions(test=("run",), parameters=SimulationParameters(bending=1.5))
    for _ in range(2):
        store = import_clips(pairs, tmp_path / "a.clips", options)
    assert store.names("test") == ("run",)
    assert store.names("train") == ("jump-train", "walk-train")
    assert store.names("validation") == ("jump-validation", "walk-validation")
    assert {c.parameters.bending for c in store.clips()} == {1.5}
    ssdr.save(cloth(motion(seed=9), 9), tmp_path / "run.usda")
    ssdr.save(rig(motion(seed=9)), tmp_path / "run.glb")
    with pytest.raises(InputError, match="clip run is of"):
        import_clips(pairs[1:2], tmp_path / "a.clips", ImportOptions(test=("run",)))


@pytest.mark.parametrize("first", [{}, {"test": ("walk",)}])
def test_a_clip_is_in_a_store_in_one_way_alone(files, tmp_path, first):
    """Imported once more in other splits, frames for testing would be trained on."""
    store = import_clips([files], tmp_path / "a.clips", ImportOptions(**first))
    names = store.names()
    for other in ({}, {"test": ("walk",)}, {"validation": ("walk",)}):
        if other != first:
            with pytest.raises(InputError, match=r"the splits in which the store has walk \(walk"):
                import_clips([files], tmp_path / "a.clips", ImportOptions(**other))
        assert ClipStore.open(store.path).names() == names


def test_another_rate_is_resampled_and_said(files, tmp_path):
    fast = motion(frames=2 * FRAMES - 1, fps=2 * FPS)
    ssdr.save(rig(fast, fps=2 * FPS), tmp_path / "fast.glb")
    said: list[str] = []
    store = import_clips([(files[0], tmp_path / "fast.glb")], tmp_path / "a.clips", say=said.append)
    assert any("resampled from 60 to 30" in text for text in said)
    joints = np.concatenate(
        [store.clip(f"walk-{s}").joints for s in ("train", "validation", "test")]
    )
    np.testing.assert_allclose(joints, fast[::2], atol=1e-5)
    ssdr.save(dataclasses.replace(cloth(), fps=25.0), tmp_path / "cache.npz")
    with pytest.raises(InputError, match=r"cache\.npz: expected 30 frames a second, got 25"):
        import_clips([(tmp_path / "cache.npz", files[1])], tmp_path / "a.clips")
    with pytest.raises(InputError, match="fps: expected 30"):
        import_clips([files], tmp_path / "a.clips", ImportOptions(fps=24.0))


def test_units_and_axes_are_applied_or_hinted_at(files, tmp_path):
    turned = cloth().vertices[..., [0, 2, 1]] * np.float32([1, -1, 1])  # z up
    cases = {
        "cloth-scale 0.01": cloth().vertices * np.float32(100),
        "cloth-up z": turned,
        "cloth-up z and cloth-scale 0.01": turned * np.float32(100),
    }
    for k, (hint, vertices) in enumerate(cases.items()):
        source = tmp_path / f"c{k}.npz"
        ssdr.save(MeshSequence(vertices, cloth().faces, FPS), source)
        with pytest.raises(InputError, match=f"away from it; {hint} would fit"):
            import_clips([(source, files[1])], tmp_path / "a.clips")
        assert not (tmp_path / "a.clips").exists()
        right = Source(scale=0.01 if "scale" in hint else 1.0, up="z" if "up" in hint else None)
        store = import_clips(
            [(source, files[1])], tmp_path / f"{k}.clips", ImportOptions(cloth=right)
        )
        np.testing.assert_allclose(store.rest, cloth().vertices[0], atol=1e-5)
    ssdr.save(cloth(), tmp_path / "c.npz")
    for kind in ("cloth", "rig"):
        wrong = ImportOptions(**{kind: Source(up="z")})
        with pytest.raises(InputError, match=f"away from it; {kind}-up y would fit"):
            import_clips([(tmp_path / "c.npz", files[1])], tmp_path / "a.clips", wrong)
    ssdr.save(
        MeshSequence(cloth().vertices + np.float32(3), cloth().faces, FPS), tmp_path / "far.npz"
    )
    with pytest.raises(
        InputError, match=r"got one 0\.\d+ m large, \d\.\d+ m away from it \(far\)$"
    ):
        import_clips([(tmp_path / "far.npz", files[1])], tmp_path / "a.clips")


def test_candidates_are_ranked_and_a_tiny_cloth_is_not_taken_in_silence(files, tmp_path):
    """In centimetres with z up: a tenth of the right size lies close to the body, too."""
    turned = cloth().vertices[..., [0, 2, 1]] * np.float32([100, -100, 100])
    source = tmp_path / "cape.npz"
    ssdr.save(MeshSequence(turned, cloth().faces, FPS), source)
    with pytest.raises(InputError, match=r"; cloth-up z and cloth-scale 0\.01 would fit"):
        import_clips([(source, files[1])], tmp_path / "a.clips")
    for scale, up in ((0.0014, "z"), (0.0014, None)):
        said: list[str] = []
        options = ImportOptions(cloth=Source(scale=scale, up=up))
        try:
            import_clips([(source, files[1])], tmp_path / f"{up}.clips", options, say=said.append)
        except InputError as error:
            said.append(str(error))
        assert any("cloth-scale 0.014 would fit" in text for text in said), said


def test_the_output_is_checked_before_anything_is_read(files, tmp_path):
    store = import_clips([files], tmp_path / "new" / "deeper" / "a.clips")
    assert store.path.parent.name == "deeper"
    (tmp_path / "file").write_text("in the way")
    missing = tmp_path / "not there.usda", tmp_path / "nor there.glb"
    with pytest.raises((InputError, SsdrError), match="file"):
        import_clips([missing], tmp_path / "file" / "a.clips")


def test_a_skeleton_of_another_size_and_one_that_lies_are_two_messages(tmp_path):
    def said_of(scale, turn):
        def put(x):
            return (x[..., [0, 2, 1]] * [1, -1, 1] if turn else x) * scale

        m = np.tile(np.eye(3, 4), (FRAMES, 3, 1, 1))
        tall = JOINTS * [1, 1, 1] - [[0, 0, 0], [0, 0.6, 0], [0, 0.6, 0]]
        body = rig(m, joint_positions=put(tall))
        ssdr.save(dataclasses.replace(body, rest=put(body.rest)), tmp_path / "r.npz")
        still = np.repeat(put(np.asarray(cloth().vertices[:1], float)), FRAMES, axis=0)
        ssdr.save(MeshSequence(still.astype(np.float32), cloth().faces, FPS), tmp_path / "c.npz")
        said: list[str] = []
        path = tmp_path / f"{scale}-{turn}.clips"
        import_clips([(tmp_path / "c.npz", tmp_path / "r.npz")], path, say=said.append)
        return " ".join(text for text in said if "warning" in text)

    assert said_of(1.0, False) == ""
    assert "--rig-scale" in said_of(0.1, False)
    assert "--rig-up" not in said_of(0.1, False)
    assert "--rig-up z" in said_of(1.0, True)
    assert "--rig-scale" not in said_of(1.0, True)


def test_usd_in_centimetres_with_z_up_is_read_in_metres_with_y_up(files, tmp_path):
    from pxr import Usd, UsdGeom

    turned = cloth().vertices[..., [0, 2, 1]] * np.float32([100, -100, 100])
    ssdr.save(MeshSequence(turned, cloth().faces, FPS), tmp_path / "cm.usda")
    stage = Usd.Stage.Open(str(tmp_path / "cm.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.Save()
    store = import_clips([(tmp_path / "cm.usda", files[1])], tmp_path / "a.clips")
    np.testing.assert_allclose(store.rest, cloth().vertices[0], atol=1e-5)


def test_other_skeletons_topologies_and_times_are_refused(files, tmp_path):
    import_clips([files], tmp_path / "a.clips")

    def refused(match, new_cloth=None, new_rig=None, **options):
        ssdr.save(new_cloth or cloth(), tmp_path / "other.usda")
        ssdr.save(new_rig or rig(), tmp_path / "other.glb")
        pair = tmp_path / "other.usda", tmp_path / "other.glb"
        with pytest.raises(InputError, match=match):
            import_clips([pair], tmp_path / "a.clips", ImportOptions(**options))

    bare = {"parents": None, "joint_positions": None}
    refused("rig: expected a skeleton: joints with parents", new_rig=rig(**bare))
    refused(
        "joints and parents .* others: arm_r, leg_r",
        new_rig=rig(bone_names=("hips", "leg_l", "arm_r")),
    )
    refused("others: leg_r", new_rig=rig(parents=[-1, 0, 1]))
    lower = JOINTS - [[0, 0, 0], [0, 0.3, 0], [0, 0, 0]]
    refused("bind pose of the first clip, got leg_l 0.", new_rig=rig(joint_positions=lower))
    scaled = motion()
    scaled[20:, 2, :, :3] *= 1.5
    refused(
        "joints that turn and move, got leg_r scaled", new_rig=rig(scaled, bone_model="similarity")
    )
    fewer = MeshSequence(cloth().vertices, cloth().faces[:-1], FPS)
    first = "cloth: expected the mesh of the first clip, 50 vertices and 80 triangles"
    refused(rf"{first}, got 50 and 79 \(other\)", fewer)
    other_order = MeshSequence(cloth().vertices, cloth().faces[::2].tolist() * 2, FPS)
    refused(f"{first}, got as many in another order", other_order)
    loose = np.concatenate([cloth().vertices, cloth().vertices[:, :1]], axis=1)
    refused(f"{first}, got 51 and 80", MeshSequence(loose, cloth().faces, FPS))
    refused("a time that cloth and rig have in common, got 60 frames of cloth", offset=2.5)
    refused("expected some of other, got walk", test=("walk",))
    with pytest.raises(InputError, match="different names"):
        import_clips([files, files], tmp_path / "b.clips")
    ssdr.save(MeshSequence(cloth().vertices[:1], cloth().faces[:-1]), tmp_path / "cut.npz")
    with pytest.raises(InputError, match="rest: expected the mesh of the first clip"):
        import_clips([files], tmp_path / "b.clips", rest=tmp_path / "cut.npz")


def test_only_common_frames_are_taken(files, tmp_path):
    late = motion()[10:]
    ssdr.save(cloth(late), tmp_path / "late.usda")
    pair = tmp_path / "late.usda", files[1]
    said: list[str] = []
    store = import_clips([pair], tmp_path / "b.clips", ImportOptions(offset=1 / 3), say=said.append)
    assert any("50 frames in common of 50 frames of cloth, 60 of the rig" in text for text in said)
    np.testing.assert_allclose(store.clip("late-train").joints, late[:40], atol=1e-5)


def test_a_skeleton_in_another_place_and_order_is_the_same(files, tmp_path):
    turn = Rotation.from_euler("y", 0.7).as_matrix()
    place = turn @ JOINTS.T + [[0.4], [0.0], [-0.2]]
    order = [0, 2, 1]
    there, back = place.T[order], rig()
    rest = back.rest @ turn.T + [0.4, 0.0, -0.2]
    m = motion()
    linear = m[..., :3] @ turn.T
    shift = m[..., 3] - linear @ [0.4, 0.0, -0.2]
    moved = np.concatenate([linear, shift[..., None]], axis=-1)[:, order]
    names = tuple(np.array(NAMES)[order])
    other = rig(moved, bone_names=names, joint_positions=there)
    indices = np.argsort(order)[back.indices]
    ssdr.save(dataclasses.replace(other, rest=rest, indices=indices), tmp_path / "again.glb")
    ssdr.save(cloth(), tmp_path / "again.usda")
    pairs = [files, (tmp_path / "again.usda", tmp_path / "again.glb")]
    store = import_clips(pairs, tmp_path / "a.clips")
    np.testing.assert_allclose(
        store.clip("again-train").joints, store.clip("walk-train").joints, atol=1e-5
    )


def test_a_prop_and_an_open_body_do_no_harm(files, tmp_path):
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
    ssdr.save(model, tmp_path / "prop.npz")
    said: list[str] = []
    store = import_clips([(files[0], tmp_path / "prop.npz")], tmp_path / "a.clips", say=said.append)
    assert (store.skeleton.names, store.body.n_vertices) == (NAMES, 18)
    assert any("not closed: nothing can be pushed out" in text for text in said)


@pytest.mark.slow
def test_a_rig_without_a_body_is_learned_and_drawn(files, tmp_path):
    """Its joints stand for the body: nothing is pushed out, and nothing counts as inside."""
    from pxr import Usd

    ssdr.save(rig(), tmp_path / "bones.usda")
    stage = Usd.Stage.Open(str(tmp_path / "bones.usda"))
    stage.RemovePrim("/body/Mesh")
    stage.Save()

    def call(*words):
        result = CliRunner().invoke(app, [str(w) for w in words])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == 0, result.output
        return result

    store, run = tmp_path / "a.clips", tmp_path / "run"
    done = call("import", "--cloth", files[0], "--rig", tmp_path / "bones.usda", "-o", store)
    assert "no body: nothing can be pushed out" in done.stderr
    assert len(ClipStore.open(store).body.faces) == 0
    small = [
        "bones.count=6",
        "low.hidden=8",
        "high.hidden=8",
        "train.epochs=1",
        "train.high_epochs=1",
    ]
    small += [
        "train.tensorboard=false",
        "train.threads=1",
        "high.mlp=[4]",
        "high.edge_features=[4]",
    ]
    call("train", "tiny", "--store", store, "-o", run, *(w for s in small for w in ("--set", s)))
    network, clip = run / "checkpoint.safetensors", store / "clips" / "walk-test"
    done = call("predict", network, clip, "-o", tmp_path / "a.png", "-o", tmp_path / "a.npz")
    assert "nothing is pushed out: the body has no closed mesh" in done.stderr
    assert (tmp_path / "a.png").is_file()
    assert ssdr.load(tmp_path / "a.npz").vertices.shape == (6, 50, 3)
    table = call("evaluate", network, "--store", store, "-o", tmp_path / "e", "--no-baselines")
    assert "run" in table.stdout


def test_the_command_takes_patterns_and_one_rig_for_all(files, tmp_path):
    call = CliRunner().invoke
    ssdr.save(cloth(motion()[::-1]), tmp_path / "back.usda")
    both = Skinning(
        rig().rest,
        rig().indices,
        rig().weights,
        np.concatenate([motion(), motion()[::-1]]),
        faces=rig().faces,
        bone_names=NAMES,
        parents=PARENTS,
        joint_positions=JOINTS,
        clips=(ssdr.Clip("walk", 0, 60, FPS), ssdr.Clip("back", 60, 120, FPS)),
    )
    ssdr.save(both, tmp_path / "both.glb")
    words = ["import", "--cloth", f"{tmp_path}/*.usda", "--rig", f"{tmp_path}/both.glb"]
    words += ["-o", str(tmp_path / "a.clips"), "--test", "back", "--validation", "back"]
    result = call(app, [*words, "--parameters", "bending=2,density=0.3"])
    assert result.exit_code == 0, result.output
    store = ClipStore.open(tmp_path / "a.clips")
    assert store.names() == ("back", "walk")
    assert store.clip("walk").parameters == SimulationParameters(2.0, 0.3)
    np.testing.assert_allclose(store.clip("back").joints, motion()[::-1], atol=1e-5)
    for bad, match in (
        (["--parameters", "weight=2"], "weight"),
        (["--rig", "x.glb", "--rig", "y.glb"], "as cloths"),
    ):
        error = call(app, [*words, *bad]).exception
        assert isinstance(error, (InputError, FormatError))
        assert match in str(error)
