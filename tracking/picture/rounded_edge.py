"""The strip between a flat face and the contour of a rounded die, or between two of its faces.

A rounded die is a smaller sharp body with a ball rolled round it. Its contour is that body's contour pushed out by the
radius. Between a flat face and the contour, or between two flat faces, lies a strip on which the surface normal turns
from one to the other. With u from 0 to 1 along that turn, the intensity of the strip is

    c0 + α u + β u²                            at the contour,
    c0 (1 - u) + c1 u + γ p(u) + δ q(u)        between two faces,

with p = 4u(1 - u), and q the cubic that is zero at both ends and in the middle. Distant light on a dull surface gives
these to second order, and to third order over the wider turn, which passes through the direction of the light and into
the shade. A weak prior holds α, β, γ, δ near zero, because a strip that is seen too narrow does not determine them.

The strip is drawn in STRIP_CELLS pieces of equal turn, each between its own two lines of the picture, the surface
points whose normals divide the turn.

**Light.** If the clip shows the brightness B of a surface by its normal (`tracking.clip_parameters.light`), c0
B(u)/B(0) takes the place of c0 at the contour, and between two faces B(u) over its own chord multiplies the straight
line. α, β, γ, δ then are no larger than the differences of faces from B.
"""

from __future__ import annotations

from math import acos, cos, sin, sqrt
from typing import Any

import numpy as np
from scipy.special import ndtr

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory
from .kernel_types import LIGHT_DEGREE, LIGHT_TERMS, STRIP_CELLS, Workspace

_PER_BLUR = 128
"""Samples per blur in the tables of Φ and its derivative φ: linear interpolation is right to 2e-6, a thousandth of what
a grey level shows."""
_END_BLURS = 5.0
"""Where the tables end: Φ is 3e-7 there."""
_BLURS = np.arange(-_END_BLURS * _PER_BLUR, _END_BLURS * _PER_BLUR + 2) / _PER_BLUR
_CUMULATIVE = np.asarray(ndtr(_BLURS))
_DENSITY = np.exp(-0.5 * _BLURS**2) / np.sqrt(2.0 * np.pi)


def _strip_steps() -> Any:
    """(2, STRIP_CELLS + 1, 4) the change of the basis functions at each line of a strip, at the contour and between two
    faces."""
    u = (np.arange(STRIP_CELLS) + 0.5) / STRIP_CELLS
    flat, none = np.ones(STRIP_CELLS), np.zeros(STRIP_CELLS)
    contour = np.stack([flat, none, u, u * u]), np.eye(4)[1]
    humps = 4.0 * u * (1.0 - u), 6.0 * np.sqrt(3.0) * u * (1.0 - u) * (1.0 - 2.0 * u)
    between = np.stack([1.0 - u, u, *humps]), np.eye(4)[1]
    return np.stack(
        [np.diff(inside, axis=1, prepend=np.eye(4)[:, :1], append=far[:, None]).T for inside, far in (contour, between)]
    )


_STRIP_STEPS = np.ascontiguousarray(_strip_steps())


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
        lines[j] = max(lines[j], lines[j - 1])


@inner_no_memory
def _brightness(light: Any, x: float, y: float, z: float) -> float:
    """Brightness [grey] of a surface of normal (x, y, z)."""
    total, k, a = 0.0, np.int64(0), 1.0
    for i in range(LIGHT_DEGREE + 1):
        b = a
        for j in range(LIGHT_DEGREE + 1 - i):
            total += light[k] * b
            k += 1
            if i + j < LIGHT_DEGREE:
                total += light[k] * b * z
                k += 1
            b *= y
        a *= x
    return max(total, light[k])


