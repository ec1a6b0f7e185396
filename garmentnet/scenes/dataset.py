"""Make the clips of a data set: one process a core, resumable, never anything twice."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import json
import multiprocessing
import os
import queue
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

from ssdr.errors import InputError, SsdrError
from ssdr.io.registry import require

from ..bvh import find_bvh, read_bvh, retarget
from ..clips import ClipStore, Split
from ..motion import Motion
from .body import Body
from .scene import DataSet, MotionSource, Scene
from .simulate import simulate, versions

__all__ = ["Progress", "make_data_set", "open_store", "recorded_motions"]

_ROW = 12  # bytes of a vertex in a frame
_LOCK = "writing.lock"


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a data set is.

    Attributes
    ----------
    clips, clips_total : int
    frames, frames_total : int
        Settling included; of what was still to do when the run began.
    elapsed, time_left : float
        Seconds; the second is NaN before the first frame.
    clip : str
        The clip that this is about.
    accepted : bool or None
        Whether the quality gate took it; None while it runs.
    reason : str
        Why not.
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


def recorded_motions(
    folder: str | os.PathLike[str], data_set: DataSet, *, frames: int = 300
) -> tuple[MotionSource, ...]:
    """Clips from a folder of BVH files, for every split.

    The last file becomes test, the one before validation, the others train: no file is in two
    splits.  With two files there is no validation; one is cut in three.

    Parameters
    ----------
    folder : path
    data_set : DataSet
        Whose rate counts the frames.
    frames : int
        Length of a clip; what is left of a file is a clip too, if it has half of that.
    """
    body = data_set.make_body()
    found: list[MotionSource] = []
    files = find_bvh(folder)
    for k, path in enumerate(files):
        motion = retarget(read_bvh(path), body.skeleton, fps=data_set.fps)
        stem = "".join(c if c.isalnum() else "_" for c in path.name.split(".")[0])
        starts = list(range(0, motion.n_frames, frames))
        if len(starts) > 1 and motion.n_frames - starts[-1] < frames // 2:
            starts.pop()
        for i, start in enumerate(starts):
            split: Split = "train"
            if len(files) == 1:
                place = i / len(starts)
                split = "train" if place < 0.6 else "validation" if place < 0.8 else "test"
            elif k == len(files) - 1:
                split = "test"
            elif k == len(files) - 2 and len(files) > 2:
                split = "validation"
            length = min(frames, motion.n_frames - start)
            found.append(MotionSource(f"{stem}_{i:02d}", split, i, length, (), str(path), start))
    return tuple(found)


def open_store(data_set: DataSet, path: str | os.PathLike[str]) -> ClipStore:
    """The store of a data set, made if it is not there.

    Raises
    ------
    InputError
        If what is there is of another garment or body.
    """
    body = data_set.make_body()
    garment = data_set.make_garment(body)
    return ClipStore.create(
        path,
        rest=garment.rest,
        faces=garment.faces,
        body=body.skinning,
        skeleton=body.skeleton,
        fps=data_set.fps,
        mirror_vertices=garment.mirror,
        pinned=garment.pinned,
        attributes={"data_set": data_set.name},
    )


def make_data_set(
    data_set: DataSet,
    path: str | os.PathLike[str],
    *,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> ClipStore:
    """Simulate all clips of a data set that its store does not hold yet.

    Stopped at any moment and started again, it goes on where it was: a clip is in the store
    whole or not at all, and comes out with the same bytes.

    Parameters
    ----------
    data_set : DataSet
    path : path
        Of the store.
    workers : int, optional
        Processes; as many as cores by default.
    progress : callable, optional
        Called from this process with a :class:`Progress`.

    Returns
    -------
    ClipStore
        With rejected clips too, each with its reason.

    Raises
    ------
    InputError
        If the store holds a clip of this name that was made otherwise, another process writes
        to it, or the disk has no room.
    MissingDependencyError
        Without newton or warp.
    """
    require("newton", "scenes", "a simulation")
    require("warp", "scenes", "a simulation")
    count = workers or len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    count = workers or count
    if count < 1:
        raise InputError("workers", "at least 1", workers)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    store = open_store(data_set, path)
    made_with = versions()
    scenes = data_set.scenes()
    with _writing(store):
        store.sweep()
        todo = [s for s in scenes if not _is_there(store, s, made_with)]
        # What is learned from comes first: training need not wait for the test clips.
        todo.sort(key=lambda s: get_args(Split).index(s.motion.split))
        _check_room(store, todo)
        if todo:
            _Run(store, scenes, todo, progress).go(min(count, len(todo)))
    return store


def _is_there(store: ClipStore, scene: Scene, made_with: dict[str, str]) -> bool:
    if scene.name not in store:
        return False
    clip = store.clip(scene.name)
    wanted = json.loads(json.dumps(scene.provenance(made_with)))
    same = (
        clip.provenance == wanted
        and clip.parameters == scene.parameters.parameters
        and clip.seed == scene.seed
        and clip.perturbation == scene.perturbation
    )
    if not same:
        differs = [k for k in wanted if clip.provenance.get(k) != wanted[k]]
        raise InputError(
            "path",
            f"a store whose clip {scene.name} was made from the same scene",
            f"{store.path}, where it differs in {', '.join(differs) or 'its parameters'}",
        )
    return True


def _check_room(store: ClipStore, todo: list[Scene]) -> None:
    # Half of it is what compression was seen to save; the rest is left to spare.
    need = sum(s.motion.frames for s in todo) * store.n_vertices * _ROW
    free = shutil.disk_usage(store.path).free
    if need > free:
        raise InputError(
            "path", f"a disk with {need >> 20} MiB to spare", f"{free >> 20} MiB at {store.path}"
        )


@contextlib.contextmanager
def _writing(store: ClipStore) -> Iterator[None]:
    """One writer at a time; the lock of a process that is gone does not count."""
    path = store.path / _LOCK
    while True:
        try:
            handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
            break
        except FileExistsError:
            text = path.read_text(errors="replace").strip() if path.exists() else ""
            if text.isdigit() and _alive(int(text)):
                raise InputError(
                    "path", "a store that nobody writes to", f"process {text} does"
                ) from None
            path.unlink(missing_ok=True)
    os.write(handle, str(os.getpid()).encode())
    os.close(handle)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    if process == os.getpid():
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


class _Run:
    """One run over what is to do: sends scenes to processes, gathers what they say."""

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
        context = multiprocessing.get_context("spawn")
        news: Any = context.Queue()
        with (
            _one_thread(),
            concurrent.futures.ProcessPoolExecutor(
                workers, mp_context=context, initializer=_begin, initargs=(news, os.getpid())
            ) as pool,
        ):
            # The first compiles the simulator's kernels; beside it others would do the same.
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
                for future in waiting:
                    future.cancel()
                for process in list((pool._processes or {}).values()):
                    process.terminate()
                raise

    def _wait(self, futures: set[Any], news: Any) -> set[Any]:
        while True:
            done, _ = concurrent.futures.wait(
                futures, timeout=0.2, return_when=concurrent.futures.FIRST_COMPLETED
            )
            name = ""
            with contextlib.suppress(queue.Empty):
                while True:
                    name, frames = news.get_nowait()
                    self._frames[name] = frames
            if name:
                self._tell(name)
            if done:
                return done

    def _finished(self, scene: Scene, accepted: bool, reason: str, seconds: float) -> None:
        self._clips += 1
        frames = scene.motion.frames + self._lead
        self._frames[scene.name] = frames
        line = {"clip": scene.name, "frames": frames, "seconds": round(seconds, 2)}
        # Beside the clips, not in them: times are never the same twice.
        with (self._store.path / "timing.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        self._tell(scene.name, accepted, reason)

    def _tell(self, name: str, accepted: bool | None = None, reason: str = "") -> None:
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
    """Processes started inside use one thread each, for all that counts threads by itself."""
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


# What follows runs in the processes.
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

    def tell(frame: int, total: int) -> None:
        if os.getppid() != _parent:
            # Nobody waits for this any more; the clip is made when the run goes on.
            os._exit(1)
        if _news is not None and (frame % 5 == 0 or frame == total):
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
        progress=tell,
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
    """Compile the simulator's kernels, on the smallest dress and two frames."""
    from ..parameters import SimulationParameters
    from .body import default_body
    from .garments import Dress, cut_dress
    from .simulate import Solver

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
    import numpy as np

    joints = np.broadcast_to(np.eye(3, 4), (2, body.skeleton.n_joints, 3, 4))
    return Motion(joints, np.zeros(2, dtype=np.int8))
