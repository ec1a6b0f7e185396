"""Files that do not fit each other or their store are refused before anything is stored."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from garmentnet.importing.importing import ImportOptions, import_clips
from helpers.walking_rig import FPS, JOINTS, cloth, motion, rig
from ssdr import MeshSequence
from ssdr.common.errors import InputError, SsdrError

FIRST = "cloth: expected the mesh of the first clip, 50 vertices and 80 triangles"
LOWER = JOINTS - [[0, 0, 0], [0, 0.3, 0], [0, 0, 0]]
LEG = np.array(rig().rest)
LEG[6:12] += (JOINTS[1] - LEG[6:12]) * [2, 2, 0]  # half a turn about the joint
SCALED = motion()
SCALED[20:, 2, :, :3] *= 1.5
DOUBLED = np.concatenate([cloth().vertices, cloth().vertices[:, :1]], axis=1)
REFUSED = {
    "rig: expected a skeleton: joints with parents": {
        "new_rig": rig(parents=None, joint_positions=None)
    },
    "joints and parents .* none such: leg_r": {
        "new_rig": rig(bone_names=("hips", "leg_l", "arm_r"))
    },
    "none such: leg_r": {"new_rig": rig(parents=[-1, 0, 1])},
    "bind pose of the first clip, got leg_l 0.": {"new_rig": rig(joint_positions=LOWER)},
    "bind pose of the first clip, got the skin 0.": {
        "new_rig": dataclasses.replace(rig(), rest=LEG)
    },
    "joints that turn and move, got leg_r scaled": {
        "new_rig": rig(SCALED, bone_model="similarity")
    },
    rf"{FIRST}, got 50 and 79 \(other\)": {
        "new_cloth": MeshSequence(cloth().vertices, cloth().faces[:-1], FPS)
    },
    f"{FIRST}, got as many in another order": {
        "new_cloth": MeshSequence(cloth().vertices, cloth().faces[::2].tolist() * 2, FPS)
    },
    f"{FIRST}, got 51 and 80": {"new_cloth": MeshSequence(DOUBLED, cloth().faces, FPS)},
    "a time that cloth and rig have in common, got 60 frames of cloth": {"offset": 2.5},
    "expected some of other, each once, got walk": {"test": ("walk",)},
    "each once, got other": {"test": ("other",), "validation": ("other",)},
    "fps: expected 30": {"fps": 24.0},
    r"other\.npz: expected 30 frames a second, got 25": {
        "new_cloth": dataclasses.replace(cloth(), fps=25.0), "cloth_as": "npz"
    },
}  # fmt: skip


def test_other_skeletons_topologies_and_times_are_refused(pair, files, tmp_path):
    import_clips([files], tmp_path / "a.clips")
    for text, given in REFUSED.items():
        models = {k: v for k, v in given.items() if k in ("new_cloth", "new_rig", "cloth_as")}
        options = ImportOptions(**{k: v for k, v in given.items() if k not in models})
        with pytest.raises(InputError, match=text):
            import_clips([pair("other", **models)], tmp_path / "a.clips", options)
    with pytest.raises(InputError, match="different names"):
        import_clips([files, files], tmp_path / "b.clips")
    ssdr.save(MeshSequence(cloth().vertices[:1], cloth().faces[:-1]), tmp_path / "cut.npz")
    with pytest.raises(InputError, match="rest: expected the mesh of the first clip"):
        import_clips([files], tmp_path / "b.clips", rest=tmp_path / "cut.npz")
    assert not (tmp_path / "b.clips").exists()


def test_a_garment_at_rest_is_on_the_body_and_that_of_the_store(pair, files, tmp_path):
    cut = MeshSequence(cloth().vertices[:1], cloth().faces, FPS)
    ssdr.save(cut, tmp_path / "cut.npz")
    for factor, text in ((100, "a garment on the body"), (1.01, "that the store has")):
        ssdr.save(dataclasses.replace(cut, vertices=cut.vertices * factor), tmp_path / "other.npz")
        with pytest.raises(InputError, match=f"rest: expected .*{text}"):
            import_clips([files], tmp_path / "a.clips", rest=tmp_path / "other.npz")
        import_clips([files], tmp_path / "a.clips", rest=tmp_path / "cut.npz")
    again = import_clips([pair("run")], tmp_path / "a.clips", rest=tmp_path / "cut.npz")
    assert len(again.names()) == 2


def test_the_output_is_checked_before_anything_is_read(files, tmp_path):
    store = import_clips([files], tmp_path / "new" / "deeper" / "a.clips")
    assert store.path.parent.name == "deeper"
    (tmp_path / "file").write_text("in the way")
    missing = tmp_path / "not there.usda", tmp_path / "nor there.glb"
    with pytest.raises((InputError, SsdrError), match="file"):
        import_clips([missing], tmp_path / "file" / "a.clips")
