"""Script that finds the bones, run by a Python that has ssdr: ``run_solver.py FOLDER``.

It prints a fraction and a text at each step to stderr, and the result as JSON to stdout.
"""

import dataclasses
import json
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import ssdr
from ssdr.mesh.sequence import joined


def main(folder: Path) -> None:
    """Read ``asked.json`` and ``frames.npz``, and write ``model.glb`` and ``model.npz``."""
    asked = json.loads((folder / "asked.json").read_text(encoding="utf-8"))
    with np.load(folder / "frames.npz") as held:
        vertices, faces = held["vertices"], held["faces"]
    about = {"name": asked["name"], "space": ssdr.Space(up="z")}
    shots = [
        ssdr.MeshSequence(vertices[first:stop], faces, asked["fps"], clip=name, **about)
        for name, first, stop in asked["clips"]
    ]
    options = asked["options"]
    if asked["joints"] is not None:
        options["rig"] = skeleton(**asked["joints"])

    def tell(step: Any) -> None:
        error = f", RMSE {step.rmse:.3g}" if np.isfinite(step.rmse) else ""
        print(f"{step.fraction:.3f} {step.phase}{error}", file=sys.stderr, flush=True)

    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", ssdr.SsdrWarning)
        find = ssdr.smallest if "tolerance" in options else ssdr.decompose
        found = find(shots, callback=tell, **options)
        # A key in every frame, since Blender interpolates rotations in another way.
        model = dataclasses.replace(found.skinning, keyframes=None)
        ssdr.save(model, folder / "model.glb")
    errors = ssdr.metrics.distances(joined(shots), model)
    skin = {"indices": model.indices, "weights": model.weights}
    np.savez(folder / "model.npz", rest=model.rest.astype(np.float32), **skin)
    text = (
        f"{model.n_bones} bones, RMSE {errors.percent_of_diagonal:.3g} % of the diagonal, largest "
        f"error {100 * errors.max / (errors.diagonal or 1.0):.3g} %"
    )
    held = "tolerance" not in options or found.parsimony.held
    text += "" if held else "; the tolerance is out of reach"
    said = [str(one.message) for one in warned if issubclass(one.category, ssdr.SsdrWarning)]
    print(json.dumps({"text": text, "warnings": said}))


def skeleton(names: list[str], parents: list[int], positions: list[list[float]]) -> ssdr.Skeleton:
    """Skeleton of an armature: joints, each of which moves a vertex in its place."""
    count, joints = len(names), np.array(positions, dtype=np.float64)
    skin = np.arange(count)[:, None], np.ones((count, 1)), np.eye(3, 4)[None, None].repeat(count, 1)
    tree = {"parents": parents, "joint_positions": joints, "bone_names": names}
    return ssdr.Skeleton(ssdr.Skinning(joints, *skin, **tree))


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except ssdr.SsdrError as error:
        sys.exit(str(error))
