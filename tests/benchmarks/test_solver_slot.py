"""Solvers and models of other people: what can be scored, and what is said of what cannot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ssdr
from benchmarks import common
from benchmarks.peers import slot

EXAMPLE = common.ROOT / "benchmarks" / "leaderboard" / "example_solver.py"


def test_the_example_has_ten_lines_and_is_that_of_the_page() -> None:
    text = EXAMPLE.read_text("utf-8")
    body = text[text.index("def solve") :].strip()
    assert len(body.splitlines()) <= 10
    assert body in (common.ROOT / "docs" / "leaderboard.md").read_text("utf-8")


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


def test_a_solver_is_a_file_or_a_function_of_a_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = EXAMPLE.read_text("utf-8").replace("def solve", "def mine")
    (tmp_path / "my_solver.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    frames = np.random.default_rng(0).standard_normal((4, 9, 3))
    asked = {"bones": 2, "influences": 2, "bone_model": "rigid", "rest": None}
    for name in ("my_solver:mine", "my_solver.py:mine"):
        assert slot.is_own(name)
        assert slot.solver_of(name)(frames, None, **asked).weights.shape == (9, 2)
    assert not slot.is_own("ssdr balanced")
    with pytest.raises(SystemExit, match=r"my_solver has no function yours"):
        slot.solver_of("my_solver:yours")


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
