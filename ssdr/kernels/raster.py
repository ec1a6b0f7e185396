"""Depth-buffered rasterisation of triangles and balls, one band of rows at a time."""

from __future__ import annotations

import numpy as np

from .policy import kernel


@kernel
def raster_triangles(points, faces, depth, index, first, last):
    """Find the nearest triangle at the centre of each pixel in the rows first..last.

    points  (V, 3)  float64  x and y in pixels, then nearness, in
    faces   (T, 3)  int32    vertices of triangles, in
    depth   (H, W)  float64  nearness of the nearest triangle so far, updated
    index   (H, W)  int32    index of that triangle, updated

    Nearness is larger for nearer points and linear over the screen.  It is NaN behind the camera;
    triangles with such a vertex are left out.
    """
    width = depth.shape[1]
    for t in range(faces.shape[0]):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        xa, ya, za = points[a, 0], points[a, 1], points[a, 2]
        xb, yb, zb = points[b, 0], points[b, 1], points[b, 2]
        xc, yc, zc = points[c, 0], points[c, 1], points[c, 2]
        if not np.isfinite(za + zb + zc):
            continue
        low, high = min(ya, yb, yc), max(ya, yb, yc)
        if high < first + 0.5 or low > last - 0.5:
            continue
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if area == 0.0:
            continue
        left = max(0.0, np.ceil(min(xa, xb, xc) - 0.5))
        right = min(float(width), np.floor(max(xa, xb, xc) - 0.5) + 1.0)
        top = max(float(first), np.ceil(low - 0.5))
        bottom = min(float(last), np.floor(high - 0.5) + 1.0)
        for row in range(int(top), int(bottom)):
            y = row + 0.5
            for column in range(int(left), int(right)):
                x = column + 0.5
                u = ((xb - x) * (yc - y) - (xc - x) * (yb - y)) / area
                v = ((xc - x) * (ya - y) - (xa - x) * (yc - y)) / area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                near = u * za + v * zb + w * zc
                if near > depth[row, column]:
                    depth[row, column] = near
                    index[row, column] = t


@kernel
def raster_balls(balls, depth, index, first, last):
    """Find the nearest ball at the centre of each pixel in the rows first..last.

    balls  (N, 5)  float64  x, y and radius in pixels, nearness of the centre, and how much larger
                            the nearness of the ball's nearest point is, in
    depth  (H, W)  float64  nearness of the nearest ball so far, updated
    index  (H, W)  int32    index of that ball, updated
    """
    width = depth.shape[1]
    for k in range(balls.shape[0]):
        x0, y0, radius, near0, rise = balls[k]
        if not np.isfinite(near0) or y0 + radius < first or y0 - radius > last:
            continue
        for row in range(max(first, int(y0 - radius)), min(last, int(y0 + radius) + 1)):
            y = (row + 0.5 - y0) / radius
            for column in range(max(0, int(x0 - radius)), min(width, int(x0 + radius) + 1)):
                x = (column + 0.5 - x0) / radius
                rest = 1.0 - x * x - y * y
                if rest < 0.0:
                    continue
                near = near0 + rise * np.sqrt(rest)
                if near > depth[row, column]:
                    depth[row, column] = near
                    index[row, column] = k
