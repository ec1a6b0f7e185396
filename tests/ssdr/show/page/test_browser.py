"""A page in a browser without a screen: what it draws is what the model says."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
import trimesh

import ssdr
from helpers.browser import Browser, chromium, drawn, points
from helpers.rig_model import tube

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="no Chromium to open a page with"),
]
FRAMES = (0, 5, 11, 17, 23)


def test_the_shader_skins_as_the_model_does(opened, dancer, model):
    browser = opened(model, dancer)
    browser.value("ssdr.set({view: 'side'})")
    within = 1e-5 * dancer.diagonal()
    span = np.abs(dancer.vertices - model.skin()).max() / 32767
    for frame in FRAMES:
        browser.value(f"ssdr.seek({frame})")
        for read, truth, more in (
            ("ssdr.read(0)", model.skin()[frame], 0.0),
            (f"ssdr.vertices({frame})", model.skin()[frame], 0.0),
            ("ssdr.read(1)", dancer.vertices[frame], 0.5 * span),
            (f"ssdr.input({frame})", dancer.vertices[frame], 0.5 * span),
        ):
            np.testing.assert_allclose(points(browser, read), truth, atol=within + more)


def test_the_page_opens_playing_beside_the_input(browser, dancer, model, tmp_path):
    browser.scheme("light", "no-preference")
    browser.open(ssdr.view(model, dancer, tmp_path / "page.html").path)
    opened = "ssdr.ready.then(() => [ssdr.state.view, ssdr.state.playing])"
    assert browser.value(opened) == ["side", True]
    browser.scheme("light")


def test_two_sequences_side_by_side_with_their_error(opened, dancer, model):
    other = dataclasses.replace(dancer, vertices=model.skin())
    browser = opened(other, dancer)
    within = 1e-5 * dancer.diagonal()
    span = np.abs(dancer.vertices - model.skin()).max() / 32767
    browser.value("ssdr.seek(17)")
    np.testing.assert_allclose(points(browser, "ssdr.read(0)"), other.vertices[17], atol=within)
    truth = dancer.vertices[17]
    np.testing.assert_allclose(points(browser, "ssdr.read(1)"), truth, atol=within + span)
    assert browser.value("[ssdr.state.view, ssdr.state.color]") == ["side", "error"]
    hidden = "[...document.querySelectorAll('[type=radio]')].filter(r => !r.closest('[hidden]'))"
    offered = ["result", "input", "side", "overlay", "slider", "plain", "error", "normals"]
    assert browser.value(f"{hidden}.map(r => r.value)") == offered
    assert browser.value("document.getElementById('bones').hidden")


def test_a_joint_turned_by_hand_is_a_pose(opened, dancer, model):
    browser = opened(model, dancer)
    local = model.local_transforms()[3]
    bone = int(np.flatnonzero(np.asarray(model.parents) >= 0)[0])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    rotations = local[..., :3].copy()
    rotations[bone] = rotations[bone] @ turn
    roots = local[np.asarray(model.parents) < 0, :, 3]
    posed = model.pose(rotations, roots).skin()[0]
    matrix = np.eye(3, 4)
    matrix[:, :3] = turn
    browser.value(f"ssdr.set({{turns: new Map([[{bone}, {matrix.ravel().tolist()}]])}})")
    browser.value("ssdr.seek(3)")
    extent = np.ptp(model.rest, axis=0).max()
    np.testing.assert_allclose(points(browser, "ssdr.read(0)"), posed, atol=1e-4 * extent)
    assert not browser.value("document.getElementById('posed').hidden")
    stale = "document.getElementById('now').classList.contains('stale')"
    assert browser.value(stale)
    for change, shown in (("view: 'side'", model.skin()[3]), ("view: 'result'", posed)):
        browser.value(f"ssdr.set({{{change}}}); ssdr.seek(3)")
        np.testing.assert_allclose(points(browser, "ssdr.read(0)"), shown, atol=1e-4 * extent)
    browser.key("Escape")
    browser.value("ssdr.seek(3)")
    np.testing.assert_allclose(points(browser, "ssdr.read(0)"), model.skin()[3], atol=1e-5 * extent)
    assert not browser.value(stale)


def test_every_control_changes_the_picture(opened, dancer, model):
    browser = opened(model, dancer)
    seen = [drawn(browser)]
    for key in "23541ewclsb":
        browser.key(key)
        seen.append(drawn(browser))
        assert (seen[-1][..., 3] > 0).mean() > 0.01
    for was, now in itertools.pairwise(seen):
        assert (was != now).any()
    for key in ("j", "n"):
        browser.key(key)
    assert browser.value("ssdr.state.joints && ssdr.state.names")
    browser.key("ArrowRight")
    assert browser.value("ssdr.state.frame") == 1
    browser.value("ssdr.set({playing: true})")
    # a slow machine may take a while to the next frame
    moved = "new Promise(r => { const t = setInterval(() => ssdr.state.frame > 1 && r(1), 50); })"
    assert browser.value(moved)
    browser.key(" ")
    assert not browser.value("ssdr.state.playing")


def test_a_click_finds_the_bone_of_a_vertex(opened, model):
    browser = opened(model)
    pixels = drawn(browser)[..., 3] > 0
    y, x = (round(v) for v in np.argwhere(pixels).mean(axis=0))
    x = int(np.flatnonzero(pixels[y])[np.abs(np.flatnonzero(pixels[y]) - x).argmin()])
    browser.click(x, y)
    vertex, bone = browser.value("[ssdr.state.vertex, ssdr.state.bone]")
    assert vertex >= 0
    assert bone == model.indices[vertex, model.weights[vertex].argmax()]
    browser.click(2, 300)
    assert browser.value("[ssdr.state.vertex, ssdr.state.bone]") == [-1, -1]


def test_the_view_turns_moves_and_zooms_by_mouse_and_fingers(opened, model):
    browser = opened(model)
    camera = "[ssdr.camera.azimuth, ssdr.camera.elevation, ssdr.camera.distance]"
    place = "ssdr.camera.target"
    start, here = browser.value(camera), browser.value(place)
    browser.drag((300, 300), (350, 320))
    turned = browser.value(camera)
    assert turned[0] != start[0]
    assert turned[1] != start[1]
    assert turned[2] == start[2]
    browser.drag((300, 300), (350, 320), modifiers=8)
    assert browser.value(camera) == turned
    assert browser.value(place) != here
    browser.mouse("Wheel", 300, 300, deltaX=0, deltaY=-200)
    near = browser.value(camera)
    assert near[2] < turned[2]
    browser.touch("Start", (250, 300), (350, 300))
    browser.touch("Move", (200, 300), (400, 300))
    browser.touch("End")
    assert browser.value(camera)[2] < near[2]


def test_a_drag_in_the_ring_turns_the_joint_and_the_view_stays(opened, dancer, model):
    browser = opened(model, dancer)
    browser.value("ssdr.set({bone: 0})")
    pixels = drawn(browser)[..., 3] > 0
    head = browser.value("ssdr.place(0)")[:2]
    assert pixels[round(head[1]), round(head[0])]
    view = browser.value("[ssdr.camera.azimuth, ssdr.camera.distance]")
    browser.drag(head, (head[0] + 20, head[1] + 5), (head[0] + 60, head[1] + 5))
    assert browser.value("ssdr.state.turns.size") == 1
    assert browser.value("[ssdr.camera.azimuth, ssdr.camera.distance]") == view
    browser.key("Escape")
    browser.drag((100, 100), (150, 110))
    moved = browser.value("[ssdr.camera.azimuth, ssdr.camera.distance]")
    for key in "3145":
        browser.key(key)
    assert browser.value("[ssdr.camera.azimuth, ssdr.camera.distance]") == moved != view


def test_the_rim_of_the_ring_is_a_dial(opened, model):
    """A quarter on the screen is a quarter about the line of sight, by the hand of the screen."""
    browser = opened(model)
    browser.value("ssdr.set({bone: 0})")
    x, y = browser.value("ssdr.place(0)")[:2]
    around = np.linspace(0, np.pi / 2, 12)
    browser.drag(*((x + 38 * np.cos(a), y + 38 * np.sin(a)) for a in around))
    turn = np.reshape(browser.value("ssdr.state.turns.get(0)"), (3, 4))[:, :3]
    back = np.array(browser.value("ssdr.camera.axes()[2]"))
    world = model.transforms[0, 0, :, :3] @ turn @ model.transforms[0, 0, :, :3].T
    np.testing.assert_allclose(world @ back, back, atol=1e-4)
    axis = [world[2, 1] - world[1, 2], world[0, 2] - world[2, 0], world[1, 0] - world[0, 1]]
    np.testing.assert_allclose(axis, -2 * back, atol=1e-3)  # clockwise, by 90 degrees


def test_show_it_turns_the_view_to_the_worst_vertex(opened, dancer, model):
    browser = opened(model, dancer)
    browser.resize(390, 844)
    browser.value("document.querySelector('#figures button').click()")
    frame = int(np.linalg.norm(dancer.vertices - model.skin(), axis=2).max(axis=1).argmax())
    browser.value(f"ssdr.seek({frame})")
    points_ = model.skin()[frame]
    vertex = int(np.linalg.norm(dancer.vertices[frame] - points_, axis=1).argmax())
    d = "JSON.parse(document.getElementById('document').textContent)"
    center, scale = browser.value(f"[{d}.center, {d}.scale]")
    target = np.array(browser.value("ssdr.camera.target")) * scale + center
    np.testing.assert_allclose(target, points_[vertex], atol=1e-4 * scale)
    normal = trimesh.Trimesh(points_, model.faces, process=False).vertex_normals[vertex]
    assert normal @ browser.value("ssdr.camera.axes()[2]") > 0.5
    assert browser.value("document.body.classList.contains('bare')")
    browser.resize(1000, 700)


def test_nothing_stays_drawn_after_deselecting(opened, model):
    browser = opened(model)
    browser.value("ssdr.set({bone: 2})")
    assert drawn(browser, "over").any()
    browser.key("Escape")
    assert not drawn(browser, "over").any()


@pytest.mark.parametrize("size", [(1000, 700), (390, 844)])
def test_the_page_opens_with_the_mesh_in_the_middle(opened, model, size):
    browser = opened(model)
    browser.resize(*size)
    browser.value("new Promise(r => setTimeout(r, 300))")
    rows, columns = (np.flatnonzero((drawn(browser)[..., 3] > 0).any(axis=k)) for k in (1, 0))
    view = "document.getElementById('view')"
    width, height = browser.value(f"[{view}.clientWidth, {view}.clientHeight]")
    assert abs((columns[0] + columns[-1]) / 2 - width / 2) < 0.03 * width
    assert 20 < rows[0] < rows[-1] < height - 20
    assert max(np.ptp(columns) / width, np.ptp(rows) / (height - 130)) > 0.8
    browser.resize(1000, 700)


def test_hostile_names_do_nothing(opened, model):
    names = [f"<img src=x onerror=alert({k})></script>" for k in range(9)] + ["🦴" * 5000]
    hostile = dataclasses.replace(model, bone_names=names, name="<b>&amp;</title>")
    browser = opened(hostile)
    browser.value("ssdr.set({names: true, joints: true, bone: 3, color: 'weight'})")
    assert browser.value("document.querySelectorAll('img, b').length") == 0
    assert browser.value("document.title") == "<b>&amp;</title>"
    first = "document.querySelector('#bone-list .name').textContent"
    assert browser.value(first).startswith(("<img", "🦴"))


@pytest.mark.parametrize("faces", [True, False])
def test_a_sequence_and_a_cloud_of_points(opened, dancer, faces):
    shown = dancer if faces else ssdr.MeshSequence(dancer.vertices[:1])
    browser = opened(shown)
    np.testing.assert_allclose(
        points(browser, "ssdr.read(1)"), dancer.vertices[0], atol=1e-4 * dancer.diagonal()
    )
    assert (drawn(browser)[..., 3] > 0).mean() > 0.01
    assert browser.value("document.getElementById('bones').hidden")


def test_without_webgl_the_page_says_so(dancer, model, tmp_path):
    page = ssdr.view(model, path=tmp_path / "page.html")
    flags = "--disable-3d-apis"
    with Browser(tmp_path / "profile", flags=flags) as browser:
        browser.open(page.path)
        said = "ssdr.ready.catch(() => document.getElementById('message').textContent)"
        assert "does not have" in browser.value(said)


def face():
    """A tube with two expressions, each a clip of two frames, the first at rest."""
    model = tube(frames=4)
    moves = model.transforms.copy()
    moves[::2] = np.eye(3, 4)
    amounts = np.array([[0, 0], [1, 0], [0, 0], [0, 1.0]])
    moved = np.random.default_rng(0).normal(0, 0.1, (2, model.n_vertices, 3))
    moved[0, 30:] = 0
    clips = ssdr.Clip("smile", 0, 2, 24), ssdr.Clip("frown", 2, 4, 24)
    shapes = ssdr.Shapes(moved, amounts)
    bones = dataclasses.replace(model, transforms=moves, clips=clips, fps=None)
    return ssdr.ShapedSkinning(bones, shapes, driven=True)


def test_the_page_plays_shapes_and_drives_expressions(opened):
    model = face()
    browser = opened(model)
    for frame in (1, 3):
        found = browser.value(f"Array.from(ssdr.vertices({frame}))")
        shown = np.reshape(found, (-1, 3))
        np.testing.assert_allclose(shown, model.skin([frame])[0], atol=1e-4)
    sliders = "document.querySelectorAll('#expression-sliders input')"
    assert browser.value(f"{sliders}.length") == 2
    browser.value(f"(() => {{ const s = {sliders}; s[0].value = 50; s[1].value = 100; "
                  "s[1].dispatchEvent(new Event('input')); })()")  # fmt: skip
    frame = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    browser.value(frame)
    shown = np.reshape(browser.value("Array.from(ssdr.read(0))"), (-1, 3))[: model.n_vertices]
    expected = ssdr.drive(model, [[0.5, 1.0]]).skin()[0]
    np.testing.assert_allclose(shown, expected, atol=1e-4)
    browser.value("ssdr.seek(1)")  # a frame takes the weights back
    assert browser.value(f"{sliders}[1].value") == "0"
