"""The pictures of chaos: how exponents settle, and how errors grow along a throw. As in `figures`, each on its axes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ..elements import IMPACT, MEASURED, SIMULATED, hex_colour

Array = NDArray[np.float64]


def convergence(ax: Axes, logs: Array, times_s: Array, per_second: float, error: float) -> Axes:
    """Estimates of the exponent [1/s] after ever more impacts, one line an orbit: `logs` and `times_s` (orbits, n).

    The band is the final value with two standard errors.
    """
    count = np.arange(1, logs.shape[1] + 1)
    shown = np.unique(np.geomspace(10, len(count), 400).astype(int)) - 1 if len(count) > 10 else count - 1
    for k, (log, time) in enumerate(zip(logs, times_s, strict=True)):
        estimate = np.cumsum(log)[shown] / time[shown]
        label = "each orbit" if k == 0 else None
        ax.plot(count[shown], estimate, linewidth=0.7, color=hex_colour(MEASURED), alpha=0.6, label=label)
    label = f"{per_second:.3f} ± {2.0 * error:.3f} per second (two standard errors)"
    ax.axhspan(per_second - 2.0 * error, per_second + 2.0 * error, color=hex_colour(SIMULATED), alpha=0.25, linewidth=0)
    ax.axhline(per_second, color=hex_colour(SIMULATED), linewidth=1.2, label=label)
    ax.set_xscale("log")
    ax.set_xlabel("impacts")
    ax.set_ylabel("largest Lyapunov exponent [1/s]")
    ax.legend(loc="best", frameon=False)
    return ax


def growth_curve(ax: Axes, log10_growth: Array) -> Axes:
    """The factor (impacts,) by which an error of the release has grown after each impact."""
    ax.plot(np.arange(1, len(log10_growth) + 1), log10_growth, "o-", markersize=3, color=hex_colour(SIMULATED))
    ax.axhline(16.0, color=hex_colour(IMPACT), linewidth=0.8)
    ax.annotate("rounding of a double grows to the size of the die", (0.99, 16.0), xycoords=("axes fraction", "data"),
                ha="right", va="bottom", fontsize=8, color=hex_colour(IMPACT))  # fmt: skip
    ax.set_xlabel("impact")
    ax.set_ylabel("log$_{10}$ of the growth of an error")
    ax.set_ylim(bottom=min(0.0, float(np.min(log10_growth, initial=0.0))))
    return ax
