"""A frame of a live garment in one thread, beside torch, the simulator and memory.

The network has the sizes of the dress that ships, or of ``rooted``, and reads simulation
parameters, which change in every frame; its weights are random, since they do not change the time::

    python benchmarks/garment/live_speed.py

Milliseconds a frame, the median and the quickest of blocks of thirty frames: features, GRUs and
bones; detail and skinning; both; eight pivots of which all have weight; pushing out; the same
network in torch, frame by frame; the simulator at the settings of its data set.  ``bytes_ms`` is
the time in which the bytes that a frame reads and writes pass a copy in memory on this machine.
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

BONES, INFLUENCES, PIVOTS, FRAMES, BLOCK = 80, 8, 8, 600, 30
_SHIPPED, _ROOTED = {"hidden": 128, "rank": 16}, {"hidden": 256, "rank": 64}
CASES = {
    "2,100 vertices": {"preset": "dress", **_SHIPPED},
    "2,100 vertices, rooted": {"preset": "dress", **_ROOTED},
    "12,273 vertices": {"preset": "soft_dress", **_SHIPPED},
    "12,273 vertices, rooted": {"preset": "soft_dress", **_ROOTED},
}
COLUMNS = (
    "bones", "skinning", "frame", "frame_quickest", "bytes_ms", "pivots", "push_out", "torch",
    "simulator",
)  # fmt: skip


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
        began = time.perf_counter()
        for frame in range(start, min(start + BLOCK, frames)):
            step(frame)
        found.append(1e3 * (time.perf_counter() - began) / BLOCK)
    return found[1:]


def measure(preset: str, hidden: int, rank: int) -> common.Row:
    import torch

    from benchmarks.garment.scenes.cloth import Cloth
    from benchmarks.garment.scenes.dance.choreography import dance
    from benchmarks.garment.scenes.scene_file import load_data_set
    from benchmarks.garment.scenes.simulator import simulate
    from garmentnet.collision.outward import OutwardPush
    from garmentnet.configs.config import load_config, override
    from garmentnet.data.parameters import SimulationParameters
    from garmentnet.networks.checkpoint import Checkpoint, save_checkpoint
    from garmentnet.networks.features import Normaliser, PoseFeatures
    from garmentnet.networks.network import MotionNetwork
    from garmentnet.paper.ensemble import Kernel
    from garmentnet.runtime import load_live

    torch.set_num_threads(1)
    data_set = load_data_set(preset)
    body = data_set.make_body()
    garment = data_set.make_garment(body)
    subject = subject_of(garment, body, data_set.fps)
    motion = dance(body.skeleton, seed=20000, frames=FRAMES, fps=data_set.fps)
    poses = motion.joints
    some = [SimulationParameters(b, 0.2, 1.0) for b in np.geomspace(0.2, 2.0, PIVOTS)]
    changing = [SimulationParameters(b, 0.2, 1.0) for b in np.geomspace(0.2, 2.0, FRAMES)]

    def network(condition: bool) -> Any:
        reads = f"data.condition={str(condition).lower()}"
        sizes = [f"high.hidden={hidden}", f"high.rank={rank}"]
        fixed = "low.relative_to=frame"
        config = override(load_config("rooted"), [reads, fixed, *sizes])
        features = PoseFeatures(body.skeleton, config.features, data_set.fps)(poses)[0]
        fitted = Normaliser.fit([features], floor=0.01, clamp=5.0)
        torch.manual_seed(0)
        made = MotionNetwork(config, subject, fitted)
        made.low.code.fit(np.tile(np.eye(3, 4), (2, BONES, 1, 1)))
        made.add_high()
        return made.eval()

    with tempfile.TemporaryDirectory() as folder:
        reading = Checkpoint((network(True),), (None,), None)
        path = save_checkpoint(reading, Path(folder) / "one.safetensors")
        live = load_live(path)
        size = path.stat().st_size
        alike = Kernel()
        torch.nn.init.zeros_(alike.g[2].weight)
        ensemble = Checkpoint((network(False),) * PIVOTS, tuple(some), alike)
        mixed = load_live(save_checkpoint(ensemble, Path(folder) / "eight.safetensors"))

    state: Any = None
    states: list[Any] = []

    def bones(frame: int) -> None:
        nonlocal state
        state = live.advance(state, live.checked(poses[frame]), changing[frame])
        states.append(state)

    def skinning(frame: int) -> Any:
        return live.vertices(states[frame], poses[frame])

    def whole(of: Any) -> Callable[[int], None]:
        def step(frame: int) -> None:
            nonlocal state
            state, _ = of.step(state if frame else None, poses[frame], changing[frame])

        return step

    row: dict[str, Any] = {}
    for name, step in (
        ("bones", bones), ("skinning", skinning), ("frame", whole(live)), ("pivots", whole(mixed))
    ):  # fmt: skip
        found = blocks(step, FRAMES)
        row[name] = float(np.median(found))
        row[f"{name}_quickest"] = min(found)
    count = garment.n_vertices
    push = OutwardPush(body.skinning, garment.faces, garment.rest, pinned=garment.pinned)
    worn = np.stack([skinning(f) for f in range(4 * BLOCK)])

    def out(frame: int) -> None:
        push(worn[frame : frame + 1], poses[frame : frame + 1])

    row["push_out"] = float(np.median(blocks(out, len(worn))))
    memory: Any = None

    def in_torch(frame: int) -> None:
        nonlocal memory
        theta = changing[frame].normalised()
        memory, _ = reading.networks[0].step(memory, poses[frame], parameters=theta)

    row["torch"] = float(np.median(blocks(in_torch, 4 * BLOCK)))
    cloth = Cloth(body, garment, data_set.solver)
    short = motion.cut(0, 120)
    simulate(cloth, short, some[0])  # compiled
    lead = data_set.solver.approach + data_set.solver.settle
    began = time.perf_counter()
    simulate(cloth, short, some[0])
    row["simulator"] = 1e3 * (time.perf_counter() - began) / (120 + lead)
    # Weights once, and of every vertex its rest pose, bones, weights and result.
    vertex = 12 + INFLUENCES * (8 + 4) + 12
    read = size + count * vertex
    row["megabytes"] = read / 1e6
    row["bytes_ms"] = read / 1e6 / common.machine()["memory"]
    return row


if __name__ == "__main__":
    common.run(__file__, __doc__, CASES, measure, COLUMNS)
