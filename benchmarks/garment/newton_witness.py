"""Our simulator beside newton's vertex block descent, on the same scene.

Dances of the data set `dress` are simulated by both, each also from a start moved by 1 mm, on one
core one after the other::

    python benchmarks/garment/newton_witness.py --dances 6 --out out/newton
    python benchmarks/garment/newton_witness.py --first 20000 --frames 120 --dances 3 --parameters

Written are speed, stretch, vertices inside the body, chaos floor, depth of creases, distance from
rest and the distance between both; with ``--parameters`` creases and distance from rest for soft
and stiff, light and heavy, slow and fast cloth.  Needs newton 1.8.0 and warp-lang 1.19.0.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks import common
from garmentnet.configs.config import FeatureOptions
from garmentnet.data.motion import Motion, interpolate, lead_in
from garmentnet.data.parameters import SimulationParameters
from garmentnet.networks.features import PoseFeatures
from garmentnet.scenes.body import default_body
from garmentnet.scenes.cloth import Cloth
from garmentnet.scenes.cut import Cut, cut_garment
from garmentnet.scenes.dance.choreography import dance
from garmentnet.scenes.quality import judge, outside
from garmentnet.scenes.simulator import perturbation_field
from ssdr.laplacian import LaplacianSmoother
from ssdr.skinning import skin

BASE = SimulationParameters()
FPS = 30.0
FRAMES = 600  # of a training dance; a shorter one is not its beginning
SUBSTEPS, STRETCH, STRETCH_DAMPING = 40, 3e3, 1e-5
BENDING_DAMPING, DRAG, FRICTION, DISTANCE = 2e-2, 3.0, 0.1, 0.01
EDGE = 0.0276  # m; the mean edge for which newton's bending stiffness is stated
BOX = 1e3  # m; newton takes the collider's bounding box from the first pose

LENGTH = 0.02  # m, of the split
ENDS = {
    "bending": (0.2, 2.0, "soft", "stiff"),
    "density": (0.1, 0.3, "light", "heavy"),
    "time_scale": (0.7, 1.3, "slow", "fast"),
}


class Measures:
    """Depth of creases and distance from rest, over the vertices that are not pinned."""

    def __init__(self, garment: Any, skeleton: Any, joints: np.ndarray, fps: float) -> None:
        self.smoother = LaplacianSmoother(garment.rest, garment.faces, LENGTH)
        self.free = ~garment.pinned
        options = FeatureOptions(heading_free=True, translation=False, frame="heading")
        _, self.frame, _ = PoseFeatures(skeleton, options, fps)(joints)
        still = np.tile(np.eye(3, 4), (1, joints.shape[1], 1, 1))
        self.rest = np.asarray(garment.rest, float) - skeleton.positions(still)[0, 0]

    def __call__(self, vertices: np.ndarray) -> dict[str, float]:
        high = vertices - np.asarray(self.smoother.smooth(vertices))
        local = (vertices - self.frame[:, None, :, 3]) @ self.frame[..., :3]
        gap = (local - self.rest)[:, self.free]
        return {
            "creases_mm": 1e3 * float(np.sqrt((high[:, self.free] ** 2).sum(-1).mean())),
            "from_rest_mm": 1e3 * float(np.sqrt((gap**2).sum(-1).mean())),
        }


class NewtonCloth:
    """The garment in newton's ``SolverVBD``: one iteration a substep."""

    def __init__(self, body: Any, garment: Any, approach: int, settle: int) -> None:
        import newton
        import warp as wp

        wp.config.log_level = wp.LOG_ERROR
        self.newton, self.wp = newton, wp
        self.body, self.garment, self.lead = body, garment, (approach, settle)

    def simulate(
        self, joints: Any, parameters: SimulationParameters, first: int, moved: Any = None
    ) -> np.ndarray:
        dt = parameters.time_scale / FPS / SUBSTEPS
        decay = np.float32(math.exp(-DRAG * dt * 0.2 / parameters.density))
        self._build(joints[0], parameters)
        out = []
        for frame in range(len(joints)):
            if frame == first and moved is not None:
                self.states[0].particle_q.numpy()[:] += moved
            if frame > 0:
                at = np.arange(1, SUBSTEPS + 1) / SUBSTEPS
                between = interpolate(self.body.skeleton, joints[frame - 1 : frame + 1], at)
                self._advance(between, dt, decay)
            if frame >= first:
                out.append(self.states[0].particle_q.numpy().copy())
        return np.stack(out)

    def _build(self, joints: Any, parameters: SimulationParameters) -> None:
        newton, wp, g, rig = self.newton, self.wp, self.garment, self.body.skinning
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
        self.skin = skin(rig.rest, rig.indices, rig.weights, joints[None], dtype=np.float32)[0]
        # Without one triangle, under a sole, the mesh is open, and newton lets the nearest face
        # decide what is inside instead of a ray, which is wrong where limbs overlap.
        sole = int(self.skin[rig.faces, 1].mean(axis=1).argmin())
        faces = np.delete(rig.faces, sole, axis=0)
        self.collider = newton.Mesh(self.skin, faces.ravel(), compute_inertia=False)
        touch = newton.ModelBuilder.ShapeConfig(
            ke=1e4, kd=1e-3, mu=FRICTION, has_shape_collision=False
        )
        builder.add_shape_mesh(-1, mesh=self.collider, cfg=touch)
        builder.add_cloth_mesh(
            pos=wp.vec3(0.0, 0.0, 0.0),
            rot=wp.quat_identity(),
            scale=1.0,
            vel=wp.vec3(0.0, 0.0, 0.0),
            vertices=[wp.vec3(*p) for p in g.rest.astype(float).tolist()],
            indices=g.faces.ravel().tolist(),
            density=parameters.density,
            tri_ke=STRETCH,
            tri_ka=STRETCH,
            tri_kd=STRETCH_DAMPING,
            edge_ke=parameters.bending * EDGE / g.edge_length(),
            edge_kd=BENDING_DAMPING,
            particle_radius=DISTANCE,
        )
        self.pinned = np.flatnonzero(g.pinned)
        for i in self.pinned.tolist():
            builder.particle_mass[i] = 0.0
            builder.particle_flags[i] &= ~int(newton.ParticleFlags.ACTIVE)
        builder.color(include_bending=True)
        model = builder.finalize(device="cpu")
        model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e4, 1e-3, FRICTION
        model.shape_collision_aabb_lower.fill_(wp.vec3(-BOX, -BOX, -BOX))
        model.shape_collision_aabb_upper.fill_(wp.vec3(BOX, BOX, BOX))
        self.solver = newton.solvers.SolverVBD(
            model,
            iterations=1,
            particle_enable_self_contact=False,
            particle_enable_tile_solve=False,
        )
        self.pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.03)
        self.contacts, self.control = self.pipeline.contacts(), model.control()
        self.states = [model.state(), model.state()]
        start = g.rest.astype(float) @ joints[0, :, :3].T + joints[0, :, 3]
        for state in self.states:
            state.particle_q.numpy()[:] = start.astype(np.float32)
            state.particle_qd.zero_()
        self.graphs: dict[int, Any] = {}

    def _advance(self, joints: Any, dt: float, decay: Any) -> None:
        g, rig, p = self.garment, self.body.skinning, self.garment.pinned
        skins = skin(rig.rest, rig.indices, rig.weights, joints, dtype=np.float32)
        pins = skin(g.rest[p], g.indices[p], g.weights[p], joints, dtype=np.float32)
        mesh = self.collider.mesh
        for points, held in zip(skins, pins, strict=True):
            mesh.velocities.numpy()[:] = (points - self.skin) / np.float32(dt)
            mesh.points.numpy()[:] = points
            mesh.refit()
            self.skin = points
            a, b = self.states
            for state in (a, b):
                state.particle_q.numpy()[self.pinned] = held
            if id(a) not in self.graphs:
                # Recorded once: its short kernels take 1.6 times as long when launched one by one.
                with self.wp.ScopedCapture(device="cpu") as capture:
                    a.clear_forces()
                    self.pipeline.collide(a, self.contacts)
                    self.solver.step(a, b, self.control, self.contacts, dt)
                self.graphs[id(a)] = capture.graph
            self.wp.capture_launch(self.graphs[id(a)])
            b.particle_qd.numpy()[:] *= decay
            self.states = [b, a]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dances", type=int, default=6)
    parser.add_argument("--first", type=int, default=22000, help="seed of the first dance")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--parameters", action="store_true", help="the ends of each parameter too")
    parser.add_argument("--chaos", action="store_true", help="newton's chaos floor too")
    parser.add_argument("--out", type=Path, default=Path("out/newton"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    body = default_body()
    garment = cut_garment(body, Cut(vertices=2100))
    ours = Cloth(body, garment)
    approach, settle = ours.solver.approach, ours.solver.settle
    theirs = NewtonCloth(body, garment, approach, settle)
    makers = {
        "ours": lambda j, p, first, moved=None: ours.simulate(j, FPS, p, first=first, moved=moved),
        "newton": theirs.simulate,
    }
    still = np.repeat(np.eye(3, 4)[None, None], body.skeleton.n_joints, axis=1).repeat(2, axis=0)
    for make in makers.values():
        make(still, BASE, 0)  # compiles
    sets = {"base": BASE}
    if options.parameters:
        for key, (low, high, *words) in ENDS.items():
            for value, word in zip((low, high), words, strict=True):
                sets[word] = SimulationParameters(**{key: value})
    rows = []
    for seed in range(options.first, options.first + options.dances):
        length = FRAMES if seed < 21000 else options.frames
        motion = dance(body.skeleton, seed=seed, frames=length, fps=FPS)
        motion = motion.cut(0, options.frames)
        lead = lead_in(body.skeleton, motion.joints, approach, settle)
        joints = np.concatenate([lead, motion.joints]).astype(np.float32).astype(np.float64)
        measure = Measures(garment, body.skeleton, motion.joints, FPS)
        for word, parameters in sets.items():
            made = {}
            for who, make in makers.items():
                begun = time.process_time()
                made[who] = vertices = make(joints, parameters, len(lead))
                seconds = time.process_time() - begun
                row = {"who": who, "set": word, "seed": seed, "seconds": seconds}
                row |= {"frames": len(joints)} | measure(vertices)
                row |= quality(body, garment, motion, vertices)
                if word == "base" and (who == "ours" or options.chaos):
                    moved = perturbation_field(garment, 1e-3, seed)
                    again = make(joints, parameters, len(lead), moved)
                    row["chaos_mm"] = distance(vertices, again, ~garment.pinned) / math.sqrt(2)
                rows.append(row)
            rows[-1]["between_mm"] = distance(made["ours"], made["newton"], ~garment.pinned)
            print(rows[-2], rows[-1], file=sys.stderr, flush=True)
    table = [summary(rows, who, word) for word in sets for who in makers]
    print(common.table(table, list(table[0])))
    common.write_json(options.out / f"newton-{options.first}.json", {"rows": rows, "table": table})


def quality(body: Any, garment: Any, motion: Motion, vertices: np.ndarray) -> dict[str, float]:
    """Stretch and vertices inside the body, before any is pushed out of it."""
    _, depth = outside(body, garment, motion, vertices, push=False)
    q = judge(garment, motion, vertices, depth)
    return {
        "stretch_p99": q.stretch_p99,
        "stretch_max": q.stretch_max,
        "inside_percent": 100 * q.inside_fraction,
        "depth_mm": 1e3 * q.depth_max,
    }


def distance(a: np.ndarray, b: np.ndarray, chosen: np.ndarray) -> float:
    """RMS distance of the chosen vertices, mm."""
    gap = a[:, chosen].astype(float) - b[:, chosen]
    return 1e3 * float(np.sqrt((gap**2).sum(-1).mean()))


def summary(rows: list[dict[str, Any]], who: str, word: str) -> dict[str, Any]:
    """One row of the table: worst clip for stretch and depth, else over all clips."""
    part = [r for r in rows if r["who"] == who and r["set"] == word]

    def rms(key: str) -> float:
        values = [r[key] for r in part if key in r]
        return round(math.sqrt(sum(v * v for v in values) / len(values)), 2) if values else math.nan

    frames, seconds = sum(r["frames"] for r in part), sum(r["seconds"] for r in part)
    return {
        "who": who,
        "set": word,
        "frames an hour, one core": round(3600 * frames / seconds),
        "stretch p99": max(r["stretch_p99"] for r in part),
        "stretch max": max(r["stretch_max"] for r in part),
        "inside %": round(sum(r["inside_percent"] for r in part) / len(part), 4),
        "depth mm": round(max(r["depth_mm"] for r in part), 1),
        "creases mm": rms("creases_mm"),
        "from rest mm": rms("from_rest_mm"),
        "chaos mm": rms("chaos_mm"),
        "between mm": rms("between_mm"),
    }


if __name__ == "__main__":
    main()
