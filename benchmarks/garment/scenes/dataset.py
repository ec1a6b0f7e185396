"""Simulation of data sets: clips run in parallel, and an interrupted run continues."""

from __future__ import annotations

import concurrent.futures
import contextlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from garmentnet.data.clip_files import Split
from garmentnet.data.store import ClipStore
from garmentnet.importing.quality import LIMITS
from garmentnet.io.files import Progress, silent
from ssdr.common.errors import InputError
from ssdr.common.parallel import get_threads

from .bvh import read_bvh
from .cloth import Cloth
from .motion_sources import MotionSource
from .retarget import retarget
from .scene_file import DataSet, SceneDescription
from .simulator import outfit_of, simulate

# Step of stored coordinates, metres: rounding to its multiples moves no vertex by more than 0.2 mm.
STEP = 2.3e-4


def recorded_motions(
    folder: str | os.PathLike[str], data_set: DataSet, *, frames: int = 300
) -> tuple[MotionSource, ...]:
    """Motions from a folder of BVH files, for every split.

    The last file is for testing, the one before for validation, the others for training, so that
    no file is in two splits.  Of two files none is for validation.

    Parameters
    ----------
    folder : path
    data_set : DataSet
        Data set with the frame rate and body of the motions.
    frames : int
        Length of a clip; the rest of a file is a clip too if it is at least half as long.
    """
    body = data_set.make_body()
    sources: list[MotionSource] = []
    files = find_bvh(folder)
    for k, path in enumerate(files):
        motion = retarget(read_bvh(path), body.skeleton, fps=data_set.fps)
        named = path.name[: path.name.lower().rindex(".bvh")]
        stem = "".join(c if c.isalnum() else "_" for c in named)
        starts = list(range(0, motion.n_frames, frames))
        if len(starts) > 1 and motion.n_frames - starts[-1] < frames // 2:
            starts.pop()
        for i, start in enumerate(starts):
            split: Split = "train"
            if k == len(files) - 1:
                split = "test"
            elif k == len(files) - 2 and len(files) > 2:
                split = "validation"
            length = min(frames, motion.n_frames - start)
            sources.append(MotionSource(f"{stem}_{i:02d}", split, i, length, (), str(path), start))
    return tuple(sources)


def find_bvh(folder: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Paths of the BVH files (``.bvh``, ``.bvh.gz``) in a folder, sorted by name.

    Raises
    ------
    InputError
        If there are none.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     (Path(folder) / "walk.bvh.gz").touch()
    ...     [path.name for path in find_bvh(folder)]
    ['walk.bvh.gz']
    """
    path = Path(folder)
    files = [p for p in path.glob("*") if p.name.lower().endswith((".bvh", ".bvh.gz"))]
    if not files:
        raise InputError("motion", "a folder with BVH files (.bvh, .bvh.gz)", str(path))
    return tuple(sorted(files))


def make_data_set(
    data_set: DataSet,
    path: str | os.PathLike[str],
    *,
    recorded: Sequence[MotionSource] = (),
    workers: int | None = None,
    progress: Progress = silent,
) -> ClipStore:
    """Simulate all clips of a data set that are not in its store yet.

    An interrupted run continues when it is called again: a clip is in the store complete or not at
    all, and has the same bytes however often the run was interrupted.

    Parameters
    ----------
    data_set : DataSet
    path : path
        Path of the store, which is created if it does not exist.
    recorded : sequence of MotionSource
        Further motions under the base parameters, from :func:`recorded_motions`.
    workers : int, optional
        Number of threads; by default that of :func:`ssdr.get_threads`, all cores.
    progress : callable, optional
        Called after every clip with its name and number, and the fraction of the frames, settling
        included, that is done.

    Returns
    -------
    ClipStore
        The store, which also holds the rejected clips, each with the reason.

    Raises
    ------
    InputError
        If the store has another garment or body, or a clip of the same name from another scene,
        or another process writes to the store.
    OSError
        If a clip could not be written.
    """
    count = get_threads() if workers is None else workers
    if count < 1:
        raise InputError("workers", "at least 1", workers)
    body = data_set.make_body()
    garment = data_set.make_garment(body)
    store = ClipStore.create(path, outfit_of(body, garment, data_set.fps))
    scenes = data_set.scenes(recorded)
    lead = data_set.solver.approach + data_set.solver.settle
    # The simulator runs without the GIL, so that threads use all cores.
    pool = concurrent.futures.ThreadPoolExecutor(count, thread_name_prefix="simulation")
    with _lock(store):
        store.sweep()
        todo = [s for s in scenes if not _is_there(store, s)]
        # Validation and testing come first, so that a part of a data set can be trained on.
        order = ("validation", "test", "train").index
        todo.sort(key=lambda s: (order(s.motion.split), s.parameters.name != "base"))
        total, frames = sum(s.motion.frames + lead for s in todo), 0
        cloth = Cloth(body, garment, data_set.solver)
        try:
            waiting = {pool.submit(_add, cloth, scene, store): scene for scene in todo}
            done = concurrent.futures.as_completed(waiting)
            for number, future in enumerate(done, start=len(scenes) - len(todo) + 1):
                future.result()
                scene = waiting[future]
                frames += scene.motion.frames + lead
                text = f"simulated {scene.name}, clip {number}/{len(scenes)}"
                progress(text, frames / total)
        finally:
            pool.shutdown(cancel_futures=True)
    return store


def _add(cloth: Cloth, scene: SceneDescription, store: ClipStore) -> None:
    """Simulate one scene and add it to the store."""
    data_set, motion = scene.data_set, scene.motion.make(cloth.body, scene.data_set.fps)
    result = simulate(
        cloth,
        motion,
        scene.parameters.parameters,
        limits=LIMITS | data_set.gate,
        seed=scene.seed,
        perturbation=scene.perturbation,
    )
    store.add(
        scene.name,
        vertices=result.vertices,
        joints=motion.joints,
        classes=motion.classes,
        split=scene.motion.split,
        motion=scene.motion.name,
        parameters=scene.parameters.parameters,
        seed=scene.seed,
        quality=result.quality,
        provenance=scene.provenance(),
        perturbation=scene.perturbation,
        step=STEP,
    )


def _is_there(store: ClipStore, scene: SceneDescription) -> bool:
    if scene.name not in store:
        return False
    clip, numbers = store.clip(scene.name), ("seed", "perturbation")
    here = json.loads(json.dumps(scene.provenance())) | {k: getattr(scene, k) for k in numbers}
    there = clip.provenance | {k: getattr(clip, k) for k in numbers}
    differs = [k for k in here | there if here.get(k) != there.get(k)]
    if clip.parameters != scene.parameters.parameters:
        differs.append("its parameters")
    if differs:
        raise InputError(
            "path",
            f"a store whose clip {scene.name} was made from the same scene",
            f"{store.path}, where it differs in {', '.join(differs)}",
        )
    return True


def _lock(store: ClipStore) -> contextlib.AbstractContextManager[Any]:
    """Context in which this process alone writes to a store.

    The operating system releases the lock of a process that has ended.
    """
    try:
        return FileLock(store.path / "writing.lock").acquire(timeout=0)
    except Timeout:
        got = "another process that does"
        raise InputError("path", "a store that nobody writes to", got) from None
