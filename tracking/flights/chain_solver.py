"""Least squares along a chain of flights, link by link, at a cost linear in the number of links.

To first order, flight k costs x_kᵀ H_k x_k + 2 g_kᵀ x_k for a change x_k of its state and of the parameters that all flights
share. A link takes x_k over to the next flight by its own changes u_k,

    x_{k+1} = F_k x_k + G_k u_k,

and the conditions of an impact add |R_k x_k + S_k u_k + r_k|². That is the linear-quadratic problem of optimal control, solved by
its Riccati recursion (e.g. Bertsekas, Dynamic Programming and Optimal Control, 1995, 4.1). From the last flight to the first, the
cost of all that follows is reduced to a quadratic xᵀ P x + 2 pᵀ x of the state before the link, by the best u = K x + k; then the
changes are found from the first flight to the last. P is computed as Aᵀ P A with A = F + G K, a sum of squares, which rounding
cannot make negative as it can a difference.

**Covariance.** The gradients p are sums of independent parts with known covariances: those of the flights, and the identity for
the conditions of impacts. With C_k the response of x_k to p_k, and a_k the contribution of the flights before to x_k,

    x_k = a_k + C_k p_k,     C_{k+1} = A C_k Aᵀ - G Q⁻¹ Gᵀ,

Q the matrix of u_k: the covariance of each state and its link follows from those of a_k and p_k in one pass.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner, inner_nogil
from ..covariance import scaled_inverse

Array = NDArray[np.float64]

MAX_LINK_SIZE = 12
"""Most parameters of a link; those of a link with fewer come first, and the others are zero."""
LEAST_DAMPING = 1e-9
"""Added to the diagonal of every damped matrix: a parameter that no frame determines, as of a flight between two frames, stays
where it is."""
OPEN_PIVOT = 1e-13
"""Squared pivot of a scaled matrix below which only rounding is left: that parameter is undetermined, and stays where it is."""


class Stages(NamedTuple):
    """The links of a chain, for states of d numbers: how the state behind each follows from that before, and the conditions of
    its impact."""

    sizes: NDArray[np.int64]
    """(N,) number of parameters of each."""
    by_state: Array
    """F (N, d, d)."""
    by_link: Array
    """G (N, d, MAX_LINK_SIZE)."""
    impact_by_state: Array
    """R (N, 4, d); zero without conditions."""
    impact_by_link: Array
    """S (N, 4, MAX_LINK_SIZE)."""
    violation: Array
    """r (N, 4)."""


@compiled(nogil=True)
def empty_stages(count: int, d: int) -> Stages:
    """So many links, all zero, for states of d numbers."""
    return Stages(
        np.zeros(count, np.int64), np.zeros((count, d, d)), np.zeros((count, d, MAX_LINK_SIZE)),
        np.zeros((count, 4, d)), np.zeros((count, 4, MAX_LINK_SIZE)), np.zeros((count, 4)),
    )  # fmt: skip


class LinkResponses(NamedTuple):
    """The best parameters of each link, u = K x + k, for a state x before it."""

    K: Array
    """(N, MAX_LINK_SIZE, d)."""
    k: Array
    """(N, MAX_LINK_SIZE)."""
    inverse: Array
    """Q⁻¹ (N, MAX_LINK_SIZE, MAX_LINK_SIZE)."""


@compiled(nogil=True)
def _empty_responses(count: int, d: int) -> LinkResponses:
    """Of so many links, all zero."""
    return LinkResponses(
        np.zeros((count, MAX_LINK_SIZE, d)), np.zeros((count, MAX_LINK_SIZE)),
        np.zeros((count, MAX_LINK_SIZE, MAX_LINK_SIZE)),
    )  # fmt: skip


@compiled(nogil=True)
def solve_chain(normal: Array, gradient: Array, stages: Stages, damping: float) -> tuple[Array, Array]:
    """The changes of least cost: of the first state (d,), and of each link (N, MAX_LINK_SIZE).

    `normal` (N + 1, d, d) and `gradient` (N + 1, d) are those of the flights, `damping` is Levenberg's.
    """
    count, d = len(stages.sizes), normal.shape[1]
    P, p = normal[count].copy(), gradient[count].copy()
    responses = _empty_responses(count, d)
    _backward_pass(normal, gradient, stages, damping, P, p, responses)
    first, changes = np.zeros(d), np.zeros((count, MAX_LINK_SIZE))
    _forward_pass(P, p, stages, damping, responses, first, changes)
    return first, changes


def chain_covariance(normal: Array, noises: Array, stages: Stages) -> tuple[Array, Array]:
    """Covariance of the last state (d, d), and joint covariance of each state before it with the parameters of its link
    (N, d + MAX_LINK_SIZE, d + MAX_LINK_SIZE).

    `noises` (N + 1, d, d) are the covariances of the flights' gradients; if they are `normal`, the result is the inverse of the
    chain's normal matrix.
    """
    count, d = len(stages.sizes), normal.shape[1]
    P, p = normal[-1].copy(), np.zeros(d)
    K, _, inverse = responses = _empty_responses(count, d)
    _backward_pass(normal, np.zeros((count + 1, d)), stages, 0.0, P, p, responses)
    A, R = stages.by_state + stages.by_link @ K, stages.impact_by_state + stages.impact_by_link @ K
    later_noise = np.empty_like(normal)
    later_noise[-1] = noises[-1]
    for j in range(count - 1, -1, -1):
        later_noise[j] = noises[j] + A[j].T @ later_noise[j + 1] @ A[j] + R[j].T @ R[j]
    C, earlier = -scaled_inverse(P), np.zeros((d, d))
    joint = np.empty((count, d + MAX_LINK_SIZE, d + MAX_LINK_SIZE))
    for j in range(count):
        F, G = stages.by_state[j], stages.by_link[j]
        state_and_link = np.vstack([np.eye(d), K[j]])
        response = state_and_link @ C @ np.hstack([R[j].T, A[j].T])
        response[d:] -= inverse[j] @ np.hstack([stages.impact_by_link[j].T, G.T])
        by_impact, by_later = response[:, :4], response[:, 4:]
        before = earlier + C @ noises[j] @ C.T
        joint[j] = (
            state_and_link @ before @ state_and_link.T
            + by_impact @ by_impact.T
            + by_later @ later_noise[j + 1] @ by_later.T
        )
        passed_on = F @ by_impact[:d] + G @ by_impact[d:]
        earlier = A[j] @ before @ A[j].T + passed_on @ passed_on.T
        C = A[j] @ C @ A[j].T - G @ inverse[j] @ G.T
    return earlier + C @ later_noise[-1] @ C.T, joint


@compiled(nogil=True)
def _backward_pass(
    normal: Array, gradient: Array, stages: Stages, damping: float, P: Array, p: Array, responses: LinkResponses
) -> None:
    """Riccati recursion from the cost of the last flight (P, p) to the cost-to-go of the first, in place. Fills the responses."""
    sizes, by_state, by_link, impact_by_state, impact_by_link, violation = stages
    K, k, inverse = responses
    d = len(p)
    Q, cross, link_gradient = (
        np.empty((MAX_LINK_SIZE, MAX_LINK_SIZE)),
        np.empty((MAX_LINK_SIZE, d)),
        np.empty(MAX_LINK_SIZE),
    )
    PG, PA, A, R, gradient_before = (
        np.empty((d, MAX_LINK_SIZE)),
        np.empty((d, d)),
        np.empty((d, d)),
        np.empty((4, d)),
        np.empty(d),
    )
    for link in range(len(sizes) - 1, -1, -1):
        q, F, G = sizes[link], by_state[link], by_link[link]
        S, r = impact_by_link[link], violation[link]
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
            link_gradient[a] = total
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
                    total += S[c, a] * impact_by_state[link, c, b]
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
                total += inverse[link, a, c] * link_gradient[c]
            k[link, a] = -total
        for a in range(d):
            for b in range(d):
                total = F[a, b]
                for c in range(q):
                    total += G[a, c] * K[link, c, b]
                A[a, b] = total
        for a in range(4):
            for b in range(d):
                total = impact_by_state[link, a, b]
                for c in range(q):
                    total += S[a, c] * K[link, c, b]
                R[a, b] = total
        for a in range(d):
            total = gradient[link, a]
            for c in range(d):
                total += F[c, a] * p[c]
            for c in range(4):
                total += impact_by_state[link, c, a] * r[c]
            for c in range(q):
                total += cross[c, a] * k[link, c]
            gradient_before[a] = total
            for b in range(d):
                total = 0.0
                for c in range(d):
                    total += P[a, c] * A[c, b]
                PA[a, b] = total
        for a in range(d):
            p[a] = gradient_before[a]
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


@inner_nogil
def _forward_pass(
    P: Array, p: Array, stages: Stages, damping: float, responses: LinkResponses, first: Array, changes: Array
) -> None:
    """Fill the changes, from the first flight to the last."""
    by_state, by_link, K, k = stages.by_state, stages.by_link, responses.K, responses.k
    d = len(p)
    inverse, x, state_after = np.empty((d, d)), np.empty(d), np.empty(d)
    _invert_damped(P, d, damping, inverse)
    for a in range(d):
        total = 0.0
        for b in range(d):
            total -= inverse[a, b] * p[b]
        first[a] = total
        x[a] = total
    for link in range(len(k)):
        for a in range(MAX_LINK_SIZE):
            total = k[link, a]
            for b in range(d):
                total += K[link, a, b] * x[b]
            changes[link, a] = total
        for a in range(d):
            total = 0.0
            for b in range(d):
                total += by_state[link, a, b] * x[b]
            for b in range(MAX_LINK_SIZE):
                total += by_link[link, a, b] * changes[link, b]
            state_after[a] = total
        for a in range(d):
            x[a] = state_after[a]


@inner
def _invert_damped(matrix: Array, n: int, damping: float, inverse: Array) -> None:
    """Inverse of the leading (n, n) block with Levenberg's damping."""
    damped = np.empty((n, n))
    for a in range(n):
        for b in range(n):
            damped[a, b] = matrix[a, b]
        if damping > 0.0:
            damped[a, a] += damping * matrix[a, a] + LEAST_DAMPING
    _invert(damped, n, inverse)


@inner
def _invert(matrix: Array, n: int, inverse: Array) -> None:
    """Inverse of the leading (n, n) block of a positive matrix by Cholesky, after scaling its diagonal to one; rows of
    undetermined parameters (OPEN_PIVOT) are zero."""
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
