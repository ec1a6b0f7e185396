"""Motion capture in BVH files."""

from __future__ import annotations

import dataclasses
import gzip
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssdr.common.errors import FormatError
from ssdr.io.file_errors import check, reading

Float = NDArray[np.float64]
# Limits against hostile files, far above what a motion of a body needs.
_MAX_BYTES = 1 << 28
_MAX_JOINTS = 1000
_MAX_DEPTH = 200  # levels of joints
_FRAME_TIMES = (1e-4, 10.0)  # seconds, shortest and longest


@dataclasses.dataclass(frozen=True, eq=False)
class Bvh:
    """A skeleton and its motion as a BVH file states them.

    Attributes
    ----------
    names : tuple of str
    parents : (J,) int array
        -1 for the root.
    offsets : (J, 3) float array
        Rest position of each joint relative to its parent, in the file's units.
    root : (F, 3) float array
        Translation of the root.
    rotations : (F, J, 3, 3) float array
        Rotation of each joint relative to its parent.
    fps : float
    """

    names: tuple[str, ...]
    parents: NDArray[np.int32]
    offsets: Float
    root: Float
    rotations: Float
    fps: float

    @property
    def n_frames(self) -> int:
        return len(self.root)


def read_bvh(path: str | os.PathLike[str]) -> Bvh:
    """Read a BVH file, compressed (``.gz``) or not.

    Raises
    ------
    FormatError
        If the file is damaged or not BVH.

    Examples
    --------
    >>> import tempfile
    >>> text = '''HIERARCHY
    ... ROOT Hips
    ... {
    ...   OFFSET 0 0 0
    ...   CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
    ...   End Site { OFFSET 0 1 0 }
    ... }
    ... MOTION
    ... Frames: 2
    ... Frame Time: 0.04
    ... 0 1 0 0 0 0
    ... 0 2 0 90 0 0
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "a.bvh"
    ...     _ = path.write_text(text)
    ...     motion = read_bvh(path)
    >>> motion.names, motion.fps, motion.root[1].tolist()
    (('Hips',), 25.0, [0.0, 2.0, 0.0])
    """
    source = Path(path)
    with reading(source):
        opener = gzip.open if source.suffix.lower() == ".gz" else open
        with opener(source, "rb") as file:
            data = file.read(_MAX_BYTES + 1)
        check(len(data) <= _MAX_BYTES, f"more than {_MAX_BYTES} bytes")
        text = data.decode("utf-8-sig")
        head, separator, tail = text.partition("MOTION")
        check(separator, "no section MOTION")
        names, parents, offsets, channels = _hierarchy(iter(head.split()))
        words = tail.split()
        stated = words[:1] + words[2:4] == ["Frames:", "Frame", "Time:"]
        check(stated, "no 'Frames:' and 'Frame Time:' after MOTION")
        frames, step = int(words[1]), float(words[4])
        valid = frames >= 1 and _FRAME_TIMES[0] <= step <= _FRAME_TIMES[1]
        check(valid, f"{frames} frames of {step} s")
        width = sum(len(c) for c in channels)
        values = np.array(words[5:], dtype=np.float64)
        expected = f"expected {frames} frames of {width} numbers, got {len(values)} numbers"
        check(len(values) == frames * width, expected)
        check(np.isfinite(values).all(), "NaN or Inf among the channels")
        values = values.reshape(frames, width)
        root = np.zeros((frames, 3))
        rotations = np.broadcast_to(np.eye(3), (frames, len(names), 3, 3)).copy()
        column = 0
        for j, names_of_joint in enumerate(channels):
            order, angles = "", []
            for name in names_of_joint:
                if name.endswith("position"):
                    if j == 0:
                        root[:, "XYZ".index(name[0])] = values[:, column]
                else:
                    order += name[0]
                    angles.append(values[:, column])
                column += 1
            if order:
                turned = Rotation.from_euler(order, np.stack(angles, axis=1), degrees=True)
                rotations[:, j] = turned.as_matrix()
        return Bvh(names, np.array(parents, np.int32), offsets, root, rotations, 1 / step)


def _hierarchy(
    words: Iterator[str],
) -> tuple[tuple[str, ...], list[int], Float, list[list[str]]]:
    try:
        check(next(words) == "HIERARCHY", "does not begin with HIERARCHY")
        names: list[str] = []
        parents: list[int] = []
        offsets: list[list[float]] = []
        channels: list[list[str]] = []
        stack: list[int] = []
        end = False  # inside an End Site, whose offset no joint has
        for word in words:
            if word in ("ROOT", "JOINT"):
                check((word == "ROOT") == (not names), "more than one ROOT, or none before a JOINT")
                names.append(next(words))
                parents.append(stack[-1] if stack else -1)
                offsets.append([0.0, 0.0, 0.0])
                channels.append([])
                check(len(names) <= _MAX_JOINTS, f"more than {_MAX_JOINTS} joints")
            elif word == "End":
                next(words)
                end = True
            elif word == "{":
                stack.append(-2 if end else len(names) - 1)
                check(len(stack) <= _MAX_DEPTH, f"joints nested deeper than {_MAX_DEPTH}")
            elif word == "}":
                end = False
                stack.pop()
            elif word == "OFFSET":
                values = [float(next(words)) for _ in range(3)]
                check(np.isfinite(values).all(), "an OFFSET that is not finite")
                if stack[-1] >= 0:
                    offsets[stack[-1]] = values
            elif word == "CHANNELS":
                chosen = [next(words) for _ in range(int(next(words)))]
                kinds = {f"{a}{k}" for a in "XYZ" for k in ("position", "rotation")}
                turns = sum(c.endswith("rotation") for c in chosen)
                valid = set(chosen) <= kinds and len(set(chosen)) == len(chosen) and turns in (0, 3)
                check(valid, f"channels {chosen}: expected three rotations or none")
                channels[stack[-1]] = chosen
            else:
                raise FormatError(f"{word!r} in the hierarchy")
        check(names and not stack, "a hierarchy without end")
    except (StopIteration, IndexError) as error:
        raise FormatError("a hierarchy that is cut off") from error
    return tuple(names), parents, np.array(offsets), channels
