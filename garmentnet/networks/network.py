"""A motion network D: G = G_LF + G_HF from body motion, in one piece or frame by frame."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ssdr.errors import InputError

from ..configs.config import Config
from ..data.subject import Subject
from .features import Normaliser, PoseFeatures, PoseState
from .high_frequency import HighFrequency
from .low_frequency import BoneCode, LowFrequency
from .skinning import TorchSkinning, apply_frame

__all__ = ["Motion", "MotionNetwork", "NetworkState"]

_CHUNK = 128  # frames that run() sees at once: bounds the memory, changes nothing


@dataclasses.dataclass(frozen=True, eq=False)
class NetworkState:
    """What a network remembers between frames."""

    pose: PoseState | None = None
    low: Tensor | None = None
    high: Tensor | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """What a network says of F frames, before it is put into the world.

    Attributes
    ----------
    transforms : (F, B, 3, 4)
        Of the virtual bones, in the moving frame.
    low : (F, V, 3)
    high : (F, V, 3) or None
    frame : (F, 3, 4) float64
        From the moving frame to the world.
    """

    transforms: Tensor
    low: Tensor
    high: Tensor | None
    frame: NDArray[np.float64]

    def vertices(self) -> NDArray[np.float32]:
        """Positions in the world."""
        local = self.low if self.high is None else self.low + self.high
        return self.to_world(local)

    def to_world(self, local: Tensor) -> NDArray[np.float32]:
        frame = torch.from_numpy(self.frame)
        return np.asarray(apply_frame(frame, local.double().cpu()).numpy(), np.float32)

    def world_transforms(self) -> NDArray[np.float64]:
        """The bones' transforms in the world ``(F, B, 3, 4)``."""
        m = self.transforms.double().cpu().numpy()
        r, t = self.frame[:, None, :, :3], self.frame[:, None, :, 3:]
        moved: NDArray[np.float64] = r @ m
        moved[..., 3:] += t
        return moved


