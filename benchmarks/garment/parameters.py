"""What the simulation parameters do, in the simulated cloth and in an ensemble's answer.

One motion is simulated with one parameter at the end of its range at a time; the
ensemble answers for the same.  Written are a table, a picture of each pair and
the pivots' weights over a sweep of each parameter::

    python benchmarks/garment/parameters.py ENSEMBLE.safetensors --out out/parameters

Needs garmentnet.  Simulations are kept in the
folder and made once.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from garmentnet.data.parameters import SimulationParameters
from garmentnet.drawing.dressed import dressed, outfit_parts
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.networks.features import PoseFeatures
from garmentnet.prediction.prediction import predict
from garmentnet.scenes.cloth import Cloth
from garmentnet.scenes.dance.choreography import dance
from garmentnet.scenes.scene_file import load_data_set
from garmentnet.scenes.simulator import simulate
from ssdr.laplacian import LaplacianSmoother
from ssdr.render import render_frame

LENGTH = 0.02  # m, of the split
ENDS = {
    "bending": (0.2, 2.0, "soft", "stiff"),
    "density": (0.1, 0.3, "light", "heavy"),
    "time_scale": (0.7, 1.3, "slow", "fast"),
}


def simulated(
    data_set: Any, motion: Any, parameters: SimulationParameters, folder: Path
) -> np.ndarray:
    """Vertices ``(F, V, 3)`` of a motion, from the folder or simulated."""
    name = "-".join(f"{v:g}" for v in dataclasses.astuple(parameters))
    path = folder / f"simulated-{name}.npy"
    if path.is_file():
        return np.asarray(np.load(path, allow_pickle=False))
    body = data_set.make_body()
    cloth = Cloth(body, data_set.make_garment(body), data_set.solver)
    result = simulate(cloth, motion, parameters)
    if not result.quality.accepted:
        raise SystemExit(f"{parameters}: {result.quality.reason}")
    np.save(path, result.vertices, allow_pickle=False)
    return result.vertices


class Measures:
    """Depth of creases and distance from rest, over the vertices that are not pinned."""

    def __init__(self, garment: Any, skeleton: Any, joints: np.ndarray, fps: float) -> None:
        self.smoother = LaplacianSmoother(garment.rest, garment.faces, LENGTH)
        self.free = ~garment.pinned
        reader = PoseFeatures(skeleton, _heading_frame(), fps)
        _, self.frame, _ = reader(joints)
        place = skeleton.positions(skeleton_rest(joints.shape[1]))[0, 0]
        self.rest = np.asarray(garment.rest, float) - place

    def __call__(self, vertices: np.ndarray) -> dict[str, float]:
        high = vertices - np.asarray(self.smoother.smooth(vertices))
        local = (vertices - self.frame[:, None, :, 3]) @ self.frame[..., :3]
        gap = (local - self.rest)[:, self.free]
        return {
            "creases_mm": 1e3 * float(np.sqrt((high[:, self.free] ** 2).sum(-1).mean())),
            "from_rest_mm": 1e3 * float(np.sqrt((gap**2).sum(-1).mean())),
        }


def _heading_frame() -> Any:
    from garmentnet.configs.config import FeatureOptions

    return FeatureOptions(heading_free=True, translation=False, frame="heading")


def skeleton_rest(joints: int) -> np.ndarray:
    """The rest pose as joint transforms ``(1, J, 3, 4)``."""
    return np.tile(np.eye(3, 4), (1, joints, 1, 1))


def weight_sweeps(model: Any, base: SimulationParameters, steps: int = 41) -> dict[str, Any]:
    """Weights of all pivots over each parameter's range, the others at the base."""
    found = {}
    for key, (low, high, _, _) in ENDS.items():
        at = (
            np.geomspace(low, high, steps) if key != "time_scale" else np.linspace(low, high, steps)
        )
        rows = [
            model.ensemble.weights(dataclasses.replace(base, **{key: float(x)}).normalised())
            for x in at
        ]
        found[key] = (at, np.stack(rows))
    return found


def draw_weights(model: Any, sweeps: dict[str, Any], path: Path) -> None:
    plt = common.pyplot()
    figure, axes = plt.subplots(1, len(sweeps), figsize=(13, 3.6), sharey=True)
    for axis, (key, (at, weights)) in zip(axes, sweeps.items(), strict=True):
        for k, p in enumerate(model.parameters):
            label = f"{p.bending:g}, {p.density:g}, {p.time_scale:g}"
            axis.plot(at, weights[:, k], label=label, linewidth=1.8)
        axis.set_xlabel(key.replace("_", " "))
        if key != "time_scale":
            axis.set_xscale("log")
            marks = [0.2, 0.5, 1, 2] if key == "bending" else [0.1, 0.15, 0.2, 0.3]
            axis.set_xticks(marks, [f"{m:g}" for m in marks])
            axis.minorticks_off()
    axes[0].set_ylabel("weight of the pivot")
    axes[-1].legend(
        title="pivot: bending, density, time",
        fontsize=7,
        title_fontsize=8,
        loc="upper left",
        bbox_to_anchor=(1, 1),
    )
    common.save_figure(figure, path)


