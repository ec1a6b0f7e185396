"""Damaged and hostile files, one table by format: how each is made, and what is said of it."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

import ssdr
from helpers.glb import rebuild
from helpers.gltf_asset import make_asset
from helpers.rig_model import tube
from helpers.rig_tree import creature
from ssdr import FormatError, InputError
from ssdr.io.file_errors import MOST_BYTES, afford

FOREIGN = re.compile(
    r"Traceback|at line \d+ in file|not iterable|subscriptable|pxrInternal|File \""
)
OPTIONS = {suffix: {"faces": "none"} for suffix in ("npy", "pc2", "mdd", "zarr")}
needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders here")
TABLE = {}
"""Suffix, function that makes a file, text of the error and functions that read, by case."""


def refused(suffix, make, cases, *readers):
    """Add cases of a format: arguments of `make` after the path, and the text, by what is wrong."""
    for what, (given, says) in cases.items():
        TABLE[f"{suffix}: {what}"] = suffix, make, given, says, readers or (ssdr.load,)


def raw(path, data):
    path.write_bytes(data.encode() if isinstance(data, str) else data)


# --- glTF ----------------------------------------------------------------------------------------


def put(section, index, **fields):
    return lambda document, _: document[section][index].update(fields)


def top(**fields):
    return lambda document, _: document.update(fields)


def overwritten(number_of, replacement):
    """Bytes of the view of an accessor."""

    def change(document, binary):
        primitive = document["meshes"][0]["primitives"][0]
        accessor = document["accessors"][number_of(primitive)]
        start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        binary[start : start + len(replacement)] = replacement

    return change


def without_data(document, _):
    positions = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    huge = {"componentType": 5126, "type": "VEC3", "count": 80_000_000}
    document["accessors"][positions] = huge


def last_key(document, binary):
    accessor = document["accessors"][document["animations"][0]["samplers"][0]["input"]]
    stop = document["bufferViews"][accessor["bufferView"]]["byteOffset"] + 4 * accessor["count"]
    binary[stop - 4 : stop] = np.float32(3e7).tobytes()
    del document["animations"][0]["extras"]


def nested(document, _):
    """2,000 nodes that hang on each other, the first of which moves over 9,600 frames."""
    nodes, animation = document["nodes"], document["animations"][0]
    first = len(nodes)
    nodes += [{"children": [first + k + 1]} for k in range(2000)] + [{"mesh": 0}]
    document["scenes"][0]["nodes"].append(first)
    animation["channels"].append({"sampler": 0, "target": {"node": first, "path": "translation"}})
    animation["extras"]["ssdr"]["frames"] = 9600


def beside(document, binary):
    """The same nodes, each of which holds the mesh and moves for itself."""
    nested(document, binary)
    nodes, animation = document["nodes"], document["animations"][0]
    first = len(nodes) - 2001
    document["scenes"][0]["nodes"] += range(first + 1, first + 2001)
    for k in range(first, first + 2001):
        nodes[k] = {"mesh": 0}
        target = {"node": k, "path": "translation"}
        animation["channels"].append({"sampler": 0, "target": target})


def stated(**clip):
    return put("animations", 0, extras={"ssdr": {"fps": 24, **clip}})


def glb(path, change):
    ssdr.save(tube(frames=3), path.with_name("whole.glb"))
    rebuild(path.with_name("whole.glb"), path, change)


JOINTS, INDICES = (lambda p: p["attributes"]["JOINTS_0"]), (lambda p: p["indices"])
GLB = {
    "a joint beyond the skin": (overwritten(JOINTS, b"\xfa"), "joint 250 of a skin of 5"),
    "an index beyond the vertices": (overwritten(INDICES, b"\xfe\xff"), "index 65534 into"),
    "NaN": (overwritten(lambda p: 0, np.float32(np.nan).tobytes()), "NaN or Inf"),
    "a count beyond the data": (put("accessors", 0, count=10**4), "do not fit"),
    "a huge count": (put("accessors", 0, count=10**12), r"elements needs 2400000000\d+ bytes"),
    "80 million vertices without data": (without_data, "POSITION of 80000000 elements"),
    "frames without data": (stated(frames=200_000_000), "200000000 frames at 24 per second needs"),
    "frames without end": (stated(frames=10**12), "max_bytes"),
    "times beyond float64": (
        stated(fps=1e-308, frames=100), "100 frames at 1e-308 per second from"),
    "a last key after a year": (last_key, "720000001 frames at 24 per second needs"),
    "nested nodes over many frames": (nested, "nodes over 9600 frames needs"),
    "nodes beside each other over many frames": (beside, "nodes over 9600 frames needs"),
    "a negative offset": (
        put("bufferViews", 0, byteOffset=-4), "byteOffset of bufferView 0 is -4"),
    "an offset that is text": (put("bufferViews", 0, byteOffset="4"), "byteOffset .* is '4'"),
    "a view beyond the buffer": (put("bufferViews", 0, byteLength=10**9), "ends at byte"),
    "a cycle": (put("nodes", 2, children=[1]), "its own ancestor"),
    "two parents": (put("nodes", 0, children=[3]), "two parents"),
    "a missing joint": (put("skins", 0, joints=[999]), "none of the 7 nodes"),
    "no joints": (put("skins", 0, joints=[]), "no joints"),
    "a missing mesh": (put("nodes", 0, mesh=7), "mesh 7 is none of the 1 meshes"),
    "a bool for an index": (put("nodes", 0, mesh=True), "mesh True is none of"),
    "nodes that are no list": (top(nodes=3), "nodes is not a list"),
    "a node that is no object": (
        lambda d, _: d["nodes"].__setitem__(0, 3), "nodes is not a list of objects"),
    "an unknown extension": (
        top(extensionsRequired=["KHR_texture_basisu"]), "requires KHR_texture_basisu"),
    "version 1": (top(asset={"version": "1.0"}), "version 1.0"),
    "no mesh": (lambda d, _: d["nodes"][0].pop("mesh"), "holds no mesh"),
    "keys of another kind": (
        lambda d, _: d["animations"][0]["samplers"][0].update(input=0), "key times is 'VEC3'"),
    "a lazy buffer": (put("buffers", 0, byteLength=10**9), "states 1000000000"),
    "an escape": (put("buffers", 0, uri="../../etc/passwd"), "outside"),
    "a web address": (put("buffers", 0, uri="http://x/y"), "outside"),
    "a bad data URI": (put("buffers", 0, uri="data:;base64,???"), "data URI"),
}  # fmt: skip
refused("glb", glb, GLB, ssdr.load, ssdr.load_skinning)


def gltf(path, fields):
    raw(path, json.dumps({"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}]} | fields))


KIND = "an entry holds another kind of value"
GLTF = {
    "no attributes": ({"meshes": [{"primitives": [{}]}]}, "it has no 'attributes'"),
    "no primitives": ({"meshes": [{}]}, "it has no 'primitives'"),
    "a number for a list": ({"meshes": [{"primitives": 3}]}, KIND),
    "a text for nodes": ({"meshes": [{}], "nodes": [{"mesh": 0, "children": "ab"}]}, KIND),
}
refused("gltf", gltf, GLTF, ssdr.load, ssdr.load_skinning)


def with_number(path, number):
    raw(path, make_asset(path).read_text().replace("0.7", number, 1))


NUMBERS = {number[:9]: (number, "bad") for number in ("1e999", "-1e999", "NaN", "9" * 5000)}
refused("gltf", with_number, NUMBERS, ssdr.load, ssdr.list_clips)
OTHERS = {"a zip": b"PK\x03\x04" * 20, "brackets": b"[" * 100_000, "{}": b"{}", "255": b"\xff" * 64}
for _suffix in ("glb", "gltf"):
    refused(_suffix, raw, {what: (data, "bad") for what, data in OTHERS.items()})

# --- archives of arrays --------------------------------------------------------------------------


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
refused("npz", npz, NPZ)
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
        ("rest", None, "no array rest"),
    ])
}  # fmt: skip
refused("npz", skinned_npz, SKINNED, ssdr.load_skinning)


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


def mapped(path, **options):
    return ssdr.load(path, mmap=True, **options)


refused("npz", forged_npz, FORGED)
refused("npy", raw, FORGED, ssdr.load, mapped)
PICKLE = np.array([Bang()], dtype=object)
refused("npy", np.save, {"a pickle": (PICKLE, "the array holds pickled Python objects")})


def directory_size(path, lie):
    """The size in the zip's directory is what is checked; what inflates may be more."""
    npz(path, {})
    data = bytearray(path.read_bytes())
    entry = data.index(b"PK\x01\x02")
    true = struct.unpack_from("<I", data, entry + 24)[0]
    struct.pack_into("<I", data, entry + 24, lie if lie > 100 else true + lie)
    raw(path, data)


