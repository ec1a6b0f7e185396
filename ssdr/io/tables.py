"""Skin weights as CSV (``vertex,bone,weight``) and JSON, for other programs and for eyes."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, InputError
from ..hierarchy.transforms import check_parents
from .atomic import write_bytes
from .registry import SaveReport, reading

if TYPE_CHECKING:
    from ..skinning import Skinning

__all__ = ["SkinWeights", "read_weights", "write_csv", "write_json"]

_COLUMNS = ["vertex", "bone", "weight"]
_FORMAT = "ssdr-weights"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SkinWeights:
    """Skin weights read from a table.

    Attributes
    ----------
    indices : (V, K) int32
        Bones of each vertex, largest weight first; padded with bone 0, weight 0.
    weights : (V, K) float64
        Non-negative, summing to 1 over K.
    bone_names : tuple of B str
    parents : (B,) int32 or None
        -1 at roots; None where the table holds no hierarchy, as no CSV file does.
    joint_positions : (B, 3) float64 or None
        By which point of the rest pose each bone hangs on its parent.

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
    parents: NDArray[np.int32] | None = None
    joint_positions: NDArray[np.float64] | None = None


def write_csv(skinning: Skinning, path: Path, *, unweld: bool = False) -> SaveReport:
    """Write one row ``vertex,bone,weight`` for every weight above 0; exact.

    A bone that moves nothing gets a row of vertex 0 and weight 0, so that it is
    not lost.

    Parameters
    ----------
    skinning : Skinning
    path : Path
    unweld : bool
        Write the vertices of the mesh before it was welded.
    """
    indices, weights = _given(skinning, unweld)
    names = skinning.names()
    if len(set(names)) != len(names):
        raise InputError("bone_names", "different names", "the same name twice")
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    idle = set(range(skinning.n_bones)) - set(indices[weights > 0].tolist())
    rows.writerows((0, names[j], "0") for j in sorted(idle))
    for i, (bones, values) in enumerate(zip(indices.tolist(), weights.tolist(), strict=True)):
        rows.writerows(
            (i, names[j], _shortest(w, weights.dtype))
            for j, w in zip(bones, values, strict=True)
            if w > 0
        )
    return _report(path, text.getvalue(), indices, skinning, unweld)


def write_json(skinning: Skinning, path: Path, *, unweld: bool = False) -> SaveReport:
    """Write ``{"format", "version", "bones", "joints", "weights"}``; exact.

    Where bones have a hierarchy, ``"parents"`` and ``"joint_positions"`` as well.

    Parameters as for :func:`write_csv`.
    """
    indices, weights = _given(skinning, unweld)
    record: dict[str, Any] = {"format": _FORMAT, "version": 1, "bones": list(skinning.names())}
    if skinning.parents is not None:
        record["parents"] = skinning.parents.tolist()
        at = skinning.joint_positions
        record["joint_positions"] = [[float(_shortest(x, at.dtype)) for x in p] for p in at]
    head = json.dumps(record, indent=1)
    lines = [
        "[" + ", ".join(_shortest(w, weights.dtype) for w in row) + "]" for row in weights.tolist()
    ]
    text = '{},\n "joints": [\n{}\n ],\n "weights": [\n{}\n ]\n}}\n'.format(
        head.removesuffix("\n}"),
        ",\n".join(f"  {row}" for row in indices.tolist()),
        ",\n".join(f"  {line}" for line in lines),
    )
    return _report(path, text, indices, skinning, unweld)


