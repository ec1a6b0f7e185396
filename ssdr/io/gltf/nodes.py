"""glTF's nodes: which hang on which, and where they stand in the frames of a clip."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rigid import matrix_from_quaternion
from .animation import Animation
from .document import Document

__all__ = ["Nodes", "descendants"]

_AT_REST = {
    "translation": [0.0, 0.0, 0.0],
    "rotation": [0.0, 0.0, 0.0, 1.0],
    "scale": [1.0, 1.0, 1.0],
}


def descendants(nodes: Sequence[dict[str, Any]], roots: Iterable[int]) -> list[int]:
    """Nodes and all that hangs on them, each before its children."""
    order: dict[int, None] = {}
    stack = list(roots)[::-1]
    while stack:
        node = stack.pop()
        if node not in order:
            order[node] = None
            stack.extend(nodes[node].get("children", [])[::-1])
    return list(order)


class Nodes:
    """The nodes of a file over the frames of a clip.

    Attributes
    ----------
    items : list of dict
        The nodes' JSON.
    order : list of int
        All nodes, each before its children.
    shown : list of int
        The nodes of the scene.

    Raises
    ------
    FormatError
        If a node has two parents or is its own ancestor.
    """

    def __init__(self, document: Document, animation: Animation) -> None:
        self.document, self.animation = document, animation
        self.items = document.items("nodes")
        self._cache: dict[int, NDArray[np.float64]] = {}
        self._parent: dict[int, int] = {}
        for parent, node in enumerate(self.items):
            for child in node.get("children", []):
                if child in self._parent:
                    raise document.error(f"node {child} has two parents")
                self._parent[child] = parent
        every = set(range(len(self.items)))
        self.order = descendants(self.items, sorted(every - self._parent.keys()))
        if len(self.order) < len(every):
            node = min(every.difference(self.order))
            raise document.error(f"node {node} is its own ancestor, or hangs on one that is")
        self.shown = self.order
        if document.items("scenes"):
            scene = document.items("scenes")[document.json.get("scene", 0)]
            self.shown = descendants(self.items, scene.get("nodes", []))

    def ancestors(self, node: int) -> Iterator[int]:
        """The nodes above a node, the nearest first."""
        while node in self._parent:
            node = self._parent[node]
            yield node

    def matrices(self, node: int) -> NDArray[np.float64]:
        """Global transforms ``(F, 4, 4)`` of a node, or ``(1, 4, 4)`` of one that stands still."""
        chain = [node]
        while chain[-1] not in self._cache and chain[-1] in self._parent:
            chain.append(self._parent[chain[-1]])
        for k in reversed(chain):
            if k not in self._cache:
                local = self._local(k)
                above = self._cache.get(self._parent.get(k, -1), np.eye(4)[None])
                n_frames = max(len(local), len(above))
                self.document.budget.spend(
                    128 * n_frames, f"{len(self._cache) + 1} nodes over {n_frames} frames"
                )
                self._cache[k] = above @ local
        return self._cache[node]

    def _local(self, index: int) -> NDArray[np.float64]:
        node, document = self.items[index], self.document
        if "matrix" in node:
            matrix = document.numbers(node, "matrix", [0.0] * 16).reshape(1, 4, 4)
            return np.swapaxes(matrix, 1, 2)
        tracks = {}
        for path, default in _AT_REST.items():
            keys = self.animation.sample(index, path)
            tracks[path] = document.numbers(node, path, default)[None] if keys is None else keys
        result = np.zeros((max(len(values) for values in tracks.values()), 4, 4))
        result[:, :3, :3] = matrix_from_quaternion(tracks["rotation"]) * tracks["scale"][:, None]
        result[:, :3, 3] = tracks["translation"]
        result[:, 3, 3] = 1
        return result
