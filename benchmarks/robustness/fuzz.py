"""Damaged files of every format: a reader returns finite arrays or raises FormatError, no more.

    python benchmarks/robustness/fuzz.py --minutes 10 --out out/fuzz
    python benchmarks/robustness/fuzz.py --case 1234  # one file again, kept in the folder --out

A seed chooses a valid file, one to three kinds of damage (cut off, bytes flipped, removed,
inserted or repeated, numbers made enormous, negative or NaN, parts of another file) and reads
it.  A worker with little memory does the reading and a second process watches: a hang, a crash
or a MemoryError is a line of failures with its seed, and the next file follows.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import io
import json
import os
import re
import resource
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import revision, write_json
from benchmarks.robustness.soak import Watchdog
from helpers import motions
from ssdr.io import read_weights

MEMORY = 3 << 30  # bytes of address space beyond what is there before the first file
CPU_LIMIT = 60.0  # seconds of one file; nearly all of them are read in milliseconds
WALL_LIMIT = 1800.0  # for what waits for ever without computing


@dataclasses.dataclass(frozen=True)
class Sample:
    """A valid file (or folder) and how it is read."""

    path: Path
    read: Callable[[Path], Any]

    @property
    def parts(self) -> list[Path]:
        """The files that can be damaged."""
        if self.path.is_dir():
            return sorted(p for p in self.path.rglob("*") if p.is_file())
        return sorted(p for p in self.path.parent.iterdir() if p.is_file())


def samples(folder: Path) -> dict[str, Sample]:
    """One small file of every format that is read here, each in a folder of its own."""
    rig = motions.chain(bones=3, rows=5, ring=4, frames=3)
    rng = np.random.default_rng(0)
    uv = rng.random((len(rig.faces), 3, 2)).astype(np.float32)
    surface = ssdr.Surface(uv=uv, materials=(ssdr.Material(name="skin"),))
    sequence = ssdr.MeshSequence(rig.frames.astype(np.float32), rig.faces, 25.0, surface=surface)
    bare = ssdr.MeshSequence(sequence.vertices, rig.faces, 25.0)
    skinning = ssdr.Skinning(
        rig.rest, rig.indices, rig.weights, rig.transforms, faces=rig.faces, surface=surface
    )
    found: dict[str, Sample] = {}

    def add(name: str, file: str, thing: Any, read: Callable[[Path], Any], **options: Any) -> None:
        path = folder / re.sub(r"\W", "_", name) / file
        path.parent.mkdir()
        ssdr.save(thing, path, **options)
        found[name] = Sample(path, read)

    n = sequence.n_vertices
    add("npz", "a.npz", sequence, ssdr.load, compress=False)
    add("npz, packed", "a.npz", sequence, ssdr.load, compress=True)
    add("npz, skinning", "a.npz", skinning, ssdr.load_skinning)
    add("npy", "a.npy", bare, lambda p: ssdr.load(p, faces=rig.faces))
    add("pc2", "a.pc2", bare, lambda p: ssdr.load(p, mesh=rig.faces))
    add("mdd", "a.mdd", bare, lambda p: ssdr.load(p, mesh=rig.faces))
    for suffix in ("obj", "ply"):
        add(suffix, f"a_%d.{suffix}", sequence, lambda p: ssdr.load(p.parent))
    add("csv", "a.csv", skinning, lambda p: read_weights(p, n_vertices=n))
    for suffix in ("glb", "gltf"):
        add(suffix, f"a.{suffix}", skinning, ssdr.load)
        add(f"{suffix}, skinning", f"a.{suffix}", skinning, ssdr.load_skinning)
    if importlib.util.find_spec("pxr"):
        for suffix in ("usda", "usdc"):
            add(suffix, f"a.{suffix}", bare, ssdr.load)
            add(f"{suffix}, skinning", f"a.{suffix}", skinning, ssdr.load_skinning)
    if importlib.util.find_spec("zarr"):
        add("zarr", "a.zarr", bare, lambda p: ssdr.load(p, faces=rig.faces))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ssdr.SsdrWarning)
        result = ssdr.decompose(bare, bones=2, effort="fast", max_iterations=3)
    path = folder / "state" / "a.npz"
    path.parent.mkdir()
    result.state.save(path)
    found["state"] = Sample(path, ssdr.SolverState.load)
    for suffix in ("off", "stl"):
        import trimesh

        (folder / suffix).mkdir()
        for k in range(2):
            mesh = trimesh.Trimesh(bare.vertices[k], bare.faces, process=False)
            mesh.export(folder / suffix / f"a_{k}.{suffix}")
        found[suffix] = Sample(folder / suffix / f"a_0.{suffix}", lambda p: ssdr.load(p.parent))
    return found


# damage


def cut(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    return data[: int(rng.integers(0, len(data) + 1))]


def flip(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    out = bytearray(data)
    reach = len(out) if rng.random() < 0.5 else min(len(out), 400)
    for place in rng.integers(0, max(reach, 1), int(rng.integers(1, 9))):
        if len(out):
            out[place] = (
                int(rng.integers(256))
                if rng.random() < 0.5
                else out[place] ^ 1 << int(rng.integers(8))
            )
    return bytes(out)


def remove(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    a = int(rng.integers(0, len(data) + 1))
    return data[:a] + data[a + int(rng.integers(1, 200)) :]


def insert(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    a = int(rng.integers(0, len(data) + 1))
    return data[:a] + rng.bytes(int(rng.integers(1, 60))) + data[a:]


def repeat(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    a, b = np.sort(rng.integers(0, len(data) + 1, 2))
    return data[:b] + data[a : min(b, a + 500)] * int(rng.integers(1, 4)) + data[b:]


def zero(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    a = int(rng.integers(0, len(data) + 1))
    b = min(len(data), a + int(rng.integers(1, 300)))
    return data[:a] + bytes(b - a) + data[b:]


def graft(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    a, b = int(rng.integers(0, len(data) + 1)), int(rng.integers(0, len(other) + 1))
    return (
        data[:a] + other[b : b + int(rng.integers(1, 2000))] + data[a:][: int(rng.integers(5000))]
    )


SIZES = [0, -1, 1, 2**31 - 1, -(2**31), 2**32 - 1, 2**62, 2**63 - 1, -(2**63), 10**9, 65_536]


def size(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    """A whole number of 2, 4 or 8 bytes where a count or an offset may stand."""
    out = bytearray(data)
    width, kind = [(2, "h"), (4, "i"), (8, "q")][int(rng.integers(3))]
    if len(out) < width:
        return data
    reach = len(out) - width + 1
    place = int(rng.integers(0, reach if rng.random() < 0.4 else min(reach, 300)))
    value = int(rng.choice(np.array(SIZES, dtype=object))) & (256**width - 1)
    packed = struct.pack(("<" if rng.random() < 0.8 else ">") + kind.upper(), value)
    out[place : place + width] = packed
    return bytes(out)


WORDS = [b"0", b"-1", b"nan", b"inf", b"-inf", b"1e999", b"999999999999999999999", b"4294967296",
         b"1e-400", b"x", b"null", b"[]", b"{}", b'"', b"true", b"0x7f", b"-0", b"1.5"]  # fmt: skip


def word(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    """A number of a text, or of a header in JSON, replaced."""
    numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", data[:20_000]))
    if not numbers:
        return flip(rng, data, other)
    match = numbers[int(rng.integers(len(numbers)))]
    return data[: match.start()] + WORDS[int(rng.integers(len(WORDS)))] + data[match.end() :]


def inside(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    """A member of an archive damaged, with a right checksum; anything else as it is."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as source:
            members = {name: source.read(name) for name in source.namelist()}
    except Exception:  # whatever Python's own reader says of what is damaged already
        return data
    if not members:
        return data
    name = sorted(members)[int(rng.integers(len(members)))]
    change = [cut, flip, size, word, word, zero, remove][int(rng.integers(7))]
    members[name] = change(rng, members[name], other)
    if rng.random() < 0.1:
        del members[sorted(members)[int(rng.integers(len(members)))]]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as target:
        for key, value in members.items():
            target.writestr(key, value)
    return out.getvalue()


