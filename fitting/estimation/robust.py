"""A loss that bad frames cannot bend.

Each frame enters with s = |r|², the square of its whitened residual (6,), through Huber's ρ(s) = s up to k² and
2 k √s - k² beyond. A frame is bad as a whole, so the loss looks at all six numbers together; scipy's own losses look
at them one by one. Written as scaled residuals r √(ρ/s), whose squares add up to ρ, it is an ordinary least-squares
problem with an exact gradient.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled

Array = NDArray[np.float64]

CLEAN_FRAME = 22.46
"""k²: |r|² of a good frame exceeds it in one case out of a thousand (χ² with six degrees of freedom)."""

MEDIAN_FRAME = 5.348
"""Median of |r|² over good frames."""


def huber(residuals: Array, jacobian: Array, k2: float) -> tuple[Array, Array]:
    """Scaled residuals (n, 6), whose squares add up to Σ ρ, and their derivative (n, 6, m)."""
    s = (residuals**2).sum(1)
    beyond = s > k2
    if not beyond.any():
        return residuals, jacobian
    far, k = s[beyond], np.sqrt(k2)
    gain = np.sqrt((2.0 * k * np.sqrt(far) - k2) / far)
    slope = (k / np.sqrt(far) - gain**2) / (2.0 * gain * far)
    scaled, scaled_jacobian = residuals.copy(), jacobian.copy()
    r, j = residuals[beyond], jacobian[beyond]
    scaled[beyond] = gain[:, None] * r
    along = np.einsum("ni,nim->nm", r, j)
    scaled_jacobian[beyond] = gain[:, None, None] * j + (2.0 * slope)[:, None, None] * r[:, :, None] * along[:, None, :]
    return scaled, scaled_jacobian


def condensed(residuals: Array, jacobian: Array) -> Array:
    """[J r] (n, m + 1) as m + 1 rows with the same squares and products, so the same steps of least squares.

    The singular values of the tall J, which scipy's trust region wants at every step, took three quarters of a fit.
    """
    rows, columns = len(jacobian), jacobian.shape[1] + 1
    stacked = np.zeros((columns, max(rows, columns)))
    stacked[:-1, :rows] = jacobian.T
    stacked[-1, :rows] = residuals
    return np.asarray(_triangle(stacked))


def triangle(jacobian: Array) -> Array:
    """Upper triangular T (m, m) with a diagonal of 0 or more and Tᵀ T = Jᵀ J, of J (n, m)."""
    padded = np.zeros((jacobian.shape[1], max(jacobian.shape)))
    padded[:, : len(jacobian)] = jacobian.T
    root = np.asarray(_triangle(padded))
    return root * np.where(np.diag(root) < 0.0, -1.0, 1.0)[:, None]


def orthonormal(jacobian: Array, root: Array) -> Array:
    """Orthonormal columns (n, m) that span those of a derivative (n, m); `root` (m, m) measures its unknowns, as in
    `in_units_of`."""
    scaled = in_units_of(root, jacobian)
    own = triangle(scaled)
    # What moves nothing, such as friction where every contact sticks, has a column of zeros and keeps it.
    still = np.diag(own) < 1e-12 * np.diag(own).max()
    own[still, still] = 1.0
    return np.asarray(in_units_of(own, scaled))


@compiled
def _triangle(columns: Array) -> Array:
    """R (m, m) of the QR decomposition of a matrix given by its columns (m, n), n >= m, by Householder's reflections.

    LAPACK's own, threaded, takes ten times as long on a machine whose cores are busy, for matrices of this size.
    """
    m, n = columns.shape
    for j in range(m):
        norm = 0.0
        for i in range(j, n):
            norm += columns[j, i] ** 2
        norm = sqrt(norm)
        if norm == 0.0:
            continue
        pivot = columns[j, j] + (norm if columns[j, j] >= 0.0 else -norm)
        # The reflection 1 - β v vᵀ with v = (pivot, rest of the column); the column itself becomes (∓norm, 0, …).
        beta = 1.0 / (norm * abs(pivot))
        for k in range(j + 1, m):
            along = pivot * columns[k, j]
            for i in range(j + 1, n):
                along += columns[j, i] * columns[k, i]
            along *= beta
            columns[k, j] -= along * pivot
            for i in range(j + 1, n):
                columns[k, i] -= along * columns[j, i]
        columns[j, j] = -norm if columns[j, j] >= 0.0 else norm
        for i in range(j + 1, n):
            columns[j, i] = 0.0
    root = np.empty((m, m))
    for i in range(m):
        for j in range(m):
            root[i, j] = columns[j, i]
    return root


@compiled
def in_units_of(root: Array, jacobian: Array) -> Array:
    """J T⁻¹ (n, m) of J (n, m) and an upper triangular T (m, m): the derivative by u = T x."""
    n, m = jacobian.shape
    scaled = np.empty((n, m))
    for i in range(n):
        for j in range(m):
            rest = jacobian[i, j]
            for k in range(j):
                rest -= scaled[i, k] * root[k, j]
            scaled[i, j] = rest / root[j, j]
    return scaled


@compiled
def solved(root: Array, right: Array) -> Array:
    """T⁻¹ b (m,) of an upper triangular T (m, m)."""
    m = len(right)
    x = np.zeros(m)
    for j in range(m - 1, -1, -1):
        rest = right[j]
        for k in range(j + 1, m):
            rest -= root[j, k] * x[k]
        x[j] = rest / root[j, j]
    return x


def robust_variance(residuals: Array, degrees_of_freedom: float) -> float:
    """Variance of whitened residuals (n, 6), by the median frame, for a fit that left so many degrees of freedom."""
    s = (residuals**2).sum(1)
    return float(np.median(s)) / MEDIAN_FRAME * s.size * 6.0 / max(degrees_of_freedom, 1.0)
