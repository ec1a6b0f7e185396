"""Prediction of a trained garment frame by frame by onnxruntime, without torch.

The file is that of :func:`garmentnet.runtime.onnx_file.export_onnx`, which engines run, too.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import FormatError, InputError
from ssdr.io.optional import import_optional as require

from ..data.parameters import SimulationParameters, warn_beyond
from ..data.skeleton import Skeleton, check_joints

Single = NDArray[np.float32]
# States of a garment after a frame, by the names of the graph's inputs.
State = Mapping[str, Single]


class LiveGarment:
    """Garment of an ONNX file that predicts its vertices frame by frame, in one thread.

    Parameters
    ----------
    path : path
        File that ``garmentnet export`` wrote.

    Attributes
    ----------
    skeleton : Skeleton
    faces : (T, 3) int32
        Triangles of the garment.
    fps : float
        Frames a second of the network.
    reads_parameters : bool
        Whether a frame needs simulation parameters.

    Raises
    ------
    InputError
        If there is no such file.
    FormatError
        If it is no ONNX file of a garment.
    MissingDependencyError
        If ``onnxruntime`` is not installed.
    """

    def __init__(self, path: Path | str) -> None:
        runtime = require("onnxruntime", "garmentnet[onnx]", "a live garment")
        if not Path(path).is_file():
            raise InputError("path", "an .onnx file", str(path))
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            self._session = runtime.InferenceSession(str(path), options)
            found = self._session.get_modelmeta().custom_metadata_map["garmentnet"]
            d = json.loads(found)
            rest = np.array(d["joints_at_rest"], float)
            self.skeleton = Skeleton(tuple(d["joints"]), d["parents"], rest)
            self.faces, self.fps = np.array(d["faces"], np.int32), float(d["fps"])
        except Exception as error:  # onnxruntime raises classes of its own
            raise FormatError(f"{path}: no ONNX file of a garment ({error})") from error
        self.reads_parameters = bool(d["parameters"])
        self._start = {
            i.name: np.zeros(i.shape, np.float32)
            for i in self._session.get_inputs()
            if i.name.endswith("_state")
        }
        self._outputs = [o.name for o in self._session.get_outputs()]
        self._warned: SimulationParameters | None = None

    def step(
        self,
        state: State | None,
        pose: Any,
        parameters: SimulationParameters | None = None,
    ) -> tuple[State, Single]:
        """State and vertices ``(V, 3)``, metres in the world, of the next frame.

        No step changes a state, so a caller may go back to an earlier one.

        Parameters
        ----------
        state : State or None
            State after the frame before; None if the motion starts here, from rest.
        pose : (J, 3, 4) array
            World transforms of the body's joints from its rest pose, metres.
        parameters : SimulationParameters, optional
            Simulation parameters, for a garment that reads them.

        Raises
        ------
        InputError
            If the pose does not fit the body, is not finite or not rigid, or parameters are missing
            or of another type.

        Warns
        -----
        SsdrWarning
            If the parameters are new and lie outside the trained range.
        """
        m = check_joints(np.asarray(pose)[None], self.skeleton.n_joints)[0]
        given = {"pose": m.astype(np.float32), "reset": np.array([state is None], np.float32)}
        if self.reads_parameters:
            if not isinstance(parameters, SimulationParameters):
                raise InputError("parameters", "SimulationParameters", type(parameters).__name__)
            if parameters != self._warned:
                warn_beyond(parameters, ())
                self._warned = parameters
            given["parameters"] = np.array(dataclasses.astuple(parameters), np.float32)
        found = self._session.run(
            self._outputs, given | dict(self._start if state is None else state)
        )
        vertices, *states = found
        return dict(zip(self._start, states, strict=True)), vertices
