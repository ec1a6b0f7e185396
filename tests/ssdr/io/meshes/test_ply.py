"""PLY."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest

import ssdr


def test_ply_normals_and_texture_coordinates_go_to_corners(tmp_path):
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n"
        "property double z\nproperty float nx\nproperty float ny\nproperty float nz\n"
        "property float s\nproperty float t\nelement face 1\n"
        "property list uchar uint vertex_indices\nend_header\n"
        "0 0 0 0 0 1 0.25 0.5\n1 0 0 0 1 0 0 1\n0 1 0 1 0 0 1 0\n3 2 0 1\n"
    )
    surface = ssdr.load(tmp_path / "a.ply").surface
    np.testing.assert_array_equal(surface.uv, [[[1, 0], [0.25, 0.5], [0, 1]]])
    np.testing.assert_array_equal(surface.normals, [[[1, 0, 0], [0, 0, 1], [0, 1, 0]]])


HEAD = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"


TAIL = "property float z\nelement face {}\nproperty list {} int vertex_indices\nend_header\n"


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_rows_of_any_lengths_are_the_rows_that_were_written(tmp_path, kind):
    """Lists before and after the corners, and numbers between them."""
    rng = np.random.default_rng(3)
    kinds = ("uchar", "short"), ("int", "double"), ("ushort", "int")
    codes = {"uchar": "B", "short": "h", "int": "i", "double": "d", "ushort": "H", "float": "f"}
    head = HEAD.format(kind, 9) + (
        "property float z\ncomment by hand\nelement face 50\nproperty float a\n"
        "property list uchar short b\nproperty list int double c\nproperty uchar d\n"
        "property list ushort int vertex_index\nproperty double e\nend_header\n"
    )
    polygons, words, body = [], [], b""
    order = ">" if "big" in kind else "<"
    for _ in range(50):
        polygons.append(rng.integers(0, 9, rng.integers(3, 7)).tolist())
        lists = rng.integers(-9, 9, rng.integers(0, 4)).tolist(), rng.random(rng.integers(0, 3))
        row = [("float", 0.5)]
        for (count, one), values in zip(kinds, (*lists, polygons[-1]), strict=True):
            row += [("uchar", 7)] if one == "int" else []
            row += [(count, len(values)), *((one, value) for value in values)]
        row += [("double", 0.25)]
        words += [str(value) for _, value in row]
        body += b"".join(struct.pack(order + codes[one], value) for one, value in row)
    points = np.arange(27.0)
    if kind == "ascii":
        body = " ".join([*map(str, points), *words]).encode()
    else:
        body = points.astype(order + "f4").tobytes() + body
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    fans = [[p[0], p[k], p[k + 1]] for p in polygons for k in range(1, len(p) - 1)]
    read = ssdr.load(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.faces, fans)
    np.testing.assert_array_equal(read.vertices[0], points.reshape(9, 3))


def test_ply_rows_take_no_object_each(tmp_path):
    head = HEAD.format("binary_little_endian", 3) + TAIL.format(1, "uchar")
    head = head.replace("end_header", "element more 50000\nproperty list uchar uchar a\nend_header")
    body = bytes(36) + struct.pack("<B3i", 3, 0, 1, 2) + b"\0\1\5\2\5\5" * 16666 + b"\0\0"
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    ssdr.load(tmp_path / "a.ply")
    tracemalloc.start()
    try:
        assert len(ssdr.load(tmp_path / "a.ply").faces) == 1
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 35 * len(body)
