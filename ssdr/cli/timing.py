"""What a decomposition spends beside the solver: loading, compiling, saving."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..clips import Clip
from ..io.registry import format_of
from ..sequence import MeshSequence
from .output import Output, rehearse

__all__ = ["prepare", "times_text"]

_FEW = 8  # frames of a small model whose writing is timed
_BLENDER = 20.0  # seconds, which starting it twice and exporting usually need
_PANELS, _PANEL = 30, (300, 300)  # of a contact sheet: how many, pixels of each
_USUAL_BONES = 24  # where a tolerance will decide
_LEAST = 0.05  # of the time limit, for the solver: one model is made in any case


def prepare(
    shots: list[MeshSequence],
    outputs: Mapping[Path, Mapping[str, Any]],
    *,
    clips: Sequence[Clip],
    bones: int | None,
    picture: Path | None,
    time_limit: float | None,
    began: float,
    output: Output,
) -> tuple[float | None, float]:
    """Rehearse the outputs, given with their options, and compile.

    What is returned are the seconds left to the solver, and those of compiling.

    Under a time limit, saving is timed beforehand, and what it will need is set aside.
    """
    frames, needed = sum(len(shot) for shot in shots), 0.0
    with output.waiting("trying the outputs"):
        for path, options in outputs.items():
            rehearse(shots[0], path, options, frames=frames, clips=clips)
            if time_limit is not None:
                count = bones or _USUAL_BONES
                needed += _seconds_to_save(shots[0], path, options, frames=frames, bones=count)
        if picture is not None and time_limit is not None:
            needed += _seconds_to_draw(shots[0])
    with output.waiting("compiling"):
        from ..solver.warmup import compile_kernels

        compiling = compile_kernels()
    if time_limit is None:
        return None, compiling
    left = time_limit - (time.perf_counter() - began)
    return max(left - needed, _LEAST * time_limit), compiling


def _seconds_to_save(
    sequence: MeshSequence, path: Path, options: Mapping[str, Any], *, frames: int, bones: int
) -> float:
    """About how long a model of so many frames and bones will take to write.

    From the times of two small ones, since it grows with the frames.
    """
    if format_of(path)[1].module == "blender":
        return _BLENDER
    times, few = [], min(frames, _FEW)
    for stored in (1, few):
        began = time.perf_counter()
        rehearse(sequence, path, options, frames=frames, bones=bones, stored=stored)
        times.append(time.perf_counter() - began)
    slope = max(0.0, times[1] - times[0]) / max(1, few - 1)
    return max(times) + slope * (frames - few)


def _seconds_to_draw(sequence: MeshSequence) -> float:
    """About how long a contact sheet will take, from the time of one of its panels."""
    from ..render.figures import render_frame

    render_frame(sequence, 0, size=_PANEL)  # compiles
    began = time.perf_counter()
    render_frame(sequence, 0, size=_PANEL)
    return _PANELS * (time.perf_counter() - began)


def times_text(
    total: float, loading: float, compiling: float, solving: float, saving: float
) -> str:
    """Seconds of all and of its parts, in one line."""
    parts = {"loading": loading, "compiling": compiling, "solving": solving, "saving": saving}
    shown = [f"{name} {seconds:.1f} s" for name, seconds in parts.items() if seconds > 0.05]
    return ", ".join([f"{total:.1f} s", *shown])
