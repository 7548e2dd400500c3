"""tracking.picture.rounded_edge."""

from __future__ import annotations

from math import acos, cos, sin, sqrt
from typing import Any

import numpy as np
from scipy.special import ndtr

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory
from .kernel_types import LIGHT_DEGREE, LIGHT_TERMS, STRIP_CELLS

_FINE, _FAR = 128, 5.0
_STEP = np.arange(-_FAR * _FINE, _FAR * _FINE + 2) / _FINE
_PHI = np.asarray(ndtr(_STEP))
_BELL = np.exp(-0.5 * _STEP**2) / np.sqrt(2.0 * np.pi)
"""Φ and its derivative, tabulated: linear interpolation is right to 2e-6, a thousandth of what a grey level shows."""


def _strip_weights() -> Any:
    """(2, CELLS + 1, 4) what each line of a rounded strip adds to the basis functions, at the contour and between two
    faces: the change there of the intensity as a function of the turn u."""
    u = (np.arange(STRIP_CELLS) + 0.5) / STRIP_CELLS
    flat, none = np.ones(STRIP_CELLS), np.zeros(STRIP_CELLS)
    contour = np.stack([flat, none, u, u * u]), np.eye(4)[1]
    humps = 4.0 * u * (1.0 - u), 6.0 * np.sqrt(3.0) * u * (1.0 - u) * (1.0 - 2.0 * u)
    between = np.stack([1.0 - u, u, *humps]), np.eye(4)[1]
    return np.stack(
        [np.diff(inside, axis=1, prepend=np.eye(4)[:, :1], append=far[:, None]).T for inside, far in (contour, between)]
    )


_STRIP = np.ascontiguousarray(_strip_weights())


@inner_no_memory
def strip_turn(aw: Any, n0: Any, n1: Any, interior: bool, turned: Any) -> float:
    """The angle through which the normal turns on a rounded strip, from n0 to n1 or to the contour, and in `turned` (3,) the
    direction it turns to, at a right angle to n0. `aw` is the derivative of d by a world displacement."""
    size = sqrt(aw[0] * aw[0] + aw[1] * aw[1] + aw[2] * aw[2])
    e0, e1, e2 = (n1[0], n1[1], n1[2]) if interior else (aw[0] / size, aw[1] / size, aw[2] / size)
    along = n0[0] * e0 + n0[1] * e1 + n0[2] * e2
    e0, e1, e2 = e0 - along * n0[0], e1 - along * n0[1], e2 - along * n0[2]
    across = sqrt(max(e0 * e0 + e1 * e1 + e2 * e2, 1e-30))
    turned[0], turned[1], turned[2] = e0 / across, e1 / across, e2 / across
    return acos(min(1.0, max(-1.0, along)))


@inner_no_memory
def strip_lines(aw: Any, n0: Any, turned: Any, angle: float, radius: float, lines: Any) -> None:
    """Signed distances [px] of the CELLS + 1 lines of a rounded strip from the inner body's edge: the surface points
    whose normals divide the turn into equal parts."""
    d0 = radius * (aw[0] * n0[0] + aw[1] * n0[1] + aw[2] * n0[2])
    d1 = radius * (aw[0] * turned[0] + aw[1] * turned[1] + aw[2] * turned[2])
    c, s = cos(angle / STRIP_CELLS), sin(angle / STRIP_CELLS)
    lines[0] = d0
    for j in range(1, STRIP_CELLS + 1):
        d0, d1 = c * d0 + s * d1, c * d1 - s * d0
        lines[j] = d0
    for j in range(1, STRIP_CELLS + 1):
        lines[j] = max(lines[j], lines[j - 1])