def pictures(
    data_set: Any, motion: Any, meshes: dict[str, list[np.ndarray]], frames: list[int], path: Path
) -> None:
    """Rows: one a way of making; columns: low and high end at each frame."""
    body = data_set.make_body()
    garment = data_set.make_garment(body)
    rig = body.skinning
    from ssdr.skinning import skin

    skins = np.asarray(skin(rig.rest, rig.indices, rig.weights, motion.joints), np.float32)
    root = body.skeleton.positions(motion.joints)[:, 0]
    size = 300
    parts = outfit_parts(rig.n_vertices, len(garment.rest))
    names = list(meshes)
    page = Image.new("RGB", (size * 2 * len(frames), (size + 22) * len(names)), "white")
    draw = ImageDraw.Draw(page)
    for r, name in enumerate(names):
        for e, cloth in enumerate(meshes[name]):
            # Not vertically, so that jumps stay visible.
            place = root[:, None] * np.array([1.0, 0.0, 1.0])
            faces = rig.faces, garment.faces
            scene = dressed(skins - place, cloth - place, *faces, data_set.fps, name)
            for c, frame in enumerate(frames):
                tile = render_frame(scene, frame, size=(size, size), azimuth=20, parts=parts)
                x, y = (2 * c + e) * size, r * (size + 22)
                page.paste(tile, (x, y + 22))
                draw.text((x + 6, y + 5), f"{name.split('|')[e]}, frame {frame}", "black")
    page.save(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("ensemble", type=Path, nargs="?", help="none: only the simulation")
    parser.add_argument("--out", type=Path, default=Path("out/parameters"))
    parser.add_argument("--data-set", default="small")
    parser.add_argument("--seed", type=int, default=77, help="of the dance; in no data set")
    parser.add_argument("--frames", type=int, default=120)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    data_set = load_data_set(options.data_set)
    body = data_set.make_body()
    garment = data_set.make_garment(body)
    motion = dance(body.skeleton, seed=options.seed, frames=options.frames, fps=data_set.fps)
    model = load_checkpoint(options.ensemble) if options.ensemble else None
    measure = Measures(garment, body.skeleton, motion.joints, data_set.fps)
    base = data_set.base.parameters
    rows, shown = [], {}
    for key, (low, high, a, b) in ENDS.items():
        both: list[list[np.ndarray]] = [[], []]
        for value, word in ((low, a), (high, b)):
            parameters = dataclasses.replace(base, **{key: value})
            truth = simulated(data_set, motion, parameters, options.out)
            both[0].append(truth)
            row = {"parameter": key, "value": value, "is": word}
            row |= {f"simulated_{k}": v for k, v in measure(truth).items()}
            if model is not None:
                answer = model.predict(motion.joints, parameters)
                # Drawn as a user gets it, measured as the networks give it.
                drawn = predict(model, motion.joints, parameters)
                both[1].append(np.asarray(drawn.cloth.vertices))
                row |= {f"predicted_{k}": v for k, v in measure(answer).items()}
                gap = ((answer - truth).astype(float) ** 2).sum(-1).mean()
                row["rmse_mm"] = 1e3 * float(np.sqrt(gap))
            rows.append(row)
        shown[f"{a}|{b}"] = both[0]
        if model is not None:
            shown[f"{a}, predicted|{b}, predicted"] = both[1]
    print(common.table(rows, list(rows[0])))
    document: dict[str, Any] = {"rows": rows, "seed": options.seed, "frames": options.frames}
    if model is not None:
        sweeps = weight_sweeps(model, base)
        document["weights"] = {
            key: {
                "least": float(w.min()),
                "sum_error": float(np.abs(w.sum(1) - 1).max()),
                "largest_step": float(np.abs(np.diff(w, axis=0)).max()),
            }
            for key, (_, w) in sweeps.items()
        }
        print(document["weights"])
        draw_weights(model, sweeps, options.out / "weights.png")
    at = [options.frames // 3, 2 * options.frames // 3, options.frames - 1]
    pictures(data_set, motion, shown, at, options.out / "parameters.png")
    common.write_json(options.out / "parameters.json", document)


if __name__ == "__main__":
    main()
