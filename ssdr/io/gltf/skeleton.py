"""Storage of a rig in a glTF document: joint nodes, skin, animations and skin weights."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import Clip
from ...rigid import quaternion_from_matrix
from ..file_clips import seconds
from ..rig import Rig
from .builder import ARRAY, Builder


def add_weights(builder: Builder, rig: Rig, vertex: NDArray[np.integer]) -> dict[str, int]:
    """Add the skin weights of the rig's vertices `vertex` (N,) and return accessors by attribute.

    Each pair of attributes, ``JOINTS_k`` and ``WEIGHTS_k``, holds four influences of a vertex.
    """
    count = rig.n_bones if rig.moving is None else len(rig.moving)
    narrow = np.uint8 if count <= 256 else np.uint16
    pad = ((0, 0), (0, -rig.weights.shape[1] % 4))
    joints = np.pad(rig.indices[vertex].astype(narrow), pad)
    weights = np.pad(rig.weights[vertex], pad)
    attributes = {}
    for k in range(joints.shape[1] // 4):
        four = slice(4 * k, 4 * k + 4)
        for name, values in ((f"JOINTS_{k}", joints), (f"WEIGHTS_{k}", weights)):
            share = name.startswith("WEIGHTS")
            attributes[name] = builder.accessor(
                values[:, four], "VEC4", target=ARRAY, normalized=share
            )
    return attributes


def skeleton_nodes(rig: Rig, title: str, first: int) -> list[dict[str, Any]]:
    """JSON of a skeleton's nodes: its root, which becomes node `first`, and then its joints."""
    parents = np.full(rig.n_bones, -1) if rig.parents is None else rig.parents
    nodes: list[dict[str, Any]] = [{"name": f"{title}_skeleton"}]
    for bone, name in enumerate(rig.names):
        nodes.append({"name": name, "translation": [float(str(x)) for x in rig.offsets[bone]]})
        if rig.axes is not None:
            above = rig.axes[parents[bone]] if parents[bone] >= 0 else np.eye(3)
            turn = quaternion_from_matrix(above.T @ rig.axes[bone])
            nodes[-1]["rotation"] = turn.tolist()
    for place, node in enumerate(nodes):
        children = first + 1 + np.flatnonzero(parents == place - 1)
        if len(children):
            node["children"] = children.tolist()
    return nodes


def add_skin(builder: Builder, rig: Rig, title: str, first: int) -> dict[str, Any]:
    """Add the inverse bind matrices of a skeleton and return the JSON of its skin.

    The skeleton's root is node `first` of the file, and its joints are the nodes that follow.
    """
    moving = np.arange(rig.n_bones) if rig.moving is None else rig.moving
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(moving), 1, 1))
    axes = np.tile(np.eye(3), (len(moving), 1, 1)) if rig.axes is None else rig.axes
    # glTF stores matrices column by column, so that rows here are the columns of the matrix.
    inverse[:, :3, :3] = axes
    inverse[:, 3, :3] = -np.einsum("bji,bj->bi", axes, rig.centers[moving].astype(np.float64))
    return {
        "name": title,
        "inverseBindMatrices": builder.accessor(inverse.reshape(-1, 16), "MAT4"),
        "skeleton": first,
        "joints": (first + 1 + moving).tolist(),
    }


def _moved(rig: Rig, clip: Clip) -> list[int]:
    """Indices of the bones that leave their rest transforms in a clip; bone 0 if none do."""
    if rig.axes is not None:
        return list(range(rig.n_bones))
    some = clip.frames
    moved = (rig.rotations[some] != np.array([0, 0, 0, 1])).any(axis=(0, 2))
    moved |= ((rig.translations[some] != rig.offsets).any(axis=2) & rig.translating).any(axis=0)
    if rig.scales is not None:
        moved |= (rig.scales[some] != 1).any(axis=(0, 2))
    return np.flatnonzero(moved).tolist() or [0]


def add_animation(
    builder: Builder, rig: Rig, clip: Clip, name: str, first: int, start: float = 0.0
) -> dict[str, Any]:
    """Add the keys of a clip and return the JSON of its animation.

    The first frame of the clip is at `start` seconds; the skeleton's root is node `first`.
    """
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    inputs: dict[bytes, int] = {}
    for bone in _moved(rig, clip):
        keys = clip.start + np.flatnonzero(rig.keys[clip.frames, bone])
        if keys.tobytes() not in inputs:
            times = (start + seconds(keys - clip.start, clip.fps)).astype(np.float32)
            inputs[keys.tobytes()] = builder.accessor(times, "SCALAR", bounds=True)
        tracks = [("rotation", rig.rotations[keys, bone], "VEC4")]
        if rig.translating[bone]:
            tracks.insert(0, ("translation", rig.translations[keys, bone], "VEC3"))
        if rig.scales is not None and (rig.scales[:, bone] != 1).any():
            tracks.append(("scale", rig.scales[keys, bone], "VEC3"))
        for path, values, kind in tracks:
            target = {"node": first + 1 + bone, "path": path}
            channels.append({"sampler": len(samplers), "target": target})
            output = builder.accessor(values, kind)
            samplers.append({"input": inputs[keys.tobytes()], "output": output})
    stated: dict[str, Any] = {"fps": clip.fps, "frames": clip.n_frames}
    if start:
        stated["start"] = start
    return {"name": name, "samplers": samplers, "channels": channels, "extras": {"ssdr": stated}}
