"""Milliseconds a frame of a trained garment in one thread: onnxruntime, pushing out, and torch.

``python benchmarks/garment/live_speed.py dress`` plays the dance that ships, with simulation
parameters that change in every frame; the dress may be any checkpoint of one network for its body.
A figure is the median of blocks of thirty frames.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from garmentnet.collision.outward import push_of
from garmentnet.data.parameters import SimulationParameters
from garmentnet.io.tensors import SHIPPED
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.prediction.motion_file import read_motion
from garmentnet.runtime import LiveGarment
from garmentnet.runtime.onnx_file import export_onnx

BLOCK, ROUNDS = 30, 20


def milliseconds(step: Callable[[int], Any], frames: int) -> float:
    """Median over blocks of frames, the first one left out."""
    found = []
    for _ in range(ROUNDS):
        for start in range(0, frames - BLOCK + 1, BLOCK):
            began = time.process_time()
            for frame in range(start, start + BLOCK):
                step(frame)
            found.append(1e3 * (time.process_time() - began) / BLOCK)
    return float(np.median(found[1:]))


def main(name: str) -> None:
    torch.set_num_threads(1)
    model = load_checkpoint(name)
    poses, _ = read_motion(SHIPPED / "dance.npz", model.subject)
    count, push = len(poses), push_of(model.subject)
    changing = [SimulationParameters(b, 0.2, 1.0) for b in np.geomspace(0.2, 2.0, count)]
    given = changing if model.reads_parameters else [None] * count
    with tempfile.TemporaryDirectory() as folder:
        file = export_onnx(model, Path(folder) / "one.onnx")
        began = time.process_time()
        live = LiveGarment(file)
        print(f"opened in {time.process_time() - began:.2f} s, {file.stat().st_size / 1e6:.1f} MB")
    worn = np.empty((count, model.subject.garment.n_vertices, 3), np.float32)
    state: dict[str, Any] = {"onnxruntime": None, "torch": None}

    def step(name: str, run: Callable[[Any, Any, Any], tuple[Any, Any]], t: int) -> None:
        state[name], worn[t] = run(state[name] if t else None, poses[t], given[t])

    def by_torch(memory: Any, pose: Any, parameters: Any) -> tuple[Any, Any]:
        return model.step(memory, pose, parameters=parameters)

    for name, run in (("onnxruntime", live.step), ("torch", by_torch)):
        print(f"{name} {milliseconds(lambda t, n=name, r=run: step(n, r, t), count):.3f} ms")
    if push is not None:
        print(f"pushing out {milliseconds(lambda t: push(worn[[t]], poses[[t]]), count):.3f} ms")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("model", nargs="?", default="dress", help="a checkpoint")
    main(options.parse_args().model)
