"""Body and cloth as one mesh of two colours, and pictures, camera paths and captions of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter1d

from ssdr import MeshSequence
from ssdr.metrics import rmse
from ssdr.show import FABRIC, SKIN, contact_sheet, write_picture

from ..data.clip import CLASSES, Clip
from ..data.outfit import Outfit

MILLIMETRES = ("mm", 1000.0)
_SHOWN = 5  # frames of a sheet
# Azimuth of the camera from the front, degrees: shows both the front and the depth of a skirt.
_AZIMUTH = 32.0
_SMOOTH = 0.25  # s, deviation of the Gaussian that smooths the path of the camera
_HORIZONTAL = np.array([1.0, 0.0, 1.0])
# Horizontal length of the unit vector to the front below which the heading is not determined.
_NO_HEADING = 1e-3


def dressed(
    body: Any, cloth: Any, body_faces: Any, cloth_faces: Any, fps: float, name: str = ""
) -> MeshSequence:
    """Body ``(F, V, 3)`` and cloth ``(F, V, 3)`` as one mesh, the body first."""
    both = np.concatenate([np.asarray(body), np.asarray(cloth)], axis=1).astype(np.float32)
    faces = np.concatenate([body_faces, np.asarray(cloth_faces) + np.asarray(body).shape[1]])
    return MeshSequence(both, faces, fps, name=name)


def outfit_look(body: int, cloth: int) -> dict[str, Any]:
    """Colours of a :func:`dressed` mesh, by the numbers of vertices of body and cloth.

    Errors are measured on the cloth alone.
    """
    on_cloth = np.arange(body + cloth) >= body
    return {"colors": np.where(on_cloth[:, None], FABRIC, SKIN), "measured": on_cloth}


def error_text(truth: Any, prediction: Any, outfit: Outfit) -> str:
    """RMSE in mm of a cloth ``(F, V, 3)``: of all vertices and, if some are pinned, of the free."""
    sets = {"all": np.ones_like(outfit.pinned)}
    if outfit.pinned.any() and not outfit.pinned.all():
        sets["free"] = ~outfit.pinned
    name, factor = MILLIMETRES
    found = {key: factor * rmse(truth[:, one], prediction[:, one]) for key, one in sets.items()}
    return ", ".join(f"{key} {value:#.3g}".rstrip(".") + f" {name}" for key, value in found.items())


def camera_track(root: ArrayLike, fps: float) -> NDArray[np.float64]:
    """Smooth horizontal path ``(F, 3)`` of a camera that follows a root.

    Its height does not change, so that jumps are seen.
    """
    path = np.asarray(root, dtype=np.float64) * _HORIZONTAL
    return np.asarray(gaussian_filter1d(path, _SMOOTH * fps, axis=0, mode="nearest"))


def facing_the_camera(vertices: Any, root: ArrayLike, joints: Any) -> NDArray[np.float32]:
    """Vertices ``(F, V, 3)``, moved and turned on the floor to the same place and heading.

    Pictures of single frames then show the front of every pose.  Errors do not change.

    Parameters
    ----------
    vertices : (F, V, 3) array
    root : (F, 3) array
        Positions of the root joint.
    joints : (F, J, 3, 4) array
        World transforms of the joints, of which the first is the root.
    """
    m = np.asarray(joints, dtype=np.float64)
    forward = m[:, 0, :, 2]
    length = np.hypot(forward[:, 0], forward[:, 2])
    # A body that looks straight up has no heading.
    sine, cosine = np.where(
        length > _NO_HEADING, [forward[:, 0], forward[:, 2]] / np.maximum(length, 1e-30), [[0], [1]]
    )
    local = np.asarray(vertices, np.float64) - np.asarray(root)[:, None] * _HORIZONTAL
    x, y, z = np.moveaxis(local, -1, 0)
    turned = [cosine[:, None] * x - sine[:, None] * z, y, sine[:, None] * x + cosine[:, None] * z]
    return np.stack(turned, axis=-1).astype(np.float32)


def outfit_sheet(
    body: MeshSequence,
    cloth: MeshSequence,
    joints: Any,
    root: ArrayLike,
    *,
    truth: Clip | None = None,
) -> Image.Image:
    """Picture of some frames side by side, each seen from a little beside the body's front.

    Rows are truth, prediction and error, or the prediction alone.  The header states the RMSE of
    the cloth over all frames, each picture of the error that of its frame.

    Parameters
    ----------
    body, cloth : MeshSequence
        Body and predicted cloth; the name of the cloth is the title.
    joints : (F, J, 3, 4) array
    root : (F, 3) array
        Positions of the root joint.
    truth : Clip, optional
        The simulated clip of the same motion.
    """

    def facing(vertices: Any) -> MeshSequence:
        scene = dressed(body.vertices, vertices, body.faces, cloth.faces, cloth.fps)
        # Truth and prediction have one body, so one turn suits both.
        turned = facing_the_camera(scene.vertices, root, joints)
        return dataclasses.replace(scene, vertices=turned)

    chosen = spread_frames(_SHOWN, cloth.n_frames)
    classes = None if truth is None else truth.classes
    options: dict[str, Any] = {
        "frames": chosen,
        **outfit_look(body.n_vertices, cloth.n_vertices),
        "captions": [caption(t, cloth.fps, classes) for t in chosen],
        "title": cloth.name,
        "azimuth": _AZIMUTH,
    }
    if truth is None:
        return contact_sheet(facing(cloth.vertices), row_names=("prediction",), **options)
    simulated = truth.sequence.frames(slice(None))
    figures = error_text(simulated, cloth.vertices, truth.outfit)
    return contact_sheet(
        facing(cloth.vertices),
        reference=facing(simulated),
        subtitle=f"{cloth.n_vertices:,} vertices  ·  {cloth.n_frames:,} frames  ·  RMSE: {figures}",
        styles=["plain", "error"],
        row_names=("truth", "prediction", "error"),
        unit=MILLIMETRES,
        **options,
    )


def draw_clip(clip: Clip, prediction: NDArray[np.float32], path: Path) -> Path:
    """Draw truth, prediction ``(F, V, 3)`` and error of a clip, row by row, as a PNG.

    The error is coloured on the cloth alone, and the figures are RMSE over the cloth: of the clip
    in the head, of a frame in its column.
    """
    outfit = clip.outfit
    sheet = outfit_sheet(
        MeshSequence(clip.body(), outfit.body.faces, clip.fps),
        MeshSequence(prediction, outfit.faces, clip.fps, name=clip.name),
        clip.joints,
        outfit.skeleton.positions(clip.joints)[:, 0],
        truth=clip,
    )
    write_picture(sheet, path)
    return path


def spread_frames(count: int, n_frames: int) -> list[int]:
    """Indices of at most `count` frames, spread evenly over a clip.

    Examples
    --------
    >>> spread_frames(3, 600)
    [100, 300, 500]
    """
    chosen = min(count, n_frames)
    return [int(t) for t in (np.arange(chosen) + 0.5) * n_frames / chosen]


def caption(
    frame: int, fps: float, classes: Sequence[int] | NDArray[np.integer] | None = None
) -> str:
    """Caption of a frame: its class of motion, if known, and its time.

    Examples
    --------
    >>> caption(45, 30.0), caption(1, 30.0, [0, 3])
    ('1.50 s', 'spin  ·  0.03 s')
    """
    time = f"{frame / fps:.2f} s"
    return time if classes is None else f"{CLASSES[int(classes[frame])]}  ·  {time}"
