"""Files of every format whose numbers were forged: refused by name, or read to finite arrays."""

from __future__ import annotations

import io
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.io import read_weights

SIZES = [0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**64 - 1, 10**9, 65_536]
WORDS = [b"0", b"-1", b"nan", b"inf", b"1e999", b"999999999999999999999", b"1e-400", b"x",
         b"null", b"[]", b"{}", b'"', b"true", b"1.5"]  # fmt: skip


def forge_size(rng: np.random.Generator, data: bytes) -> bytes:
    """A whole number of 2, 4 or 8 bytes replaced, often in the head."""
    width = int(rng.choice([2, 4, 8]))
    reach = max(1, len(data) - width)
    place = int(rng.integers(0, reach if rng.random() < 0.4 else min(reach, 300)))
    value = SIZES[int(rng.integers(len(SIZES)))] & (256**width - 1)
    packed = struct.pack("<Q", value)[:width]
    return data[:place] + packed + data[place + width :]


def forge_word(rng: np.random.Generator, data: bytes) -> bytes:
    """A number of a text, or of a header in JSON, replaced."""
    numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", data[:20_000]))
    if not numbers:
        return forge_size(rng, data)
    match = numbers[int(rng.integers(len(numbers)))]
    return data[: match.start()] + WORDS[int(rng.integers(len(WORDS)))] + data[match.end() :]


def forge_member(rng: np.random.Generator, data: bytes) -> bytes:
    """A member of an archive forged or left out; checksums are right."""
    with zipfile.ZipFile(io.BytesIO(data)) as source:
        members = {name: source.read(name) for name in source.namelist()}
    name = sorted(members)[int(rng.integers(len(members)))]
    if rng.random() < 0.1:
        del members[name]
    else:
        members[name] = [forge_size, forge_word][int(rng.integers(2))](rng, members[name])
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as target:
        for key, value in members.items():
            target.writestr(key, value)
    return out.getvalue()


def written(kind: str, folder: Path) -> tuple[list[Path], Callable[[], Any]]:
    """A valid file of a kind: what can be forged, and a function that reads it."""
    rig = motions.chain(bones=3, rows=5, ring=4, frames=3)
    sequence = ssdr.MeshSequence(rig.frames.astype(np.float32), rig.faces, 25.0)
    skinning = ssdr.Skinning(rig.rest, rig.indices, rig.weights, rig.transforms, faces=rig.faces)
    suffix, _, skinned = kind.partition(" ")
    path = folder / ("a_%d" if suffix in ("obj", "ply") else "a")
    path = path.with_suffix(f".{suffix}")
    ssdr.save(skinning if skinned or suffix == "csv" else sequence, path)
    if suffix == "csv":
        return [path], lambda: read_weights(path, n_vertices=len(rig.rest))
    if suffix in ("npy", "zarr"):
        parts = [p for p in path.rglob("*") if p.is_file()] if suffix == "zarr" else [path]
        return parts, lambda: ssdr.load(path, faces=rig.faces)
    if suffix in ("pc2", "mdd"):
        return [path], lambda: ssdr.load(path, faces=rig.faces)
    if "%" in path.name:
        return sorted(folder.iterdir()), lambda: ssdr.load(folder)
    return sorted(folder.iterdir()), lambda: (ssdr.load_skinning if skinned else ssdr.load)(path)


KINDS = ["npz", "npz skinned", "npy", "pc2", "mdd", "obj", "ply", "csv", "glb skinned",
         "gltf skinned", "usda", "usda skinned", "zarr"]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_forged_numbers_are_refused_or_finite(kind: str, tmp_path: Path) -> None:
    for module, kinds in (("pxr", "usda"), ("zarr", "zarr")):
        if kind.startswith(kinds):
            pytest.importorskip(module)
    parts, read = written(kind, tmp_path)
    valid = {part: part.read_bytes() for part in parts}
    rng, refused = np.random.default_rng(0), []
    for trial in range(60):
        part = parts[int(rng.integers(len(parts)))]
        forge = [forge_size, forge_word][trial % 2]
        if valid[part].startswith(b"PK"):
            forge = forge_member
        part.write_bytes(forge(rng, valid[part]))
        try:
            found = read()
        except ssdr.FormatError as error:
            refused.append(str(error))
        else:
            arrays = [a for a in vars(found).values() if isinstance(a, np.ndarray)]
            assert arrays
            assert all(np.isfinite(a).all() for a in arrays)
            faces = getattr(found, "faces", None)
            if faces is not None and faces.size:
                assert 0 <= faces.min() <= faces.max() < found.n_vertices
        part.write_bytes(valid[part])
    assert refused
    assert all(str(tmp_path) in message for message in refused)
