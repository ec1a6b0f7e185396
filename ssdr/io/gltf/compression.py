"""Draco and meshopt: glTF's compressed geometry, decoded by the libraries of the extra ``gltf``.

Both libraries are told what the file's JSON states, and what they give back is compared with it:
a file that states one size and holds another is refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..registry import require

if TYPE_CHECKING:
    from .document import Document

__all__ = ["DRACO", "MESHOPT", "decode_primitive", "decode_view", "meshopt_of"]

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_LIMIT = 1 << 30  # bytes (1 GiB) of one view: a few bytes may state any size


def decode_primitive(document: Document, primitive: dict[str, Any]) -> None:
    """Decode a primitive's Draco data into the accessors that it names.

    A file that holds the geometry without compression as well is read from that.

    Raises
    ------
    MissingDependencyError
        Without DracoPy.
    FormatError
        If what is decoded is not what the accessors state.
    """
    item = document.dictionary(document.dictionary(primitive, "extensions"), DRACO)
    names = document.dictionary(primitive, "attributes")
    if "bufferView" in document.item("accessors", names.get("POSITION")):
        return
    draco = require("DracoPy", "draco", f"{document.path}: geometry compressed with Draco")
    try:
        mesh = draco.decode(bytes(document.view(item.get("bufferView"))[0]))
    except (draco.FileTypeException, RuntimeError, ValueError) as error:
        raise document.error(f"Draco data that cannot be decoded ({error})") from error
    found = {entry["unique_id"]: entry["data"] for entry in mesh.attributes}
    for name, number in document.dictionary(item, "attributes").items():
        if name not in names or number not in found:
            raise document.error(f"its Draco data hold no {name}")
        document.replace(names[name], found[number], name)
    if "indices" in primitive:
        faces = getattr(mesh, "faces", None)
        if faces is None:
            raise document.error("its Draco data hold no triangles")
        document.replace(primitive["indices"], faces.reshape(-1), "indices")
        if primitive.get("mode", 4) != 4:
            raise document.error("Draco data of a strip or fan")


def meshopt_of(document: Document, view: dict[str, Any]) -> dict[str, Any] | None:
    """What says how a buffer view is compressed; None where it is not, or need not be."""
    extensions = document.dictionary(view, "extensions")
    for name in MESHOPT:
        if name in extensions and name in document.array(document.json, "extensionsRequired"):
            return document.dictionary(extensions, name)
    return None


def decode_view(document: Document, item: dict[str, Any]) -> memoryview:
    """The bytes of a buffer view that meshopt has compressed.

    Raises
    ------
    MissingDependencyError
        Without meshoptimizer.
    FormatError
        If the data are damaged or state what cannot be.
    """
    library = require(
        "meshoptimizer", "meshopt", f"{document.path}: buffers compressed with meshopt"
    )
    data = document.buffer(document.integer(item.get("buffer"), "buffer of a view"))
    start = document.integer(item.get("byteOffset", 0), "byteOffset of a view")
    length = document.integer(item.get("byteLength"), "byteLength of a view", least=1)
    count = document.integer(item.get("count"), "count of a compressed view", least=1)
    stride = document.integer(item.get("byteStride"), "byteStride of a compressed view", 257, 1)
    if start + length > len(data):
        raise document.error(f"compressed data end at byte {start + length} of {len(data)}")
    if count * stride > _LIMIT:
        raise document.error(f"compressed data state {count * stride} bytes")
    packed, mode = bytes(data[start : start + length]), item.get("mode")
    try:
        if mode == "ATTRIBUTES" and stride % 4 == 0:
            plain = library.decode_vertex_buffer(count, stride, packed)
            plain = _filtered(document, library, item.get("filter", "NONE"), plain, count, stride)
            return memoryview(plain.tobytes())
        if mode in ("TRIANGLES", "INDICES") and stride in (2, 4):
            if mode == "TRIANGLES" and count % 3:
                raise document.error(f"{count} compressed indices are no triangles")
            decode = library.decode_index_buffer
            if mode == "INDICES":
                decode = library.decode_index_sequence
            # as 32 bits, which the library's own arrays have
            index: NDArray[np.uint32] = decode(count, 4, packed)
            if stride == 2 and int(index.max()) > 0xFFFF:
                raise document.error("compressed indices that do not fit in 16 bits")
            return memoryview(index.astype(f"<u{stride}").tobytes())
    except (RuntimeError, ValueError) as error:
        raise document.error(f"meshopt data that cannot be decoded ({error})") from error
    raise document.error(f"compressed data of mode {mode!r} and a stride of {stride} bytes")


def _filtered(
    document: Document, library: Any, name: Any, plain: Any, count: int, stride: int
) -> Any:
    if name == "NONE":
        return plain
    known = {
        "OCTAHEDRAL": (library.decode_filter_oct, (4, 8)),
        "QUATERNION": (library.decode_filter_quat, (8,)),
        "EXPONENTIAL": (library.decode_filter_exp, range(4, 257, 4)),
    }
    if name not in known or stride not in known[name][1]:
        raise document.error(f"the filter {name!r} on elements of {stride} bytes")
    return known[name][0](plain, count, stride)
