"""Reading of arrays and JSON documents from a safetensors file, without torch or running code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.errors import FormatError, InputError
from ssdr.io.optional import import_optional as require
from ssdr.io.registry import reading

# Checkpoints that ship with the package.
SHIPPED = Path(__file__).parents[1] / "models"


def load_arrays(path: Path, wanted: Sequence[str]) -> tuple[dict[str, NDArray[Any]], Any]:
    """Arrays and JSON documents of a safetensors file, or of one that ships, by its name.

    Numbers in half precision are converted to single precision.

    Raises
    ------
    InputError
        If there is no such file.
    FormatError
        If the file is of another format, differs from its checksum, has other documents or holds
        numbers that are not finite in single precision.

    Notes
    -----
    Files of earlier versions have no checksum.
    """
    safetensors = require("safetensors", "garmentnet", "a checkpoint")
    ships = SHIPPED / f"{path}.safetensors"
    path = ships if ships.is_file() and not path.exists() else path
    if not path.is_file():
        raise InputError("checkpoint", "a file", str(path))
    with reading(path):
        with safetensors.safe_open(str(path), framework="numpy") as file:
            text = (file.metadata() or {}).get("garmentnet")
            if text is None:
                raise FormatError("safetensors, but not of garmentnet")
            arrays = {k: file.get_tensor(k) for k in file.keys()}  # noqa: SIM118
        documents = json.loads(text)
        expected = documents.pop("sha256", None)
        if expected is not None and expected != digest(arrays, documents):
            raise FormatError("damaged: its checksum is another")
        # A checksum whose own name is damaged would otherwise be a further document.
        if set(documents) != set(wanted):
            raise FormatError(f"documents {sorted(documents)}, expected {sorted(wanted)}")
        for key, value in arrays.items():
            if value.dtype.kind != "f":
                continue
            with np.errstate(over="ignore"):
                single = value.astype(np.float32)
            if not np.isfinite(single).all():
                raise FormatError(f"numbers that are not finite in single precision in {key}")
            if value.dtype == np.float16:
                arrays[key] = single
    return arrays, documents


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
