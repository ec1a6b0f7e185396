"""A trained garment, its body and some motions as one HTML file: the browser predicts.

``python docs/gallery/live/page.py dress MOTION... -o page.html`` writes a page that asks for
nothing; without a motion it has the one that ships.  Motions are files as for ``garmentnet
predict``.  The page holds networks, poses and push-out, and of a clip of a store its simulation; it
computes what the network computes in torch, with the skinning on the graphics card.
"""

from __future__ import annotations

import argparse
import base64
import dataclasses
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from garmentnet.collision.outward import push_of
from garmentnet.data.parameters import RANGES, SimulationParameters
from garmentnet.data.skeleton import check_joints
from garmentnet.io.tensors import SHIPPED
from garmentnet.networks.checkpoint import Checkpoint, load_checkpoint
from garmentnet.networks.detail_basis import DetailBasis
from garmentnet.networks.gru import GRULinear
from garmentnet.prediction.motion_file import read_motion
from garmentnet.prediction.prediction import check_set, chosen_parameters
from ssdr import Skinning
from ssdr.common.errors import InputError
from ssdr.io.atomic import write_bytes
from ssdr.mesh.surface import Material, Surface
from ssdr.model.bone_ends import limb_ends
from ssdr.show import FABRIC, SKIN
from ssdr.show.page.blocks import (
    Blocks,
    difference_entry,
    heat_scales,
    surface_entries,
    weight_entries,
)
from ssdr.show.page.motion import Outermost
from ssdr.show.page.page import PARTS, WEB, assembled
from ssdr.show.palette import bone_colors, srgb_from_linear

_WEB = Path(__file__).parent
_SCRIPTS = tuple(_WEB / f"{name}.js" for name in ("network", "garment", "dress", "main"))
_STYLES = (WEB / "page.css", _WEB / "page.css")
_MARGIN = 0.1  # distance of the skin from the joints, about, in metres
# Metres.  The page pushes out recorded motions alone, by displacements computed beforehand; of
# others it hides skin that is so little above the cloth.
_BEHIND = 0.03
_STEP = 2.5e-4  # step to which the truth is rounded, metres; coarser if 16 bits need it
_SMOOTH = 1.0  # seconds over which the camera's path is averaged
Float = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclasses.dataclass(frozen=True, eq=False)
class Take:
    """A motion of a page.

    Attributes
    ----------
    name : str
    joints : (F, J, 3, 4) array
        World transforms from the body's rest pose, at the garment's frame rate.
    truth : (F, V, 3) array-like or None
        The simulated garment, where it is known; shown beside the prediction.
    """

    name: str
    joints: Any
    truth: Any = None


def write_page(
    garment: Checkpoint,
    takes: Sequence[Take],
    path: Path | str,
    *,
    parameters: SimulationParameters | None = None,
    title: str = "Garment",
    max_bytes: int = 12_000_000,
) -> int:
    """Write a page that needs no network and return its size in bytes.

    Parameters
    ----------
    garment : Checkpoint
        One network that predicts rotations as 6D, and detail by components or none.
    takes : sequence of Take
        One or more; the page opens with the first.
    path : path
    parameters : SimulationParameters, optional
        Parameters of the truth, with which the page also starts if the garment reads parameters.
    title : str
    max_bytes : int
        Largest size of the page.  If it would be larger, networks are rounded to half precision,
        and if that is not enough, the truth is left out.

    Raises
    ------
    InputError
        If the garment is an ensemble, a motion does not fit the body, a truth does not fit the
        motion, or the page would still be larger than `max_bytes`.
    """
    n = garment.networks[0]
    if garment.kernel is not None:
        raise InputError("model", "one network, such as reads the parameters", "an ensemble")
    if n.config.low.rotation != "sixd" or not isinstance(n.high, DetailBasis | None):
        raise InputError("model", "a network of rooted's kind", "Euler angles or EdgeConvs")
    if not takes:
        raise InputError("takes", "one or more motions", "none")
    bare = [dataclasses.replace(take, truth=None) for take in takes]
    smaller = "To keep the page small, its networks are in half precision"
    for half, some, notes in (
        (False, takes, []),
        (True, takes, [f"{smaller}."]),
        (True, bare, [f"{smaller}, and the simulation is left out."]),
    ):
        start = parameters or SimulationParameters()
        data = _page_text(garment, some, start, title, half, notes).encode()
        if len(data) <= max_bytes:
            break
    else:
        frames = sum(len(take.joints) for take in takes)
        expected = f"a network and motions that fit into {max_bytes:,} bytes"
        raise InputError("max_bytes", expected, f"{len(data):,} with {frames:,} frames")
    write_bytes(Path(path), data)
    return len(data)


