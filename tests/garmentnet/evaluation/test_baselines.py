import copy
import types

import numpy as np

import ssdr
from garmentnet.evaluation.baselines import BodySkinned, MeanShape, Ridge, body_skinning
from helpers.measures import pooled

TRAIN = [f"base-train-{k}" for k in range(8)]
HELD = ["base-validation-0", "base-validation-1"]


def test_mean_shape_is_the_best_fixed_shape(toy_bones, toy_store):
    clip = toy_store.clip(TRAIN[0])
    whole = clip.sequence.frames(slice(None))
    mean = MeanShape(toy_bones, [TRAIN[0]])
    best = pooled(mean.predict(clip), whole)
    rng = np.random.default_rng(0)
    for _ in range(3):
        mean.shape = mean.shape + 5e-3 * rng.normal(size=mean.shape.shape)
        assert pooled(mean.predict(clip), whole) > best


def test_body_skinned_is_the_rest_pose_at_rest(toy_store):
    at_rest = types.SimpleNamespace(joints=np.tile(np.eye(3, 4), (1, 3, 1, 1)))
    assert np.abs(BodySkinned(toy_store).predict(at_rest)[0] - toy_store.rest).max() < 1e-6
    s = body_skinning(toy_store)
    assert np.allclose(s.weights.sum(axis=1), 1)
    # The hem hangs where the legs are, the waist at the root.
    dense = s.dense_weights()
    assert dense[:16, 0].mean() > dense[-16:, 0].mean()


def test_ridge_finds_a_linear_rule(toy_bones, toy_store):
    # Bones that follow the pose at once: what a static regression can tell exactly.

    fake = copy.copy(toy_bones)

    def posed(name):
        joints = toy_store.clip(name).joints
        moved = np.repeat(joints[:, :1], toy_bones.skinning.n_bones, axis=1)
        return moved.astype(np.float32)

    object.__setattr__(fake, "transforms", posed)
    ridge = Ridge(fake, TRAIN[:3], HELD, np.zeros((toy_store.n_vertices, 3)))
    s = toy_bones.skinning
    expected = ssdr.skin(s.rest, s.indices, s.weights, posed(HELD[0]))
    assert pooled(ridge.predict(toy_store.clip(HELD[0])), expected) < 5e-3
    # With the penalty that is best here, the least one, it is least squares.
    pairs = [ridge._pair(fake, name) for name in TRAIN[:3]]
    x, y = (np.concatenate([p[k] for p in pairs]) for k in (0, 1))
    x = ridge.normaliser(x)
    best = np.linalg.lstsq(x, y - y.mean(axis=0), rcond=None)[0]
    assert np.abs(x @ (ridge.matrix - best)).max() < 0.01 * y.std()
    # Without validation clips the last one tells which penalty is best, and is not learned.
    same = Ridge(fake, [*TRAIN[:3], HELD[0]], [], ridge.high)
    assert np.array_equal(same.matrix, ridge.matrix)
