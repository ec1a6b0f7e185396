"""Archives made to do harm: pickles, bombs, sizes that lie."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np
import pytest

import ssdr
from ssdr import FormatError, InputError


class Bang:
    def __reduce__(self):
        return (exec, ("raise SystemExit('unpickled')",))


def test_pickles_are_never_read(tmp_path, wave):
    payload = np.array([Bang()], dtype=object)
    np.save(tmp_path / "a.npy", payload, allow_pickle=True)
    with pytest.raises(FormatError, match=r"a\.npy: the array holds pickled Python objects"):
        ssdr.load(tmp_path / "a.npy", faces="none")
    for key in ("vertices", "faces", "fps", "name", "materials"):
        arrays = {"vertices": wave.vertices, "faces": wave.faces, "fps": 24.0, key: payload}
        np.savez(tmp_path / "a.npz", **arrays)
        with pytest.raises(FormatError, match=rf"{key}\.npy holds pickled Python objects"):
            ssdr.load(tmp_path / "a.npz")


def archive(path, members, *, stored=False):
    with zipfile.ZipFile(path, "w") as target:
        for name, data in members.items():
            kind = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
            target.writestr(name, data, kind)
    return path


def npy(shape, dtype="<f4", data=b""):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": dtype, "fortran_order": False, "shape": shape}
    )
    return stream.getvalue() + data


FACES = npy((1, 3), "<i4", struct.pack("<3i", 0, 1, 2))


@pytest.mark.parametrize(
    "shape", [(10**6, 10**6, 3), (2**62, 4, 3), (0, 4, 3), (-1, 4, 3), (4, 3), (1, 2, 3)]
)
def test_shapes_that_the_data_do_not_fill_are_refused(tmp_path, shape):
    body = npy(shape, data=bytes(3 * 4 * 3 * 4))
    path = archive(tmp_path / "a.npz", {"vertices.npy": body, "faces.npy": FACES})
    with pytest.raises(FormatError, match=r"a\.npz: vertices"):
        ssdr.load(path)
    (tmp_path / "a.npy").write_bytes(body)
    for mmap in (False, True):
        with pytest.raises(FormatError, match=r"a\.npy: "):
            ssdr.load(tmp_path / "a.npy", faces="none", mmap=mmap)


@pytest.mark.parametrize("parts", [1, 5])
def test_zip_bombs_are_refused_before_they_inflate(tmp_path, parts):
    """At once or in arrays of which each alone would pass."""
    size = 280_000_000 // parts
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as target:
        target.writestr("vertices.npy", npy((1, 3, 3), data=bytes(36)))
        target.writestr("faces.npy", FACES)
        for k in range(parts):
            with target.open(f"texture_{k}.npy", "w") as member:
                member.write(npy((size,), "|u1"))
                member.write(bytes(size))
    assert path.stat().st_size < 4 << 20
    with pytest.raises(
        FormatError, match=r"texture_0\.npy.* needs 2800\d+ bytes, inflated \d+-fold"
    ):
        ssdr.load(path)
    with pytest.raises(FormatError, match="limit of 1000 "):
        ssdr.load(path, max_bytes=1000)
    with pytest.raises(InputError, match="max_bytes: expected a positive number"):
        ssdr.load(path, max_bytes=0)


def test_stated_sizes_that_lie_are_refused(tmp_path, wave):
    """The size in the zip's directory is what is checked; what inflates may be more."""
    ssdr.save(wave, tmp_path / "a.npz")
    data = bytearray((tmp_path / "a.npz").read_bytes())
    entry = data.index(b"PK\x01\x02")
    true = struct.unpack_from("<I", data, entry + 24)[0]
    for lie in (true - 4, true + 4, 200, 2**31):
        struct.pack_into("<I", data, entry + 24, lie)
        (tmp_path / "b.npz").write_bytes(data)
        with pytest.raises(FormatError, match=r"b\.npz"):
            ssdr.load(tmp_path / "b.npz")


def test_two_members_of_one_name_are_refused(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.npz")
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as target, pytest.warns(UserWarning, match="Dup"):
        target.writestr("faces.npy", FACES)
    with pytest.raises(FormatError, match="two members are called 'faces'"):
        ssdr.load(tmp_path / "a.npz")
