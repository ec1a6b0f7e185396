"""A rig found from some clips of a character, in the poses of a clip that it has never seen.

    python benchmarks/accuracy/other_clip.py FOX.glb --learn Survey Walk --pose Run

The rig comes from the vertices of the clips to learn alone.  The other clip is explained by
rotations of its joints and the place of its root; weights, rest pose and joints stay.  Then the
rig is posed by these rotations, and frames of the true animation and of the rig are
drawn above each other.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks.common import IMAGES, machine, tell
from ssdr.render import contact_sheet, write_picture


def _rmse(sequence: ssdr.MeshSequence, model: ssdr.Skinning) -> float:
    squared = ((model.skin() - sequence.vertices) ** 2).sum(axis=-1)
    return float(np.sqrt(squared.mean()) / sequence.diagonal())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--learn", nargs="+", required=True, metavar="CLIP")
    parser.add_argument("--pose", required=True, metavar="CLIP")
    parser.add_argument("--bones", type=int, default=20)
    parser.add_argument("--effort", default="balanced", choices=["fast", "balanced", "best"])
    parser.add_argument("--rng", type=int, default=0)
    parser.add_argument("--columns", type=int, default=5)
    parser.add_argument("--picture", type=Path, default=IMAGES / "other_clip.png")
    args = parser.parse_args()
    learned = [ssdr.load(args.file, clip=clip) for clip in args.learn]
    unseen = ssdr.load(args.file, clip=args.pose)
    rig = ssdr.decompose(
        learned, bones=args.bones, hierarchy="rigid", effort=args.effort, rng=args.rng
    ).skinning
    motion = ssdr.decompose(
        unseen,
        skeleton=rig,
        indices=rig.indices,
        weights=rig.weights,
        rest=rig.rest,
        influences=rig.n_influences,
    ).skinning
    roots = np.flatnonzero(rig.parents < 0)
    at = rig.joint_positions[roots]
    moved = motion.transforms[:, roots]
    places = np.einsum("frab,rb->fra", moved[..., :3], at) + moved[..., 3]
    posed = rig.pose(motion.local_transforms()[..., :3], places)
    frames = ssdr.MeshSequence(np.concatenate([clip.vertices for clip in learned]))
    print(f"RMSE of {' and '.join(args.learn)}: {_rmse(frames, rig):.2%} of the diagonal")
    print(f"RMSE of {args.pose}, by rotations: {_rmse(unseen, posed):.2%}")
    away = np.linalg.norm(posed.skin() - unseen.vertices, axis=-1).max() / unseen.diagonal()
    print(f"largest distance of a vertex there: {away:.2%}")
    columns = np.linspace(0, len(unseen) - 1, args.columns).round().astype(int).tolist()
    sheet = contact_sheet(
        posed,
        reference=unseen,
        frames=columns,
        styles=["weights", "bones"],
        row_names=[args.pose, "the rig, posed", "its joints"],
        title=f"{args.file.stem}: a rig of {' and '.join(args.learn)} in poses of {args.pose}",
    )
    write_picture(sheet, args.picture)
    print(tell(machine()))


if __name__ == "__main__":
    main()
