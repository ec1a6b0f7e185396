"""Decoding of glTF geometry that is compressed with Draco or meshopt, by optional libraries.

Decoded data are compared with the sizes and types that the file's JSON states, and a file in which
they differ is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ..file_errors import check
from ..optional import require

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


def decode_mesh(data: bytes, path: Path) -> tuple[dict[int, NDArray[Any]], NDArray[Any] | None]:
    """Arrays of a Draco mesh's attributes by attribute id, and its faces (None if it has none).

    Raises
    ------
    MissingDependencyError
        If DracoPy is not installed.
    FormatError
        If the data are damaged.
    """
    draco = require("draco", f"{path}: geometry compressed with Draco")
    try:
        mesh = draco.decode(data)
    except (draco.FileTypeException, RuntimeError, ValueError) as error:
        raise FormatError(f"{path}: Draco data that cannot be decoded ({error})") from error
    attributes = {entry["unique_id"]: entry["data"] for entry in mesh.attributes}
    return attributes, getattr(mesh, "faces", None)


def decode_view(
    data: bytes, count: int, stride: int, mode: str, filter_: str, path: Path
) -> memoryview:
    """Decompressed bytes of a meshopt buffer view, which are `count` elements of `stride` bytes.

    Raises
    ------
    MissingDependencyError
        If meshoptimizer is not installed.
    FormatError
        If the data are damaged, or the mode or filter is unknown or does not fit the elements.
    """
    library = require("meshopt", f"{path}: buffers compressed with meshopt")
    state = f"{mode!r} and a stride of {stride} bytes"
    words, short = stride in range(4, 257, 4), stride in (2, 4)
    known = words if mode == "ATTRIBUTES" else short and mode in ("TRIANGLES", "INDICES")
    check(known, f"{path}: compressed data of mode {state}")
    filters = {
        "NONE": (lambda plain, *_: plain, range(257)),
        "OCTAHEDRAL": (library.decode_filter_oct, (4, 8)),
        "QUATERNION": (library.decode_filter_quat, (8,)),
        "EXPONENTIAL": (library.decode_filter_exp, range(257)),
    }
    unfilter, strides = filters.get(filter_, (None, ()))
    check(stride in strides, f"{path}: the filter {filter_!r} on elements of {stride} bytes")
    check(mode != "TRIANGLES" or count % 3 == 0, f"{path}: {count} indices are no triangles")
    try:
        if mode == "ATTRIBUTES":
            plain = library.decode_vertex_buffer(count, stride, data)
            return memoryview(unfilter(plain, count, stride).tobytes())
        decode = library.decode_index_buffer
        if mode == "INDICES":
            decode = library.decode_index_sequence
        index: NDArray[np.uint32] = decode(count, 4, data)  # the library decodes to 32 bits
    except (RuntimeError, ValueError) as error:
        raise FormatError(f"{path}: meshopt data that cannot be decoded ({error})") from error
    fits = stride == 4 or int(index.max()) <= 0xFFFF
    check(fits, f"{path}: compressed indices that do not fit in 16 bits")
    return memoryview(index.astype(f"<u{stride}").tobytes())
