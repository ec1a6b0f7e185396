"""Skin weights as a CSV table with the columns ``vertex,bone,weight``."""

from __future__ import annotations

import csv
import dataclasses
import io
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, InputError
from ..representation import short_repr
from .atomic import write_bytes
from .budget import afford
from .mesh_names import natural_key
from .registry import SaveReport, check, read_file, reading, written_vertices

if TYPE_CHECKING:
    from ..skinning import Skinning


_COLUMNS = ["vertex", "bone", "weight"]
_NUMBER = re.compile(r"\s*[0-9]{1,9}\s*")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SkinWeights:
    """Skin weights read from a table.

    Attributes
    ----------
    indices : (V, K) int32
        Bones of each vertex, from the largest weight to the smallest; unused entries are bone 0
        with weight 0.
    weights : (V, K) float64
        Non-negative; those of a vertex sum to 1.
    bone_names : tuple of B str

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = pathlib.Path(folder, "weights.csv")
    ...     _ = table.write_text("vertex,bone,weight\\n0,hip,1\\n1,hip,0.5\\n1,leg,0.5\\n")
    ...     skin_weights = ssdr.io.read_weights(table)
    >>> skin_weights.bone_names, skin_weights.weights.shape
    (('hip', 'leg'), (2, 2))
    """

    indices: NDArray[np.int32]
    weights: NDArray[np.float64]
    bone_names: tuple[str, ...]

    __repr__ = short_repr


def write_skinning(skinning: Skinning, path: Path, *, unweld: bool = False) -> SaveReport:
    """Write one row ``vertex,bone,weight`` for every weight above 0, without loss.

    A bone that moves no vertex gets a row with vertex 0 and weight 0, so that its name is kept.

    Parameters
    ----------
    skinning : Skinning
    path : Path
    unweld : bool
        Write the weights of the vertices that the mesh had before it was welded.
    """
    written, note = written_vertices(skinning, unweld)
    indices, weights = skinning.indices[written], skinning.weights[written]
    names = skinning.names()
    if len(set(names)) != len(names):
        raise InputError("bone_names", "different names", "the same name twice")
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    idle = set(range(skinning.n_bones)) - set(indices[weights > 0].tolist())
    rows.writerows((0, names[j], "0") for j in sorted(idle))
    for i, k in np.argwhere(weights > 0).tolist():
        w = weights[i, k]
        shortest = f"{w:.9g}" if weights.dtype == np.float32 else repr(float(w))
        rows.writerow((i, names[indices[i, k]], shortest))
    size = write_bytes(path, text.getvalue().encode("utf-8", "replace"))
    return SaveReport(path=path, bytes=size, influences=indices.shape[1], note=note)


def read_weights(
    path: str | os.PathLike[str],
    *,
    bones: Sequence[str] | None = None,
    n_vertices: int | None = None,
) -> SkinWeights:
    """Read skin weights from a ``.csv`` file.

    Parameters
    ----------
    path : path
    bones : sequence of str, optional
        Names of the bones, in the order of their indices in the result; by default the natural
        order of the names (``bone_2`` before ``bone_10``).
    n_vertices : int, optional
        Number of vertices that the table must have. Without it, a table that has lost its last
        lines is not noticed.

    Returns
    -------
    SkinWeights

    Raises
    ------
    FormatError
        If the table is damaged, a vertex is missing, a bone is unknown, or
        weights are negative or do not sum to 1 within 1e-4.
    InputError
        If the suffix is not ``.csv``, or `bones` has the same name twice.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = pathlib.Path(folder, "weights.csv")
    ...     _ = table.write_text("vertex,bone,weight\\n0,hip,1\\n1,leg,1\\n")
    ...     skin_weights = ssdr.io.read_weights(table, bones=["leg", "hip"])
    >>> skin_weights.indices[:, 0].tolist()
    [1, 0]
    """
    source = Path(path)
    if source.suffix.lower() != ".csv":
        raise InputError("path", "a .csv file", str(source))
    if bones is not None and len(set(bones)) != len(bones):
        raise InputError("bones", "different names", "the same name twice")
    with reading(source):
        vertex, named, weight = _parse(read_file(source).decode("utf-8-sig"))
        order = tuple(sorted(set(named), key=natural_key) if bones is None else bones)
        unknown = sorted(set(named) - set(order))
        if unknown:
            raise FormatError(f"bone {unknown[0]!r} is none of the bones asked for")
        place = {name: k for k, name in enumerate(order)}
        bone = np.array([place[name] for name in named], dtype=np.int64)
        table = _pack(source, vertex, bone, weight, order)
        found = len(table.weights)
        check(n_vertices in (None, found), f"{found} vertices, expected {n_vertices}")
        return table


def _parse(text: str) -> tuple[NDArray[np.int64], list[str], NDArray[np.float64]]:
    rows = list(filter(None, csv.reader(io.StringIO(text, newline=""), strict=True)))
    header = [cell.strip() for cell in rows[0]] if rows else []
    check(header == _COLUMNS, f"the header is {','.join(header)[:80]!r}, not vertex,bone,weight")
    for k, row in enumerate(rows[1:], 1):
        if len(row) != 3 or not _NUMBER.fullmatch(row[0]):
            raise FormatError(f"row {k} is not vertex,bone,weight")
    vertex = np.array([int(row[0]) for row in rows[1:]], dtype=np.int64)
    weight = np.array([float(row[2]) for row in rows[1:]], dtype=np.float64)
    return vertex, [row[1] for row in rows[1:]], weight


def _pack(
    path: Path,
    vertex: NDArray[np.int64],
    bone: NDArray[np.int64],
    weight: NDArray[np.float64],
    names: tuple[str, ...],
) -> SkinWeights:
    """Pack the columns of a table as skin weights; `bone` holds indices into `names`."""
    usable = np.isfinite(weight).all() and (weight >= 0).all()
    check(usable, "a weight is negative or not finite")
    used = weight > 0
    vertex, bone, weight = vertex[used], bone[used], weight[used]
    every = np.unique(vertex).size == vertex.max(initial=0) + 1
    check(every, "not every vertex from 0 on has weights")
    once = np.unique(vertex * len(names) + bone).size == vertex.size
    check(once, "a vertex names the same bone twice")
    count = np.bincount(vertex)
    afford(12 * len(count) * int(count.max()), f"{len(count)} times {count.max()} weights", path)
    sums = np.bincount(vertex, weights=weight)
    worst = int(np.abs(sums - 1).argmax())
    problem = f"the weights of vertex {worst} sum to {sums[worst]:.6g}, not 1"
    check(abs(sums[worst] - 1) <= 1e-4, problem)
    indices, weights = weight_rows(vertex, bone, weight)
    return SkinWeights(indices=indices, weights=weights, bone_names=names)


def weight_rows(
    vertex: NDArray[np.integer], bone: NDArray[np.integer], weight: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Indices and weights (V, K), largest weight first, from (vertex, bone, weight) entries.

    Every vertex has at least one entry.
    """
    order = np.lexsort((bone, -weight, vertex))
    count = np.bincount(vertex)
    row, place = vertex[order], np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    indices = np.zeros((len(count), count.max()), dtype=np.int32)
    weights = np.zeros(indices.shape)
    indices[row, place], weights[row, place] = bone[order], weight[order]
    return indices, weights
