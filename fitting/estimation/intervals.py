"""Intervals of fitted parameters, widened by what the residuals show.

Least squares gives the covariance (Jᵀ J)⁻¹ if every whitened residual is independent and of unit variance. The residuals
show two departures, and both are corrected:

- their variance s²: frames worse than stated, or a model that does not quite hold;
- their correlation from frame to frame, which makes n frames worth n/τ with τ = 1 + 2 Σ ρ_l over the autocorrelations ρ_l
  (Priestley, Spectral Analysis and Time Series, 1981, Sec. 5.3).

Their product is not taken below 1. Covariances may state errors that are correlated as larger independent ones, as those of
tracking do: residuals are then smaller than stated, and correlated, and s² τ compares what they add up to with what is stated.
An error that all frames share shows in no residual.

A profile-likelihood interval (Venzon & Moolgavkar, Appl. Stat. 37, 87, 1988) holds all values at which the best fit of
everything else costs at most z² more. It respects the bounds of a parameter, and ends at a bound that it reaches.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Array = NDArray[np.float64]

_ROOT_TOLERANCE = 0.01
"""Relative error of √excess at which a bound of an interval is found: a hundredth of the half width."""

_MAX_TRIALS = 16
"""Trials of one bound of an interval; each is a fit."""

_SECANT_TRIALS = 6
"""Trials after which a bracket is halved instead: a flat stretch that ends in a cliff defeats false position."""

_BRACKET_MARGIN = 0.05
"""Share of a bracket at either end in which false position puts no trial."""

_OVERSHOOT, _MAX_EXPANSION = 1.1, 4.0
"""Outside a bracket: the next trial lies a tenth beyond where a straight line crosses, and at most four times as far."""


def normal_quantile(level: float) -> float:
    """Standard deviations to either side that hold a share `level` of a normal distribution: 1.96 for 0.95."""
    return float(ndtri(0.5 + level / 2.0))


def variance_inflation(residuals: Array, degrees_of_freedom: float, flight: NDArray[np.int64]) -> tuple[float, float]:
    """s² and τ of whitened residuals (n, 6) in flights (n,); τ is at least 1, and so is their product."""
    variance = float((residuals**2).sum()) / max(degrees_of_freedom, 1.0)
    tau = correlation_time(residuals, flight)
    return max(1.0 / tau, variance), tau


def correlation_time(residuals: Array, flight: NDArray[np.int64]) -> float:
    """τ = 1 + 2 Σ ρ_l [frames], at least 1, summed until ρ_l is within its own noise; pairs never span two flights."""
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


def profile_interval(
    value: float,
    sigma: float,
    bounds: tuple[float, float],
    excess: Callable[[float], float],
    *,
    level: float = 0.95,
) -> tuple[float, float]:
    """The interval of a parameter within its bounds.

    `excess(x)` is the rise of Σ r², in units of its true variance, when the parameter is held at x and everything else
    is fitted again. `sigma`, from the covariance, gives the first trial.
    """
    z = normal_quantile(level)
    return _crossing(excess, value, -sigma, bounds[0], z), _crossing(excess, value, sigma, bounds[1], z)


def _crossing(excess: Callable[[float], float], value: float, sigma: float, bound: float, z: float) -> float:
    """Where √excess, which is nearly linear, reaches z between the value and a bound; the bound if it never does.

    False position within a bracket, and bisection where that is slow. scipy's root finders evaluate both ends of a
    bracket again and test the width of the bracket alone; here the first trial usually ends the search.
    """
    if abs(bound - value) < 1e-12:
        return bound
    near, far, far_root = value, None, 0.0
    near_root = 0.0
    x = value + z * sigma
    for trial in range(_MAX_TRIALS):
        beyond = (x - bound) * np.sign(sigma) >= 0.0
        x = bound if beyond else x
        root = float(np.sqrt(max(0.0, excess(x))))
        if abs(root - z) < _ROOT_TOLERANCE * z or (beyond and root < z):
            return x if beyond else value + (x - value) * z / root
        if root < z:
            near, near_root = x, root
        else:
            far, far_root = x, root
        if far is None:
            x = value + (x - value) * min(_MAX_EXPANSION, _OVERSHOOT * z / max(root, 1e-3 * z))
        else:
            if abs(far - near) < _ROOT_TOLERANCE * abs(far - value):
                return far
            share = (z - near_root) / (far_root - near_root)
            margin = _BRACKET_MARGIN
            x = near + (far - near) * float(np.clip(share, margin, 1.0 - margin) if trial < _SECANT_TRIALS else 0.5)
    return x if far is None else far