@inner_no_memory
def _brightness(light: Any, x: float, y: float, z: float) -> float:
    """How bright a surface of normal (x, y, z) looks."""
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
def strip_shades(light: Any, n0: Any, turned: Any, angle: float, interior: bool, strip: Any) -> None:
    """In `strip` (CELLS + 1, 4) what each line adds to the basis functions, of a strip that the light shades."""
    kind = 1 if interior else 0
    for j in range(STRIP_CELLS + 1):
        for a in range(4):
            strip[j, a] = _STRIP[kind, j, a]
    if not light[LIGHT_TERMS + 1] > 0.0:
        return
    first = _brightness(light, n0[0], n0[1], n0[2])
    c, s = cos(angle), sin(angle)
    last = _brightness(light, c * n0[0] + s * turned[0], c * n0[1] + s * turned[1], c * n0[2] + s * turned[2])
    near, far = 1.0, 0.0
    for j in range(STRIP_CELLS):
        u = (j + 0.5) / STRIP_CELLS
        c, s = cos(u * angle), sin(u * angle)
        here = _brightness(light, c * n0[0] + s * turned[0], c * n0[1] + s * turned[1], c * n0[2] + s * turned[2])
        if interior:
            shade = here / ((1.0 - u) * first + u * last)
            strip[j, 0], strip[j, 1] = (1.0 - u) * shade - near, u * shade - far
            near, far = near + strip[j, 0], far + strip[j, 1]
        else:
            strip[j, 0] = here / first - near
            near += strip[j, 0]
    strip[STRIP_CELLS, 0], strip[STRIP_CELLS, 1] = -near, 1.0 - far


@inner_no_memory
def rounded_basis(
    d: float, ib: float, shade: float, strip: Any, lines: Any, full: bool, phi: Any, slope: Any, spread: Any, n: int
) -> None:
    """Basis functions of the intensities of pixel n at distance d from a rounded edge, with their derivatives by d and,
    where `full`, by the blur 1 / ib.

    A cell's share is the difference of two steps; summed by parts, each of the CELLS + 1 lines is looked up once and
    weighs what the basis function changes by there.
    """
    f0, f1, f2, f3 = 1.0, 0.0, 0.0, 0.0
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    b0, b1, b2, b3 = 0.0, 0.0, 0.0, 0.0
    for j in range(STRIP_CELLS + 1):
        t = (d - lines[j]) * ib
        a, p = _step(t)
        v0, v1, v2, v3 = strip[j, 0], strip[j, 1], strip[j, 2], strip[j, 3]
        f0, f1, f2, f3 = f0 + v0 * a, f1 + v1 * a, f2 + v2 * a, f3 + v3 * a
        p *= ib
        s0, s1, s2, s3 = s0 + v0 * p, s1 + v1 * p, s2 + v2 * p, s3 + v3 * p
        if full:
            p *= -t
            b0, b1, b2, b3 = b0 + v0 * p, b1 + v1 * p, b2 + v2 * p, b3 + v3 * p
    phi[0, n], phi[1, n], phi[2, n], phi[3, n] = f0, f1 * shade, f2, f3
    slope[0, n], slope[1, n], slope[2, n], slope[3, n] = s0, s1 * shade, s2, s3
    if full:
        spread[0, n], spread[1, n], spread[2, n], spread[3, n] = b0, b1 * shade, b2, b3


@inner_fast_sums_no_memory
def sharp_basis(n: int, near: Any, far: Any, near_slope: Any, far_slope: Any) -> None:
    """Basis functions of the two intensities of n pixels beside sharp edges, and their derivatives by the distance, in place
    of that distance in blurs (`near`), what shades the far side (`far`), and one over the blur (`near_slope`).

    As `_step`, without branches: several pixels at once.
    """
    for i in range(n):
        x = (min(max(near[i], -_FAR), _FAR) + _FAR) * _FINE
        k = int(x)
        x -= k
        a = _PHI[k] + x * (_PHI[k + 1] - _PHI[k])
        p = (_BELL[k] + x * (_BELL[k + 1] - _BELL[k])) * near_slope[i]
        near_slope[i], far_slope[i] = -p, p * far[i]
        near[i], far[i] = 1.0 - a, a * far[i]


@inner_no_memory
def _step(t: float) -> tuple[float, float]:
    """Φ(t) and its derivative."""
    if t >= _FAR:
        return 1.0, 0.0
    if t <= -_FAR:
        return 0.0, 0.0
    x = (t + _FAR) * _FINE
    k = int(x)
    x -= k
    return _PHI[k] + x * (_PHI[k + 1] - _PHI[k]), _BELL[k] + x * (_BELL[k + 1] - _BELL[k])
