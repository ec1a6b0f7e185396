"""Checkpoints: networks in a safetensors file with a JSON document; nothing in it is executed.

A checkpoint holds everything that prediction needs: configuration, statistics, rest pose and skin
weights of the virtual bones, the body and its skeleton, and for an ensemble every pivot and the
kernel.  It names no Python module, so it does not depend on where the code lies.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from msgspec import Meta
from numpy.typing import NDArray
from torch import Tensor

from ssdr import Skinning
from ssdr.common.checks import check_skin
from ssdr.common.errors import FormatError, InputError
from ssdr.io.file_errors import check, reading

from ..configs.config import Amount, Config
from ..data.outfit import mesh_identity
from ..data.parameters import SimulationParameters
from ..data.skeleton import Skeleton
from ..data.skin_weights import BodyBound
from ..data.subject import Subject
from ..io.tables import from_table
from ..io.tensors import load_arrays, save_arrays, tensors_of
from ..paper.ensemble import Kernel
from .features import Normaliser
from .network import MotionNetwork, NetworkOutput, Predictor

# Tensors with fewer numbers stay in single precision, since halving them saves almost nothing.
_MANY = 10_000
_FORMAT, _VERSION = "garmentnet checkpoint", 6
# Arrays of a mesh, and of the vertices bound to the body.
_MESH = ("rest", "indices", "weights", "faces")
_BOUND = tuple(f.name for f in dataclasses.fields(BodyBound))
# Bytes of the dense skinning matrix beyond which a file counts as hostile: 3 million vertices and
# 80 bones in float32.
_MAX_SKINNING = 4 << 30


@dataclasses.dataclass(frozen=True)
class NetworkRecord:
    """Settings of a network, the parameters of the clips it learned, and whether it has detail."""

    config: Config
    parameters: SimulationParameters | None
    high: bool
    clamp: Amount


@dataclasses.dataclass(frozen=True)
class CheckpointDocument:
    """The JSON document of a checkpoint."""

    fps: Annotated[float, Meta(gt=0, le=1e9)]
    garment_id: str
    body_id: str
    joint_names: tuple[str, ...]
    networks: Annotated[tuple[NetworkRecord, ...], Meta(min_length=1)]
    kernel: bool = False
    errors: dict[str, float] = dataclasses.field(default_factory=dict)
    format: str = _FORMAT
    version: int = _VERSION


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint(Predictor):
    """One network, or the pivots of an ensemble.

    Attributes
    ----------
    networks : tuple of MotionNetwork
    parameters : tuple of SimulationParameters or None
        Simulation parameters that each network was trained on; None for a network that reads the
        parameters and was trained on all training sets.
    kernel : Kernel or None
        Kernel that mixes the networks of an ensemble.
    errors : mapping of str to float
        RMSE in metres by module and split, such as "low, validation".

    Raises
    ------
    InputError
        If the networks differ in rest pose, skin weights or moving frame.
    """

    networks: tuple[MotionNetwork, ...]
    parameters: tuple[SimulationParameters | None, ...]
    kernel: Kernel | None
    errors: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        garments = [n.subject.garment for n in self.networks]
        bones = {(mesh_identity(g.rest, g.indices), g.weights.tobytes()) for g in garments}
        if len(bones) > 1 or len({n.config.features.frame for n in self.networks}) > 1:
            raise InputError("networks", "pivots of one rest pose, weights and frame", "others")

    @property
    def subject(self) -> Subject:
        return self.networks[0].subject

    @property
    def reads_parameters(self) -> bool:
        """Whether a prediction needs simulation parameters."""
        return self.kernel is not None or self.networks[0].config.data.condition

    def weights(self, parameters: SimulationParameters) -> NDArray[np.float64]:
        """Ψ̄ ``(K,)`` of an ensemble's pivots at some parameters; sums to 1."""
        assert self.kernel is not None
        rows = np.stack([p.normalised() for p in self.parameters if p is not None])
        return self.kernel.weights(rows, parameters.normalised())

    @torch.no_grad()
    def run(
        self,
        joints: Any,
        state: Any = None,
        *,
        parameters: SimulationParameters | None = None,
        detail: bool = True,
    ) -> tuple[NetworkOutput, Any]:
        """As :meth:`MotionNetwork.run`; equation 3 of the paper for an ensemble.

        Parameters
        ----------
        parameters : SimulationParameters, optional
            Needed by an ensemble and by a network that reads them; other networks were trained for
            fixed parameters.

        Raises
        ------
        InputError
            If the parameters are missing, or the joints do not fit the body.
        """
        theta = None
        if self.reads_parameters:
            if not isinstance(parameters, SimulationParameters):
                got = None if parameters is None else repr(parameters)
                raise InputError("parameters", "bending, density and time scale", got)
            theta = parameters.normalised()
        first = self.networks[0]
        if self.kernel is None or parameters is None:
            return first.run(joints, state, parameters=theta, detail=detail)
        pairs = zip(self.networks, state or (None,) * len(self.networks), strict=True)
        outputs, states = zip(*(n.run(joints, s, detail=detail) for n, s in pairs), strict=True)
        weights = self.weights(parameters).tolist()

        def mixed(name: str) -> Any:
            # LBS is linear in the transforms, so Σ Ψ̄ LBS(M_i) = LBS(Σ Ψ̄ M_i).
            return sum(w * getattr(m, name) for w, m in zip(weights, outputs, strict=True))

        high = None if outputs[0].high is None else mixed("high")
        return NetworkOutput(mixed("transforms"), mixed("low"), high, outputs[0].frame), states


