"""Worker processes that simulate clips, and the run that starts them and reports progress."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import json
import multiprocessing
import os
import queue
import time
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import numpy as np

from ssdr.errors import SsdrError

from ..data.motion import Motion
from ..data.parameters import SimulationParameters
from ..data.store import ClipStore
from .body import Body, default_body
from .cloth import Solver
from .garments import Dress, cut_dress
from .scene import Scene
from .simulator import simulate, versions

__all__ = ["Progress", "Run"]

_POLL = 0.2  # seconds between looks at the progress of the processes
_EVERY = 5  # frames after which a process reports


@dataclasses.dataclass(frozen=True)
class Progress:
    """Progress of a data set.

    Attributes
    ----------
    clips, clips_total : int
    frames, frames_total : int
        Of the clips that this run simulates, including the frames before the motion starts.
    elapsed, time_left : float
        Seconds; `time_left` is NaN before the first frame.
    clip : str
        The clip that progressed last.
    accepted : bool or None
        Whether the quality gate accepted it; None while it is simulated.
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
    accepted: bool | None = None
    reason: str = ""


class Run:
    """One run: sends scenes to worker processes and collects their progress.

    Parameters
    ----------
    store : ClipStore
    scenes : tuple of Scene
        All of the data set.
    todo : list of Scene
        Those to simulate, in this order; not empty.
    progress : callable or None
    """

    def __init__(
        self,
        store: ClipStore,
        scenes: tuple[Scene, ...],
        todo: list[Scene],
        progress: Callable[[Progress], None] | None,
    ) -> None:
        self._store, self._todo, self._progress = store, todo, progress
        solver = todo[0].data_set.solver
        self._lead = solver.approach + solver.settle
        self._total = sum(s.motion.frames + self._lead for s in todo)
        self._clips = len(scenes) - len(todo)
        self._n_clips = len(scenes)
        self._frames: dict[str, int] = {}
        self._begun = time.monotonic()

    def go(self, workers: int) -> None:
        """Simulate the clips in `workers` processes.

        Raises
        ------
        SsdrError
            If a process was killed or a clip could not be written.
        """
        try:
            self._go(workers)
        except BrokenProcessPool as error:
            raise SsdrError(
                "a process that simulates was killed (for want of memory?); "
                "the same command again goes on where it was"
            ) from error

    def _go(self, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        news: Any = context.Queue()
        with (
            _one_thread(),
            concurrent.futures.ProcessPoolExecutor(
                workers, mp_context=context, initializer=_begin, initargs=(news, os.getpid())
            ) as pool,
        ):
            # One process compiles the simulator's kernels; otherwise every process would.
            first = pool.submit(_warm_up)
            self._wait({first}, news)
            first.result()
            waiting = {
                pool.submit(_make, scene, str(self._store.path)): scene for scene in self._todo
            }
            try:
                while waiting:
                    for future in self._wait(set(waiting), news):
                        scene = waiting.pop(future)
                        self._finished(scene, *future.result())
            except BaseException:
                # The futures are not cancelled: a broken pool ends all of them itself.
                for process in list((pool._processes or {}).values()):
                    process.terminate()
                raise

    def _wait(self, futures: set[Any], news: Any) -> set[Any]:
        while True:
            done, _ = concurrent.futures.wait(
                futures, timeout=_POLL, return_when=concurrent.futures.FIRST_COMPLETED
            )
            name = ""
            with contextlib.suppress(queue.Empty):
                while True:
                    name, frames = news.get_nowait()
                    self._frames[name] = frames
            if name:
                self._report(name)
            if done:
                return done

    def _finished(self, scene: Scene, accepted: bool, reason: str, seconds: float) -> None:
        self._clips += 1
        frames = scene.motion.frames + self._lead
        self._frames[scene.name] = frames
        line = {"clip": scene.name, "frames": frames, "seconds": round(seconds, 2)}
        # In a file of its own, because times differ between runs and clips must not.
        with (self._store.path / "timing.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        self._report(scene.name, accepted, reason)

    def _report(self, name: str, accepted: bool | None = None, reason: str = "") -> None:
        if self._progress is None:
            return
        frames = sum(self._frames.values())
        elapsed = time.monotonic() - self._begun
        left = elapsed / frames * (self._total - frames) if frames else float("nan")
        self._progress(
            Progress(
                self._clips,
                self._n_clips,
                frames,
                self._total,
                elapsed,
                left,
                name,
                accepted,
                reason,
            )
        )


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started in this block use one thread each."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "SSDR_NUM_THREADS")
    before = {n: os.environ.get(n) for n in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


# The rest runs in the worker processes.
_news: Any = None
_parent = 0


def _begin(news: Any, parent: int) -> None:
    global _news, _parent
    _news, _parent = news, parent


def _make(scene: Scene, path: str) -> tuple[bool, str, float]:
    """Simulate one scene and add it to the store."""
    begun = time.monotonic()
    data_set = scene.data_set
    body = data_set.make_body()
    garment = data_set.make_garment(body)
    motion = scene.motion.make(body, data_set.fps)

    def send(frame: int, total: int) -> None:
        if os.getppid() != _parent:
            # The parent has ended; the clip is simulated when the run continues.
            os._exit(1)
        if _news is not None and (frame % _EVERY == 0 or frame == total):
            _news.put((scene.name, frame))

    result = simulate(
        body,
        garment,
        motion,
        scene.parameters.parameters,
        solver=data_set.solver,
        gate=data_set.gate,
        seed=scene.seed,
        perturbation=scene.perturbation,
        progress=send,
    )
    try:
        ClipStore.open(path).add(
            scene.name,
            vertices=result.vertices,
            joints=motion.joints,
            classes=motion.classes,
            split=scene.motion.split,
            motion=scene.motion.name,
            parameters=scene.parameters.parameters,
            seed=scene.seed,
            quality=dataclasses.asdict(result.quality),
            provenance=scene.provenance(versions()),
            perturbation=scene.perturbation,
        )
    except OSError as error:
        raise SsdrError(f"{path}: clip {scene.name} could not be written: {error}") from error
    return result.quality.accepted, result.quality.reason, time.monotonic() - begun


def _warm_up() -> None:
    """Compile the simulator's kernels, with a small dress and two frames."""
    body = default_body()
    motion = _still(body)
    simulate(
        body,
        cut_dress(body, Dress(vertices=300)),
        motion,
        SimulationParameters(),
        solver=Solver(substeps=1, approach=0, settle=1),
    )


def _still(body: Body) -> Motion:
    joints = np.broadcast_to(np.eye(3, 4), (2, body.skeleton.n_joints, 3, 4))
    return Motion(joints, np.zeros(2, dtype=np.int8))
