"""Whether a simulated clip is good enough to learn from."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.skinning import skin

from ..data.motion import Motion
from .backend import load_warp
from .body import Body
from .garments import Garment

__all__ = ["Depth", "Gate", "Quality", "judge"]


# Metres below the skin from which a vertex counts as inside: contact leaves some at the skin.
_INSIDE = 5e-4


@dataclasses.dataclass(frozen=True)
class Gate:
    """Limits beyond which a clip is rejected.

    Parameters
    ----------
    stretch_p99, stretch_max : float
        Length of an edge divided by its length at rest.
    inside : float
        Fraction of the vertices inside the body, over all frames.
    depth : float
        Greatest depth of a vertex inside the body, metres.
    speed : float
        Greatest speed of a vertex, m/s.

    Examples
    --------
    >>> Gate(depth=0.02).stretch_max
    4.0
    """

    stretch_p99: float = 1.5
    stretch_max: float = 4.0
    inside: float = 0.02
    depth: float = 0.05
    speed: float = 40.0


@dataclasses.dataclass(frozen=True)
class Quality:
    """Measurements of a clip, over all frames; lengths in metres.

    Stretch is measured on the edges with at least one end that is not pinned.  A vertex counts as
    inside when it is more than half a millimetre below the skin.
    """

    accepted: bool
    reason: str
    stretch_p50: float
    stretch_p99: float
    stretch_max: float
    inside_fraction: float
    inside_worst_frame: float
    depth_max: float
    speed_max: float


def judge(
    body: Body,
    garment: Garment,
    motion: Motion,
    vertices: NDArray[np.float32],
    gate: Gate | None = None,
) -> Quality:
    """Measure a clip and decide whether it is good enough to learn from.

    Parameters
    ----------
    body, garment, motion
        As in :func:`~garmentnet.scenes.simulator.simulate`.
    vertices : (F, V, 3) float32
    gate : Gate, optional
    """
    limit = gate or Gate()
    if not np.isfinite(vertices).all():
        frame = int((~np.isfinite(vertices)).any(axis=(1, 2)).argmax())
        return Quality(False, f"NaN from frame {frame} on", *(0.0,) * 7)
    edges = garment.edges()
    edges = edges[~garment.pinned[edges].all(axis=1)]
    rest = _lengths(garment.rest[None], edges)[0]
    stretch = _lengths(vertices, edges) / rest
    p50, p99 = (float(v) for v in np.percentile(stretch, [50, 99]))
    rig = body.skinning
    depth = np.empty((len(vertices), garment.n_vertices), dtype=np.float32)
    depth_of = Depth(rig.rest, rig.faces)
    for frame in range(len(vertices)):
        pose = motion.joints[frame].astype(np.float32)
        depth[frame] = depth_of(skin(rig.rest, rig.indices, rig.weights, pose), vertices[frame])
    inside = (depth > _INSIDE).mean(axis=1)
    speed = 0.0
    if len(vertices) > 1:
        step = np.linalg.norm(np.diff(vertices, axis=0), axis=2)
        speed = float(step.max()) * motion.fps
    measured = {
        "stretch_p50": p50,
        "stretch_p99": p99,
        "stretch_max": float(stretch.max()),
        "inside_fraction": float(inside.mean()),
        "inside_worst_frame": float(inside.max()),
        "depth_max": max(0.0, float(depth.max())),
        "speed_max": speed,
    }
    reasons = [
        f"{name} {measured[name]:.4g} > {most:g}"
        for name, most in (
            ("stretch_p99", limit.stretch_p99),
            ("stretch_max", limit.stretch_max),
            ("inside_fraction", limit.inside),
            ("depth_max", limit.depth),
            ("speed_max", limit.speed),
        )
        if measured[name] > most
    ]
    # Six digits, so that the stored numbers do not depend on the order of a sum.
    rounded = {k: float(f"{v:.6g}") for k, v in measured.items()}
    return Quality(accepted=not reasons, reason="; ".join(reasons), **rounded)


class Depth:
    """How deep points are inside a mesh of fixed topology; negative outside."""

    def __init__(self, points: NDArray[np.float32], faces: NDArray[np.int32]) -> None:
        wp = load_warp()
        self._mesh = wp.Mesh(
            points=wp.array(points, dtype=wp.vec3, device="cpu"),
            indices=wp.array(faces.ravel(), dtype=wp.int32, device="cpu"),
            support_winding_number=True,
        )

    def __call__(self, points: NDArray[np.float32], at: NDArray[np.float32]) -> NDArray[np.float32]:
        wp = load_warp()
        self._mesh.points.numpy()[:] = points
        self._mesh.refit()
        places = wp.array(at, dtype=wp.vec3, device="cpu")
        out = wp.zeros(len(at), dtype=wp.float32, device="cpu")
        wp.launch(_depth_kernel(), dim=len(at), inputs=[self._mesh.id, places, out], device="cpu")
        return np.array(out.numpy())


@functools.cache
def _depth_kernel() -> Any:
    from . import warp_kernels

    return warp_kernels.signed_depth


def _lengths(vertices: NDArray[np.float32], edges: NDArray[np.int32]) -> NDArray[np.float32]:
    return np.asarray(np.linalg.norm(vertices[:, edges[:, 0]] - vertices[:, edges[:, 1]], axis=2))
