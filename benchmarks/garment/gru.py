"""Forward and backward pass of the GRU against torch's own, with the error of its gradient.

    python benchmarks/garment/gru.py

Eight lanes of 30 frames, as in training; the ratio of times is the median over rounds in which the
ways take turns, and the error that of the weights' gradient against torch's in double precision.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from garmentnet.networks.gru import GRU

LANES, FRAMES, INPUTS = 8, 30, 145


def passes(module: nn.GRU, x: Tensor, weight: Tensor, half: bool) -> Callable[[], Tensor]:
    """A function that goes forward and back once and returns the weights' gradient."""

    def run() -> Tensor:
        module.zero_grad()
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            out, _ = module(x)
        (out.float() * weight).sum().backward()
        return torch.cat([p.grad.flatten() for p in module.parameters() if p.grad is not None])

    return run


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--hidden", type=int, nargs="+", default=[256, 600, 1000])
    options.add_argument("--rounds", type=int, default=15)
    options.add_argument("--threads", type=int, default=1)
    given = options.parse_args()
    torch.set_num_threads(given.threads)
    for hidden in given.hidden:
        torch.manual_seed(0)
        x, weight = torch.randn(LANES, FRAMES, INPUTS), torch.randn(LANES, FRAMES, hidden)
        theirs, ours = nn.GRU(INPUTS, hidden, batch_first=True), GRU(INPUTS, hidden)
        ours.load_state_dict(theirs.state_dict())
        ways = {
            "torch, single": passes(theirs, x, weight, False),
            "torch, bfloat16": passes(theirs, x, weight, True),
            "own, single": passes(ours, x, weight, False),
            "own, bfloat16": passes(ours, x, weight, True),
        }
        twin = nn.GRU(INPUTS, hidden, batch_first=True).double()
        twin.load_state_dict({k: v.double() for k, v in theirs.state_dict().items()})
        exact = passes(twin, x.double(), weight.double(), False)()
        spent: dict[str, list[float]] = {k: [] for k in ways}
        for _ in range(given.rounds):
            for name, run in ways.items():
                began = time.perf_counter()
                run()
                spent[name].append(time.perf_counter() - began)
        first = spent["torch, single"]
        for name, run in ways.items():
            ratio = statistics.median(b / a for a, b in zip(first, spent[name], strict=True))
            error = float((run().double() - exact).norm() / exact.norm())
            print(f"{hidden:5d} {name:16s} time {ratio:.2f}  gradient error {error:.1e}")


if __name__ == "__main__":
    main()
