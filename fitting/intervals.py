"""Intervals for fitted parameters, wide enough for what the residuals show.

Least squares gives the covariance (Jᵀ J)⁻¹ if every whitened residual is independent and of unit variance. Two
departures can be seen in the residuals themselves and are put right: their variance s² (frames worse than stated, or a
model that does not quite hold), and their likeness from one frame to the next, which makes n frames worth only n/τ with
τ = 1 + 2 Σ ρ_l over the autocorrelations ρ_l (Priestley, Spectral Analysis and Time Series, 1981, Sec. 5.3).
Both factors are never taken below 1. An error that all frames share shows in no residual and in no interval.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import norm

Array = NDArray[np.float64]

NEAR_BOUND_SIGMAS = 3.0
"""A bound nearer than this is felt by the interval, and the likelihood is profiled instead."""


def variance_inflation(residuals: Array, degrees_of_freedom: float, flight: NDArray[np.int64]) -> tuple[float, float]:
    """s² and τ, at least 1 each, of whitened residuals (n, 6) in flights (n,)."""
    variance = float((residuals**2).sum()) / max(degrees_of_freedom, 1.0)
    return max(1.0, variance), correlation_length(residuals, flight)


def correlation_length(residuals: Array, flight: NDArray[np.int64]) -> float:
    """τ = 1 + 2 Σ ρ_l, at least 1, summed until ρ_l drowns in its own noise; pairs never span two flights."""
    runs = [residuals[flight == k] for k in np.unique(flight)]
    power = float((residuals**2).mean()) if residuals.size else 0.0
    tau = 1.0
    for lag in range(1, max((len(run) for run in runs), default=0) // 2):
        products = np.concatenate([(run[lag:] * run[:-lag]).ravel() for run in runs if len(run) > lag])
        rho = float(products.mean()) / power if power > 0.0 else 0.0
        if rho < 2.0 / np.sqrt(products.size):
            break
        tau += 2.0 * rho
    return tau


def chi_interval(
    chi: float,
    sigma: float,
    excess: Callable[[float], float],
    *,
    level: float = 0.95,
) -> tuple[float, float]:
    """Interval of a coefficient of restitution, inside [0, 1].

    Away from the bounds χ ± z σ. Near one, `excess(χ)`, by how much χ² grows (in units of its true variance) when χ is
    held there and all else is fitted again, is followed to z²; where the bound is reached before, the interval ends
    there.
    """
    z = float(norm.ppf(0.5 + level / 2.0))
    if NEAR_BOUND_SIGMAS * sigma < min(chi, 1.0 - chi):
        return chi - z * sigma, chi + z * sigma
    return _crossing(excess, chi, 0.0, z**2), _crossing(excess, chi, 1.0, z**2)


def _crossing(excess: Callable[[float], float], best: float, bound: float, target: float) -> float:
    """Where excess reaches the target between the best value and the bound; the bound where it never does."""
    if abs(bound - best) < 1e-12 or excess(bound) <= target:
        return bound
    return float(brentq(lambda x: excess(x) - target if x != best else -target, best, bound, xtol=1e-5, rtol=1e-5))
