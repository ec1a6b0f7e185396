"""Export of a trained garment as one ONNX graph of standard operators, by torch's own exporter.

The graph computes a frame of :meth:`~garmentnet.networks.network.MotionNetwork.run` in float32; the
state is among its inputs and outputs.  :mod:`.garment` plays it without torch.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ssdr.common.errors import InputError
from ssdr.io.atomic import write_bytes
from ssdr.io.optional import import_optional as require

from ..data.parameters import RANGES
from ..networks.checkpoint import Checkpoint
from ..networks.network import MotionNetwork

_OPSET = 17  # a version of 2021, which the engines' importers know


def export_onnx(checkpoint: Checkpoint, path: Path | str) -> Path:
    """Write a garment as an ONNX model, complete or not at all.

    Inputs are ``pose`` (J, 3, 4); ``reset`` (1,), which is 1 where a motion starts and otherwise 0;
    the states ``pose_state``, ``low_state`` and ``high_state``, which are ignored where a motion
    starts; and ``parameters`` (3,) if the garment reads them.  Outputs are ``vertices`` (V, 3), in
    metres in the world, and the states for the next frame, whose names end in ``_out``.  The
    metadata ``garmentnet`` is a JSON document with frame rate, skeleton, triangles and parameters.

    Parameters
    ----------
    checkpoint : Checkpoint
        One network.
    path : path

    Raises
    ------
    InputError
        If the checkpoint is an ensemble.
    MissingDependencyError
        If ``onnx`` is not installed.
    """
    if checkpoint.kernel is not None:
        raise InputError("model", "one network, such as reads the parameters", "an ensemble")
    onnx = require("onnx", "garmentnet[onnx]", "an ONNX file")
    frame = Frame(checkpoint.networks[0]).eval()
    start = frame.start()
    outputs = ["vertices", *(f"{n}_out" for n in start if n.endswith("_state"))]
    with warnings.catch_warnings(), torch.no_grad(), tempfile.TemporaryDirectory() as folder:
        # Of shapes that are constants here, and of an exporter that makes graphs ten times as slow.
        warnings.simplefilter("ignore")
        whole = Path(folder) / "whole.onnx"
        torch.onnx.export(
            frame, tuple(start.values()), whole, input_names=list(start), output_names=outputs,
            opset_version=_OPSET, dynamo=False,
        )  # fmt: skip
        model = onnx.load(whole)
    entry = model.metadata_props.add()
    entry.key, entry.value = "garmentnet", json.dumps(_document(checkpoint))
    onnx.checker.check_model(model)
    file = Path(path)
    write_bytes(file, model.SerializeToString())
    return file


def _document(checkpoint: Checkpoint) -> dict[str, Any]:
    s = checkpoint.subject
    reads = checkpoint.reads_parameters
    return {
        "fps": s.fps,
        "joints": list(s.skeleton.names),
        "parents": s.skeleton.parents.tolist(),
        "joints_at_rest": s.skeleton.rest.tolist(),
        "faces": np.asarray(s.garment.faces).tolist(),
        "parameters": {k: list(r) for k, r in RANGES.items()} if reads else {},
    }


class Frame(nn.Module):
    """One step of a network: from a pose and a state to vertices and the next state.

    Parameters
    ----------
    network : MotionNetwork
    """

    def __init__(self, network: MotionNetwork) -> None:
        super().__init__()
        self.network, normaliser = network, network.normaliser
        low, high = np.log(list(RANGES.values())).T
        self.mean, self.scale, self.middle, self.span = (
            torch.tensor(x, dtype=torch.float32)
            for x in (normaliser.mean, 1 / normaliser.deviation, (low + high) / 2, (high - low) / 2)
        )

    def start(self) -> dict[str, Tensor]:
        """Inputs of the right shapes, by name: the body at rest, where a motion begins."""
        n = self.network
        found = {
            "pose": torch.eye(3, 4).repeat(n.subject.skeleton.n_joints, 1, 1),
            "reset": torch.ones(1),
            "pose_state": torch.zeros(n.features.state_size),
            "low_state": torch.zeros(n.config.low.hidden),
        }
        if n.high is not None:
            found["high_state"] = torch.zeros(n.config.high.hidden)
        return found | ({"parameters": torch.ones(3)} if n.condition else {})

    def forward(self, pose: Tensor, reset: Tensor, pose_state: Tensor, *more: Tensor) -> Any:
        """Vertices ``(V, 3)``, metres, and the states for the next frame."""
        n, begins = self.network, reset > 0.5
        states, more = more[: 1 + (n.high is not None)], more[1 + (n.high is not None) :]
        kept = [torch.where(begins, 0 * reset, state)[None, None] for state in states]
        features, frame, pose_state = n.features.of(pose[None], pose_state, begins)
        x = (features - self.mean) * self.scale
        if n.normaliser.clamp > 0:
            x = x.clamp(-n.normaliser.clamp, n.normaliser.clamp)
        if n.condition:
            x = torch.cat([x, ((more[0].log() - self.middle) / self.span)[None]], dim=1)
        turn, origin = frame[0, :, :3], frame[0, :, 3]
        near = torch.cat([pose[..., :3], (pose[..., 3] - origin)[..., None]], dim=-1)
        body = turn.T @ near
        _, low, high, *states = n(x, body[None], *[*kept, None][:2])
        local = low[0] if high is None else low[0] + high[0]
        vertices = local @ turn.T + origin
        return vertices, pose_state, *(s[0, 0] for s in states if s is not None)
