"""Predictions as meshes, skinned models, films and pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.common.errors import InputError
from ssdr.io.formats import FORMATS
from ssdr.io.outputs import check_file
from ssdr.model.rigid import nearest_rotation
from ssdr.show import Film, write_picture

from ..data.clip import Clip
from ..drawing.dressed import (
    MILLIMETRES,
    camera_track,
    caption,
    dressed,
    error_text,
    outfit_look,
    outfit_sheet,
)
from ..io.files import Progress, silent
from .prediction import Prediction

_ELEVATION = 12.0  # degrees of the camera above the horizon
_FILMS = (".gif", ".webp")
_PICTURES = (".png", ".jpg", ".jpeg")
_BONES = (".glb", ".gltf", ".fbx")
_PAGE = ".html"


def check_outputs(paths: Sequence[Path], inputs: Sequence[Path] = (), *, frames: int = 1) -> None:
    """Check that :func:`save_prediction` can write so many frames to files of these names.

    Raises
    ------
    InputError
        If a format is unknown, or a file cannot be made, is named twice or is one of `inputs`,
        which are read.
    MissingDependencyError
        If a format needs a package that is not installed.
    """
    meshes = [s for s, f in FORMATS.items() if f.writes_sequences] + list(_BONES)
    known, seen = sorted({*_FILMS, *_PICTURES, *meshes, _PAGE}), list(inputs)
    for file in paths:
        suffix = file.suffix.lower()
        if suffix not in known:
            raise InputError("output", f"a suffix of {', '.join(known)}", str(file))
        if frames > 1 and "%" not in file.name and FORMATS.get(suffix) is FORMATS[".obj"]:
            raise InputError("output", "a number such as %04d, for a file a frame", str(file))
        if suffix in meshes:
            ssdr.io.check_outputs([file], inputs=seen)
        else:
            check_file(file, "output", others=seen)
        seen.append(file)


def save_prediction(
    prediction: Prediction,
    path: Path | str,
    *,
    size: int = 640,
    truth: Clip | None = None,
    every: int = 1,
    progress: Progress = silent,
) -> str:
    """Write a prediction in the format of the suffix.

    ``.gif`` and ``.webp`` are films and ``.png`` and ``.jpg`` sheets of pictures, with
    the body and, where it is known, the truth beside the prediction; ``.glb``, ``.gltf`` and
    ``.fbx`` hold the joints and virtual bones, without the detail and the push-out; ``.html`` is a
    page of the cloth beside the truth or, where it is not known, of the virtual bones beside the
    cloth; all other formats hold the vertices.

    Parameters
    ----------
    prediction : Prediction
    path : path
    size : int
        Height of a panel of a film, pixels; without the truth its width too.
    truth : Clip, optional
        The simulated clip of the same motion: films show it beside the prediction, sheets with
        the error, and the RMSE over the cloth is stated.
    every : int
        Step between the frames that a film shows; its speed does not change.
    progress : callable, optional
        Called with the fraction of a film that is drawn.

    Returns
    -------
    str
        Text for the user that says what was written.

    Raises
    ------
    InputError
        If the clip has other numbers of frames or vertices than the prediction.
    OSError
        If the file cannot be written.
    """
    file = Path(path)
    p = prediction
    if truth is not None:
        expected, found = p.cloth.vertices.shape[:2], (truth.n_frames, truth.outfit.n_vertices)
        if expected != found:
            text = "a clip of {} frames and {} vertices".format
            raise InputError("truth", text(*expected), text(*found))
    suffix = file.suffix.lower()
    if suffix in _FILMS:
        film = _film(p, truth, size, every)
        film.write(file, lambda done: progress("drawing", done))
        beside = " of truth and prediction" if truth is not None else ""
        return f"a film{beside}, {len(film.panels.frames)} frames"
    if suffix in _PICTURES:
        sheet = outfit_sheet(p.body, p.cloth, p.joints, p.root, truth=truth)
        write_picture(sheet, file)
        return "pictures of some frames"
    if suffix == _PAGE:
        return _write_page(p, file, truth)
    if suffix in _BONES:
        return _save_bones(p, file)
    report = ssdr.save(p.cloth, file)
    return ": ".join([f"{p.cloth.n_frames} frames of vertices", *report.notes])


def _write_page(p: Prediction, file: Path, truth: Clip | None) -> str:
    beside = "the simulation" if truth is not None else "the prediction with all its detail"
    page = ssdr.view(
        p.skinning if truth is None else p.cloth,
        p.cloth if truth is None else truth.sequence,
        file,
        title=f"{p.cloth.name}: {'virtual bones' if truth is None else 'prediction'}",
        reference_name=beside,
    )
    shown = "the virtual bones" if truth is None else "the prediction"
    notes = "".join(f"; {note}" for note in page.notes)
    return f"a page of {shown} beside {beside}, {page.frames} frames{notes}"


def _film(p: Prediction, truth: Clip | None, size: int, every: int) -> Film:
    """Film of a prediction, in which the camera follows the body but does not turn with it."""

    path = camera_track(p.root, p.cloth.fps)[:, None]

    def scene(cloth: Any) -> MeshSequence:
        both = p.body.vertices - path, cloth - path
        return dressed(*both, p.body.faces, p.cloth.faces, p.cloth.fps, p.cloth.name)

    side = size - size % 2
    every *= Film.step(p.cloth.fps / every)
    order = range(0, p.cloth.n_frames, every)
    options: dict[str, Any] = {
        **outfit_look(p.body.n_vertices, p.cloth.n_vertices),
        "frames": order,
        "fps": p.cloth.fps / every,
        "elevation": _ELEVATION,
    }
    width = side
    if truth is not None:
        width = size * 3 // 4 // 2 * 2  # someone who stands is narrow
        true = truth.sequence.frames(slice(None))
        captions = []
        for t in order:
            figures = error_text(true[t : t + 1], p.cloth.vertices[t : t + 1], truth.outfit)
            captions.append(f"{caption(t, p.cloth.fps, truth.classes)}  ·  RMSE {figures}")
        options |= {"reference": scene(true), "captions": captions, "unit": MILLIMETRES}
        options["titles"] = "truth", "prediction"
    return Film.of(scene(p.cloth.vertices), size=(width, side), **options)


def _save_bones(p: Prediction, file: Path) -> str:
    truth, model = np.asarray(p.cloth.vertices, np.float64), rigid(p.skinning)
    report = ssdr.save(model, file)
    return (
        f"{model.n_bones} joints, {model.n_frames} frames, {report.bytes / 1e6:.1f} MB; "
        f"RMSE to the prediction {1e3 * ssdr.metrics.distances(truth, model).rmse:.2f} mm"
    )


def rigid(skinning: Skinning) -> Skinning:
    """Copy with rigid bones, for engines; an ensemble blends rotations into affine transforms.

    Such a transform is replaced by the closest rotation about the centroid of the vertices that the
    bone moves.
    """
    if skinning.bone_model == "rigid":
        return skinning
    m = np.asarray(skinning.transforms, np.float64)
    centres = skinning.centroids()
    r = nearest_rotation(m[..., :3])
    place = np.einsum("fbij,bj->fbi", m[..., :3] - r, centres) + m[..., 3]
    return dataclasses.replace(
        skinning, transforms=np.concatenate([r, place[..., None]], axis=-1), bone_model="rigid"
    )
