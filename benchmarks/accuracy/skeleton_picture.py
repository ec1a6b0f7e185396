"""A skeleton that is known above the one that was found from the vertices of its animation alone.

    python benchmarks/accuracy/skeleton_picture.py FOX.glb --bones 20 --effort best

Every clip of the file is learned; how near the found model comes is printed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import IMAGES, machine, tell
from ssdr.render import contact_sheet, write_picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--bones", type=int, default=20)
    parser.add_argument("--effort", default="best", choices=["fast", "balanced", "best"])
    parser.add_argument("--rng", type=int, default=0)
    parser.add_argument("--columns", type=int, default=5)
    parser.add_argument("--picture", type=Path, default=IMAGES / "skeleton_found.png")
    args = parser.parse_args()
    clips = [ssdr.load(args.file, clip=clip.name) for clip in ssdr.list_clips(args.file)]
    result = ssdr.decompose(
        clips, bones=args.bones, hierarchy="rigid", effort=args.effort, rng=args.rng
    )
    whole = np.concatenate([clip.vertices for clip in clips])
    diagonal = ssdr.MeshSequence(whole).diagonal()
    print(f"{args.file.stem}: RMSE {result.rmse / diagonal:.2g} of the diagonal")
    frames = np.linspace(0, len(whole) - 1, args.columns + 2)[1:-1].round().astype(int).tolist()
    rows = [
        contact_sheet(model, frames=frames, styles=["bones"], row_names=[name], title=title)
        for name, model, title in (
            ("in the file", ssdr.load_skinning(args.file), f"{args.file.stem}: its skeleton"),
            ("found", result.skinning, "from the vertices of its animation alone"),
        )
    ]
    sheet = Image.new("RGB", (max(r.width for r in rows), sum(r.height for r in rows)), "white")
    top = 0
    for row in rows:
        sheet.paste(row, (0, top))
        top += row.height
    write_picture(sheet, args.picture)
    print(tell(machine()))


if __name__ == "__main__":
    main()
