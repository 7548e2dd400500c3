"""What the residuals of a fit show of the frames' errors and of the law: variance, correlation, and misfit.

Least squares gives the covariance (Jᵀ J)⁻¹ if every whitened residual is independent and of unit variance. Three departures are
corrected.

- *Variance and correlation of the frames*: each of the six whitened errors is the sum of a white and an AR(1) part, of which the
  restricted likelihood of the residuals is greatest (`tracking.flights.error_model`). The autocorrelation of the residuals itself
  would be too small: what a fit has absorbed of a slow error looks like none.
- *How a parameter draws on the frames*: a parameter is a sum Σ gᵀ r over the residuals, and its variance Σ gᵀ Σ g with Σ the
  covariance of this error model (sandwich estimate, Liang & Zeger, Biometrika 73, 13, 1986). One that is a slow function of time
  suffers from correlations in full, one that compares neighbours hardly; positions and rotations err in their own ways.
- *Misfit of the law*: value and rate of each flight's residuals are what the law has not joined. Their sum of squares, over that
  which the errors of the frames alone would give, is 1 where the law holds; variances are multiplied by what exceeds 1 (Birge,
  Phys. Rev. 40, 207, 1932). One bounce has few such numbers: misfit of a law shows better with more.

Nothing is taken below what the frames state. Covariances may state errors that are correlated as larger independent ones, as
those of tracking do: residuals are then smaller than stated, and correlated, and both together are compared with what is stated.
An error that all frames share shows in no residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...tracking.flights import ErrorModel, error_model_of

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ResidualErrors:
    """The errors of frames, by the residuals (n, 6) of a fit with p parameters to flights."""

    model: ErrorModel
    spacing_s: float
    """Between frames."""
    misfit: float
    """Mean square of what flights differ from the law, over that by the errors of the frames; at least 1."""

    @property
    def variance(self) -> float:
        """Of single residuals, the mean of the six."""
        return float(self.model.variance.mean())

    @property
    def correlation_time(self) -> float:
        """Frames that count as one in a mean over many."""
        return float(self.model.long_run_variance(self.spacing_s).mean()) / self.variance

    @property
    def scale(self) -> float:
        """Factor on the variance of a parameter that is a slow function of time, at least 1; it divides gains in likelihood."""
        return max(1.0, self.variance * self.correlation_time * self.misfit)

    def variance_of(self, gains: Array, time_s: Array, flight: Integers) -> Array:
        """Covariance (p, p) of Σ gᵀ r over whitened residuals r (n, 6), with gains g (n, 6, p), at times (n,) in flights (n,)."""
        # Of each component: the sum of the earlier gains, each with the correlation that is left of it.
        earlier = np.zeros_like(gains)
        keep = np.exp(-np.diff(time_s, prepend=time_s[:1])[:, None] / self.model.correlation_time_s)
        keep[np.diff(flight, prepend=flight[:1] - 1) != 0] = 0.0
        for k in range(1, len(gains)):
            earlier[k] = keep[k][:, None] * (earlier[k - 1] + gains[k - 1])
        slow = self.model.variance_ratio[:, None]
        weighted = gains * (self.model.scale**2)[:, None]
        crossed = np.einsum("tip,tiq->pq", weighted * slow, earlier)
        return self.misfit * (np.einsum("tip,tiq->pq", weighted * (1.0 + slow), gains) + crossed + crossed.T)

    def innovations(self, residuals: Array, time_s: Array, flight: Integers) -> Array:
        """Errors (n, 6) that are independent and of unit variance, if the residuals have this error model: what the Kalman filter
        of its two parts does not predict."""
        found = np.empty_like(residuals)
        predicted = np.zeros(6)
        for k, (keep, gain, size) in enumerate(self._filter(time_s, flight)):
            predicted = keep * predicted
            found[k] = (residuals[k] - predicted) / size
            predicted = predicted + gain * size * found[k]
        return found

    def errors_of(self, innovations: Array, time_s: Array, flight: Integers) -> Array:
        """The errors (n, 6) that have these innovations."""
        found = np.empty_like(innovations)
        predicted = np.zeros(6)
        for k, (keep, gain, size) in enumerate(self._filter(time_s, flight)):
            predicted = keep * predicted
            found[k] = predicted + size * innovations[k]
            predicted = predicted + gain * size * innovations[k]
        return found

    def _filter(self, time_s: Array, flight: Integers) -> list[tuple[Array, Array, Array]]:
        """For each frame, of the six components: what is left of the prediction of the frame before, the gain by which an error
        enters the next, and the standard deviation of what is not predicted."""
        white, slow = self.model.scale**2, self.model.scale**2 * self.model.variance_ratio
        variance, steps = slow, []
        for k in range(len(time_s)):
            if k == 0 or flight[k] != flight[k - 1]:
                keep, variance = np.zeros(6), slow
            else:
                keep = np.exp(-(time_s[k] - time_s[k - 1]) / self.model.correlation_time_s)
                variance = keep**2 * variance + (1.0 - keep**2) * slow
            gain = variance / (variance + white)
            steps.append((keep, gain, np.sqrt(variance + white)))
            variance = variance * (1.0 - gain)
        return steps


def residual_errors(residuals: Array, time_s: Array, flight: Integers, parameters: int) -> ResidualErrors:
    """The errors that whitened residuals (n, 6) at times (n,) [s] show, of a fit with so many parameters to flights (n,)."""
    runs = [np.flatnonzero(flight == k) for k in np.unique(flight)]
    model = error_model_of([time_s[run] for run in runs], [residuals[run] for run in runs])
    steps = np.concatenate([np.diff(time_s[run]) for run in runs])
    spacing_s = float(np.median(steps)) if len(steps) else 1.0
    found, expected, count = 0.0, 0.0, 0
    unscaled = ResidualErrors(model, spacing_s, 1.0)
    for run in runs:
        if len(run) > 2:
            line = _line(time_s[run])
            found += float(((line.T @ residuals[run]) ** 2).sum())
            gains = np.zeros((len(run), 6, 12))
            for k in range(6):
                gains[:, k, 2 * k : 2 * k + 2] = line
            expected += float(np.trace(unscaled.variance_of(gains, time_s[run], flight[run])))
            count += 12
    # The fit has absorbed its share of what the errors of the frames would give.
    left = expected * (1.0 - parameters / count) if count > parameters else 0.0
    return ResidualErrors(model, spacing_s, max(1.0, found / left) if left > 0.0 else 1.0)


def not_below(covariance: Array, root: Array) -> Array:
    """A covariance (p, p), in no direction below the one whose information is `root`ᵀ `root`."""
    eigenvalues, axes = np.linalg.eigh(root @ covariance @ root.T)
    half = np.linalg.solve(root, axes * np.sqrt(np.maximum(eigenvalues, 1.0)))
    return np.asarray(half @ half.T, dtype=np.float64)


def _line(time_s: Array) -> Array:
    """Orthonormal value and rate (n, 2) over times (n,)."""
    rate = time_s - time_s.mean()
    return np.stack([np.full(len(time_s), len(time_s) ** -0.5), rate / np.linalg.norm(rate)], axis=1)
