"""Polygons are cut into triangles."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import ssdr

POLYGONS = [[0, 1, 2, 3], [2, 1, 4], [0, 3, 5, 6, 7]]


FANS = [[0, 1, 2], [0, 2, 3], [2, 1, 4], [0, 3, 5], [0, 5, 6], [0, 6, 7]]


def mixed_polygons(kind):
    points = np.arange(24).reshape(8, 3) / 4
    rows = "".join("{} {} {}\n".format(*p) for p in points)
    listed = "".join(f"{len(p)} {' '.join(map(str, p))}\n" for p in POLYGONS)
    head = (
        "ply\nformat {} 1.0\ncomment made by hand\nelement vertex 8\nproperty float x\n"
        "property float y\nproperty float z\nelement face 3\n"
        "property list uchar int vertex_index\nproperty uchar flags\nend_header\n"
    )
    if kind == "obj":
        faces = "".join(f"f {' '.join(str(i + 1) for i in p)}\n" for p in POLYGONS)
        text = "# by hand\r\no thing\n" + "".join(f"v  {p}\n" for p in rows.splitlines()) + faces
    elif kind == "ascii":
        flagged = listed.replace("\n", " 7\n")
        text = head.format("ascii") + rows + flagged
    else:
        order = "<" if kind == "little" else ">"
        return (
            head.format(f"binary_{kind}_endian").encode()
            + points.astype(f"{order}f4").tobytes()
            + b"".join(struct.pack(f"{order}B{len(p)}iB", len(p), *p, 7) for p in POLYGONS)
        ), points
    return text.encode(), points


@pytest.mark.parametrize("kind", ["obj", "ascii", "little", "big"])
def test_polygons_are_cut_into_fans_in_order(tmp_path, kind):
    data, points = mixed_polygons(kind)
    path = tmp_path / f"a.{'obj' if kind == 'obj' else 'ply'}"
    path.write_bytes(data)
    sequence = ssdr.load(path)
    np.testing.assert_array_equal(sequence.vertices[0], points)
    np.testing.assert_array_equal(sequence.faces, FANS)
