"""Equivariance of a GRU to reflection: a mirrored motion leads to the mirrored state.

The mirror image of a motion moves mirrored cloth, which mirrored clips teach only roughly.  It is
exact if reflecting the input exchanges the two halves of the state: with S the reflection of the
input and P the exchange, h(S x) = P h(x).  The weights of each gate then satisfy U = P U S,
W = P W P and b = P b (Ravanbakhsh, Schneider and Póczos 2017, "Equivariance through
parameter-sharing"): half as many numbers to learn.  Only training knows of it: the weights are
stored and run as those of any GRU.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from ssdr.common.errors import InputError

from ..data.skeleton import mirror_transforms
from .features import PoseReader

_POSES = 32  # random poses by which features are told apart
_ALIKE = 1e-5  # largest difference of a feature from that of which it is the mirror image


def reflected_inputs(reader: PoseReader) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Columns c and signs s ``(D,)`` of the input's reflection S, (S x)_j = s_j x_c(j).

    S is found from poses and their mirror images; simulation parameters stay as they are.

    Raises
    ------
    InputError
        If the input has a joint of one side only.
    """
    features, skeleton = reader.features, reader.features.skeleton
    rng = np.random.default_rng(0)
    turns = Rotation.random(_POSES * skeleton.n_joints, rng=rng).as_matrix()
    local = turns.reshape(_POSES, skeleton.n_joints, 3, 3)
    joints = skeleton.transforms(rng.normal(size=(_POSES, 3)), local)
    plain = features(joints)[0]
    image = features(mirror_transforms(joints, skeleton.mirror()))[0]
    gaps = [np.abs(image[:, :, None] - sign * plain[:, None]).max(axis=0) for sign in (1, -1)]
    columns = linear_sum_assignment(np.minimum(*gaps))[1]
    at = np.arange(len(columns)), columns
    if np.minimum(*gaps)[at].max() > _ALIKE:
        expected = "joints of both sides, where low.symmetric"
        raise InputError("features.joints", expected, features.options.joints)
    signs = np.where(gaps[0][at] <= gaps[1][at], 1.0, -1.0)
    more = np.arange(reader.condition)
    columns = np.concatenate([columns, len(columns) + more])
    return columns, np.concatenate([signs, np.ones(len(more))]).astype(np.float32)


def tie_mirrored(gru: nn.GRU, columns: NDArray[np.integer], signs: NDArray[np.floating]) -> None:
    """Make a GRU's weights those for which h(S x) = P h(x), and keep them so in training.

    Weights that are so already do not change.

    Parameters
    ----------
    gru : torch.nn.GRU
        Of one layer and an even width.
    columns, signs : (D,) array
        The reflection S, from :func:`reflected_inputs`.
    """
    rows = torch.arange(3 * gru.hidden_size).view(3, 2, -1).flip(1).flatten()
    swapped, where, sign = rows[: gru.hidden_size], torch.as_tensor(columns), torch.as_tensor(signs)
    images: dict[str, Callable[[Tensor], Tensor]] = {
        "weight_ih_l0": lambda u: u[rows][:, where] * sign.to(u),
        "weight_hh_l0": lambda w: w[rows][:, swapped],
        "bias_ih_l0": lambda b: b[rows],
        "bias_hh_l0": lambda b: b[rows],
    }
    for name, image in images.items():
        weights = getattr(gru, name)

        def mean(w: Tensor, image: Callable[[Tensor], Tensor] = image) -> Tensor:
            return (w + image(w)) / 2

        with torch.no_grad():
            tied = mean(weights)
            # A mean of random weights is smaller than they are.
            weights.copy_(tied * (weights.norm() / tied.norm()))
        weights.register_hook(mean)
