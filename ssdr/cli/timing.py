"""What a decomposition spends beside the solver: loading, compiling, saving."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..clips import Clip
from ..io.registry import format_of
from ..sequence import MeshSequence
from .output import Output, rehearse

__all__ = ["Prepared", "frames_of_sheet", "prepare", "seconds_running", "times_text"]

_FEW = 8  # frames of a small model whose writing is timed
_BLENDER = 20.0  # seconds, which starting it twice and exporting usually need
_COLUMNS, _ROWS, _PANEL = 5, 6, (300, 300)  # of a contact sheet: panels, with some to spare
_PICTURE = 0.25  # of the time limit, for the picture, which may have fewer frames
_USUAL_BONES = 24  # where a tolerance will decide
_LEAST = 0.05  # of the time limit, for the solver: one model is made in any case


class Prepared(NamedTuple):
    """What the solver may take, and what is known of the rest.

    Attributes
    ----------
    left : float or None
        Seconds for the solver.
    compiling : float
        Seconds that went into it.
    panel : float
        Seconds of one panel of the picture; 0 where nobody has to know.
    """

    left: float | None
    compiling: float
    panel: float


def seconds_running() -> float:
    """How long this process has been running; its processor time where nobody knows."""
    spent = time.process_time()
    try:
        with open("/proc/self/stat", "rb") as file:
            fields = file.read().rpartition(b")")[2].split()  # the name before may hold anything
        ticks = int(fields[19]) / os.sysconf("SC_CLK_TCK")
        age = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks
    except (AttributeError, IndexError, OSError, ValueError):
        return spent
    return max(age, spent)


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
) -> Prepared:
    """Rehearse the outputs, given with their options, and compile.

    Under a time limit, saving is timed beforehand, and what it will need is set aside.
    """
    frames, needed, panel = sum(len(shot) for shot in shots), 0.0, 0.0
    with output.waiting("trying the outputs"):
        for path, options in outputs.items():
            rehearse(shots[0], path, options, frames=frames, clips=clips)
            if time_limit is not None:
                count = bones or _USUAL_BONES
                needed += _seconds_to_save(shots[0], path, options, frames=frames, bones=count)
        if picture is not None and time_limit is not None:
            panel = _seconds_of_panel(shots[0])
            needed += min(_COLUMNS * _ROWS * panel, _PICTURE * time_limit)
    with output.waiting("compiling"):
        from ..solver.warmup import compile_kernels

        compiling = compile_kernels()
    if time_limit is None:
        return Prepared(None, compiling, panel)
    left = time_limit - (time.perf_counter() - began)
    return Prepared(max(left - needed, _LEAST * time_limit), compiling, panel)


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


def frames_of_sheet(time_limit: float | None, began: float, panel: float) -> int:
    """How many frames of a contact sheet can be drawn within the time limit; at least one."""
    if time_limit is None:
        return _COLUMNS
    left = time_limit - (time.perf_counter() - began)
    return int(min(_COLUMNS, max(1, left // max(_ROWS * panel, 1e-3))))


def _seconds_of_panel(sequence: MeshSequence) -> float:
    """About how long one panel of a contact sheet will take."""
    from ..render.figures import render_frame

    render_frame(sequence, 0, size=_PANEL)  # compiles
    began = time.perf_counter()
    render_frame(sequence, 0, size=_PANEL)
    return time.perf_counter() - began


def times_text(
    total: float, loading: float, compiling: float, solving: float, saving: float
) -> str:
    """Seconds of all and of its parts, in one line."""
    parts = {"loading": loading, "compiling": compiling, "solving": solving, "saving": saving}
    shown = [f"{name} {seconds:.1f} s" for name, seconds in parts.items() if seconds > 0.05]
    return ", ".join([f"{total:.1f} s", *shown])
