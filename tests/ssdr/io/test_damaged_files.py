"""Files that are cut off, flipped, forged, mislabelled or made to do harm are refused in words."""

from __future__ import annotations

import dataclasses
import io
import re
import struct
import zipfile

import numpy as np
import pytest

import ssdr
from helpers.rig_model import tube
from ssdr import FormatError

# a suffix and what the file holds, by default a sequence
WHOLE = ["npz packed", "npz", "npz surface", "npz skinned", "npy", "glb skinned", "pc2", "mdd",
         "obj", "ply"]  # fmt: skip
# in parts, or text of another library, or read by a process of its own
SEVERAL = ["gltf skinned", "usda", "usda skinned"]
SEVERAL += [pytest.param("abc", marks=pytest.mark.slow)]


@pytest.fixture
def written(request, tmp_path, wave, seam, skinned):
    """A valid file of a kind: its parts that can be damaged, and a function that reads it."""
    suffix, _, what = request.param.partition(" ")
    for module, other in (("pxr.UsdSkel", "usda"), ("alembic3d", "abc")):
        if suffix == other:
            pytest.importorskip(module)
    folder = tmp_path / "valid"
    folder.mkdir()
    path, options, read = folder / f"a.{suffix}", {}, ssdr.load
    thing = {"surface": seam, "skinned": skinned}.get(what, seam if suffix == "obj" else wave)
    if what == "skinned":
        read = ssdr.load_skinning
        surface = ssdr.Surface(materials=seam.surface.materials)
        thing = dataclasses.replace(skinned, surface=surface)
        if suffix != "npz":
            thing, options = tube(frames=3, rings=4, sides=4), {"max_bytes": 1 << 24}
    elif suffix in ("npy", "pc2", "mdd"):
        options = {"faces": wave.faces}
    if suffix in ("obj", "ply"):
        thing = dataclasses.replace(thing, vertices=thing.vertices[1:])
        ssdr.save(thing, folder / f"a_%d.{suffix}")
        return [folder / f"a_1.{suffix}"], lambda: read(folder)
    if suffix == "npy":
        np.save(path, wave.vertices)
    else:
        ssdr.save(thing, path, **({"compress": what == "packed"} if suffix == "npz" else {}))
    return sorted(folder.iterdir()), lambda: read(path, **options)


def arrays_of(found):
    """All arrays of a result, which are sound."""
    arrays = {k: a for k, a in vars(found).items() if isinstance(a, np.ndarray)}
    assert arrays
    assert all(np.isfinite(a).all() for a in arrays.values())
    faces = arrays.get("faces")
    if faces is not None and faces.size:
        assert 0 <= faces.min() <= faces.max() < found.n_vertices
    return arrays


@pytest.mark.parametrize("written", WHOLE, indirect=True)
def test_truncated_files_are_refused(written):
    parts, read = written
    path, expected = parts[0], arrays_of(read())
    whole = path.read_bytes()
    n = len(whole)
    tail = 12
    cuts = {0, 1, 3, 7, 20, 33, 81, 90, n // 4, n // 3, n // 2, 3 * n // 4, n - 45, n - 1 - tail}
    for cut in sorted({c for c in cuts if 0 <= c < n - tail}):
        path.write_bytes(whole[:cut])
        with pytest.raises(FormatError, match=path.parent.name):
            read()
    # Cut among the last bytes: refused, or nothing of the arrays was lost.
    for cut in range(n - tail, n):
        path.write_bytes(whole[:cut])
        try:
            result = arrays_of(read())
        except FormatError:
            continue
        assert path.suffix in (".obj", ".ply")
        for key, array in expected.items():
            np.testing.assert_array_equal(result[key], array)


SIZES = [0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**64 - 1, 10**9, 65_536]
WORDS = [b"0", b"-1", b"nan", b"inf", b"1e999", b"999999999999999999999", b"1e-400", b"x",
         b"null", b"[]", b"{}", b'"', b"true", b"1.5"]  # fmt: skip


def flip(rng, data):
    """Up to three bytes replaced, half of the times in the head, where counts and offsets are."""
    data, reach = bytearray(data), len(data) if rng.random() < 0.5 else min(len(data), 160)
    for place in rng.integers(0, reach, rng.integers(1, 4)):
        data[place] = rng.integers(0, 256)
    return bytes(data)


def splice(rng, data):
    """Up to 50 bytes left out, and up to eight others there."""
    a, b = sorted(rng.integers(0, len(data), 2))
    return data[:a] + rng.bytes(int(rng.integers(0, 9))) + data[min(b, a + 50) :]


def forge_size(rng, data):
    """A whole number of 2, 4 or 8 bytes replaced, often in the head."""
    width = int(rng.choice([2, 4, 8]))
    reach = max(1, len(data) - width)
    place = int(rng.integers(0, reach if rng.random() < 0.4 else min(reach, 300)))
    value = SIZES[int(rng.integers(len(SIZES)))] & (256**width - 1)
    return data[:place] + struct.pack("<Q", value)[:width] + data[place + width :]


def forge_word(rng, data):
    """A number of a text, or of a header in JSON, replaced."""
    numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", data[:20_000]))
    if not numbers:
        return forge_size(rng, data)
    match = numbers[int(rng.integers(len(numbers)))]
    return data[: match.start()] + WORDS[int(rng.integers(len(WORDS)))] + data[match.end() :]


def forge_member(rng, data):
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


@pytest.mark.filterwarnings("ignore:.*(uneven times|lie between its frames):ssdr.SsdrWarning")
@pytest.mark.parametrize("written", [*WHOLE, *SEVERAL], indirect=True)
def test_damaged_and_forged_files_give_sound_arrays_or_an_error(written, rng, request):
    parts, read = written
    valid, refused = {part: part.read_bytes() for part in parts}, []
    whole = request.node.callspec.params["written"] in WHOLE
    for trial in range(100 if whole else 60):
        part = parts[int(rng.integers(len(parts)))]
        forge = (
            forge_member if valid[part].startswith(b"PK") else (forge_size, forge_word)[trial % 2]
        )
        damage = (flip, splice, forge, forge, forge)[trial % 5] if whole else forge
        part.write_bytes(damage(rng, valid[part]))
        try:
            arrays_of(read())
        except FormatError as error:
            refused.append(str(error))
        part.write_bytes(valid[part])
    assert refused
    assert all("valid" in said for said in refused)  # the name of the folder
