"""FBX of Maya, MotionBuilder and Blender beside what these showed, and damaged files."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.fbx_text import FbxText

pytest.importorskip("ufbx", reason="ufbx is not installed")

MAYA = "maya_game_sausage"
# a file, what the names of the .obj beside it begin with, units in a metre, and the frame of each
SHOWN = [
    ("blender440_shape_weight_anim_7400_binary", "blender440_shape_weight_anim", 1, (5, 15, 25), 0),
    (f"{MAYA}_6100_binary_deform", f"{MAYA}_deform", 100, (8, 15), 0),
    (f"{MAYA}_7500_ascii_deform", f"{MAYA}_deform", 100, (8, 15), 0),
    (f"{MAYA}_7500_binary_deform", f"{MAYA}_deform", 100, (8, 15), 0),
    (f"{MAYA}_7500_binary_spin", f"{MAYA}_spin", 100, (7, 15), 0),
    (f"{MAYA}_7500_binary_wiggle", f"{MAYA}_wiggle", 100, (10, 18), 1),
    ("motionbuilder_sausage_rrss_7700_binary", "motionbuilder_sausage_rrss", 100, (12, 24, 48), 0),
]


@pytest.mark.parametrize(("name", "stem", "units", "frames", "first"), SHOWN)
def test_vertices_are_where_the_program_had_them(data_dir, name, stem, units, frames, first):
    """Also versions 6100 and ASCII, weights of shapes, and MotionBuilder's scales of segments."""
    path = data_dir / "fbx" / f"{name}.fbx"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    seen, model = ssdr.load(path), ssdr.load_skinning(path)
    np.testing.assert_allclose(model.skin(), seen.vertices, atol=1e-6 * seen.diagonal())
    for frame in frames:
        lines = (data_dir / "fbx" / f"{stem}_{frame}.obj").read_text("latin-1").splitlines()
        truth = np.array([line.split()[1:4] for line in lines if line[:2] == "v "], dtype=float)
        off = np.linalg.norm(units * seen.vertices[frame - first] - truth, axis=1).max()
        assert off < 5e-7 * np.linalg.norm(np.ptp(truth, axis=0))


def test_files_that_bind_scales_shapes_and_caches(data_dir):
    """How many frames, vertices and bones there are; 0 bones: no skinning holds the motion."""
    folder, sizes = data_dir / "fbx", {}
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    for name in ("blend_inbetween", "cache_sine", "lod_group", "transformed_skin", "zero_end"):
        (path,) = folder.glob(f"maya_{name}_*.fbx")
        seen = ssdr.load(path)
        try:
            bones = getattr(model := ssdr.load_skinning(path), "skinning", model).n_bones
        except ssdr.FormatError as error:
            assert "geometry cache" in str(error)  # noqa: PT017
            bones = 0
        sizes[name] = len(seen), seen.n_vertices, bones
    assert sizes == {
        "blend_inbetween": (120, 26, 1),
        "cache_sine": (30, 72, 0),
        "lod_group": (1, 76, 2),
        "transformed_skin": (21, 20, 3),
        "zero_end": (1, 8, 1),
    }
    path = data_dir.parent / "cases" / "segment_scale.fbx"
    if path.is_file():  # in centimetres 0.6 wide, however the joint below swells
        frames = ssdr.load(path).vertices
        tops = [frame[frame[:, 1] > frame[:, 1].max() - 1e-3] for frame in frames]
        np.testing.assert_allclose([np.ptp(top[:, 0]) for top in tops], 0.006, atol=1e-6)


def damaged(content: bytes, seed: int) -> bytes:
    """Bits flipped, the end cut off, a count changed, or a block lost."""
    rng, data, n = np.random.default_rng([seed, 7]), bytearray(content), len(content)
    at = int(rng.integers(27, n - 4))
    if seed % 4 == 0:
        for place in rng.integers(27, n, 1 + seed % 3):
            data[place] ^= 1 << int(rng.integers(8))
    elif seed % 4 == 1:
        del data[at:]
    elif seed % 4 == 2 and data[:1] == b"K":
        data[at : at + 4] = int(rng.choice([0, 1, 2**31 - 1, 2**32 - 1])).to_bytes(4, "little")
    elif seed % 4 == 2:
        digits = [k for k, byte in enumerate(data) if chr(byte).isdigit()]
        data[digits[int(rng.integers(len(digits)))]] = ord("0") + seed % 10
    else:
        del data[at : at + 200]
    return bytes(data)


def check_damaged(path, content, seeds):
    """Each is refused as a file, or read as numbers that are finite, with corners that exist."""
    refused = 0
    for seed in seeds:
        path.write_bytes(damaged(content, seed))
        try:
            found = ssdr.load(path, max_bytes=1 << 28)
        except ssdr.FormatError as error:
            assert str(path) in str(error)  # noqa: PT017
            refused += 1
            continue
        assert seed % 4 != 1, "read without its end"
        assert np.isfinite(found.vertices).all()
        assert not len(found.faces) or found.faces.max() < found.n_vertices
    return refused


def test_damaged_text_is_refused_or_finite(tmp_path):
    file = FbxText()
    node = file.node("sheet")
    mesh = file.mesh(node, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]])
    joint = file.node("joint", kind="LimbNode")
    file.skin(mesh, {joint: ([0, 1, 2, 3], np.ones(4), np.eye(4))})
    file.stack("go", 0, 1, {(joint, "Lcl Translation", "X"): [(0, 0), (1, 1)]})
    assert check_damaged(tmp_path / "a.fbx", file.text().encode(), range(20)) > 10


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        f"{MAYA}_7500_binary_deform",
        f"{MAYA}_6100_binary_deform",
        f"{MAYA}_7500_ascii_deform",
        "maya_blend_inbetween_7500_binary",
        "motionbuilder_sausage_rrss_7700_binary",
    ],
)
@pytest.mark.filterwarnings("ignore::ssdr.SsdrWarning")  # of keys that a changed bit has moved
def test_damaged_files_are_refused_or_finite(tmp_path, data_dir, name):
    path = data_dir / "fbx" / f"{name}.fbx"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    assert check_damaged(tmp_path / "a.fbx", path.read_bytes(), range(16)) > 5
