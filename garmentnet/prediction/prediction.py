"""A checkpoint's answer to a motion, and files and pictures of it."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ssdr
from ssdr import MeshSequence, Skinning
from ssdr.errors import FormatError, InputError, SsdrWarning
from ssdr.io.atomic import atomic_path
from ssdr.io.registry import FORMATS, reading, require

from ..data.parameters import RANGES, SimulationParameters
from ..io.files import writing
from ..networks.checkpoint import Checkpoint
from ..networks.features import check_joints

__all__ = [
    "Prediction",
    "check_output",
    "follow",
    "predict",
    "read_joints",
    "save_prediction",
    "trained_range",
]

_FILMS = (".mp4", ".gif", ".webp")
_PICTURES = (".png", ".jpg", ".jpeg")
_BONES = (".glb", ".gltf", ".fbx")


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """A predicted garment on its body.

    Attributes
    ----------
    cloth, body : MeshSequence
    skinning : Skinning
        The low-frequency part: virtual bones with their transforms in the world.
    joints : (F, J, 3, 4) array
    root : (F, 3) array
        Positions of the root joint.
    extrapolated : tuple of str
        What lies outside the range that was trained, in words; empty: nothing.
    """

    cloth: MeshSequence
    body: MeshSequence
    skinning: Skinning
    joints: NDArray[np.float64]
    root: NDArray[np.float64]
    extrapolated: tuple[str, ...]

    def scene(self, *, still: bool = True) -> MeshSequence:
        """Cloth and body as one mesh; `still`: the camera walks along."""
        where = self.root if still else None
        return follow(self.cloth.vertices, self.body.vertices, self.cloth.faces,
                      self.body.faces, self.cloth.fps, where, self.cloth.name)  # fmt: skip


def predict(
    checkpoint: Checkpoint,
    joints: Any,
    parameters: SimulationParameters | None = None,
    *,
    detail: bool = True,
    name: str = "prediction",
) -> Prediction:
    """The garment that a checkpoint predicts for a motion of its body.

    Parameters
    ----------
    checkpoint : Checkpoint
    joints : (F, J, 3, 4) array
        World transforms from the body's rest pose, at the checkpoint's frame rate.
    parameters : SimulationParameters, optional
        Needed by an ensemble and a network that reads them; a single network
        knows its own only.
    detail : bool
        Whether to run the high-frequency module.

    Raises
    ------
    InputError
        If the joints are not usable, or the parameters are missing or not those
        of a single network.

    Warns
    -----
    SsdrWarning
        If the parameters lie outside the trained range: the answer is an
        extrapolation.
    """
    several = checkpoint.kernel is not None or checkpoint.networks[0].condition
    own = checkpoint.parameters[0]
    if not several and parameters is not None and own is not None and parameters != own:
        raise InputError(
            "parameters", f"those of this single network, {own} (an ensemble takes any)", parameters
        )
    beyond: tuple[str, ...] = ()
    if several and parameters is not None:
        beyond = _beyond(checkpoint, parameters)
        if beyond:
            text = "; ".join(beyond)
            warnings.warn(f"extrapolated: {text}", SsdrWarning, stacklevel=2)
    motions = checkpoint.motions(joints, parameters, detail=detail)
    subject, m = checkpoint.subject, np.asarray(joints, np.float64)
    garment, rig = subject.garment, subject.body
    cloth = np.concatenate([part.vertices() for part in motions])
    moved = np.concatenate([part.world_transforms() for part in motions])
    body = np.asarray(ssdr.skin(rig.rest, rig.joints, rig.weights, m), np.float32)
    return Prediction(
        cloth=MeshSequence(cloth, garment.faces, subject.fps, name=name),
        body=MeshSequence(body, rig.faces, subject.fps, name="body"),
        skinning=Skinning(
            garment.rest, garment.joints, garment.weights, moved, faces=garment.faces,
            fps=subject.fps, bone_model="affine" if several else "rigid", name=name,
        ),
        joints=m,
        root=subject.skeleton.positions(m)[:, 0],
        extrapolated=beyond,
    )  # fmt: skip


def trained_range(checkpoint: Checkpoint) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of every parameter among the pivots; empty without any."""
    known = [dataclasses.asdict(p) for p in checkpoint.parameters if p is not None]
    if not known:
        return {}
    return {k: (min(p[k] for p in known), max(p[k] for p in known)) for k in known[0]}


def _beyond(checkpoint: Checkpoint, parameters: SimulationParameters) -> tuple[str, ...]:
    limits = trained_range(checkpoint)
    found = []
    if not limits:  # a network that reads them does not know its sets: what they are meant for
        for key in parameters.outside():
            low, high = RANGES[key]
            found.append(f"{key} {getattr(parameters, key):g}, meant for {low:g} to {high:g}")
        return tuple(found)
    for key, value in dataclasses.asdict(parameters).items():
        low, high = limits[key]
        if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
            found.append(f"{key} {value:g}, trained from {low:g} to {high:g}")
    return tuple(found)


