"""Light, normals and textures of a page in a browser without a screen."""

from __future__ import annotations

import dataclasses
import io

import numpy as np
import pytest
import trimesh
from PIL import Image

import ssdr
from helpers.browser import chromium, drawn
from helpers.drawn import model_normals, surface_normals

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="no Chromium to open a page with"),
]


def test_texture_and_hard_edges_are_drawn(opened):
    """A box of one red texel, lit differently on its sides."""
    box = trimesh.creation.box()
    picture = io.BytesIO()
    Image.new("RGB", (1, 1), (255, 0, 0)).save(picture, "PNG")
    material = ssdr.Material(texture=picture.getvalue(), base_color=(1, 1, 1, 1))
    normals = np.repeat(box.face_normals[:, None], 3, axis=1).astype(np.float32)
    uv = np.zeros((12, 3, 2), np.float32)
    surface = ssdr.Surface(uv=uv, normals=normals, materials=(material,))
    browser = opened(ssdr.MeshSequence(box.vertices[None], box.faces, surface=surface))
    browser.value("new Promise(r => setTimeout(r, 300))")
    pixels = drawn(browser)
    inside = pixels[pixels[..., 3] == 255].astype(int)
    assert (inside[:, 0] > inside[:, 1] + 40).all()
    flat, count = np.unique(inside[:, 0] // 6, return_counts=True)
    assert 2 <= (count > 0.1 * len(inside)).sum() <= 4, (flat, count)


def box_of(n_frames=2, **surface):
    """A box that turns by a quarter, as a sequence and as a model of one bone."""
    box = trimesh.creation.box()
    turn = np.tile(np.eye(3, 4), (n_frames, 1, 1, 1))
    turn[1:, 0, :, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    skin = np.zeros((8, 1), int), np.ones((8, 1)), turn
    model = ssdr.Skinning(box.vertices, *skin, faces=box.faces, surface=ssdr.Surface(**surface))
    hard = ssdr.Surface(normals=np.repeat(box.face_normals[:, None], 3, axis=1).astype(np.float32))
    return ssdr.MeshSequence(model.skin(), box.faces, surface=hard), model


def test_the_shader_turns_rest_normals_by_the_blended_matrices(opened, dancer, model):
    rng = np.random.default_rng(3)
    own = rng.normal(size=(model.n_vertices, 3))
    own = (own / np.linalg.norm(own, axis=1, keepdims=True)).astype(np.float32)
    fitted = dataclasses.replace(model, surface=ssdr.Surface(normals=own[model.faces]))
    for subject in (fitted, dataclasses.replace(model, surface=None)):
        browser = opened(subject, dancer)
        for frame in (5, 11):
            browser.value(f"ssdr.seek({frame})")
            turned = np.reshape(browser.value("Array.from(ssdr.normals())"), (-1, 4))[:, :3]
            turned = turned / np.linalg.norm(turned, axis=1, keepdims=True)
            expected = model_normals(subject, frame)
            np.testing.assert_allclose(turned[subject.faces], expected, atol=2e-3)


def test_a_model_is_lit_by_its_rest_normals_or_by_its_surface(opened):
    """Right rest normals look as the surface does; wrong ones only until the switch is pressed."""
    truth, bare = box_of()
    seen = []
    wrong = np.tile(np.float32([0.6, 0, 0.8]), (12, 3, 1))
    inwards = -truth.surface.normals
    for normals in (truth.surface.normals, wrong, inwards):
        right = dataclasses.replace(bare, surface=ssdr.Surface(normals=normals))
        browser = opened(right, truth)
        browser.value("ssdr.set({color: 'plain', view: 'input'}); ssdr.seek(1)")
        surface = drawn(browser)
        browser.value("ssdr.set({view: 'result'}); ssdr.seek(1)")
        engine = drawn(browser)
        browser.key("s")
        browser.value("ssdr.seek(1)")
        seen.append(
            [np.abs(drawn(browser).astype(int) - surface).mean(), engine - surface.astype(int)]
        )
    assert np.abs(seen[0][1]).mean() < 0.05
    assert seen[0][0] < 0.05
    assert np.abs(seen[1][1]).mean() > 1
    assert seen[2][1].mean() < -1  # inwards: dark
    assert seen[2][0] < 0.05  # the surface has the same hard edges


def test_the_error_of_normals_is_an_angle_on_a_scale_of_its_own(opened):
    """Three squares whose rest normals are off by 0°, half of and the whole top of the scale."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    rest = np.concatenate([square + 1.2 * k * np.eye(3)[0] for k in range(3)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    faces = np.concatenate([faces + 4 * k for k in range(3)])
    angle = np.radians([0, 0, 20, 20, 40, 40])
    normals = np.stack([0 * angle, np.sin(angle), np.cos(angle)], axis=1)
    surface = ssdr.Surface(normals=np.repeat(normals[:, None], 3, axis=1).astype(np.float32))
    skin = np.zeros((12, 1), int), np.ones((12, 1)), np.eye(3, 4)[None, None]
    model = ssdr.Skinning(rest, *skin, faces=faces, surface=surface)
    browser = opened(model, ssdr.MeshSequence(rest[None], faces))
    d = "JSON.parse(document.getElementById('document').textContent)"
    heat, top = browser.value(f"[{d}.heat[0], {d}.angles.top]")
    assert top == pytest.approx(40, abs=0.01)
    browser.value("ssdr.camera.azimuth = ssdr.camera.elevation = 0")
    browser.key("l")
    browser.value("ssdr.seek(0)")
    pixels = drawn(browser)
    inside = np.flatnonzero((pixels[..., 3] > 0).any(axis=0))
    row = int(np.flatnonzero((pixels[..., 3] > 0).any(axis=1)).mean())
    for k, share in enumerate((0.5 / 3.4, 0.5, 2.9 / 3.4)):
        at = pixels[row, inside[0] + round(share * np.ptp(inside)), :3] / 255
        expected = np.array([np.interp(7.5 * k, range(16), c) for c in np.transpose(heat)])
        # light changes how bright it is, hardly its hue
        at, expected = (c**2.2 / (c**2.2).sum() for c in (at, expected))
        np.testing.assert_allclose(at, expected, atol=0.03)
    browser.key("s")
    browser.value("ssdr.seek(0)")
    pale = drawn(browser)[row, inside[[10, -10]], :3].astype(int)
    assert np.ptp(pale, axis=0).max() <= 2
    legend = "document.getElementById('legend').textContent"
    assert "≥ 40°" in browser.value(legend)


def test_normals_of_a_surface_are_weighted_by_angles(opened, wave):
    """As rest normals are made: the page finds no error in them, to a fraction of a degree."""
    still = np.tile(np.eye(3, 4), (1, 1, 1, 1))
    n = wave.n_vertices
    skin = np.zeros((n, 1), int), np.ones((n, 1)), still
    normals = surface_normals(wave.frames(0), wave.faces).astype(np.float32)
    model = ssdr.Skinning(
        wave.frames(0), *skin, faces=wave.faces, surface=ssdr.Surface(normals=normals)
    )
    browser = opened(model, ssdr.MeshSequence(wave.vertices[:1], wave.faces))
    browser.key("l")
    browser.value("ssdr.seek(0)")
    heat = browser.value("JSON.parse(document.getElementById('document').textContent).heat[0]")
    pixels = drawn(browser).astype(float)
    linear = (pixels[pixels[..., 3] == 255][:, :3] / 255) ** 2.2
    share, first, third = (
        c / c.sum(axis=-1, keepdims=True) for c in (linear, *np.array(heat)[[0, 2]] ** 2.2)
    )
    assert np.abs(share - first).max() < 0.5 * np.abs(third - first).max()
