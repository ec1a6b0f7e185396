"""A linear fit, and what it decides: whether virtual bones move relative to the body's joints.

What skinning by the body leaves of a sleeve is small, though the arm moves far; of a hem that hangs
it is not smaller than the motion itself.  A linear map of the pose tells the two apart in seconds.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ..configs.config import Config
from ..data.virtual_bones import VirtualBones
from ..networks.features import PoseFeatures, transforms_in_frame
from ..networks.low_frequency import REACH, BoneCode

_logger = logging.getLogger(__name__)
_FRAMES = 6000  # about as many training frames are tried, in evenly spread clips
_CLIPS = 8  # clips for validation
Array = NDArray[np.float64]
Way = Literal["frame", "joints"]
_WAYS: dict[Way, str] = {"frame": "moving frame", "joints": "joints of the body"}
# Penalties per frame that are tried, from a negligible to a dominant one.
_PENALTIES = 10.0 ** np.arange(-6, 2)
# Smallest deviation by which an input is divided, and largest value of one that is.
_FLOOR, _CLAMP = 0.01, 5.0


@dataclasses.dataclass(frozen=True, eq=False)
class LinearFit:
    """An affine map of inputs that are scaled and clamped.

    Attributes
    ----------
    centre, scale : (D,) float64
    matrix : (D, O) float64
    mean : (O,) float64
    error : float
        Root of the mean squared length of the residuals on the pairs for validation.

    Examples
    --------
    >>> x = np.linspace(-1, 1, 50)[:, None]
    >>> fit = LinearFit.of([(x, 3 * x + 2)], [(x, 3 * x + 2)])
    >>> fit(np.array([[0.5]])).round(3).tolist()
    [[3.5]]
    """

    centre: Array
    scale: Array
    matrix: Array
    mean: Array
    error: float

    @classmethod
    def of(
        cls, learned: Sequence[tuple[Array, Array]], held: Sequence[tuple[Array, Array]]
    ) -> LinearFit:
        """The map with the least error on pairs (F, D), (F, O) that are held back from the fit.

        Without any the smallest penalty is taken.
        """
        x, y = (np.concatenate([pair[k] for pair in learned]) for k in (0, 1))
        centre, scale = x.mean(axis=0), np.maximum(x.std(axis=0), _FLOOR)
        first = cls(centre, scale, np.zeros((x.shape[1], y.shape[1])), y.mean(axis=0), math.inf)
        z = first._scaled(x)
        gram, right = z.T @ z, z.T @ (y - first.mean)
        best = first
        for penalty in len(z) * _PENALTIES:
            factor = cho_factor(gram + penalty * np.eye(len(gram)))
            found = dataclasses.replace(first, matrix=np.asarray(cho_solve(factor, right)))
            gaps = [found(a) - b for a, b in held]
            squares = np.concatenate([np.square(g).sum(axis=1) for g in gaps] or [np.zeros(1)])
            error = math.sqrt(float(squares.mean()))
            if error < best.error:
                best = dataclasses.replace(found, error=error)
        return best

    def _scaled(self, x: Array) -> Array:
        return np.asarray(((x - self.centre) / self.scale).clip(-_CLAMP, _CLAMP))

    def __call__(self, x: Array) -> Array:
        """Outputs (F, O) of inputs (F, D)."""
        return np.asarray(self._scaled(x) @ self.matrix + self.mean)


def resolve_relative_to(
    config: Config, bones: VirtualBones, names: Sequence[str], held: Sequence[str]
) -> Config:
    """The configuration with a choice in place of ``low.relative_to = "auto"``.

    A ridge regression from the pose features to the bones' motion is fitted to training clips in
    either way; the one with the smaller error on validation clips is taken, and said in the log.
    Without validation clips bones move relative to the moving frame.

    Parameters
    ----------
    config : Config
    bones : VirtualBones
    names, held : sequence of str
        Clips for training and for validation.
    """
    if config.low.relative_to != "auto":
        return config
    chosen: Way = "frame"
    if held:
        errors = _errors(config, bones, names, held[:_CLIPS])
        chosen, other = sorted(_WAYS, key=lambda way: errors[way])
        _logger.info(
            "bones move relative to the %s: there a linear trial errs by %.1f mm on validation "
            "clips, relative to the %s by %.1f mm",
            *(x for way in (chosen, other) for x in (_WAYS[way], 1e3 * errors[way])),
        )
    low = dataclasses.replace(config.low, relative_to=chosen)
    return dataclasses.replace(config, low=low)


def _errors(
    config: Config, bones: VirtualBones, names: Sequence[str], held: Sequence[str]
) -> dict[Way, float]:
    """RMSE of the trials in metres, over the bones, of their centres and of points near them."""
    store, o = bones.store, config.features
    features = PoseFeatures(store.skeleton, o, store.fps)
    every = max(1, round(sum(store.clip(n).n_frames for n in names) / _FRAMES))

    def read(name: str) -> tuple[Any, Any, Any]:
        joints = store.clip(name).joints
        x, frame, _ = features(joints)
        moved = transforms_in_frame(bones.transforms(name), frame)
        return x, moved, transforms_in_frame(joints, frame)

    known, checks = ([read(n) for n in some] for some in (names[::every], held))
    moved, joints = (np.concatenate([part[k] for part in known]) for k in (1, 2))
    errors = {}
    for way in _WAYS:
        code = BoneCode(bones.skinning.centroids(), "sixd", follows=way == "joints")
        code.fit(moved, joints)
        # Rotations as metres, so that the error is a distance whatever the bones are relative to.
        unit = np.array([REACH] * 6 + [1.0] * 3)
        pairs = [
            [(x, (code.numbers(m, j) * unit).reshape(len(x), -1)) for x, m, j in some]
            for some in (known, checks)
        ]
        errors[way] = LinearFit.of(*pairs).error / len(code.centres) ** 0.5
    return errors