class MotionNetwork(nn.Module):
    """Low- and high-frequency module over one set of virtual bones.

    Parameters
    ----------
    config : Config
    subject : Subject
    normaliser : Normaliser
        Of the pose features.
    """

    def __init__(self, config: Config, subject: Subject, normaliser: Normaliser) -> None:
        super().__init__()
        self.config, self.subject, self.normaliser = config, subject, normaliser
        self.features = PoseFeatures(subject.skeleton, config.features, subject.fps)
        self.condition = 3 if config.data.condition else 0
        garment = subject.garment
        self.lbs = TorchSkinning.of(garment)
        code = BoneCode(garment.centroids(), config.low.rotation)
        inputs = self.features.size + self.condition
        self.low = LowFrequency(inputs, config.low.hidden, code)
        self.high: HighFrequency | None = None

    def add_high(self) -> HighFrequency:
        """Give the network its high-frequency module, freshly initialised."""
        o, garment = self.config.high, self.subject.garment
        bones, width = self.low.code.shape
        own = bones * width if o.source == "bones" else self.features.size
        a = np.asarray(garment.rest, np.float64)[garment.faces]
        edge = float(np.linalg.norm(a - a[:, [1, 2, 0]], axis=-1).mean())
        self.high = HighFrequency(
            own + self.condition,
            garment.faces,
            garment.n_vertices,
            hidden=o.hidden,
            global_features=o.global_features,
            edge_features=o.edge_features if o.local else (),
            mlp=o.mlp,
            edge_length=edge,
        ).to(self.device)
        return self.high

    @property
    def device(self) -> torch.device:
        return next(self.low.parameters()).device

    def inputs(self, features: NDArray[np.float64], parameters: Any = None) -> Tensor:
        """Normalised features ``(F, D)``, with the parameters where the network takes them.

        Parameters
        ----------
        features : (F, D)
        parameters : (3,) array, optional
            Normalised simulation parameters.

        Raises
        ------
        InputError
            If the network needs parameters and there are none.
        """
        x = torch.from_numpy(self.normaliser(features))
        if self.condition:
            if parameters is None:
                raise InputError("parameters", "the simulation's, which this network reads", None)
            row = torch.as_tensor(np.asarray(parameters, np.float32))
            x = torch.cat([x, row.expand(len(x), -1)], dim=1)
        return x

    def mesh(self, z: Tensor) -> Tensor:
        """Low-frequency mesh of normalised bone motion, in the moving frame."""
        return torch.as_tensor(self.lbs(self.low.code(z)))

    def high_inputs(self, x: Tensor, z: Tensor) -> Tensor:
        """What the high-frequency module's GRU reads: ``(N, T, D)``."""
        if self.config.high.source == "body":
            return x
        own = z.flatten(-2)
        return torch.cat([own, x[..., -self.condition :]], dim=-1) if self.condition else own

    @torch.no_grad()
    def run(
        self,
        joints: Any,
        state: NetworkState | None = None,
        *,
        parameters: Any = None,
        detail: bool = True,
        frames: Any = None,
    ) -> tuple[Motion, NetworkState]:
        """Continue from a state over consecutive frames.

        Parameters
        ----------
        joints : (F, J, 3, 4) array
            World transforms of the body's joints from its rest pose.
        state : NetworkState, optional
            None: the motion starts here, from rest.
        parameters : (3,) array, optional
            Normalised; only for a network that reads them.
        detail : bool
            Whether to run the high-frequency module.
        frames : (f,) int array, optional
            The only frames whose mesh is wanted; the memory goes through all.

        Raises
        ------
        InputError
            If the joints are not those of the body, not finite or not rigid.
        """
        state = state or NetworkState()
        features, frame, pose = self.features(joints, state.pose)
        x = self.inputs(features, parameters).to(self.device)[None]
        z, low_state = self.low(x, state.low)
        index = None
        if frames is not None:
            index = torch.as_tensor(np.asarray(frames, np.int64), device=self.device)
            frame = frame[np.asarray(frames, np.int64)]
        transforms = self.low.code(z if index is None else z[:, index])[0]
        low = self.lbs(transforms)
        high, high_state = None, state.high
        if detail and self.high is not None:
            chosen = None if index is None else index[None]
            out, high_state = self.high(self.high_inputs(x, z), low[None], state.high, chosen)
            high = out[0]
        return Motion(transforms, low, high, frame), NetworkState(pose, low_state, high_state)

    def predict(
        self, joints: Any, *, parameters: Any = None, detail: bool = True, frames: Any = None
    ) -> NDArray[np.float32]:
        """World positions ``(F, V, 3)`` of a whole motion, or of the named frames, ascending."""
        parts = self.motions(joints, parameters=parameters, detail=detail, frames=frames)
        return np.concatenate([m.vertices() for m in parts])

    def motions(
        self, joints: Any, *, parameters: Any = None, detail: bool = True, frames: Any = None
    ) -> list[Motion]:
        """The motion, or the named frames of it, in pieces of bounded length, in order."""
        joints, state, out = np.asarray(joints), None, []
        wanted = None if frames is None else np.asarray(frames, np.int64)
        for start in range(0, max(1, len(joints)), _CHUNK):
            part = joints[start : start + _CHUNK]
            own = None
            if wanted is not None:
                own = wanted[(wanted >= start) & (wanted < start + len(part))] - start
            # One frame at least: a mesh of none has no shape; the memory goes on either way.
            some = own if own is None or len(own) else [0]
            motion, state = self.run(part, state, parameters=parameters, detail=detail, frames=some)
            if own is None or len(own):
                out.append(motion)
        return out

    def step(
        self, state: NetworkState | None, pose: Any, *, parameters: Any = None
    ) -> tuple[NetworkState, NDArray[np.float32]]:
        """One frame: joints ``(J, 3, 4)`` to world positions ``(V, 3)``.

        The same as :meth:`predict` frame by frame, to rounding.
        """
        motion, state = self.run(np.asarray(pose)[None], state, parameters=parameters)
        return state, motion.vertices()[0]
