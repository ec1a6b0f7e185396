"""Milliseconds that the page of a garment predicts a frame in, in Chromium without a screen.

The garment that ships (2,100 vertices), and one of 3,000 vertices with random weights and the sizes
of ``rooted`` (80 bones, GRUs of 600 and 256, 64 components)::

    python benchmarks/garment/page_speed.py

Each page plays; the times are those that the page measures itself, of the last 300 frames of
twenty seconds.  On Linux, the software that stands for a graphics card is kept to the second core.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / "tests"))


from benchmarks import common  # noqa: E402

PERCENTILES = (5, 50, 95)
WATCH = "new Promise(done => setTimeout(() => done(garmentnet.times), 20000))"


def part_cores() -> None:
    """Give the threads that draw, and those that predict, a core each."""
    for core, kind in enumerate(("renderer", "gpu-process")):
        found = subprocess.run(["pgrep", "-f", f"type={kind}"], capture_output=True, text=True)
        for process in found.stdout.split():
            for thread in Path(f"/proc/{process}/task").iterdir():
                os.sched_setaffinity(int(thread.name), {core})


def main() -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    from garmentnet.data.parameters import SimulationParameters
    from garmentnet.runtime import load_live
    from garmentnet.scenes.dance.choreography import dance
    from garmentnet.viewer import Take, write_page
    from helpers import live_garment
    from helpers.browser import Browser

    rows: list[common.Row] = []
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        ships = load_live("dress")
        poses = dance(ships.subject.skeleton, seed=20000, frames=600, fps=30.0).joints
        sizes = {"high": {"hidden": 256, "rank": 64}, "low": {"hidden": 600}}
        large = live_garment.live(folder, vertices=3000, bones=80, condition=True, **sizes)
        cases = {
            "the dress that ships": (ships, poses),
            "3,000 vertices, rooted": (large, live_garment.motion(20.0)),
        }
        for name, (garment, joints) in cases.items():
            write_page(
                garment,
                [Take("a", joints)],
                folder / "page.html",
                parameters=SimulationParameters(),
            )
            with Browser(folder) as tab:
                tab.open(folder / "page.html")
                tab.value("garmentnet.ready.then(() => garmentnet.set({ playing: true }))")
                if sys.platform == "linux":
                    part_cores()
                times = np.percentile(tab.value(WATCH), PERCENTILES)
            row: common.Row = {"garment": name}
            rows.append(row | {f"p{p}": float(t) for p, t in zip(PERCENTILES, times, strict=True)})
    print(common.tell(common.machine()))
    print(common.table(rows, ["garment", *(f"p{p}" for p in PERCENTILES)]))


if __name__ == "__main__":
    main()
