"""Limbs through the cloth: in the simulation, in predictions, and after they are pushed out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..collision.crossings import Crossings, find_crossings
from ..collision.outward import push_of
from ..data.clip import Clip
from ..paper.bones import VirtualBones
from .methods import Method
from .tables import markdown


def count_limbs(
    bones: VirtualBones, methods: Sequence[Method], names: Sequence[str]
) -> list[dict[str, Any]]:
    """Crossings of body and garment in the named clips: one row of the simulation's own, then two
    of each method, before and after its prediction is pushed out.

    A row has its name, the number of frames, the fractions of these in which a triangle of the body
    crosses one of the cloth that can move, `crossed`, and in which one does so by more than 5 mm,
    `deep`, and the depth of the deepest crossing in mm, `deepest`.

    There are no rows for a body without triangles, and none of what is pushed out of a body that is
    not closed.
    """
    store, subject = bones.store, bones.subject
    if not len(store.body.faces):
        return []
    pinned, push = subject.carried, push_of(subject)
    found: dict[str, list[Crossings]] = {}

    def count(name: str, clip: Clip, vertices: NDArray[np.floating]) -> None:
        here = find_crossings(store.body, store.faces, vertices, clip.joints, pinned=pinned)
        found.setdefault(name, []).append(here)

    for clip in map(store.clip, names):
        count("simulation", clip, np.asarray(clip.sequence.frames(slice(None))))
        for method in methods:
            low, high = method.split(clip, bones)
            count(method.name, clip, low + high)
            if push is not None:
                moved = push(low + high, clip.joints).vertices
                count(f"{method.name}, pushed out", clip, moved)
    rows = []
    for name, parts in found.items():
        whole = Crossings(
            np.concatenate([c.pairs for c in parts]), np.concatenate([c.depth for c in parts])
        )
        row = {"name": name, "frames": len(whole.depth), "crossed": whole.any, "deep": whole.deep}
        rows.append(row | {"deepest": 1e3 * float(whole.depth.max())})
    return rows


def limbs_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Table in Markdown, in per cent of the frames and mm."""
    head = ["body through the cloth", "frames", "deeper than 5 mm", "deepest, mm"]
    lines = [
        [r["name"], *(f"{100 * r[k]:.2f} %" for k in ("crossed", "deep")), f"{r['deepest']:.0f}"]
        for r in rows
    ]
    return markdown(head, lines)
