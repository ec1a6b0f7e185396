"""Scores by hand, rules that a solver may not break, and the tables of the leaderboard."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from benchmarks import common
from benchmarks.leaderboard import catalogue, fetch, score, tables
from benchmarks.leaderboard.catalogue import SEQUENCES, Sequence
from benchmarks.peers import slot


def needs(name: str) -> np.ndarray:
    if not common.sequence_file(name).is_file():
        pytest.skip(f"no data for {name}")
    return common.load(name)[0]


TOY = Sequence(
    repository="owner/toy", commit="c" * 40, pattern=r"models/toy/\d+\.obj", files=6, licence="CC0",
    credit="nobody",
)  # fmt: skip


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


@pytest.mark.parametrize("name", [n for n, s in SEQUENCES.items() if s.sha256])
def test_the_catalogue_knows_the_vertices(name: str) -> None:
    frames = needs(name)
    assert fetch.same_as_the_tables(SEQUENCES[name], frames)
    frames[0, 0, 0] += np.float32(1e-3)
    assert fetch.same_as_the_tables(SEQUENCES[name], frames) is False


def test_tables_put_methods_beside_each_other() -> None:
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
    rows = {str(k): r for k, r in enumerate(kept)}
    (line,) = tables.published_rows(rows)
    assert line["2012 K rigid given"]["E"] == 2.5
    assert line["ssdr dense affine given"]["E"] == 20.0
    assert (line["HIS"], line["Le rigid"]) == (6.575, 10.92)
    better = [(r["name"], r["measure"], r["theirs"], r["ours"]) for r in tables.better_rows(rows)]
    assert better == [
        ("SSDR 2012", "E", 2.5, 3.0),
        ("Dem Bones", "largest error, %", 0.5, 1.0),
        ("Hyperspectral Inverse Skinning", "2 E / diagonal", 6.575, 10.0),
    ]
