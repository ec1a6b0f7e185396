"""Motion capture for a network's body: ``motion_capture.py dress walk.bvh walk.npz``.

``garmentnet predict`` and ``export`` take the file that is written.  Joints are matched by name;
see :func:`benchmarks.garment.scenes.retarget.retarget`.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.garment.scenes.bvh import read_bvh
from benchmarks.garment.scenes.retarget import retarget
from garmentnet.networks.checkpoint import load_checkpoint

if __name__ == "__main__":
    model, source, target = sys.argv[1:]
    subject = load_checkpoint(model).subject
    np.savez(target, joints=retarget(read_bvh(source), subject.skeleton, fps=subject.fps).joints)
