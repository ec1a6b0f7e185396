"""Arrays and a JSON document in a safetensors file, without torch; nothing in it is executed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
from numpy.typing import NDArray

from ssdr.common.errors import InputError
from ssdr.io.atomic import write_bytes
from ssdr.io.file_errors import check, reading

# Checkpoints that ship with the package.
SHIPPED = Path(__file__).parents[1] / "models"


def save_arrays(path: Path, arrays: Mapping[str, Any], kind: str, document: Any) -> Path:
    """Write arrays, a document of a kind and their checksum to one file, complete or not at all."""
    plain = {name: np.asarray(array) for name, array in arrays.items()}
    documents = json.loads(json.dumps({kind: document}))  # tuples become lists
    # A single metadata entry, because several would be written in an order that varies.
    text = json.dumps(documents | {"sha256": digest(plain, documents)}, sort_keys=True)
    write_bytes(path, safetensors.numpy.save(plain, {"garmentnet": text}))
    return path


def load_arrays(path: Path, kind: str) -> tuple[dict[str, NDArray[Any]], Any]:
    """Arrays and JSON document of a safetensors file, given by its path or, if it ships, its name.

    Numbers in half precision are converted to single precision.

    Raises
    ------
    InputError
        If there is no such file.
    FormatError
        If the file is of another format or kind, differs from its checksum, has other documents or
        holds numbers that are not finite in single precision.
    """
    ships = SHIPPED / f"{path}.safetensors"
    path = ships if ships.is_file() and not path.is_file() else path
    if not path.is_file():
        raise InputError("checkpoint", "a file", str(path))
    with reading(path):
        with safetensors.safe_open(str(path), framework="numpy") as file:
            text = (file.metadata() or {}).get("garmentnet", "")
            check(text, "safetensors, but not of garmentnet")
            arrays = {k: file.get_tensor(k) for k in file.keys()}  # noqa: SIM118
        documents = json.loads(text)
        expected = documents.pop("sha256", None)
        check(set(documents) == {kind}, f"documents {sorted(documents)}, expected {kind!r}")
        check(expected is not None, "it has no checksum")
        check(expected == digest(arrays, documents), "damaged: its checksum is another")
        for key, value in arrays.items():
            if value.dtype.kind == "f":
                with np.errstate(over="ignore"):
                    single = value.astype(np.float32)
                finite = bool(np.isfinite(single).all())
                check(finite, f"numbers that are not finite in single precision in {key}")
                arrays[key] = single if value.dtype == np.float16 else value
    return arrays, documents[kind]


def digest(arrays: Mapping[str, NDArray[Any]], documents: Mapping[str, Any]) -> str:
    """SHA-256 of arrays, with their names and types, and of JSON documents, in hexadecimal.

    Examples
    --------
    >>> digest({"a": np.zeros(2)}, {}) == digest({"a": np.zeros(2)}, {})
    True
    >>> digest({"a": np.zeros(2)}, {}) == digest({"b": np.zeros(2)}, {})
    False
    """
    found = hashlib.sha256(json.dumps(documents, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def tensors_of(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, Any]:
    """The arrays whose names begin with a prefix, as tensors that are named without it."""
    import torch

    some = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
    # Copied to aligned addresses; products of unaligned tensors differ in their last bits.
    return {k: torch.from_numpy(v).clone() for k, v in some.items()}
