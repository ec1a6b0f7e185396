"""Body and cloth as one mesh of two colours, and what stands beside them in pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter1d

from ssdr import MeshSequence
from ssdr.errors import InputError
from ssdr.render import FABRIC, SKIN, Part, contact_sheet

from ..data.motion import CLASSES
from ..data.outfit import Outfit

__all__ = [
    "MILLIMETRES",
    "camera_track",
    "caption",
    "dressed",
    "facing_the_camera",
    "free_vertices",
    "outfit_parts",
    "outfit_regions",
    "outfit_sheet",
    "spread_frames",
]

MILLIMETRES = ("mm", 1000.0)
# Degrees beside the front of a body: both its front and the depth of a skirt are seen.
_AZIMUTH = 32.0
_SMOOTH = 0.25  # s, deviation of the Gaussian that smooths the path of the camera
_HORIZONTAL = np.array([1.0, 0.0, 1.0])
# Length of the heading, a unit vector seen from above, below which it says nothing.
_NO_HEADING = 1e-3


def dressed(
    body: Any, cloth: Any, body_faces: Any, cloth_faces: Any, fps: float, name: str = ""
) -> MeshSequence:
    """Body ``(F, V, 3)`` and cloth ``(F, V, 3)`` as one mesh, the body first."""
    both = np.concatenate([np.asarray(body), np.asarray(cloth)], axis=1).astype(np.float32)
    faces = np.concatenate([body_faces, np.asarray(cloth_faces) + np.asarray(body).shape[1]])
    return MeshSequence(both, faces, fps, name=name)


def outfit_parts(body: int, cloth: int) -> tuple[Part, Part]:
    """Body and cloth of a :func:`dressed` mesh, by their numbers of vertices.

    Errors are measured on the cloth alone.
    """
    return (
        Part("body", slice(0, body), SKIN, measured=False),
        Part("cloth", slice(body, body + cloth), FABRIC),
    )


def outfit_regions(body: int, cloth: int, free: ArrayLike | None) -> dict[str, NDArray[np.bool_]]:
    """Vertices of a :func:`dressed` mesh over which errors are stated.

    Parameters
    ----------
    body, cloth : int
        Numbers of vertices.
    free : (V,) bool array or None
        Vertices of the cloth that do not follow the body.

    Returns
    -------
    dict
        ``all`` of the cloth and, with a mask that leaves some out, ``free``.

    Raises
    ------
    InputError
        If `free` is no mask of the cloth, or empty.
    """
    regions = {"all": np.arange(body + cloth) >= body}
    if free is None:
        return regions
    mask = np.asarray(free)
    if mask.dtype != bool or mask.shape != (cloth,):
        raise InputError(
            "free", f"a mask of the cloth's {cloth} vertices", f"{mask.dtype} of {mask.shape}"
        )
    if not mask.any():
        raise InputError("free", "at least one vertex", "none")
    if not mask.all():
        regions["free"] = np.concatenate([np.zeros(body, bool), mask])
    return regions


def free_vertices(outfit: Outfit) -> NDArray[np.bool_] | None:
    """Vertices of a garment that are not pinned to the body; None if all are free."""
    return None if not outfit.pinned.any() else ~outfit.pinned


def camera_track(root: ArrayLike, fps: float) -> NDArray[np.float64]:
    """Path ``(F, 3)`` of a camera that walks along with a root: horizontal and smooth.

    Heights stay, so that jumps are seen.
    """
    path = np.asarray(root, dtype=np.float64) * _HORIZONTAL
    return np.asarray(gaussian_filter1d(path, _SMOOTH * fps, axis=0, mode="nearest"))


def facing_the_camera(vertices: Any, root: ArrayLike, joints: Any) -> NDArray[np.float32]:
    """Vertices ``(F, V, 3)``, every frame turned and moved on the floor to one heading and place.

    For pictures of single frames, which then show the front of every pose; errors stay the same.

    Parameters
    ----------
    vertices : (F, V, 3) array
    root : (F, 3) array
        Places of the root joint.
    joints : (F, J, 3, 4) array
        The first is the root.
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
    truth: ArrayLike | None,
    joints: Any,
    root: ArrayLike,
    *,
    frames: Sequence[int],
    captions: Sequence[str],
    title: str,
    free: ArrayLike | None = None,
) -> Image.Image:
    """A picture of some frames side by side, each seen from beside the body's front.

    Rows are truth, prediction and error, or the prediction alone.  The head has the RMSE of all
    frames over the cloth, a column that of its frame.

    Parameters
    ----------
    body, cloth : MeshSequence
        The cloth is the prediction.
    truth : (F, V, 3) array or None
        The simulated cloth.
    joints : (F, J, 3, 4) array
    root : (F, 3) array
        Places of the root joint.
    frames : sequence of int
    captions : sequence of str
        One for each of `frames`.
    title : str
    free : (V,) bool array, optional
        Vertices that have a figure of their own.

    Raises
    ------
    InputError
        If `free` is no mask of the cloth.
    """

    def facing(vertices: Any) -> MeshSequence:
        scene = dressed(body.vertices, vertices, body.faces, cloth.faces, cloth.fps)
        # Truth and prediction have one body, so one turn suits both.
        turned = facing_the_camera(scene.vertices, root, joints)
        return dataclasses.replace(scene, vertices=turned)

    sizes = body.n_vertices, cloth.n_vertices
    options: dict[str, Any] = {
        "frames": list(frames),
        "parts": outfit_parts(*sizes),
        "captions": list(captions),
        "title": title,
        "azimuth": _AZIMUTH,
    }
    if truth is None:
        return contact_sheet(facing(cloth.vertices), row_names=("prediction",), **options)
    return contact_sheet(
        facing(cloth.vertices),
        reference=facing(truth),
        styles=["plain", "error"],
        row_names=("truth", "prediction", "error"),
        regions=outfit_regions(*sizes, free),
        unit=MILLIMETRES,
        **options,
    )


def spread_frames(count: int, n_frames: int) -> list[int]:
    """At most `count` frames, evenly over a clip.

    Examples
    --------
    >>> spread_frames(3, 600)
    [100, 300, 500]
    """
    chosen = min(count, n_frames)
    return [int(t) for t in (np.arange(chosen) + 0.5) * n_frames / chosen]


def caption(
    frame: int,
    fps: float,
    classes: Sequence[int] | NDArray[np.integer] | None,
    between: str = "  ·  ",
) -> str:
    """Class of motion of a frame, if that is known, and its time.

    Examples
    --------
    >>> caption(45, 30.0, None), caption(1, 30.0, [0, 3])
    ('1.50 s', 'spin  ·  0.03 s')
    """
    time = f"{frame / fps:.2f} s"
    return time if classes is None else f"{CLASSES[int(classes[frame])]}{between}{time}"
