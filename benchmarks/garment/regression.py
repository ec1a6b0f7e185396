"""Baselines of the paper's table 2 that regress offsets or positions of the vertices.

They differ in three things: the inputs, the kind of network, and the space in which positions are
predicted.  The last layer gives coefficients of principal components of the training frames, some
two hundred numbers instead of 3 V.  This changes the time of training, but no error.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

import ssdr
from garmentnet.configs.config import Config, load_config, override
from garmentnet.data.clip import MIRRORED, Clip
from garmentnet.evaluation.baselines import body_skinning
from garmentnet.evaluation.methods import Array, VertexMethod
from garmentnet.io.files import Progress, kept, silent
from garmentnet.networks.features import PoseReader, transforms_in_frame
from garmentnet.networks.gru import GRULinear
from garmentnet.paper.bones import VirtualBones, apply_frame, remove_frame
from garmentnet.paper.train import pose_reader
from garmentnet.training.batches import Track, load_tracks
from garmentnet.training.detail import CoefficientObjective
from garmentnet.training.loop import fit
from garmentnet.training.shapes import ShapeBasis

Part = Literal["whole", "low", "high"]
# Number of components, and of training frames from which they are found.
_RANK, _FRAMES = 192, 1500
# Added to the diagonal of AᵀA, since a blend A of rotations may be nearly singular.
_RIDGE = 1e-3


class Unposed:
    """Space of offsets o from the rest pose before the body skins it: v = Σ_j w_ij M_j (p_i + o_i).

    Detail is only rotated back, by the blended rotations.
    """

    def __init__(self, bones: VirtualBones) -> None:
        self.skinning = body_skinning(bones.store)
        self._weights = self.skinning.dense_weights()

    def remove(self, mesh: Any, joints: Any, part: Part) -> Array:
        """Offsets ``(F, V, 3)`` of a mesh, or of its detail, under joints ``(F, J, 3, 4)``."""
        m = np.einsum("vj,fjab->fvab", self._weights, joints, optimize=True)
        a = m[..., :3]
        if part != "high":
            mesh = mesh - m[..., 3] - (a @ np.asarray(self.skinning.rest)[..., None])[..., 0]
        gram = a.swapaxes(-1, -2) @ a + _RIDGE * np.eye(3)
        found = np.linalg.solve(gram, a.swapaxes(-1, -2) @ mesh[..., None])[..., 0]
        return np.asarray(found, np.float32)

    def add(self, predicted: Any, joints: Any, part: Part) -> Array:
        """The mesh, or its detail, of offsets."""
        s = self.skinning
        if part == "high":
            m = np.einsum("vj,fjab->fvab", self._weights, joints[..., :3], optimize=True)
            return np.asarray((m @ predicted[..., None])[..., 0], np.float32)
        rest = np.asarray(s.rest) + predicted
        frames = (ssdr.skin(r, s.indices, s.weights, m) for r, m in zip(rest, joints, strict=True))
        return np.asarray(list(frames), np.float32)


class FrameMLP(nn.Module):
    """Three-layer MLP that reads one frame, as in TailorNet."""

    def __init__(self, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(inputs, hidden), nn.Linear(hidden, hidden)
        self.out = nn.Linear(hidden, outputs)

    def forward(
        self, x: Tensor, state: Tensor | None = None, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        h = torch.relu(self.second(torch.relu(self.first(x))))
        return self.out(h if mask is None else h * mask), x.new_zeros(1, len(x), 1)


class WindowMLP(FrameMLP):
    """Three-layer MLP that reads a frame and those before it, which are kept as the state."""

    def __init__(self, inputs: int, hidden: int, outputs: int, frames: int = 8) -> None:
        super().__init__(inputs * frames, hidden, outputs)
        self.frames = frames

    def forward(
        self, x: Tensor, state: Tensor | None = None, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        n, before = self.frames - 1, state
        if before is None:
            before = x.new_zeros(1, len(x), n * x.shape[-1])
        whole = torch.cat([before[0].view(len(x), n, -1), x], dim=1)
        windows = whole.unfold(1, self.frames, 1).transpose(-1, -2).flatten(-2)
        return super().forward(windows, None, mask)[0], whole[:, -n:].flatten(1)[None]


@dataclasses.dataclass(frozen=True)
class Variant:
    """Description of a baseline.

    Attributes
    ----------
    name : str
    parts : tuple of {"whole", "low", "high"}
        Parts of the garment that are predicted, each by a network of its own.
    network : callable
        Makes a network from the numbers of inputs, hidden units and outputs.
    unposed : bool
        Whether it predicts offsets of the rest pose, which the body skins, or positions in the
        moving frame.
    features : str
        Name of the configuration whose pose features the networks read; "" for the one given to
        :func:`train_regression`.
    changes : tuple of str
        Further changes of settings, such as ``features.root_motion=false``.
    """

    name: str
    parts: tuple[Part, ...] = ("whole",)
    network: Callable[[int, int, int], nn.Module] = GRULinear
    unposed: bool = True
    features: str = ""
    changes: tuple[str, ...] = ()


class _Scaled(nn.Module):
    """A network whose outputs are coefficients in units of their deviations."""

    deviation: Tensor

    def __init__(self, net: nn.Module, basis: ShapeBasis) -> None:
        super().__init__()
        self.net = net
        self.register_buffer("deviation", torch.from_numpy(basis.deviation.copy()))

    def forward(
        self, x: Tensor, state: Tensor | None = None, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        out, state = self.net(x, state, mask)
        return out * self.deviation, state


@dataclasses.dataclass(eq=False)
class Regression(VertexMethod):
    """Prediction by a trained baseline."""

    name: str
    reader: PoseReader
    space: Unposed | None
    nets: dict[Part, tuple[nn.Module, ShapeBasis]]

    @torch.no_grad()
    def _parts(self, clip: Clip) -> dict[Part, Array]:
        features, frame, _ = self.reader.features(clip.joints)
        x = torch.from_numpy(self.reader.inputs(features, None))[None]
        joints = transforms_in_frame(clip.joints, frame)
        out: dict[Part, Array] = {}
        for part, (net, basis) in self.nets.items():
            local = basis.decode(net(x)[0][0].numpy())
            if self.space is not None:
                local = self.space.add(local, joints, part)
            turned = local @ frame[..., :3].swapaxes(-1, -2)
            moved = turned if part == "high" else apply_frame(frame, local)
            out[part] = np.asarray(moved, np.float32)
        return out

    def predict(self, clip: Clip) -> Array:
        return np.asarray(sum(self._parts(clip).values()), np.float32)

    def split(self, clip: Clip, bones: VirtualBones) -> tuple[Array, Array]:
        """Low and high part as predicted; the prediction of a single network is split like data."""
        parts = self._parts(clip)
        if "whole" in parts:
            return super().split(clip, bones)
        some = next(iter(parts.values()))
        return parts.get("low", np.zeros_like(some)), parts.get("high", np.zeros_like(some))


def train_regression(
    variant: Variant,
    bones: VirtualBones,
    config: Config,
    names: Sequence[str],
    validation: Sequence[str],
    folder: Path,
    *,
    progress: Progress = silent,
) -> Regression:
    """Train a baseline with the training options and layer width of a configuration.

    Parameters
    ----------
    variant : Variant
    bones : VirtualBones
    config : Config
    names, validation : sequence of str
        Names of the clips, mirrored ones included.
    folder : Path
        Folder of the training's state, from which an interrupted training continues and a finished
        one is read.
    progress : callable, optional
        Called after every epoch with a text and the fraction of the epochs that is done.
    """
    folder.mkdir(parents=True, exist_ok=True)
    features = config.features
    if variant.features:
        features = load_config(variant.features).features
        # A preset names joints of the body that ships; another body has those of `config`.
        joints = config.features.joints if features.joints else ()
        features = dataclasses.replace(features, joints=joints)
    data = dataclasses.replace(config.data, condition=False)
    own = override(dataclasses.replace(config, features=features, data=data), variant.changes)
    reader = pose_reader(own, bones, names)
    space = Unposed(bones) if variant.unposed else None
    finished = folder / "finished"
    wanted = ([], []) if finished.is_file() else (names, validation)
    tracks, held = (load_tracks(reader, bones, n) for n in wanted)
    nets: dict[Part, tuple[nn.Module, ShapeBasis]] = {}
    o = config.train
    learn = functools.partial(fit, options=o, folder=folder, progress=progress)
    for part in variant.parts:
        target = _Target(bones, reader, space, part)
        basis = target.basis(names, folder)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.train.seed)
            net = _Scaled(variant.network(reader.size, config.low.hidden, basis.rank), basis)
        coded, others = ([target.track(t, basis) for t in some] for some in (tracks, held))
        size, width, share = bones.store.n_vertices, config.low.hidden, config.low.dropout
        objective = CoefficientObjective(
            net, size, hidden=width, dropout=share, tracks=coded, validation=others
        )
        epochs = 0 if finished.is_file() else o.epochs
        learn(objective, name=part, epochs=epochs, learning_rate=o.learning_rate)
        nets[part] = net, basis
    finished.touch()
    return Regression(variant.name, reader, space, nets)


@dataclasses.dataclass(frozen=True, eq=False)
class _Target:
    """Targets of one network of a baseline."""

    bones: VirtualBones
    reader: PoseReader
    space: Unposed | None
    part: Part

    def basis(self, names: Sequence[str], folder: Path) -> ShapeBasis:
        """Principal components of the training frames; read from the folder if it has them."""

        def made() -> dict[str, Any]:
            plain = [n for n in names if not n.endswith(MIRRORED)]
            clips = self.bones.store.sample(plain, _FRAMES)
            local = np.concatenate([self._local(c.name, some) for c, some in clips])
            return dataclasses.asdict(ShapeBasis.fit(local, _RANK))

        return ShapeBasis(**kept(folder / f"{self.part}.npz", made))

    def track(self, track: Track, basis: ShapeBasis) -> Track:
        rows: list[NDArray[np.float32]] = []
        for frames in track.parts():
            local = self._local(track.name, frames)
            numbers = basis.encode(local)
            rest = ((local - basis.decode(numbers)) ** 2).sum(axis=(1, 2))
            rows.append(np.column_stack([numbers, rest]).astype(np.float32))
        return dataclasses.replace(track, extra=torch.from_numpy(np.concatenate(rows)))

    def _local(self, name: str, frames: Any) -> Array:
        clip = self.bones.store.clip(name)
        frame = self.reader.features(clip.joints)[1][frames]
        joints = transforms_in_frame(clip.joints[frames], frame)
        if self.part == "whole":
            mesh = remove_frame(frame, clip.sequence.frames(frames))
        else:
            low, high = self.bones.split(name, frames)
            mesh = remove_frame(frame, low) if self.part == "low" else high @ frame[..., :3]
        if self.space is not None:
            mesh = self.space.remove(mesh, joints, self.part)
        return np.asarray(mesh, np.float32)