refused("npz", directory_size, {f"size {lie}": (lie, "bad") for lie in (-4, 4, 2000, 2**31)})


def two_members(path, _):
    npz(path, {})
    with zipfile.ZipFile(path, "a") as target, pytest.warns(UserWarning, match="Dup"):
        target.writestr("faces.npy", FACES)


refused("npz", two_members, {"twice": (None, "two members are called 'faces'")})


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
refused("npz", bomb, {"a bomb": (1, BOMB), "a bomb in parts": (5, BOMB)})


def baked(path, n):
    """A file of 1 MiB stated 20 GB of vertices."""
    still = ssdr.Skinning(
        np.zeros((n, 3), dtype=np.float32), np.zeros((n, 1), dtype=np.int32),
        np.ones((n, 1), dtype=np.float32), np.tile(np.eye(3, 4), (n, 1, 1, 1)),
    )  # fmt: skip
    assert ssdr.save(still, path).bytes < 1 << 20


BAKED = "baking 40000 frames of 40000 vertices needs 192000"
refused("npz", baked, {"many frames of many vertices": (40_000, BAKED)})

# --- text, meshes and point caches ---------------------------------------------------------------

OBJ = [
    *("f 1 2 4", "f 0 1 2", "f 1 2 -4", "f 1 2", "f 1 2 x", "f 1/1 2 3"),
    *("v 1 2", "v 1 2 x", "v 1 2 nan", "v 1 2 inf", "v 1 2 1e999"),
]
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n{}\nf 1 2 3\n"
refused("obj", raw, {line: (TRIANGLE.format(line), "bad") for line in OBJ})


