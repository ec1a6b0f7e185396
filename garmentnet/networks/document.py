"""Reading of a checkpoint's garment and body, without torch."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from ssdr import Skinning
from ssdr.common.checks import check_skin
from ssdr.common.errors import FormatError
from ssdr.io.file_errors import check

from ..configs.config import Config
from ..data.parameters import SimulationParameters
from ..data.skeleton import Skeleton
from ..data.skin_weights import BodyBound
from ..data.subject import Subject
from ..io.tables import from_table

FORMAT, VERSION = "garmentnet checkpoint", 5
# Arrays of a mesh, and of the vertices bound to the body.
MESH = ("rest", "indices", "weights", "faces")
BOUND = tuple(f.name for f in dataclasses.fields(BodyBound))
# Bytes of the dense skinning matrix beyond which a file counts as hostile: 3 million vertices and
# 80 bones in float32.
_MAX_SKINNING = 4 << 30


@dataclasses.dataclass(frozen=True)
class NetworkRecord:
    """A network: its settings, the parameters it was trained on, whether it has detail."""

    config: Config
    parameters: SimulationParameters | None
    high: bool
    clamp: float


@dataclasses.dataclass(frozen=True)
class CheckpointDocument:
    """The JSON document of a checkpoint.

    `power` is that of the kernel; earlier versions, whose kernels have 1, do not state it.
    """

    fps: float
    garment_id: str
    body_id: str
    joint_names: tuple[str, ...]
    networks: tuple[NetworkRecord, ...]
    kernel: bool = False
    power: int = 1
    errors: dict[str, Any] = dataclasses.field(default_factory=dict)
    format: str = FORMAT
    version: int = VERSION

    @property
    def reads_parameters(self) -> bool:
        """Whether a prediction needs simulation parameters."""
        return self.kernel or self.networks[0].config.data.condition


def read_document(arrays: dict[str, Any], table: Any) -> tuple[CheckpointDocument, Subject]:
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
    ours = isinstance(table, dict) and table.get("format") == FORMAT
    check(ours, "not a checkpoint of garmentnet")
    version = table.get("version")
    check(version == VERSION, f"version {version}, this reads {VERSION}")
    for record in table.get("networks", ()):  # of earlier networks, how they were trained
        record["config"]["low"].pop("symmetric", None)
    d = from_table(CheckpointDocument, table, file="document")
    numbers = (d.fps, *(r.clamp for r in d.networks))
    check(d.fps > 0 and all(map(math.isfinite, numbers)), f"frame rate or clamp {numbers}")
    count = len(d.networks)
    check(count == 1 or (d.kernel and count), f"{count} networks, kernel {d.kernel}")
    check(d.power in (1, 2), f"power {d.power} of the kernel")
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
    bound = BodyBound(**{k: arrays[f"bound.{k}"] for k in BOUND})
    vertices = np.arange(len(arrays["garment.rest"]))
    fits = (
        len(bound.index) > 0
        and np.array_equal(bound.index, np.intersect1d(bound.index, vertices))
        and bound.rest.shape == bound.smooth.shape == (len(bound.index), 3)
    )
    check(fits, "bound: vertices that do not exist")
    check_skin(bound.indices, bound.weights, len(bound.index), joints, "bound.")
    return bound
