"""The strip between a flat face and the contour of a rounded die, or between two of its faces.

A rounded die is a smaller sharp body with a ball rolled round it. Its contour is that body's contour pushed out by the
radius. Between a flat face and the contour, or between two flat faces, lies a strip on which the surface normal turns
from one to the other. With u from 0 to 1 along that turn, the intensity of the strip is

    c0 + α u + β u²                            at the contour,
    c0 (1 - u) + c1 u + γ p(u) + δ q(u)        between two faces,

with p = 4u(1 - u), and q the cubic that is zero at both ends and in the middle. Distant light on a dull surface gives
these to second order, and to third order over the wider turn, which passes through the direction of the light and into
the shade. α, β, γ, δ of all strips follow from one light on the die, up to small deviations (`surface_light`). A weak
prior holds them near zero where no light is assumed: in the first step on a picture of an unknown light, and where radii
are compared.

The strip is drawn in STRIP_CELLS pieces of equal turn, over each of which the intensity is linear in the picture, between
the surface points whose normals divide the turn. Its nodes are raised or lowered by a twelfth of their second difference,
so that chords have the mean of the curve. Pieces of constant intensity, five to a strip of as many pixels, left nearly a
grey level at both ends of a strip, and moved edges between two faces by a tenth of a pixel.

With σ the blur, a blurred ramp that begins at a line is σ ψ((d - line)/σ), ψ(t) = t Φ(t) + φ(t).
"""

from __future__ import annotations

from math import acos, cos, sin, sqrt
from typing import Any

import numpy as np
from scipy.special import ndtr

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory
from .kernel_types import STRIP_CELLS, Workspace
from .surface_light import STRIP_NODES

_PER_BLUR = 128
"""Samples per blur in the tables of Φ and its derivative φ: linear interpolation is right to 2e-6, a thousandth of what
a grey level shows."""
_END_BLURS = 5.0
"""Where the tables end: Φ is 3e-7 there."""
LEAST_PIECE_PX = 1e-3
"""Least width of a piece of a strip in the picture: where the surface turns away, pieces end in one line."""
_BLURS = np.arange(-_END_BLURS * _PER_BLUR, _END_BLURS * _PER_BLUR + 2) / _PER_BLUR
_CUMULATIVE = np.asarray(ndtr(_BLURS))
_DENSITY = np.exp(-0.5 * _BLURS**2) / np.sqrt(2.0 * np.pi)


@inner_no_memory
def fill_strip_slopes(interior: bool, left: Any, work: Workspace) -> None:
    """Fill `strip_slopes`, the changes of slope [1/px] at each line of a strip, of the four basis functions and of the
    nodes `left` (STRIP_CELLS + 1,), and `strip_jump`, their jumps at the last line."""
    slopes, jump, lines = work.strip_slopes, work.strip_jump, work.strip_lines
    nodes = STRIP_NODES[1 if interior else 0]
    for a in range(5):
        before = 0.0
        for j in range(STRIP_CELLS):
            rise = (left[j + 1] - left[j]) if a == 4 else (nodes[j + 1, a] - nodes[j, a])
            slope = rise / (lines[j + 1] - lines[j])
            slopes[j, a] = slope - before
            before = slope
        slopes[STRIP_CELLS, a] = -before
        jump[a] = 0.0
    if not interior:
        for a in range(4):
            jump[a] = (1.0 if a == 1 else 0.0) - nodes[STRIP_CELLS, a]
        jump[4] = -left[STRIP_CELLS]


@inner_no_memory
def strip_turn(gradient: Any, n0: Any, n1: Any, interior: bool, end: Any) -> float:
    """The angle [rad] through which the normal turns on a strip, from n0 to n1 or, unless `interior`, to the contour.

    `end` (3,) becomes the direction it turns to, perpendicular to n0. `gradient` is the derivative of d by a world
    displacement.
    """
    size = sqrt(gradient[0] * gradient[0] + gradient[1] * gradient[1] + gradient[2] * gradient[2])
    e0, e1, e2 = (n1[0], n1[1], n1[2]) if interior else (gradient[0] / size, gradient[1] / size, gradient[2] / size)
    along = n0[0] * e0 + n0[1] * e1 + n0[2] * e2
    e0, e1, e2 = e0 - along * n0[0], e1 - along * n0[1], e2 - along * n0[2]
    across = sqrt(max(e0 * e0 + e1 * e1 + e2 * e2, 1e-30))
    end[0], end[1], end[2] = e0 / across, e1 / across, e2 / across
    return acos(min(1.0, max(-1.0, along)))


@inner_no_memory
def fill_strip_lines(gradient: Any, n0: Any, end: Any, angle: float, radius: float, lines: Any) -> None:
    """Fill the signed distances [px] of the STRIP_CELLS + 1 lines of a strip from the inner body's edge."""
    d0 = radius * (gradient[0] * n0[0] + gradient[1] * n0[1] + gradient[2] * n0[2])
    d1 = radius * (gradient[0] * end[0] + gradient[1] * end[1] + gradient[2] * end[2])
    c, s = cos(angle / STRIP_CELLS), sin(angle / STRIP_CELLS)
    lines[0] = d0
    for j in range(1, STRIP_CELLS + 1):
        d0, d1 = c * d0 + s * d1, c * d1 - s * d0
        lines[j] = d0
    for j in range(1, STRIP_CELLS + 1):
        lines[j] = max(lines[j], lines[j - 1] + LEAST_PIECE_PX)