def save_checkpoint(checkpoint: Checkpoint, path: Path | str, *, half: bool = False) -> Path:
    """Write a checkpoint under a temporary name; the file is renamed when it is complete.

    With `half`, the file is half as large: the weights of the networks are stored in half
    precision, meshes and skin weights in single precision and the smallest integers.
    """
    subject, kernel = checkpoint.subject, checkpoint.kernel
    arrays: dict[str, Any] = {
        "skeleton.rest": subject.skeleton.rest,
        "skeleton.parents": subject.skeleton.parents,
    }
    arrays |= {f"garment.{k}": getattr(subject.garment, k) for k in _MESH}
    arrays |= {f"body.{k}": getattr(subject.body, k) for k in _MESH}
    if subject.bound is not None:
        arrays |= {f"bound.{k}": getattr(subject.bound, k) for k in _BOUND}
    if half:
        # All but the numbers that the body's hash is of.
        own = ("skeleton.", "body.rest", "body.weights")
        arrays |= {k: _compact(v) for k, v in arrays.items() if not k.startswith(own)}
    records: list[NetworkRecord] = []
    pairs = zip(checkpoint.networks, checkpoint.parameters, strict=True)
    for k, (network, trained_on) in enumerate(pairs):
        of = network.config, trained_on, network.high is not None, network.normaliser.clamp
        records.append(NetworkRecord(*of))
        for key, v in network.state_dict().items():
            small = half and v.is_floating_point() and v.numel() >= _MANY
            arrays[f"network.{k}.{key}"] = (v.half() if small else v).cpu().numpy()
        arrays[f"network.{k}.features.mean"] = network.normaliser.mean
        arrays[f"network.{k}.features.deviation"] = network.normaliser.deviation
    if kernel is not None:
        arrays |= {f"kernel.{k}": v.numpy() for k, v in kernel.state_dict().items()}
    document = CheckpointDocument(
        fps=subject.fps,
        garment_id=subject.garment_id,
        body_id=subject.body_id,
        joint_names=subject.skeleton.names,
        networks=tuple(records),
        kernel=kernel is not None,
        errors=dict(checkpoint.errors),
    )
    return save_arrays(Path(path), arrays, "checkpoint", dataclasses.asdict(document))


def _compact(array: NDArray[Any]) -> NDArray[Any]:
    floats = array.dtype.kind == "f"
    return array.astype(np.float32 if floats else np.min_scalar_type(array.max(initial=0)))


def load_checkpoint(path: Path | str) -> Checkpoint:
    """Read a checkpoint from a file, or one that ships with the package by its name, ``dress``.

    Raises
    ------
    FormatError
        If the file is something else, damaged or contradicts itself.
    """
    file = Path(path)
    arrays, document = load_arrays(file, "checkpoint")
    with reading(file):
        d, subject = _read_document(arrays, document)
        networks = [
            _network(subject, record, tensors_of(arrays, f"network.{k}."))
            for k, record in enumerate(d.networks)
        ]
        kernel = None
        if d.kernel:
            with torch.device("meta"):
                kernel = Kernel()
            kernel.load_state_dict(tensors_of(arrays, "kernel."), assign=True)
        parameters = tuple(record.parameters for record in d.networks)
        return Checkpoint(tuple(networks), parameters, kernel, d.errors)


