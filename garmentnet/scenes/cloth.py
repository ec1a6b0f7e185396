"""The cloth simulator newton, set up for one garment on one body and advanced in substeps."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.errors import InputError
from ssdr.skinning import skin

from ..data.parameters import SimulationParameters
from ..io.packages import require
from .backend import load_warp
from .body import Body
from .garments import Garment

__all__ = ["Cloth", "Solver"]


# Metres; mean edge of the standard dress at 1,900 vertices.  The simulator multiplies bending
# stiffness by the length of an edge.  Multiplied by this length over the garment's mean edge, the
# stiffness does not depend on resolution.
_EDGE = 0.0276
# kg/m²; the density at which `drag` is stated.
_DENSITY = 0.2
# Upper limit of every number of the solver, against typing errors.
_LARGEST = 1e8
# Metres; the bounding box of the collider, which newton takes from the first pose.
_BOX = 1e3


@dataclasses.dataclass(frozen=True)
class Solver:
    """Settings of the simulator; the defaults are measured, see docs/garment-scenes.md.

    Parameters
    ----------
    substeps, iterations : int
        Substeps in a frame, iterations in a substep.
    stretch, stretch_damping : float
        newton's ``tri_ke`` and ``tri_ka``, and ``tri_kd``.
    bending_damping : float
        newton's ``edge_kd``.
    friction : float
        Coefficient between cloth and skin.
    drag : float
        Decay rate of velocity in the cloth's time, 1/s, at 0.2 kg/m²; inversely proportional to
        the density.
    radius, gap : float
        Distance of cloth from skin, and the further distance within which contacts are searched;
        metres.
    contact, contact_damping : float
        Stiffness and damping of contact.
    approach, settle : int
        Frames in which the body moves from rest to its first pose, and in which it then waits.

    Raises
    ------
    InputError
        If a number is negative, not finite, or 0 for `substeps` and `iterations`.

    Examples
    --------
    >>> Solver(substeps=20).iterations
    1
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
            if field.type == "int" and type(value) is not int:
                raise InputError(field.name, "an integer", repr(value))
            if not (math.isfinite(value) and least <= value <= _LARGEST):
                raise InputError(field.name, f"a number >= {least}", repr(value))


class Cloth:
    """The simulator's model, its two states and the collider.

    Parameters
    ----------
    body : Body
    garment : Garment
    parameters : SimulationParameters
    how : Solver
    fps : float
    joints : (J, 3, 4) array
        The body's first pose.
    """

    def __init__(
        self,
        body: Body,
        garment: Garment,
        parameters: SimulationParameters,
        how: Solver,
        fps: float,
        joints: NDArray[np.float64],
    ) -> None:
        wp, newton = load_warp(), require("newton", "garmentnet[scenes]", "a simulation")
        self._rig, self._garment = body.skinning, garment
        self._dt = parameters.time_scale / fps / how.substeps
        self._decay = math.exp(-how.drag * self._dt * _DENSITY / parameters.density)
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
        points = self._body(joints[None])[0]
        # newton decides what is inside a closed mesh by counting the crossings of a ray, which is
        # wrong where limbs overlap.  Without one triangle, under a sole, the mesh is open and the
        # nearest face decides.
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
        # The body leaves the bounding box of its first pose.
        model.shape_collision_aabb_lower.fill_(wp.vec3(-_BOX, -_BOX, -_BOX))
        model.shape_collision_aabb_upper.fill_(wp.vec3(_BOX, _BOX, _BOX))
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
        """Advance by one substep for each of the body's poses ``(S, J, 3, 4)``."""
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

        A substep is some thirty short kernels.  Launched one by one from Python they take 1.6
        times as long, with the same bits.
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
        return np.asarray(skin(rig.rest, rig.indices, rig.weights, joints, dtype=np.float32))

    def _pins(self, joints: NDArray[np.float64]) -> NDArray[np.float32]:
        g, p = self._garment, self._garment.pinned
        return np.asarray(skin(g.rest[p], g.indices[p], g.weights[p], joints, dtype=np.float32))