DAMAGE = [cut, flip, flip, remove, insert, repeat, zero, graft, size, size, word, word]


def damaged(seed: int, kinds: dict[str, Sample], folder: Path) -> tuple[str, Sample, str]:
    """The name of a format, a damaged copy of its sample, and what was done to it."""
    rng = np.random.default_rng(seed)
    name = sorted(kinds)[int(rng.integers(len(kinds)))]
    other = kinds[sorted(kinds)[int(rng.integers(len(kinds)))]]
    source = kinds[name]
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source.path.parent, folder)
    copy = Sample(folder / source.path.name, source.read)
    part = copy.parts[int(rng.integers(len(copy.parts)))]
    data = part.read_bytes()
    foreign = other.parts[0].read_bytes()
    done = []
    for _ in range(int(rng.integers(1, 4))):
        change = DAMAGE[int(rng.integers(len(DAMAGE)))]
        if data[:2] == b"PK" and rng.random() < 0.7:
            change = inside  # checksums would catch the rest
        data = change(rng, data, foreign)
        done.append(change.__name__)
    part.write_bytes(data)
    return name, copy, " ".join(done)


def unsound(thing: Any) -> str:
    """What is wrong with a result; empty if nothing is."""
    arrays: dict[str, Any] = {
        k: v for k, v in vars(thing).items() if hasattr(v, "shape") and hasattr(v, "dtype")
    }
    for prefix in ("current", "best"):
        model = getattr(thing, prefix, None)
        if model is not None:
            parts = vars(model) | (vars(model.tree) if model.tree is not None else {})
            parts = {k: v for k, v in parts.items() if k not in ("tree", "rigid")}
            arrays |= {f"{prefix} {k}": v for k, v in parts.items()}
    if not arrays:
        return "no arrays"
    for name, array in arrays.items():
        values = np.asarray(array)
        if values.dtype.kind not in "fiu" or not np.isfinite(values).all():
            return f"{name} not finite"
    faces, n = arrays.get("faces"), getattr(thing, "n_vertices", None)
    if faces is None or n is None or not faces.size:
        return ""
    inside = int(np.min(faces)) >= 0 and int(np.max(faces)) < n
    return "" if inside else "faces out of range"


