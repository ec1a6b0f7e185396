"""One picture: what an engine draws of a sequence, and the rest poses that it draws it from.

    python benchmarks/accuracy/rest_pose_pictures.py

From left to right: a frame of the input; a free rest pose with the normals of that mesh, as files
were written before normals were fitted; a decomposition with default options.  Below: the frame
that the default rest pose resembles, and the rest poses of both.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import EFFORTS, IMAGES, e_of, load, machine, tell
from ssdr.render import render_frame, write_picture

HEAD, GAP = 54, 8  # pixels


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence", nargs="?", default="horse_gallop")
    parser.add_argument("--bones", type=int, default=20)
    parser.add_argument("--effort", choices=EFFORTS, default="balanced")
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--azimuth", type=float, default=90.0)
    parser.add_argument("--width", type=int, default=1500)
    parser.add_argument("--picture", type=Path, default=IMAGES / "normals.webp")
    args = parser.parse_args()
    sequence = ssdr.MeshSequence(*load(args.sequence))
    found = [
        ssdr.decompose(sequence, bones=args.bones, effort=args.effort, **options).skinning
        for options in ({"rest_pose": "free", "normals": False}, {})
    ]
    free, default = dataclasses.replace(found[0], surface=None), found[1]
    titles = ["input"] + [
        f"{name}: E {e_of(sequence.vertices, model):.2f}, normals {errors.mean:.1f}° off"
        for name, model in (("free rest pose, its own normals", free), ("default", default))
        for errors in [ssdr.metrics.normals(sequence, model)]
    ]
    frame = nearest(sequence, default)
    poses = [
        ssdr.MeshSequence(pose[None], sequence.faces)
        for pose in (sequence.vertices[frame], free.rest, default.rest)
    ]
    rows = [
        (titles, [sequence, free, default], args.frame),
        ([f"input, frame {frame}", "rest pose", "rest pose"], poses, 0),
    ]
    write_picture(sheet(rows, args.width, args.azimuth), args.picture, quality=88)
    print("; ".join(titles[1:]))
    print(tell(machine()))


def nearest(sequence: ssdr.MeshSequence, model: ssdr.Skinning) -> int:
    """Frame whose edges differ least from those of a model's rest pose."""
    ends = model.faces[:, [0, 1]]
    edges = np.diff(sequence.vertices[:, ends], axis=2)
    return int(((edges - np.diff(model.rest[ends], axis=1)) ** 2).sum(axis=(1, 2, 3)).argmin())


def sheet(rows: list, width: int, azimuth: float) -> Image.Image:
    """Rows of pictures of the same size, each seen by a camera of its own and with its title."""
    wide = (width - 2 * GAP) // 3
    high = 2 * wide // 3
    page = Image.new("RGB", (width, len(rows) * (HEAD + high)), "white")
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(17)
    for row, (titles, subjects, frame) in enumerate(rows):
        for column, (title, subject) in enumerate(zip(titles, subjects, strict=True)):
            x, y = column * (wide + GAP), row * (HEAD + high)
            if isinstance(subject, ssdr.Skinning):
                one = dataclasses.replace(
                    subject, transforms=subject.transforms[[frame]], keyframes=None, clips=None
                )
            else:
                one = ssdr.MeshSequence(subject.vertices[[frame]], subject.faces)
            look = {"azimuth": azimuth, "elevation": 4.0}
            picture = render_frame(one, style="plain", size=(wide, high), **look)
            draw.text((x + 4, y + HEAD - 12), title, "#333333", font, "ls")
            page.paste(picture, (x, y + HEAD))
    return page


if __name__ == "__main__":
    main()
