"""A frame of a live garment in one thread by onnxruntime, beside torch.

The network has the sizes of the dress that ships, or of ``rooted``, and reads simulation
parameters, which change in every frame; its weights are random, since they do not change the time::

    python benchmarks/garment/live_speed.py

Milliseconds a frame, the median and the quickest of blocks of thirty frames: the exported file;
pushing out; the same network in torch, frame by frame.
``start`` is the seconds to open the file, ``megabytes`` its size.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks import common

BONES, INFLUENCES, FRAMES, BLOCK = 80, 8, 600, 30
_SHIPPED, _ROOTED = {"hidden": 128, "rank": 16}, {"hidden": 256, "rank": 64}
CASES = {
    "2,100 vertices": {"preset": "dress", **_SHIPPED},
    "2,100 vertices, rooted": {"preset": "dress", **_ROOTED},
    "12,273 vertices": {"preset": "soft_dress", **_SHIPPED},
    "12,273 vertices, rooted": {"preset": "soft_dress", **_ROOTED},
}
COLUMNS = ("frame", "frame_quickest", "push_out", "torch", "start", "megabytes")


def subject_of(garment: Any, body: Any, fps: float) -> Any:
    """A garment whose vertices follow the nearest of evenly spread bones."""
    from scipy.spatial import cKDTree

    from garmentnet.data.outfit import mesh_identity
    from garmentnet.data.subject import Subject
    from ssdr import Skinning

    centres = garment.rest[:: len(garment.rest) // BONES][:BONES]
    distance, indices = cKDTree(centres).query(garment.rest, k=INFLUENCES)
    weights = 1 / (distance + 1e-3)
    rest = Skinning(
        garment.rest,
        indices,
        weights / weights.sum(axis=1, keepdims=True),
        np.tile(np.eye(3, 4), (1, BONES, 1, 1)),
        faces=garment.faces,
    )
    identity = mesh_identity(garment.rest, garment.faces)
    return Subject(rest, body.skinning, body.skeleton, fps, identity)


def blocks(step: Callable[[int], Any], frames: int) -> list[float]:
    """Milliseconds a frame of blocks of frames, the first one left out."""
    found = []
    for start in range(0, frames, BLOCK):
        began = time.process_time()
        for frame in range(start, min(start + BLOCK, frames)):
            step(frame)
        found.append(1e3 * (time.process_time() - began) / BLOCK)
    return found[1:]


def measure(preset: str, hidden: int, rank: int) -> common.Row:
    import torch

    from benchmarks.garment.scenes.dance.choreography import dance
    from benchmarks.garment.scenes.scene_file import load_data_set
    from garmentnet.collision.outward import OutwardPush
    from garmentnet.configs.config import load_config, override
    from garmentnet.data.parameters import SimulationParameters
    from garmentnet.networks.checkpoint import Checkpoint
    from garmentnet.networks.features import Normaliser, PoseFeatures
    from garmentnet.networks.network import MotionNetwork
    from garmentnet.runtime import LiveGarment
    from garmentnet.runtime.onnx_file import export_onnx

    torch.set_num_threads(1)
    data_set = load_data_set(preset)
    body = data_set.make_body()
    garment = data_set.make_garment(body)
    subject = subject_of(garment, body, data_set.fps)
    motion = dance(body.skeleton, seed=20000, frames=FRAMES, fps=data_set.fps)
    poses = motion.joints
    changing = [SimulationParameters(b, 0.2, 1.0) for b in np.geomspace(0.2, 2.0, FRAMES)]
    changes = ["data.condition=true", f"high.hidden={hidden}", f"high.rank={rank}"]
    config = override(load_config("rooted"), changes)
    features = PoseFeatures(body.skeleton, config.features, data_set.fps)(poses)[0]
    torch.manual_seed(0)
    network = MotionNetwork(config, subject, Normaliser.fit([features], floor=0.01, clamp=5.0))
    network.low.code.fit(np.tile(np.eye(3, 4), (2, BONES, 1, 1)))
    network.add_high()
    network.eval()
    row: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        file = export_onnx(Checkpoint((network,), (None,), None), Path(folder) / "one.onnx")
        began = time.process_time()
        live = LiveGarment(file)
        row["start"] = time.process_time() - began
        row["megabytes"] = file.stat().st_size / 1e6
    state: Any = None
    worn = np.empty((FRAMES, garment.n_vertices, 3), np.float32)

    def step(frame: int) -> None:
        nonlocal state
        state, worn[frame] = live.step(state if frame else None, poses[frame], changing[frame])

    found = blocks(step, FRAMES)
    row["frame"], row["frame_quickest"] = float(np.median(found)), min(found)
    push = OutwardPush(body.skinning, garment.faces, garment.rest, pinned=garment.pinned)

    def out(frame: int) -> None:
        push(worn[frame : frame + 1], poses[frame : frame + 1])

    row["push_out"] = float(np.median(blocks(out, 4 * BLOCK)))
    memory: Any = None

    def in_torch(frame: int) -> None:
        nonlocal memory
        theta = changing[frame].normalised()
        memory, _ = network.step(memory, poses[frame], parameters=theta)

    row["torch"] = float(np.median(blocks(in_torch, 4 * BLOCK)))
    return row


if __name__ == "__main__":
    common.run(__file__, __doc__, CASES, measure, COLUMNS)
