"""Motion capture for a network's body: ``motion_capture.py dress walk.bvh walk.npz``.

``garmentnet predict`` and ``docs/gallery/live/page.py`` take the file that is written.  Joints are
matched by name; see :func:`benchmarks.garment.scenes.retarget.retarget`.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.garment.scenes.bvh import read_bvh
from benchmarks.garment.scenes.retarget import retarget
from garmentnet.networks.checkpoint import load_checkpoint

if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("model", "source", "target"):
        options.add_argument(name)
    given = options.parse_args()
    subject = load_checkpoint(given.model).subject
    motion = retarget(read_bvh(given.source), subject.skeleton, fps=subject.fps)
    np.savez(given.target, joints=motion.joints, fps=subject.fps)
