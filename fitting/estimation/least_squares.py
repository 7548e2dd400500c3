"""Robust least squares under bounds, for motions that are nearly linear in the right coordinates only.

**Loss.** A frame enters with s = |r|², the square of its whitened residual (6,), through Huber's ρ(s) = s up to k² and
2 k √s - k² beyond. A frame is bad as a whole, so the loss takes all six numbers together; scipy's own losses take them
one by one. Written as scaled residuals r √(ρ/s), whose squares add up to ρ, the problem is an ordinary least-squares
problem with an exact gradient.

**Steps.** The frames determine some directions of the unknowns x of a throw a million times better than others. Let T be
upper triangular with Tᵀ T the information of an earlier fit. Steps are taken in u = T x, in which all directions have
the same scale, by the method of Levenberg and Marquardt (Nocedal & Wright, Numerical Optimization, 2006, Sec. 10.3). The
damping is zero until a step fails. J T⁻¹ is reduced by QR decomposition and never squared.

**Bounds** hold for single x. If a step crosses a bound, that unknown is put on it and the step is solved again.

**End.** The descent ends when a step promises to lower the cost by less than a tolerance. A cost that no correct model
has (`hopeless`) ends it at a share of the cost (`_HOPELESS_SHARE`): such fits are only compared with better ones, and a
robust loss converges slowly there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dtrsm

Array = NDArray[np.float64]

HUBER_THRESHOLD = 22.46
"""k²: |r|² of a good frame exceeds it in one case out of a thousand (χ² with six degrees of freedom)."""

MEDIAN_SQUARE = 5.348
"""Median of |r|² over good frames (χ² with six degrees of freedom)."""

COST_TOLERANCE = 1e-7
"""Fall of the cost Σ r², in units of a residual's variance, below which no step is taken: a three-thousandth of a sigma."""

COARSE_TOLERANCE = 1e-2
"""The same for a fit that only starts the next one: a tenth of a sigma."""

_DAMPED_TOLERANCE = 1e-3
"""The same for damped steps, which follow curved valleys by many short steps."""

_HOPELESS_SHARE = 1e-4
"""Share of a hopeless cost by which a step must promise to lower it; fits that fail then take a third of the steps."""

_FIRST_DAMPING = 1e-2
"""Damping after the first failed step, relative to the curvature; below it the damping returns to zero."""

_MAX_DAMPING = 1e8
"""Damping at which steps are lost in rounding and the descent ends."""

_NEGLIGIBLE_DIAGONAL = 1e-13
"""Diagonal of R, relative to the largest, below which a direction is undetermined: it is rounding."""

_NULL_COLUMN = 1e-12
"""The same for a column of the derivative that is zero, such as that of friction where every contact sticks."""

_SMALLEST_STEP = 1e-200
"""Of an unknown that does not move, where it is divided by."""


def huber(residuals: Array, jacobian: Array, k2: float) -> tuple[Array, Array]:
    """Scaled residuals (n, 6), whose squares add up to Σ ρ, and their derivative (n, 6, m)."""
    s = (residuals**2).sum(1)
    beyond = s > k2
    if not beyond.any():
        return residuals, jacobian
    far, k = s[beyond], np.sqrt(k2)
    gain = np.sqrt((2.0 * k * np.sqrt(far) - k2) / far)
    slope = (k / np.sqrt(far) - gain**2) / (2.0 * gain * far)
    scaled, scaled_jacobian = residuals.copy(), jacobian.copy()
    r, j = residuals[beyond], jacobian[beyond]
    scaled[beyond] = gain[:, None] * r
    along = np.einsum("ni,nim->nm", r, j)
    scaled_jacobian[beyond] = gain[:, None, None] * j + (2.0 * slope)[:, None, None] * r[:, :, None] * along[:, None, :]
    return scaled, scaled_jacobian


def robust_variance(residuals: Array, degrees_of_freedom: float) -> float:
    """Variance of whitened residuals (n, 6) from the median frame, for a fit that left so many degrees of freedom."""
    s = (residuals**2).sum(1)
    return float(np.median(s)) / MEDIAN_SQUARE * s.size * 6.0 / max(degrees_of_freedom, 1.0)


