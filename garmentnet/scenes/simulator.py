"""Cloth on a moving body: newton's vertex block descent, few iterations, many substeps.

One clip runs on one core and gives the same bits every time.  What comes out is judged before
anyone learns from it.

References
----------
Chen et al., "Vertex Block Descent", SIGGRAPH 2024; the solver is newton's ``SolverVBD``, which
its authors mark experimental: its version is pinned.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.metadata
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from ssdr.errors import InputError
from ssdr.io.registry import require
from ssdr.skinning import skin

from ..data.motion import Motion, interpolate, lead_in
from ..data.parameters import SimulationParameters
from .body import Body
from .garments import Garment

__all__ = ["Gate", "Quality", "Simulated", "Solver", "judge", "simulate", "versions"]

# Mean edge of the standard dress at 1,900 vertices.  The simulator multiplies bending by the
# length of an edge: scaled by this over the garment's own, it means the same at any resolution.
_EDGE = 0.0276
_DENSITY = 0.2
_INSIDE = 5e-4


@dataclasses.dataclass(frozen=True)
class Solver:
    """How the cloth is simulated; every default was measured, see the docs.

    Parameters
    ----------
    substeps, iterations : int
        Substeps a frame, iterations a substep.
    stretch, stretch_damping : float
        ``tri_ke`` and ``tri_ka``, ``tri_kd``.
    bending_damping : float
        ``edge_kd``.
    friction : float
        Between cloth and skin.
    drag : float
        Decay of velocity, 1/s of the cloth's time, at 0.2 kg/m²; in proportion less for a
        heavier cloth.
    radius, gap : float
        Metres that cloth keeps from skin, and beyond them the distance at which contact is
        looked for.
    contact, contact_damping : float
        Stiffness and damping of contact.
    approach, settle : int
        Frames in which the body goes from rest to its first pose, and in which it then waits.
    """

    substeps: int = 40
    iterations: int = 1
    stretch: float = 3e3
    stretch_damping: float = 1e-5
    bending_damping: float = 2e-2
    friction: float = 0.1
    drag: float = 3.0
    radius: float = 0.01
    gap: float = 0.03
    contact: float = 1e4
    contact_damping: float = 1e-3
    approach: int = 15
    settle: int = 40

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            least = 1 if field.name in ("substeps", "iterations") else 0
            whole = field.type == "int"
            if whole and not (isinstance(value, int) and not isinstance(value, bool)):
                raise InputError(field.name, "an integer", repr(value))
            if not (math.isfinite(value) and least <= value <= 1e8):
                raise InputError(field.name, f"a number >= {least}", repr(value))


@dataclasses.dataclass(frozen=True)
class Gate:
    """What a clip may be at worst to be accepted.

    Parameters
    ----------
    stretch_p99, stretch_max : float
        Length of an edge over its length at rest.
    inside : float
        Share of the vertices inside the body, over all frames.
    depth : float
        Metres that a vertex may be inside the body.
    speed : float
        m/s of a vertex.
    """

    stretch_p99: float = 1.5
    stretch_max: float = 4.0
    inside: float = 0.02
    depth: float = 0.05
    speed: float = 40.0


@dataclasses.dataclass(frozen=True)
class Quality:
    """What was measured on a clip, over all frames; lengths in metres.

    Stretch is over the edges that have a free end.  A vertex counts as inside when it is more
    than half a millimetre beneath the skin.
    """

    accepted: bool
    reason: str
    stretch_p50: float
    stretch_p99: float
    stretch_max: float
    inside_fraction: float
    inside_worst_frame: float
    depth_max: float
    speed_max: float


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated clip.

    Attributes
    ----------
    vertices : (F, V, 3) float32
        The garment in every frame of the motion.
    quality : Quality
    """

    vertices: NDArray[np.float32]
    quality: Quality


def versions() -> dict[str, str]:
    """Versions of what decides the bits of a clip."""
    return {p: importlib.metadata.version(p) for p in ("newton", "warp-lang")}


