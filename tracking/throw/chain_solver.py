"""Least squares along a chain of flights, link by link, at a cost that grows with the number of links.

To the first order, flight k costs x_kᵀ H_k x_k + 2 g_kᵀ x_k for a change x_k of its state and of what all flights share, a
link takes x_k over to the next flight by its own changes u_k,

    x_{k+1} = F_k x_k + G_k u_k,

and what a contact obeys adds |R_k x_k + S_k u_k + r_k|². That is a linear-quadratic problem, as in optimal control, and is
solved as such (Riccati; e.g. Bertsekas, Dynamic Programming and Optimal Control, 1995, 4.1): from the last flight to the
first, what all that follows costs is brought down to a quadratic xᵀ P x + 2 pᵀ x of the state before the link, by the best
u = K x + k; then the changes are found from the first flight to the last. P is taken together as Aᵀ P A with A = F + G K, a sum
of squares, which rounding cannot make negative as it can a difference.

**How sure it is.** The gradients p are sums of independent parts with known covariances (`noises`: those of the flights, and
the identity for what a contact obeys). With C_k the response of x_k to p_k, and a_k what x_k owes to the flights before,

    x_k = a_k + C_k p_k,     C_{k+1} = A C_k Aᵀ - G Q⁻¹ Gᵀ,

Q the matrix of u_k: the covariance of each state and its link follows from those of a_k and p_k in one pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner
from .flights import scaled_inverse

Array = NDArray[np.float64]

MOST = 12
"""Numbers that a link may have; those of one that has fewer come first, and the others are zero."""
HELD = 1e-9
"""Added to the matrix of every change: a number that no frame knows of, as of a flight between two frames, stays where it is."""
OPEN_PIVOT = 1e-13
"""Squared pivot of a scaled matrix below which nothing but rounding is left: that number is open, and stays where it is."""


@dataclass(frozen=True, eq=False)
class Stages:
    """The links of a chain, for states of d numbers: how the state behind each follows from that before, and what its
    contact obeys."""

    sizes: NDArray[np.int64]
    """(N,) how many numbers each has."""
    onward: Array
    """F (N, d, d)."""
    turned: Array
    """G (N, d, MOST)."""
    rows: Array
    """R (N, 4, d); zero where nothing is obeyed."""
    own_rows: Array
    """S (N, 4, MOST)."""
    miss: Array
    """r (N, 4)."""

    @staticmethod
    def empty(count: int, d: int) -> Stages:
        """So many links that do nothing yet."""
        shapes = ((d, d), (d, MOST), (4, d), (4, MOST), (4,))
        return Stages(np.zeros(count, np.int64), *(np.zeros((count, *shape)) for shape in shapes))

    @property
    def arrays(self) -> tuple[NDArray[np.int64], Array, Array, Array, Array, Array]:
        """All of them, in this order."""
        return self.sizes, self.onward, self.turned, self.rows, self.own_rows, self.miss


def solve_chain(normal: Array, gradient: Array, stages: Stages, damping: float) -> tuple[Array, Array]:
    """The changes that cost least: of the first state (d,), and of each link (N, MOST).

    `normal` (N + 1, d, d) and `gradient` (N + 1, d) are those of the flights, `damping` Levenberg's.
    """
    count, d = len(stages.sizes), normal.shape[1]
    P, p = normal[-1].copy(), gradient[-1].copy()
    K, k, inverse = np.zeros((count, MOST, d)), np.zeros((count, MOST)), np.zeros((count, MOST, MOST))
    _way_back(normal, gradient, *stages.arrays, damping, P, p, K, k, inverse)
    first, changes = np.zeros(d), np.zeros((count, MOST))
    _way_on(P, p, stages.onward, stages.turned, damping, K, k, first, changes)
    return first, changes


def spread_along(normal: Array, noises: Array, stages: Stages) -> tuple[Array, Array]:
    """Covariance of the last state (d, d), and of each state before together with its link's numbers (N, d + MOST, d + MOST).

    `noises` (N + 1, d, d) are the covariances of the flights' gradients; where they are `normal`, the result is the inverse
    of the chain's normal matrix.
    """
    count, d = len(stages.sizes), normal.shape[1]
    P, p = normal[-1].copy(), np.zeros(d)
    K, k, inverse = np.zeros((count, MOST, d)), np.zeros((count, MOST)), np.zeros((count, MOST, MOST))
    _way_back(normal, np.zeros((count + 1, d)), *stages.arrays, 0.0, P, p, K, k, inverse)
    A, R = stages.onward + stages.turned @ K, stages.rows + stages.own_rows @ K
    ahead = np.empty_like(normal)
    ahead[-1] = noises[-1]
    for k_ in range(count - 1, -1, -1):
        ahead[k_] = noises[k_] + A[k_].T @ ahead[k_ + 1] @ A[k_] + R[k_].T @ R[k_]
    C, owed, beside = -scaled_inverse(P), np.zeros((d, d)), np.empty((count, d + MOST, d + MOST))
    for j in range(count):
        F, G = stages.onward[j], stages.turned[j]
        both = np.vstack([np.eye(d), K[j]])
        answer = both @ C @ np.hstack([R[j].T, A[j].T])
        answer[d:] -= inverse[j] @ np.hstack([stages.own_rows[j].T, G.T])
        own, later = answer[:, :4], answer[:, 4:]
        before = owed + C @ noises[j] @ C.T
        beside[j] = both @ before @ both.T + own @ own.T + later @ ahead[j + 1] @ later.T
        told = F @ own[:d] + G @ own[d:]
        owed = A[j] @ before @ A[j].T + told @ told.T
        C = A[j] @ C @ A[j].T - G @ inverse[j] @ G.T
    return owed + C @ ahead[-1] @ C.T, beside


@compiled(nogil=True)
def _way_back(
    normal: Array, gradient: Array, sizes: NDArray[np.int64], onward: Array, turned: Array, rows: Array, own_rows: Array,
    miss: Array, damping: float, P: Array, p: Array, K: Array, k: Array, inverse: Array,
) -> None:  # fmt: skip
    """From what the last flight costs (P, p) to what all costs seen from the first, and how each link answers (K, k) to the
    state before it; with the inverse matrix of its numbers."""
    d = len(p)
    Q, cross, pull = np.empty((MOST, MOST)), np.empty((MOST, d)), np.empty(MOST)
    PG, PA, A, R, onto = np.empty((d, MOST)), np.empty((d, d)), np.empty((d, d)), np.empty((4, d)), np.empty(d)
    for link in range(len(sizes) - 1, -1, -1):
        q, F, G = sizes[link], onward[link], turned[link]
        S, r = own_rows[link], miss[link]
        for a in range(d):
            for b in range(q):
                total = 0.0
                for c in range(d):
                    total += P[a, c] * G[c, b]
                PG[a, b] = total
        for a in range(q):
            total = 0.0
            for c in range(d):
                total += G[c, a] * p[c]
            for c in range(4):
                total += S[c, a] * r[c]
            pull[a] = total
            for b in range(q):
                total = 0.0
                for c in range(d):
                    total += G[c, a] * PG[c, b]
                for c in range(4):
                    total += S[c, a] * S[c, b]
                Q[a, b] = total
            for b in range(d):
                total = 0.0
                for c in range(d):
                    total += PG[c, a] * F[c, b]
                for c in range(4):
                    total += S[c, a] * rows[link, c, b]
                cross[a, b] = total
        _invert_damped(Q, q, damping, inverse[link])
        for a in range(q):
            for b in range(d):
                total = 0.0
                for c in range(q):
                    total += inverse[link, a, c] * cross[c, b]
                K[link, a, b] = -total
            total = 0.0
            for c in range(q):
                total += inverse[link, a, c] * pull[c]
            k[link, a] = -total
        for a in range(d):
            for b in range(d):
                total = F[a, b]
                for c in range(q):
                    total += G[a, c] * K[link, c, b]
                A[a, b] = total
        for a in range(4):
            for b in range(d):
                total = rows[link, a, b]
                for c in range(q):
                    total += S[a, c] * K[link, c, b]
                R[a, b] = total
        for a in range(d):
            total = gradient[link, a]
            for c in range(d):
                total += F[c, a] * p[c]
            for c in range(4):
                total += rows[link, c, a] * r[c]
            for c in range(q):
                total += cross[c, a] * k[link, c]
            onto[a] = total
            for b in range(d):
                total = 0.0
                for c in range(d):
                    total += P[a, c] * A[c, b]
                PA[a, b] = total
        for a in range(d):
            p[a] = onto[a]
            for b in range(a + 1):
                total = normal[link, a, b]
                for c in range(d):
                    total += A[c, a] * PA[c, b]
                for c in range(4):
                    total += R[c, a] * R[c, b]
                for c in range(q):
                    total += damping * Q[c, c] * K[link, c, a] * K[link, c, b]
                P[a, b] = total
                P[b, a] = total


@compiled(nogil=True)
def _way_on(
    P: Array, p: Array, onward: Array, turned: Array, damping: float, K: Array, k: Array, first: Array, changes: Array
) -> None:
    """The changes, from the first flight to the last."""
    d = len(p)
    inverse, x, behind = np.empty((d, d)), np.empty(d), np.empty(d)
    _invert_damped(P, d, damping, inverse)
    for a in range(d):
        total = 0.0
        for b in range(d):
            total -= inverse[a, b] * p[b]
        first[a] = total
        x[a] = total
    for link in range(len(k)):
        for a in range(MOST):
            total = k[link, a]
            for b in range(d):
                total += K[link, a, b] * x[b]
            changes[link, a] = total
        for a in range(d):
            total = 0.0
            for b in range(d):
                total += onward[link, a, b] * x[b]
            for b in range(MOST):
                total += turned[link, a, b] * changes[link, b]
            behind[a] = total
        for a in range(d):
            x[a] = behind[a]


@inner
def _invert_damped(matrix: Array, n: int, damping: float, inverse: Array) -> None:
    """Inverse of the first (n, n) with Levenberg's damping."""
    held = np.empty((n, n))
    for a in range(n):
        for b in range(n):
            held[a, b] = matrix[a, b]
        if damping > 0.0:
            held[a, a] += damping * matrix[a, a] + HELD
    _invert(held, n, inverse)


