"""Covariances: the inverse of an information whose parameters have different units, and the root that draws are made with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WELL_CONDITIONED_PIVOT = 1e-8
"""Squared pivot of a scaled matrix below which some parameters may be undetermined: rounding changes one by some 1e-14."""
SINGULAR_EIGENVALUE = 1e-14
"""Relative eigenvalue below which a direction counts as undetermined."""


def scaled_inverse(matrix: Array) -> Array:
    """Inverse of a symmetric matrix whose parameters differ by ten orders of magnitude (seconds, metres, rad/s).

    The diagonal is scaled to one first; undetermined directions get the pseudo-inverse. That needs eigenvalues, which take a
    hundred times as long as a Cholesky factor, and is therefore used only if Cholesky finds a small pivot."""
    known = np.diag(matrix) > 0.0
    unit = np.where(known, 1.0 / np.sqrt(np.where(known, np.diag(matrix), 1.0)), 0.0)
    scaled = matrix * np.outer(unit, unit)
    if _is_well_conditioned(scaled):
        inverse = np.linalg.inv(scaled)
        inverse = 0.5 * (inverse + inverse.T)
    else:
        inverse = np.linalg.pinv(scaled, rcond=SINGULAR_EIGENVALUE, hermitian=True)
    return np.asarray(inverse * np.outer(unit, unit))


def _is_well_conditioned(scaled: Array) -> bool:
    try:
        pivots = np.diag(np.linalg.cholesky(scaled))
    except np.linalg.LinAlgError:
        return False
    return bool(pivots.min() ** 2 > WELL_CONDITIONED_PIVOT)


def covariance_root(covariance: Array) -> Array:
    """L (m, m) with L Lᵀ a covariance (m, m), which may be singular: L z is a draw for z of independent normal numbers."""
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.clip(values, 0.0, None)))