def _page_text(
    garment: Checkpoint,
    takes: Sequence[Take],
    parameters: SimulationParameters,
    title: str,
    half: bool,
    notes: list[str],
) -> str:
    blocks = Blocks()
    count = garment.subject.skeleton.n_joints
    joints = [check_joints(take.joints, count) for take in takes]
    ends = np.cumsum([0, *map(len, joints)]).tolist()
    paths, rooms = _ways(garment, joints)
    document = {
        "title": title,
        "unit": " mm",
        **_figure(garment, blocks),
        "step": 1,
        "frames": ends[-1],
        "clips": [
            {
                "name": take.name,
                "start": start,
                "stop": stop,
                "first": 0,
                "fps": garment.subject.fps,
                "truth": take.truth is not None,
                "room": room,
            }
            for take, (start, stop), room in zip(takes, pairwise(ends), rooms, strict=True)
        ],
        "transforms": blocks.fixed(np.concatenate(joints)),
        "path": blocks.array(np.concatenate(paths).astype(np.float32)),
        **_seen(garment, takes, joints, parameters, blocks),
        "garment": _network(garment, parameters, half, blocks),
        "notes": notes,
    }
    scripts = (*PARTS, *_SCRIPTS)
    panel = _WEB / "panel.html"
    return assembled(document, blocks.data, scripts, styles=_STYLES, panel=panel)


def _figure(garment: Checkpoint, blocks: Blocks) -> dict[str, Any]:
    """Document entries of one mesh of garment and body, with joints and virtual bones as bones."""
    s = garment.subject
    g, body, count = s.garment, s.body, s.skeleton.n_joints
    rest, indices, weights = s.skin(smooth=garment.networks[0].high is None)
    most = max(indices.shape[1], body.indices.shape[1])

    def wide(x: NDArray[Any]) -> NDArray[Any]:
        return np.pad(x, ((0, 0), (0, most - x.shape[1])))

    indices = (indices + count) % (count + g.n_bones)
    faces = np.concatenate([g.faces, body.faces + g.n_vertices])
    model = Skinning(
        np.concatenate([rest, body.rest]),
        np.concatenate([wide(indices), wide(body.indices)]),
        np.concatenate([wide(weights), wide(body.weights)]),
        np.tile(np.eye(3, 4), (1, count + g.n_bones, 1, 1)),
        faces=faces,
    )
    colors = Surface(
        material_index=np.repeat(np.arange(2, dtype=np.int32), [len(g.faces), len(body.faces)]),
        materials=tuple(Material(base_color=(*color, 1.0)) for color in (FABRIC, SKIN)),
    )
    surface = surface_entries(faces, colors, model.n_vertices, blocks, [])
    surface["parts"][-1]["behind"] = _BEHIND
    heads = s.skeleton.rest
    tails = limb_ends(heads, s.skeleton.parents, body.rest, body.indices, body.weights)
    o = garment.networks[0].config
    hidden = [o.low.hidden, *[o.high.hidden] * (garment.networks[0].high is not None)]
    return {
        "summary": f"{g.n_vertices:,} vertices on {g.n_bones} virtual bones, predicted here by "
        f"recurrent networks of {' and '.join(map(str, hidden))}",
        "vertices": model.n_vertices,
        "cloth": g.n_vertices,
        "bones": count,
        "virtual": g.n_bones,
        "basis": np.eye(3).ravel().tolist(),
        "center": [0, 0, 0],
        "scale": 1,
        "heat": heat_scales(),
        "rest": blocks.array(model.rest.astype(np.float32)),
        **weight_entries(model, blocks),
        **surface,
        "rig": {
            "names": list(s.skeleton.names),
            "parents": s.skeleton.parents.tolist(),
            "rigid": True,
            "heads": heads.tolist(),
            "ends": tails.tolist(),
            "colors": (255 * srgb_from_linear(bone_colors(heads))).round().astype(int).tolist(),
        },
    }


