"""Figures of many throws: basins of attraction, odds, predictability, Lyapunov exponents. Each draws on the given axes.

A face has the same colour on every map. Throws that end on no face are black (spinning) or grey (still bouncing).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...model.ensembles import ENDING_OF_INDEX, Axis, Fairness, FinalStateSensitivity, Share, UncertaintyExponent
from ...model.throw import Ending
from ..elements import (
    BOUNCING_COLOUR,
    FACE_COLOURS,
    IMPACT,
    MEASURED,
    NO_RELEASE_COLOUR,
    SIMULATED,
    SPINNING_COLOUR,
    hex_colour,
)
from .throw_plots import remove_box

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

Array = NDArray[np.float64]
Indices = NDArray[np.integer[Any]]

AXIS_LABELS = {
    "z0": "$z_0$ [m]",
    "psi": r"$\psi$ [rad]",
    "theta": r"$\vartheta$ [rad]",
    "phi": r"$\varphi$ [rad]",
    "vx": "$v_x$ [m/s]",
    "vy": "$v_y$ [m/s]",
    "vz": "$v_z$ [m/s]",
    "omega_xi": r"$\omega_\xi$ [rad/s]",
    "omega_eta": r"$\omega_\eta$ [rad/s]",
    "omega_zeta": r"$\omega_\zeta$ [rad/s]",
}
"""By the names of the initial conditions."""

_SPINNING = {Ending.SPINNING, Ending.SPUN_LONG, Ending.BALANCED}
SERIES_ORDER = (0, 2, 4, 5, 3, 1)
"""Faces whose colours the series of a plot take in turn: the most distinct ones first."""
LEGEND_ROW = 3
"""Largest number of series side by side in a legend."""
CONVERGENCE_POINTS = 400
"""Points of each curve of a convergence plot, spaced logarithmically."""
ROUNDING_DIGITS = 16.0
"""Decades between the rounding error of a double and 1."""


def colours_of(face: Indices, ending: Indices) -> NDArray[np.uint8]:
    """Colours (..., 3) of pixels from the landed face (...), 0 for none, and the index of the ending (...)."""
    table = np.array([*FACE_COLOURS], np.uint8)
    colours = table[(np.asarray(face) - 1) % len(table)]
    no_face = [SPINNING_COLOUR if each in _SPINNING else BOUNCING_COLOUR for each in ENDING_OF_INDEX]
    colours[face == 0] = np.array([*no_face, NO_RELEASE_COLOUR], np.uint8)[np.asarray(ending)[face == 0]]
    return colours


def basin_map(ax: Axes, x: Axis, y: Axis, face: Indices, ending: Indices, faces: int) -> Axes:
    """Basins over a plane of initial conditions: `face` and `ending` (rows, columns), the first row at y's low end.

    A legend beside the map names the `faces` of the die and the other endings that occur.
    """
    extent = (x.low, x.high, y.low, y.high)
    ax.imshow(colours_of(face, ending), origin="lower", extent=extent, aspect="auto", interpolation="nearest")
    ax.set_xlabel(AXIS_LABELS[x.name])
    ax.set_ylabel(AXIS_LABELS[y.name])
    patches = [_patch(FACE_COLOURS[k % len(FACE_COLOURS)], f"face {k + 1}") for k in range(faces)]
    no_face = np.unique(ending[face == 0])
    if any(k >= 0 and ENDING_OF_INDEX[k] in _SPINNING for k in no_face):
        patches.append(_patch(SPINNING_COLOUR, "spins"))
    if any(k >= 0 and ENDING_OF_INDEX[k] not in _SPINNING for k in no_face):
        patches.append(_patch(BOUNCING_COLOUR, "still bouncing"))
    if (no_face < 0).any():
        patches.append(_patch(NO_RELEASE_COLOUR, "below the table"))
    ax.legend(handles=patches, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, handlelength=1.0)
    return ax


def face_odds(ax: Axes, shares: Mapping[str, Sequence[Share]]) -> Axes:
    """Odds of every face with their intervals, one series beside the other; a line marks equal odds."""
    faces = len(next(iter(shares.values())))
    for k, (name, row) in enumerate(shares.items()):
        place = np.arange(1, faces + 1) + (k - 0.5 * (len(shares) - 1)) * 0.8 / max(len(shares), 2)
        _points(ax, place, row, k, name)
    ax.axhline(1.0 / faces, color="#444444", linewidth=0.8, zorder=1)
    ax.annotate(f"1/{faces}", (1.0, 1.0 / faces), xycoords=("axes fraction", "data"), xytext=(3, 0),
                textcoords="offset points", va="center", color="#444444")  # fmt: skip
    ax.set_xticks(np.arange(1, faces + 1))
    ax.set_xlim(0.4, faces + 0.6)
    ax.set_xlabel("face [number]")
    ax.set_ylabel("probability [1]")
    ax.legend(loc="best", frameon=False, ncols=min(len(shares), LEGEND_ROW), handletextpad=0.2)
    return remove_box(ax)


def lowest_again(ax: Axes, shares: Mapping[str, Sequence[Share]], faces: int) -> Axes:
    """Odds that the lowest face is the one that was lowest at release, at each impact; last, those of the landed face."""
    columns = max(len(row) for row in shares.values())
    for k, (name, row) in enumerate(shares.items()):
        shift = (k - 0.5 * (len(shares) - 1)) * 0.5 / max(len(shares), 2)
        _points(ax, np.arange(1, len(row) + 1) + shift, row, k, name)
    ax.axhline(1.0 / faces, color="#444444", linewidth=0.8, zorder=1)
    ax.set_xticks(np.arange(1, columns + 1), [*(str(k) for k in range(1, columns)), "landed"])
    ax.set_xlim(0.4, columns + 0.6)
    ax.set_xlabel("impact [number]")
    ax.set_ylabel("same lowest face as at release: probability [1]")
    ax.legend(loc="best", frameon=False, ncols=min(len(shares), LEGEND_ROW), handletextpad=0.2)
    return remove_box(ax)


def uncertain_shares(ax: Axes, sensitivity: FinalStateSensitivity, exponent: UncertaintyExponent | None = None) -> Axes:
    """Share of the initial conditions with a neighbour at distance ε on another face, with the fitted power law."""
    values = np.array([share.value for share in sensitivity.shares])
    low, high = np.array([share.interval for share in sensitivity.shares]).T
    some = values > 0.0
    errors = np.array([values - low, high - values])[:, some]
    ax.errorbar(sensitivity.epsilons[some], values[some], errors, fmt="o", markersize=4, color=hex_colour(MEASURED))
    blue, label = hex_colour(MEASURED), "none uncertain: upper bound"
    if not some.all():
        ax.plot(sensitivity.epsilons[~some], high[~some], "v", markersize=4, mfc="none", color=blue, label=label)
    if exponent is not None:
        line = np.array([exponent.epsilon_from, exponent.epsilon_to])
        label = rf"$\alpha$ = {exponent.value:.3f} ± {exponent.standard_error:.3f}"
        ax.plot(line, exponent.prefactor * line**exponent.value, color=hex_colour(SIMULATED), label=label, zorder=3)
    if exponent is not None or not some.all():
        ax.legend(loc="lower right", frameon=False)
    ax.axhline(sensitivity.chance, color="#444444", linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
    ax.annotate("chance", (0.01, sensitivity.chance), xycoords=("axes fraction", "data"), xytext=(0, -3),
                textcoords="offset points", va="top", color="#444444")  # fmt: skip
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(0.5 * sensitivity.epsilons[0], 2.0 * sensitivity.epsilons[-1])
    ax.set_ylim(0.3 / (sensitivity.decided.sum()), 1.5)
    ax.set_xlabel(r"distance $\varepsilon$ of the neighbours [sides of the window]")
    ax.set_ylabel(r"uncertain conditions $f(\varepsilon)$ [share]")
    return remove_box(ax)


def ball_measures(ax: Axes, balls: Sequence[Fairness]) -> Axes:
    """Largest difference of a face's measure from 1/n in balls about several conditions, against the balls' radius."""
    for ball in balls:
        n = ball.counts.shape[1]
        away = np.abs(ball.measures - 1.0 / n).max(1)
        ax.plot(ball.epsilons, away, ".-", linewidth=0.8, markersize=4, color=hex_colour(MEASURED), alpha=0.7)
    n = balls[0].counts.shape[1]
    ax.axhline(1.0 - 1.0 / n, color="#444444", linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
    ax.annotate("one face alone", (0.99, 1.0 - 1.0 / n), xycoords=("axes fraction", "data"), xytext=(0, 4),
                textcoords="offset points", ha="right", color="#444444")  # fmt: skip
    ax.set_xscale("log")
    ax.set_ylim(0.0, 1.08 * (1.0 - 1.0 / n))
    ax.set_xlabel(r"radius $\varepsilon$ of the ball [sides of the window]")
    ax.set_ylabel(r"largest $|\beta_i - 1/n|$ [1]")
    return remove_box(ax)


def convergence(ax: Axes, logs: Array, times_s: Array, per_second: float, error: float) -> Axes:
    """Running estimates of the exponent [1/s], one line per orbit: `logs` and `times_s` (orbits, impacts).

    The band is the final value with two standard errors.
    """
    count = np.arange(1, logs.shape[1] + 1)
    shown = count - 1
    if len(count) > 10:
        shown = np.unique(np.geomspace(10, len(count), CONVERGENCE_POINTS).astype(int)) - 1
    for k, (log, time) in enumerate(zip(logs, times_s, strict=True)):
        estimate = np.cumsum(log)[shown] / time[shown]
        label = "each orbit" if k == 0 else None
        ax.plot(count[shown], estimate, linewidth=0.7, color=hex_colour(MEASURED), alpha=0.6, label=label)
    label = f"{per_second:.3f} ± {2.0 * error:.3f} per second (two standard errors)"
    ax.axhspan(per_second - 2.0 * error, per_second + 2.0 * error, color=hex_colour(SIMULATED), alpha=0.25, linewidth=0)
    ax.axhline(per_second, color=hex_colour(SIMULATED), linewidth=1.2, label=label)
    ax.set_xscale("log")
    ax.set_xlabel("impacts [number]")
    ax.set_ylabel("largest Lyapunov exponent [1/s]")
    ax.legend(loc="best", frameon=False)
    return ax


def growth_curve(ax: Axes, log10_growth: Array) -> Axes:
    """log10 of the factor (impacts,) by which an error of the release has grown after each impact."""
    ax.plot(np.arange(1, len(log10_growth) + 1), log10_growth, "o-", markersize=3, color=hex_colour(SIMULATED))
    ax.axhline(ROUNDING_DIGITS, color=hex_colour(IMPACT), linewidth=0.8)
    ax.annotate("rounding of a double has grown to the size of the die", (0.99, ROUNDING_DIGITS),
                xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8,
                color=hex_colour(IMPACT))  # fmt: skip
    ax.set_xlabel("impact [number]")
    ax.set_ylabel("log$_{10}$ of the error growth [1]")
    ax.set_ylim(bottom=min(0.0, float(np.min(log10_growth, initial=0.0))))
    return ax


def _points(ax: Axes, place: Any, row: Sequence[Share], number: int, name: str) -> None:
    values = np.array([share.value for share in row])
    errors = np.abs(np.array([share.interval for share in row]).T - values)
    colour = hex_colour(FACE_COLOURS[SERIES_ORDER[number % len(SERIES_ORDER)]])
    ax.errorbar(place, values, errors, fmt="o", markersize=4, linewidth=1.4, color=colour, label=name)


def _patch(colour: tuple[int, int, int], label: str) -> Patch:
    from matplotlib.patches import Patch

    return Patch(facecolor=hex_colour(colour), edgecolor="#888888", linewidth=0.5, label=label)