@inner_no_memory
def fill_rounded_basis(d: float, blur: float, shade: float, with_blur: bool, work: Workspace, n: int) -> float:
    """Fill the basis functions of pixel n at distance d [px] from a rounded edge, their derivatives by d and, if
    `with_blur`, by the blur. `shade` is what multiplies the far side, of whose slope the pixel gets `ramp`. Returns what the
    basis functions leave of the brightness at the pixel [grey], and fills its derivative by d.
    """
    slopes, jump, lines = work.strip_slopes, work.strip_jump, work.strip_lines
    phi, slope, spread = work.basis, work.basis_slope, work.basis_blur
    f0, f1, f2, f3, f4 = 1.0, 0.0, 0.0, 0.0, 0.0
    s0, s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0, 0.0
    b0, b1, b2, b3 = 0.0, 0.0, 0.0, 0.0
    ib, t, a, p = 1.0 / blur, 0.0, 0.0, 0.0
    for j in range(STRIP_CELLS + 1):
        t = (d - lines[j]) * ib
        a, p = _blurred_step(t)
        ramp = blur * (t * a + p)
        v0, v1, v2, v3, v4 = slopes[j, 0], slopes[j, 1], slopes[j, 2], slopes[j, 3], slopes[j, 4]
        f0, f1, f2, f3, f4 = f0 + v0 * ramp, f1 + v1 * ramp, f2 + v2 * ramp, f3 + v3 * ramp, f4 + v4 * ramp
        s0, s1, s2, s3, s4 = s0 + v0 * a, s1 + v1 * a, s2 + v2 * a, s3 + v3 * a, s4 + v4 * a
        if with_blur:
            b0, b1, b2, b3 = b0 + v0 * p, b1 + v1 * p, b2 + v2 * p, b3 + v3 * p
    work.ramp[n] = shade * blur * (t * a + p)
    v0, v1, v2, v3, v4 = jump[0], jump[1], jump[2], jump[3], jump[4]
    f0, f1, f2, f3, f4 = f0 + v0 * a, f1 + v1 * a, f2 + v2 * a, f3 + v3 * a, f4 + v4 * a
    p *= ib
    s0, s1, s2, s3, s4 = s0 + v0 * p, s1 + v1 * p, s2 + v2 * p, s3 + v3 * p, s4 + v4 * p
    phi[0, n], phi[1, n], phi[2, n], phi[3, n] = f0, f1 * shade, f2, f3
    slope[0, n], slope[1, n], slope[2, n], slope[3, n] = s0, s1 * shade, s2, s3
    if with_blur:
        p *= -t
        b0, b1, b2, b3 = b0 + v0 * p, b1 + v1 * p, b2 + v2 * p, b3 + v3 * p
        spread[0, n], spread[1, n], spread[2, n], spread[3, n] = b0, b1 * shade, b2, b3
    work.known_slope[n] = s4
    return f4


@inner_fast_sums_no_memory
def fill_sharp_basis(n: int, near: Any, far: Any, near_slope: Any, far_slope: Any, ramp: Any) -> None:
    """Fill the basis functions of two intensities at n pixels beside sharp edges, and their derivatives by the
    distance; `ramp` is what a pixel gets of the slope of the far one.

    They replace the distance in blurs (`near`), the factor on the far side (`far`), and one over the blur
    (`near_slope`). The arithmetic is that of `_blurred_step` without branches, for several pixels at once.
    """
    for i in range(n):
        x = (min(max(near[i], -_END_BLURS), _END_BLURS) + _END_BLURS) * _PER_BLUR
        k = int(x)
        x -= k
        a = _CUMULATIVE[k] + x * (_CUMULATIVE[k + 1] - _CUMULATIVE[k])
        density = _DENSITY[k] + x * (_DENSITY[k + 1] - _DENSITY[k])
        p = density * near_slope[i]
        ramp[i] = far[i] * (near[i] * a + density) / near_slope[i]
        near_slope[i], far_slope[i] = -p, p * far[i]
        near[i], far[i] = 1.0 - a, a * far[i]


@inner_no_memory
def _blurred_step(t: float) -> tuple[float, float]:
    """Φ(t) and its derivative."""
    if t >= _END_BLURS:
        return 1.0, 0.0
    if t <= -_END_BLURS:
        return 0.0, 0.0
    x = (t + _END_BLURS) * _PER_BLUR
    k = int(x)
    x -= k
    return _CUMULATIVE[k] + x * (_CUMULATIVE[k + 1] - _CUMULATIVE[k]), _DENSITY[k] + x * (_DENSITY[k + 1] - _DENSITY[k])
