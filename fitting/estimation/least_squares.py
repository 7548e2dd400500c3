"""Least squares for a motion that is nearly linear in the right coordinates and wild in the wrong ones.

The unknowns x of a throw through bounces have directions that the frames know a million times better than others. With
T upper triangular and Tᵀ T the information of an earlier fit, the steps are taken in u = T x, in which all directions
are alike, by Levenberg and Marquardt's method (Nocedal & Wright, Numerical Optimization, 2006, Sec. 10.3): the damping
is zero until a step fails. J T⁻¹ is reduced to a triangle by reflections, never squared.

Bounds hold for single x. A step that would cross one is solved again with that unknown put on its bound, and so on.
The descent ends when a step promises to lower the cost by less than `enough`; where the
cost says that the model is not that of the data at all, by less than `_ROUGHLY` of it. A robust loss converges slowly there,
and such a fit is only ever told from better ones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .robust import condensed, in_units_of, solved, triangle

Array = NDArray[np.float64]

ENOUGH = 1e-7
"""Fall of the cost Σ r², in units of a residual's variance, that is not worth a step: a three-thousandth of a sigma."""

NEARLY = 1e-2
"""The same for a fit that only leads to the next: a tenth of a sigma."""

_CRAWL = 1e-3
"""The same for damped steps: along a valley that curls, where the cost falls by less it is not worth the way."""

_ROUGHLY = 1e-4
"""Part of a hopeless cost by which a step must promise to lower it; fits that fail then take a third of the steps."""

_FIRST_DAMPING = 1e-2
_MOST_DAMPING = 1e8


def descend(
    evaluate: Callable[[Array], tuple[Array, Array]],
    root: Array,
    low: Array,
    high: Array,
    *,
    steps: int = 40,
    enough: float = ENOUGH,
    hopeless: float = np.inf,
) -> Array:
    """The x (m,) with the least Σ r², started from 0.

    `evaluate(x)` gives residuals (n,) and their derivative (n, m) there, `root` (m, m) is T, and `low`, `high` (m,) are
    the bounds of x, which hold 0. Residuals that are not finite count as infinitely bad; a cost above `hopeless` is no fit.
    """
    x = np.zeros(len(root))
    residuals, jacobian = evaluate(x)
    few = condensed(residuals, jacobian)
    cost, damping = _cost(residuals), 0.0
    for _ in range(steps):
        step, gain = _step(few, root, low - x, high - x, damping)
        least = _ROUGHLY * cost if cost > hopeless else max(enough, _CRAWL if damping > 0.0 else 0.0)
        if 0.0 <= gain < least:
            break
        residuals, jacobian = evaluate(x + step)
        lower = _cost(residuals)
        if lower < cost:
            x, cost, few = x + step, lower, condensed(residuals, jacobian)
            damping = 0.1 * damping if damping > _FIRST_DAMPING else 0.0
        else:
            damping = max(10.0 * damping, _FIRST_DAMPING)
            if damping > _MOST_DAMPING:
                break
    return x


def _cost(residuals: Array) -> float:
    total = float(residuals @ residuals)
    return total if np.isfinite(total) else np.inf


def _step(few: Array, root: Array, low: Array, high: Array, damping: float) -> tuple[Array, float]:
    """The step (m,) within its bounds, and by how much a linear model says the cost falls; `few` is [J r], condensed."""
    free = np.ones(len(root), bool)
    step = np.zeros(len(root))
    while free.any():
        rest = few[:, -1] + few[:, :-1][:, ~free] @ step[~free]
        step[free] = _free_step(rest, few[:, :-1][:, free], triangle(root[:, free]), damping)
        inside = np.clip(step, low, high)
        beyond = np.flatnonzero(free & (step != inside))
        if not len(beyond):
            break
        # The bound that is crossed first on the way; with that unknown on it the others may stay inside.
        first = beyond[np.argmin(np.abs(inside[beyond]) / np.abs(step[beyond]))]
        step[first], free[first] = inside[first], False
    after = few[:, -1] + few[:, :-1] @ step
    return step, float(few[:, -1] @ few[:, -1] - after @ after)


def _free_step(residuals: Array, jacobian: Array, root: Array, damping: float) -> Array:
    """The damped least-squares step of unbounded unknowns."""
    m = len(root)
    scaled = in_units_of(root, jacobian)
    if damping > 0.0:
        # Marquardt: in proportion to the curvature of each direction, so that units drop out.
        weight = np.sqrt(damping) * np.linalg.norm(scaled, axis=0)
        scaled, residuals = np.vstack([scaled, np.diag(weight)]), np.append(residuals, np.zeros(m))
    few = condensed(residuals, scaled)
    # A direction that nothing tells of keeps its place: its diagonal is rounding.
    known = np.abs(np.diag(few[:, :m])) > 1e-13 * np.abs(np.diag(few[:, :m])).max()
    u = np.zeros(m)
    u[known] = -solved(few[:m, :m][np.ix_(known, known)], few[:m, m][known])
    return np.asarray(solved(root, u))
