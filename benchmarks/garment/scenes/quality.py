"""Quality of simulated clips, and limits beyond which they are not used for training."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from garmentnet.collision.body_tree import INSIDE, BodyTree

from .body import Body
from .garments import Garment
from .motion import Motion

# Distance from the skin, metres, up to which vertices outside are measured.
_LOOK = 1e-3


@dataclasses.dataclass(frozen=True)
class Gate:
    """Limits beyond which a clip is rejected, by the names in its :class:`Quality`.

    Parameters
    ----------
    stretch_p99, stretch_max : float
        Length of an edge divided by its length at rest.
    inside_fraction : float
        Fraction of the vertices inside the body, over all frames.
    depth_max : float
        Greatest depth of a vertex inside the body, metres.
    speed_max : float
        Greatest speed of a vertex, m/s.

    Examples
    --------
    >>> Gate(depth_max=0.02).stretch_max
    4.0
    """

    stretch_p99: float = 1.5
    stretch_max: float = 4.0
    inside_fraction: float = 0.02
    depth_max: float = 0.05
    speed_max: float = 40.0


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


def depths(body: Body, motion: Motion, vertices: NDArray[np.float32]) -> NDArray[np.float64]:
    """Depths ``(F, V)`` of the vertices, metres below the skin; 0 in frames with NaN.

    They are measured up to 1 mm outside and -inf beyond.
    """
    depth, whole = np.zeros(vertices.shape[:2]), np.isfinite(vertices).all(axis=(1, 2))
    tree = BodyTree(body.skinning)
    depth[whole] = -tree.signed_distance(vertices[whole], motion.joints[whole], limit=_LOOK)
    return depth


def judge(
    garment: Garment,
    motion: Motion,
    vertices: NDArray[np.float32],
    depth: NDArray[np.float64],
    gate: Gate | None = None,
) -> Quality:
    """Measure a clip and decide whether it is good enough to learn from.

    Parameters
    ----------
    garment : Garment
    motion : Motion
    vertices : (F, V, 3) float32
    depth : (F, V) array
        Metres below the skin, from :func:`depths`.
    gate : Gate, optional
    """
    if not np.isfinite(vertices).all():
        frame = int((~np.isfinite(vertices)).any(axis=(1, 2)).argmax())
        return Quality(False, f"NaN from frame {frame} on", *(0.0,) * 7)
    edges = garment.edges()
    edges = edges[~garment.pinned[edges].all(axis=1)]
    stretch = _lengths(vertices, edges) / _lengths(garment.rest[None], edges)[0]
    p50, p99 = (float(v) for v in np.percentile(stretch, [50, 99]))
    inside = (depth > INSIDE).mean(axis=1)
    step = np.linalg.norm(np.diff(vertices, axis=0), axis=2)
    measured = {
        "stretch_p50": p50,
        "stretch_p99": p99,
        "stretch_max": float(stretch.max()),
        "inside_fraction": inside.mean(),
        "inside_worst_frame": inside.max(),
        "depth_max": max(0.0, depth.max()),
        "speed_max": float(step.max(initial=0.0)) * motion.fps,
    }
    limits = dataclasses.asdict(gate or Gate())
    reasons = [
        f"{name} {measured[name]:.4g} > {most:g}"
        for name, most in limits.items()
        if measured[name] > most
    ]
    # Six digits, so that the stored numbers do not depend on the order of a sum.
    rounded = {k: float(f"{v:.6g}") for k, v in measured.items()}
    return Quality(accepted=not reasons, reason="; ".join(reasons), **rounded)


def _lengths(vertices: NDArray[np.float32], edges: NDArray[np.int32]) -> NDArray[np.float32]:
    return np.asarray(np.linalg.norm(vertices[:, edges[:, 0]] - vertices[:, edges[:, 1]], axis=2))
