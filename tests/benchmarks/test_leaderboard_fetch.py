"""Fetching the leaderboard's sequences, from a server on this machine in place of GitHub."""

from __future__ import annotations

import dataclasses
import json
import subprocess
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from benchmarks import common
from benchmarks.leaderboard import fetch
from benchmarks.leaderboard.catalogue import SEQUENCES, Sequence
from benchmarks.peers import slot
from helpers.leaderboard import BOARD, EXAMPLE, needs, run

COMMIT = "c" * 40


# --- a server in place of GitHub -----------------------------------------------------------------


@dataclasses.dataclass
class Server:
    """What it serves, by path, and the paths that it was asked for."""

    url: str
    content: dict[str, bytes]
    asked: list[str]

    def publish(self, sequence: Sequence, files: dict[str, bytes]) -> None:
        """Serve files and the listing of their commit, as GitHub does."""
        home = f"/{sequence.repository}/{sequence.commit}/"
        self.content |= {home + path: data for path, data in files.items()}
        tree: list[dict[str, Any]] = [{"path": "models", "type": "tree", "sha": "0"}]
        for path, data in files.items():
            tree.append({"path": path, "size": len(data), "sha": git_hash(data)})
        listing = json.dumps({"tree": tree, "truncated": False}).encode()
        self.content[tree_path(sequence)] = listing


def tree_path(sequence: Sequence) -> str:
    return f"/repos/{sequence.repository}/git/trees/{sequence.commit}?recursive=1"


def git_hash(data: bytes) -> str:
    """Hash of a file by Git itself."""
    done = subprocess.run(["git", "hash-object", "--stdin"], input=data, capture_output=True)
    return done.stdout.decode().strip()


@pytest.fixture
def server() -> Iterator[Server]:
    content: dict[str, bytes] = {}
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            data = content.get(self.path)
            self.send_response(404 if data is None else 200)
            self.end_headers()
            self.wfile.write(data or b"")

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        thread = Thread(target=http.serve_forever)
        thread.start()
        yield Server(f"http://127.0.0.1:{http.server_port}", content, asked)
        http.shutdown()
        thread.join()


def obj(vertices: np.ndarray, faces: str) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, dtype=float).tolist()]
    return ("\n".join([*lines, faces]) + "\n").encode()


TOY = Sequence(
    repository="owner/toy", commit=COMMIT, pattern=r"models/toy/\d+\.obj", files=12, every=2,
    first="models/first.obj", rest="models/rest.obj", vertices=4, licence="CC0", credit="nobody",
    fps=12.0,
)  # fmt: skip


def toy_files() -> tuple[np.ndarray, dict[str, bytes]]:
    """Positions (14, 5, 3) and files: the first, frames 1 to 12, the rest pose."""
    places = np.random.default_rng(0).standard_normal((14, 5, 3)).astype(np.float32)
    names = ["first", *(f"toy/{k}" for k in range(1, 13)), "rest"]
    faces = "f 1 2 3 4\nf 1 2 5"
    files = {f"models/{n}.obj": obj(p, faces) for n, p in zip(names, places, strict=True)}
    return places, files | {"models/toy/notes.txt": b"no frame"}


def test_frames_come_in_their_order_and_as_the_catalogue_says(
    server: Server, tmp_path: Path
) -> None:
    places, files = toy_files()
    server.publish(TOY, files)
    path = fetch.get("toy", TOY, tmp_path, server.url)
    with np.load(path) as archive:
        np.testing.assert_array_equal(archive["vertices"], places[[0, 1, 3, 5, 7, 9, 11], :4])
        np.testing.assert_array_equal(archive["faces"], [[0, 1, 2], [0, 2, 3]])
        np.testing.assert_array_equal(archive["rest"], places[13])
        assert archive["fps"] == 12.0
    # eight files, and not what the catalogue leaves out
    assert len(server.asked) == 1 + 8
    server.asked.clear()
    fetch.get("toy", TOY, tmp_path, server.url)
    assert server.asked == [tree_path(TOY)]


def _file(number: int) -> str:
    return f"/owner/toy/{COMMIT}/models/toy/{number}.obj"


def test_an_address_that_is_not_reached_is_said_to_be() -> None:
    with pytest.raises(fetch.FetchError, match=r"^http://\S+: not reached: \[Errno \d+\] \w"):
        fetch.download("http://127.0.0.1:1/nobody", 10)


def _listed(content: dict[str, bytes], left_out: str = "-", **more: object) -> None:
    """Leave a file out of the listing, or say more in it."""
    tree = json.loads(content[tree_path(TOY)])
    tree["tree"] = [e for e in tree["tree"] if not e["path"].endswith(left_out)]
    content[tree_path(TOY)] = json.dumps(tree | more).encode()


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda c: c.update({_file(3): c[_file(3)].replace(b"v ", b"v 1", 1)[:-1]}),
         r"models/toy/3\.obj: expected the Git SHA-1 \w{40}, got \w{40}"),
        (lambda c: c.pop(_file(5)), r"models/toy/5\.obj: HTTP Error 404"),
        (lambda c: c.update({_file(7): c[_file(7)] + b"#" * 1000}),
         r"models/toy/7\.obj: expected at most [\d,]+ bytes"),
        (lambda c: _listed(c, "/9.obj"), r"expected 12 files, got 11"),
        (lambda c: _listed(c, "rest.obj"), r"models/rest\.obj: the commit has no such file"),
        (lambda c: _listed(c, truncated=True), r"the listing is cut off"),
        (lambda c: c.update({tree_path(TOY): b"[1, 2]"}), r"not a listing of files"),
    ],
)  # fmt: skip
def test_what_is_not_as_it_should_be_is_refused_by_name(
    damage: Callable[[dict[str, bytes]], object], word: str, server: Server, tmp_path: Path
) -> None:
    server.publish(TOY, toy_files()[1])
    damage(server.content)
    with pytest.raises(fetch.FetchError, match=word):
        fetch.get("toy", TOY, tmp_path, server.url)
    assert not (tmp_path / "toy.npz").exists()


