"""Compiled loops of the cloth simulator: extended position-based dynamics with small steps.

A substep predicts every free vertex from its velocity, sweeps once over all constraints, pushes the
vertices out of the body and takes the velocities from the displacements.  Many substeps with one
sweep each converge better than few substeps with many sweeps (Macklin et al. 2019).

Positions and velocities are flat float32 arrays ``(3 V,)``: x, y, z of each vertex in turn.  They
are relative to an origin near the body's root, so that float32 resolves micrometres.

References
----------
Macklin, Müller, Chentanez, "XPBD: Position-Based Simulation of Compliant Constrained Dynamics",
MIG 2016.  Macklin et al., "Small Steps in Physics Simulation", SCA 2019.
"""