def ply_head(kind, n_vertices, n_faces, count="uchar", number="int"):
    return (
        f"ply\nformat {kind} 1.0\nelement vertex {n_vertices}\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {n_faces}\n"
        f"property list {count} {number} vertex_indices\nend_header\n"
    ).encode()


POINTS = b"0 0 0 1 0 0 0 1 0 "
BODIES = {"ascii": POINTS + b"3 0 1 2", "binary_little_endian": bytes(36) + b"\3" + bytes(12)}
COUNTS = [(10**15, 1, "uchar"), (3, 10**15, "uchar"), (2**70, 1, "int"), (0, 1, "uchar")]
COUNTS += [(3, 1, "float")]
for _kind, _body in BODIES.items():
    _cases = {f"{_kind} {c}": (ply_head(_kind, *c) + _body, "bad") for c in COUNTS}
    refused("ply", raw, _cases)
for _corner in (0.5, np.nan, 1e300):
    _data = ply_head("ascii", 3, 1, number="double") + POINTS + f"3 0 1 {_corner}".encode()
    refused("ply", raw, {str(_corner): (_data, "the faces are not lists of integers")})
for _length in (2**31 - 1, -3):
    for _step in (1, -1):
        _rows = [struct.pack("<4i", n, 0, 1, 2) for n in (3, _length)][::_step]
        _data = ply_head("binary_little_endian", 3, 2, "int") + bytes(36) + b"".join(_rows)
        refused("ply", raw, {f"a list of {_length} {_step}": (_data, "bad")})
# trimesh leaves out the rows
for _rows in ("3 0 1 2 3 0 1", "3 0 1 2", "3.5 0 1 2 3 0 1 2", "nan 0 1 2"):
    _data = ply_head("ascii", 3, 2) + POINTS + _rows.encode()
    refused("ply", raw, {f"cut {_rows}": (_data, "bad")})

SAMPLES = [(2**31 - 1, 2**31 - 1), (-1, 4), (0, 4), (4, 0), (13, 4), (12, 5), (11, 4)]
for _points, _samples in SAMPLES:  # of 4 samples of 12 points
    _says = f"states {_samples} samples of {_points} p"
    _head = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, _points, 0.0, 1.0, _samples)
    _case = {f"{_samples} of {_points}": (_head + bytes(4 * 12 * 12), _says)}
    refused("pc2", raw, _case, ssdr.load, mapped)
    _head = struct.pack(">ii4f", _samples, _points, 0, 1, 2, 3)
    _case = {f"{_samples} of {_points}": (_head + bytes(4 * 12 * 12), _says)}
    refused("mdd", raw, _case, ssdr.load, mapped)

# --- zarr ----------------------------------------------------------------------------------------


