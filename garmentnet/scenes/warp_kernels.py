# mypy: ignore-errors
"""Kernels of our own that run beside the simulator; warp reads their annotations its own way."""

import warp as wp


@wp.kernel
def signed_depth(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
    i = wp.tid()
    p = points[i]
    # Not by the nearest normal: near a tie of two limbs it was seen to call a point inside that
    # was 60 mm outside.
    query = wp.mesh_query_point_sign_winding_number(mesh, p, 10.0, 2.0, 0.5)
    if query.result:
        q = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        out[i] = -query.sign * wp.length(p - q)
    else:
        out[i] = -10.0
