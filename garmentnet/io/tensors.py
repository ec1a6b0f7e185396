"""Reading of arrays and JSON documents from a safetensors file, without torch or running code."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.errors import FormatError, InputError
from ssdr.io.optional import import_optional as require
from ssdr.io.registry import reading

__all__ = ["SHIPPED", "load_arrays"]

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
        If the file is of another format, lacks a document or holds NaN or Inf.
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
        missing = [k for k in wanted if k not in documents]
        if missing:
            raise FormatError(f"no document {missing[0]!r}")
        for key, value in arrays.items():
            if value.dtype.kind == "f" and not np.isfinite(value).all():
                raise FormatError(f"NaN or Inf in {key}")
            if value.dtype == np.float16:
                arrays[key] = value.astype(np.float32)
    return arrays, documents