@inner_no_memory
def fill_strip_steps(light: Any, n0: Any, end: Any, angle: float, interior: bool, steps: Any) -> None:
    """Fill `steps` (STRIP_CELLS + 1, 4), the change of the basis functions at each line of a strip, shaded by the light
    of its view (LIGHT_TERMS + 2,) where that is known."""
    kind = 1 if interior else 0
    for j in range(STRIP_CELLS + 1):
        for a in range(4):
            steps[j, a] = _STRIP_STEPS[kind, j, a]
    if not light[LIGHT_TERMS + 1] > 0.0:
        return
    first = _brightness(light, n0[0], n0[1], n0[2])
    c, s = cos(angle), sin(angle)
    last = _brightness(light, c * n0[0] + s * end[0], c * n0[1] + s * end[1], c * n0[2] + s * end[2])
    near, far = 1.0, 0.0
    for j in range(STRIP_CELLS):
        u = (j + 0.5) / STRIP_CELLS
        c, s = cos(u * angle), sin(u * angle)
        here = _brightness(light, c * n0[0] + s * end[0], c * n0[1] + s * end[1], c * n0[2] + s * end[2])
        if interior:
            shade = here / ((1.0 - u) * first + u * last)
            steps[j, 0], steps[j, 1] = (1.0 - u) * shade - near, u * shade - far
            near, far = near + steps[j, 0], far + steps[j, 1]
        else:
            steps[j, 0] = here / first - near
            near += steps[j, 0]
    steps[STRIP_CELLS, 0], steps[STRIP_CELLS, 1] = -near, 1.0 - far


@inner_no_memory
def fill_rounded_basis(d: float, ib: float, shade: float, with_blur: bool, work: Workspace, n: int) -> None:
    """Fill the basis functions of pixel n at distance d [px] from a rounded edge, their derivatives by d and, if
    `with_blur`, by the blur 1 / ib. `shade` is what multiplies the far side.

    The share of a cell is a difference of two steps. Summed by parts, each of the STRIP_CELLS + 1 lines is looked up
    once and is weighted by the change of the basis function there.
    """
    steps, lines, phi, slope, spread = work.strip_steps, work.strip_lines, work.basis, work.basis_slope, work.basis_blur
    f0, f1, f2, f3 = 1.0, 0.0, 0.0, 0.0
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    b0, b1, b2, b3 = 0.0, 0.0, 0.0, 0.0
    for j in range(STRIP_CELLS + 1):
        t = (d - lines[j]) * ib
        a, p = _blurred_step(t)
        v0, v1, v2, v3 = steps[j, 0], steps[j, 1], steps[j, 2], steps[j, 3]
        f0, f1, f2, f3 = f0 + v0 * a, f1 + v1 * a, f2 + v2 * a, f3 + v3 * a
        p *= ib
        s0, s1, s2, s3 = s0 + v0 * p, s1 + v1 * p, s2 + v2 * p, s3 + v3 * p
        if with_blur:
            p *= -t
            b0, b1, b2, b3 = b0 + v0 * p, b1 + v1 * p, b2 + v2 * p, b3 + v3 * p
    phi[0, n], phi[1, n], phi[2, n], phi[3, n] = f0, f1 * shade, f2, f3
    slope[0, n], slope[1, n], slope[2, n], slope[3, n] = s0, s1 * shade, s2, s3
    if with_blur:
        spread[0, n], spread[1, n], spread[2, n], spread[3, n] = b0, b1 * shade, b2, b3


@inner_fast_sums_no_memory
def fill_sharp_basis(n: int, near: Any, far: Any, near_slope: Any, far_slope: Any) -> None:
    """Fill the basis functions of two intensities at n pixels beside sharp edges, and their derivatives by the
    distance.

    They replace the distance in blurs (`near`), the factor on the far side (`far`), and one over the blur
    (`near_slope`). The arithmetic is that of `_blurred_step` without branches, for several pixels at once.
    """
    for i in range(n):
        x = (min(max(near[i], -_END_BLURS), _END_BLURS) + _END_BLURS) * _PER_BLUR
        k = int(x)
        x -= k
        a = _CUMULATIVE[k] + x * (_CUMULATIVE[k + 1] - _CUMULATIVE[k])
        p = (_DENSITY[k] + x * (_DENSITY[k + 1] - _DENSITY[k])) * near_slope[i]
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
