"""Checkpoints: networks in a safetensors file with a JSON document; nothing in it is executed.

A checkpoint holds everything that prediction needs: configuration, statistics, rest pose and skin
weights of the virtual bones, the body and its skeleton, and for an ensemble every pivot and the
kernel.  It names no Python module, so it does not depend on where the code lies.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ssdr import Skinning
from ssdr.errors import FormatError, InputError
from ssdr.io.registry import reading

from ..configs.config import Config
from ..data.parameters import SimulationParameters
from ..data.skeleton import Skeleton
from ..data.skin_weights import BodyBound
from ..data.store import ClipStore
from ..data.subject import Subject, mesh_identity
from .ensemble import Ensemble, Kernel
from .features import Normaliser
from .network import Motion, MotionNetwork
from .tensor_files import load_tensors, part_of, save_tensors

__all__ = [
    "Checkpoint",
    "load_checkpoint",
    "load_weights",
    "save_checkpoint",
]

_FORMAT, _VERSION = "garmentnet checkpoint", 3
_MESH = ("rest", "indices", "weights", "faces")
_BOUND = tuple(f.name for f in dataclasses.fields(BodyBound))
# Bytes of the dense skinning matrix beyond which a file counts as hostile: 3 million vertices and
# 80 bones in float32.
_MAX_SKINNING = 4 << 30


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint:
    """One network, or the pivots of an ensemble.

    Attributes
    ----------
    networks : tuple of MotionNetwork
    parameters : tuple of SimulationParameters or None
        Simulation parameters that each network was trained on; None: all training sets, for a
        network that reads them.
    kernel : Kernel or None
        Of an ensemble.
    common : MotionNetwork or None
        Of an ensemble: a network that reads the parameters, mixed with the pivots.
    share : float
        Its weight.
    """

    networks: tuple[MotionNetwork, ...]
    parameters: tuple[SimulationParameters | None, ...]
    kernel: Kernel | None
    common: MotionNetwork | None = None
    share: float = 0.0

    @property
    def subject(self) -> Subject:
        return self.networks[0].subject

    @property
    def ensemble(self) -> Ensemble:
        """The pivots as an ensemble.

        Raises
        ------
        InputError
            If the checkpoint is a single network.
        """
        if self.kernel is None:
            raise InputError("checkpoint", "an ensemble", "a single network")
        rows = np.stack([p.normalised() for p in self.parameters if p is not None])
        return Ensemble(self.networks, rows, self.kernel, self.common, self.share)

    def motions(
        self, joints: Any, parameters: SimulationParameters | None = None, *, detail: bool = True
    ) -> list[Motion]:
        """Predict a motion with the network or the ensemble.

        Parameters
        ----------
        joints : (F, J, 3, 4) array
        parameters : SimulationParameters, optional
            For an ensemble and a network that reads them; other networks have parameters of
            their own.

        Raises
        ------
        InputError
            If the parameters are missing, or the joints do not fit the body.
        """
        model = self.networks[0] if self.kernel is None else self.ensemble
        theta = None
        if self.kernel is not None or self.networks[0].condition:
            if parameters is None:
                raise InputError("parameters", "bending, density and time scale", None)
            theta = parameters.normalised()
        return model.motions(joints, parameters=theta, detail=detail)

    def predict(
        self, joints: Any, parameters: SimulationParameters | None = None, *, detail: bool = True
    ) -> NDArray[np.float32]:
        """World positions ``(F, V, 3)``, metres; arguments as :meth:`motions`."""
        parts = self.motions(joints, parameters, detail=detail)
        return np.concatenate([m.vertices() for m in parts])

    def check_fits(self, store: ClipStore) -> None:
        """Raise InputError unless the store has this garment, body and frame rate."""
        own = self.subject
        there = dataclasses.replace(own, body=store.body, skeleton=store.skeleton).body_id
        for what, expected, got in (
            ("garment", mesh_identity(store.rest, store.faces), own.garment_id),
            ("body", there, own.body_id),
            ("fps", store.fps, own.fps),
        ):
            if expected != got:
                wanted = f"one of the {what} of {store.path} ({expected})"
                raise InputError("checkpoint", wanted, f"another ({got})")


def save_checkpoint(checkpoint: Checkpoint, path: Path | str) -> Path:
    """Write a checkpoint under a temporary name; the file is renamed when it is complete."""
    subject, kernel = checkpoint.subject, checkpoint.kernel
    arrays: dict[str, Any] = {
        "skeleton.rest": subject.skeleton.rest,
        "skeleton.parents": subject.skeleton.parents,
    }
    arrays |= {f"garment.{k}": getattr(subject.garment, k) for k in _MESH}
    arrays |= {f"body.{k}": getattr(subject.body, k) for k in _MESH}
    if subject.bound is not None:
        arrays |= {f"bound.{k}": getattr(subject.bound, k) for k in _BOUND}
    tensors: dict[str, Tensor] = {}
    record: list[dict[str, Any]] = []
    networks, parameters = list(checkpoint.networks), list(checkpoint.parameters)
    if checkpoint.common is not None:
        networks, parameters = [*networks, checkpoint.common], [*parameters, None]
    for k, (network, trained_on) in enumerate(zip(networks, parameters, strict=True)):
        config = dataclasses.replace(
            network.config, data=dataclasses.replace(network.config.data, store="")
        )
        record.append(
            {
                "config": config.as_dict(),
                "parameters": None if trained_on is None else dataclasses.asdict(trained_on),
                "high": network.high is not None,
                "clamp": network.normaliser.clamp,
            }
        )
        tensors |= {f"network.{k}.{key}": v for key, v in network.state_dict().items()}
        arrays[f"network.{k}.features.mean"] = network.normaliser.mean
        arrays[f"network.{k}.features.deviation"] = network.normaliser.deviation
    if kernel is not None:
        tensors |= {f"kernel.{k}": v for k, v in kernel.state_dict().items()}
    tensors |= {k: torch.from_numpy(np.array(v)) for k, v in arrays.items()}
    document = {
        "format": _FORMAT,
        "version": _VERSION,
        "fps": subject.fps,
        "garment_id": subject.garment_id,
        "body_id": subject.body_id,
        "joint_names": list(subject.skeleton.names),
        "networks": record,
        "kernel": None
        if kernel is None
        else {"sizes": kernel.sizes, "sigma": kernel.sigma, "shape": kernel.shape},
        "common": None if checkpoint.common is None else checkpoint.share,
    }
    return save_tensors(Path(path), tensors, {"checkpoint": document})


def load_checkpoint(path: Path | str) -> Checkpoint:
    """Read a checkpoint.

    Raises
    ------
    FormatError
        If the file is something else, damaged or contradicts itself.
    """
    file = Path(path)
    tensors, documents = load_tensors(file, ("checkpoint",))
    with reading(file):
        d = documents["checkpoint"]
        if not isinstance(d, dict) or d.get("format") != _FORMAT:
            raise FormatError("not a checkpoint of garmentnet")
        if d.get("version") != _VERSION:
            raise FormatError(f"version {d.get('version')}, this reads {_VERSION}")
        arrays = {k: v.numpy() for k, v in tensors.items() if not k.startswith("network.")}
        names = tuple(str(n) for n in d["joint_names"])
        skeleton = Skeleton(names, arrays["skeleton.parents"], arrays["skeleton.rest"])
        bones = len(tensors["network.0.low.code.centres"])
        subject = Subject(
            _skinning(arrays, "garment", bones, None),
            _skinning(arrays, "body", skeleton.n_joints, names),
            skeleton,
            float(d["fps"]),
            str(d["garment_id"]),
            _bound(arrays, skeleton.n_joints),
        )
        if subject.body_id != d["body_id"]:
            raise FormatError("the body is not the one that the file names")
        networks, parameters = [], []
        for k, record in enumerate(d["networks"]):
            networks.append(_network(subject, record, part_of(tensors, f"network.{k}.")))
            trained_on = record["parameters"]
            parameters.append(None if trained_on is None else SimulationParameters(**trained_on))
        kernel, common, share = None, None, 0.0
        if d.get("common") is not None:
            if d["kernel"] is None or parameters.pop() is not None:
                raise FormatError("a common network without a kernel, or with parameters")
            common, share = networks.pop(), float(d["common"])
        if d["kernel"] is not None:
            if any(p is None for p in parameters):
                raise FormatError("pivots without parameters")
            inputs, hidden, latent = (int(n) for n in d["kernel"]["sizes"])
            shape, sigma = d["kernel"]["shape"], d["kernel"]["sigma"]
            if shape not in ("gaussian", "exponential"):
                raise FormatError(f"a kernel of shape {shape!r}")
            with torch.device("meta"):
                kernel = Kernel(inputs, hidden=hidden, latent=latent, sigma=sigma, shape=shape)
            kernel.load_state_dict(part_of(tensors, "kernel."), assign=True)
        elif len(networks) != 1:
            raise FormatError(f"{len(networks)} networks without a kernel")
        checkpoint = Checkpoint(tuple(networks), tuple(parameters), kernel, common, share)
        if kernel is not None:
            _ = checkpoint.ensemble
        return checkpoint


def load_weights(network: MotionNetwork, start: Checkpoint, part: str) -> None:
    """Copy weights and statistics from a checkpoint into a module of a network.

    Parameters
    ----------
    network : MotionNetwork
    start : Checkpoint
        Of a single network with the same sizes and virtual bones.
    part : {"low", "high"}

    Raises
    ------
    InputError
        If it does not fit.
    """
    source = start.networks[0]
    if not np.array_equal(source.subject.garment.rest, network.subject.garment.rest):
        raise InputError("start", "a checkpoint with the same virtual bones", "others")
    module, source_module = getattr(network, part), getattr(source, part)
    try:
        module.load_state_dict(source_module.state_dict())
    except RuntimeError as error:
        raise InputError("start", "a network of the same configuration", str(error)) from error
    network.normaliser = source.normaliser


def _skinning(
    arrays: dict[str, Any], name: str, bones: int, names: tuple[str, ...] | None
) -> Skinning:
    rest, indices = arrays[f"{name}.rest"], arrays[f"{name}.indices"]
    if len(rest) * bones * 16 > _MAX_SKINNING:
        raise FormatError(f"{name}: {len(rest)} vertices and {bones} bones")
    return Skinning(
        rest,
        indices,
        arrays[f"{name}.weights"],
        np.tile(np.eye(3, 4), (1, bones, 1, 1)),
        faces=arrays[f"{name}.faces"],
        bone_names=names,
    )


def _bound(arrays: dict[str, Any], joints: int) -> BodyBound | None:
    if "bound.index" not in arrays:
        return None
    bound = BodyBound(**{k: arrays[f"bound.{k}"] for k in _BOUND})
    count, vertices = len(bound.index), len(arrays["garment.rest"])
    fits = (
        0 < count <= vertices
        and bound.rest.shape == bound.smooth.shape == (count, 3)
        and bound.indices.shape == bound.weights.shape == (count, bound.weights.shape[1])
        and (np.diff(bound.index) > 0).all()
        and bound.index[0] >= 0
        and bound.index[-1] < vertices
        and bound.indices.min() >= 0
        and bound.indices.max() < joints
    )
    if not fits:
        raise FormatError("bound: vertices or joints that do not exist")
    return bound


def _network(subject: Subject, record: dict[str, Any], part: dict[str, Tensor]) -> MotionNetwork:
    config = Config.of(record["config"], "configuration")
    mean, deviation = part.pop("features.mean").numpy(), part.pop("features.deviation").numpy()
    # Weights have no memory before their sizes are found to be those of the tensors: a hostile
    # configuration cannot fill it.
    with torch.device("meta"):
        normaliser = Normaliser(mean, deviation, float(record["clamp"]))
        network = MotionNetwork(config, subject, normaliser)
        if record["high"]:
            network.add_high()
    if mean.shape != (network.features.size,) or deviation.shape != mean.shape:
        raise FormatError(f"statistics of {mean.shape} features, not {network.features.size}")
    network.load_state_dict(part, assign=True)
    return network.eval()