def zstd(*frames):
    """Frames of zeros, each as (bytes, bytes that its header states), in blocks of one byte."""
    data = b""
    for size, said in frames:
        blocks, rest = divmod(size, 1 << 17)
        heads = [(1 << 17) << 3 | 2] * blocks + [rest << 3 | 3]
        data += struct.pack("<IBBQ", 0xFD2FB528, 0xC0, 0x38, said)
        data += b"".join(struct.pack("<I", head)[:3] + b"\0" for head in heads)
    return data


def zarr_chunk(path, chunk):
    """A store of the shape (2, 3, 3), whose chunk took 3 GB."""
    zarr = pytest.importorskip("zarr")
    zarr.create_array(path, shape=(2, 3, 3), chunks=(2, 3, 3), dtype="f4")
    (path / "c" / "0" / "0").mkdir(parents=True)
    (path / "c" / "0" / "0" / "0").write_bytes(chunk)


G3 = 3_000_000_000
CHUNKS = {
    "cut": (zstd((72, 72))[:-2], "bad"),
    "bomb": (zstd((G3, G3)), "3000000000 bytes, inflated 32761-fold"),
    "second": (zstd((72, 72), (G3, G3)), "3000000072 bytes, inflated"),
    "more": (zstd((G3, 72)), "bad"),
    "less": (zstd((72, G3)), "3000000000 bytes, inflated"),
    "text": (b"nonsense", "no zstd frame"),
    "empty": (b"", "bad"),
}
refused("zarr", zarr_chunk, CHUNKS)


def zarr_shape(path, made):
    step, chunk = made
    zarr = pytest.importorskip("zarr")
    shape = {"shape": (10**9, 2, 3), "chunks": (step, 2, 3)}
    zarr.create_array(path, dtype="f4", compressors=None, **shape)
    if chunk:
        (path / "c" / "0" / "0").mkdir(parents=True)
        (path / "c" / "0" / "0" / "0").write_bytes(chunk)


MISSING = r"holds 0 of \d+ chunks of the shape \(1000000000,"
LARGE = "a chunk needs 24000000000 bytes, above the limit of"
LARGEST = {"a": ((1, b""), MISSING), "b": ((10**9, b""), MISSING), "c": ((10**9, b"few"), LARGE)}
refused("zarr", zarr_shape, LARGEST)


def zarr_codec(path, kind):
    zarr = pytest.importorskip("zarr")
    codecs = pytest.importorskip("zarr.codecs")
    options = {
        "gzip": {"compressors": codecs.GzipCodec()},
        "shards": {"shards": (4, 2, 3)},
        "two codecs": {"compressors": [codecs.ZstdCodec(), codecs.BloscCodec()]},
    }
    data = np.zeros((4, 2, 3), np.float32)
    zarr.create_array(path, data=data, chunks=(2, 2, 3), **options[kind])


KNOWN = "whole chunks by zstd or Blosc are read"
refused("zarr", zarr_codec, {kind: (kind, KNOWN) for kind in ("gzip", "shards", "two codecs")})


def zarr_group(path, _):
    group = pytest.importorskip("zarr").create_group(store=path)
    group.create_array("points", data=np.zeros(3))


refused("zarr", zarr_group, {"no vertices": (None, "no array vertices; it holds")})


def zarr_trap(path, trap):
    """A pipe was waited for, an endless device read until memory ended."""
    pytest.importorskip("zarr")
    place, kind = trap
    ssdr.save(ssdr.MeshSequence(np.zeros((4, 3, 3)), [[0, 1, 2]]), path)
    inside = path / place
    inside.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(inside)
    else:
        inside.symlink_to("/dev/zero" if kind == "device" else path.parent)


TRAPS = [
    (place, kind)
    for place in ("zarr.json", "vertices/zarr.json", "vertices/c/0/0/0", "x")
    for kind in ("pipe", "device", "folder")
]
IS_TRAP = "a device, a pipe or a socket|a link to a folder"
refused("zarr", zarr_trap, {" ".join(trap): (trap, IS_TRAP) for trap in TRAPS})

# --- USD -----------------------------------------------------------------------------------------

refused("usda", lambda path, text: raw(path, f"#usda 1.0\n{text}"), {
    "cut off": ('def Xform "a" {', r"\(USD says: 2:16: Expected }"),
    "a wrong tuple": ('def Mesh "a" { point3f[] points = [(0,0)] }', "USD says: .*Tuple dim"),
    "a missing layer": ("( subLayers = [@./gone.usda@] )", "refers to gone.usda, which is missing"),
})  # fmt: skip
refused("usda", raw, {"no USD": ("hello\n", "not a USD file|USD says")})


