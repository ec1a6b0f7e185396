"""Damaged and hostile archives and arrays are refused in words."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np
import pytest

import ssdr
from helpers.refused import Refused, looks, mapped, raw
from helpers.rig_tree import creature
from ssdr import FormatError
from ssdr.io.file_errors import MOST_BYTES, afford

TABLE = Refused()
TABLE.add("npz", raw, looks("a zip archive"))
TABLE.add("npy", raw, looks("a NumPy .npy array"))


class Bang:
    def __reduce__(self):
        return (exec, ("raise SystemExit('unpickled')",))


def npz(path, arrays):
    whole = {"vertices": np.eye(3)[None], "faces": np.array([[0, 1, 2]]), "fps": 24.0}
    np.savez(path, **{**whole, **arrays})


NPZ = {
    f"{key} {k}": ({key: value}, says)
    for k, (key, value, says) in enumerate([
        ("vertices", np.full((1, 3, 3), np.nan), "nan at frame 0, vertex 0"),
        ("vertices", np.zeros((3, 3)), r"shape \(3, 3\)"),
        ("vertices", np.zeros((1, 3, 3), dtype="U1"), "real numbers"),
        ("faces", np.array([[0, 1, 3]]), "3 in face 0"),
        ("faces", np.array([[0, 1, -1]]), "-1 in face 0"),
        ("faces", np.array([[0.0, 1, 2]]), "integers"),
        ("fps", np.array([24.0, 25.0]), "one number"),
        ("fps", np.array(-1.0), "a positive number"),
        ("materials", np.array("[{"), "damaged"),
        ("materials", np.array('[{"name": "x", "base_color": [1], "evil": 1}]'), "damaged"),
        ("materials", np.array("[" * 5000), "damaged"),
        *((key, np.array([Bang()], dtype=object), rf"{key}\.npy holds pickled Python objects")
          for key in ("vertices", "faces", "fps", "name", "materials")),
    ])
}  # fmt: skip
TABLE.add("npz", npz, NPZ)
CLIPS = (ssdr.Clip("walk", 0, 9, 24.0), ssdr.Clip("jump", 9, 19, 60.0), ssdr.Clip("a", 19, 20, 25))


def skinned_npz(path, change):
    key, value = change
    ssdr.save(creature(frames=20, clips=CLIPS), path)
    with np.load(path) as archive:
        arrays = {k: v for k, v in (dict(archive) | {key: value}).items() if v is not None}
    np.savez(path, **arrays)


SKINNED = {
    f"{key} {k}": ((key, None if value is None else np.array(value)), says)
    for k, (key, value, says) in enumerate([
        ("clip_offsets", [0, 9, 19], "clip_offsets"),
        ("clip_offsets", [0, 9, 19, 21], "clips"),
        ("clip_offsets", [0, 19, 9, 20], "clip"),
        ("clip_offsets", [0.0, 9, 19, 20], "clip_names"),
        ("clip_fps", [24.0, np.nan, 25], "fps"),
        ("clip_fps", [24.0, 60], "bad"),
        ("clip_fps", [30.0, 60, 25], "fps"),
        ("clip_names", "{}", "clip_names"),
        ("clip_names", "[1, 2, 3]", "name"),
        ("clip_names", '["a", "a", "b"]', "name"),
        ("clip_names", "no JSON", "bad"),
        ("parents", [2, 0, 0, 0, 2, -1, 4], "parents"),
        ("parents", [0, 0, 0], "parents"),
        ("parents", None, "parents"),
        ("rest", None, "no array rest; it holds"),
        ("format_version", 1, "format_version 1; this release reads 2 to 3"),
        ("format_version", 4, "format_version 4; this release reads 2 to 3"),
    ])
}  # fmt: skip
TABLE.add("npz", skinned_npz, SKINNED, ssdr.load_skinning)


def npy_bytes(shape, dtype="<f4", data=b""):
    stream = io.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + data


FACES = npy_bytes((1, 3), "<i4", struct.pack("<3i", 0, 1, 2))
SHAPES = [(10**6, 10**6, 3), (2**62, 4, 3), (0, 4, 3), (-1, 4, 3), (4, 3), (1, 2, 3)]
FORGED = {str(shape): (npy_bytes(shape, data=bytes(3 * 4 * 3 * 4)), "bad") for shape in SHAPES}


def forged_npz(path, vertices):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        target.writestr("vertices.npy", vertices)
        target.writestr("faces.npy", FACES)


TABLE.add("npz", forged_npz, FORGED)
TABLE.add("npy", raw, FORGED, ssdr.load, mapped)
PICKLE = np.array([Bang()], dtype=object)
TABLE.add("npy", np.save, {"a pickle": (PICKLE, "the array holds pickled Python objects")})


def directory_size(path, lie):
    """The size in the zip's directory is what is checked; what inflates may be more."""
    npz(path, {})
    data = bytearray(path.read_bytes())
    entry = data.index(b"PK\x01\x02")
    true = struct.unpack_from("<I", data, entry + 24)[0]
    struct.pack_into("<I", data, entry + 24, lie if lie > 100 else true + lie)
    raw(path, data)


