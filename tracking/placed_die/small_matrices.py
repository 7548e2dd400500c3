"""Linear algebra of matrices with a few rows, for kernels: no library call is worth its overhead there."""

from __future__ import annotations

from math import atan2, cos, sin, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_no_memory, inner_nogil

SMALL_ANGLE_RAD = 1e-8
"""Rotation below which the first-order form of the exponential is exact to rounding."""
SMALL_SINE = 1e-9
"""Sine below which the first-order form of the logarithm is exact to rounding."""
LEAST_PIVOT = 1e-12
"""Part of its diagonal that a pivot of a definite matrix keeps at the least, in `solve_positive`."""
LEAST_INVERTED_PIVOT = 1e-13
"""The same in `inverse_positive`."""


@inner_no_memory
def cholesky_factor(A: Any, K: int, L: Any, least: float) -> bool:
    """Cholesky factor of the leading K × K of A, in L, which may be A. False if a pivot keeps no more than the part
    `least` of its diagonal."""
    for i in range(K):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > least * A[i, i]:
                    return False
                L[i, i] = sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    return True


@inner_no_memory
def solve_factored(L: Any, K: int, y: Any, out: Any) -> None:
    """Solve L Lᵀ out = y."""
    for i in range(K):
        s = y[i]
        for k in range(i):
            s -= L[i, k] * out[k]
        out[i] = s / L[i, i]
    for i in range(K - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, K):
            s -= L[k, i] * out[k]
        out[i] = s / L[i, i]


@inner_no_memory
def solve_positive(A: Any, n: int, y: Any, out: Any) -> bool:
    """Solve the leading n × n of a symmetric positive definite A out = y, whose Cholesky factor replaces the lower
    triangle of A; False where it is not definite."""
    if not cholesky_factor(A, n, A, LEAST_PIVOT):
        return False
    solve_factored(A, n, y, out)
    return True


@inner_nogil
def inverse_positive(A: Any, n: int, out: Any) -> bool:
    """Fill the inverse of the leading n × n of a symmetric positive definite matrix; False if it is not definite."""
    L, e, x = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    if not cholesky_factor(A, n, L, LEAST_INVERTED_PIVOT):
        return False
    for a in range(n):
        e[:] = 0.0
        e[a] = 1.0
        solve_factored(L, n, e, x)
        for b in range(n):
            out[b, a] = x[b]
    return True


@inner_nogil
def product(A: Any, B: Any) -> Any:
    """A B (3, 3)."""
    out = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            out[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]
    return out


@inner_nogil
def turn_from(R: Any, Q: Any) -> Any:
    """Q Rᵀ (3, 3): the rotation that takes R to Q."""
    out = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            out[a, b] = Q[a, 0] * R[b, 0] + Q[a, 1] * R[b, 1] + Q[a, 2] * R[b, 2]
    return out


@inner_nogil
def turn(R: Any, w: Any) -> Any:
    """exp(w) R."""
    return product(rotation_exp(w), R)


@inner_nogil
def rotation_exp(w: Any) -> Any:
    """exp(w) (3, 3) by Rodrigues' formula."""
    angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    W = np.zeros((3, 3))
    W[0, 1], W[0, 2], W[1, 2] = -w[2], w[1], -w[0]
    W[1, 0], W[2, 0], W[2, 1] = w[2], -w[1], w[0]
    if angle < SMALL_ANGLE_RAD:
        return np.eye(3) + W
    s, c = sin(angle) / angle, (1.0 - cos(angle)) / (angle * angle)
    E = np.eye(3)
    for i in range(3):
        for j in range(3):
            square = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
            E[i, j] += s * W[i, j] + c * square
    return E


@inner_no_memory
def rotation_log(R: Any, out: Any) -> None:
    """Fill the rotation vector (3,) of a rotation by less than about 3 rad."""
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    s = 0.5 * sqrt(x * x + y * y + z * z)
    c = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    factor = 0.5 if s < SMALL_SINE else 0.5 * atan2(s, c) / s
    out[0], out[1], out[2] = factor * x, factor * y, factor * z
