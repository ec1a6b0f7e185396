"""Predictions as meshes, skinned models, films and pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.errors import InputError
from ssdr.io.atomic import atomic_path
from ssdr.io.registry import FORMATS
from ssdr.rigid import nearest_rotation

from ..io.files import writing
from ..io.packages import require
from .prediction import Prediction

__all__ = ["check_output", "save_prediction"]

_ELEVATION = 12.0  # degrees of the camera above the horizon
_FILMS = (".mp4", ".gif", ".webp")
_PICTURES = (".png", ".jpg", ".jpeg")
_BONES = (".glb", ".gltf", ".fbx")


def check_output(path: Path | str) -> None:
    """Check that :func:`save_prediction` can write a file of this name.

    Raises
    ------
    InputError
        If there is no such folder or format.
    MissingDependencyError
        If the format needs a package that is not installed.
    """
    file = Path(path)
    if not file.parent.is_dir():
        raise InputError("output", "a file in a folder that exists", str(file))
    suffix = file.suffix.lower()
    meshes = [s for s, f in FORMATS.items() if f.write_sequence] + list(_BONES)
    known = sorted({*_FILMS, *_PICTURES, *meshes})
    if suffix not in known:
        raise InputError("output", f"a suffix of {', '.join(known)}", str(file))
    if suffix == ".mp4":
        require("av", "garmentnet", "an .mp4 file")
    if suffix.startswith(".usd"):
        require("pxr", "ssdr[usd]", f"a {suffix} file")
    if suffix == ".fbx":
        from ssdr.io.blender import command

        command("")


def save_prediction(
    prediction: Prediction,
    path: Path | str,
    *,
    size: int = 640,
    frames: int = 5,
    progress: Callable[[float], None] | None = None,
) -> str:
    """Write a prediction in the format of the suffix.

    ``.mp4``, ``.gif`` and ``.webp`` are films and ``.png`` and ``.jpg`` sheets of pictures, with
    the body; ``.glb``, ``.gltf`` and ``.fbx`` hold the virtual bones, without the high-frequency
    part; all other formats hold the vertices.

    Parameters
    ----------
    prediction : Prediction
    path : path
    size : int
        Width and height of a film, pixels.
    frames : int
        Number of pictures in a sheet.
    progress : callable, optional
        Called with the fraction of a film that is drawn.

    Returns
    -------
    str
        What was written, for the user.

    Raises
    ------
    SsdrError
        If the file cannot be written.
    """
    file = Path(path)
    with writing(file):
        return _save(prediction, file, size, frames, progress)


def _save(
    prediction: Prediction,
    file: Path,
    size: int,
    frames: int,
    progress: Callable[[float], None] | None,
) -> str:
    from ssdr.render import animate, contact_sheet, write_picture

    suffix = file.suffix.lower()
    if suffix in _FILMS:
        scene = prediction.scene()
        if suffix == ".mp4":
            _write_mp4(scene, file, size, progress)
        else:
            animate(scene, file, size=(size, size), callback=progress)
        return f"a film of {scene.n_frames} frames"
    if suffix in _PICTURES:
        write_picture(contact_sheet(prediction.scene(), frames=frames), file)
        return f"{frames} frames"
    if suffix in _BONES:
        ssdr.save(_rigid(prediction.skinning), file)
        gap = prediction.cloth.vertices - prediction.skinning.skin(dtype=np.float32)
        rms = 1e3 * float(np.sqrt((gap.astype(np.float64) ** 2).sum(-1).mean()))
        return f"the virtual bones alone; {rms:.2f} mm of the prediction are not in it"
    report = ssdr.save(prediction.cloth, file)
    return (
        f"{prediction.cloth.n_frames} frames of vertices{': ' + report.note if report.note else ''}"
    )


def _rigid(skinning: Skinning) -> Skinning:
    # An ensemble mixes rotations to affine transforms, which engines cannot play.  They are
    # replaced by the closest rotations about the centroids of the vertices that each bone moves.
    if skinning.bone_model == "rigid":
        return skinning
    m = np.asarray(skinning.transforms, np.float64)
    centres = skinning.centroids()
    r = nearest_rotation(m[..., :3])
    place = np.einsum("fbij,bj->fbi", m[..., :3] - r, centres) + m[..., 3]
    return dataclasses.replace(
        skinning, transforms=np.concatenate([r, place[..., None]], axis=-1), bone_model="rigid"
    )


def _write_mp4(
    scene: MeshSequence, path: Path, size: int, progress: Callable[[float], None] | None
) -> None:
    from ssdr.render.scene import Scene, View, draw_panel

    av = require("av", "garmentnet", "an .mp4 file")
    side = size - size % 2
    shown = Scene.of(scene, None)
    view = View.of(
        shown, list(range(scene.n_frames)), (side, side), None, "y", None, _ELEVATION, True
    )
    with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as file:
        codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        stream = file.add_stream(codec, rate=round(scene.fps))
        stream.width = stream.height = side
        stream.pix_fmt = "yuv420p"
        for t in range(scene.n_frames):
            picture = draw_panel(shown, view, t, "plain", (side, side), 1.0, 2)
            for packet in stream.encode(av.VideoFrame.from_image(picture)):
                file.mux(packet)
            if progress:
                progress((t + 1) / scene.n_frames)
        for packet in stream.encode():
            file.mux(packet)