def _ways(garment: Checkpoint, joints: list[Float]) -> tuple[list[Float], list[Any]]:
    """Camera's path across the ground in each motion, and 26 points around the body there."""
    skeleton = garment.subject.skeleton
    size = max(1, round(_SMOOTH * garment.subject.fps))
    paths, rooms = [], []
    for m in joints:
        heads, room = skeleton.positions(m), Outermost()
        path = uniform_filter1d(heads[:, 0], size, axis=0, mode="nearest") * [1.0, 0.0, 1.0]
        room.add((heads - path[:, None]).reshape(-1, 3))
        paths.append(path)
        rooms.append((room.points + _MARGIN * room.ways).round(3).tolist())
    return paths, rooms


def _seen(
    garment: Checkpoint,
    takes: Sequence[Take],
    joints: list[Float],
    parameters: SimulationParameters,
    blocks: Blocks,
) -> dict[str, Any]:
    """What the browser does not compute: how far each frame is pushed out of the body, differences
    of the truth from it, and errors in millimetres.
    """
    push, known = push_of(garment.subject), any(take.truth is not None for take in takes)
    n, body = garment.subject.garment.n_vertices, garment.subject.body.n_vertices
    off: list[Single] = []
    moved: list[Single] = []
    for take, m in zip(takes, joints, strict=True):
        truth, shown = None, np.zeros((len(m), n, 3), np.float32)
        if take.truth is not None:
            truth = np.asarray(take.truth, np.float32)
            if truth.shape != (len(m), n, 3):
                raise InputError("truth", f"shape {(len(m), n, 3)}", truth.shape)
        plain = shown
        if push is not None or truth is not None:
            shown = plain = garment.predict(m, parameters if garment.reads_parameters else None)
        if push is not None:
            shown = push(plain, m).vertices
        gap = np.zeros_like(shown) if truth is None else truth - shown
        moved += list(np.pad(shown - plain, ((0, 0), (0, body), (0, 0))))
        off += list(np.pad(gap, ((0, 0), (0, body), (0, 0))))
    pushed = None
    far = max(float(np.abs(one).max()) for one in moved)
    if far > 0:
        pushed = difference_entry(moved.__getitem__, len(moved), n + body, far, 1.0, blocks)
    if not known:
        return {"pushed": pushed, "error": None, "input": None}
    size = 1e3 * np.stack([np.linalg.norm(one[:n], axis=1) for one in off])
    reach = max(32767 * _STEP, *(float(np.abs(one).max()) for one in off))
    box = np.ptp(garment.subject.garment.rest, axis=0)
    return {
        "pushed": pushed,
        "error": {
            "mean": size.mean(axis=1).round(4).tolist(),
            "largest": size.max(axis=1).round(4).tolist(),
            "top": max(float(np.quantile(size, 0.995, axis=1).max()), 1e-3),
            "max": float(size.max()),
            "diagonal": 1e3 * float(np.linalg.norm(box)),
        },
        "input": difference_entry(off.__getitem__, len(off), n + body, reach, 1.0, blocks),
    }