def try_case(seed: int, kinds: dict[str, Sample], folder: Path) -> dict[str, Any]:
    """What came of one file."""
    name, copy, done = damaged(seed, kinds, folder)
    line: dict[str, Any] = {"seed": seed, "format": name, "damage": done, "fault": ""}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            line["outcome"] = "read"
            line["fault"] = unsound(copy.read(copy.path))
    except ssdr.FormatError as error:
        line["outcome"] = "refused"
        if str(folder) not in str(error):
            line["fault"] = f"does not name the file: {error}"
    except Exception as error:
        line["outcome"] = "other"
        line["fault"] = f"{type(error).__name__}: {str(error)[:200]}"
    return line


# the worker and its watcher


def work(out: Path, first: int, seconds: float) -> None:
    with tempfile.TemporaryDirectory() as folder, (out / "cases.jsonl").open("a") as log:
        kinds = samples(Path(folder))
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        end = time.monotonic() + seconds
        seed = first
        watchdog = Watchdog(out, CPU_LIMIT, WALL_LIMIT)
        while time.monotonic() < end:
            with watchdog.over(seed):
                line = try_case(seed, kinds, Path(folder) / "case")
            log.write(json.dumps(line) + "\n")
            log.flush()
            seed += 1


def watch_over(out: Path, seconds: float, first: int) -> dict[str, Any]:
    out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + seconds
    log = out / "cases.jsonl"
    while (left := end - time.monotonic()) > 0:
        done = [json.loads(x)["seed"] for x in log.read_text().splitlines()] if log.exists() else []
        seed = max(done, default=first - 1) + 1
        child = subprocess.run(
            [sys.executable, __file__, "--out", str(out), "--work", str(seed), str(left)],
            check=False,
        )
        if child.returncode == 70:
            raise SystemExit(70)
        if child.returncode:
            seed = int((out / "running").read_text())
            what = "hang" if child.returncode == 1 else f"crash ({child.returncode})"
            with log.open("a") as file:
                file.write(json.dumps({"seed": seed, "outcome": "other", "fault": what}) + "\n")
    cases = [json.loads(x) for x in log.read_text().splitlines()]
    formats: dict[str, Counter[str]] = {}
    for case in cases:
        formats.setdefault(case.get("format", "?"), Counter())[case["outcome"]] += 1
    summary = {
        "revision": revision(),
        "files": len(cases),
        "refused": sum(c["outcome"] == "refused" for c in cases),
        "formats": {k: dict(v) for k, v in sorted(formats.items())},
        "failures": [c for c in cases if c["fault"]],
    }
    write_json(out / "summary.json", summary)
    return summary


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--first", type=int, default=0, help="first seed of a new run")
    parser.add_argument("--case", type=int, metavar="SEED", help="one file again")
    parser.add_argument("--work", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.work:
        try:
            work(args.out, int(args.work[0]), float(args.work[1]))
        except Exception:
            traceback.print_exc()
            return 70  # a fault of this program, not of a reader
        return 0
    if args.case is not None:
        with tempfile.TemporaryDirectory() as folder:
            kinds = samples(Path(folder))
            line = try_case(args.case, kinds, args.out / f"case_{args.case}")
        print(json.dumps(line, indent=1))
        return 1 if line["fault"] else 0
    summary = watch_over(args.out, 60 * args.minutes, args.first)
    print(json.dumps(summary, indent=1))
    return 1 if summary["failures"] else 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
