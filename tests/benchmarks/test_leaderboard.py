"""The leaderboard: scores by hand, rules, words for what is missing."""

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

import ssdr
from benchmarks import common
from benchmarks.leaderboard import catalogue, fetch, score, tables
from benchmarks.leaderboard.catalogue import SEQUENCES, Sequence
from benchmarks.peers import slot

BOARD = common.ROOT / "benchmarks" / "leaderboard"
EXAMPLE = BOARD / "example_solver.py"


def run(script: Path, *words: str, data: Path | None = None) -> subprocess.CompletedProcess[str]:
    settings = {"PYTHONPATH": str(common.ROOT)} | ({"SSDR_TEST_DATA": str(data)} if data else {})
    return subprocess.run(
        [sys.executable, str(script), *words],
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | settings,
    )


def needs(name: str) -> np.ndarray:
    if not common.sequence_file(name).is_file():
        pytest.skip(f"no data for {name}")
    return common.load(name)[0]


ROOT = common.ROOT
TOY = Sequence(
    repository="owner/toy", commit="c" * 40, pattern=r"models/toy/\d+\.obj", files=6, licence="CC0",
    credit="nobody",
)  # fmt: skip


# --- the commands --------------------------------------------------------------------------------


def test_the_example_has_ten_lines_and_is_that_of_the_page() -> None:
    text = EXAMPLE.read_text("utf-8")
    body = text[text.index("def solve") :].strip()
    assert len(body.splitlines()) <= 10
    assert body in (ROOT / "docs" / "benchmarks.md").read_text("utf-8")


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
        ("peers/race.py", ["--parts", "race"], "no data for cow_elastic, ea_bone, fox"),
        ("peers/race.py", ["--only", "sheep-3"], "--only: sheep-3: there are ea_bone-10"),
        ("peers/race.py", ["--solvers", "own"], "--solvers: own: there are dembones default"),
    ],
)
def test_what_is_missing_is_named_at_once(
    script: str, words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nowhere, out = tmp_path / "nowhere", tmp_path / "results"
    if script.startswith("peers"):
        words = [*words, "--results", str(out), "--images", str(out)]
    elif script.endswith("score.py") and "--model" not in words:
        words = [*words, "--out", str(out / "rows.json")]
    monkeypatch.setenv("SSDR_TEST_DATA", str(nowhere))
    monkeypatch.setattr(sys, "argv", [script, *words])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(ROOT / "benchmarks" / script), run_name="__main__")
    found = str(end.value.code)
    assert not out.exists()
    if importlib.util.find_spec("py_dem_bones") is None and found.startswith("py_dem_bones"):
        return  # which is missing, too, and is named first
    assert found.startswith(said.replace("NOWHERE", str(nowhere)))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def solver(): ...", "has no function solve"),
        ("import no_such_package", "needs what is not installed: No module named 'no_such_pack"),
        ("def solve(frames faces): ...", r"no solver: .*mine\.py: SyntaxError: "),
        ("raise RuntimeError('no licence')", r"no solver: .*mine\.py: RuntimeError: no licence"),
    ],
)
def test_a_file_that_is_no_solver_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(SystemExit, match=said):
        slot.solver_of(str(path))


def test_shapes_that_do_not_fit_are_named(tmp_path: Path) -> None:
    good = np.zeros((5, 3)), np.zeros((5, 2)), np.zeros((7, 2, 3, 4))
    assert slot.parts_of(good, "mine.py", (7, 5, 3)).transforms.shape == (7, 2, 3, 4)
    for k, part, said in (
        (0, np.zeros((4, 3)), r"mine.py: rest: expected shape \(5, 3\), got \(4, 3\)"),
        (1, np.zeros((4, 2)), r"weights: expected shape \(5, 2\), got \(4, 2\)"),
        (2, np.zeros((7, 2, 4, 4)), r"expected shape \(7, 2, 3, 4\), .* pass m\[\.\.\., :3, :\]"),
        (1, np.full((5, 2), np.nan), r"weights: expected finite numbers, got NaN or Inf"),
    ):
        bad = [*good[:k], part, *good[k + 1 :]]
        with pytest.raises(SystemExit, match=said):
            slot.parts_of(bad, "mine.py", (7, 5, 3))
    with pytest.raises(SystemExit, match=r"expected rest, weights, transforms"):
        slot.parts_of(None, "mine.py", (7, 5, 3))


