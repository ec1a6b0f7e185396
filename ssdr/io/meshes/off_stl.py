"""OFF and STL files, with checks that a file is complete.

STL is read by trimesh. OFF is not, because trimesh reads no polygons of five or more corners from
it, and silently drops rows that are cut off.
"""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import numpy as np

from ..registry import check, read_file, reading
from ..signatures import describe
from .polygons import Mesh, fan, vertex_rows


def parse_off(path: Path, _like: Mesh | None = None) -> Mesh:
    """Read one OFF file, without the colours and normals of its vertices."""
    with reading(path):
        data = read_file(path)
        rows = [line.split(b"#", 1)[0].split() for line in data.splitlines()]
        rows = [row for row in rows if row]
        known = rows and re.fullmatch(rb"(ST)?C?N?OFF", rows[0][0])
        check(known, f"not an OFF file: {describe(data[:64])}")
        start = 1 if len(rows[0]) > 1 else 2  # counts may stand in the first line
        n_vertices, n_faces = map(int, (rows[0][1:] or rows[1])[:2])
        polygons = rows[start + n_vertices :]
        held = len(rows) - start
        problem = f"states {n_vertices} vertices and {n_faces} faces, holds {held} lines"
        check(min(n_vertices, n_faces) >= 0 and n_vertices + n_faces == held, problem)
        counts = np.array([int(row[0]) for row in polygons], dtype=np.int64)
        whole = all(0 <= n < len(row) for n, row in zip(counts, polygons, strict=True))
        check(whole, "a face has fewer corners than it states")
        corners = [w for n, row in zip(counts, polygons, strict=True) for w in row[1 : n + 1]]
        faces = np.array([int(w) for w in corners], dtype=np.int64)[fan(counts)[0]]
        return Mesh(vertices=vertex_rows(rows[start : start + n_vertices]), faces=faces)


def parse_stl(path: Path, _like: Mesh | None = None) -> Mesh:
    """Read one STL file, ASCII or binary; each triangle has three vertices of its own."""
    from trimesh.exchange.stl import load_stl

    with reading(path), warnings.catch_warnings():
        warnings.simplefilter("error")  # trimesh only warns of numbers that are cut off
        data = read_file(path)
        loaded = load_stl(io.BytesIO(data))
        solids = loaded.get("geometry", {"": loaded}).values()
        vertices = np.concatenate([solid["vertices"] for solid in solids] or [np.zeros((0, 3))])
        binary = len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
        facets = len(vertices) // 3 if binary else len(re.findall(rb"(?i)endfacet", data))
        whole = facets and len(vertices) == 3 * facets
        check(whole, f"not an STL file, or cut off: {describe(data[:64])}")
        return Mesh(vertices=vertices, faces=np.arange(len(vertices)).reshape(-1, 3))
