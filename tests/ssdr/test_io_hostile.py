"""Files that are cut off, flipped, mislabelled or made to do harm are refused in words."""

from __future__ import annotations

import dataclasses
import io
import pickle
import re
import struct
import zipfile

import numpy as np
import pytest

import ssdr
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
            return ssdr.load(p, mesh=wave.faces)

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
    "cache.pc2",
    "cache.mdd",
    "mesh.obj",
    "mesh.ply",
    "mesh.off",
    "mesh.stl",
    "mesh_text.stl",
    "weights.csv",
    "weights.json",
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
        assert path.suffix in (".obj", ".off", ".ply", ".stl", ".csv", ".json")
        for key, array in expected.items():
            np.testing.assert_allclose(result[key], array, rtol=0, atol=atol)


def test_flipped_bytes_give_finite_arrays_or_an_error(valid, rng):
    path, read = valid
    whole = bytearray(path.read_bytes())
    refused = 0
    for trial in range(150):
        data = bytearray(whole)
        # Half of the flips go to the head, where counts and offsets are.
        reach = len(data) if trial % 2 else min(len(data), 160)
        for place in rng.integers(0, reach, 1 + trial % 3):
            data[place] = rng.integers(0, 256)
        path.write_bytes(data)
        try:
            result = read(path)
        except FormatError:
            refused += 1
        else:
            assert_sound(result)
    assert refused > 0


def test_inserted_and_removed_bytes_give_finite_arrays_or_an_error(valid, rng):
    path, read = valid
    whole = path.read_bytes()
    for _ in range(60):
        a, b = sorted(rng.integers(0, len(whole), 2))
        b = min(b, a + 50)
        extra = rng.bytes(int(rng.integers(0, 9)))
        path.write_bytes(whole[:a] + extra + whole[b:])
        try:
            result = read(path)
        except FormatError:
            continue
        assert_sound(result)


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
        option = {"npy": "faces", "pc2": "mesh", "mdd": "mesh"}.get(suffix)
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


# npz and npy


class Bang:
    def __reduce__(self):
        return (exec, ("raise SystemExit('unpickled')",))


def test_pickles_are_never_read(tmp_path, wave):
    payload = np.array([Bang()], dtype=object)
    np.save(tmp_path / "a.npy", payload, allow_pickle=True)
    with pytest.raises(FormatError, match=r"a\.npy: holds pickled Python objects"):
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


def test_zip_bombs_are_refused_before_they_inflate(tmp_path):
    shape = (1000, 24_000, 3)
    size = 4 * 1000 * 24_000 * 3
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as target:
        target.writestr("faces.npy", FACES)
        with target.open("vertices.npy", "w") as member:
            member.write(npy(shape))
            zeros = bytes(1 << 22)
            for _ in range(size // len(zeros)):
                member.write(zeros)
            member.write(bytes(size % len(zeros)))
    path = tmp_path / "bomb.npz"
    path.write_bytes(bomb.getvalue())
    assert path.stat().st_size < 4 << 20
    with pytest.raises(FormatError, match=r"vertices\.npy inflates \d+-fold to 288000\d+ bytes"):
        ssdr.load(path)
    with pytest.raises(FormatError, match="max_bytes is 1000"):
        ssdr.load(path, max_bytes=1000)


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


def test_missing_keys_are_named(tmp_path, wave, skinned):
    np.savez(tmp_path / "a.npz", verts=wave.vertices, faces=wave.faces)
    with pytest.raises(FormatError, match="no array vertices; it holds verts, faces"):
        ssdr.load(tmp_path / "a.npz")
    ssdr.save(wave, tmp_path / "b.npz")
    with pytest.raises(FormatError, match="no array rest, joints, weights, transforms"):
        ssdr.load_skinning(tmp_path / "b.npz")
    ssdr.save(skinned, tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as source:
        arrays = dict(source)
    arrays["format_version"] = np.int64(2)
    np.savez(tmp_path / "c.npz", **arrays)
    with pytest.raises(FormatError, match="format_version 2; this release reads up to 1"):
        ssdr.load_skinning(tmp_path / "c.npz")


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("vertices", np.full((1, 3, 3), np.nan), "nan at frame 0, vertex 0"),
        ("vertices", np.zeros((3, 3)), r"shape \(3, 3\)"),
        ("vertices", np.zeros((1, 3, 3), dtype="U1"), "real numbers"),
        ("faces", np.array([[0, 1, 3]]), "3 in face 0"),
        ("faces", np.array([[0, 1, -1]]), "-1 in face 0"),
        ("faces", np.array([[0.0, 1, 2]]), "integers"),
        ("fps", np.array([24.0, 25.0]), "one number"),
        ("fps", np.array(-1.0), "a positive number"),
        ("fps", np.array("fast"), "one number"),
        ("name", np.array(3), "one text"),
        ("vertex_map", np.array([5]), "indices from 0 to 2"),
        ("surface_uv", np.zeros((2, 3, 2)), "surface.uv"),
        ("surface_uv", np.full((1, 3, 2), np.inf), "finite numbers"),
        ("materials", np.array("[{"), "damaged"),
        ("materials", np.array('[{"name": "x", "base_color": [1], "evil": 1}]'), "damaged"),
        ("materials", np.array("[" * 5000), "damaged"),
    ],
)
def test_arrays_that_a_sequence_must_not_have_are_refused(tmp_path, key, value, says):
    arrays = {"vertices": np.eye(3)[None], "faces": np.array([[0, 1, 2]]), "fps": 24.0}
    np.savez(tmp_path / "a.npz", **{**arrays, key: value})
    with pytest.raises(FormatError, match=rf"a\.npz: .*{says}"):
        ssdr.load(tmp_path / "a.npz")


