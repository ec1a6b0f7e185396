"""Input on which decompositions are known to fail, as one table.

Each case says what to decompose, and either which argument the error names or the
same problem without the disturbance, whose error the disturbed one must reach.
Errors are relative: rmse over the size that the case names (the diagonal of the
undisturbed frames), so that shifted and scaled input can be compared.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable
from typing import Any

import motions
import numpy as np

import ssdr

SEEDS = 3


@dataclasses.dataclass(frozen=True)
class Problem:
    """Arguments of one call and the size that its error is measured by."""

    frames: Any
    size: float
    faces: Any = None
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def solve(self, seeds: int = 1) -> ssdr.Decomposition:
        """The best of so many seeds."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ssdr.SsdrWarning)  # fewer bones would often do
            results = [
                ssdr.decompose(self.frames, self.faces, rng=seed, **({"bones": 4} | self.options))
                for seed in range(seeds)
            ]
        return min(results, key=lambda result: result.rmse)


@dataclasses.dataclass(frozen=True)
class Case:
    """A disturbed problem.

    `refused` names the argument of the expected error.  Otherwise the relative
    error must be at most ``factor`` times that of `undisturbed` (0 where there is
    none: the data is exact) plus ``slack``, which is what the storage loses.
    Of two problems that are compared the best of three seeds counts: rounding alone
    can lead a single run to the minimum next door.
    """

    name: str
    disturbed: Callable[[], Problem]
    undisturbed: Callable[[], Problem] | None = None
    refused: str | None = None
    factor: float = 1.1
    slack: float = 1e-9
    only_valid: bool = False


def diagonal(frames: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(frames, axis=1), axis=1).max())


@functools.cache
def rig() -> motions.Rig:
    return motions.chain(bones=4, rows=16, frames=16)


@functools.cache
def base() -> np.ndarray:
    frames = motions.wobble(rig(), 0.05)
    frames.setflags(write=False)
    return frames


def plain(**options: Any) -> Problem:
    return Problem(base(), diagonal(base()), rig().faces, options)


def changed(change: Callable[[np.ndarray], Any], faces: Any = None, **options: Any) -> Problem:
    faces = rig().faces if faces is None else faces
    return Problem(change(np.array(base())), diagonal(base()), faces, options)


