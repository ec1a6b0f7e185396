"""Kernels of one sweep over the edges, and of one over the hinges, of the cloth.

A constraint C(x) = 0 with compliance α (the inverse of its stiffness) and time constant τ of its
damping is projected by (XPBD, equation 26, with one iteration per step, so that λ starts at 0)

    Δλ = −(C + γ ∇C·(x − x_prev)) / ((1 + γ) Σ w |∇C|² + α / h²),   γ = τ / h,   Δx = w ∇C Δλ

where w are inverse masses and h is the length of the substep.  The damping coefficient is
proportional to the stiffness: β = τ / α.

Constraints come in chunks of :data:`LANES` that share no free vertex (see
:mod:`.chunks`).  Each chunk is gathered to a buffer, computed there, which
the compiler vectorises, and scattered.  Row r of a chunk begins at ``r * LANES``.
"""

from __future__ import annotations

import math
from typing import Any

from .policy import LANES, ONE, REAL, TINY, TWO, kernel

BUFFER_ROWS = 18
_ZERO, _UNIT, _DOUBLE = REAL(0), REAL(1), REAL(2)
_A, _HALF_PI = REAL(0.28), REAL(math.pi / 2)
# Least denominator of tan(θ / 2), so that an edge that is folded flat has a finite angle.
_FOLDED = REAL(1e-4)


@kernel
def stretch(x: Any, edges: Any, buffer: Any) -> None:
    """Distance constraint of every edge: C = |x₂ − x₁| − l₀.

    x       (3 V,)  float32  positions, in and out
    edges           Chunks   rows of vertices: both ends; of numbers: w₁, w₂, l₀, α / h²
    buffer  (BUFFER_ROWS * LANES,)  float32
    """
    vertices, numbers, size = edges
    for chunk in range(size):
        v, p = chunk * 2 * LANES, chunk * 4 * LANES
        for n in range(LANES):
            i, j = vertices[v + n], vertices[v + LANES + n]
            buffer[n] = x[j] - x[i]
            buffer[LANES + n] = x[j + ONE] - x[i + ONE]
            buffer[2 * LANES + n] = x[j + TWO] - x[i + TWO]
        for n in range(LANES):
            dx, dy, dz = buffer[n], buffer[LANES + n], buffer[2 * LANES + n]
            length = math.sqrt(dx * dx + dy * dy + dz * dz) + TINY
            w1, w2 = numbers[p + n], numbers[p + LANES + n]
            rest, compliance = numbers[p + 2 * LANES + n], numbers[p + 3 * LANES + n]
            share = (length - rest) / ((w1 + w2 + compliance) * length)
            buffer[n], buffer[LANES + n], buffer[2 * LANES + n] = share * dx, share * dy, share * dz
        for n in range(LANES):
            i, j = vertices[v + n], vertices[v + LANES + n]
            w1, w2 = numbers[p + n], numbers[p + LANES + n]
            x[i] += w1 * buffer[n]
            x[i + ONE] += w1 * buffer[LANES + n]
            x[i + TWO] += w1 * buffer[2 * LANES + n]
            x[j] -= w2 * buffer[n]
            x[j + ONE] -= w2 * buffer[LANES + n]
            x[j + TWO] -= w2 * buffer[2 * LANES + n]


