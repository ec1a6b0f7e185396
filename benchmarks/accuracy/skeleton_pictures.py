"""Two pictures of skeletons that were found from the vertices of a character's clips alone.

    python benchmarks/accuracy/skeleton_pictures.py Fox.glb
    python benchmarks/accuracy/skeleton_pictures.py Fox.glb --learn Survey Walk --pose Run

Without --pose: the skeleton of the file above the one that was found.  With it: frames of a clip
that was not learned above the rig in the same poses, which are rotations of its joints and the
place of its root; weights, rest pose and joints stay.  How near the models come is printed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.accuracy.known_skeletons import carried
from benchmarks.common import EFFORTS, IMAGES, machine, tell
from ssdr.render import contact_sheet, write_picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--learn", nargs="+", metavar="CLIP", help="default: every clip")
    parser.add_argument("--pose", metavar="CLIP", help="a clip that was not learned")
    parser.add_argument("--bones", type=int, default=20)
    parser.add_argument("--effort", choices=EFFORTS, help="best, with --pose balanced")
    parser.add_argument("--picture", type=Path)
    args = parser.parse_args()
    names = args.learn or [clip.name for clip in ssdr.list_clips(args.file)]
    clips = [ssdr.load(args.file, clip=name) for name in names]
    effort = args.effort or ("balanced" if args.pose else "best")
    rig = ssdr.decompose(clips, bones=args.bones, rig="rigid", effort=effort).skinning
    learned = ssdr.MeshSequence(np.concatenate([clip.vertices for clip in clips]))
    print(f"RMSE of {' and '.join(names)}: {rmse(learned, rig):.2g} of the diagonal")
    if args.pose:
        sheet = posed_sheet(args.file, rig, names, args.pose)
    else:
        sheet = found_sheet(args.file, rig)
    default = IMAGES / ("other_clip.png" if args.pose else "skeleton_found.png")
    write_picture(sheet, args.picture or default)
    print(tell(machine()))


def rmse(sequence: ssdr.MeshSequence, model: ssdr.Skinning) -> float:
    squared = ((model.skin() - sequence.vertices) ** 2).sum(axis=-1)
    return float(np.sqrt(squared.mean()) / sequence.diagonal())


def found_sheet(file: Path, rig: ssdr.Skinning) -> Image.Image:
    frames = np.linspace(0, rig.n_frames - 1, 7)[1:-1].round().astype(int).tolist()
    rows = [
        contact_sheet(model, frames=frames, styles=["bones"], row_names=[name], title=title)
        for name, model, title in (
            ("in the file", ssdr.load_skinning(file), f"{file.stem}: its skeleton"),
            ("found", rig, "from the vertices of its animation alone"),
        )
    ]
    sheet = Image.new("RGB", (max(r.width for r in rows), sum(r.height for r in rows)), "white")
    sheet.paste(rows[0], (0, 0))
    sheet.paste(rows[1], (0, rows[0].height))
    return sheet


def posed_sheet(file: Path, rig: ssdr.Skinning, names: list[str], clip: str) -> Image.Image:
    unseen = ssdr.load(file, clip=clip)
    start = ssdr.Start(rest=rig.rest, indices=rig.indices, weights=rig.weights)
    motion = ssdr.decompose(
        unseen, rig=ssdr.Skeleton(rig), start=start, influences=rig.n_influences
    ).skinning
    roots = np.flatnonzero(rig.parents < 0)
    places = [carried(motion.transforms[:, r], rig.joint_positions[r]) for r in roots]
    posed = rig.pose(motion.local_transforms()[..., :3], np.stack(places, axis=1))
    away = np.linalg.norm(posed.skin() - unseen.vertices, axis=-1).max() / unseen.diagonal()
    print(f"RMSE of {clip}, by rotations: {rmse(unseen, posed):.2%}, at most {away:.2%}")
    return contact_sheet(
        posed,
        reference=unseen,
        frames=np.linspace(0, len(unseen) - 1, 5).round().astype(int).tolist(),
        styles=["weights", "bones"],
        row_names=[clip, "the rig, posed", "its joints"],
        title=f"{file.stem}: a rig of {' and '.join(names)} in poses of {clip}",
    )


if __name__ == "__main__":
    main()
