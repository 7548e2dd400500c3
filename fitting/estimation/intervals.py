"""Intervals of fitted parameters.

A profile-likelihood interval (Venzon & Moolgavkar, Appl. Stat. 37, 87, 1988) holds all values at which the best fit of
everything else costs at most z² more. It respects the bounds of a parameter, and ends at a bound that it reaches. The cost is in
units of what the residuals show (`residual_errors`).
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
