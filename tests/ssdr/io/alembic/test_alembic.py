"""Alembic caches that the library's own bindings have written, and what ours lack."""

from __future__ import annotations

import importlib.util
import logging
import subprocess
import sys

import numpy as np
import pytest

import ssdr
from helpers.alembic_cache import OUTWARD, TETRAHEDRON, Cache, moving, one_mesh, uniform
from ssdr.io import own_process
from ssdr.io.alembic import alembic_reading

TELEVISION = 24000 / 1001


def turn(angle, place=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0)):
    """A scale, then a turn about z, then a move."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    matrix[:3, :3] *= scale
    matrix[:3, 3] = place
    return matrix


def volume(sequence):
    """Signed volume within the triangles of each frame, positive where they face outwards."""
    corners = sequence.vertices[:, sequence.faces].astype(np.float64)
    return np.linalg.det(corners).sum(axis=1) / 6


@pytest.mark.parametrize(
    ("fps", "frame"),
    [(TELEVISION, 1001), (23.976, 0), (24.0, -40), (30.0, 1001), (5.0, -40), (7.3, 1001), (1e3, 0)],
)
def test_samples_are_frames_whatever_their_rate_and_start(tmp_path, fps, frame):
    points = moving(7)
    path = one_mesh(tmp_path / "a.abc", points, uniform(fps, frame / fps))
    back = ssdr.load(path)
    np.testing.assert_array_equal(back.vertices, points)
    assert back.fps == pytest.approx(fps, rel=1e-12)
    assert (back.name, back.clip, back.space) == ("ball", "a", ssdr.Space())
    assert (volume(back) > 0).all()
    back = ssdr.load(one_mesh(tmp_path / "b.abc", points[:1], uniform(fps, frame / fps)))
    assert (len(back), back.fps) == (1, 24.0)


def scene(path):
    """Two balls and a plate, one ball below two moving transforms."""
    cache = Cache(path)
    clock, half = cache.clock(*uniform(25)), cache.clock(*uniform(12.5))
    high = [turn(0.3 * k, (k, 0, 0.5)) for k in range(5)]
    low = [turn(-0.2 * k, (0, 0, k), (1, 2, 3)) for k in range(3)]
    top = cache.above("top", high, clock)
    zebra = cache.above("zebra", low, half, top)
    cache.mesh("zebraShape", moving(5, 1), clock, zebra)
    cache.mesh("plate", moving(1, 2), cache.clock(*uniform(1)))
    free = cache.above("ape", [turn(0.1)], clock, top, inherits=False)
    cache.mesh("apeShape", moving(5, 3), clock, free, polygons=[(0, 1, 2), (0, 3, 1)])
    truth = []
    for k in range(5):
        between = low[k // 2] if k % 2 == 0 else (low[k // 2] + low[k // 2 + 1]) / 2
        items = (turn(0.1), moving(5, 3)[k]), (np.eye(4), moving(1, 2)[0])
        items = (*items, (high[k] @ between, moving(5, 1)[k]))
        truth.append(np.concatenate([p @ m[:3, :3].T + m[:3, 3] for m, p in items]))
    del top, zebra, free
    return cache.close(), np.array(truth)


def test_objects_follow_each_other_below_their_transforms_and_are_chosen_by_name(tmp_path):
    path, truth = scene(tmp_path / "a.abc")
    back = ssdr.load(path)
    assert (len(back), back.fps, back.name) == (5, 25.0, "a")
    np.testing.assert_allclose(back.vertices, truth, atol=1e-6)
    assert back.faces.tolist()[:2] == [[2, 1, 0], [1, 3, 0]]
    assert len(back.faces) == 2 + 4 + 4
    assert ssdr.io.list_meshes(path) == ("ape", "plate", "zebra")
    for names, frames, rows in (
        ("ape", truth, range(4)),
        (["plate"], truth[:1], range(4, 8)),
        ("zebraShape", truth, range(8, 12)),
        ("top", truth, [*range(4), *range(8, 12)]),
    ):
        one = ssdr.load(path, meshes=names)
        np.testing.assert_allclose(one.vertices, frames[:, rows], atol=1e-6)
    with pytest.raises(ssdr.InputError, match=r"meshes: expected one of .*'plate'.*got 'monkey'"):
        ssdr.load(path, meshes=["ape", "monkey"])


def test_hidden_meshes_are_left_out_and_a_subdivision_surface_is_read_as_its_cage(tmp_path, caplog):
    cache = Cache(tmp_path / "a.abc")
    clock = cache.clock(*uniform(24))
    cache.mesh("seen", moving(2), clock, kind="SubD")
    cache.mesh("unseen", moving(2, 1), clock, hidden=True)
    path = cache.close()
    with caplog.at_level(logging.INFO, "ssdr"):
        np.testing.assert_array_equal(ssdr.load(path).vertices, moving(2))
    assert "unseen is not shown" in caplog.text
    assert "/seen: a subdivision surface" in caplog.text


@pytest.mark.parametrize("grows", [False, True])
def test_a_mirrored_mesh_faces_outwards(tmp_path, grows):
    mirrors = [turn(0.3 * k, scale=(-1, 1, 1) if k or not grows else (0, 0, 0)) for k in range(3)]
    normals = np.array([[-1, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    given = {"above": mirrors, "normals": (normals, "Vertex")}
    back = ssdr.load(one_mesh(tmp_path / "a.abc", moving(3), uniform(24), **given))
    assert (volume(back)[grows:] > 0).all()
    seen = back.vertices[int(grows)]
    corners = seen[back.faces] - seen.mean(axis=0)
    assert ((corners * back.surface.normals).sum(axis=2) > 0).all()


def test_polygons_are_cut_into_triangles_seen_from_outside(tmp_path):
    points = np.concatenate([TETRAHEDRON, TETRAHEDRON + 3])[None]
    path = one_mesh(tmp_path / "a.abc", points, uniform(24), polygons=[(0, 1, 2, 3, 4), (5, 6, 7)])
    assert ssdr.load(path).faces.tolist() == [[4, 3, 2], [4, 2, 1], [4, 1, 0], [7, 6, 5]]

    ell = np.array([[2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 0]]) @ np.eye(2, 3)
    back = ssdr.load(one_mesh(path, ell[None], uniform(24), polygons=[(5, 4, 3, 2, 1, 0)]))
    a, b, c = ell[back.faces].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert areas.min() > 0
    assert areas.sum() == 3


UV = np.arange(24, dtype=np.float32).reshape(12, 2)
CORNERS = np.arange(12).reshape(4, 3)[:, ::-1]  # of each triangle, as they are read


@pytest.mark.parametrize(
    ("param", "rows"),
    [
        ((UV, "Facevarying"), CORNERS),
        ((UV[:5], "Facevarying", np.arange(12) % 5), CORNERS % 5),
        ((UV[:4], "Vertex"), OUTWARD[:, ::-1]),
        ((UV[:4], "Varying"), OUTWARD[:, ::-1]),
        ((UV[:4], "Uniform"), np.repeat(np.arange(4)[:, None], 3, axis=1)),
        ((UV[:1], "Constant"), np.zeros((4, 3), int)),
        ((UV[:5], "Facevarying"), None),
        ((UV[:5], "Facevarying", np.arange(12)), None),
        ((np.full((12, 2), np.nan), "Facevarying"), None),
    ],
)
def test_uvs_of_every_scope(tmp_path, param, rows, caplog):
    path = one_mesh(tmp_path / "a.abc", moving(2), uniform(24), uv=param)
    surface = ssdr.load(path).surface
    if rows is None:
        assert surface is None
        assert "/ball/ballShape: UVs do not match the mesh" in caplog.text
    else:
        np.testing.assert_array_equal(surface.uv, UV[rows])


def test_normals_turn_with_the_first_frame(tmp_path):
    normals = np.array([[1, 1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2]])
    first = turn(0.7, (1, 2, 3), (1, 4, 1))
    given = {"above": [first, turn(0.9)], "normals": (normals, "Vertex")}
    path = one_mesh(tmp_path / "a.abc", moving(2), uniform(24), **given)
    found = ssdr.load(path).surface.normals
    truth = normals @ np.linalg.inv(first[:3, :3])
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    np.testing.assert_allclose(found, truth[OUTWARD[:, ::-1]], atol=1e-6)


def test_resampling_is_said_with_its_error(tmp_path):
    points, times = moving(6), np.array([0.3, 0.37, 0.5, 0.52, 0.77, 1.01])
    path = one_mesh(tmp_path / "a.abc", points, (None, times.tolist()))
    with pytest.warns(ssdr.SsdrWarning, match=r"a\.abc: 5 keys of the clip a lie between") as said:
        back = ssdr.load(path)
    assert (len(back), back.fps) == (19, 24.0)

    def lines(at, stamps, values):
        flat = values.reshape(len(values), -1).astype(np.float64)
        rows = [np.interp(at, stamps, column) for column in flat.T]
        return np.stack(rows, axis=1).reshape(-1, 4, 3)

    frames = 0.3 + np.arange(19) / 24
    np.testing.assert_allclose(back.vertices, lines(frames, times, points), atol=1e-6)
    off = np.linalg.norm(lines(times, frames, back.vertices) - points, axis=2).max()
    assert f"24 a second: vertices are up to {off:.3g} (" in str(said[0].message)
    assert len(ssdr.load(path, fps=10.0)) == 8  # the caller's choice is no warning


def test_samples_at_two_rates_do_not_make_a_rate_above_both(tmp_path):
    cache = Cache(tmp_path / "a.abc")
    for name, fps in (("a", 24), ("b", 25)):
        cache.mesh(name, moving(fps + 1), cache.clock(*uniform(fps)))
    path = cache.close()
    with pytest.warns(ssdr.SsdrWarning, match="24 keys of the clip a lie between"):
        assert 24 <= ssdr.load(path).fps < 100


@pytest.mark.parametrize(
    ("code", "limit", "text"),
    [
        ("import os; os.abort()", 600, "truncated or damaged: alembic3d failed"),
        ("while True: pass", 0.1, r"alembic3d needed more than 0\.1 s"),
    ],
)
def test_a_crash_or_an_endless_loop_is_blamed_on_the_file(tmp_path, monkeypatch, code, limit, text):
    path = one_mesh(tmp_path / "a.abc", moving(2), uniform(24))
    (tmp_path / "script.py").write_text(code)
    monkeypatch.setattr(alembic_reading, "_SCRIPT", tmp_path / "script.py")
    monkeypatch.setattr(own_process, "_TIME_LIMIT", limit)
    with pytest.raises(ssdr.FormatError, match=rf"a\.abc: {text}"):
        ssdr.load(path)


@pytest.mark.slow
def test_damaged_archives_are_refused(data_dir):
    paths = sorted((data_dir / "alembic" / "damaged").glob("*.abc"))
    if not paths:
        pytest.skip(f"no damaged caches in {data_dir}")
    pytest.importorskip("alembic3d", reason="alembic3d is not installed")
    for path in paths:
        with pytest.raises(ssdr.FormatError, match=path.name):
            ssdr.load(path, max_bytes=1 << 28)


def test_caches_of_the_old_kind_say_what_converts_them(data_dir):
    for name in ("cube.abc", "xforms.abc"):
        path = data_dir / "alembic" / name
        if not path.is_file():
            pytest.skip(f"no {name} in {data_dir}")
        with pytest.raises(ssdr.FormatError, match=r"old kind HDF5.*abcconvert -toOgawa"):
            ssdr.load(path)


def test_the_library_never_enters_the_process_that_reads(tmp_path):
    path = one_mesh(tmp_path / "a.abc", moving(2), uniform(24))
    code = f"import ssdr, sys; ssdr.load({str(path)!r}); print('alembic3d' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("points", "more", "text"),
    [
        (moving(4), {"polygons": [OUTWARD] * 2 + [OUTWARD[:3]]},
         "topology changes: .*4 vertices and 4 polygons in frame 0, "
         r"4 vertices and 3 polygons in frame 2 \(0\.08 s\)"),
        (moving(4), {"polygons": [OUTWARD, OUTWARD[::-1]]}, r"others in frame 1 \(0\.04 s\)"),
        ([*moving(3), np.eye(5, 3)], {}, "5 vertices and 4 polygons in frame 3"),
        (np.repeat(moving(1), 4, axis=0), {"polygons": [OUTWARD] * 3 + [OUTWARD[:2]]},
         "2 polygons in frame 3"),
        (moving(2), {"polygons": [(0, 1, 7)]}, "indices from 0 to 7 for 4 vertices"),
        (moving(2), {"polygons": [(0, 1, -2)]}, "indices from -2 to 1 for 4 vertices"),
        (moving(2), {"polygons": [(0, 1)]}, "face 0 has 2 corners"),
        (moving(2) * np.float32(np.nan), {}, "nan at frame 0"),
        (moving(2), {"above": [np.eye(4), np.diag([np.nan, 1, 1, 1])]}, "not finite"),
        (moving(2), {"above": [np.diag([np.inf, 1, 1, 1])]}, "a transform that is not finite"),
        (moving(2), {"above": [np.diag([1, 1, 1, 2.0])]}, "a transform that is not affine"),
        (moving(3), {"clock": (None, [0, 4e-7, 8e-7])}, "by more than a microsecond"),
        (moving(2), {"hidden": True}, "no mesh that is shown"),
        (moving(3), {"clock": (None, [0.0, 1e-3, 1e6])}, "frames of 4 vertices needs"),
        (moving(400), {}, "400 samples of 4 vertices needs \\d+ bytes"),
    ],
)  # fmt: skip
def test_what_no_sequence_holds_is_refused_with_its_place(tmp_path, points, more, text):
    path = one_mesh(tmp_path / "a.abc", points, **{"clock": uniform(25), **more})
    with pytest.raises(ssdr.FormatError, match=rf"a\.abc: .*{text}"):
        ssdr.load(path, max_bytes=16000)


def test_nested_names_and_many_samples_stay_within_the_limit(tmp_path):
    """Names of nested objects grow with the square of their number, and count."""
    cache = Cache(tmp_path / "a.abc")
    clock, above = cache.clock(*uniform(24)), None
    for k in range(100):
        above = cache.above(f"{k:03d}" + "n" * 400, [turn(0, (0.01, 0, 0))], clock, above)
        cache.mesh("m", moving(1), clock, above)
    del above
    path = cache.close()
    with pytest.raises(ssdr.FormatError, match=r"object.* beside others,? needs"):
        ssdr.load(path, max_bytes=1 << 22)
    back = ssdr.load(path, meshes=f"099{'n' * 400}")
    np.testing.assert_allclose(back.vertices[0], moving(1)[0] + [1, 0, 0], atol=1e-6)


def test_without_the_extra_its_package_is_named(tmp_path, wave, monkeypatch):
    path = one_mesh(tmp_path / "a.abc", moving(2), uniform(24))
    monkeypatch.setitem(sys.modules, "alembic3d", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for act in (lambda: ssdr.load(path), lambda: ssdr.save(wave, tmp_path / "b.abc")):
        with pytest.raises(ssdr.MissingDependencyError, match=r"pip install \"alembic3d"):
            act()
    assert not (tmp_path / "b.abc").exists()


@pytest.mark.parametrize(
    ("clock", "asked", "rate", "frames", "samples", "between"),
    [
        ((None, [1, 25 / 24, 27 / 24, 28 / 24]), None, 24, [0, 1, 3, 4], [0, 1, 2, 3], (2, 1)),
        # of an open shutter
        ((1 / 24, [-0.25 / 24, 0, 0.25 / 24]), None, 96, [0, 1, 2, 4], [0, 1, 2, 3], (3, 2)),
        (uniform(24, 2), 48, 48, [0, 2, 4, 6], [0, 1, 2, 3], (1, 0)),
        (uniform(24, 2), 12, 12, [0, 1], [0, 2], None),
    ],
)
def test_samples_on_frames_are_frames(tmp_path, clock, asked, rate, frames, samples, between):
    points = moving(4)
    back = ssdr.load(one_mesh(tmp_path / "a.abc", points, clock), fps=asked)
    assert (len(back), back.fps) == (frames[-1] + 1, rate)
    np.testing.assert_array_equal(back.vertices[frames], points[samples])
    if between:
        frame, k = between
        mean = points[k : k + 2].mean(axis=0)
        np.testing.assert_allclose(back.vertices[frame], mean, atol=1e-6)
