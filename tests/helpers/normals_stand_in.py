"""Stand-in for ``ssdr.metrics.normals`` until it is there; to be removed then."""

from __future__ import annotations

import numpy as np

import ssdr
from ssdr.render.scene import Scene

from .normal_angles import Angles


def normals(reference, model) -> Angles:
    """Errors of the normals of the vertices."""
    if not len(model.faces):
        raise ssdr.InputError("faces", "a triangle with an area", "none")
    scene = Scene.of(model, reference)
    every = np.array([scene.errors(t, "normals") for t in range(model.n_frames)])
    return Angles(
        float(every.mean()),
        float(np.percentile(every, 95, method="inverted_cdf")),
        float((every > 20).mean()),
        float((every > 90).mean()),
    )


if not hasattr(ssdr.metrics, "normals"):
    ssdr.metrics.normals = normals
