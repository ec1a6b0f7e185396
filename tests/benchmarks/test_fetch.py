"""Sequences are fetched as the catalogue says, or refused by name; the commands name what lacks."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import runpy
import subprocess
import sys
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

BOARD = common.ROOT / "benchmarks" / "leaderboard"


def run(script: Path, *words: str, data: Path | None = None) -> subprocess.CompletedProcess[str]:
    settings = {"PYTHONPATH": str(common.ROOT)} | ({"SSDR_TEST_DATA": str(data)} if data else {})
    return subprocess.run(
        [sys.executable, str(script), *words],
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | settings,
    )


NAMES = "cat_poses, cow_elastic, ea_bone, horse_gallop, horse_poses, ict_face_expressions, samba"


@pytest.mark.parametrize(
    ("script", "words", "said"),
    [
        ("leaderboard/score.py", [], f"no data for {NAMES}: expected NAME.npz in NOWHERE"),
        ("leaderboard/score.py", ["--only", "bowen"], "no data for bowen: expected NAME.npz in"),
        ("leaderboard/score.py", ["--only", "sheep"], "--only: no case contains sheep"),
        ("leaderboard/score.py", ["--solver", "best"], "no solver best: a Python file, or one of"),
        ("leaderboard/score.py", ["--solver", "no.py"], "no solver: no.py is not a file"),
        ("leaderboard/score.py", ["--model", "m.npz"], "--model needs --sequence"),
        (
            "leaderboard/score.py",
            ["--model", "m.npz", "--sequence", "cow"],
            "--sequence: cow: there",
        ),
        ("leaderboard/fetch.py", ["sheep"], "no sequence sheep: there are cat_poses"),
        ("bench.py", [], "no data for cow_elastic, ea_bone, fox"),
        ("bench.py", ["--only", "sheep-3"], "--only: no case contains sheep-3: ea_bone-10"),
        ("bench.py", ["--solver", "no.py"], "no solver: no.py is not a file"),
    ],
)
def test_what_is_missing_is_named_at_once(
    script: str, words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nowhere, out = tmp_path / "nowhere", tmp_path / "results"
    if script == "bench.py":
        pytest.importorskip("py_dem_bones")
        words = [*words, "--out", str(out)]
    elif script.endswith("score.py") and "--model" not in words:
        words = [*words, "--out", str(out / "rows.json")]
    monkeypatch.setenv("SSDR_TEST_DATA", str(nowhere))
    monkeypatch.setattr(sys, "argv", [script, *words])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(common.ROOT / "benchmarks" / script), run_name="__main__")
    found = str(end.value.code)
    assert not out.exists()
    if importlib.util.find_spec("py_dem_bones") is None and found.startswith("py_dem_bones"):
        return  # which is missing, too, and is named first
    assert found.startswith(said.replace("NOWHERE", str(nowhere)))


# --- a server in place of GitHub ---


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
    repository="owner/toy", commit="c" * 40, pattern=r"models/toy/\d+\.obj", files=12, every=2,
    first="models/first.obj", rest="models/rest.obj", vertices=4, licence="CC0", credit="nobody",
    fps=12.0,
)  # fmt: skip


def toy_files() -> tuple[np.ndarray, dict[str, bytes]]:
    """Positions (14, 5, 3) and files: the first, frames 1 to 12, the rest pose."""
    places = np.random.default_rng(0).standard_normal((14, 5, 3)).astype(np.float32)
    names = ["first", *(f"toy/{k}" for k in range(1, 13)), "rest"]
    faces = "f 1 2 3\nf 1 3 4\nf 1 2 5"
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
    return f"/owner/toy/{TOY.commit}/models/toy/{number}.obj"


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
    words = ("--solver", str(BOARD / "example_solver.py"), "--only", "aura", "--out", str(out))
    done = run(BOARD / "score.py", *words, data=data)
    assert done.returncode == 0, done.stderr
    for case in ("aura-40 K8 rigid", "aura-40 K8 affine", "aura-200 K32 rigid"):
        assert f"\n| {case} given, example_solver |" in done.stdout
    row = common.read_rows(out)["aura-40 K8 rigid given, example_solver"]
    assert (row["defects"], row["rest from"], row["influences found"]) == ("", "neutral face", 1)