def read_weights(
    path: str | os.PathLike[str],
    *,
    bones: Sequence[str] | None = None,
    n_vertices: int | None = None,
) -> SkinWeights:
    """Read skin weights from ``.csv`` or ``.json``.

    Parameters
    ----------
    path : path
    bones : sequence of str, optional
        Names of the bones in the order that the joints shall have; by default
        the order of a JSON file, the natural order of the names of a CSV file
        (``bone_2`` before ``bone_10``).
    n_vertices : int, optional
        How many vertices there must be; a CSV file that lost its last lines
        shows it in nothing else.

    Raises
    ------
    FormatError
        If the table is damaged, a vertex is missing, a bone is unknown, or
        weights are negative or do not sum to 1 within 1e-4.
    InputError
        If the suffix is neither.

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
    suffix = source.suffix.lower()
    if suffix not in (".csv", ".json"):
        raise InputError("path", "a .csv or .json file", str(source))
    if bones is not None and len(set(bones)) != len(bones):
        raise InputError("bones", "different names", "the same name twice")
    with reading(source):
        text = source.read_text(encoding="utf-8-sig")
        parse = _parse_csv if suffix == ".csv" else _parse_json
        vertex, name_index, weight, names = parse(source, text)
        hierarchy = _hierarchy(source, text) if suffix == ".json" else None
        order = tuple(names if bones is None else bones)
        unknown = sorted(set(names) - set(order))
        if unknown:
            raise FormatError(f"{source}: bone {unknown[0]!r} is none of the bones asked for")
        joint = np.array([order.index(n) for n in names], dtype=np.int32)[name_index]
        table = _pack(source, vertex, joint, weight, order)
        if n_vertices is not None and len(table.weights) != n_vertices:
            raise FormatError(f"{source}: {len(table.weights)} vertices, expected {n_vertices}")
        if hierarchy is None or set(order) != set(names):  # of further bones nothing is known
            return table
        return _with_hierarchy(table, names, *hierarchy)


def _given(skinning: Skinning, unweld: bool) -> tuple[NDArray[np.int32], NDArray[Any]]:
    if not unweld:
        return skinning.indices, skinning.weights
    index = skinning.vertex_map
    if index is None:
        raise InputError("unweld", "a skinning that was welded", "one without vertex_map")
    return skinning.indices[index], skinning.weights[index]


def _shortest(value: float, dtype: np.dtype[Any]) -> str:
    return f"{value:.9g}" if dtype == np.float32 else repr(float(value))


def _report(
    path: Path, text: str, indices: NDArray[np.int32], skinning: Skinning, unweld: bool
) -> SaveReport:
    note = ""
    if skinning.vertex_map is not None and not unweld:
        note = (
            f"numbers the {skinning.n_vertices} welded vertices; unweld=True numbers the "
            f"{len(skinning.vertex_map)} of the mesh before"
        )
    size = write_bytes(path, text.encode("utf-8", "replace"))
    return SaveReport(path=path, bytes=size, influences=indices.shape[1], note=note)


_Table = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], list[str]]


def _parse_csv(path: Path, text: str) -> _Table:
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    header = [cell.strip() for cell in next(rows, [])]
    if header != _COLUMNS:
        raise FormatError(
            f"{path}: the header is {','.join(header)[:80]!r}, not vertex,bone,weight"
        )
    vertex, bone, weight = [], [], []
    for row in rows:
        if not row:
            continue
        number = row[0].strip()
        if len(row) != 3 or not (number.isascii() and number.isdigit() and len(number) < 10):
            raise FormatError(f"{path}: line {rows.line_num} is not vertex,bone,weight")
        vertex.append(int(number))
        bone.append(row[1])
        weight.append(float(row[2]))
    names = sorted(set(bone), key=_natural)
    place = {name: k for k, name in enumerate(names)}
    return (
        np.array(vertex, dtype=np.int64),
        np.array([place[name] for name in bone], dtype=np.int64),
        np.array(weight, dtype=np.float64),
        names,
    )


def _parse_json(path: Path, text: str) -> _Table:
    table = json.loads(text)
    if not isinstance(table, dict) or table.get("format") != _FORMAT:
        raise FormatError(f'{path}: not a table of skin weights ("format": "{_FORMAT}")')
    if table.get("version") != 1:
        raise FormatError(f"{path}: version {table.get('version')}; this release reads 1")
    names = table.get("bones")
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise FormatError(f"{path}: bones are not a list of names")
    if len(set(names)) != len(names):
        raise FormatError(f"{path}: two bones have the same name")
    indices, weights = np.array(table.get("joints")), np.array(table.get("weights"))
    numbers = indices.dtype.kind == "i" and weights.dtype.kind in "if"
    if indices.ndim != 2 or indices.shape != weights.shape or not numbers:
        raise FormatError(f"{path}: joints and weights are not two tables of one shape")
    if indices.size and not 0 <= indices.min() <= indices.max() < len(names):
        raise FormatError(f"{path}: a joint is not one of the {len(names)} bones")
    vertex = np.repeat(np.arange(len(indices)), indices.shape[1])
    flat = weights.astype(np.float64).ravel()
    keep = flat != 0
    return vertex[keep], indices.ravel()[keep].astype(np.int64), flat[keep], names


def _hierarchy(path: Path, text: str) -> tuple[NDArray[np.int32], NDArray[np.float64]] | None:
    """Parents and joint positions of a table, in its own order."""
    table = json.loads(text)
    if "parents" not in table and "joint_positions" not in table:
        return None
    parents = check_parents(np.array(table.get("parents")), len(table["bones"]))
    positions = np.array(table.get("joint_positions"))
    if positions.shape != (len(parents), 3) or positions.dtype.kind not in "if":
        raise FormatError(f"{path}: joint_positions are not three numbers for each bone")
    if not np.isfinite(positions).all():
        raise FormatError(f"{path}: a joint position is not finite")
    return parents, positions.astype(np.float64)


def _with_hierarchy(
    table: SkinWeights,
    names: Sequence[str],
    parents: NDArray[np.int32],
    positions: NDArray[np.float64],
) -> SkinWeights:
    """The table with the hierarchy of bones `names`, in the table's order."""
    place = {name: k for k, name in enumerate(table.bone_names)}
    old = [names.index(name) for name in table.bone_names]
    above = [place[names[parents[k]]] if parents[k] >= 0 else -1 for k in old]
    return dataclasses.replace(
        table, parents=np.array(above, dtype=np.int32), joint_positions=positions[old]
    )


def _pack(
    path: Path,
    vertex: NDArray[np.int64],
    joint: NDArray[np.int32],
    weight: NDArray[np.float64],
    names: tuple[str, ...],
) -> SkinWeights:
    if not np.isfinite(weight).all() or (weight < 0).any():
        raise FormatError(f"{path}: a weight is negative or not finite")
    used = weight > 0
    vertex, joint, weight = vertex[used], joint[used], weight[used]
    present = np.unique(vertex)
    if len(present) == 0 or present[-1] != len(present) - 1:
        raise FormatError(f"{path}: not every vertex from 0 on has weights")
    pairs = vertex * len(names) + joint
    if len(np.unique(pairs)) != len(pairs):
        raise FormatError(f"{path}: a vertex names the same bone twice")
    count = np.bincount(vertex)
    sums = np.bincount(vertex, weights=weight)
    off = np.abs(sums - 1)
    if off.max() > 1e-4:
        worst = int(off.argmax())
        raise FormatError(f"{path}: the weights of vertex {worst} sum to {sums[worst]:.6g}, not 1")
    order = np.lexsort((-weight, vertex))
    slot = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    indices = np.zeros((len(count), count.max()), dtype=np.int32)
    weights = np.zeros(indices.shape)
    indices[vertex[order], slot] = joint[order]
    weights[vertex[order], slot] = weight[order]
    return SkinWeights(indices=indices, weights=weights, bone_names=names)


def _natural(name: str) -> list[tuple[int, str]]:
    parts = re.split(r"([0-9]+)", name)
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in parts]