def load_weights(network: MotionNetwork, start: Checkpoint, part: str) -> None:
    """Copy weights and statistics from a checkpoint into a module of a network.

    Parameters
    ----------
    network : MotionNetwork
    start : Checkpoint
        Checkpoint of a single network with the same sizes and virtual bones.
    part : {"low", "high"}

    Raises
    ------
    InputError
        If `start` does not fit the network.
    """
    source = start.networks[0]
    options, known = network.config.features, source.config.features
    if options != known:
        raise InputError("start", f"a network of the same configuration, {options}", known)
    try:
        getattr(network, part).load_state_dict(getattr(source, part).state_dict())
    except RuntimeError as error:
        raise InputError("start", "a network of the same configuration", str(error)) from error
    network.normaliser = source.normaliser


def _network(subject: Subject, record: NetworkRecord, part: dict[str, Tensor]) -> MotionNetwork:
    mean, deviation = part.pop("features.mean").numpy(), part.pop("features.deviation").numpy()
    # Memory for the weights is allocated only once their sizes agree with the tensors, so that a
    # hostile configuration cannot fill it.
    with torch.device("meta"):
        normaliser = Normaliser(mean, deviation, record.clamp)
        network = MotionNetwork(record.config, subject, normaliser)
        if record.high:
            network.add_high()
    if mean.shape != (network.features.size,) or deviation.shape != mean.shape:
        raise FormatError(f"statistics of {mean.shape} features, not {network.features.size}")
    network.load_state_dict(part, assign=True)
    return network.eval()


def _read_document(arrays: dict[str, Any], table: Any) -> tuple[CheckpointDocument, Subject]:
    """JSON document of a checkpoint, and the garment and body that its networks are for.

    Parameters
    ----------
    arrays : dict of array
        All arrays of the file.
    table : dict
        The file's document.

    Raises
    ------
    FormatError
        If the file is no checkpoint, of another version, or contradicts itself.
    """
    ours = isinstance(table, dict) and table.get("format") == _FORMAT
    check(ours, "not a checkpoint of garmentnet")
    version = table.get("version")
    check(version == _VERSION, f"version {version}, this reads {_VERSION}")
    d = from_table(CheckpointDocument, table, file="document")
    check(d.kernel or len(d.networks) == 1, f"{len(d.networks)} networks without a kernel")
    known = all(r.parameters is not None for r in d.networks)
    check(known or not d.kernel, "pivots without parameters")
    skeleton = Skeleton(d.joint_names, arrays["skeleton.parents"], arrays["skeleton.rest"])
    bones = len(arrays["network.0.low.code.centres"])
    for key, followed in arrays.items():
        if key.endswith(".code.followed"):
            whole = followed.dtype.kind == "i" and followed.shape == (bones,)
            there = whole and ((followed >= -1) & (followed < skeleton.n_joints)).all()
            check(there, f"{key}: expected a joint's index, or -1, for each of {bones} bones")
    subject = Subject(
        _skinning(arrays, "garment", bones, None),
        _skinning(arrays, "body", skeleton.n_joints, d.joint_names),
        skeleton,
        d.fps,
        d.garment_id,
        _bound(arrays, skeleton.n_joints),
    )
    check(subject.body_id == d.body_id, "the body is not the one that the file names")
    return d, subject


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
    types = {"index": np.int32, "indices": np.int32}
    bound = BodyBound(**{k: arrays[f"bound.{k}"].astype(types.get(k, np.float64)) for k in _BOUND})
    vertices = np.arange(len(arrays["garment.rest"]))
    fits = (
        len(bound.index) > 0
        and np.array_equal(bound.index, np.intersect1d(bound.index, vertices))
        and bound.rest.shape == bound.smooth.shape == (len(bound.index), 3)
    )
    check(fits, "bound: vertices that do not exist")
    check_skin(bound.indices, bound.weights, len(bound.index), joints, "bound.")
    return bound
