"""The light on one face of one frame, fitted robustly to its pixels.

The model has the six coefficients of `kernel_types`. They are solved by iteratively reweighted least squares with
Tukey's biweight, so that glare, shadow and whatever occludes the die get no weight.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.compiled import inner_fast_sums, inner_no_memory, inner_nogil
from ..picture import NORMAL_MAD, solve_positive
from .kernel_types import (
    DECIMATED_FROM,
    FIRST_GRADIENT,
    LIGHT_COEFFICIENTS,
    LIGHT_GRADIENT_SIGMA,
    SCALE_DECIMATION,
    STEEP_SHARE,
    Faces,
    Workspace,
)

FIRST_LEVEL_GREY = 255.0
"""Scattered light by which the prior of its gradients is scaled before the first solution."""


@inner_no_memory
def relative_slopes(steep: Any, n: int) -> None:
    """Divide slopes by the largest; without any slope all become 1."""
    most = 0.0
    for i in range(n):
        most = max(most, steep[i])
    for i in range(n):
        steep[i] = steep[i] / most if most > 0.0 else 1.0


@inner_fast_sums
def light_sums(n: int, grey: Any, texture: Any, xs: Any, ys: Any, weight: Any, A: Any, y: Any) -> None:
    """Fill the normal matrix A (lower half) and the right side y of the six light coefficients; only eighteen of the
    products differ."""
    s0, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    t0, tx, ty, txx, txy, tyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    q0, qx, qy, qxx, qxy, qyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    y0, y1, y2, y3, y4, y5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        w, t, a, b = weight[i], texture[i], xs[i], ys[i]
        wa, wb, wt, wg = w * a, w * b, w * t, w * grey[i]
        waa, wab, wbb, wtt, wgt = wa * a, wa * b, wb * b, wt * t, wg * t
        s0 += w
        sx += wa
        sy += wb
        sxx += waa
        sxy += wab
        syy += wbb
        t0 += wt
        tx += wa * t
        ty += wb * t
        txx += waa * t
        txy += wab * t
        tyy += wbb * t
        q0 += wtt
        qx += wtt * a
        qy += wtt * b
        qxx += wtt * a * a
        qxy += wtt * a * b
        qyy += wtt * b * b
        y0 += wgt
        y1 += wg
        y2 += wg * a
        y3 += wg * b
        y4 += wgt * a
        y5 += wgt * b
    A[0, 0] = q0
    A[1, 0], A[1, 1] = t0, s0
    A[2, 0], A[2, 1], A[2, 2] = tx, sx, sxx
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = ty, sy, sxy, syy
    A[4, 0], A[4, 1], A[4, 2], A[4, 3], A[4, 4] = qx, tx, txx, txy, qxx
    A[5, 0], A[5, 1], A[5, 2], A[5, 3], A[5, 4], A[5, 5] = qy, ty, txy, tyy, qxy, qyy
    y[0], y[1], y[2], y[3], y[4], y[5] = y0, y1, y2, y3, y4, y5


@inner_fast_sums
def _fill_residuals(n: int, c: Any, grey: Any, texture: Any, xs: Any, ys: Any, residual: Any) -> None:
    """Grey levels minus the model with the coefficients c."""
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    for i in range(n):
        a, b = xs[i], ys[i]
        residual[i] = grey[i] - (c0 + c4 * a + c5 * b) * texture[i] - (c1 + c2 * a + c3 * b)


@inner_fast_sums
def _fill_weights(n: int, inverse_cut: float, residual: Any, weight: Any) -> None:
    """Tukey's biweight of residuals."""
    for i in range(n):
        q = residual[i] * inverse_cut
        q = max(1.0 - q * q, 0.0)
        weight[i] = q * q


@inner_nogil
def fit_light(
    n: int, known: bool, faces: Faces, ceiling_grey: float, iterations: int, workspace: Workspace, A: Any, c: Any
) -> float:
    """Fit the light of n pixels: all coefficients c if the texture is `known`, else a plane.

    Fills weights and residuals of the workspace, and c. Returns the noise scale [grey], between `faces.floor_grey`
    and `ceiling_grey`, or -1 if there is no solution. The scale is that of steep pixels: where the texture changes,
    small errors of position and blur add to the noise, and those pixels determine the pose.
    """
    grey, texture, xs, ys = workspace.grey, workspace.texture, workspace.a, workspace.b
    weight, residual, size, steep = workspace.weight, workspace.residual, workspace.size, workspace.steep
    y, x = np.zeros(LIGHT_COEFFICIENTS), np.zeros(LIGHT_COEFFICIENTS)
    for i in range(n):
        weight[i] = 1.0
    scale = faces.floor_grey
    count = LIGHT_COEFFICIENTS if known else FIRST_GRADIENT - 1
    for iteration in range(iterations):
        light_sums(n, grey, texture, xs, ys, weight, A, y)
        if known:
            level = max(abs(c[0]), scale) if iteration > 0 else FIRST_LEVEL_GREY
            for a in range(FIRST_GRADIENT, LIGHT_COEFFICIENTS):
                A[a, a] += (scale / (LIGHT_GRADIENT_SIGMA * level)) ** 2
        else:
            for a in range(count):
                y[a] = y[a + 1]
                for b in range(a + 1):
                    A[a, b] = A[a + 1, b + 1]
        if not solve_positive(A, count, y, x):
            return -1.0
        for a in range(count):
            c[a if known else a + 1] = x[a]
        _fill_residuals(n, c, grey, texture, xs, ys, residual)
        stride = SCALE_DECIMATION if iteration < iterations - 1 and n > DECIMATED_FROM else 1
        m = 0
        for i in range(0, n, stride):
            if steep[i] >= STEEP_SHARE:
                size[m] = abs(residual[i])
                m += 1
        if m == 0:
            return -1.0
        scale = min(max(faces.floor_grey, NORMAL_MAD * np.median(size[:m])), ceiling_grey)
        _fill_weights(n, 1.0 / (faces.cut * scale), residual, weight)
    return scale