def face() -> dict[str, np.ndarray]:
    """A face as Kavan et al. publish theirs, with parts that only unpickling could read."""
    rng = np.random.default_rng(1)
    return {
        "rest_verts": rng.standard_normal((60, 3)),
        "deltas": 0.1 * rng.standard_normal((9, 60, 3)),
        "rest_faces": np.stack([np.arange(k, k + 50) for k in range(4)], axis=1),
        "inbetween_info": np.array({"a": 1}, dtype=object),
    }


def test_the_reader_of_faces_unpickles_nothing(tmp_path: Path) -> None:
    arrays = face()
    np.savez(tmp_path / "aura.npz", **arrays)  # type: ignore[arg-type]
    frames, faces = fetch.read_compskin(tmp_path / "aura.npz")
    assert (frames.shape, frames.dtype) == ((10, 60, 3), np.float32)
    np.testing.assert_allclose(frames[0], arrays["rest_verts"], rtol=1e-6)
    np.testing.assert_allclose(frames[4] - frames[0], arrays["deltas"][3], atol=1e-6)
    assert faces.tolist()[:2] == [[0, 1, 2], [0, 2, 3]]
    assert len(faces) == 100
    np.savez(tmp_path / "flat.npz", **(arrays | {"deltas": np.zeros((9, 59, 3))}))  # type: ignore[arg-type]
    with pytest.raises(
        fetch.FetchError, match=r"expected \(V, 3\), \(S, V, 3\) and \(Q, 4\) arrays"
    ):
        fetch.read_compskin(tmp_path / "flat.npz")


# --- the commands --------------------------------------------------------------------------------


@pytest.mark.slow
def test_one_command_fetches_and_one_scores_the_example(server: Server, tmp_path: Path) -> None:
    np.savez(tmp_path / "face.npz", **face())  # type: ignore[arg-type]
    files = {f"in/{name}.npz": (tmp_path / "face.npz").read_bytes() for name in ("aura", "bowen")}
    server.publish(SEQUENCES["aura"], files)
    del server.content[f"/facebookresearch/compskin/{SEQUENCES['bowen'].commit}/in/bowen.npz"]
    data = tmp_path / "data"
    words = ("aura", "bowen", "--mirror", server.url, "--to", str(data))
    done = run(BOARD / "fetch.py", *words, data=data)
    assert done.returncode == 1
    assert "licence: Apache-2.0" in done.stdout
    assert "10 frames, 60 vertices; no table has it yet" in done.stdout
    assert "in/bowen.npz: HTTP Error 404" in done.stderr
    assert done.stderr.endswith("not fetched: bowen\n")
    assert "is there" in run(BOARD / "fetch.py", "aura", data=data).stdout

    out = tmp_path / "rows.json"
    words = ("--solver", str(EXAMPLE), "--only", "aura", "--out", str(out))
    done = run(BOARD / "score.py", *words, data=data)
    assert done.returncode == 0, done.stderr
    for case in ("aura-40 K8 rigid", "aura-40 K8 affine", "aura-200 K32 rigid"):
        assert f"\n| {case} given, example_solver |" in done.stdout
    row = common.read_rows(out)["aura-40 K8 rigid given, example_solver"]
    assert (row["defects"], row["rest from"], row["influences found"]) == ("", "neutral face", 1)

    frames, faces = fetch.read_compskin(tmp_path / "face.npz")
    solve = slot.solver_of(str(EXAMPLE))
    parts = solve(
        frames[1:], faces, bones=40, influences=8, bone_model="rigid", rest=frames[0].astype(float)
    )
    moves = parts.transforms[:, parts.weights.argmax(axis=1)]
    moved = np.einsum("fvij,vj->fvi", moves[..., :3], parts.rest) + moves[..., 3]
    off = np.abs(moved - frames[1:])
    assert row["MXE"] == pytest.approx(10 * off.max(), rel=1e-6)
    assert row["MAE"] == pytest.approx(10 * off.mean(), rel=1e-6)
    assert row["E"] == pytest.approx(1000 * np.sqrt((off**2).mean()), rel=1e-6)


# --- the data, where it is here ------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n, s in SEQUENCES.items() if s.sha256])
def test_the_catalogue_knows_the_vertices(name: str) -> None:
    frames = needs(name)
    assert fetch.same_as_the_tables(SEQUENCES[name], frames)
    frames[0, 0, 0] += np.float32(1e-3)
    assert fetch.same_as_the_tables(SEQUENCES[name], frames) is False
