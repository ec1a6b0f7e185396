"""Predictions as meshes, skinned models, films and pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.errors import InputError
from ssdr.io.atomic import atomic_path
from ssdr.io.registry import FORMATS
from ssdr.render import Part, contact_sheet, write_picture
from ssdr.render.film import Film
from ssdr.rigid import nearest_rotation

from ..data.clip import Clip
from ..drawing.dressed import (
    AZIMUTH,
    MILLIMETRES,
    camera_track,
    caption,
    dressed,
    facing_the_camera,
    free_vertices,
    outfit_parts,
    outfit_regions,
    spread_frames,
)
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
        from ssdr.io.blender.finder import command

        command("")


def save_prediction(
    prediction: Prediction,
    path: Path | str,
    *,
    size: int = 640,
    frames: int = 5,
    truth: Clip | None = None,
    free: NDArray[np.bool_] | None = None,
    error: bool = False,
    every: int = 1,
    progress: Callable[[float], None] | None = None,
) -> str:
    """Write a prediction in the format of the suffix.

    ``.mp4``, ``.gif`` and ``.webp`` are films and ``.png`` and ``.jpg`` sheets of pictures, with
    the body and, where it is known, the truth beside the prediction; ``.glb``, ``.gltf`` and
    ``.fbx`` hold the virtual bones, without the high-frequency part; all other formats hold the
    vertices.

    Parameters
    ----------
    prediction : Prediction
    path : path
    size : int
        Height of a panel of a film, pixels; without the truth its width too.
    frames : int
        Number of frames in a sheet.
    truth : Clip, optional
        The simulated clip of the same motion: films show it beside the prediction, sheets with
        the error, and the RMSE over the cloth is stated.
    free : (V,) bool array, optional
        Vertices that have a figure of their own; by default those of the clip's garment that are
        not pinned.
    error : bool
        Whether a film with the truth has the error as a third panel.
    every : int
        A film shows every frame, every second and so on; its speed stays.
    progress : callable, optional
        Called with the fraction of a film that is drawn.

    Returns
    -------
    str
        What was written, for the user.

    Raises
    ------
    InputError
        If the clip is not of the prediction's frames and vertices, `free` is no mask of them, or
        `every` is below 1.
    SsdrError
        If the file cannot be written.
    """
    file = Path(path)
    shown = Picture.of(prediction, truth, free)
    if every < 1:
        raise InputError("every", "1 or more", every)
    suffix = file.suffix.lower()
    with writing(file):
        if suffix in _FILMS:
            film = shown.film(size, error, every)
            if suffix == ".mp4":
                _write_mp4(film, file, progress)
            else:
                film.write(file, progress)
            beside = " of truth and prediction" if truth is not None else ""
            return f"a film{beside}, {len(film.order)} frames"
        if suffix in _PICTURES:
            write_picture(shown.sheet(frames), file)
            return f"{frames} frames"
        return _save(prediction, file)


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """What films and sheets show of a prediction."""

    prediction: Prediction
    truth: Clip | None
    regions: dict[str, NDArray[np.bool_]]

    @classmethod
    def of(
        cls, prediction: Prediction, truth: Clip | None, free: NDArray[np.bool_] | None
    ) -> Picture:
        """Check that the parts fit together."""
        body, cloth = prediction.body.n_vertices, prediction.cloth.n_vertices
        if truth is not None:
            expected = prediction.cloth.n_frames, cloth
            found = truth.n_frames, truth.outfit.n_vertices
            if expected != found:
                text = "a clip of {} frames and {} vertices".format
                raise InputError("truth", text(*expected), text(*found))
            free = free_vertices(truth.outfit) if free is None else free
        return cls(prediction, truth, outfit_regions(body, cloth, free))

    def film(self, size: int, error: bool, every: int) -> Film:
        """The camera walks along; the body turns before it."""
        p = self.prediction
        side = size - size % 2
        order = range(0, p.cloth.n_frames, every)
        options: dict[str, Any] = {
            "parts": self.parts,
            "track": camera_track(p.root, p.cloth.fps),
            "frames": order,
            "fps": p.cloth.fps / every,
            "elevation": _ELEVATION,
        }
        if self.truth is None:
            return Film.of(self._dressed(p.cloth.vertices), size=(side, side), **options)
        # Someone who stands is narrow.
        width = size * 3 // 4
        return Film.of(
            self._dressed(p.cloth.vertices),
            reference=self._dressed(self.truth.sequence.frames(slice(None))),
            style=["plain", "error"] if error else ["plain"],
            size=(width - width % 2, side),
            titles=("truth", "prediction", "error")[: 3 if error else 2],
            captions=[caption(t, p.cloth.fps, self.truth.classes) for t in order],
            regions=self.regions,
            unit=MILLIMETRES,
            **options,
        )

    def sheet(self, frames: int) -> Image.Image:
        """Frames evenly over the clip, each seen from beside the body's front."""
        p = self.prediction
        chosen = spread_frames(frames, p.cloth.n_frames)
        classes = None if self.truth is None else self.truth.classes
        options: dict[str, Any] = {
            "frames": chosen,
            "parts": self.parts,
            "captions": [caption(t, p.cloth.fps, classes, "\n") for t in chosen],
            "title": p.cloth.name,
            "azimuth": AZIMUTH,
        }
        subject = self._facing(p.cloth.vertices)
        if self.truth is None:
            return contact_sheet(subject, row_names=("prediction",), **options)
        return contact_sheet(
            subject,
            reference=self._facing(self.truth.sequence.frames(slice(None))),
            row_names=("truth", "prediction", "error"),
            regions=self.regions,
            unit=MILLIMETRES,
            **options,
        )

    @property
    def parts(self) -> tuple[Part, Part]:
        """Body and cloth."""
        return outfit_parts(self.prediction.body.n_vertices, self.prediction.cloth.n_vertices)

    def _dressed(self, cloth: Any) -> MeshSequence:
        p = self.prediction
        faces = p.body.faces, p.cloth.faces
        return dressed(p.body.vertices, np.asarray(cloth), *faces, p.cloth.fps, p.cloth.name)

    def _facing(self, cloth: Any) -> MeshSequence:
        p, scene = self.prediction, self._dressed(cloth)
        # Truth and prediction have one body, so one turn suits both.
        vertices = facing_the_camera(scene.vertices, p.root, p.joints)
        return dataclasses.replace(scene, vertices=vertices)


def _save(prediction: Prediction, file: Path) -> str:
    if file.suffix.lower() in _BONES:
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


def _write_mp4(film: Film, path: Path, progress: Callable[[float], None] | None) -> None:
    av = require("av", "garmentnet", "an .mp4 file")
    width, height = film.size
    with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as file:
        codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        stream = file.add_stream(codec, rate=Fraction(film.fps).limit_denominator(1001))
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p"
        if codec == "libx264":
            stream.options = {"crf": "20", "preset": "slow"}
        for picture in film.pictures(progress):
            for packet in stream.encode(av.VideoFrame.from_image(picture)):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)
