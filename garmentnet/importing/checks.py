"""Check that a cloth belongs to a rig: its place, unit and axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ssdr import skin
from ssdr.errors import InputError
from ssdr.hierarchy.transforms import rest_diagonal

from .rig import Rig

__all__ = ["check_place"]

_LOOKED_AT = 8  # number of frames in which the cloth must be at the body
_FAR = 0.25  # largest median distance from the body, relative to the larger size of the two
_SMALLEST, _LARGEST = 0.05, 5.0  # bounds of a cloth's size, relative to the body's
_HUGE = 20.0  # size from which a skeleton's unit cannot be the metre


def check_place(vertices: NDArray[np.float32], rig: Rig) -> None:
    """Check that a cloth ``(F, V, 3)`` is at the rig's body.

    Raises
    ------
    InputError
        If the cloth is far away or of another size; the message says which unit or axis would fit.
    """
    body, size = rig.body, rest_diagonal(rig.body.rest)
    chosen = np.unique(np.linspace(0, len(rig.joints) - 1, _LOOKED_AT).astype(int))
    cloth = vertices[chosen].astype(np.float64)
    posed = skin(body.rest, body.indices, body.weights, rig.joints[chosen])
    trees = [cKDTree(v) for v in posed]

    def measure(v: NDArray[np.float64]) -> tuple[float, float]:
        far = np.median([tree.query(x)[0] for tree, x in zip(trees, v, strict=True)])
        return float(far), rest_diagonal(v[0])

    def fits(v: NDArray[np.float64]) -> bool:
        far, large = measure(v)
        return far < _FAR * max(size, large) and _SMALLEST * size < large < _LARGEST * size

    if fits(cloth):
        return
    lying = rig.is_lying()
    # A quarter turn about x, from y up to z up or back.
    turned = cloth[..., [0, 2, 1]] * ((1, -1, 1) if lying else (1, 1, -1))
    found = []
    for axis, v in (("", cloth), ("rig-up z" if lying else "cloth-up z", turned)):
        for factor in (1, 0.01, 100, 0.001, 1000):
            if fits(factor * v):
                rig_too = f"rig-scale {1 / factor:g}" if size > _HUGE else f"cloth-scale {factor:g}"
                found.append(" and ".join(filter(None, (axis, rig_too if factor != 1 else ""))))
    far, large = measure(cloth)
    hint = f"; {found[0]} would fit" if found else ""
    raise InputError(
        "cloth",
        f"a garment on the body, which is {size:.3g} m large, in its unit, axes and place",
        f"one {large:.3g} m large, {far:.3g} m away from it{hint}",
    )
