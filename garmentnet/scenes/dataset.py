"""Data sets: their clips are simulated in parallel; an interrupted run continues."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from ssdr.errors import InputError
from ssdr.parallel import get_threads

from ..data.bvh import find_bvh, read_bvh
from ..data.clip_files import Split
from ..data.retarget import retarget
from ..data.store import ClipStore
from .run import Progress, simulate_scenes
from .scene import DataSet, MotionSource, Scene

__all__ = ["Progress", "make_data_set", "open_store", "recorded_motions"]

_VERTEX = 12  # bytes of a vertex in one frame, float32
_LOCK = "writing.lock"


def recorded_motions(
    folder: str | os.PathLike[str], data_set: DataSet, *, frames: int = 300
) -> tuple[MotionSource, ...]:
    """Motions from a folder of BVH files, for every split.

    The last file is for testing, the one before for validation, the others for training, so that
    no file is in two splits.  Of two files none is for validation; a single file is cut in three
    parts.

    Parameters
    ----------
    folder : path
    data_set : DataSet
        For its frame rate and its body.
    frames : int
        Length of a clip; the rest of a file is a clip too if it is at least half as long.
    """
    body = data_set.make_body()
    sources: list[MotionSource] = []
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
            sources.append(MotionSource(f"{stem}_{i:02d}", split, i, length, (), str(path), start))
    return tuple(sources)


def open_store(data_set: DataSet, path: str | os.PathLike[str]) -> ClipStore:
    """The store of a data set, created if it does not exist.

    Raises
    ------
    InputError
        If it exists with another garment or body.
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
    """Simulate all clips of a data set that are not in its store yet.

    An interrupted run continues when it is called again: a clip is in the store complete or not at
    all, and has the same bytes however often the run was interrupted.

    Parameters
    ----------
    data_set : DataSet
    path : path
        Of the store.
    workers : int, optional
        Threads; as many as :func:`ssdr.parallel.get_threads` by default, all cores.
    progress : callable, optional
        Called in this process with a :class:`~garmentnet.scenes.run.Progress`.

    Returns
    -------
    ClipStore
        It also has the rejected clips, each with the reason.

    Raises
    ------
    InputError
        If the store has a clip of the same name from another scene, another process writes to
        the store, or the disk is too small.
    """
    count = get_threads() if workers is None else workers
    if count < 1:
        raise InputError("workers", "at least 1", workers)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    store = open_store(data_set, path)
    scenes = data_set.scenes()
    with _writing(store):
        store.sweep()
        todo = [s for s in scenes if not _is_there(store, s)]
        # The base parameters first, and of these what training needs: it need not wait.
        todo.sort(key=lambda s: (s.parameters != data_set.base, bool(s.repeat_of), _order(s)))
        _check_space(store, todo)
        if todo:
            simulate_scenes(store, todo, len(scenes), min(count, len(todo)), progress)
    return store


def _order(scene: Scene) -> int:
    order: tuple[Split, ...] = ("validation", "train", "test")
    return order.index(scene.motion.split)


def _is_there(store: ClipStore, scene: Scene) -> bool:
    if scene.name not in store:
        return False
    clip = store.clip(scene.name)
    expected = json.loads(json.dumps(scene.provenance()))
    same = (
        clip.provenance == expected
        and clip.parameters == scene.parameters.parameters
        and clip.seed == scene.seed
        and clip.perturbation == scene.perturbation
    )
    if not same:
        differs = [k for k in expected if clip.provenance.get(k) != expected[k]]
        raise InputError(
            "path",
            f"a store whose clip {scene.name} was made from the same scene",
            f"{store.path}, where it differs in {', '.join(differs) or 'its parameters'}",
        )
    return True


def _check_space(store: ClipStore, todo: list[Scene]) -> None:
    # Without compression, which roughly halves it: the other half is reserve.
    need = sum(s.motion.frames for s in todo) * store.n_vertices * _VERTEX
    free = shutil.disk_usage(store.path).free
    if need > free:
        raise InputError(
            "path", f"a disk with {need >> 20} MiB to spare", f"{free >> 20} MiB at {store.path}"
        )


@contextlib.contextmanager
def _writing(store: ClipStore) -> Iterator[None]:
    """Allow one writer at a time, by a lock file; the lock of an ended process is ignored."""
    path = store.path / _LOCK
    while True:
        try:
            handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
            break
        except FileExistsError:
            text = path.read_text(errors="replace").strip() if path.exists() else ""
            if text.isdigit() and _alive(int(text)):
                raise InputError(
                    "path",
                    "a store that nobody writes to",
                    f"process {text} does (if that is no garmentnet, remove {path})",
                ) from None
            path.unlink(missing_ok=True)
    os.write(handle, str(os.getpid()).encode())
    os.close(handle)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _alive(pid: int) -> bool:
    if pid == os.getpid():
        return False
    if os.name == "nt":
        return True  # on Windows a signal would end the process
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
