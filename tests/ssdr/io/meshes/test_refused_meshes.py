"""Damaged and hostile OBJ, PLY and point caches are refused in words."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import ssdr
from helpers.refused import Refused, looks, mapped, raw

TABLE = Refused()
for _suffix in ("obj", "ply", "pc2", "abc"):
    TABLE.add(_suffix, raw, looks())
# MDD has no magic number: any bytes are counts that do not fit
TABLE.add("mdd", raw, {what: (data, "bad") for what, (data, _) in looks().items()})

OBJ = [
    *("f 1 2 4", "f 0 1 2", "f 1 2 -4", "f 1 2", "f 1 2 x", "f 1/1 2 3"),
    *("v 1 2", "v 1 2 x", "v 1 2 nan", "v 1 2 inf", "v 1 2 1e999"),
]
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n{}\nf 1 2 3\n"
TABLE.add("obj", raw, {line: (TRIANGLE.format(line), "bad") for line in OBJ})


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
    TABLE.add("ply", raw, _cases)
for _corner in (0.5, np.nan, 1e300):
    _data = ply_head("ascii", 3, 1, number="double") + POINTS + f"3 0 1 {_corner}".encode()
    TABLE.add("ply", raw, {str(_corner): (_data, "the faces are not lists of integers")})
for _length in (2**31 - 1, -3):
    for _step in (1, -1):
        _rows = [struct.pack("<4i", n, 0, 1, 2) for n in (3, _length)][::_step]
        _data = ply_head("binary_little_endian", 3, 2, "int") + bytes(36) + b"".join(_rows)
        TABLE.add("ply", raw, {f"a list of {_length} {_step}": (_data, "bad")})
# trimesh leaves out the rows
for _rows in ("3 0 1 2 3 0 1", "3 0 1 2", "3.5 0 1 2 3 0 1 2", "nan 0 1 2"):
    _data = ply_head("ascii", 3, 2) + POINTS + _rows.encode()
    TABLE.add("ply", raw, {f"cut {_rows}": (_data, "bad")})

SAMPLES = [(2**31 - 1, 2**31 - 1), (-1, 4), (0, 4), (4, 0), (13, 4), (12, 5), (11, 4)]
for _points, _samples in SAMPLES:  # of 4 samples of 12 points
    _says = f"states {_samples} samples of {_points} p"
    _head = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, _points, 0.0, 1.0, _samples)
    _case = {f"{_samples} of {_points}": (_head + bytes(4 * 12 * 12), _says)}
    TABLE.add("pc2", raw, _case, ssdr.load, mapped)
    _head = struct.pack(">ii4f", _samples, _points, 0, 1, 2, 3)
    _case = {f"{_samples} of {_points}": (_head + bytes(4 * 12 * 12), _says)}
    TABLE.add("mdd", raw, _case, ssdr.load, mapped)


@pytest.mark.parametrize("case", TABLE)
def test_the_file_is_refused_in_words(tmp_path, case):
    TABLE.check(case, tmp_path)
