"""Tensors and JSON documents in one safetensors file; nothing in it is executed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ssdr.io.atomic import atomic_path
from ssdr.io.optional import import_optional as require

from ..io.files import writing
from ..io.tensors import digest, load_arrays


def save_tensors(path: Path, tensors: dict[str, Tensor], documents: dict[str, Any]) -> Path:
    """Write tensors, JSON documents and their checksum to one file, complete or not at all."""
    safetensors = require("safetensors.torch", "garmentnet", "a checkpoint")
    # Tensors may share memory, which the format cannot express.
    plain = {k: v.detach().cpu().contiguous().clone() for k, v in tensors.items()}
    read = json.loads(json.dumps(documents))  # tuples become lists
    checksum = digest({k: v.numpy() for k, v in plain.items()}, read)
    # A single metadata entry, because several would be written in an order that varies.
    text = json.dumps(documents | {"sha256": checksum}, sort_keys=True)
    with writing(path), atomic_path(path) as temporary:
        temporary.touch()
        mode = temporary.stat().st_mode
        safetensors.save_file(plain, str(temporary), metadata={"garmentnet": text})
        # safetensors makes the file readable by its owner alone.
        temporary.chmod(mode)
    return path


def part_of(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names begin with a prefix, named without it."""
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def load_tensors(path: Path, wanted: Sequence[str]) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and JSON documents of a safetensors file; errors as :func:`load_arrays`."""
    arrays, documents = load_arrays(path, wanted)
    # Copied to aligned addresses; products of unaligned tensors differ in their last bits.
    return {k: torch.from_numpy(v).clone() for k, v in arrays.items()}, documents