@kernel
def bend(x: Any, previous: Any, hinges: Any, damping: Any, buffer: Any) -> None:
    """Dihedral constraint of every inner edge: C = θ − θ₀, with damping.

    Vertices 1 and 2 are the ends of the edge e, 3 and 4 the opposite corners.  With p = e × (x₃ −
    x₁) and q = (x₄ − x₁) × e the gradients are ∇₃ = −|e| p / |p|², ∇₄ = −|e| q / |q|²; those of the
    ends balance force and torque (Bridson et al., "Simulation of Clothing with Folds and
    Wrinkles", SCA 2003; Grinspun et al., "Discrete Shells", SCA 2003).

    x         (3 V,)  float32  positions, in and out
    previous  (3 V,)  float32  positions at the start of the substep
    hinges            Chunks   rows of vertices: 1 to 4; of numbers: w₁ to w₄, cos θ₀, sin θ₀,
                               α / h²
    damping           float32  γ
    buffer    (BUFFER_ROWS * LANES,)  float32
    """
    vertices, numbers, size = hinges
    for chunk in range(size):
        v, p = chunk * 4 * LANES, chunk * 7 * LANES
        for n in range(LANES):
            i, j = vertices[v + n], vertices[v + LANES + n]
            k, m = vertices[v + 2 * LANES + n], vertices[v + 3 * LANES + n]
            ox, oy, oz = x[i], x[i + ONE], x[i + TWO]
            dx, dy, dz = ox - previous[i], oy - previous[i + ONE], oz - previous[i + TWO]
            buffer[n] = x[j] - ox
            buffer[LANES + n] = x[j + ONE] - oy
            buffer[2 * LANES + n] = x[j + TWO] - oz
            buffer[3 * LANES + n] = x[k] - ox
            buffer[4 * LANES + n] = x[k + ONE] - oy
            buffer[5 * LANES + n] = x[k + TWO] - oz
            buffer[6 * LANES + n] = x[m] - ox
            buffer[7 * LANES + n] = x[m + ONE] - oy
            buffer[8 * LANES + n] = x[m + TWO] - oz
            buffer[9 * LANES + n] = x[j] - previous[j] - dx
            buffer[10 * LANES + n] = x[j + ONE] - previous[j + ONE] - dy
            buffer[11 * LANES + n] = x[j + TWO] - previous[j + TWO] - dz
            buffer[12 * LANES + n] = x[k] - previous[k] - dx
            buffer[13 * LANES + n] = x[k + ONE] - previous[k + ONE] - dy
            buffer[14 * LANES + n] = x[k + TWO] - previous[k + TWO] - dz
            buffer[15 * LANES + n] = x[m] - previous[m] - dx
            buffer[16 * LANES + n] = x[m + ONE] - previous[m + ONE] - dy
            buffer[17 * LANES + n] = x[m + TWO] - previous[m + TWO] - dz
        for n in range(LANES):
            ex, ey, ez = buffer[n], buffer[LANES + n], buffer[2 * LANES + n]
            ax, ay, az = buffer[3 * LANES + n], buffer[4 * LANES + n], buffer[5 * LANES + n]
            bx, by, bz = buffer[6 * LANES + n], buffer[7 * LANES + n], buffer[8 * LANES + n]
            px, py, pz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
            qx, qy, qz = by * ez - bz * ey, bz * ex - bx * ez, bx * ey - by * ex
            square = ex * ex + ey * ey + ez * ez + TINY
            length = math.sqrt(square)
            p2 = _UNIT / (px * px + py * py + pz * pz + TINY)
            q2 = _UNIT / (qx * qx + qy * qy + qz * qz + TINY)
            # θ − θ₀ = 2 atan(sin / (1 + cos)); no branch, so that all lanes do the same.
            scale = math.sqrt(p2 * q2)
            cosine = (px * qx + py * qy + pz * qz) * scale
            sine = (
                ((py * qz - pz * qy) * ex + (pz * qx - px * qz) * ey + (px * qy - py * qx) * ez)
                * scale
                / length
            )
            cosine0, sine0 = numbers[p + 4 * LANES + n], numbers[p + 5 * LANES + n]
            s, c = sine * cosine0 - cosine * sine0, cosine * cosine0 + sine * sine0
            t = s / max(_UNIT + c, _FOLDED)
            steep = abs(t) > _UNIT
            u = _UNIT / abs(t) if steep else abs(t)
            # atan(u) = u / (1 + 0.28 u²) for u in [0, 1], within 0.005 rad.
            f = u / (_UNIT + _A * u * u)
            f = _HALF_PI - f if steep else f
            angle = _DOUBLE * (f if t >= _ZERO else -f)
            gx, gy, gz = -length * p2 * px, -length * p2 * py, -length * p2 * pz
            hx, hy, hz = -length * q2 * qx, -length * q2 * qy, -length * q2 * qz
            at3 = (ax * ex + ay * ey + az * ez) / square
            at4 = (bx * ex + by * ey + bz * ez) / square
            jx, jy, jz = -at3 * gx - at4 * hx, -at3 * gy - at4 * hy, -at3 * gz - at4 * hz
            ix, iy, iz = -gx - hx - jx, -gy - hy - jy, -gz - hz - jz
            rate = (
                (jx * buffer[9 * LANES + n] + jy * buffer[10 * LANES + n])
                + (jz * buffer[11 * LANES + n] + gx * buffer[12 * LANES + n])
                + (gy * buffer[13 * LANES + n] + gz * buffer[14 * LANES + n])
                + (hx * buffer[15 * LANES + n] + hy * buffer[16 * LANES + n])
                + hz * buffer[17 * LANES + n]
            )
            w1, w2 = numbers[p + n], numbers[p + LANES + n]
            w3, w4 = numbers[p + 2 * LANES + n], numbers[p + 3 * LANES + n]
            weighted = (
                w1 * (ix * ix + iy * iy + iz * iz)
                + w2 * (jx * jx + jy * jy + jz * jz)
                + w3 * (gx * gx + gy * gy + gz * gz)
                + w4 * (hx * hx + hy * hy + hz * hz)
            )
            compliance = numbers[p + 6 * LANES + n]
            change = -(angle + damping * rate) / ((_UNIT + damping) * weighted + compliance)
            f1, f2, f3, f4 = change * w1, change * w2, change * w3, change * w4
            buffer[n], buffer[LANES + n], buffer[2 * LANES + n] = f1 * ix, f1 * iy, f1 * iz
            buffer[3 * LANES + n], buffer[4 * LANES + n] = f2 * jx, f2 * jy
            buffer[5 * LANES + n], buffer[6 * LANES + n] = f2 * jz, f3 * gx
            buffer[7 * LANES + n], buffer[8 * LANES + n] = f3 * gy, f3 * gz
            buffer[9 * LANES + n], buffer[10 * LANES + n] = f4 * hx, f4 * hy
            buffer[11 * LANES + n] = f4 * hz
        for n in range(LANES):
            for k in range(4):
                i = vertices[v + k * LANES + n]
                x[i] += buffer[3 * k * LANES + n]
                x[i + ONE] += buffer[(3 * k + 1) * LANES + n]
                x[i + TWO] += buffer[(3 * k + 2) * LANES + n]
