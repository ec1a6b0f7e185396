"""A swinging skirt of any size, as a function of the frame: any block of frames by itself.

A rig of columns of 5 bones from waist to hem, each turning about its upper end with nine
frequencies that never repeat, 48 waves that travel along the normals, and noise: of full rank, so
that no skinning fits.  How far it is from the skinning that it was made with (waves and noise
together) is the floor of the error.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay, cKDTree
from scipy.spatial.transform import Rotation

import ssdr
from benchmarks.record import read_rows, write_rows

RINGS, REACH, SWING = 5, 0.18, 0.08
WAVES, WAVE, NOISE = 48, 0.01, 0.0005  # waves and noise: RMS in units; the skirt is 2 units high
BLOCK = 250  # frames


def _tube(around: np.ndarray, height: np.ndarray) -> np.ndarray:
    around, height = np.broadcast_arrays(around, height)
    radius = 0.65 - 0.15 * height
    return np.stack([radius * np.cos(around), height, radius * np.sin(around)], axis=-1)


class Skirt:
    def __init__(self, vertices: int, columns: int, influences: int) -> None:
        rng = np.random.default_rng(0)
        self.vertices, self.columns, self.bones = vertices, columns, columns * RINGS
        k = np.arange(vertices)
        height = 2.0 * (k + 0.5) / vertices
        turned = np.mod(2.399963229728653 * k, 2 * np.pi)  # the golden angle spreads them evenly
        self.rest = _tube(turned, height)
        self.normal = np.stack([np.cos(turned), np.zeros(vertices), np.sin(turned)], axis=1)
        # Triangulated as a flat sheet: the seam stays open.
        self.faces = Delaunay(np.stack([turned * 0.5, height], axis=1)).simplices.astype(np.int32)
        around = 2 * np.pi * (np.arange(columns) + 0.5) / columns
        level = 2.0 - 2.0 * np.arange(RINGS) / RINGS
        self.around, self.joints = around, _tube(around[:, None], level)
        middle = _tube(around[:, None], level - 1.0 / RINGS).reshape(self.bones, 3)
        distance, near = cKDTree(middle).query(self.rest, k=influences)
        weights = np.exp(-((distance / REACH) ** 2)) + 1e-9
        self.weights, self.indices = weights / weights.sum(1, keepdims=True), near.astype(np.int32)
        # Swing out, swing sideways and twist of every joint: a slow field around the skirt, and
        # each bone's own; nine sines of incommensurate rates.
        self.rates = 2 * np.pi * rng.uniform(0.05, 1.6, 9) / 30
        place = np.stack([np.ones(columns), np.cos(around), np.sin(around)], axis=1)
        field = np.einsum("rdk,ck->rdc", rng.normal(size=(9, 3, 3)), place)[..., None]
        own = rng.normal(size=(9, 3, columns, RINGS))
        self.size = SWING * (0.8 * field + 0.6 * own) * np.array([1, 0.6, 0.6])[:, None, None]
        self.phase = rng.uniform(0, 2 * np.pi, (9, 3, 1, 1)) + rng.uniform(0, 1.5, own.shape)
        across = rng.integers(-6, 7, WAVES)
        along = rng.uniform(2, 25, WAVES)
        where = turned[:, None] * across + height[:, None] * along
        self.waves = np.concatenate([np.cos(where), np.sin(where)], axis=1)
        self.speed = 2 * np.pi * rng.uniform(0.1, 2.0, WAVES) / 30
        share = rng.uniform(0.5, 1.0, WAVES)
        self.share = share * WAVE * np.sqrt(2 / (share**2).sum())

    def transforms(self, frames: np.ndarray) -> np.ndarray:
        """Rigid transforms (F, B, 3, 4) of some frames."""
        angle = np.sin(
            frames[:, None, None, None, None] * self.rates[:, None, None, None] + self.phase
        )
        swing, side, twist = np.moveaxis((self.size * angle).sum(axis=1), 1, 0)
        cos, sin, none = np.cos(self.around), np.sin(self.around), np.zeros(self.columns)
        out, tangent = np.stack([cos, none, sin], axis=1), np.stack([-sin, none, cos], axis=1)
        vector = swing[..., None] * tangent[:, None] + side[..., None] * out[:, None]
        vector[..., 1] += twist
        turn = Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix()
        turn = turn.reshape(len(frames), self.columns, RINGS, 3, 3)
        result = np.empty((len(frames), self.columns, RINGS, 3, 4))
        linear = np.broadcast_to(np.eye(3), (len(frames), self.columns, 3, 3))
        shift = np.zeros((len(frames), self.columns, 3))
        for ring in range(RINGS):
            at = self.joints[:, ring]
            moved = np.einsum("tcab,cb->tca", linear, at) + shift
            linear = linear @ turn[:, :, ring]
            shift = moved - np.einsum("tcab,cb->tca", linear, at)
            result[:, :, ring, :, :3], result[:, :, ring, :, 3] = linear, shift
        return result.reshape(len(frames), self.bones, 3, 4)

    def block(self, first: int, count: int) -> tuple[np.ndarray, float]:
        """Frames (F, V, 3) in float32 and their squared distance to their own skinning."""
        frames = np.arange(first, first + count)
        exact = ssdr.skin(self.rest, self.indices, self.weights, self.transforms(frames))
        # cos(x − st) by the addition theorem: one matrix product for all frames
        turned = frames[:, None] * self.speed
        clock = np.concatenate([np.cos(turned), np.sin(turned)], axis=1) * np.tile(self.share, 2)
        waves = (clock @ self.waves.T)[..., None] * self.normal
        out = np.empty((count, self.vertices, 3), np.float32)
        for k, frame in enumerate(frames):
            rng = np.random.default_rng([1, int(frame)])
            noise = rng.standard_normal((self.vertices, 3), np.float32) * (NOISE / np.sqrt(3))
            out[k] = exact[k] + waves[k] + noise
        return out, float(((out - exact) ** 2).sum())

    def write(self, path: Path, frames: int, whole: int) -> float:
        """Write the first frames of a file of `whole` frames; returns their floor.

        Frames that an earlier call has written are kept; the others are holes in the file.
        """
        squares = read_rows(path.with_suffix(".json"))
        if not path.is_file():
            shape = (whole, self.vertices, 3)
            np.lib.format.open_memmap(path, "w+", dtype=np.float32, shape=shape).flush()
            squares = {}
        target = np.load(path, mmap_mode="r+")
        for first in range(0, frames, BLOCK):
            if str(first) not in squares:
                block, square = self.block(first, min(BLOCK, whole - first))
                target[first : first + len(block)] = block
                squares[str(first)] = {"square": square}
                write_rows(path.with_suffix(".json"), squares)
        target.flush()
        total = sum(squares[str(first)]["square"] for first in range(0, frames, BLOCK))
        return float(np.sqrt(total / (frames * self.vertices)))
