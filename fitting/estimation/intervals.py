"""Intervals for fitted parameters, wide enough for what the residuals show.

Least squares gives the covariance (Jᵀ J)⁻¹ if every whitened residual is independent and of unit variance. Two
departures can be seen in the residuals themselves and are put right: their variance s² (frames worse than stated, or a
model that does not quite hold), and their likeness from one frame to the next, which makes n frames worth only n/τ with
τ = 1 + 2 Σ ρ_l over the autocorrelations ρ_l (Priestley, Spectral Analysis and Time Series, 1981, Sec. 5.3).
Both factors are never taken below 1. An error that all frames share shows in no residual and in no interval.

An interval is that of the profile likelihood (Venzon & Moolgavkar, Appl. Stat. 37, 87, 1988): all values at which the
best fit of everything else costs at most z² more. It knows the bounds of a parameter, and ends at one that it reaches.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

Array = NDArray[np.float64]

_CLOSE = 0.01
"""Relative error of √excess at which a bound of an interval is found: a hundredth of the half width."""

_FEW_TRIALS, _MOST_TRIALS = 6, 16


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


def profile_interval(
    value: float,
    sigma: float,
    bounds: tuple[float, float],
    excess: Callable[[float], float],
    *,
    level: float = 0.95,
) -> tuple[float, float]:
    """The interval of a parameter within its bounds.

    `excess(x)` is by how much Σ r² grows, in units of its true variance, when the parameter is held at x and all else
    is fitted again; `sigma`, from the covariance, says where to look first.
    """
    z = float(norm.ppf(0.5 + level / 2.0))
    return _crossing(excess, value, -sigma, bounds[0], z), _crossing(excess, value, sigma, bounds[1], z)


def _crossing(excess: Callable[[float], float], value: float, sigma: float, bound: float, z: float) -> float:
    """Where √excess, which is nearly linear, comes to z on the way from the value to a bound; the bound if it never does.

    By the rule of false position within a bracket, after Anderson & Björck (BIT 13, 253, 1973); by halves where that is
    slow, as at the end of a flat stretch, whose cliff an interval includes.
    """
    if abs(bound - value) < 1e-12:
        return bound
    near, far, far_root = value, None, 0.0
    near_root = 0.0
    x = value + z * sigma
    for trial in range(_MOST_TRIALS):
        beyond = (x - bound) * np.sign(sigma) >= 0.0
        x = bound if beyond else x
        root = float(np.sqrt(max(0.0, excess(x))))
        if abs(root - z) < _CLOSE * z or (beyond and root < z):
            return x if beyond else value + (x - value) * z / root
        if root < z:
            near, near_root = x, root
        else:
            far, far_root = x, root
        if far is None:
            # Not beyond yet: on by the slope seen so far, at most fourfold.
            x = value + (x - value) * min(4.0, 1.1 * z / max(root, 1e-3 * z))
        else:
            if abs(far - near) < _CLOSE * abs(far - value):
                return far
            share = (z - near_root) / (far_root - near_root)
            x = near + (far - near) * float(np.clip(share, 0.05, 0.95) if trial < _FEW_TRIALS else 0.5)
    return x if far is None else far
