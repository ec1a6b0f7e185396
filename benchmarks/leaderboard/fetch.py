"""Fetch the leaderboard's sequences from where their owners publish them, and convert them.

    python benchmarks/leaderboard/fetch.py --list              # addresses, commits, licences
    python benchmarks/leaderboard/fetch.py                     # all of them, into out/data
    python benchmarks/leaderboard/fetch.py horse_gallop aura   # some of them

Every file is compared with the Git SHA-1 that the listing of its commit has of it, and what is
fetched already is not fetched again.  The converted vertices are compared with those that the
tables were made of.  Read the licences: most of this data may be used and not be given on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
import urllib.error
import urllib.request
from collections.abc import Sequence as Listed
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from benchmarks.leaderboard.catalogue import SEQUENCES, Sequence

API, RAW = "https://api.github.com", "https://raw.githubusercontent.com"
LISTING_BYTES = 1 << 26
TOGETHER = 8  # requests at a time
SECONDS = 60.0  # without an answer


class Entry(NamedTuple):
    """A file of a repository as its listing describes it."""

    path: str
    size: int
    sha1: str


class FetchError(Exception):
    """Something that was fetched is not what it should be."""


def download(url: str, most: int) -> bytes:
    """Content of an address, of at most so many bytes."""
    request = urllib.request.Request(url, headers={"User-Agent": "ssdr-leaderboard"})
    try:
        with urllib.request.urlopen(request, timeout=SECONDS) as answer:
            data: bytes = answer.read(most + 1)
    except urllib.error.HTTPError as error:
        error.close()  # it holds the connection
        raise FetchError(f"{url}: {error}") from error
    except (OSError, ValueError) as error:  # of urllib, too
        raise FetchError(f"{url}: not reached: {getattr(error, 'reason', error)}") from error
    if len(data) > most:
        raise FetchError(f"{url}: expected at most {most:,} bytes, got more")
    return data


def listing(sequence: Sequence, mirror: str | None) -> list[Entry]:
    """Every file of the commit."""
    url = f"{mirror or API}/repos/{sequence.repository}/git/trees/{sequence.commit}?recursive=1"
    try:
        found = json.loads(download(url, LISTING_BYTES))
        entries = [Entry(e["path"], e["size"], e["sha"]) for e in found["tree"] if "size" in e]
    except (ValueError, TypeError, KeyError) as error:
        raise FetchError(f"{url}: not a listing of files: {error!r}") from error
    if found.get("truncated"):
        raise FetchError(f"{url}: the listing is cut off")
    return entries


def natural(entry: Entry) -> list[Any]:
    return [int(word) if word.isdecimal() else word for word in re.split(r"(\d+)", entry.path)]


def chosen(sequence: Sequence, entries: Listed[Entry]) -> list[Entry]:
    """Files of the frames in their order, then that of the rest pose, if there is one."""
    frames = sorted((e for e in entries if re.fullmatch(sequence.pattern, e.path)), key=natural)
    if len(frames) != sequence.files:
        raise FetchError(f"{sequence.pattern}: expected {sequence.files} files, got {len(frames)}")
    by_path = {e.path: e for e in entries}
    if missing := [p for p in (sequence.first, sequence.rest) if p and p not in by_path]:
        raise FetchError(f"{missing[0]}: the commit has no such file")
    first, rest = ([by_path[p]] if p else [] for p in (sequence.first, sequence.rest))
    return [*first, *frames[:: sequence.every], *rest]


def git_sha1(data: bytes) -> str:
    """SHA-1 by which Git knows a file's content."""
    return hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()


def fetch(entry: Entry, sequence: Sequence, mirror: str | None, target: Path) -> Path:
    """Fetch one file, unless it is there."""
    if target.is_file() and git_sha1(target.read_bytes()) == entry.sha1:
        return target
    url = f"{mirror or RAW}/{sequence.repository}/{sequence.commit}/{entry.path}"
    data = download(url, entry.size)
    if (got := git_sha1(data)) != entry.sha1:
        raise FetchError(f"{url}: expected the Git SHA-1 {entry.sha1}, got {got}")
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_suffix(".part")
    part.write_bytes(data)
    part.replace(target)
    return target


