"""Pages without a browser: what they hold, what they refuse, and names that mean harm."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.drawn import surface_normals
from helpers.page import Held
from ssdr.show.page.page import page_text

PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108020000009077 53de0000000c49444154"
    "08d763f8cfc0000003010100c9fe92ef0000000049454e44ae426082".replace(" ", "")
)


@pytest.fixture(scope="module")
def result(dancer):
    return ssdr.decompose(dancer, bones=8, effort="fast", rig="rigid")


def made(n_frames=5, **more):
    """Two bones that turn, three triangles."""
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0.5]], float)
    turn = np.linspace(0, 1, n_frames)
    transforms = np.tile(np.eye(3, 4), (n_frames, 2, 1, 1))
    transforms[:, 1, 0, 0] = transforms[:, 1, 1, 1] = np.cos(turn)
    transforms[:, 1, 1, 0] = np.sin(turn)
    transforms[:, 1, 0, 1] = -np.sin(turn)
    weights = np.array([[1, 0], [0.75, 0.25], [1, 0], [0.3, 0.7], [0, 1]])
    faces = [[0, 1, 2], [1, 3, 2], [1, 4, 3]]
    given = {"faces": faces, "fps": 24.0, **more}
    return ssdr.Skinning(rest, np.tile([0, 1], (5, 1)), weights, transforms, **given)


def held(*arguments, **options):
    return Held(page_text(*arguments, **options)[0])


def test_the_page_holds_the_model_and_the_input(dancer, result):
    page = held(result, dancer)
    diagonal = dancer.diagonal()
    np.testing.assert_allclose(page.vertices(), result.reconstruct(), atol=1e-6 * diagonal)
    step = page.document["input"]["step"] * page.document["scale"]
    assert step <= np.abs(dancer.vertices - result.reconstruct()).max() / 32767 * (1 + 1e-5)
    np.testing.assert_allclose(page.input(), dancer.vertices, atol=0.5 * step + 1e-6 * diagonal)


def test_a_mesh_far_away_and_in_other_units_is_as_exact(dancer, result):
    model = result.skinning
    shift = np.array([3e5, -2e5, 1e5])
    transforms = 1000 * model.transforms.astype(np.float64)
    transforms[..., :3] /= 1000
    transforms[..., 3] += shift
    far = dataclasses.replace(
        model, rest=1000 * model.rest.astype(np.float64), transforms=transforms
    )
    page = held(far)
    np.testing.assert_allclose(page.vertices(), far.skin(), atol=1e-6 * 1000 * dancer.diagonal())


def test_errors_are_those_of_the_metrics(dancer, result):
    found = ssdr.metrics.compare(dancer, result.reconstruct(), hausdorff=False, sted=False)
    page = held(result, dancer, reference_name="dance.abc").document
    error = page["error"]
    assert (error["frame"], error["worst"][error["frame"]]) == (found.max_frame, found.max_vertex)
    np.testing.assert_allclose(error["largest"][found.max_frame], found.max, rtol=1e-6)
    np.testing.assert_allclose(np.mean(error["mean"]), found.mean, rtol=1e-6)
    rows = {name: (value, note) for name, value, note in page["figures"]}
    assert rows["RMSE"][0] == f"{found.rmse:.3g} ({found.percent_of_diagonal:.2g} %)"
    assert "dance.abc" in rows["RMSE"][1]
    assert rows["Vertex cache"][0] == f"{12 * 24 * 799 / 1000:.1f} kB"


def test_without_an_input_there_is_no_error(dancer, result):
    assert len(held(result, dancer).document["error"]["mean"]) == 24
    assert held(result).document["error"] is None
    assert held(result).document["expressions"] is None


def test_a_sequence_is_a_page_of_its_own(dancer):
    page = held(dancer)
    assert page.document["rig"] is None
    reach = np.abs(dancer.vertices - dancer.vertices[0]).max()
    np.testing.assert_allclose(page.input(), dancer.vertices, atol=reach / 32767)


def test_two_sequences_are_both_held_with_the_errors_between_them(dancer, result):
    other = dataclasses.replace(dancer, vertices=result.reconstruct())
    page, through_bones = held(other, dancer), held(result, dancer)
    within = 1e-6 * dancer.diagonal()
    np.testing.assert_allclose(page.vertices(), other.vertices, atol=within)
    step = page.document["input"]["step"] * page.document["scale"]
    np.testing.assert_allclose(page.input(), dancer.vertices, atol=0.5 * step + within)
    assert page.document["rig"] is None
    for name in ("mean", "largest"):
        of_pair, of_model = (p.document["error"][name] for p in (page, through_bones))
        np.testing.assert_allclose(of_pair, of_model, rtol=1e-4)
    rows = {name: value for name, value, _ in page.document["figures"]}
    assert not {"Bones", "Influences"} & set(rows)
    assert rows["RMSE"] == f"{result.rmse:.3g} ({100 * result.rmse / dancer.diagonal():.2g} %)"


def test_a_sequence_that_travels_is_in_view_and_followed():
    rest = np.eye(3)
    way = np.linspace(0, 50, 21)[:, None] * np.array([1.0, 0, 0])
    page = held(ssdr.MeshSequence(rest + way[:, None])).document
    whole = np.array(page["whole"]) * page["scale"] + page["center"]
    assert np.ptp(whole, axis=0) == pytest.approx([51, 1, 1], abs=1e-3)
    assert page["follow"]
    path = held(ssdr.MeshSequence(rest + way[:, None])).array(page["path"]) * page["scale"]
    np.testing.assert_allclose(path, way, atol=1e-4)


@pytest.mark.parametrize("faces", [None, np.zeros((0, 3), int)])
def test_one_frame_and_no_faces(faces):
    model = made(1, faces=faces)
    page = held(model, model.skin())
    np.testing.assert_allclose(page.input(), model.skin(), atol=1e-6)
    assert page.document["error"]["max"] == 0
    assert page.document["parts"] == []


def test_a_point_that_stays_where_it_is():
    page = held(ssdr.MeshSequence(np.ones((2, 1, 3))))
    np.testing.assert_allclose(page.input(), 1)
    assert page.document["scale"] == 1


NAMES = {
    "script": "</script><script>alert(1)</script>",
    "image": "<img src=x onerror=alert(1)>",
    "comment": "<!-- <script> -->",
    "long": "x" * 10_000,
    "emoji": "🦴 💃🏽 \u2028 \u202e \ud800",
    "placeholder": "<!-- ssdr: script -->",
}


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
def test_names_are_only_text(name):
    clean = held(made(), made().skin()).tags
    file_name = name.replace("\ud800", "?")
    model = made(bone_names=(name, "b"), name=name, clips=(ssdr.Clip(file_name, 0, 5),))
    text, _ = page_text(model, model.skin(), reference_name=name)
    text.encode()
    page = Held(text)
    assert page.tags == clean
    assert page.document["rig"]["names"] == [name, "b"]
    assert page.document["title"] == name


def test_nothing_is_fetched():
    text, _ = page_text(made())
    for part in ("default-src 'none'", "script-src 'unsafe-inline' 'wasm-unsafe-eval'"):
        assert part in text
    for word in ("http:", "https:", "import(", "fetch(", "new Worker", " src=", "@import", "url("):
        assert word not in text


def test_seams_hard_edges_and_materials():
    uv = np.zeros((3, 3, 2), np.float32)
    uv[1] = 0.5  # a seam between the first two triangles
    normals = np.zeros((3, 3, 3), np.float32)
    normals[:2, :, 2], normals[2, :, 1] = 1, 1  # a hard edge before the third
    materials = (
        ssdr.Material(base_color=(1, 0, 0, 1)),
        ssdr.Material(base_color=(1, 1, 1, 1), texture=PNG),
    )
    look = {"material_index": np.array([1, 0, 1], np.int32), "materials": materials}
    page = held(made(surface=ssdr.Surface(uv=uv, normals=normals, **look)))
    d = page.document
    vertex = np.concatenate([np.arange(5), page.array(d["copies"])])
    faces = page.array(d["faces"]).reshape(-1, 3)
    assert vertex[faces].tolist() == [[1, 3, 2], [0, 1, 2], [1, 4, 3]]  # by material
    np.testing.assert_allclose(page.array(d["uv"])[faces], uv[[1, 0, 2]])
    group = page.array(d["groups"])
    assert group[faces[0, 0]] == group[faces[1, 1]] != group[faces[2, 0]]
    assert [part["count"] for part in d["parts"]] == [1, 2]
    assert page.block(d["parts"][1]["texture"]["block"]) == PNG
    assert d["parts"][0]["texture"] is None


@pytest.mark.parametrize("own", [True, False])
def test_rest_normals_of_vertices_and_copies(own):
    model = made()
    normals = np.zeros((3, 3, 3), np.float32)
    normals[:2, :, 2], normals[2] = 1, [0.6, 0, 0.8]  # a hard edge before the third
    if own:
        model = dataclasses.replace(model, surface=ssdr.Surface(normals=normals))
    else:
        normals = surface_normals(model.rest, model.faces)
    page = held(model)
    faces = page.array(page.document["faces"]).reshape(-1, 3)
    found = page.array(page.document["normals"])
    assert len(found) == (5 + 2 if own else 5)
    np.testing.assert_allclose(found[faces], normals, atol=2e-5)
    assert held(ssdr.MeshSequence(model.skin(), model.faces)).document["normals"] is None


def test_the_error_of_normals_is_that_of_the_metric():
    model = made()
    rng = np.random.default_rng(1)
    truth = ssdr.MeshSequence(model.skin() + 0.1 * rng.normal(size=(5, 5, 3)), model.faces)
    expected = ssdr.metrics.normals(truth, model)
    page = held(model, truth).document
    rows = {name: value for name, value, _ in page["figures"]}
    assert rows["Normals"] == f"{expected.mean:.3g}°"
    assert page["angles"]["mean"] == pytest.approx(expected.mean, rel=1e-4)
    pair = held(ssdr.MeshSequence(model.skin(), model.faces), truth).document
    assert pair["angles"]["mean"] > 0
    assert held(made(faces=None), truth.vertices).document["angles"] is None
    assert held(model).document["angles"] is None
    flat = dataclasses.replace(model, rest=0 * model.rest)  # no triangle has an area
    assert held(flat, flat.skin()).document["error"]["max"] == 0


def test_a_texture_that_is_no_picture_is_left_out():
    uv = np.zeros((3, 3, 2), np.float32)
    material = ssdr.Material(texture=b"none", texture_type="image/webp")
    text, content = page_text(made(surface=ssdr.Surface(uv=uv, materials=(material,))))
    assert content.notes == ("A texture that is no readable picture was left out.",)
    assert Held(text).document["parts"][0]["texture"] is None


def test_a_model_too_large_for_a_page_loses_frames(tmp_path):
    model = made(400, clips=(ssdr.Clip("a", 0, 300, 24.0), ssdr.Clip("b", 300, 400, 12.0)))
    page = ssdr.view(model, model.skin(), tmp_path / "page.html", max_bytes=200_000)
    assert page.bytes <= 200_000
    assert page.frames < 400
    assert f"{page.frames} of 400" in page.notes[0]
    found = Held(page.path.read_text(encoding="utf-8"))
    d = found.document
    kept = np.concatenate([np.arange(c.start, c.stop, d["step"]) for c in model.clips])
    np.testing.assert_allclose(found.vertices(), model.skin()[kept], atol=1e-6)
    assert [c["fps"] * d["step"] for c in d["clips"]] == [24, 12]
    assert [c["first"] for c in d["clips"]] == [0, 300]
    assert d["clips"][1]["stop"] == page.frames == len(kept)
    with pytest.raises(ssdr.InputError, match=r"max_bytes.*at least [\d,]+ for this mesh"):
        ssdr.view(model, model.skin(), tmp_path / "small.html", max_bytes=10_000)
    assert not (tmp_path / "small.html").exists()


def test_more_than_eight_influences_are_pruned():
    rng = np.random.default_rng(0)
    weights = rng.random((4, 10))
    weights /= weights.sum(axis=1, keepdims=True)
    still = np.tile(np.eye(3, 4), (2, 10, 1, 1))
    model = ssdr.Skinning(rng.random((4, 3)), np.tile(np.arange(10), (4, 1)), weights, still)
    text, content = page_text(model)
    assert content.notes == ("The 8 largest weights of each vertex are shown.",)
    assert Held(text).document["weights"]["shape"] == [4, 8]


def test_shots_are_joined_and_an_up_axis_is_a_basis(dancer):
    model = made(6)
    half = [ssdr.MeshSequence(part) for part in np.split(model.skin(), 2)]
    assert held(model, half).document["error"]["max"] == 0
    basis = np.reshape(held(model, up="z").document["basis"], (3, 3))
    np.testing.assert_allclose(basis @ [0, 0, 1], [0, 1, 0])
    assert np.linalg.det(basis) == pytest.approx(1)


def test_opened_where_no_path_is_given(monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    page = ssdr.view(made())
    assert opened == [page.path.as_uri()]
    page.path.unlink()
    page.path.parent.rmdir()