# Meshes, caches, tables


@pytest.mark.parametrize(
    "faces", ["f 1 2 4", "f 0 1 2", "f 1 2 -4", "f 1 2", "f 1 2 x", "f 1/1 2 3"]
)
def test_obj_indices_must_exist(tmp_path, faces):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{faces}\n")
    with pytest.raises(FormatError, match=r"a\.obj"):
        ssdr.load(tmp_path / "a.obj")


@pytest.mark.parametrize("vertex", ["v 1 2", "v 1 2 x", "v 1 2 nan", "v 1 2 inf", "v 1 2 1e999"])
def test_obj_vertices_must_be_finite_numbers(tmp_path, vertex):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\n{vertex}\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FormatError, match=r"a\.obj"):
        ssdr.load(tmp_path / "a.obj")


HEAD = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
TAIL = "property float z\nelement face {}\nproperty list {} int vertex_indices\nend_header\n"


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize(
    ("n_vertices", "n_faces", "count"),
    [
        (10**15, 1, "uchar"),
        (3, 10**15, "uchar"),
        (2**70, 1, "int"),
        (0, 1, "uchar"),
        (3, 1, "float"),
    ],
)
def test_ply_counts_are_not_believed(tmp_path, kind, n_vertices, n_faces, count):
    head = HEAD.format(kind, n_vertices) + TAIL.format(n_faces, count)
    body = b"0 0 0 1 0 0 0 1 0 3 0 1 2" if kind == "ascii" else bytes(36) + b"\3" + bytes(12)
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    with pytest.raises(FormatError, match=r"a\.ply"):
        ssdr.load(tmp_path / "a.ply")


def test_ply_lists_are_not_believed(tmp_path):
    head = (HEAD.format("binary_little_endian", 3) + TAIL.format(2, "int")).encode()
    first = struct.pack("<4i", 3, 0, 1, 2)
    for second in (struct.pack("<4i", 2**31 - 1, 0, 1, 2), struct.pack("<4i", -3, 0, 1, 2)):
        for rows in (first + second, second + first):
            (tmp_path / "a.ply").write_bytes(head + bytes(36) + rows)
            with pytest.raises(FormatError, match=r"a\.ply"):
                ssdr.load(tmp_path / "a.ply")


