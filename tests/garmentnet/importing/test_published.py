"""Clips in the layout of the paper's data set, made here."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

pytest.importorskip("torch")
pytest.importorskip("zarr")

import ssdr
from garmentnet.cli import app
from garmentnet.data.store import ClipStore
from garmentnet.importing.published import import_published, smplh_skeleton
from helpers.cloth_scenes import tube
from ssdr import MeshSequence
from ssdr.common.errors import FormatError, InputError

FRAMES = 12
PELVIS = smplh_skeleton().rest[0]
REST, FACES = tube(-0.2 - 0.1 * np.arange(4), 0.2)


def clip(seed):
    """The dress turns and walks with the pelvis; the other joints turn as they like."""
    rng = np.random.default_rng(seed)
    pose, trans = rng.normal(0, 0.4, (FRAMES, 52, 3)), rng.normal(0, 1, (FRAMES, 3))
    turn = Rotation.from_rotvec(pose[:, 0]).as_matrix()
    sim = np.einsum("fab,vb->fva", turn, REST - PELVIS) + PELVIS + trans[:, None]
    return {"pose": pose, "trans": trans, "sim_res": sim}


@pytest.fixture
def folder(tmp_path):
    out = tmp_path / "dress02"
    out.mkdir()
    ssdr.save(MeshSequence(REST[None], FACES), out / "template.obj")
    for k in range(11):
        np.savez(out / f"{k}.npz", **clip(k))
    return out


def test_a_store_of_the_layout(folder, tmp_path):
    store = import_published(folder, tmp_path / "new" / "a.clips")
    np.testing.assert_allclose(store.rest, REST, atol=1e-5)
    assert np.array_equal(store.faces, FACES)
    assert (store.names("test"), store.names("validation")) == (("9",), ("8",))
    assert len(store.names("train")) == 9
    made, found = clip(3), store.clip("3")
    np.testing.assert_allclose(found.sequence.frames(slice(None)), made["sim_res"], atol=1e-5)
    # What the root's transforms carry is where the clip has it.
    root = np.asarray(found.joints, float)[:, 0]
    carried = REST @ root[:, :, :3].swapaxes(1, 2) + root[:, None, :, 3]
    np.testing.assert_allclose(carried, made["sim_res"], atol=1e-5)
    before = (store.path / "clips" / "3" / "zarr.json").stat().st_mtime_ns
    again = import_published(folder, store.path)
    assert (again.path / "clips" / "3" / "zarr.json").stat().st_mtime_ns == before


def test_joints_hang_together_and_turn_relative_to_their_parents(folder, tmp_path):
    skeleton = smplh_skeleton()
    assert (skeleton.n_joints, len(set(skeleton.names))) == (52, 52)
    made = clip(3)
    m = np.asarray(import_published(folder, tmp_path / "a.clips").clip("3").joints, float)
    heads = skeleton.positions(m)
    np.testing.assert_allclose(heads[:, 0], PELVIS + made["trans"], atol=1e-5)
    for j, p in enumerate(skeleton.parents):
        if p >= 0:
            carried = m[:, p, :, :3] @ skeleton.rest[j] + m[:, p, :, 3]
            np.testing.assert_allclose(heads[:, j], carried, atol=1e-5)
            own = m[:, p, :, :3].swapaxes(1, 2) @ m[:, j, :, :3]
            turn = Rotation.from_rotvec(made["pose"][:, j]).as_matrix()
            np.testing.assert_allclose(own, turn, atol=1e-5)


def test_the_command_and_what_is_refused(folder, tmp_path):
    words = ["import", "--data", str(folder), "-o", str(tmp_path / "b.clips"), "--test", "2"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert ClipStore.open(tmp_path / "b.clips").names("test") == ("2",)
    beside = CliRunner().invoke(app, [*words, "--cloth", "a.abc"]).exception
    assert "--data" in str(beside)
    with pytest.raises(InputError, match=r"template\.obj"):
        import_published(tmp_path, tmp_path / "c.clips")
    with pytest.raises(InputError, match="expected some of 0, 1"):
        import_published(folder, tmp_path / "c.clips", test=["77"])
    short = clip(0) | {"trans": np.zeros((3, 3))}
    np.savez(folder / "0.npz", **short)
    with pytest.raises(InputError, match=r"trans of 0\.npz: expected shape \(12, 3\)"):
        import_published(folder, tmp_path / "c.clips")
    np.savez(folder / "0.npz", pose=short["pose"])
    with pytest.raises(FormatError, match=r"0\.npz"):
        import_published(folder, tmp_path / "c.clips")
