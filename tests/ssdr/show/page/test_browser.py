"""A page in a browser without a screen: what it draws is what the model says."""

from __future__ import annotations

import base64
import dataclasses
import io
import itertools

import numpy as np
import pytest
import trimesh
from PIL import Image

import ssdr
from helpers.browser import Browser, chromium
from helpers.drawn import model_normals, surface_normals
from helpers.rig_model import tube

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="no Chromium to open a page with"),
]
FRAMES = (0, 5, 11, 17, 23)


@pytest.fixture(scope="module")
def dancer():
    return ssdr.samples.load("dancer_small")


@pytest.fixture(scope="module")
def model(dancer):
    return ssdr.decompose(dancer, bones=10, effort="fast", rig="rigid").skinning


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("browser")) as tab:
        yield tab


@pytest.fixture
def opened(browser, tmp_path):
    """Write a page and open it; nothing may go wrong, and nothing else may be asked for."""

    def call(*arguments, **options):
        page = ssdr.view(*arguments, path=tmp_path / "page.html", **options)
        browser.open(page.path)
        browser.value("ssdr.ready")
        return browser

    yield call
    assert browser.complaints() == []
    assert len(browser.requests()) == 1  # the page itself


def points(browser, script):
    return np.reshape(browser.value(f"Promise.resolve({script}).then(Array.from)"), (-1, 3))


def drawn(browser, canvas="view"):
    """Pixels of the mesh, or of the marks over it (height, width, RGBA)."""
    script = f"document.getElementById('{canvas}').toDataURL()"
    # read in the frame in which it is drawn, before the browser clears it
    draw = f"new Promise(r => {{ ssdr.set({{}}); requestAnimationFrame(() => r({script})); }})"
    data = base64.b64decode(browser.value(draw).partition(",")[2])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGBA")).copy()


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
        for frame in FRAMES[1:3]:
            browser.value(f"ssdr.seek({frame})")
            turned = np.reshape(browser.value("Array.from(ssdr.mesh.normals())"), (-1, 4))[:, :3]
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