def read_compskin(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Frames (1 + S, V, 3) and faces of a face of Kavan et al. 2024: neutral, then its S shapes.

    Their npz holds `rest_verts` (V, 3), `deltas` (S, V, 3) and quads `rest_faces`.  Nothing is
    unpickled: what describes their rig is not read.
    """
    with np.load(path) as archive:
        rest, deltas, quads = (archive[k] for k in ("rest_verts", "deltas", "rest_faces"))
    if deltas.ndim != 3 or rest.shape != deltas.shape[1:] or quads.shape[1:] not in ((3,), (4,)):
        shapes = f"{rest.shape}, {deltas.shape} and {quads.shape}"
        raise FetchError(f"{path}: expected (V, 3), (S, V, 3) and (Q, 4) arrays, got {shapes}")
    frames = np.concatenate([rest[None], rest + deltas]).astype(np.float32)
    fans = [quads[:, [0, k, k + 1]] for k in range(1, quads.shape[1] - 1)]
    return frames, np.stack(fans, axis=1).reshape(-1, 3).astype(np.int32)


def convert(sequence: Sequence, files: Listed[Path]) -> dict[str, np.ndarray]:
    """Arrays of the npz file of a sequence."""
    import ssdr

    frames = files[: -1 if sequence.rest else None]
    if frames[0].suffix == ".npz":
        vertices, faces = read_compskin(frames[0])
    else:
        # OBJ files lie in a folder, one a frame
        read = ssdr.load(frames[0].parent if frames[0].suffix == ".obj" else frames[0])
        if sequence.weld:
            read, _ = read.weld()
        vertices, faces = np.asarray(read.vertices, dtype=np.float32), read.faces
    if sequence.vertices is not None:
        faces = faces[(faces < sequence.vertices).all(axis=1)]
        vertices = vertices[:, : sequence.vertices]
    found = {"vertices": vertices, "faces": faces, "fps": np.float32(sequence.fps)}
    if sequence.rest:
        found["rest"] = np.asarray(ssdr.load(files[-1]).vertices[0])
    return found


def same_as_the_tables(sequence: Sequence, vertices: np.ndarray) -> bool | None:
    """Whether vertices are, to the bit, those of the tables; None if no table has them."""
    if sequence.sha256 is None:
        return None
    data = np.ascontiguousarray(vertices, dtype="<f4").tobytes()
    return hashlib.sha256(data).hexdigest() == sequence.sha256


def get(name: str, sequence: Sequence, folder: Path, mirror: str | None = None) -> Path:
    """Fetch and convert a sequence; returns its npz file."""
    print(f"{name}: {sequence.credit}\n  github.com/{sequence.repository} at {sequence.commit}")
    print(f"  licence: {sequence.licence}", flush=True)
    entries = chosen(sequence, listing(sequence, mirror))
    home, last = folder / "originals" / name, len(entries) - 1
    targets = [
        home / ("rest" if sequence.rest and k == last else "frames") / f"{k:04}{suffix}"
        for k, suffix in enumerate(Path(e.path).suffix for e in entries)
    ]
    with ThreadPoolExecutor(TOGETHER) as pool:
        one = lambda entry, target: fetch(entry, sequence, mirror, target)  # noqa: E731
        files = list(pool.map(one, entries, targets))
    arrays = convert(sequence, files)
    path = folder / f"{name}.npz"
    part = folder / f"{name}.part"
    with part.open("wb") as file:
        np.savez_compressed(file, **arrays)
    part.replace(path)
    frames, n = arrays["vertices"].shape[:2]
    word = {True: "the vertices of the tables", False: "not to the bit the vertices of the tables"}
    same = same_as_the_tables(sequence, arrays["vertices"])
    print(f"  {path}: {frames} frames, {n} vertices; {word.get(same, 'no table has it yet')}")
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="all by default")
    parser.add_argument("--list", action="store_true", help="what there is, with its licence")
    default = common.data_folders()[-1]
    parser.add_argument("--to", type=Path, default=default, help=f"folder, by default {default}")
    parser.add_argument("--mirror", metavar="URL", help="in place of GitHub's two addresses")
    args = parser.parse_args()
    if unknown := set(args.names) - set(SEQUENCES):
        sys.exit(f"no sequence {', '.join(unknown)}: there are {', '.join(SEQUENCES)}")
    chosen_names = args.names or [*SEQUENCES]
    if args.list:
        rows = [{"name": n, **vars(SEQUENCES[n])} for n in chosen_names]
        print(common.table(rows, ["name", "repository", "commit", "licence", "credit"]))
        return
    failed = []
    for name in chosen_names:
        if common.sequence_file(name).is_file():
            print(f"{name}: {common.sequence_file(name)} is there")
            continue
        args.to.mkdir(parents=True, exist_ok=True)
        try:
            get(name, SEQUENCES[name], args.to, args.mirror)
        except Exception as error:  # the others may be there
            failed.append(name)
            print(f"  {error}", file=sys.stderr)
    if failed:
        sys.exit(f"not fetched: {', '.join(failed)}")


if __name__ == "__main__":
    main()