def _network(
    garment: Checkpoint, parameters: SimulationParameters, half: bool, blocks: Blocks
) -> dict[str, Any]:
    """Document entries of the network that ``garment.js`` evaluates."""
    n, s = garment.networks[0], garment.subject
    o, normaliser, code = n.config.features, n.normaliser, n.low.code

    def packed(x: Any) -> dict[str, Any]:
        values = np.asarray(x, np.float32)
        # Numbers rounded to half precision end in zero bits, which compress well.
        return blocks.array(values.astype(np.float16).astype(np.float32) if half else values)

    def recurrent(part: GRULinear, scale: Any = None) -> dict[str, Any]:
        arrays = [x.detach().numpy() for x in (*part.gru.all_weights[0], *part.out.parameters())]
        names = "w_in", "w_state", "b_in", "b_state", "w_out", "b_out"
        found = dict(zip(names, arrays, strict=True))
        if scale is not None:  # the deviations of the weights, multiplied into the last layer
            found |= {"w_out": found["w_out"] * scale[:, None], "b_out": found["b_out"] * scale}
        return {name: packed(x) for name, x in found.items()}

    basis = still = high = None
    if isinstance(n.high, DetailBasis):
        high = recurrent(n.high, n.high.deviation.numpy())
        own = np.concatenate([n.high.mean[None], n.high.basis.unflatten(1, n.high.mean.shape)])
        whole = np.zeros((len(own), s.garment.n_vertices, 3), np.float32)
        whole[:, s.free] = own
        mean, *components = whole.reshape(len(whole), -1)
        still, basis = packed(mean), packed(np.transpose(components))
    followed = [-1] * len(code.centres) if code.followed is None else code.followed.tolist()
    fields = dataclasses.asdict(parameters)
    return {
        "fps": s.fps,
        "read": n.features.read,
        "tracked": n.features.tracked,
        "sixd": o.rotation == "sixd",
        "headingFree": o.heading_free,
        "translation": o.translation,
        "velocities": o.velocities,
        "rootMotion": o.root_motion,
        "frame": o.frame,
        "mean": normaliser.mean.tolist(),
        "deviation": normaliser.deviation.tolist(),
        "clamp": normaliser.clamp,
        "readsBody": n.config.high.source == "body",
        "parameters": [
            {"name": k, "low": low, "high": high, "value": fields[k]}
            for k, (low, high) in RANGES.items()
            if n.condition
        ],
        "product": base64.b64encode((_WEB / "affine.wasm").read_bytes()).decode(),
        "low": recurrent(n.low),
        "high": high,
        "scale": blocks.array(code.deviation.numpy()),
        "shift": blocks.array(code.mean.numpy()),
        "centres": blocks.array(code.centres.numpy()),
        "followed": followed,
        "basis": basis,
        "still": still,
    }


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("model", help="checkpoint of one network, or dress")
    options.add_argument("motions", nargs="*", type=Path, help="files as for garmentnet predict")
    options.add_argument("--output", "-o", type=Path, required=True, help="page.html")
    options.add_argument("--max-mb", type=float, default=12.0, help="largest size of the page")
    for name in RANGES:
        options.add_argument(f"--{name.replace('_', '-')}", type=float)
    given = options.parse_args()
    garment = load_checkpoint(given.model)
    entered = {k: v for k in RANGES if (v := getattr(given, k)) is not None}
    shown = chosen_parameters(garment, entered) or garment.parameters[0]
    check_set(garment, shown)
    takes = []
    for path in given.motions or [SHIPPED / "dance.npz"]:
        joints, clip = read_motion(path, garment.subject)
        fits = clip is not None and clip.parameters == shown
        truth = clip.sequence.frames(slice(None)) if clip is not None and fits else None
        takes.append(Take(path.stem, joints, truth))
    size = write_page(
        garment, takes, given.output, parameters=shown,
        title=Path(given.model).stem, max_bytes=round(1e6 * given.max_mb),
    )  # fmt: skip
    print(f"{given.output}: {size / 1e6:.1f} MB, {len(takes)} motion(s)")


if __name__ == "__main__":
    main()
