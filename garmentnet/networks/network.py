"""The motion network: the garment G = G_LF + G_HF from body motion, at once or frame by frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..configs.config import Config
from ..data.skeleton import check_joints
from ..data.subject import Subject
from ..paper.bones import TorchSkinning, apply_frame, moved, turn
from ..paper.high import HighFrequency
from ..paper.low import BoneCode, LowFrequency
from .detail_basis import DetailBasis
from .features import Normaliser, PoseFeatures, PoseReader, transforms_in_frame

# Frames that are predicted at once, which bounds the memory; results do not depend on it.
FRAMES_AT_ONCE = 120


# State of a network between two frames: pose, and hidden states (1, 1, H) of both modules.
State = tuple[NDArray[np.float64] | None, Tensor | None, Tensor | None]


@dataclasses.dataclass(frozen=True, eq=False)
class NetworkOutput:
    """A network's prediction for F frames, in the moving frame.

    Attributes
    ----------
    transforms : (F, B, 3, 4)
        Transforms of the virtual bones.
    low : (F, V, 3)
        Low-frequency mesh, metres.
    high : (F, V, 3) or None
        Detail, metres; None without the high-frequency module.
    frame : (F, 3, 4) float64
        Transforms from the moving frame to the world.
    """

    transforms: Tensor
    low: Tensor
    high: Tensor | None
    frame: NDArray[np.float64]

    def vertices(self) -> NDArray[np.float32]:
        """Vertices ``(F, V, 3)`` in the world, metres."""
        local = self.low if self.high is None else self.low + self.high
        return self.to_world(local)

    def to_world(self, local: Tensor) -> NDArray[np.float32]:
        frame = torch.from_numpy(self.frame)
        return np.asarray(apply_frame(frame, local.double().cpu()).numpy(), np.float32)

    def world_transforms(self) -> NDArray[np.float64]:
        """Transforms ``(F, B, 3, 4)`` of the bones in the world."""
        m = self.transforms.double().cpu().numpy()
        r, t = self.frame[:, None, :, :3], self.frame[:, None, :, 3:]
        moved: NDArray[np.float64] = r @ m
        moved[..., 3:] += t
        return moved


class Predictor:
    """What a network and a checkpoint share: whole motions and single frames from :meth:`run`."""

    # Prediction of consecutive frames that follow a state, and the state after them.
    run: Callable[..., tuple[NetworkOutput, Any]]

    def motions(
        self, joints: Any, parameters: Any = None, *, detail: bool = True
    ) -> list[NetworkOutput]:
        """Outputs for a motion in parts of at most `FRAMES_AT_ONCE`."""
        count = np.shape(joints)[1] if np.ndim(joints) == 4 else 1  # the features check it
        joints, state, out = check_joints(joints, count), None, []
        for start in range(0, len(joints), FRAMES_AT_ONCE):
            part = joints[start : start + FRAMES_AT_ONCE]
            motion, state = self.run(part, state, parameters=parameters, detail=detail)
            out.append(motion)
        return out

    def predict(
        self, joints: Any, parameters: Any = None, *, detail: bool = True
    ) -> NDArray[np.float32]:
        """Vertices ``(F, V, 3)`` of the garment in the world, metres, for a motion of its body."""
        parts = self.motions(joints, parameters, detail=detail)
        return np.concatenate([m.vertices() for m in parts])

    def step(
        self, state: Any, pose: Any, *, parameters: Any = None
    ) -> tuple[Any, NDArray[np.float32]]:
        """New state and world positions ``(V, 3)`` for the next frame, with joints ``(J, 3, 4)``.

        Positions are equal to those of :meth:`predict`, except for rounding.
        """
        motion, state = self.run(np.asarray(pose)[None], state, parameters=parameters)
        return state, motion.vertices()[0]


class MotionNetwork(nn.Module, PoseReader, Predictor):
    """Motion network D: a low- and a high-frequency module on one set of virtual bones.

    Parameters
    ----------
    config : Config
    subject : Subject
    normaliser : Normaliser
        Scaling of the pose features.

    Examples
    --------
    A network for a triangle that hangs from one joint, with random weights:

    >>> from ssdr import Skinning
    >>> from garmentnet.configs.config import LowOptions
    >>> rig = Skinning(
    ...     np.eye(3), np.zeros((3, 1), int), np.ones((3, 1)), np.eye(3, 4)[None, None],
    ...     faces=[[0, 1, 2]], bone_names=("root",),
    ... )
    >>> from garmentnet.data.skeleton import Skeleton
    >>> skeleton = Skeleton(("root",), [-1], [[0, 0, 0]])
    >>> subject = Subject(rig, rig, skeleton, 30.0, "triangle")
    >>> network = MotionNetwork(
    ...     Config(low=LowOptions(hidden=8)), subject, Normaliser(np.zeros(6), np.ones(6), 0.0)
    ... )
    >>> network.predict(np.tile(np.eye(3, 4), (5, 1, 1, 1))).shape
    (5, 3, 3)
    """

    gap: Tensor
    order: Tensor

    def __init__(self, config: Config, subject: Subject, normaliser: Normaliser) -> None:
        nn.Module.__init__(self)
        features = PoseFeatures(subject.skeleton, config.features, subject.fps)
        PoseReader.__init__(self, features, normaliser, 3 if config.data.condition else 0)
        self.config, self.subject = config, subject
        garment = subject.garment
        follows = config.low.relative_to == "joints"
        code = BoneCode(garment.centroids(), config.low.rotation, follows=follows)
        self.low = LowFrequency(self.size, config.low.hidden, code)
        self.high: HighFrequency | DetailBasis | None = None
        # All vertices on the virtual bones and, behind these, on the joints of the body.
        rest, bones, weights = subject.skin(smooth=True)
        count = garment.n_bones + subject.body.n_bones
        self.skinning = TorchSkinning(rest, bones, weights, count)
        self.free = subject.free
        # What smoothing at rest leaves of the bound vertices, and where free and bound ones go.
        gap = (subject.skin(smooth=False)[0] - rest) * subject.carried[:, None]
        order = np.argsort(np.concatenate([self.free, np.flatnonzero(subject.carried)]))
        self.register_buffer("gap", torch.from_numpy(gap.astype(np.float32)), persistent=False)
        self.register_buffer("order", torch.from_numpy(order), persistent=False)

    def add_high(self) -> HighFrequency | DetailBasis:
        """Add the high-frequency module with random weights, on the CPU, and return it."""
        o, garment = self.config.high, self.subject.garment
        inputs = self.low.code.mean.numel() if o.source == "bones" else self.features.size
        inputs += self.condition
        high: HighFrequency | DetailBasis
        if o.kind == "basis":
            high = DetailBasis(inputs, len(self.free), hidden=o.hidden, rank=o.rank)
        else:
            a = np.asarray(garment.rest, np.float64)[garment.faces]
            high = HighFrequency(
                inputs,
                garment.faces,
                garment.n_vertices,
                o,
                edge_length=float(np.linalg.norm(a - a[:, [1, 2, 0]], axis=-1).mean()),
                vertices=self.free,
            )
        self.high = high
        return high

    @property
    def device(self) -> torch.device:
        return next(self.low.parameters()).device

    def blend(self, z: Tensor, joints: Tensor) -> Tensor:
        """Columns ``(..., 4, 3, V)`` of all vertices' transforms, in the moving frame.

        Parameters
        ----------
        z : (..., B, C)
            Normalised bone motion.
        joints : (..., J, 3, 4)
            Joints of the body in the moving frame, which carry the vertices bound to them.
        """
        return self.skinning.blend(torch.cat([self.low.code(z, joints), joints], dim=-3))

    def mesh(self, z: Tensor, joints: Tensor) -> Tensor:
        """Low-frequency mesh ``(..., V, 3)``; arguments as for :meth:`blend`."""
        return moved(self.blend(z, joints), self.skinning.rest)

    def _spread(self, own: Tensor) -> Tensor:
        """Detail ``(F, V, 3)`` of all vertices, from that of the free ones; 0 for the others."""
        none = own.new_zeros(len(own), len(self.gap) - len(self.free), 3)
        return torch.cat([own, none], dim=1).index_select(1, self.order)

    def high_inputs(self, x: Tensor, z: Tensor) -> Tensor:
        """Input ``(N, T, D)`` of the high-frequency module's GRU."""
        if self.config.high.source == "body":
            return x
        return torch.cat([z.flatten(-2), x[..., self.features.size :]], dim=-1)

    @torch.no_grad()
    def run(
        self,
        joints: Any,
        state: State | None = None,
        *,
        parameters: Any = None,
        detail: bool = True,
    ) -> tuple[NetworkOutput, State]:
        """Predict consecutive frames; return them and the state after the last.

        Parameters
        ----------
        joints : (F, J, 3, 4) array
            World transforms of the body's joints from its rest pose.
        state : tuple, optional
            State after the frame before; None if the motion starts here, from rest.
        parameters : (3,) array, optional
            Normalised simulation parameters, for a network that reads them.
        detail : bool
            Whether to run the high-frequency module.

        Raises
        ------
        InputError
            If the joints are not those of the body, not finite or not rigid.
        """
        pose, low_state, high_state = state or (None, None, None)
        features, frame, pose = self.features(joints, pose)
        x = torch.from_numpy(self.inputs(features, parameters)).to(self.device)
        body = torch.from_numpy(transforms_in_frame(joints, frame)).float().to(self.device)
        transforms, low, high, low_state, high_state = self(
            x, body, low_state, high_state, detail=detail
        )
        return NetworkOutput(transforms, low, high, frame), (pose, low_state, high_state)

    def forward(
        self,
        x: Tensor,
        body: Tensor,
        low_state: Tensor | None,
        high_state: Tensor | None,
        *,
        detail: bool = True,
    ) -> tuple[Tensor, Tensor, Tensor | None, Tensor, Tensor | None]:
        """Bones, low part and detail in the moving frame, and the states after the last frame.

        Parameters
        ----------
        x : (T, D)
            Inputs of consecutive frames.
        body : (F, J, 3, 4)
            Joints of the body in the moving frame, of the chosen frames.
        low_state, high_state : (1, 1, H), optional
        detail : bool
        """
        z, low_state = self.low(x[None], low_state)
        transforms = self.low.code(z[0], body)
        blend = self.skinning.blend(torch.cat([transforms, body], dim=-3))
        low, high = moved(blend, self.skinning.rest), None
        if detail and self.high is not None:
            inputs = self.high_inputs(x[None], z)
            if isinstance(self.high, DetailBasis):
                numbers, high_state = self.high(inputs, high_state)
                own = turn(blend, self._spread(self.high.local(numbers[0])))
            else:
                own, high_state = self.high(inputs, low[None], high_state)
                own = own[0]
            high = own + moved(blend, self.gap, turned=True)
        return transforms, low, high, low_state, high_state
