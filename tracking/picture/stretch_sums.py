"""Sums over the pixels of one stretch of edge: greys by least squares with robust weights, residuals and their scale, and what
saturated pixels say.

The loops are simple, so that the processor works on several pixels at once.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory

BIWEIGHT_VARIANCE = 0.8281
"""Mean square of Gaussian residuals of unit variance under the biweight's own weights with `BIWEIGHT_CUT` of `edge_stretch`."""
MEDIAN_TOLERANCE = 0.02
"""Part of itself to which a median is found; that of 200 Gaussian residuals is known to a fifteenth."""
MEDIAN_HALVINGS = 16
"""Most steps of that search, which end it if most values are nearly zero."""
SATURATED_PART = 0.01
"""Part of full scale by which a saturated pixel may be predicted darker and still counts as explained: noise."""
FAR_OFF = 1e8
"""Residual [grey] that the biweight gives no weight before the scale is known."""
CENSORED = 1e9
"""Residual [grey] of a saturated pixel that is predicted to be as bright: so far off that it never has a weight."""


@inner_fast_sums_no_memory
def median_size(values: Any, n: int) -> float:
    """Median of the first n of non-negative values, to a relative MEDIAN_TOLERANCE, by bisection: the processor counts
    eight values at a time, while sorting waits at every comparison."""
    total = 0.0
    for i in range(n):
        total += values[i]
    # At least half of them lie below twice their mean.
    low, high = 0.0, 2.0 * total / n
    for _ in range(MEDIAN_HALVINGS):
        if high - low <= MEDIAN_TOLERANCE * high:
            break
        middle, below = 0.5 * (low + high), 0.0
        for i in range(n):
            below += 1.0 if values[i] < middle else 0.0
        if 2.0 * below < n:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@inner_fast_sums_no_memory
def two_sums(
    n: int, icut: float, near: Any, far: Any, grey: Any, res: Any, w: Any
) -> tuple[float, float, float, float, float]:
    """Normal matrix (a00, a10, a11) and right side of two intensities, with weights from the last residuals and the
    inverse cut `icut` of the biweight; all weights are 1 if it is 0."""
    a00, a10, a11, y0, y1 = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        wi = q * q
        w[i] = wi
        w0, w1 = wi * near[i], wi * far[i]
        a00 += w0 * near[i]
        a10 += w1 * near[i]
        a11 += w1 * far[i]
        y0 += w0 * grey[i]
        y1 += w1 * grey[i]
    return a00, a10, a11, y0, y1


@inner_fast_sums_no_memory
def ramp_sums(n: int, K: int, phi: Any, ramp: Any, grey: Any, w: Any, out: Any) -> tuple[float, float]:
    """Of a slope of the shade: fill its coupling to the K intensities; return its square and its right side."""
    square, right = 0.0, 0.0
    for i in range(n):
        wr = w[i] * ramp[i]
        square += wr * ramp[i]
        right += wr * grey[i]
    for a in range(K):
        basis, both = phi[a], 0.0
        for i in range(n):
            both += w[i] * ramp[i] * basis[i]
        out[a] = both
    return square, right


@inner_no_memory
def less_ramp(n: int, slope: float, ramp: Any, res: Any, size: Any) -> None:
    """Residuals, and their absolute values, less the slope of the shade."""
    for i in range(n):
        res[i] -= slope * ramp[i]
        size[i] = abs(res[i])


@inner_no_memory
def two_residuals(n: int, c0: float, c1: float, near: Any, far: Any, grey: Any, res: Any, size: Any) -> None:
    """Residuals of two intensities, and their absolute values."""
    for i in range(n):
        res[i] = grey[i] - c0 * near[i] - c1 * far[i]
        size[i] = abs(res[i])


@inner_fast_sums_no_memory
def has_saturated(n: int, saturation: float, value: Any) -> bool:
    """Whether any pixel is saturated."""
    count = 0
    for i in range(n):
        count += 1 if value[i] >= saturation else 0
    return count > 0


@inner_no_memory
def censor(n: int, saturation: float, value: Any, res: Any, size: Any) -> int:
    """Mark saturated pixels that are predicted to be as bright as CENSORED, and move the absolute residuals of the others to the
    front; return their number."""
    seen = 0
    for i in range(n):
        if value[i] >= saturation and res[i] < SATURATED_PART * saturation:
            res[i] = CENSORED
        else:
            size[seen] = size[i]
            seen += 1
    return seen


@inner_fast_sums_no_memory
def four_sums(n: int, icut: float, phi: Any, grey: Any, res: Any, w: Any, A: Any, y: Any) -> None:
    """As `two_sums` for the four intensities of a rounded edge: normal matrix A (lower half) and right side y."""
    p0, p1, p2, p3 = phi[0], phi[1], phi[2], phi[3]
    a00, a10, a11, a20, a21, a22, a30, a31, a32, a33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    y0, y1, y2, y3 = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        wi = q * q
        w[i] = wi
        w0, w1, w2, w3 = wi * p0[i], wi * p1[i], wi * p2[i], wi * p3[i]
        a00 += w0 * p0[i]
        a10 += w1 * p0[i]
        a11 += w1 * p1[i]
        a20 += w2 * p0[i]
        a21 += w2 * p1[i]
        a22 += w2 * p2[i]
        a30 += w3 * p0[i]
        a31 += w3 * p1[i]
        a32 += w3 * p2[i]
        a33 += w3 * p3[i]
        y0 += w0 * grey[i]
        y1 += w1 * grey[i]
        y2 += w2 * grey[i]
        y3 += w3 * grey[i]
    A[0, 0], A[1, 0], A[1, 1], A[2, 0], A[2, 1], A[2, 2] = a00, a10, a11, a20, a21, a22
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = a30, a31, a32, a33
    y[0], y[1], y[2], y[3] = y0, y1, y2, y3


@inner_fast_sums_no_memory
def four_residuals(n: int, c: Any, phi: Any, grey: Any, res: Any, size: Any) -> None:
    """Residuals of four intensities, and their absolute values."""
    c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
    p0, p1, p2, p3 = phi[0], phi[1], phi[2], phi[3]
    for i in range(n):
        res[i] = grey[i] - c0 * p0[i] - c1 * p1[i] - c2 * p2[i] - c3 * p3[i]
        size[i] = abs(res[i])


@inner_fast_sums_no_memory
def robust_scale(n: int, icut: float, res: Any) -> float:
    """Scale of residuals by one step of an M-estimate from the scale behind `icut`: three times as efficient as the
    median that it starts from."""
    total, weights = 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        q = q * q
        total += q * res[i] * res[i]
        weights += q
    return sqrt(total / (BIWEIGHT_VARIANCE * max(weights, 1.0)))
