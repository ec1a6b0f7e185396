"""The polish of hung bones against dense Jacobians, and what its steps hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers import naive, trees
from helpers.tiny import Tiny
from ssdr.hierarchy.transforms import joint_gaps
from ssdr.hierarchy.tree import Tree
from ssdr.joints.placement import hang
from ssdr.kernels.chains import chain_image
from ssdr.solver import chain_polish
from ssdr.solver.chain_polish import ChainPolish
from ssdr.solver.model import FREE, Fixed, Model
from ssdr.solver.trajectories import gather

CASES = {
    "free": FREE,
    "rest": Fixed(rest=True),
    "weights": Fixed(weights=np.arange(8) % 2 == 0),
    "rest and weights": Fixed(rest=True, weights=np.ones(8, dtype=bool)),
    "joints": Fixed(joints=True),
    "motion alone": Fixed(rest=True, weights=np.ones(8, dtype=bool), joints=True),
}
# rotations relative to the parent that bones 0 and 1 keep, where they have one
_TURNS = Rotation.random(60, rng=np.random.default_rng(8)).as_matrix().reshape(20, 3, 3, 3)
_TURNS[:, 2] = np.nan
CASES["locked"] = Fixed(turns=_TURNS[: Tiny(3).frames])
TREES = {"tree": [1, -1, 1], "forest": [-1, 0, -1], "roots alone": [-1, -1, -1]}


@pytest.fixture(params=TREES, ids=str)
def parents(request: pytest.FixtureRequest) -> np.ndarray:
    return np.array(TREES[request.param], dtype=np.int64)


@pytest.fixture(params=CASES, ids=str)
def hung(request: pytest.FixtureRequest, parents: np.ndarray) -> Tiny:
    tiny = Tiny(3, fixed=CASES[request.param])
    points = np.random.default_rng(5).normal(size=(3, 3))
    tiny.model.tree = Tree(parents, points, rigid=False)
    hang(tiny.data, tiny.model, tiny.fixed)
    tiny.polish = ChainPolish(tiny.data, tiny.model, fixed=tiny.fixed, conjugate_steps=2000)
    return tiny


def _chain(tiny: Tiny) -> np.ndarray:
    """Dense matrix from the chain's unknowns to the bones' tangents, by the image of each."""
    polish = tiny.polish
    columns = []
    for k in range(len(polish._zeros())):
        x = polish._zeros()
        x[k] = 1.0
        out = np.empty((tiny.frames, tiny.bones, 6))
        m = tiny.model.transforms
        chain_image(
            m, polish.order, polish.parents, polish.points, *polish._unpacked(x), out, 0, len(m)
        )
        columns.append(out.ravel())
    return np.stack(columns, axis=1)


def test_step_solves_the_dense_reduced_system(hung: Tiny) -> None:
    r, j_m, j_v = hung.jacobians()
    j = j_m @ _chain(hung)
    a, g = j.T @ j, j.T @ r
    if j_v.shape[1]:
        lift = j.T @ j_v @ np.linalg.inv(j_v.T @ j_v)
        a, g = a - lift @ j_v.T @ j, g - lift @ (j_v.T @ r)
    polish = hung.polish
    polish.damping = 1e-2
    # the damping is the polish's own: each unknown's diagonal, averaged over frames
    damped = np.stack([polish_damp(polish, e) for e in np.eye(len(g))])
    want = np.linalg.solve(a + damped, -g)
    got, predicted = polish._solve()
    np.testing.assert_allclose(got, want, atol=2e-3 * np.abs(want).max())
    assert predicted == pytest.approx(-2 * g @ want - want @ a @ want, rel=1e-3)


def polish_damp(polish: ChainPolish, x: np.ndarray) -> np.ndarray:
    from ssdr.solver.moments import bone_sums

    model = polish.model
    u, _ = bone_sums(polish.data, model.indices, model.weights, model.rest, model.n_bones)
    return polish._preconditioner(u)[1](x)


def test_damping_is_the_mean_diagonal_of_the_bones(hung: Tiny) -> None:
    if hung.polish._tied:
        pytest.skip("bones that follow their parent are damped as if they were free")
    _, j_m, _ = hung.jacobians()
    j = j_m @ _chain(hung)
    diagonal = (j**2).sum(axis=0)
    polish = hung.polish
    frames, joints = polish._parts(diagonal)
    polish.damping = 1.0
    ones = polish_damp(polish, np.ones(len(diagonal)))
    own, own_joints = polish._parts(ones)
    np.testing.assert_allclose(own, np.broadcast_to(frames.mean(axis=0), own.shape), rtol=1e-5)
    np.testing.assert_allclose(own_joints, joints, rtol=1e-5, atol=1e-8 * joints.max(initial=1.0))


def test_the_preconditioner_is_symmetric_and_positive(hung: Tiny) -> None:
    from ssdr.solver.moments import bone_sums

    polish, model = hung.polish, hung.model
    u, _ = bone_sums(hung.data, model.indices, model.weights, model.rest, model.n_bones)
    precondition, _ = polish._preconditioner(u)
    matrix = np.stack([precondition(e) for e in np.eye(len(polish._zeros()))])
    scale = np.sqrt(np.abs(np.diag(matrix)))
    matrix = matrix / scale[:, None] / scale
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-9)
    assert np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min() > 0


def test_steps_descend_and_bones_stay_on_their_joints(hung: Tiny) -> None:
    values = [hung.polish.value]
    for k in range(12):
        hung.polish.step(entering=3 if k % 3 == 0 else 0)
        values.append(hung.polish.value)
    model = hung.model
    assert (np.diff(values) <= 0).all()
    assert values[-1] < 0.99 * values[0]
    assert joint_gaps(model.transforms, model.tree.parents, model.tree.points).max() < 1e-13
    inner = np.stack([hung.data.frame(t) for t in range(hung.frames)])
    scaled = inner * hung.data.frame_scale[:, None, None]
    m = model.transforms * hung.data.frame_scale[:, None, None, None]
    want = naive.squared_error(scaled, model.rest, model.indices, model.weights, m)
    np.testing.assert_allclose(model.error, want, rtol=1e-8, atol=1e-12)


def _near_exact(frames: int) -> tuple:
    made = trees.skeleton(6, frames, seed=4)
    data = gather([ssdr.MeshSequence(made.frames)], bones=6)
    rest, transforms = data.from_world(made.rest, made.transforms)
    points, _ = data.from_world(made.points, None)
    rng = np.random.default_rng(0)
    model = Model.start(transforms.copy(), rest, made.indices[:, 0], 2)
    model.indices[:], model.weights[:] = made.indices, made.weights
    points = points + 0.03 * rng.normal(size=points.shape)
    model.tree = Tree(made.parents, points, rigid=False)
    hang(data, model, FREE)
    return data, model


@pytest.mark.parametrize("memory", [None, 0])
def test_exact_data_converges(monkeypatch: pytest.MonkeyPatch, memory: int | None) -> None:
    if memory is not None:  # as few groups of frames as there may be
        monkeypatch.setattr(chain_polish, "_MEMORY", memory)
    data, model = _near_exact(60)
    polish = ChainPolish(data, model)
    first = np.sqrt(polish.value)
    for _ in range(40):
        polish.step(entering=3)
    assert np.sqrt(polish.value) < 2e-3 * first


def test_resumed_polish_goes_on_to_the_bit() -> None:
    (data, whole), (_, parts) = _near_exact(20), _near_exact(20)
    one, two = ChainPolish(data, whole), ChainPolish(data, parts)
    for _ in range(5):
        one.step(entering=3)
        two.step(entering=3)
        two = ChainPolish(data, parts, damping=two.damping, recycled=two.recycled)
    for name in ("transforms", "rest", "indices", "weights", "error"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name)), name
    assert np.array_equal(whole.tree.points, parts.tree.points)