def read_joints(path: Path | str, checkpoint: Checkpoint) -> NDArray[np.float64]:
    """Joint transforms of a motion file for a checkpoint's body, at its frame rate.

    Parameters
    ----------
    path : path
        ``.bvh`` or ``.bvh.gz``, retargeted by the names of its joints; ``.npz`` with an array
        ``joints`` ``(F, J, 3, 4)``; or the folder of a clip in a store.

    Raises
    ------
    InputError
        If there is no such file.
    FormatError
        If it is damaged, of an unknown kind or of another body.
    """
    file, subject = Path(path), checkpoint.subject
    suffix = file.suffix.lower()
    if not file.exists():
        raise InputError("motion", "a .bvh, a .npz or a clip", str(file))
    if file.name.lower().endswith((".bvh", ".bvh.gz")):
        from ..data.bvh import read_bvh, retarget

        moved = retarget(read_bvh(file), subject.skeleton, fps=subject.fps, name=file.stem)
        return np.asarray(moved.joints, np.float64)
    if file.is_dir() and file.parent.name == "clips":
        from ..data.store import ClipStore

        store = ClipStore.open(file.parent.parent)
        checkpoint.check_fits(store)
        return np.asarray(store.clip(file.name).joints, np.float64)
    if suffix != ".npz":
        raise FormatError(f"{file}: a motion is a .bvh, a .npz with joints, or a clip of a store")
    # Opened here: np.load leaves a file open where it is no archive.
    with reading(file), file.open("rb") as raw, np.load(raw, allow_pickle=False) as archive:
        if "joints" not in archive:
            raise FormatError(f"no array joints; it holds {archive.files}")
        joints = np.asarray(archive["joints"], np.float64)
        wanted = subject.skeleton.n_joints
        if joints.ndim != 4 or joints.shape[1:] != (wanted, 3, 4):
            raise FormatError(f"joints: expected (F, {wanted}, 3, 4), got {joints.shape}")
        return check_joints(joints, wanted)


def check_output(path: Path | str) -> None:
    """Raise unless :func:`save_prediction` can write a file of this name.

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
        require("pxr", "usd", f"a {suffix} file")
    if suffix == ".fbx":
        require("bpy", "blender", "an .fbx file")


def save_prediction(
    prediction: Prediction,
    path: Path | str,
    *,
    size: int = 640,
    frames: int = 5,
    progress: Callable[[float], None] | None = None,
) -> str:
    """Write a prediction as the suffix says; a sentence about what was written.

    ``.mp4``, ``.gif`` and ``.webp`` are films and ``.png`` a sheet of pictures,
    with the body; ``.glb`` and ``.fbx`` hold the virtual bones, without the
    high-frequency part; all other formats hold the vertices.

    Parameters
    ----------
    prediction : Prediction
    path : path
    size : int
        Pixels, of a film's side.
    frames : int
        Of a sheet.
    progress : callable, optional
        Told the share of a film that is drawn.
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


def follow(
    cloth: Any,
    body: Any,
    cloth_faces: Any,
    body_faces: Any,
    fps: float,
    root: NDArray[np.floating] | None,
    name: str = "",
) -> MeshSequence:
    """Cloth and body as one mesh, seen from a camera that walks along with the root."""
    both = np.concatenate([np.asarray(body), np.asarray(cloth)], axis=1).astype(np.float64)
    if root is not None:
        # Jumps stay visible: the camera does not follow upwards.
        both = both - np.asarray(root)[:, None] * np.array([1.0, 0.0, 1.0])
    faces = np.concatenate([body_faces, np.asarray(cloth_faces) + np.asarray(body).shape[1]])
    return MeshSequence(both.astype(np.float32), faces, fps, name=name)


def _rigid(skinning: Skinning) -> Skinning:
    # Mixed pivots blend rotations, which engines cannot: the closest rotations about
    # the centres of what the bones move.
    if skinning.bone_model == "rigid":
        return skinning
    m = np.asarray(skinning.transforms, np.float64)
    centres = skinning.centroids()
    u, _, vt = np.linalg.svd(m[..., :3])
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    r = u @ vt
    place = np.einsum("fbij,bj->fbi", m[..., :3] - r, centres) + m[..., 3]
    return dataclasses.replace(
        skinning, transforms=np.concatenate([r, place[..., None]], axis=-1), bone_model="rigid"
    )


def _write_mp4(
    scene: MeshSequence, path: Path, size: int, progress: Callable[[float], None] | None
) -> None:
    from ssdr.scene import Scene, View, draw_panel

    av = require("av", "garmentnet", "an .mp4 file")
    side = size - size % 2
    shown = Scene.of(scene, None)
    view = View.of(shown, list(range(scene.n_frames)), (side, side), None, "y", None, 12.0, True)
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
