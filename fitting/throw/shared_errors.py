"""Errors that all frames share, in the fit of a throw: those of cameras, die and clock as far as they are not known.

With u such errors in standard deviations and A their whitened derivative, the cost of a throw is the least over u of

    Σ ρ(|r - A u|²) + w |u + s|²,

r the residuals of the frames and s what tracking has subtracted from them already. u is solved for at every trial throw, and the
derivative of what remains is that of the throw's unknowns alone (variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10,
413, 1973). A fit has no more unknowns than before. Its information is that of throw and errors together, the errors integrated
out, and its intervals contain what the errors leave open.

The weight w of the prior is 1 while frames are as good as stated. Covariances are multiplied by what the residuals show beyond
that (`residual_errors`), which the prior must not be: its weight is then that factor.

Where nothing is unknown, nothing is computed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..estimation import FlightObservations

Array = NDArray[np.float64]

_MOST_STEPS = 50
"""Reweighted steps; where no frame is an outlier the first is exact."""

_SAME_ERRORS = 1e-9
"""Change of the errors [standard deviations] that ends the steps."""


@dataclass(frozen=True, eq=False)
class FrameResiduals:
    """Residuals of frames about a throw, without the errors that they share, with derivatives by the throw's p unknowns."""

    of_frames: Array
    """(n, 6) whitened."""
    by_frames: Array
    """(n, 6, p) their derivative."""
    of_prior: Array
    """(m,) the shared errors in standard deviations, times the root of their weight."""
    by_prior: Array
    """(m, p) their derivative."""


def without_shared_errors(
    observations: FlightObservations, residuals: Array, jacobian: Array, k2: float
) -> FrameResiduals:
    """The residuals (n, 6) and their derivative (n, 6, p), without the shared errors of least cost; `k2` as in
    `least_squares.huber`."""
    shared, weight = observations.shared, observations.shared_weight
    if shared is None:
        return FrameResiduals(residuals, jacobian, np.zeros(0), np.zeros((0, jacobian.shape[2])))
    A = observations.whitener @ shared.jacobian
    m = A.shape[2]
    errors, rest = np.zeros(m), residuals
    if not np.isfinite(residuals).all():
        # The throw leaves all that numbers hold; it has an infinite cost whatever the errors.
        return FrameResiduals(residuals, jacobian, errors, np.zeros((m, jacobian.shape[2])))
    for _ in range(_MOST_STEPS):
        squares = (rest**2).sum(1)
        weights = np.where(squares > k2, np.sqrt(k2 / np.maximum(squares, k2)), 1.0)
        weighted = weights[:, None, None] * A
        normal = np.einsum("nij,nik->jk", weighted, A) + weight * np.eye(m)
        before = errors
        errors = np.linalg.solve(normal, np.einsum("nij,ni->j", weighted, residuals) - weight * shared.subtracted)
        rest = residuals - A @ errors
        if (weights == 1.0).all() and ((rest**2).sum(1) <= k2).all():
            break
        if np.abs(errors - before).max() < _SAME_ERRORS:
            break
    slope = np.linalg.solve(normal, np.einsum("nij,nip->jp", weighted, jacobian))
    root = np.sqrt(weight)
    return FrameResiduals(rest, jacobian - A @ slope, root * (errors + shared.subtracted), root * slope)


def variance_shares(observations: FlightObservations, found: FrameResiduals, covariance: Array) -> dict[str, Array]:
    """What share of the variance of each unknown (p,) comes from the errors of each source; the rest comes from the frames.
    `covariance` (p, p) is that of the fit by the stated errors, with the prior's weight as it is."""
    if observations.shared is None:
        return {}
    # The prior of one error is one more observation, whose own error is that of the camera, the die or the clock.
    gain = covariance @ found.by_prior.T
    shares = gain**2 / np.diag(covariance)[:, None]
    sources = observations.shared.sources
    named = {name: [k for k, source in enumerate(sources) if source == name] for name in dict.fromkeys(sources)}
    return {name: shares[:, which].sum(axis=1) for name, which in named.items()}