@pytest.mark.parametrize(
    "counts", ["1000000000000 1 0", "3 99999999999 0", "-3 1 0", "3 -1 0", "x"]
)
def test_off_counts_are_not_believed(tmp_path, counts):
    (tmp_path / "a.off").write_text(f"OFF\n{counts}\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(FormatError, match=r"a\.off"):
        ssdr.load(tmp_path / "a.off")


@pytest.mark.parametrize(
    ("points", "samples"),
    [(2**31 - 1, 2**31 - 1), (-1, 4), (0, 4), (4, 0), (13, 4), (12, 5), (11, 4)],
)
def test_cache_counts_are_not_believed(tmp_path, wave, points, samples):
    ssdr.save(wave, tmp_path / "a.pc2")
    data = bytearray((tmp_path / "a.pc2").read_bytes())
    struct.pack_into("<i", data, 16, points)
    struct.pack_into("<i", data, 28, samples)
    (tmp_path / "a.pc2").write_bytes(data)
    ssdr.save(wave, tmp_path / "a.mdd")
    data = bytearray((tmp_path / "a.mdd").read_bytes())
    struct.pack_into(">ii", data, 0, samples, points)
    (tmp_path / "a.mdd").write_bytes(data)
    for name in ("a.pc2", "a.mdd"):
        for mmap in (False, True):
            with pytest.raises(
                FormatError, match=f"{name}: states {samples} samples of {points} p"
            ):
                ssdr.load(tmp_path / name, mesh="none", mmap=mmap)


def test_zarr_shapes_are_not_believed(tmp_path):
    zarr = pytest.importorskip("zarr")
    zarr.create_array(
        store=tmp_path / "a.zarr", shape=(10**9, 10**6, 3), chunks=(1, 10**6, 3), dtype="f4"
    )
    with pytest.raises(FormatError, match="states 12000000000000000 bytes"):
        ssdr.load(tmp_path / "a.zarr", faces="none")
    group = zarr.create_group(store=tmp_path / "b.zarr")
    group.create_array("points", data=np.zeros(3))
    with pytest.raises(FormatError, match="no array vertices; it holds"):
        ssdr.load(tmp_path / "b.zarr")


@pytest.mark.parametrize(
    "rows",
    [
        "",
        "vertex;bone;weight\n0;a;1\n",
        "vertex,bone,weight\n",
        "vertex,bone,weight\n0,a\n",
        "vertex,bone,weight\n0,a,half\n",
        "vertex,bone,weight\n0,a,nan\n",
        "vertex,bone,weight\n0,a,-0.5\n0,b,1.5\n",
        "vertex,bone,weight\n0,a,0.5\n",
        "vertex,bone,weight\n0,a,0.5\n0,a,0.5\n",
        "vertex,bone,weight\n1,a,1\n",
        "vertex,bone,weight\n-1,a,1\n",
        "vertex,bone,weight\n999999999999999999999,a,1\n",
        "vertex,bone,weight\n1e3,a,1\n",
        'vertex,bone,weight\n0,"a,1\n',
    ],
)
def test_tables_of_weights_are_checked(tmp_path, rows):
    (tmp_path / "w.csv").write_text(rows)
    with pytest.raises(FormatError, match=r"w\.csv"):
        read_weights(tmp_path / "w.csv")


TABLE = '{"format": "ssdr-weights", "version": 1, "bones": %s, "joints": %s, "weights": %s}'


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[" * 100_000,
        '{"format": "ssdr-weights", "version": 2}',
        TABLE % ('"ab"', "[[0]]", "[[1]]"),
        TABLE % ('["a"]', "[[1]]", "[[1]]"),
        TABLE % ('["a"]', "[[0.0]]", "[[1]]"),
        TABLE % ('["a"]', "[[0]]", "[[NaN]]"),
        TABLE % ('["a"]', "[[0]]", '[["1"]]'),
        TABLE % ('["a"]', "[[0], []]", "[[1]]"),
        TABLE % ('["a", "a"]', "[[0]]", "[[1]]"),
        TABLE % ("[]", "[]", "[]"),
    ],
)
def test_json_weights_are_checked(tmp_path, text):
    (tmp_path / "w.json").write_text(text)
    with pytest.raises(FormatError, match=r"w\.json"):
        read_weights(tmp_path / "w.json")
