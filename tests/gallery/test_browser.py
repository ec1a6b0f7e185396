"""The page of a garment in a browser without a screen: its numbers are those of the network."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from docs.gallery.live.page import Take, write_page
from garmentnet.collision.outward import push_of
from garmentnet.data.parameters import SimulationParameters as P
from garmentnet.networks.checkpoint import load_checkpoint
from helpers import live_garment as made
from helpers.browser import Browser, chromium

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="no Chromium to open a page with"),
]
CLOSE = 1e-4  # metres
SOON = "new Promise(r => requestAnimationFrame(() => requestAnimationFrame(() => r(0))))"


def played(garment, joints, parameters=None):
    return garment.predict(joints, parameters)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("browser")) as tab:
        yield tab


@pytest.fixture
def opened(browser, tmp_path):
    """Write a page and open it in a pause; nothing may go wrong, nothing else be asked for."""

    def call(garment, takes, **options):
        write_page(garment, takes, tmp_path / "page.html", **options)
        browser.open(tmp_path / "page.html")
        browser.value("garmentnet.ready.then(() => garmentnet.set({ playing: false }))")
        return browser

    yield call
    assert browser.complaints() == []
    assert len(browser.requests()) == 1  # the page itself


def vertices(browser, garment, frame=None, which=0):
    if frame is not None:
        browser.value(f"garmentnet.seek({frame}).then(() => 0)")
    out = np.reshape(browser.value(f"Array.from(garmentnet.read({which}))"), (-1, 4))
    return out[: garment.subject.garment.n_vertices, :3]


def settle(browser):
    browser.value(
        "new Promise(r => { const t = setInterval(() => "
        "garmentnet.settled() && (clearInterval(t), r(0)), 20); })"
    )


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"bound": False, "detail": False},
        {"condition": True, "high": {"source": "body"}},
        {"condition": True, "features": {"rotation": "vector", "translation": True}},
        {"features": {"joint_motion": False}},  # as of the dress that ships
        {"features": {"heading_free": False, "frame": "root", "root_motion": False}},
        {"features": {"frame": "world", "joints": ("shin_l", "spine"), "clamp": 0.0}},
        {"low": {"relative_to": "joints"}},
    ],
    ids=str,
)
def test_vertices_are_those_of_the_network(opened, tmp_path, change):
    garment, joints = made.one(made.network(**change)), made.motion(10.1, seed=3)
    joints[..., 3] += [4.0, 0.0, -2.5]
    theta = P(bending=1.3, density=0.15) if garment.reads_parameters else None
    expected = played(garment, joints, theta)
    browser = opened(garment, [Take("other", joints[:20]), Take("one", joints)], parameters=theta)
    browser.value("garmentnet.set({ clip: 1 })")
    for frame in (0, 1, 300, 45):  # back again, too
        off = vertices(browser, garment, 20 + frame) - expected[frame]
        assert np.abs(off).max() < CLOSE
    assert np.ptp(expected[:, :, 1].mean(axis=1)) > 0.01  # it moves


def test_the_dress_is_pushed_out_of_a_leg_but_not_of_one_turned_by_hand(opened):
    plain = load_checkpoint("dress")
    skeleton, count = plain.subject.skeleton, 24
    turns = np.zeros((count, skeleton.n_joints, 3))
    turns[:, skeleton.names.index("thigh_l"), 0] = np.linspace(0, -1.5, count)
    root = np.tile(skeleton.rest[0], (count, 1))
    rotations = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix()
    joints = skeleton.transforms(root, rotations.reshape(count, -1, 3, 3))
    without = played(plain, joints, P())
    expected = push_of(plain.subject)(without, joints).vertices
    far = np.abs(expected - without).max(axis=(1, 2))
    assert far.max() > 5e-3
    truth = expected + np.float32(0.01)
    browser = opened(plain, [Take("kick", joints, truth)], parameters=P())
    for frame in (int(far.argmax()), 0, count - 1):
        assert np.abs(vertices(browser, plain, frame) - expected[frame]).max() < CLOSE
    browser.value("garmentnet.set({ view: 'input' })")
    shown = vertices(browser, plain, int(far.argmax()), which=1)
    assert np.abs(shown - truth[int(far.argmax())]).max() < 4e-4  # rounded to a step
    browser.value("garmentnet.set({ view: 'result', parameters: [1, 0.2, 1] })")
    settle(browser)
    assert np.abs(vertices(browser, plain) - expected[int(far.argmax())]).max() > CLOSE


def test_a_pause_stands_still_and_a_sleeping_tab_does_not_jump(opened, tmp_path):
    garment, joints = made.one(made.network()), made.motion(4.0, seed=2)
    browser = opened(garment, [Take("one", joints)])
    before = vertices(browser, garment, 40)
    browser.value(SOON)
    assert np.array_equal(vertices(browser, garment), before)
    # The page is told the times of its frames: 1.5 seconds without any would be 45 frames.
    browser.value("window.later = requestAnimationFrame; later(t => { window.now = t; })")
    browser.value(SOON)
    browser.value("window.requestAnimationFrame = tick => { window.tick = tick; }; 0")
    browser.value("garmentnet.set({ playing: true })")
    frames = browser.value("[0, 1500].map(ms => (tick(now + ms), garmentnet.state.frame))")
    assert frames == [40, 43]
    # in this order: the browser's own times lie before those that the page was told
    browser.value("garmentnet.set({ playing: false })")
    browser.value("window.requestAnimationFrame = later; later(tick)")
    browser.value(SOON)
    now = browser.value("garmentnet.state.frame")
    expected = played(garment, joints)[now]
    assert np.abs(vertices(browser, garment) - expected).max() < CLOSE
    assert np.abs(vertices(browser, garment, 40) - before).max() < 1e-6


def test_parameters_have_sliders_where_they_are_read(opened, tmp_path):
    joints = made.motion(1.0, seed=2)
    browser = opened(made.one(made.network()), [Take("one", joints)])
    assert browser.value("document.getElementById('parameters').hidden")
    garment = made.one(made.network(condition=True))
    browser = opened(garment, [Take("one", joints)], parameters=P(bending=1.1))
    box = "document.querySelectorAll('#parameters input')"
    assert browser.value(f"[...{box}].map(x => Number(x.value))") == [1.1, 0.2, 1.0]
    for bending in (0.2, 2.0):
        browser.value(
            f"{box}[0].value = {bending}; {box}[0].dispatchEvent(new Event('input'));"
            "garmentnet.set({ frame: 0 })"
        )
        got = vertices(browser, garment, 29)
        assert np.abs(got - played(garment, joints, P(bending=bending))[29]).max() < CLOSE


def test_a_limb_turned_by_hand_takes_the_garment_along(opened, tmp_path):
    garment, joints = made.one(made.network()), np.tile(np.eye(3, 4), (5, 6, 1, 1))
    browser = opened(garment, [Take("still", joints)])
    before = vertices(browser, garment, 4)
    browser.value("garmentnet.set({ bone: 2 })")
    slide = "document.querySelectorAll('#turn-sliders input')[0]"
    browser.value(f"{slide}.value = -40; {slide}.dispatchEvent(new Event('input'))")
    settle(browser)
    after = vertices(browser, garment)
    # The pose is held for as long as the page goes on: the network comes to the same rest.
    pose = joints.copy()
    turn = np.radians(-40)
    c, s = np.cos(turn), np.sin(turn)
    r = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    head = garment.subject.skeleton.rest[2]
    pose[:, 2:4, :, :3], pose[:, 2:4, :, 3] = r, head - r @ head
    expected = played(garment, np.concatenate([joints, pose.repeat(18, axis=0)]))[-1]
    assert np.abs(after - expected).max() < 2e-3
    assert np.abs(after - before).max() > 0.01
    browser.value(SOON)
    assert np.array_equal(vertices(browser, garment), after)
    browser.key("Escape")
    settle(browser)
    assert np.abs(vertices(browser, garment, 3) - before).max() < 0.05


def test_the_truth_beside_the_prediction(opened, tmp_path):
    garment, joints = made.one(made.network()), made.motion(2.0, seed=2)
    truth = played(garment, joints) + np.linspace(0, 0.1, 60, dtype=np.float32)[:, None, None]
    browser = opened(garment, [Take("one", joints, truth), Take("two", joints)])
    shown = "!document.querySelector('[data-truth]').hidden"
    assert browser.value(shown)
    for key in "3e":
        browser.key(key)
        assert np.abs(vertices(browser, garment, 50, which=1) - truth[50]).max() < 2e-4
    errors = browser.value("JSON.parse(document.getElementById('document').textContent).error.mean")
    np.testing.assert_allclose(errors[:60], 1e3 * np.sqrt(3) * np.linspace(0, 0.1, 60), atol=0.02)
    browser.value("garmentnet.set({ turns: new Map([[1, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]]]) })")
    assert browser.value("garmentnet.state.view") == "result"  # another pose has no truth
    browser.value("garmentnet.set({ clip: 1 })")
    assert not browser.value(shown)


def test_hostile_names_do_nothing(opened, tmp_path):
    joints = made.motion(0.5)
    names = [f"<img src=x onerror=alert({k})></script><!--" for k in range(3)] + ["🦴" * 5000, ""]
    title = "<b>&amp;</title>"
    browser = opened(made.one(made.network()), [Take(name, joints) for name in names], title=title)
    assert browser.value("document.querySelectorAll('img, b').length") == 0
    assert browser.value("document.title") == title
    assert browser.value("document.querySelector('#clip option').textContent") == names[0]
    for key in "jnf j":
        browser.key(key)


def test_an_arm_of_the_dress_is_clicked_and_dragged(opened):
    garment = load_checkpoint("dress")
    joints = np.tile(np.eye(3, 4), (3, garment.subject.skeleton.n_joints, 1, 1))
    browser = opened(garment, [Take("still", joints)])
    before = vertices(browser, garment, 2)
    arm, thigh = (garment.subject.skeleton.names.index(n) for n in ("arm_l", "thigh_l"))
    (x, y), hip = (browser.value(f"garmentnet.place({b})")[:2] for b in (arm, thigh))
    hand = browser.value(f"garmentnet.place({arm + 1})")
    browser.click((x + hand[0]) / 2, (y + hand[1]) / 2)
    assert browser.value("garmentnet.state.bone") == arm
    view = browser.value("[garmentnet.camera.azimuth, garmentnet.camera.distance]")
    browser.drag((x, y), (x + 20, y + 20), (x + 30, y + 60))
    assert browser.value("garmentnet.state.turns.size") == 1
    assert browser.value("[garmentnet.camera.azimuth, garmentnet.camera.distance]") == view
    settle(browser)
    assert 0.002 < np.abs(vertices(browser, garment) - before).max() < 1.0
    browser.key("Escape")
    browser.key("Escape")
    browser.click(*hip)  # the dress has no joint to be turned
    assert browser.value("[garmentnet.state.bone, garmentnet.state.turns.size]") == [-1, 0]
