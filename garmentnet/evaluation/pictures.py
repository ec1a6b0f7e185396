"""Pictures of simulation, prediction and error: of a clip, and of the hardest frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.ndimage import distance_transform_edt

from ssdr import MeshSequence
from ssdr.render import write_picture

from ..data.clip import Clip
from ..data.motion import CLASSES
from ..data.outfit import Outfit
from ..data.store import ClipStore
from ..drawing.dressed import caption, free_vertices, outfit_sheet, spread_frames

__all__ = ["HARD", "draw_clip", "draw_moments", "moments"]

Array = NDArray[np.float32]
# Classes of motion in which loose cloth moves most.
HARD = ("spin", "kick", "squat", "stop")
_FRAMES = 5  # of a sheet


def moments(
    store: ClipStore, names: Sequence[str], classes: Sequence[str] = HARD
) -> list[tuple[str, str, int]]:
    """The most pronounced frame of each class of motion that occurs in the clips.

    Of spins the fastest rotation, of kicks the highest foot, of squats the lowest root, of other
    classes the middle of the longest run of frames.

    Parameters
    ----------
    store : ClipStore
    names : sequence of str
        Clips.
    classes : sequence of str

    Returns
    -------
    list of (class, clip, frame)
    """
    best: dict[str, tuple[float, str, int]] = {}
    for name in names:
        clip = store.clip(name)
        for label in classes:
            inside = clip.classes == CLASSES.index(label)
            if not inside.any():
                continue
            value = np.where(inside, _strength(clip, label, inside), -np.inf)
            frame = int(value.argmax())
            if label not in best or value[frame] > best[label][0]:
                best[label] = (float(value[frame]), name, frame)
    return [(label, *best[label][1:]) for label in classes if label in best]


def _strength(clip: Clip, label: str, inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    skeleton, joints = clip.outfit.skeleton, np.asarray(clip.joints, np.float64)
    heights = skeleton.positions(joints)[..., 1]
    if label == "spin":
        root = skeleton.pose(joints)[1][:, 0]
        # The smaller the trace of the step's rotation, the larger its angle.
        return np.append(-np.inf, -np.einsum("fij,fij->f", root[1:], root[:-1]))
    if label == "kick":
        # Shins and feet: the four joints that are lowest on average.
        feet = np.argsort(heights.mean(axis=0))[:4]
        return np.asarray(heights[:, feet].max(axis=1))
    if label == "squat":
        return np.asarray(-heights[:, 0])
    # Number of frames to the closer end of the run.
    return np.asarray(distance_transform_edt(np.pad(inside, 1))[1:-1])


def draw_clip(
    clip: Clip,
    prediction: Array,
    path: Path,
    *,
    free: ArrayLike | None = None,
) -> Path:
    """Draw truth, prediction and error of a clip, row by row, as a PNG.

    The error is coloured on the cloth alone, and the figures are RMSE over the cloth: of the clip
    in the head, of a frame in its column.

    Parameters
    ----------
    clip : Clip
    prediction : (F, V, 3) array
    path : Path
    free : (V,) bool array, optional
        Vertices that have a figure of their own; by default those that are not pinned.

    Raises
    ------
    InputError
        If `free` is no mask of the cloth.
    """
    frames = spread_frames(_FRAMES, clip.n_frames)
    whole = slice(None)
    sheet = _sheet(
        clip.outfit,
        clip.joints,
        clip.body(whole),
        prediction,
        clip.sequence.frames(whole),
        frames=frames,
        captions=[caption(t, clip.fps, clip.classes, "\n") for t in frames],
        title=clip.name,
        free=free_vertices(clip.outfit) if free is None else free,
    )
    write_picture(sheet, path)
    return path


def draw_moments(
    store: ClipStore, predict: Callable[[Clip], Array], names: Sequence[str], path: Path
) -> list[tuple[str, str, int]]:
    """Draw the frames of :func:`moments` as the columns of one picture; returns them.

    The figures in the head are those of these frames.
    """
    hardest = moments(store, names)
    if not hardest:
        return hardest
    columns = []
    for _, name, frame in hardest:
        clip, at = store.clip(name), slice(frame, frame + 1)
        columns.append(
            (clip.joints[at], clip.body(at), predict(clip)[at], clip.sequence.frames(at))
        )
    sheet = _sheet(
        store,
        *(np.concatenate(x) for x in zip(*columns, strict=True)),
        frames=list(range(len(hardest))),
        captions=[f"{label}\n{name}, {frame / store.fps:.2f} s" for label, name, frame in hardest],
        title=", ".join(label for label, _, _ in hardest),
        free=free_vertices(store),
    )
    write_picture(sheet, path)
    return hardest


def _sheet(
    outfit: Outfit, joints: Any, body: Array, prediction: Array, truth: Array, **options: Any
) -> Image.Image:
    return outfit_sheet(
        MeshSequence(body, outfit.body.faces, outfit.fps),
        MeshSequence(prediction, outfit.faces, outfit.fps),
        truth,
        joints,
        outfit.skeleton.positions(joints)[:, 0],
        **options,
    )
