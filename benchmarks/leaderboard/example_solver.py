"""An example of a solver for score.py and bench.py: clusters that each follow one rigid bone."""

import numpy as np
from scipy.cluster.vq import kmeans2

import ssdr


def solve(frames, faces, *, bones, influences, bone_model, rest):
    rest = frames[0] if rest is None else rest
    paths = frames.transpose(1, 0, 2).reshape(len(rest), -1)
    label = kmeans2(paths, bones, minit="++", seed=0)[1]
    weights = np.eye(bones)[label]  # (V, B): every vertex follows the bone of its cluster
    transforms = np.tile(np.eye(3, 4), (len(frames), bones, 1, 1))
    for b in set(label):
        transforms[:, b] = ssdr.kabsch(rest[label == b], frames[:, label == b])
    return rest, weights, transforms
