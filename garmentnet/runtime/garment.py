"""Prediction of a trained garment frame by frame, without torch.

The result is that of :class:`~garmentnet.networks.network.MotionNetwork`, but each vertex is
computed in one pass: at most eight transforms are blended, and the blend also rotates the detail.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import FormatError, InputError
from ssdr.io.file_errors import check, reading

from ..collision.outward import push_of
from ..configs.config import FeatureOptions
from ..data.parameters import SimulationParameters, warn_beyond
from ..data.skeleton import check_joints
from ..data.subject import Subject
from ..io.tensors import load_arrays
from ..networks.document import read_document
from ..networks.features import FRAMES, PoseFeatures, transforms_in_frame
from ..networks.pose_kernels import all_rigid, moving_frame
from .kernels import add_bones, place, skin
from .pivot import Mixture, Pivot, read_pivot

Single = NDArray[np.float32]
# Pivots of less weight are not run: where predictions differ by 0.1 m, that is an error of 0.01 mm.
_NO_WEIGHT = 1e-4
_INFLUENCES = 8  # bones a vertex that the kernel blends


@dataclasses.dataclass(frozen=True, eq=False)
class LiveState:
    """State of a garment after a frame, from which the next frame is computed.

    No step changes it, so a caller may go back to an earlier state.

    Attributes
    ----------
    pose : (18 + P,) float64
        Pose state, as :mod:`garmentnet.networks.pose_kernels` describes it.
    hidden : tuple of (low (H,), high (H,)) float32
        Hidden states of the two GRUs of each pivot.
    bones : (B, 12) float32
        Transforms of the bones in the moving frame, flattened row by row.
    detail : tuple of (1 + rank,) float32
        Weights of the mean detail and the components, for each pivot; arrays are empty without
        detail.
    """

    pose: NDArray[np.float64]
    hidden: tuple[tuple[Single, Single], ...]
    bones: Single
    detail: tuple[Single, ...]


class LiveGarment:
    """Garment that predicts its vertices frame by frame.

    Parameters
    ----------
    subject : Subject
    features : FeatureOptions
    pivots : sequence of Pivot
        The single network, or those of an ensemble.
    mixture : Mixture or None
        Kernel that mixes the networks of an ensemble.
    trained_on : sequence of SimulationParameters or None
        Of each network; None for one that reads the parameters.
    push_out : bool
        Whether vertices are moved out of the body, as
        :class:`~garmentnet.collision.outward.OutwardPush` does; without a closed mesh of the body
        none is moved.

    Raises
    ------
    InputError
        If the features name a joint that the body does not have.
    """

    def __init__(
        self,
        subject: Subject,
        features: FeatureOptions,
        pivots: tuple[Pivot, ...],
        mixture: Mixture | None = None,
        trained_on: Sequence[SimulationParameters | None] = (),
        *,
        push_out: bool = False,
    ) -> None:
        self.subject, self.features, self.pivots, self.mixture = subject, features, pivots, mixture
        self._pose = PoseFeatures(subject.skeleton, features, subject.fps)
        self.read, self.n_features = self._pose.read, self._pose.size
        self.trained_on = tuple(trained_on)
        self._push = push_of(subject) if push_out else None
        self._frame = FRAMES.index(features.frame)
        self._follow = any((p.followed >= 0).any() for p in pivots)
        self._free, self._skin = subject.free, _skin_arrays(subject, pivots[0].high is not None)
        self._sizes = [tuple(map(len, p.start)) for p in pivots]
        self._weights = functools.lru_cache(maxsize=1)(self._weigh)

    @property
    def reads_parameters(self) -> bool:
        """Whether a frame needs simulation parameters."""
        return self.mixture is not None or self.pivots[0].condition

    def step(
        self,
        state: LiveState | None,
        pose: Any,
        parameters: SimulationParameters | None = None,
    ) -> tuple[LiveState, Single]:
        """State and vertices of the next frame, at the garment's frame rate.

        Parameters
        ----------
        state : LiveState or None
            State after the frame before; None if the motion starts here, from rest.
        pose : (J, 3, 4) array
            World transforms of the body's joints from its rest pose, metres.
        parameters : SimulationParameters, optional
            Simulation parameters, for a garment that reads them.

        Returns
        -------
        state : LiveState
        vertices : (V, 3) float32
            World positions in metres.

        Raises
        ------
        InputError
            If the pose does not fit the body, is not finite or not rigid, the state is that of
            another garment, or parameters are missing.

        Warns
        -----
        SsdrWarning
            If the parameters are new and lie outside the trained range.
        """
        m = self.checked(pose)
        state = self.advance(state, m, parameters)
        return state, self.vertices(state, m)

    def checked(self, pose: Any) -> NDArray[np.float64]:
        """A pose as float64; InputError unless it fits the body and is finite and rigid."""
        try:
            m = np.ascontiguousarray(pose, np.float64)
        except (TypeError, ValueError) as error:
            raise InputError("pose", "numbers", str(error)) from error
        shape = (self.subject.skeleton.n_joints, 3, 4)
        if m.shape != shape:
            raise InputError("pose", f"shape {shape}", m.shape)
        if not all_rigid(m):
            check_joints(m[None], len(m))  # names the joint
        return m

    def advance(
        self,
        state: LiveState | None,
        pose: NDArray[np.float64],
        parameters: SimulationParameters | None = None,
    ) -> LiveState:
        """The state after the next frame, without its vertices; arguments as for :meth:`step`."""
        if parameters is not None and not isinstance(parameters, SimulationParameters):
            raise InputError("parameters", "SimulationParameters", type(parameters).__name__)
        if state is not None and not self._owns(state):
            raise InputError("state", "one of this garment", "another garment's")
        weights, theta = self._weights(parameters)
        (x,), frame, row = self._pose.of(pose[None], None if state is None else state.pose)
        joints = transforms_in_frame(pose[None], frame) if self._follow else np.empty((1, 0, 3, 4))
        bases = np.concatenate([joints[0], np.eye(3, 4)[None]]).reshape(-1, 12).astype(np.float32)
        bones = np.zeros((self.subject.garment.n_bones, 12), np.float32)
        hidden, detail = [], []
        for k, pivot in enumerate(self.pivots):
            past = pivot.start if state is None else state.hidden[k]
            numbers = pivot.nothing
            if weights[k] > 0:
                moved, numbers, past = pivot(x, theta, past)
                add_bones(moved, pivot.centres, weights[k], pivot.followed, bases, bones)
            hidden.append(past)
            detail.append(weights[k] * numbers)
        return LiveState(row, tuple(hidden), bones, tuple(detail))

    def _owns(self, state: LiveState) -> bool:
        sizes = [(len(low), len(high)) for low, high in state.hidden]
        return len(state.pose) == self._pose.state_size and sizes == self._sizes

    def vertices(self, state: LiveState, pose: NDArray[np.float64]) -> Single:
        """World positions ``(V, 3)`` of the garment in a state, on the body in a pose; metres."""
        frame, s = np.empty((3, 4)), self.subject
        moving_frame(pose, s.skeleton.rest, self._frame, frame)
        transforms = np.empty((s.garment.n_bones + len(pose), 12), np.float32)
        place(state.bones, pose, frame, transforms)
        some = zip(self.pivots, state.detail, strict=True)
        detail = [n @ p.basis for p, n in some if p.basis is not None and n[0] > 0]
        added = np.zeros((3, s.garment.n_vertices), np.float32)
        if detail:
            added[:, self._free] = sum(detail[1:], detail[0]).reshape(3, -1)
        out = np.empty((s.garment.n_vertices, 3), np.float32)
        skin(transforms, frame, *self._skin, added, out)
        return out if self._push is None else self._push.frame(out, pose).astype(np.float32)

    def _weigh(self, parameters: SimulationParameters | None) -> tuple[Single, Single]:
        if not self.reads_parameters:
            return np.ones(1, np.float32), np.zeros(0, np.float32)
        if parameters is None:
            raise InputError("parameters", "bending, density and time scale", None)
        warn_beyond(parameters, self.trained_on)  # once for each change: this result is kept
        theta = parameters.normalised()
        if self.mixture is None:
            return np.ones(1, np.float32), theta.astype(np.float32)
        weights = self.mixture(theta)
        weights[weights < _NO_WEIGHT] = 0.0
        return (weights / weights.sum()).astype(np.float32), np.zeros(0, np.float32)


def _skin_arrays(subject: Subject, detailed: bool) -> tuple[Single, NDArray[np.int64], Single]:
    # Rest pose (3, V), bones (V, 8) and weights (V, 8), as the kernel takes them.
    rest, bones, weights = subject.skin(smooth=not detailed)
    missing = _INFLUENCES - bones.shape[1]
    check(missing >= 0, f"{bones.shape[1]} influences a vertex, at most {_INFLUENCES} are run")
    pad = ((0, 0), (0, missing))
    return (
        np.ascontiguousarray(rest.T, np.float32),
        np.pad(bones, pad).astype(np.int64),
        np.pad(weights, pad).astype(np.float32),
    )


def load_live(path: Path | str, *, push_out: bool = False) -> LiveGarment:
    """Read a checkpoint: a single network, one that reads the parameters, or an ensemble.

    Parameters
    ----------
    path : path
        ``.safetensors``, as ``garmentnet train`` writes it, or the name of a garment that ships.
    push_out : bool
        Whether vertices are moved out of the body; see :class:`LiveGarment`.

    Raises
    ------
    InputError
        If there is no such file.
    FormatError
        If the file is something else or damaged, or its networks are of a kind that needs torch:
        with Euler angles of the bones, or with detail that is not a weighted basis.
    """
    file = Path(path)
    arrays, document = load_arrays(file, "checkpoint")
    with reading(file):
        d, subject = read_document(arrays, document)
        kinds = [(r.config.features, r.high) for r in d.networks]
        check(all(kind == kinds[0] for kind in kinds), "pivots that differ in features or modules")
        mixture = Mixture.read(arrays, d)
        pivots = tuple(read_pivot(arrays, k, r, subject) for k, r in enumerate(d.networks))
        trained_on = [r.parameters for r in d.networks]
        garment = LiveGarment(subject, kinds[0][0], pivots, mixture, trained_on, push_out=push_out)
        for pivot in pivots:
            if len(pivot.mean) != garment.n_features:
                raise FormatError(f"{len(pivot.mean)} features, not {garment.n_features}")
        return garment