def test_a_model_is_read_from_arrays_and_from_the_packages_files(tmp_path: Path) -> None:
    model = ssdr.initialize(ssdr.samples.load("dancer_small"), bones=5, influences=3)
    ssdr.save(model, tmp_path / "own.npz")
    weights = np.zeros((model.n_vertices, 5))
    np.add.at(weights, (np.arange(len(weights))[:, None], model.indices), model.weights)
    arrays = {"rest": model.rest, "weights": weights, "transforms": model.transforms}
    np.savez(tmp_path / "plain.npz", **arrays)
    for name in ("own", "plain"):
        parts = slot.read(tmp_path / f"{name}.npz")
        assert parts.bone_model == "rigid"
        for part, expected in zip(parts, arrays.values(), strict=False):
            np.testing.assert_allclose(part, expected, atol=1e-6)
    arrays["transforms"] = 1.1 * model.transforms
    np.savez(tmp_path / "plain.npz", **arrays)
    assert slot.read(tmp_path / "plain.npz").bone_model == "affine"
    with pytest.raises(SystemExit, match=r"no model: .*none\.npz is not a file"):
        slot.read(tmp_path / "none.npz")
    np.savez(tmp_path / "named.npz", rest=model.rest, W=weights, M=model.transforms)
    np.savez(tmp_path / "objects.npz", **(arrays | {"rest": np.array([None])}))
    (tmp_path / "text.npz").write_text("no archive")
    (tmp_path / "text.glb").write_text("no model")
    for bad in ("named.npz", "objects.npz", "text.npz", "text.glb"):
        with pytest.raises(SystemExit, match=r"no model: .*what ssdr\.load_skinning reads"):
            slot.read(tmp_path / bad)


# --- scores --------------------------------------------------------------------------------------


def toy_problem(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, **more: Any) -> np.ndarray:
    """A sequence "toy" in a data folder of its own; returns its frames."""
    frames = np.random.default_rng(2).standard_normal((6, 20, 3)).astype(np.float32)
    faces = np.stack([np.arange(k, k + 18) for k in range(3)], axis=1)
    np.savez(tmp_path / "toy.npz", vertices=frames, faces=faces)
    monkeypatch.setenv("SSDR_TEST_DATA", str(tmp_path))
    monkeypatch.setitem(SEQUENCES, "toy", dataclasses.replace(TOY, **more))
    return frames


