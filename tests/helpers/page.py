"""What a page holds, read back from its text: a twin of ``data.js``."""

from __future__ import annotations

import base64
import json
import zlib
from html.parser import HTMLParser
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES = {"Float": "f", "Int": "i", "Uint": "u"}


class Held(HTMLParser):
    """Elements of a page as a browser parses them.

    Attributes
    ----------
    tags : list of str
        Names of all elements.
    document : dict
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self._scripts: dict[str, str] = {}
        self._open = ""
        self.feed(text)
        self.document = json.loads(self._scripts["document"])

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._open = dict(attrs).get("id") or "" if tag == "script" else ""

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    def handle_data(self, data: str) -> None:
        if self._open:
            self._scripts[self._open] = self._scripts.get(self._open, "") + data

    def block(self, number: int) -> bytes:
        return base64.b64decode(self._scripts[f"block{number}"])

    def array(self, entry: dict[str, Any]) -> NDArray[Any]:
        """Array of an entry, in float64 if it has a step."""
        name = entry["type"].removesuffix("Array")
        letters = name.rstrip("0123456789")
        dtype = np.dtype(f"<{_TYPES[letters]}{int(name[len(letters) :]) // 8}")
        planes = np.frombuffer(zlib.decompress(self.block(entry["block"])), np.uint8)
        bytes_ = np.ascontiguousarray(planes.reshape(dtype.itemsize, -1).T)
        values = bytes_.view(dtype).reshape(entry["shape"])
        if entry["delta"]:
            values = np.cumsum(values, axis=0, dtype=dtype)
        return values * entry["step"] if "step" in entry else values

    def vertices(self) -> NDArray[np.float64]:
        """Vertices (F, V, 3) of the model in the mesh's units, by a sum over weights."""
        d = self.document
        rest, indices = self.array(d["rest"]), self.array(d["indices"])
        moved = self.array(d["transforms"])[:, indices]
        at = np.einsum("fvkij,vj->fvki", moved[..., :3], rest) + moved[..., 3]
        points = np.einsum("vk,fvki->fvi", self.array(d["weights"]), at)
        return points * d["scale"] + d["center"]

    def input(self) -> NDArray[np.float64]:
        """Vertices of the input in the mesh's units."""
        d = self.document
        off = np.concatenate([self.array(span) for span in d["input"]["spans"]])
        return self.vertices() + off * d["input"]["step"] * d["scale"]