def referring(path, _):
    raw(path.with_name("a.usd"), "hello\n")
    raw(path, "#usda 1.0\n( subLayers = [@./a.usd@] )")


refused("usda", referring, {"no layer": (None, "refers to a.usd, which is no USD file")})

# usd-core ends the process, whatever hides the closing brackets from a naive count
DEEP = [
    ("dictionary a = {\n", "}\n"),
    ('def Xform "a" {\n', "}\n"),
    ("double b = (", ")"),
    ('def Xform "a" { # }\n', "}\n"),
    ('def Xform "a" { /* } */\n', "}\n"),
    ('def Xform "a" { string s = "}"\n', "}\n"),
    ('def Xform "a" { string s = """ } " """\n', "}\n"),
    ("def Xform \"a\" { string s = '\\'}'\n", "}\n"),
    ('def Xform "a" { asset s = @}@\n', "}\n"),
    ('def Xform "a" { asset s = @@@}\\@@@}@@@\n', "}\n"),
    ("rel a = <" + "/A.r[", "]"),
]
for _opening, _closing in DEEP:
    _data = "#usda 1.0\n" + _opening * 100_000 + _closing * 100_000
    refused("usda", raw, {f"nested {_opening.strip()}": (_data, r"bad\.usda is nested \d+ deep")})

# --- what is asked of all ------------------------------------------------------------------------


@needs_pipes
@pytest.mark.parametrize("case", TABLE)
def test_the_file_is_refused_in_words(tmp_path, case):
    suffix, make, given, says, readers = TABLE[case]
    if suffix == "usda":
        pytest.importorskip("pxr.UsdSkel")
    path = tmp_path / f"bad.{suffix}"
    make(path, given)
    for read in readers:
        with pytest.raises(FormatError, match=says) as caught:
            read(path, **OPTIONS.get(suffix, {}))
        assert "bad." in str(caught.value)
        assert not FOREIGN.search(str(caught.value))


@pytest.mark.parametrize("change", [nested, beside])
def test_nodes_are_refused_before_they_take_memory(tmp_path, change):
    glb(tmp_path / "bad.glb", change)
    for function in (ssdr.load, ssdr.load_skinning):
        tracemalloc.start()
        try:
            with pytest.raises(FormatError, match="nodes over 9600 frames needs"):
                function(tmp_path / "bad.glb")
            assert tracemalloc.get_traced_memory()[1] < 32 << 20
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize("case", GLB)
def test_a_hostile_template_is_refused(tmp_path, case):
    glb(tmp_path / "bad.glb", GLB[case][0])
    with pytest.raises((FormatError, InputError)):
        ssdr.save(tube(frames=3), tmp_path / "c.gltf", template=tmp_path / "bad.glb")


@pytest.mark.parametrize("depth", [500, 990, 100_000])
def test_json_that_is_nested_deeply_is_read_or_refused(tmp_path, depth):
    source = make_asset(tmp_path / "all.gltf")
    text = source.read_text()
    source.write_text(text[:-1] + ', "deep": ' + '{"extras":' * depth + "1" + "}" * depth + "}")
    with contextlib.suppress(FormatError):
        model = ssdr.load_skinning(source).skinning
        ssdr.save(model, tmp_path / "b.gltf", template=source)


@pytest.mark.parametrize("size", [MOST_BYTES + 1, 10**400, float("inf"), float("nan")])
def test_the_limit_is_said_with_all_that_a_user_needs(tmp_path, size):
    with pytest.raises(FormatError, match=r"a\.glb: 8 frames needs .* limit of 17179869184 .*max_"):
        afford(size, "8 frames", "a.glb")
    afford(MOST_BYTES, "it", "a.glb")
    afford(MOST_BYTES + 1, "it", "a.glb", most=MOST_BYTES + 1)
    bomb(tmp_path / "bomb.npz", 1)
    with pytest.raises(FormatError, match="limit of 1000 "):
        ssdr.load(tmp_path / "bomb.npz", max_bytes=1000)
    with pytest.raises(InputError, match="max_bytes: expected a positive number"):
        ssdr.load(tmp_path / "bomb.npz", max_bytes=0)
