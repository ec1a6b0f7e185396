"""Arrays as compressed blocks of bytes, which ``data.js`` unpacks."""

from __future__ import annotations

import dataclasses
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEVEL = 6  # of zlib; 9 takes three times as long for 1 %


@dataclasses.dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of bytes in the order in which they were added.

    Attributes
    ----------
    data : list of bytes
    """

    data: list[bytes] = dataclasses.field(default_factory=list)

    def raw(self, data: bytes) -> int:
        """Append `data` unchanged as a new block and return the block's index."""
        self.data.append(data)
        return len(self.data) - 1

    def array(self, values: NDArray[Any], *, delta: bool = False) -> dict[str, Any]:
        """Append an array as a new block; return its document entry, with block index and layout.

        Its bytes are shuffled, one plane for each byte of a number, and compressed by zlib.

        Parameters
        ----------
        values : array
            Of uint8, uint16, int16, uint32, int32 or float32.
        delta : bool
            Whether to store the differences between consecutive rows, which wrap around.
        """
        plain = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
        if delta and len(plain):
            plain = np.concatenate([plain[:1], plain[1:] - plain[:-1]])
        planes = plain.reshape(-1, 1).view(np.uint8).T.tobytes()
        kind = {"u": "Uint", "i": "Int", "f": "Float"}[plain.dtype.kind]
        return {
            "block": self.raw(zlib.compress(planes, _LEVEL)),
            "type": f"{kind}{8 * plain.dtype.itemsize}Array",
            "shape": list(plain.shape),
            "delta": delta,
        }

    def fixed(self, values: NDArray[np.floating], *, delta: bool = True) -> dict[str, Any]:
        """Append an array in fixed point, as multiples of 2⁻²², and return its document entry.

        The step is larger for numbers above 2⁸.
        """
        largest = float(np.abs(values).max(initial=0.0))
        step = 2.0**-22 * max(1.0, 2.0 ** np.ceil(np.log2(max(largest, 1e-300) / 2**8)))
        entry = self.array(np.rint(values / step).astype(np.int32), delta=delta)
        return {**entry, "step": step}
