"""Pictures of simulation, prediction and error: of a clip, and of the hardest frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr.render import contact_sheet, write_picture

from ..data.clip import Clip
from ..data.motion import CLASSES
from ..data.store import ClipStore
from ..data.virtual_bones import VirtualBones
from ..drawing.dressed import (
    AZIMUTH,
    MILLIMETRES,
    caption,
    facing_the_camera,
    free_vertices,
    outfit_parts,
    outfit_regions,
    spread_frames,
)
from .scores import Answer

__all__ = ["HARD", "draw_clip", "draw_moments", "moments"]

Array = NDArray[np.float32]
# Classes of motion in which loose cloth moves most.
HARD = ("spin", "kick", "squat", "stop")


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
    places = skeleton.positions(joints)
    if label == "spin":
        root = skeleton.pose(joints)[1][:, 0]
        turned = np.einsum("fij,fij->f", root[1:], root[:-1])
        angle = np.arccos(np.clip((turned - 1) / 2, -1, 1))
        return np.append(0.0, angle)
    if label == "kick":
        return _highest_foot(places)
    if label == "squat":
        return np.asarray(-places[:, 0, 1], float)
    # Number of frames to the closer end of the run of frames of this class.
    after = np.zeros(len(inside))
    before = np.zeros(len(inside))
    for f in range(1, len(inside)):
        after[f] = after[f - 1] + 1 if inside[f] else 0
        before[-1 - f] = before[-f] + 1 if inside[-1 - f] else 0
    return np.minimum(after, before)


def _highest_foot(places: NDArray[np.float64]) -> NDArray[np.float64]:
    # Shins and feet: the four joints that are lowest on average.
    low = np.argsort(places[..., 1].mean(axis=0))[:4]
    return np.asarray(places[:, low, 1].max(axis=1))


def draw_clip(
    bones: VirtualBones,
    clip: Clip,
    answer: Answer,
    path: Path,
    *,
    frames: Any = 5,
    free: NDArray[np.bool_] | None = None,
) -> Path:
    """Draw truth, prediction and error of a clip, row by row, as a PNG.

    The error is coloured on the cloth alone, and the figures are RMSE over the cloth: of the clip
    in the head, of a frame in its column.

    Parameters
    ----------
    bones : VirtualBones
    clip : Clip
    answer : Answer
    path : Path
    frames : int or list of int
        How many, evenly spread, or which.
    free : (V,) bool array, optional
        Vertices that have a figure of their own; by default those that are not pinned.

    Raises
    ------
    InputError
        If `free` is no mask of the cloth.
    """
    fitted = bones.clip(clip.name)
    count = clip.n_frames
    if isinstance(frames, int):
        frames = spread_frames(frames, count)
    _draw(
        bones,
        _scene(bones, clip, fitted.read("low") + fitted.read("high")),
        _scene(bones, clip, answer.low + answer.high),
        clip.fps,
        path,
        title=clip.name,
        frames=frames,
        captions=[caption(t, clip.fps, clip.classes, "\n") for t in frames],
        free=free,
    )
    return path


def draw_moments(
    bones: VirtualBones,
    method: Callable[[Clip], Answer],
    names: Sequence[str],
    path: Path,
    *,
    free: NDArray[np.bool_] | None = None,
) -> list[tuple[str, str, int]]:
    """Draw the frames of :func:`moments` as the columns of one picture; returns them.

    The figures in the head are those of these frames.
    """
    hardest = moments(bones.store, names)
    truths, answers = [], []
    for _, name, frame in hardest:
        clip, fitted = bones.store.clip(name), bones.clip(name)
        answer = method(clip)
        at = slice(frame, frame + 1)
        truths.append(_scene(bones, clip, fitted.read("low", at) + fitted.read("high", at), at))
        answers.append(_scene(bones, clip, (answer.low + answer.high)[at], at))
    if hardest:
        _draw(
            bones,
            np.concatenate(truths),
            np.concatenate(answers),
            bones.store.fps,
            path,
            title=", ".join(label for label, _, _ in hardest),
            frames=list(range(len(hardest))),
            captions=[
                f"{label}\n{name}, {frame / bones.store.fps:.2f} s"
                for label, name, frame in hardest
            ],
            free=free,
        )
    return hardest


def _scene(bones: VirtualBones, clip: Clip, cloth: Array, at: slice = slice(None)) -> Array:
    both = np.concatenate([clip.body(at), cloth], axis=1)
    root = clip.outfit.skeleton.positions(clip.joints[at])[:, 0]
    return facing_the_camera(both, root, clip.joints[at])


def _draw(
    bones: VirtualBones,
    truth: Array,
    answer: Array,
    fps: float,
    path: Path,
    *,
    title: str,
    frames: list[int],
    captions: list[str],
    free: NDArray[np.bool_] | None,
) -> None:
    store = bones.store
    body, cloth = store.body.n_vertices, store.n_vertices
    faces = np.concatenate([store.body.faces, store.faces + body])
    sheet = contact_sheet(
        ssdr.MeshSequence(answer, faces, fps, name="prediction"),
        reference=ssdr.MeshSequence(truth, faces, fps, name="truth"),
        frames=frames,
        styles=["plain", "error"],
        title=title,
        parts=outfit_parts(body, cloth),
        regions=outfit_regions(body, cloth, free_vertices(store) if free is None else free),
        row_names=("truth", "prediction", "error"),
        captions=captions,
        unit=MILLIMETRES,
        azimuth=AZIMUTH,
    )
    write_picture(sheet, path)