def levenberg_marquardt(
    evaluate: Callable[[Array], tuple[Array, Array]],
    root: Array,
    low: Array,
    high: Array,
    *,
    max_steps: int = 40,
    tolerance: float = COST_TOLERANCE,
    hopeless: float = np.inf,
) -> Array:
    """The x (m,) of least Σ r², started from 0.

    `evaluate(x)` returns residuals (n,) and their derivative (n, m). `root` (m, m) is T. `low` and `high` (m,) are the
    bounds of x and contain 0. Residuals that are not finite have an infinite cost; a cost above `hopeless` is no fit.
    """
    x = np.zeros(len(root))
    residuals, jacobian = evaluate(x)
    rows = compressed(residuals, jacobian)
    cost, damping = _cost(residuals), 0.0
    for _ in range(max_steps):
        step, gain = _bounded_step(rows, root, low - x, high - x, damping)
        least = (
            _HOPELESS_SHARE * cost if cost > hopeless else max(tolerance, _DAMPED_TOLERANCE if damping > 0.0 else 0.0)
        )
        if 0.0 <= gain < least:
            break
        residuals, jacobian = evaluate(x + step)
        lower = _cost(residuals)
        if lower < cost:
            x, cost, rows = x + step, lower, compressed(residuals, jacobian)
            damping = 0.1 * damping if damping > _FIRST_DAMPING else 0.0
        else:
            damping = max(10.0 * damping, _FIRST_DAMPING)
            if damping > _MAX_DAMPING:
                break
    return x


def _cost(residuals: Array) -> float:
    total = float(residuals @ residuals)
    return total if np.isfinite(total) else np.inf


def _bounded_step(rows: Array, root: Array, low: Array, high: Array, damping: float) -> tuple[Array, float]:
    """The step (m,) within its bounds, and the fall of the cost that a linear model predicts; `rows` is [J r], compressed."""
    free = np.ones(len(root), bool)
    step = np.zeros(len(root))
    while free.any():
        rest = rows[:, -1] + rows[:, :-1][:, ~free] @ step[~free]
        step[free] = _free_step(rest, rows[:, :-1][:, free], triangular_factor(root[:, free]), damping)
        inside = np.clip(step, low, high)
        beyond = np.flatnonzero(free & (step != inside))
        if not len(beyond):
            break
        # The bound that the step crosses first; with that unknown on its bound the others may stay inside.
        # By rounding an unknown that does not move may lie a last digit beyond its bound.
        first = beyond[np.argmin(np.abs(inside[beyond]) / np.maximum(np.abs(step[beyond]), _SMALLEST_STEP))]
        step[first], free[first] = inside[first], False
    after = rows[:, -1] + rows[:, :-1] @ step
    return step, float(rows[:, -1] @ rows[:, -1] - after @ after)


def _free_step(residuals: Array, jacobian: Array, root: Array, damping: float) -> Array:
    """The damped least-squares step of unbounded unknowns."""
    m = len(root)
    scaled = times_inverse(jacobian, root)
    if damping > 0.0:
        # Marquardt: in proportion to the curvature of each direction, so that units cancel.
        weight = np.sqrt(damping) * np.linalg.norm(scaled, axis=0)
        scaled, residuals = np.vstack([scaled, np.diag(weight)]), np.append(residuals, np.zeros(m))
    rows = compressed(residuals, scaled)
    diagonal = np.abs(np.diag(rows[:, :m]))
    known = diagonal > _NEGLIGIBLE_DIAGONAL * diagonal.max()
    u = np.zeros(m)
    u[known] = -solve_triangular(rows[:m, :m][np.ix_(known, known)], rows[:m, m][known], check_finite=False)
    return np.asarray(solve_triangular(root, u, check_finite=False))


def compressed(residuals: Array, jacobian: Array) -> Array:
    """[J r] (n, m + 1) as m + 1 rows with the same squares and products, and so with the same least-squares steps."""
    return _upper_factor(np.column_stack([jacobian, residuals]))


def triangular_factor(jacobian: Array) -> Array:
    """Upper triangular T (m, m) with a diagonal of 0 or more and Tᵀ T = Jᵀ J, of J (n, m)."""
    root = _upper_factor(jacobian)
    return root * np.where(np.diag(root) < 0.0, -1.0, 1.0)[:, None]


def covariance_of(jacobian: Array) -> Array:
    """(Jᵀ J)⁻¹ (m, m) of the derivative J (n, r, m) of whitened residuals; 0 for directions on which they have no information."""
    return np.asarray(np.linalg.pinv(np.einsum("nij,nik->jk", jacobian, jacobian), rcond=1e-15, hermitian=True))


def orthonormal_basis(jacobian: Array, root: Array) -> Array:
    """Orthonormal columns (n, m) that span those of a derivative (n, m), whose unknowns are scaled by `root` (m, m)."""
    scaled = times_inverse(jacobian, root)
    own = triangular_factor(scaled)
    null = np.diag(own) < _NULL_COLUMN * np.diag(own).max()
    own[null, null] = 1.0
    return times_inverse(scaled, own)


def times_inverse(jacobian: Array, root: Array) -> Array:
    """J T⁻¹ (n, m) of J (n, m) and an upper triangular T (m, m): the derivative by u = T x."""
    return np.asarray(dtrsm(1.0, root, jacobian, side=1))


def _upper_factor(matrix: Array) -> Array:
    """R (m, m) of the QR decomposition of a matrix (n, m), with rows of zeros where n < m."""
    factor = np.linalg.qr(matrix, mode="r")
    return np.vstack([factor, np.zeros((max(0, matrix.shape[1] - len(factor)), matrix.shape[1]))])
