"""Files that are cut off, flipped, mislabelled or made to do harm are refused in words."""

from __future__ import annotations

import dataclasses
import pickle
import re

import numpy as np
import pytest

import ssdr
from helpers.rig_model import tube
from ssdr import FormatError
from ssdr.io import read_weights


def make(name, folder, wave, seam, skinned):
    """Write a valid file of a kind; its path and a function that reads all of it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    read = ssdr.load
    kind = re.split(r"[_.]", name)[0]
    if kind == "sequence":
        ssdr.save(wave, path, compress="packed" in name)
    elif kind == "skinning":
        surface = ssdr.Surface(materials=seam.surface.materials)
        ssdr.save(dataclasses.replace(skinned, surface=surface), path)
        read = ssdr.load_skinning
    elif kind == "surface":
        ssdr.save(seam, path)
    elif kind == "array":
        np.save(path, wave.vertices)

        def read(p):
            return ssdr.load(p, faces=wave.faces)

    elif kind == "cache":
        ssdr.save(wave, path)

        def read(p):
            return ssdr.load(p, faces=wave.faces)

    elif kind == "scene":
        ssdr.save(tube(frames=3, rings=4, sides=4), path)

        def read(p):
            return ssdr.load(p, max_bytes=1 << 24)

    elif kind == "weights":
        ssdr.save(skinned, path)

        def read(p):
            return read_weights(p, n_vertices=12)

    else:
        suffix = path.suffix
        if suffix in (".obj", ".ply"):
            ssdr.save(seam if suffix == ".obj" else wave, folder / f"mesh_%d{suffix}", start=1)
            (folder / f"mesh_4{suffix}").unlink()
        else:
            trimesh = pytest.importorskip("trimesh")
            for k in (1, 2, 3):
                mesh = trimesh.Trimesh(wave.vertices[k], wave.faces, process=False)
                ascii_ = {"file_type": "stl_ascii"} if "text" in name else {}
                mesh.export(folder / f"mesh_{k}{suffix}", **ascii_)
        path = folder / f"mesh_2{suffix}"

        def read(p):
            return ssdr.load(p.parent)

    return path, read


KINDS = [
    "sequence_packed.npz",
    "sequence_stored.npz",
    "surface.npz",
    "skinning.npz",
    "array.npy",
    "scene.glb",
    "cache.pc2",
    "cache.mdd",
    "mesh.obj",
    "mesh.ply",
    "mesh.off",
    "mesh.stl",
    "mesh_text.stl",
    "weights.csv",
]


def numbers(thing):
    """All arrays of a result."""
    values = vars(thing)
    return {k: np.asarray(v) for k, v in values.items() if isinstance(v, np.ndarray)}


def assert_sound(thing):
    arrays = numbers(thing)
    assert arrays
    for array in arrays.values():
        assert np.isfinite(array).all()


@pytest.fixture(params=KINDS)
def valid(request, tmp_path, wave, seam, skinned):
    path, read = make(request.param, tmp_path / "valid", wave, seam, skinned)
    assert_sound(read(path))
    return path, read


def test_truncated_files_are_refused(valid):
    path, read = valid
    whole, expected = path.read_bytes(), numbers(read(path))
    n = len(whole)
    # Text has no length: where its last number loses digits, the sum of the weights has to tell.
    tail, atol = (40, 1e-4) if path.suffix == ".csv" else (12, 0)
    cuts = {0, 1, 3, 7, 20, 33, 81, 90, n // 4, n // 3, n // 2, 3 * n // 4, n - 45, n - 1 - tail}
    for cut in sorted({c for c in cuts if 0 <= c < n - tail}):
        path.write_bytes(whole[:cut])
        with pytest.raises(FormatError, match=path.parent.name):
            read(path)
    # Cut among the last bytes: refused, or nothing of the arrays was lost.
    for cut in range(n - tail, n):
        path.write_bytes(whole[:cut])
        try:
            result = numbers(read(path))
        except FormatError:
            continue
        assert path.suffix in (".obj", ".off", ".ply", ".stl", ".csv")
        for key, array in expected.items():
            np.testing.assert_allclose(result[key], array, rtol=0, atol=atol)


@pytest.mark.filterwarnings("ignore:.*(uneven times|lie between its frames):ssdr.SsdrWarning")
def test_damaged_bytes_give_finite_arrays_or_an_error(valid, rng):
    path, read = valid
    whole = path.read_bytes()
    refused = 0
    for trial in range(200):
        data = bytearray(whole)
        if trial % 4 == 0:  # insert, remove or replace up to 50 bytes
            a, b = sorted(rng.integers(0, len(whole), 2))
            data[a : min(b, a + 50)] = rng.bytes(int(rng.integers(0, 9)))
        else:  # flip bytes, half of the times in the head, where counts and offsets are
            reach = len(data) if trial % 2 else min(len(data), 160)
            for place in rng.integers(0, reach, 1 + trial % 3):
                data[place] = rng.integers(0, 256)
        path.write_bytes(data)
        try:
            assert_sound(read(path))
        except FormatError:
            refused += 1
    assert refused > 0


@pytest.mark.parametrize("suffix", ["npz", "npy", "pc2", "mdd", "obj", "ply", "off", "stl"])
def test_mislabelled_files_say_what_they_look_like(tmp_path, wave, suffix):
    ssdr.save(wave, tmp_path / "right.npz")
    np.save(tmp_path / "right.npy", wave.vertices)
    others = {
        "a zip archive": (tmp_path / "right.npz").read_bytes(),
        "a NumPy .npy array": (tmp_path / "right.npy").read_bytes(),
        "a Python pickle": pickle.dumps({"vertices": [1.0] * 30}),
        "a PNG picture": b"\x89PNG\r\n\x1a\n" + bytes(100),
        "text": b"dear diary, today I was renamed\n" * 4,
        "the file is empty": b"",
    }
    own = {"npz": "a zip archive", "npy": "a NumPy .npy array"}
    for what, data in others.items():
        if own.get(suffix) == what:
            continue
        path = tmp_path / f"wrong.{suffix}"
        path.write_bytes(data)
        option = "faces" if suffix in ("npy", "pc2", "mdd") else None
        with pytest.raises(FormatError, match=rf"wrong\.{suffix}: ") as caught:
            ssdr.load(path, **({option: "none"} if option else {}))
        if suffix != "mdd":  # has no magic number: any bytes are counts that do not fit
            assert what in str(caught.value)


def test_folders_are_not_files(tmp_path):
    for name in ("a.npz", "a.npy", "a.pc2"):
        (tmp_path / name).mkdir()
        with pytest.raises(FormatError, match=name):
            ssdr.load(tmp_path / name)
    (tmp_path / "a.zarr").write_text("")
    pytest.importorskip("zarr")
    with pytest.raises(FormatError, match="not a folder"):
        ssdr.load(tmp_path / "a.zarr")