def simulate(
    body: Body,
    garment: Garment,
    motion: Motion,
    parameters: SimulationParameters,
    *,
    solver: Solver | None = None,
    gate: Gate | None = None,
    seed: int = 0,
    perturbation: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> Simulated:
    """Simulate a garment on a moving body.

    Parameters
    ----------
    body : Body
    garment : Garment
        Cut on this body.
    motion : Motion
    parameters : SimulationParameters
    solver : Solver, optional
    gate : Gate, optional
    seed : int
        Of the perturbation.
    perturbation : float
        Metres (RMS) by which the settled garment is moved, smoothly and at random, before the
        first frame: what then becomes of the difference is chaos.
    progress : callable, optional
        Called with the frames done and all frames, settling included.

    Returns
    -------
    Simulated

    Raises
    ------
    InputError
        If the motion is of another skeleton or a number is not usable.
    MissingDependencyError
        Without newton or warp.
    """
    how = solver or Solver()
    if motion.joints.shape[1] != body.skeleton.n_joints:
        raise InputError("motion", f"{body.skeleton.n_joints} joints", motion.joints.shape[1])
    if not (math.isfinite(perturbation) and 0 <= perturbation <= 0.1):
        raise InputError("perturbation", "0 to 0.1 m", perturbation)
    tree = body.skeleton
    before = lead_in(tree, motion.joints, how.approach, how.settle)
    joints = np.concatenate([before, motion.joints])
    first = len(before)
    # In float32, as the store keeps them: a clip can be made again from what is stored.
    joints = joints.astype(np.float32).astype(np.float64)
    cloth = _Cloth(body, garment, parameters, how, motion.fps, joints[0])
    out = np.empty((motion.n_frames, garment.n_vertices, 3), dtype=np.float32)
    for frame in range(len(joints)):
        if frame == first and perturbation > 0:
            cloth.move(_unrest(garment, perturbation, seed))
        if frame > 0:
            steps = frame - 1 + np.arange(1, how.substeps + 1) / how.substeps
            cloth.advance(_between(tree, joints, frame, steps))
        if frame >= first:
            out[frame - first] = cloth.positions()
        if progress is not None:
            progress(frame + 1, len(joints))
        if not np.isfinite(cloth.positions()).all():
            # It does not come back: the rest would be NaN as well.
            out[max(0, frame - first) :] = np.nan
            break
    return Simulated(out, judge(body, garment, motion, out, gate))


def judge(
    body: Body,
    garment: Garment,
    motion: Motion,
    vertices: NDArray[np.float32],
    gate: Gate | None = None,
) -> Quality:
    """Measure a clip and say whether it is fit to learn from.

    Parameters
    ----------
    body, garment, motion
        As in :func:`simulate`.
    vertices : (F, V, 3) float32
    gate : Gate, optional
    """
    limit = gate or Gate()
    if not np.isfinite(vertices).all():
        frame = int((~np.isfinite(vertices)).any(axis=(1, 2)).argmax())
        return Quality(False, f"NaN from frame {frame} on", *(0.0,) * 7)
    edges = garment.edges()
    edges = edges[~garment.pinned[edges].all(axis=1)]
    rest = _lengths(garment.rest[None], edges)[0]
    stretch = _lengths(vertices, edges) / rest
    p50, p99 = (float(v) for v in np.percentile(stretch, [50, 99]))
    rig = body.skinning
    depth = np.empty((len(vertices), garment.n_vertices), dtype=np.float32)
    measure = _Depth(rig.rest, rig.faces)
    for frame in range(len(vertices)):
        pose = motion.joints[frame].astype(np.float32)
        depth[frame] = measure(skin(rig.rest, rig.joints, rig.weights, pose), vertices[frame])
    inside = (depth > _INSIDE).mean(axis=1)
    speed = 0.0
    if len(vertices) > 1:
        step = np.linalg.norm(np.diff(vertices, axis=0), axis=2)
        speed = float(step.max()) * motion.fps
    found = {
        "stretch_p50": p50,
        "stretch_p99": p99,
        "stretch_max": float(stretch.max()),
        "inside_fraction": float(inside.mean()),
        "inside_worst_frame": float(inside.max()),
        "depth_max": max(0.0, float(depth.max())),
        "speed_max": speed,
    }
    reasons = [
        f"{name} {found[name]:.4g} > {most:g}"
        for name, most in (
            ("stretch_p99", limit.stretch_p99),
            ("stretch_max", limit.stretch_max),
            ("inside_fraction", limit.inside),
            ("depth_max", limit.depth),
            ("speed_max", limit.speed),
        )
        if found[name] > most
    ]
    # Six digits say enough, and are the same on every machine that gives the same clip.
    rounded = {k: float(f"{v:.6g}") for k, v in found.items()}
    return Quality(accepted=not reasons, reason="; ".join(reasons), **rounded)


class _Cloth:
    """The simulator's model, its two states and the body within."""

    def __init__(
        self,
        body: Body,
        garment: Garment,
        parameters: SimulationParameters,
        how: Solver,
        fps: float,
        joints: NDArray[np.float64],
    ) -> None:
        wp, newton = _warp(), require("newton", "scenes", "a simulation")
        self._rig, self._garment = body.skinning, garment
        self._dt = parameters.time_scale / fps / how.substeps
        self._decay = math.exp(-how.drag * self._dt * _DENSITY / parameters.density)
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
        points = self._body(joints[None])[0]
        # Without one triangle, under a sole, the mesh counts as open, and inside is told from
        # the nearest face.  Rays through a body whose limbs overlap would tell it wrongly.
        sole = int(points[self._rig.faces, 1].mean(axis=1).argmin())
        faces = np.delete(self._rig.faces, sole, axis=0)
        self._collider = newton.Mesh(points, faces.ravel(), compute_inertia=False)
        touch = newton.ModelBuilder.ShapeConfig(
            ke=how.contact, kd=how.contact_damping, mu=how.friction, has_shape_collision=False
        )
        builder.add_shape_mesh(-1, mesh=self._collider, cfg=touch)
        turn = joints[0]
        placed = garment.rest.astype(np.float64)
        builder.add_cloth_mesh(
            pos=wp.vec3(0.0, 0.0, 0.0),
            rot=wp.quat_identity(),
            scale=1.0,
            vel=wp.vec3(0.0, 0.0, 0.0),
            vertices=[wp.vec3(*p) for p in placed.tolist()],
            indices=garment.faces.ravel().tolist(),
            density=parameters.density,
            tri_ke=how.stretch,
            tri_ka=how.stretch,
            tri_kd=how.stretch_damping,
            edge_ke=parameters.bending * _EDGE / garment.edge_length(),
            edge_kd=how.bending_damping,
            particle_radius=how.radius,
        )
        for i in np.flatnonzero(garment.pinned).tolist():
            builder.particle_mass[i] = 0.0
            builder.particle_flags[i] &= ~int(newton.ParticleFlags.ACTIVE)
        builder.color(include_bending=True)
        self._model = model = builder.finalize(device="cpu")
        model.soft_contact_ke = how.contact
        model.soft_contact_kd = how.contact_damping
        model.soft_contact_mu = how.friction
        # The body dances out of the box that it was built in.
        model.shape_collision_aabb_lower.fill_(wp.vec3(-1e3, -1e3, -1e3))
        model.shape_collision_aabb_upper.fill_(wp.vec3(1e3, 1e3, 1e3))
        self._solver = newton.solvers.SolverVBD(
            model,
            iterations=how.iterations,
            particle_enable_self_contact=False,
            particle_enable_tile_solve=False,
        )
        self._pipeline = newton.CollisionPipeline(model, soft_contact_gap=how.gap)
        self._contacts = self._pipeline.contacts()
        self._control = model.control()
        self._states = [model.state(), model.state()]
        start = (placed @ turn[:, :3].T + turn[:, 3]).astype(np.float32)
        for state in self._states:
            state.particle_q.numpy()[:] = start
            state.particle_qd.zero_()
        self._pinned = np.flatnonzero(garment.pinned)
        self._skin = points
        self._graphs: dict[int, Any] = {}

    def positions(self) -> NDArray[np.float32]:
        return np.array(self._states[0].particle_q.numpy(), dtype=np.float32)

    def move(self, by: NDArray[np.float32]) -> None:
        self._states[0].particle_q.numpy()[:] += by

    def advance(self, joints: NDArray[np.float64]) -> None:
        """Go on by one substep for each of the body's poses ``(S, J, 3, 4)``."""
        wp = _warp()
        skins, pins = self._body(joints), self._pins(joints)
        mesh = self._collider.mesh
        for points, held in zip(skins, pins, strict=True):
            mesh.velocities.numpy()[:] = (points - self._skin) / np.float32(self._dt)
            mesh.points.numpy()[:] = points
            mesh.refit()
            self._skin = points
            a, b = self._states
            for state in (a, b):
                state.particle_q.numpy()[self._pinned] = held
            wp.capture_launch(self._recorded(a, b))
            b.particle_qd.numpy()[:] *= np.float32(self._decay)
            self._states = [b, a]

    def _recorded(self, a: Any, b: Any) -> Any:
        """One substep from state `a` to `b`, recorded once and replayed.

        A substep is some thirty short kernels: launched from Python each time they take 1.6
        times as long, for the same bits.
        """
        if id(a) not in self._graphs:
            with _warp().ScopedCapture(device="cpu") as capture:
                a.clear_forces()
                self._pipeline.collide(a, self._contacts)
                self._solver.step(a, b, self._control, self._contacts, self._dt)
            self._graphs[id(a)] = capture.graph
        return self._graphs[id(a)]

    def _body(self, joints: NDArray[np.float64]) -> NDArray[np.float32]:
        rig = self._rig
        return np.asarray(skin(rig.rest, rig.joints, rig.weights, joints, dtype=np.float32))

    def _pins(self, joints: NDArray[np.float64]) -> NDArray[np.float32]:
        g, p = self._garment, self._garment.pinned
        return np.asarray(skin(g.rest[p], g.joints[p], g.weights[p], joints, dtype=np.float32))


class _Depth:
    """How deep points are inside a mesh of fixed topology; negative outside."""

    def __init__(self, points: NDArray[np.float32], faces: NDArray[np.int32]) -> None:
        wp = _warp()
        self._mesh = wp.Mesh(
            points=wp.array(points, dtype=wp.vec3, device="cpu"),
            indices=wp.array(faces.ravel(), dtype=wp.int32, device="cpu"),
            support_winding_number=True,
        )

    def __call__(self, points: NDArray[np.float32], at: NDArray[np.float32]) -> NDArray[np.float32]:
        wp = _warp()
        self._mesh.points.numpy()[:] = points
        self._mesh.refit()
        places = wp.array(at, dtype=wp.vec3, device="cpu")
        out = wp.zeros(len(at), dtype=wp.float32, device="cpu")
        wp.launch(_depth_kernel(), dim=len(at), inputs=[self._mesh.id, places, out], device="cpu")
        return np.array(out.numpy())


@functools.cache
def _depth_kernel() -> Any:
    from . import warp_kernels

    return warp_kernels.signed_depth


@functools.cache
def _warp() -> Any:
    wp = require("warp", "scenes", "a simulation")
    # Every process would say again that there is no GPU, and what it compiled.
    wp.config.log_level = wp.LOG_ERROR
    return wp


def _between(
    tree: Any, joints: NDArray[np.float64], frame: int, steps: NDArray[np.float64]
) -> NDArray[np.float64]:
    return interpolate(tree, joints[frame - 1 : frame + 1], steps - (frame - 1))


def _lengths(vertices: NDArray[np.float32], edges: NDArray[np.int32]) -> NDArray[np.float32]:
    return np.asarray(np.linalg.norm(vertices[:, edges[:, 0]] - vertices[:, edges[:, 1]], axis=2))


def _unrest(garment: Garment, size: float, seed: int) -> NDArray[np.float32]:
    """Smooth random displacements of free vertices, RMS of their length `size`."""
    rng = np.random.default_rng([seed, 0xC4A05])
    noise = rng.normal(size=(garment.n_vertices, 3))
    e = garment.edges()
    n = garment.n_vertices
    ones = np.ones(len(e))
    near = coo_array((ones, (e[:, 0], e[:, 1])), (n, n)).tocsr()
    near = near + near.T
    degree: NDArray[np.float64] = np.asarray(near.sum(axis=1)).ravel()[:, None]
    free = ~garment.pinned
    for _ in range(20):
        # Noise of one vertex would die at once in stretch; folds are what may go another way.
        noise = 0.5 * noise + 0.5 * np.asarray(near @ noise) / degree
        noise[~free] = 0.0
    noise *= size / math.sqrt(float((noise[free] ** 2).sum(axis=1).mean()))
    return noise.astype(np.float32)
