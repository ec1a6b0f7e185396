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
# Name, parent, offset and channels.
Joint = tuple[str, int, list[float], list[str]]
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
            text = file.read().decode("utf-8-sig")
        head, separator, tail = text.partition("MOTION")
        check(separator, "no section MOTION")
        words = iter(head.split())
        check([next(words, ""), next(words, "")] == ["HIERARCHY", "ROOT"], "no HIERARCHY of a ROOT")
        joints: list[Joint] = []
        _read_joint(words, -1, joints)
        check(next(words, None) is None, "more than one ROOT")
        names, parents, offsets, channels = zip(*joints, strict=True)
        numbers = tail.split()
        stated = numbers[:1] + numbers[2:4] == ["Frames:", "Frame", "Time:"]
        check(stated, "no 'Frames:' and 'Frame Time:' after MOTION")
        frames, step = int(numbers[1]), float(numbers[4])
        valid = frames >= 1 and _FRAME_TIMES[0] <= step <= _FRAME_TIMES[1]
        check(valid, f"{frames} frames of {step} s")
        width = sum(len(c) for c in channels)
        values = np.array(numbers[5:], dtype=np.float64)
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
        tree = names, np.array(parents, np.int32), np.array(offsets)
        return Bvh(*tree, root, rotations, 1 / step)


def _read_joint(words: Iterator[str], parent: int, joints: list[Joint]) -> None:
    """Add a joint, whose name comes next, and all below it."""
    number, offset, channels = len(joints), [0.0, 0.0, 0.0], list[str]()
    name, opening = next(words), next(words)
    check(opening == "{", f"{opening!r} in place of '{{'")
    joints.append((name, parent, offset, channels))
    for word in words:
        if word == "}":
            return
        if word == "JOINT":
            _read_joint(words, number, joints)
        elif word == "End":
            site = [next(words) for _ in range(7)]  # with braces and an offset
            check(site[0] == "Site" and site[-1] == "}", f"End {' '.join(site)}")
        elif word == "OFFSET":
            offset[:] = [float(next(words)) for _ in range(3)]
            check(np.isfinite(offset).all(), "an OFFSET that is not finite")
        elif word == "CHANNELS":
            channels[:] = [next(words) for _ in range(int(next(words)))]
            kinds = {f"{a}{k}" for a in "XYZ" for k in ("position", "rotation")}
            turns = sum(c.endswith("rotation") for c in channels)
            valid = set(channels) <= kinds and len(set(channels)) == len(channels)
            check(
                valid and turns in (0, 3), f"channels {channels}: expected three rotations or none"
            )
        else:
            raise FormatError(f"{word!r} in the hierarchy")
    raise FormatError("a hierarchy that is cut off")