@inner
def _invert(matrix: Array, n: int, inverse: Array) -> None:
    """Inverse of the first (n, n) of a positive matrix by Cholesky, its diagonal scaled to one; zero for a number that it
    leaves open."""
    unit, L, x = np.zeros(n), np.zeros((n, n)), np.empty(n)
    for i in range(n):
        if matrix[i, i] > 0.0:
            unit[i] = 1.0 / sqrt(matrix[i, i])
        for j in range(i + 1):
            total = matrix[i, j] * unit[i] * unit[j]
            for c in range(j):
                total -= L[i, c] * L[j, c]
            if i == j:
                L[i, i] = sqrt(total) if total > OPEN_PIVOT else 0.0
            elif L[j, j] > 0.0:
                L[i, j] = total / L[j, j]
    for column in range(n):
        for i in range(n):
            x[i] = 1.0 if i == column else 0.0
            for c in range(i):
                x[i] -= L[i, c] * x[c]
            x[i] = x[i] / L[i, i] if L[i, i] > 0.0 else 0.0
        for i in range(n - 1, -1, -1):
            for c in range(i + 1, n):
                x[i] -= L[c, i] * x[c]
            x[i] = x[i] / L[i, i] if L[i, i] > 0.0 else 0.0
        for i in range(n):
            inverse[i, column] = x[i] * unit[i] * unit[column]
