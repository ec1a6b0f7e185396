"""Draco and meshopt: glTF's compressed geometry, decoded by the libraries of two extras.

Both libraries are told what the file's JSON states, and their results are compared with it: a file
that states one size and holds another is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ..registry import require

__all__ = ["DRACO", "MESHOPT", "decode_mesh", "decode_view"]

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


def decode_mesh(data: bytes, path: Path) -> tuple[dict[int, NDArray[Any]], NDArray[Any] | None]:
    """Attributes of a Draco mesh by their numbers, and its faces if it has any.

    Raises
    ------
    MissingDependencyError
        Without DracoPy.
    FormatError
        If the data are damaged.
    """
    draco = require("DracoPy", "draco", f"{path}: geometry compressed with Draco")
    try:
        mesh = draco.decode(data)
    except (draco.FileTypeException, RuntimeError, ValueError) as error:
        raise FormatError(f"{path}: Draco data that cannot be decoded ({error})") from error
    attributes = {entry["unique_id"]: entry["data"] for entry in mesh.attributes}
    return attributes, getattr(mesh, "faces", None)


def decode_view(
    data: bytes, count: int, stride: int, mode: str, filter_: str, path: Path
) -> memoryview:
    """Bytes of a buffer view compressed with meshopt: `count` elements of `stride` bytes.

    Raises
    ------
    MissingDependencyError
        Without meshoptimizer.
    FormatError
        If the data are damaged, or the mode or filter is unknown.
    """
    library = require("meshoptimizer", "meshopt", f"{path}: buffers compressed with meshopt")
    try:
        if mode == "ATTRIBUTES" and stride in range(4, 257, 4):
            plain = library.decode_vertex_buffer(count, stride, data)
            if filter_ != "NONE":
                filters = {
                    "OCTAHEDRAL": (library.decode_filter_oct, (4, 8)),
                    "QUATERNION": (library.decode_filter_quat, (8,)),
                    "EXPONENTIAL": (library.decode_filter_exp, range(4, 257, 4)),
                }
                decode, strides = filters.get(filter_, (None, ()))
                if stride not in strides:
                    raise FormatError(
                        f"{path}: the filter {filter_!r} on elements of {stride} bytes"
                    )
                plain = decode(plain, count, stride)
            return memoryview(plain.tobytes())
        if mode in ("TRIANGLES", "INDICES") and stride in (2, 4):
            if mode == "TRIANGLES" and count % 3:
                raise FormatError(f"{path}: {count} compressed indices are no triangles")
            decode = library.decode_index_buffer
            if mode == "INDICES":
                decode = library.decode_index_sequence
            # as 32 bits, which the library's own arrays have
            index: NDArray[np.uint32] = decode(count, 4, data)
            if stride == 2 and int(index.max()) > 0xFFFF:
                raise FormatError(f"{path}: compressed indices that do not fit in 16 bits")
            return memoryview(index.astype(f"<u{stride}").tobytes())
    except FormatError:
        raise
    except (RuntimeError, ValueError) as error:
        raise FormatError(f"{path}: meshopt data that cannot be decoded ({error})") from error
    raise FormatError(f"{path}: compressed data of mode {mode!r} and a stride of {stride} bytes")
