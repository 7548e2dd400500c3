"""Least squares along a chain of flights, link by link, at a cost that grows with the number of links.

To the first order, flight k costs x_kᵀ H_k x_k + 2 g_kᵀ x_k for a change x_k of its state and of what all flights share, a
link takes x_k over to the next flight by its own changes u_k,

    x_{k+1} = F_k x_k + G_k u_k,

and what a contact obeys adds |R_k x_k + S_k u_k + r_k|². That is a linear-quadratic problem, as in optimal control, and is
solved as such (Riccati; e.g. Bertsekas, Dynamic Programming and Optimal Control, 1995, 4.1): from the last flight to the
first, what all that follows costs is brought down to a quadratic xᵀ P x + 2 pᵀ x of the state before the link, by the best
u = K x + k; then the changes are found from the first flight to the last. P is taken together as A^T P A with A = F + G K, a sum
of squares, which rounding cannot make negative as it can a difference.

**How sure it is.** The gradients p are sums of independent parts with known covariances (`noises`: those of the flights, and
the identity for what a contact obeys). With C_k the response of x_k to p_k, and a_k what x_k owes to the flights before,

    x_k = a_k + C_k p_k,     C_{k+1} = A C_k Aᵀ - G Q⁻¹ Gᵀ,

Q the matrix of u_k: the covariance of each state and its link follows from those of a_k and p_k in one pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .flights import scaled_inverse

Array = NDArray[np.float64]

HELD = 1e-9
"""Added to the matrix of every change: a number that no frame knows of, as of a flight between two frames, stays where it is."""


@dataclass(frozen=True, eq=False)
class Stage:
    """A link: how the state behind it follows from that before, and what its contact obeys."""

    onward: Array
    """F (d, d)."""
    turned: Array
    """G (d, q) for the q numbers of the link."""
    rows: Array
    """R (r, d); r may be 0."""
    own_rows: Array
    """S (r, q)."""
    miss: Array
    """r (r,)."""


@dataclass(frozen=True, eq=False)
class _Return:
    """The way back through one link."""

    K: Array
    k: Array
    inverse: Array
    """Q⁻¹."""
    A: Array
    """F + G K."""
    R: Array
    """R + S K."""


def solve_chain(
    normal: Array, gradient: Array, stages: Sequence[Stage], damping: float
) -> tuple[Array, tuple[Array, ...]]:
    """The changes that cost least: of the first state (d,), and of each link (q,).

    `normal` (N + 1, d, d) and `gradient` (N + 1, d) are those of the flights, `damping` Levenberg's.
    """
    returns, P, p = _way_back(normal, gradient, stages, damping)
    x = -_damped_inverse(P, damping) @ p
    first, changes = x, []
    for stage, back in zip(stages, returns, strict=True):
        u = back.K @ x + back.k
        changes.append(u)
        x = stage.onward @ x + stage.turned @ u
    return first, tuple(changes)


def spread_along(normal: Array, noises: Array, stages: Sequence[Stage]) -> tuple[Array, tuple[Array, ...]]:
    """Covariance of the last state (d, d), and of each state before together with its link's numbers (d + q, d + q).

    `noises` (N + 1, d, d) are the covariances of the flights' gradients; where they are `normal`, the result is the inverse
    of the chain's normal matrix.
    """
    returns, P, _ = _way_back(normal, np.zeros(normal.shape[:2]), stages, 0.0)
    ahead = [noises[-1]]
    for noise, back in zip(noises[-2::-1], reversed(returns), strict=True):
        ahead.append(noise + back.A.T @ ahead[-1] @ back.A + back.R.T @ back.R)
    ahead.reverse()
    C, owed, beside = -scaled_inverse(P), np.zeros_like(P), []
    for k, (stage, back) in enumerate(zip(stages, returns, strict=True)):
        both = np.vstack([np.eye(len(C)), back.K])
        lead = back.inverse @ np.hstack([stage.own_rows.T, stage.turned.T])
        answer = both @ C @ np.hstack([back.R.T, back.A.T])
        answer[len(C) :] -= lead
        r = len(back.R)
        before = owed + C @ noises[k] @ C.T
        own, later = answer[:, :r], answer[:, r:]
        beside.append(both @ before @ both.T + own @ own.T + later @ ahead[k + 1] @ later.T)
        onward = np.hstack([stage.onward, stage.turned])
        told = onward @ own
        owed = back.A @ before @ back.A.T + told @ told.T
        C = back.A @ C @ back.A.T - stage.turned @ back.inverse @ stage.turned.T
    return owed + C @ ahead[-1] @ C.T, tuple(beside)


def _way_back(
    normal: Array, gradient: Array, stages: Sequence[Stage], damping: float
) -> tuple[list[_Return], Array, Array]:
    """How each link answers to the state before it; and the quadratic (P, p) of the first state."""
    P, p = normal[-1], gradient[-1]
    returns = []
    for k in range(len(stages) - 1, -1, -1):
        stage = stages[k]
        pulled = stage.turned.T @ P
        Q = pulled @ stage.turned + stage.own_rows.T @ stage.own_rows
        cross = pulled @ stage.onward + stage.own_rows.T @ stage.rows
        inverse = _damped_inverse(Q, damping)
        K, own = -inverse @ cross, -inverse @ (stage.turned.T @ p + stage.own_rows.T @ stage.miss)
        A, R = stage.onward + stage.turned @ K, stage.rows + stage.own_rows @ K
        p = gradient[k] + stage.onward.T @ p + stage.rows.T @ stage.miss + cross.T @ own
        P = normal[k] + A.T @ P @ A + R.T @ R + damping * (K.T * np.diag(Q)) @ K
        returns.append(_Return(K, own, inverse, A, R))
    returns.reverse()
    return returns, P, p


def _damped_inverse(matrix: Array, damping: float) -> Array:
    if damping == 0.0:
        return scaled_inverse(matrix)
    held = matrix.copy()
    held.flat[:: len(held) + 1] += damping * np.diag(matrix) + HELD
    return scaled_inverse(held)
