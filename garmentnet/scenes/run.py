"""Scenes simulated in parallel threads and added to a store, with a report of the progress.

The simulator runs without the GIL, so that threads use all cores.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
import json
import time
from collections.abc import Callable

from ssdr.errors import SsdrError

from ..data.store import ClipStore
from .cloth import Cloth
from .scene import Scene
from .simulator import simulate

__all__ = ["STEP", "Progress", "simulate_scenes"]

# Metres; stored vertices are rounded to its multiples, so that no vertex moves by more than 0.2 mm.
STEP = 2.3e-4


@dataclasses.dataclass(frozen=True)
class Progress:
    """Progress of a data set, after a clip.

    Attributes
    ----------
    clips, clips_total : int
    frames, frames_total : int
        Of the clips that this run simulates, including the frames before the motion starts.
    elapsed, time_left : float
        Seconds.
    clip : str
        The clip that was finished.
    accepted : bool
        Whether the quality gate accepted it.
    reason : str
        Why it was rejected.
    """

    clips: int
    clips_total: int
    frames: int
    frames_total: int
    elapsed: float
    time_left: float
    clip: str
    accepted: bool
    reason: str = ""


def simulate_scenes(
    store: ClipStore,
    scenes: list[Scene],
    clips_total: int,
    workers: int,
    progress: Callable[[Progress], None] | None,
) -> None:
    """Simulate scenes of one data set, in this order, and add them to its store.

    Raises
    ------
    SsdrError
        If a clip could not be written.
    """
    data_set = scenes[0].data_set
    body = data_set.make_body()
    cloth = Cloth(body, data_set.make_garment(body), data_set.solver)
    lead = data_set.solver.approach + data_set.solver.settle
    total = sum(s.motion.frames + lead for s in scenes)
    begun, frames = time.monotonic(), 0
    pool = concurrent.futures.ThreadPoolExecutor(workers, thread_name_prefix="simulation")
    try:
        waiting = {pool.submit(_add, cloth, scene, store): scene for scene in scenes}
        for number, future in enumerate(concurrent.futures.as_completed(waiting), start=1):
            scene = waiting[future]
            accepted, reason, seconds = future.result()
            frames += scene.motion.frames + lead
            line = {"clip": scene.name, "frames": scene.motion.frames + lead, "seconds": seconds}
            # In a file of its own, because times differ between runs and clips must not.
            with (store.path / "timing.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            if progress is not None:
                elapsed = time.monotonic() - begun
                clips = clips_total - len(scenes) + number
                left = elapsed / frames * (total - frames)
                progress(
                    Progress(
                        clips,
                        clips_total,
                        frames,
                        total,
                        elapsed,
                        left,
                        scene.name,
                        accepted,
                        reason,
                    )
                )
    finally:
        pool.shutdown(cancel_futures=True)


def _add(cloth: Cloth, scene: Scene, store: ClipStore) -> tuple[bool, str, float]:
    """Simulate one scene and add it to the store: accepted, reason, seconds."""
    begun = time.monotonic()
    data_set, motion = scene.data_set, scene.motion.make(cloth.body, scene.data_set.fps)
    result = simulate(
        cloth,
        motion,
        scene.parameters.parameters,
        gate=data_set.gate,
        seed=scene.seed,
        perturbation=scene.perturbation,
    )
    try:
        store.add(
            scene.name,
            vertices=result.vertices,
            joints=motion.joints,
            classes=motion.classes,
            split=scene.motion.split,
            motion=scene.motion.name,
            parameters=scene.parameters.parameters,
            seed=scene.seed,
            quality=dataclasses.asdict(result.quality),
            provenance=scene.provenance(),
            perturbation=scene.perturbation,
            step=STEP,
        )
    except OSError as error:
        raise SsdrError(f"{store.path}: clip {scene.name} could not be written: {error}") from error
    return result.quality.accepted, result.quality.reason, round(time.monotonic() - begun, 2)