def test_a_score_by_hand(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    frames = toy_problem(monkeypatch, tmp_path, diagonal=5.0, millimetres=10.0)
    off = np.zeros((6, 20, 3))
    off[2, 7] = (0.3, -0.4, 0.0)
    _, faces, rest, source, diagonal = score.problem("toy")
    assert (source, diagonal) == ("frame 0", 5.0)
    # a bone a vertex, which carries it where the frames have it, but for one
    transforms = np.zeros((6, 20, 3, 4))
    transforms[..., 3] = frames + off
    parts = slot.Parts(rest, np.eye(20), transforms, "affine")
    row = score.score(SEQUENCES["toy"], frames, faces, parts, diagonal)
    assert row["E"] == pytest.approx(1000 * 0.5 / np.sqrt(3 * 6 * 20))
    assert row["2 E / diagonal"] == pytest.approx(2 * row["E"] / 5.0)
    assert row["largest"] == pytest.approx(0.5)
    assert row["largest %"] == pytest.approx(10.0)
    assert row["MXE"] == pytest.approx(4.0)
    assert row["MAE"] == pytest.approx(10 * 0.7 / (6 * 20 * 3))
    whole = ssdr.metrics.sted(ssdr.MeshSequence(frames, faces), frames + off)
    assert row["STED"] == pytest.approx(whole.value, rel=1e-6)
    poses = dataclasses.replace(SEQUENCES["toy"], poses=True)
    row = score.score(poses, frames, faces, parts, diagonal)
    assert row["STED"] == pytest.approx(whole.spatial, rel=1e-6)
    assert whole.spatial < whole.value


def test_the_neutral_face_is_given_and_is_no_frame(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    frames = toy_problem(monkeypatch, tmp_path, neutral=True)
    found, _, rest, source, diagonal = score.problem("toy")
    np.testing.assert_array_equal(found, frames[1:])
    np.testing.assert_array_equal(rest, frames[0])
    assert source == "neutral face"
    assert diagonal == pytest.approx(np.linalg.norm(np.ptp(frames[0], axis=0)))


SOLVERS = {
    "moved": ("rest = frames[1]", "the rest pose that was given is not kept"),
    "many": ("weights = np.full((len(rest), bones), 1 / bones)", "more than 2 influences"),
    "few": ("weights, bones = np.ones((len(rest), 1)), 1", "1 bones, not 5"),
    "negative": ("weights = np.tile([2.0, -1, 0, 0, 0], (len(rest), 1))", "weights not convex"),
    "sheared": ("scale = 2", "rotations not orthonormal"),
    "honest": ("", ""),
}


@pytest.mark.parametrize("name", SOLVERS)
def test_what_a_solver_may_not_do_is_a_defect(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    toy_problem(monkeypatch, tmp_path)
    line, defect = SOLVERS[name]
    path = tmp_path / "mine.py"
    path.write_text(
        "import numpy as np\n"
        "def solve(frames, faces, *, bones, influences, bone_model, rest):\n"
        "    weights, scale = np.eye(bones)[np.arange(len(rest)) % bones], 1\n"
        f"    {line}\n"
        "    return rest, weights, scale * np.tile(np.eye(3, 4), (len(frames), bones, 1, 1))\n"
    )
    asked = score.case("toy", 5, 2, "rigid", "given")
    assert score.measure(**asked, solver=str(path))["defects"] == defect


def test_what_a_solver_prints_is_not_taken_for_its_row(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        "import os\n"
        "def solve(frames, faces, **asked):\n"
        "    print('from Python')\n"
        "    os.write(1, b'from C')\n"
    )
    print("before")
    with pytest.raises(SystemExit):  # for it returns nothing
        slot.solver_of(str(path))(np.zeros((2, 5, 3)), None, bone_model="affine")
    print("after")
    said = capfd.readouterr()
    assert said.out == "before\nafter\n"
    assert "from Python" in said.err
    assert "from C" in said.err


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["ssdr fast", "2012", "dembones"])
def test_the_solvers_of_this_folder_break_no_rule(
    solver: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if solver == "dembones":
        pytest.importorskip("py_dem_bones")
    toy_problem(monkeypatch, tmp_path)
    for asked in (
        score.case("toy", 4, 2, "rigid", "given"),
        score.case("toy", 4, 4, "affine", "solved"),
    ):
        if solver.startswith("ssdr") or asked["rest"] == "given":
            row = score.measure(**asked, solver=solver)
            assert row["defects"] == ""
            assert row["E"] > 0


# --- the data, where it is here ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "bones", "e"),
    [
        ("cat_poses", 10, 7.204), ("cat_poses", 25, 2.677), ("horse_poses", 20, 2.937),
        ("horse_gallop", 30, 1.757), ("ea_bone", 5, 15.5087), ("ea_bone", 20, 5.7083),
    ],
)  # fmt: skip
def test_published_models_have_the_errors_that_their_source_states(
    name: str, bones: int, e: float
) -> None:
    needs(name)
    if not score.published_file(name, bones).is_file():
        pytest.skip("no published models")
    row = score.measure(**score.case(name, bones, 8, "affine", "solved"), solver="published")
    assert row["E"] == pytest.approx(e, rel=2e-4)


def test_published_figures_are_of_cases_that_are_asked() -> None:
    asked = {(r["sequence"], r["bones"]) for r in score.questions()}
    for figures in (catalogue.HYPERSPECTRAL, catalogue.LE_AFFINE, catalogue.LE_RIGID):
        assert set(figures) <= asked
    assert set(catalogue.FACES) <= set(SEQUENCES)


# --- tables --------------------------------------------------------------------------------------


def test_tables_put_methods_beside_each_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def row(solver: str, asked: dict[str, Any], e: float, **more: Any) -> dict[str, Any]:
        shared = {"E": e, "2 E / diagonal": e / 2, "largest %": 1.0, "STED": 0.1, "defects": ""}
        return {**asked, "solver": solver, **shared, **more}

    rigid = score.case("cat_poses", 10, 4, "rigid", "given")
    dense = score.case("cat_poses", 10, 10, "affine", "given")
    kept = [
        row("ssdr balanced", rigid, 3.0),
        row("2012", rigid, 2.5, STED=0.2),
        row("dembones", rigid, 4.0, **{"largest %": 0.5}),
        row("published", rigid, 1.0, defects="reflections"),
        row("ssdr fast", dense, 20.0),
        {**dense, "solver": "mine", "failed": "ValueError"},
    ]
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    common.write_rows(tmp_path / "leaderboard.json", {str(k): r for k, r in enumerate(kept)})
    (line,) = tables.published_rows()
    assert line["2012 K rigid given"]["E"] == 2.5
    assert line["ssdr dense affine given"]["E"] == 20.0
    assert (line["HIS"], line["Le rigid"]) == (6.575, 10.92)
    better = [(r["name"], r["measure"], r["theirs"], r["ours"]) for r in tables.better_rows()]
    assert better == [
        ("SSDR 2012", "E", 2.5, 3.0),
        ("Dem Bones", "largest error, %", 0.5, 1.0),
        ("Hyperspectral Inverse Skinning", "2 E / diagonal", 6.575, 10.0),
    ]


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


OBJ_TOY = Sequence(
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
    server.publish(OBJ_TOY, files)
    path = fetch.get("toy", OBJ_TOY, tmp_path, server.url)
    with np.load(path) as archive:
        np.testing.assert_array_equal(archive["vertices"], places[[0, 1, 3, 5, 7, 9, 11], :4])
        np.testing.assert_array_equal(archive["faces"], [[0, 1, 2], [0, 2, 3]])
        np.testing.assert_array_equal(archive["rest"], places[13])
        assert archive["fps"] == 12.0
    # eight files, and not what the catalogue leaves out
    assert len(server.asked) == 1 + 8
    server.asked.clear()
    fetch.get("toy", OBJ_TOY, tmp_path, server.url)
    assert server.asked == [tree_path(OBJ_TOY)]


def _file(number: int) -> str:
    return f"/owner/toy/{COMMIT}/models/toy/{number}.obj"


def test_an_address_that_is_not_reached_is_said_to_be() -> None:
    with pytest.raises(fetch.FetchError, match=r"^http://\S+: not reached: \[Errno \d+\] \w"):
        fetch.download("http://127.0.0.1:1/nobody", 10)


def _listed(content: dict[str, bytes], left_out: str = "-", **more: object) -> None:
    """Leave a file out of the listing, or say more in it."""
    tree = json.loads(content[tree_path(OBJ_TOY)])
    tree["tree"] = [e for e in tree["tree"] if not e["path"].endswith(left_out)]
    content[tree_path(OBJ_TOY)] = json.dumps(tree | more).encode()


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
        (lambda c: c.update({tree_path(OBJ_TOY): b"[1, 2]"}), r"not a listing of files"),
    ],
)  # fmt: skip
def test_what_is_not_as_it_should_be_is_refused_by_name(
    damage: Callable[[dict[str, bytes]], object], word: str, server: Server, tmp_path: Path
) -> None:
    server.publish(OBJ_TOY, toy_files()[1])
    damage(server.content)
    with pytest.raises(fetch.FetchError, match=word):
        fetch.get("toy", OBJ_TOY, tmp_path, server.url)
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
