"""The simulator's model of one garment on one body, advanced substep by substep."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.errors import InputError
from ssdr.io.registry import require
from ssdr.skinning import skin

from ..data.parameters import SimulationParameters
from .backend import load_warp
from .body import Body
from .garments import Garment

__all__ = ["Cloth", "Solver"]


# Mean edge of the standard dress at 1,900 vertices.  The simulator multiplies bending by the
# length of an edge: scaled by this over the garment's own, it means the same at any resolution.
_EDGE = 0.0276


_DENSITY = 0.2


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


class Cloth:
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
        wp, newton = load_warp(), require("newton", "scenes", "a simulation")
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
        wp = load_warp()
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
            with load_warp().ScopedCapture(device="cpu") as capture:
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