def put(index: Any, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(frames: np.ndarray) -> np.ndarray:
        frames[index] = value
        return frames

    return change


def scaled(factor: float) -> Problem:
    return Problem(base() * factor, diagonal(base()) * factor, rig().faces)


def still(**options: Any) -> Problem:
    return Problem(np.repeat(base()[:1], 8, axis=0), diagonal(base()), rig().faces, options)


def one_motion(**options: Any) -> Problem:
    frames = np.stack(
        [base()[0] @ motions.rotation(0.4 * t, -t, 0.2).T + [t, 0, 0] for t in range(8)]
    )
    return Problem(frames, diagonal(base()), rig().faces, options)


def soup(exact: bool) -> Problem:
    frames = rig().frames if exact else base()
    corners = frames[:, rig().faces.ravel()]
    return Problem(corners, diagonal(frames), np.arange(corners.shape[1]).reshape(-1, 3))


def soup_as_importance() -> Problem:
    """The mesh whose vertices count as often as triangles use them."""
    count = np.bincount(rig().faces.ravel(), minlength=base().shape[1]).astype(float)
    return plain(vertex_importance=count)


def components() -> Problem:
    """41 bodies, moved by ten motions, in no order."""
    bodies = motions.boxes(41, frames=16, points=8)
    owner = np.random.default_rng(3).permutation(np.arange(41) % 10)
    moves = motions.boxes(10, frames=16).transforms
    frames = motions.blend(bodies.rest, np.repeat(owner, 8)[:, None], np.ones((328, 1)), moves)
    corner = 8 * np.arange(41)[:, None, None] + np.array([[0, 1, 2], [3, 4, 5], [5, 6, 7]])
    return Problem(frames, diagonal(frames), corner.reshape(-1, 3), {"bones": 10})


def few_poses(rest: np.ndarray) -> Problem:
    return Problem(base()[[0, 5, 11]], diagonal(base()), rig().faces, {"rest": rest})


def far_rest() -> np.ndarray:
    return rig().rest @ motions.rotation(0, 2.0, 1.0).T + [300.0, -200.0, 50.0]


def doubled(apart: bool) -> Problem:
    """A sheet and its copy, at the same place or parting after the first frame."""
    frames = np.concatenate([base(), base()], axis=1)
    if apart:
        half = base().shape[1]
        body = motions.blend(
            rig().rest, np.zeros((half, 1), int), np.ones((half, 1)),
            motions.boxes(1, frames=16).transforms,
        )  # fmt: skip
        frames = np.concatenate([body, np.repeat(body[:1], 16, axis=0)], axis=1)
    faces = np.concatenate([rig().faces, rig().faces + base().shape[1]])
    return Problem(frames, diagonal(base()), faces, {"bones": 2} if apart else {})


def teleport(frames: np.ndarray) -> np.ndarray:
    frames[7] = frames[7] @ motions.rotation(1, 2, 3).T + [1000.0, -2000.0, 500.0]
    return frames


def mirrored(frames: np.ndarray) -> np.ndarray:
    frames[8:] *= [-1, 1, 1]
    return frames


def flat(keep: list[int], effort: str = "best") -> Problem:
    """The exact chain with a rest pose in a plane or on a line."""
    rest = rig().rest * np.isin([0, 1, 2], keep)
    frames = motions.blend(rest, rig().joints, rig().weights, rig().transforms)
    return Problem(frames, diagonal(frames), rig().faces, {"effort": effort})


def nearly_still() -> Problem:
    """Exact bones that move by a hundred-thousandth of the size; measured by that motion."""
    tiny = motions.chain(bones=4, rows=16, frames=16, bend=1e-5)
    frames = tiny.frames
    size = float(np.linalg.norm(frames - frames[0], axis=-1).max())
    return Problem(frames, size, tiny.faces, {"effort": "best"})


def flips() -> Problem:
    """Bodies that turn by half a circle from frame to frame."""
    bodies = motions.boxes(3, frames=10)
    moves = bodies.transforms.copy()
    for b in range(3):
        axis = np.eye(3)[b]
        for t in range(10):
            moves[t, b, :, :3] = motions.rotation(*(np.pi * (t % 2) * axis))
    frames = motions.blend(bodies.rest, bodies.joints, bodies.weights, moves)
    return Problem(frames, diagonal(frames), None, {"bones": 3})


def lonely() -> Problem:
    """One vertex that moves by itself beside a body: a bone of almost no weight."""
    body = motions.boxes(1, points=200, frames=10).frames
    alone = 9 + np.random.default_rng(0).standard_normal((10, 1, 3))
    frames = np.concatenate([body, alone], axis=1)
    return Problem(frames, diagonal(frames), None, {"bones": 2})


CASES = [
    # refused
    Case("a NaN", lambda: changed(put((3, 5, 1), np.nan)), refused="vertices"),
    Case("an Inf", lambda: changed(put((3, 5, 1), -np.inf)), refused="vertices"),
    Case(
        "face index out of range",
        lambda: changed(np.array, faces=rig().faces + 1),
        refused="faces",
    ),
    Case("face index negative", lambda: changed(np.array, rig().faces - 1), refused="faces"),
    Case("faces of four corners", lambda: changed(np.array, [[0, 1, 2, 3]]), refused="faces"),
    Case("no vertices", lambda: changed(lambda f: f[:, :0], faces=[]), refused="vertices"),
    Case("no frames", lambda: changed(lambda f: f[:0]), refused="vertices"),
    Case("one dimension too few", lambda: changed(lambda f: f[0]), refused="vertices"),
    Case("one dimension too many", lambda: changed(lambda f: f[None]), refused="vertices"),
    Case("two coordinates", lambda: changed(lambda f: f[..., :2]), refused="vertices"),
    Case("complex numbers", lambda: changed(lambda f: f + 0j), refused="vertices"),
    Case("text", lambda: changed(lambda f: f.astype("U8")), refused="vertices"),
    Case("0 bones", lambda: plain(bones=0), refused="bones"),
    Case("V + 1 bones", lambda: plain(bones=97), refused="bones"),
    Case("-3 bones", lambda: plain(bones=-3), refused="bones"),
    # stored or numbered otherwise
    Case("offset 1e6, float64", lambda: changed(lambda f: f + 1e6), plain),
    Case(
        "offset 1e2, float32",
        lambda: changed(lambda f: (f + 1e2).astype(np.float32)),
        plain,
        slack=1e-5,
    ),
    Case("scale 2^20", lambda: scaled(2.0**20), plain, factor=1 + 1e-9),
    Case("scale 1e6", lambda: scaled(1e6), plain),
    Case("scale 1e-6", lambda: scaled(1e-6), plain),
    Case("float16", lambda: changed(lambda f: f.astype(np.float16)), plain, slack=1e-3),
    Case(
        "integers",
        lambda: Problem(np.rint(base() * 1e4).astype(int), diagonal(base()) * 1e4),
        plain,
        slack=1e-4,
    ),
    Case("big-endian", lambda: changed(lambda f: f.astype(">f8")), plain),
    Case("every other vertex of a larger array", lambda: changed(
        lambda f: np.repeat(f, 2, axis=1)[:, ::2]), plain),
    Case("column order", lambda: changed(np.asfortranarray), plain),
    # meshes
    Case("point cloud", lambda: changed(np.array, faces=[]), plain),
    Case("unreferenced vertices", lambda: changed(np.array, rig().faces[:40]), plain),
    Case("triangle soup", lambda: soup(False), soup_as_importance),
    Case("triangle soup, exact", lambda: soup(True), slack=1e-4),
    Case("41 components", components, slack=1e-6),
    Case("degenerate faces", lambda: changed(
        np.array, np.concatenate([rig().faces, [[3, 3, 3], [4, 4, 5], [0, 6, 12]]])), plain),
    Case("degenerate faces, smooth", lambda: changed(
        np.array, np.concatenate([rig().faces, [[3, 3, 3]]]), smoothness=0.01),
        lambda: plain(smoothness=0.01)),
    Case("duplicated sheet", lambda: doubled(False), plain),
    Case("duplicated sheet that parts", lambda: doubled(True), slack=1e-6),
    # poses
    Case("few poses, far rest", lambda: few_poses(far_rest()), lambda: few_poses(rig().rest)),
    Case("one frame", lambda: changed(lambda f: f[:1]), slack=1e-9),
    Case("static", still, slack=1e-7),
    Case("static, 20 bones", lambda: still(bones=20), slack=1e-7),
    Case("one rigid motion", one_motion, slack=1e-7),
    Case("one rigid motion, 20 bones", lambda: one_motion(bones=20), slack=1e-7),
    Case("teleporting frame", lambda: changed(teleport), plain),
    Case("reflection mid-sequence", lambda: changed(mirrored), only_valid=True),
    Case("planar rest pose", lambda: flat([0, 2]), slack=1e-4),
    Case("collinear rest pose", lambda: flat([2]), slack=1e-4),
    Case("all points identical", lambda: Problem(np.ones((5, 10, 3)), 1.0), slack=1e-9),
    Case("all points identical, moving", lambda: Problem(
        np.ones((5, 10, 3)) * np.arange(5.0)[:, None, None], 1.0), slack=1e-9),
    Case("nearly still", nearly_still, slack=1e-3),
    Case("half turns from frame to frame", flips, slack=1e-6),
    # numbers of bones
    Case("1 bone", lambda: plain(bones=1), only_valid=True),
    Case("V bones", lambda: plain(bones=96), slack=1e-6),
    Case("V - 1 bones", lambda: plain(bones=95), slack=1e-3),
    Case("one vertex", lambda: Problem(base()[:, :1], diagonal(base()), None, {"bones": 1})),
    Case("two vertices", lambda: Problem(base()[:, [0, 50]], diagonal(base()), None, {"bones": 2})),
    Case("a bone of almost no weight", lonely, slack=1e-6),
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What came of a case; `bound` is what its relative error must not exceed."""

    case: str
    outcome: str
    figure: float | None = None
    undisturbed: float | None = None
    bound: float | None = None

    @property
    def passed(self) -> bool:
        if self.outcome != "solved":
            return self.outcome.startswith("refused")
        return self.bound is None or (self.figure is not None and self.figure <= self.bound)


@functools.cache
def _figure(make: Callable[[], Problem]) -> float:
    problem = make()
    return problem.solve(SEEDS).rmse / problem.size


def run(case: Case) -> Outcome:
    """Solve a case; every model that comes back is checked from outside."""
    problem = case.disturbed()
    try:
        result = problem.solve(1 if case.undisturbed is None else SEEDS)
    except ssdr.InputError as error:
        if error.argument != case.refused:
            return Outcome(case.name, f"WRONG ERROR: {error}")
        return Outcome(case.name, f"refused: {error}")
    if case.refused is not None:
        return Outcome(case.name, "NOT REFUSED")
    frames = np.asarray(problem.frames, dtype=np.float64)
    fault = invalid(result.skinning, frames, problem.options.get("bones", 4))
    if fault:
        return Outcome(case.name, f"INVALID: {fault}")
    s = result.skinning
    gap = motions.blend(s.rest, s.joints, s.weights, s.transforms) - frames
    figure = float(np.sqrt((gap**2).sum(axis=-1).mean())) / problem.size
    reported = result.rmse / problem.size
    if abs(figure - reported) > 1e-4 * figure + 1e-9:
        return Outcome(case.name, f"INVALID: says {reported:.3g}, is {figure:.3g}", figure)
    before = 0.0 if case.undisturbed is None else _figure(case.undisturbed)
    bound = None if case.only_valid else case.factor * before + case.slack
    return Outcome(case.name, "solved", figure, before, bound)


def invalid(s: ssdr.Skinning, frames: np.ndarray, bones: int) -> str:
    """What is wrong with a model, or an empty text."""
    r = s.transforms[..., :3]
    turned = np.abs(np.einsum("tjca,tjcb->tjab", r, r) - np.eye(3)).max()
    tests = {
        "number of bones": s.transforms.shape == (len(frames), bones, 3, 4),
        "rest pose": s.rest.shape == frames.shape[1:] and bool(np.isfinite(s.rest).all()),
        "transforms": bool(np.isfinite(s.transforms).all()),
        "rotations": bool(turned < 1e-6) and bool(np.linalg.det(r).min() > 0),
        "weights": bool(s.weights.min() >= 0)
        and bool(np.abs(s.weights.sum(axis=1) - 1).max() < 1e-6),
        "joints": bool(s.joints.min() >= 0) and bool(s.joints.max() < bones),
    }
    return ", ".join(name for name, good in tests.items() if not good)
