# mypy: ignore-errors
"""Kernels beside those of the simulator; warp gives their annotations its own meaning."""

import warp as wp


@wp.kernel
def signed_depth(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
    i = wp.tid()
    p = points[i]
    # By the winding number: the normal of the nearest face was seen to call a point inside that was
    # 60 mm outside, where two limbs are equally near.  Distances in metres.
    query = wp.mesh_query_point_sign_winding_number(mesh, p, 10.0, 2.0, 0.5)
    if query.result:
        q = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        out[i] = -query.sign * wp.length(p - q)
    else:
        out[i] = -10.0
