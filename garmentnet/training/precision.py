"""Half precision in training: products in bfloat16, sums, losses and weights in float32."""

from __future__ import annotations

import contextlib
import functools
from typing import Any

import torch

from ..configs.config import TrainOptions

__all__ = ["mixed_precision"]

# What makes bfloat16 products of a processor faster than those of float32, not slower.
_INSTRUCTIONS = ("avx512_bf16", "amx_bf16")


def mixed_precision(
    options: TrainOptions, device: torch.device
) -> contextlib.AbstractContextManager[object]:
    """A context in which the products of a module are computed as `options.precision` asks.

    Losses stay outside: they are small differences of large numbers, which bfloat16 with its
    eight bits cannot hold.

    Parameters
    ----------
    options : TrainOptions
        ``precision`` is "single", "bfloat16", or "auto": bfloat16 on a processor that has
        instructions for it, otherwise single.
    device : torch.device
    """
    half = options.precision == "bfloat16"
    if options.precision == "auto" and device.type == "cpu":
        half = _has_instructions()
    return torch.autocast(device.type, torch.bfloat16) if half else contextlib.nullcontext()


@functools.cache
def _has_instructions() -> bool:
    # Known from torch 2.6 on; an older one computes in single precision.
    known: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return any(known.get(name, False) for name in _INSTRUCTIONS)
