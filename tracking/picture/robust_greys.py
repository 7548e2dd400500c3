"""tracking.picture.robust_greys."""

from __future__ import annotations

from math import sqrt
from typing import Any

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory
from .kernel_types import BIWEIGHT_VARIANCE, MEDIAN_HALVINGS, MEDIAN_TOLERANCE


@inner_fast_sums_no_memory
def median_size(values: Any, n: int) -> float:
    """Median of the first n of some sizes, to MEDIAN_TO of it: by halving an interval, whose counts are done eight at a time,
    where sorting waits at every comparison."""
    total = 0.0
    for i in range(n):
        total += values[i]
    # Half of them at the least lie below twice their mean.
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
    """Normal matrix (a00, a10, a11) and right side of two intensities, with weights from the last residuals (all one for
    `icut` zero)."""
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


@inner_no_memory
def two_left(n: int, c0: float, c1: float, near: Any, far: Any, grey: Any, res: Any, size: Any) -> None:
    """What two intensities leave of the grey levels, and its size."""
    for i in range(n):
        res[i] = grey[i] - c0 * near[i] - c1 * far[i]
        size[i] = abs(res[i])


@inner_fast_sums_no_memory
def four_sums(n: int, icut: float, phi: Any, grey: Any, res: Any, w: Any, A: Any, y: Any) -> None:
    """The same for the four intensities of a rounded edge, as normal matrix A (lower half) and right side y."""
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
def four_left(n: int, c: Any, phi: Any, grey: Any, res: Any, size: Any) -> None:
    """What four intensities leave of the grey levels, and its size."""
    c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
    p0, p1, p2, p3 = phi[0], phi[1], phi[2], phi[3]
    for i in range(n):
        res[i] = grey[i] - c0 * p0[i] - c1 * p1[i] - c2 * p2[i] - c3 * p3[i]
        size[i] = abs(res[i])


@inner_fast_sums_no_memory
def scale_left(n: int, icut: float, res: Any) -> float:
    """Scale of residuals, given the inverse cut of the biweight about an earlier one: one step of an M-estimate, three
    times as efficient as the median that it starts from."""
    total, weights = 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        q = q * q
        total += q * res[i] * res[i]
        weights += q
    return sqrt(total / (BIWEIGHT_VARIANCE * max(weights, 1.0)))


@inner_fast_sums_no_memory
def rises(n: int, K: int, c: Any, icut: float, slope: Any, res: Any, rise: Any, w: Any) -> tuple[float, float]:
    """Derivative of the grey levels by d; robust cost and sum of the weights."""
    c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
    s0, s1, s2, s3 = slope[0], slope[1], slope[2], slope[3]
    if K == 2:
        for i in range(n):
            rise[i] = c0 * s0[i] + c1 * s1[i]
    else:
        for i in range(n):
            rise[i] = c0 * s0[i] + c1 * s1[i] + c2 * s2[i] + c3 * s3[i]
    cost, used = 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        cost += 1.0 - q * q * q
        used += w[i]
    return cost, used


@inner_fast_sums_no_memory
def shift_alike(n: int, rise: Any, w: Any) -> float:
    """(Σ w |r|)² / Σ w r², with r the derivatives of grey levels by d: by how much the variance of d is greater where n
    pixels err alike, and not each for itself."""
    total, squares = 0.0, 0.0
    for i in range(n):
        total += w[i] * abs(rise[i])
        squares += w[i] * rise[i] * rise[i]
    return total * total / max(squares, 1e-30)