TABLE.add("npz", directory_size, {f"size {lie}": (lie, "bad") for lie in (-4, 4, 2000, 2**31)})


def two_members(path, _):
    npz(path, {})
    with zipfile.ZipFile(path, "a") as target, pytest.warns(UserWarning, match="Dup"):
        target.writestr("faces.npy", FACES)


TABLE.add("npz", two_members, {"twice": (None, "two members are called 'faces'")})


def bomb(path, parts):
    """At once or in arrays of which each alone would pass."""
    size = 280_000_000 // parts
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as target:
        target.writestr("vertices.npy", npy_bytes((1, 3, 3), data=bytes(36)))
        target.writestr("faces.npy", FACES)
        for k in range(parts):
            with target.open(f"texture_{k}.npy", "w") as member:
                member.write(npy_bytes((size,), "|u1"))
                member.write(bytes(size))
    assert path.stat().st_size < 4 << 20


BOMB = r"texture_0\.npy.* needs 2800\d+ bytes, inflated \d+-fold"
TABLE.add("npz", bomb, {"a bomb": (1, BOMB), "a bomb in parts": (5, BOMB)})


def baked(path, n):
    """A file of 1 MiB stated 20 GB of vertices."""
    still = ssdr.Skinning(
        np.zeros((n, 3), dtype=np.float32), np.zeros((n, 1), dtype=np.int32),
        np.ones((n, 1), dtype=np.float32), np.tile(np.eye(3, 4), (n, 1, 1, 1)),
    )  # fmt: skip
    assert ssdr.save(still, path).bytes < 1 << 20


BAKED = "baking 40000 frames of 40000 vertices needs 192000"
TABLE.add("npz", baked, {"many frames of many vertices": (40_000, BAKED)})


@pytest.mark.parametrize("case", TABLE)
def test_the_file_is_refused_in_words(tmp_path, case):
    TABLE.check(case, tmp_path)


@pytest.mark.parametrize("size", [MOST_BYTES + 1, 10**400, float("inf"), float("nan")])
def test_the_limit_is_said_with_all_that_a_user_needs(size):
    with pytest.raises(FormatError, match=r"a\.glb: 8 frames needs .* limit of 17179869184 .*max_"):
        afford(size, "8 frames", "a.glb")
    afford(MOST_BYTES, "it", "a.glb")
    afford(MOST_BYTES + 1, "it", "a.glb", most=MOST_BYTES + 1)


def test_the_limit_can_be_lowered(tmp_path):
    npz(tmp_path / "a.npz", {})
    with pytest.raises(FormatError, match="limit of 20 "):
        ssdr.load(tmp_path / "a.npz", max_bytes=20)
