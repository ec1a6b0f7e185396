"""What expressions, metrics, Laplacians, pictures and pages refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.calls import Call, Row, each, refused
from ssdr import laplacian, metrics, show

NAN, INF = float("nan"), float("inf")
DANCER = ssdr.samples.load("dancer_small")
FEW = DANCER.vertices[:4].astype(np.float64)
ZEROS = np.zeros((5, 42, 3))
CHAIN = motions.chain(bones=3, rows=5, frames=4)
MODEL = CHAIN.skinning
SHOT = ssdr.MeshSequence(CHAIN.frames, CHAIN.faces)
FEWER = ssdr.MeshSequence(CHAIN.frames[:2], CHAIN.faces)
FAR = ssdr.MeshSequence(1e200 * DANCER.vertices.astype(np.float64), DANCER.faces)
PAIR = {"reference": ZEROS, "other": ZEROS}
BALLS = {"reference": FEW, "other": FEW[::-1]}
FACE = ssdr.decompose_expressions(np.eye(3), 2 * np.ones((3, 3, 3)), bones=1)
SMOOTHER = laplacian.LaplacianSmoother(np.eye(4, 3), [[0, 1, 2]], 1.0)
CALLS: dict[str, Call] = {
    "expressions": (ssdr.decompose_expressions,
                    {"neutral": np.eye(3), "expressions": np.ones((2, 3, 3)), "bones": 1}),
    "drive": (ssdr.drive, {"face": FACE, "weights": np.ones((1, 3))}),
    **{f.__name__: (f, PAIR) for f in (metrics.compare, metrics.distances, metrics.rmse,
                                       metrics.hausdorff, metrics.sted)},
    "normals": (metrics.normals, {"reference": SHOT, "model": MODEL}),
    "smoother": (laplacian.LaplacianSmoother,
                 {"vertices": np.eye(4, 3), "faces": [[0, 1, 2]], "length": 1.0}),
    "smooth": (SMOOTHER.smooth, {}),
    "uniform": (laplacian.uniform_laplacian, {"faces": [[0, 1, 2]]}),
    "mass": (laplacian.mass_matrix, {"vertices": FEW[0], "faces": DANCER.faces}),
    "split": (laplacian.split_frequencies,
              {"frames": np.zeros((2, 4, 3)), "faces": [[0, 1, 2]], "length": 1.0}),
    "smooth weights": (laplacian.smooth_weights, {"skinning": MODEL, "length": 0.1}),
    "picture": (show.render_frame, {"subject": MODEL}),
    "sheet": (show.contact_sheet, {"subject": SHOT}),
    "film": (show.Film.of, {"subject": SHOT}),
    "page": (ssdr.view, {"model": MODEL, "path": "a.html"}),
}  # fmt: skip
FACES: list[Row] = [
    ("expressions", "expressions", "", [None]),
    ("expressions", "expressions", "shape (S, 3, 3)", [np.ones((2, 4, 3))]),
    ("expressions", "expressions", "finite", [np.full((2, 3, 3), NAN)]),
    ("expressions", "names", "2", [["a"]]),
    ("expressions", "tolerance", "", [0]),
    ("expressions", "neutral", "shape", [np.ones((3, 2))]),
    ("drive", "face", "a ShapedSkinning whose clips", [MODEL]),
    ("drive", "weights", "shape (F, 3)", [np.ones((1, 4))]),
    ("drive", "weights", "finite", [np.full((1, 3), INF)]),
]
MEASURES: list[Row] = [
    ("compare", "other", "", [ZEROS[:, 1:], ZEROS[1:], ZEROS[0], np.full(ZEROS.shape, INF)]),
    ("compare", "reference", "", [np.full(ZEROS.shape, NAN), "abc"]),
    ("compare", "faces", "", [[[0, 1, 42]]]),
    *((call, "other", "", [ZEROS[:, 1:]]) for call in ("rmse", "distances", "sted")),
    ("hausdorff", "other", "", [ZEROS[1:]]),
    *(
        (call, name, "squared and summed", [BALLS | {name: size * FEW[::-1]}])
        for call in ("compare", "distances", "rmse", "hausdorff", "sted")
        for size in (1e160, 1e307)
        for name in ("reference", "other")
    ),
    ("normals", "reference", "4 frames of 30", [CHAIN.frames[:3]]),
    ("normals", "faces", "a triangle with an area, got none",
     [{"reference": np.zeros((2, 3, 3)), "model": np.zeros((2, 3, 3))}]),
    ("normals", "model", "the triangles of the reference",
     [{"reference": ssdr.MeshSequence(CHAIN.frames, CHAIN.faces[1:])}]),
]  # fmt: skip
SMOOTHING: list[Row] = [
    ("smoother", "vertices", "",
     [np.zeros((4, 2)), np.zeros((0, 3)), np.full((4, 3), NAN), [["a"] * 3]]),
    ("smoother", "faces", "", [[[0, 1, 4]], [[0, 1, -1]], [[0.0, 1, 2]]]),
    ("smoother", "length", "", [-1.0, NAN, "a", 1e99, 1e200]),
    ("smoother", "kind", "", ["mean", {"mass": "full"}]),
    ("smoother", "backend", "", ["lapack"]),
    ("smooth", "values", "",
     [np.zeros(3), np.zeros((3, 4)), 1.0, np.full(4, INF), ["a"] * 4, np.full(4, 1.7e308)]),
    ("uniform", "n_vertices", "", [0, 10**30]),
    ("mass", "vertices", "less than 1e",
     [{"vertices": x * FEW[0], "kind": kind}
      for x in (1e101, 1e200) for kind in ("barycentric", "voronoi")]),
    ("split", "rest", "", [2, -3, np.zeros((3, 3))]),
    ("smooth weights", "skinning", "", ["model.npz", motions.model(np.eye(3))]),
    ("smooth weights", "length", "", [-1.0, "5 cm"]),
    ("smooth weights", "influences", "", [0]),
    ("smooth weights", "kind", "", ["graph"]),
]  # fmt: skip
PICTURES: list[Row] = [
    ("picture", "frames", "", [{"frame": 9}]),
    ("picture", "style", "", ["glossy", {"subject": SHOT, "style": "bones"}]),
    ("picture", "reference", "", [{"style": "error"}, FEWER]),
    ("picture", "size", "", [(1, 100), None, (64, 64.5), 64]),
    ("picture", "up", "", ["w", "--y"]),
    ("picture", "elevation", "", [100.0]),
    ("picture", "azimuth", "", [NAN]),
    ("picture", "subject", "", [np.zeros((2, 3, 3))]),
    ("picture", "colors", "", [(2.0, 0, 0), np.ones((3, 3))]),
    ("picture", "measured", "", [[30], []]),
    ("sheet", "frames", "", [[]]),
    ("sheet", "width", "", [10]),
    ("sheet", "row_names", "", [{"row_names": ("a", "b"), "reference": SHOT}]),
    ("sheet", "captions", "", [("a",), "ab"]),
    ("film", "fps", "", [-1.0]),
    ("page", "reference", "4 frames of 30 vertices, as the model has", [DANCER]),
    ("page", "model", "a Skinning, Decomposition or MeshSequence", [3]),
    ("page", "up", "", ["w"]),
    ("page", "path", "a folder that exists", ["none/a.html"]),
    *(("page", name, "numbers of less than 1e+100", [pair])  # JSON has no NaN
      for name, pair in (("model", {"model": FAR}),
                         ("reference", {"model": DANCER, "reference": FAR}),
                         ("model", {"model": FAR, "reference": DANCER}))),
]  # fmt: skip
REFUSED = FACES + MEASURES + SMOOTHING + PICTURES


@pytest.mark.parametrize(("call", "argument", "says", "value"), each(REFUSED))
def test_refuses(
    call: str, argument: str, says: str, value: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And writes no file."""
    monkeypatch.chdir(tmp_path)
    refused(CALLS[call], argument, says, value)
    assert list(tmp_path.iterdir()) == []
