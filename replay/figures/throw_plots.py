"""Plots of one throw. Each function draws on the given axes, matplotlib's or the SVG of a page, and returns them.

Measured poses are blue dots and the model is orange lines, as in the recording. Every axis states its unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.die import Solid
from ...model.rotations import matrix_from_quat
from ...model.throw import Impact, Throw
from ..elements import (
    AXIS_COLOURS,
    FACE_COLOURS,
    IMPACT,
    MEASURED,
    SIMULATED,
    Residuals,
    hex_colour,
)
from .plot_axes import AnyAxes, PlotAxes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...fitting.predict import Estimate
    from ...fitting.results import Parameter

Array = NDArray[np.float64]

MAX_VECTOR_MARKS = 20_000
"""Marks that an SVG holds as shapes. More are drawn as pixels, because the file would have many megabytes."""
MAX_NUMBERS = 16
"""Bounces that are all numbered on their axis; of more, every second, third, … is."""
DRAWN_INSTANTS = 4000
"""Instants at which a modelled throw is drawn: more than the pixels of a figure, and drawn faster than simulated."""
BAND_SIGMAS = 2.0
"""Half width of the band in plots of residuals: one residual in twenty lies outside it by chance."""
AXIS_GREY = "#444444"
"""Of lines at zero, at one, and at chance."""


def corner_heights(
    ax: AnyAxes,
    solid: Solid,
    times_s: ArrayLike,
    positions_m: ArrayLike,
    quaternions: ArrayLike,
    impacts: Sequence[Impact] = (),
    label: str = "simulated",
) -> AnyAxes:
    """Height of every corner over time, as in Fig. 5 of Kapitaniak et al. (Chaos 22, 047504, 2012).

    Poses at times (n,) [s]: positions (n, 3) [m] and quaternions (n, 4) wxyz; rows of NaN interrupt the curves. The label
    `measured` draws blue dots, any other an orange line. A thin line marks each impact. Two calls on the same axes show
    experiment and model together.
    """
    rotations = _matrices(quaternions)
    corners = np.einsum("nj,vj->nv", rotations[:, 2], solid.vertices) + np.asarray(positions_m, float)[:, 2, None]
    milliseconds = 1e3 * np.asarray(times_s, float)
    heights = 1e3 * corners
    many = heights.size > MAX_VECTOR_MARKS
    for corner, height in enumerate(heights.T):
        name = label if corner == 0 else None
        if label == "measured":
            blue = hex_colour(MEASURED)
            ax.plot(milliseconds, height, "o", markersize=2.0, color=blue, label=name, zorder=2, rasterized=many)
        else:
            orange = hex_colour(SIMULATED)
            ax.plot(milliseconds, height, "-", linewidth=0.9, color=orange, label=name, zorder=3, rasterized=many)
    _mark_impacts(ax, impacts)
    ax.axhline(0.0, color=AXIS_GREY, linewidth=0.8, zorder=1)
    ax.set_ylabel("height of each corner [mm]")
    return _time_axis(ax)


def throw_heights(ax: AnyAxes, solid: Solid, throw: Throw) -> AnyAxes:
    """Height of every corner of a modelled throw from its first instant to its last, with its bounces."""
    times = np.linspace(throw.flights[0].start.time_s, throw.flights[-1].end_s, DRAWN_INSTANTS)
    return corner_heights(ax, solid, times, *throw.poses(times), impacts=throw.bounces)


def position_residuals(ax: AnyAxes, rest: Residuals, impacts: Sequence[Impact] = ()) -> AnyAxes:
    """Measured minus simulated position on every frame, by world axis."""
    for axis, colour, values in zip("xyz", AXIS_COLOURS, rest.position_mm.T, strict=True):
        ax.plot(1e3 * rest.time_s, values, ".", markersize=2.5, color=hex_colour(colour), label=axis)
    ax.axhline(0.0, color=AXIS_GREY, linewidth=0.8, zorder=1)
    _mark_impacts(ax, impacts)
    ax.set_ylabel("position residual [mm]")
    legend_above(ax, 3, markerscale=3.0, handletextpad=0.1)
    return _time_axis(ax)


def angle_residuals(ax: AnyAxes, rest: Residuals, impacts: Sequence[Impact] = ()) -> AnyAxes:
    """Angle between the measured and the simulated orientation on every frame."""
    ax.plot(1e3 * rest.time_s, rest.rotation_deg, ".", markersize=2.5, color=hex_colour(MEASURED))
    ax.set_ylim(bottom=0.0)
    _mark_impacts(ax, impacts)
    ax.set_ylabel("angle residual [°]")
    return _time_axis(ax)


def position_sigmas(ax: AnyAxes, rest: Residuals, impacts: Sequence[Impact] = ()) -> AnyAxes:
    """Measured minus simulated position by world axis, in standard errors of the measurement; the band is ± BAND_SIGMAS."""
    scaled = rest.position_mm / rest.standard_errors[:, :3]
    return _in_sigmas(ax, rest.time_s, scaled, impacts, "position residual [σ]")


def turn_sigmas(ax: AnyAxes, rest: Residuals, impacts: Sequence[Impact] = ()) -> AnyAxes:
    """Rotation from the simulated to the measured orientation about each world axis, in standard errors, with the band."""
    scaled = rest.turn_deg / rest.standard_errors[:, 3:]
    return _in_sigmas(ax, rest.time_s, scaled, impacts, "rotation residual [σ]")


def _in_sigmas(ax: AnyAxes, time_s: Array, values: Array, impacts: Sequence[Impact], label: str) -> AnyAxes:
    ax.axhspan(-BAND_SIGMAS, BAND_SIGMAS, color=hex_colour(IMPACT), alpha=0.13, linewidth=0, zorder=0)
    for axis, colour, of_axis in zip("xyz", AXIS_COLOURS, values.T, strict=True):
        many = values.size > MAX_VECTOR_MARKS
        ax.plot(1e3 * time_s, of_axis, ".", markersize=2.5, color=hex_colour(colour), label=axis, rasterized=many)
    ax.axhline(0.0, color=AXIS_GREY, linewidth=0.8, zorder=1)
    _mark_impacts(ax, impacts)
    ax.set_ylabel(label)
    legend_above(ax, 3, markerscale=3.0, handletextpad=0.1)
    return _time_axis(ax)


def restitution(ax: AnyAxes, impacts: Sequence[Impact], fitted: Parameter | None = None) -> AnyAxes:
    """Apparent restitution of every bounce with its interval; the fitted value as a line with its band."""
    for number, impact in enumerate(impacts, 1):
        if not np.isfinite(impact.chi):
            continue
        if np.isfinite([impact.chi_low, impact.chi_high]).all():
            ends = [impact.chi_low, impact.chi_high]
            ax.plot([number, number], ends, "-", color=hex_colour(MEASURED), linewidth=1.6)
        ax.plot(number, impact.chi, "o", color=hex_colour(MEASURED), markersize=5.0)
    if fitted is not None and fitted.value is not None:
        ax.axhline(fitted.value, color=hex_colour(SIMULATED), linewidth=1.2, zorder=1)
        if fitted.low is not None and fitted.high is not None:
            ax.axhspan(fitted.low, fitted.high, color=hex_colour(SIMULATED), alpha=0.22, linewidth=0, zorder=0)
    ax.set_xlim(0.5, max(len(impacts), 1) + 0.5)
    ax.set_xticks(range(1, len(impacts) + 1, 1 + len(impacts) // MAX_NUMBERS))
    ax.set_xlabel("bounce [number]")
    ax.set_ylabel("restitution χ [1]")
    return remove_box(ax)


def correlations_of(covariance: Array) -> Array:
    """The correlations (n, n) of a covariance (n, n); NaN beside a variance of 0."""
    sigmas = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.outer(sigmas, sigmas) > 0.0, covariance / np.outer(sigmas, sigmas), np.nan)


def correlations(ax: Axes, covariance: Array, names: Sequence[str]) -> Axes:
    """Correlations of a covariance (n, n) in hundredths, on matplotlib's axes: blue positive, orange negative."""
    from matplotlib.colors import LinearSegmentedColormap

    r = correlations_of(covariance)
    shades = LinearSegmentedColormap.from_list("apart", [hex_colour(SIMULATED), "#ffffff", hex_colour(MEASURED)])
    shown = ax.imshow(r, cmap=shades, vmin=-1.0, vmax=1.0)
    for row, column in np.ndindex(r.shape):
        if row != column and np.isfinite(r[row, column]):
            text = str(round(100 * float(r[row, column]))).replace("-", "−")
            ax.text(column, row, text, ha="center", va="center", fontsize=6.0, color="#1d2126")
    ax.set_xticks(range(len(names)), names, rotation=90)
    ax.set_yticks(range(len(names)), names)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    ax.set_xlabel("component [name]")
    ax.set_ylabel("component [name]")
    if ax.figure is not None:
        ax.figure.colorbar(shown, ax=ax, shrink=0.8, label="correlation [1]")
    return ax


def landing_odds(ax: AnyAxes, odds: Mapping[int, float]) -> AnyAxes:
    """Share of the simulated landings on each face."""
    faces = sorted(odds)
    ax.bar([str(face) for face in faces], [odds[face] for face in faces], color=hex_colour(SIMULATED), width=0.7)
    for place, face in enumerate(faces):
        ax.text(place, odds[face], f"{100 * odds[face]:.0f} %", ha="center", va="bottom", fontsize=8.0)
    ax.set_ylim(0.0, 1.1)
    ax.set_xlabel("face [number]")
    ax.set_ylabel("share of landings [1]")
    return remove_box(ax)


def odds_over_time(ax: AnyAxes, estimates: Sequence[Estimate], impacts: Sequence[Impact] = ()) -> AnyAxes:
    """Odds of each face by the fit to the frames so far, as steps from each estimate to the next."""
    known = [estimate for estimate in estimates if estimate.face_odds]
    times = [1e3 * estimate.time_s for estimate in known]
    for face in sorted({face for estimate in known for face in estimate.face_odds or {}}):
        shares = [(estimate.face_odds or {}).get(face, 0.0) for estimate in known]
        if max(shares) > 0.0:
            colour = hex_colour(FACE_COLOURS[(face - 1) % len(FACE_COLOURS)])
            ax.step(times, shares, "-o", where="post", color=colour, markersize=4.0, label=f"face {face}")
    _mark_impacts(ax, impacts)
    ax.set_ylim(-0.03, 1.05)
    ax.set_ylabel("odds of landing [1]")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return _time_axis(ax)


def _matrices(quaternions: ArrayLike) -> Array:
    """Rotation matrices (n, 3, 3); NaN where the quaternion is NaN."""
    q = np.asarray(quaternions, float)
    known = np.isfinite(q).all(1)
    matrices = np.full((len(q), 3, 3), np.nan)
    if known.any():
        matrices[known] = matrix_from_quat(q[known])
    return matrices


def _mark_impacts(ax: PlotAxes, impacts: Sequence[Impact]) -> None:
    for impact in impacts:
        ax.axvline(1e3 * impact.time_s, color=hex_colour(IMPACT), linewidth=0.7, linestyle=(0, (2, 2)), zorder=1)


def _time_axis(ax: AnyAxes) -> AnyAxes:
    ax.set_xlabel("time [ms]")
    ax.margins(x=0.01)
    return remove_box(ax)


def legend_above(ax: PlotAxes, columns: int, *, markerscale: float = 1.0, handletextpad: float = 0.8) -> None:
    """The names of the curves in a row above the axes, where they cover no data."""
    ax.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False,
        markerscale=markerscale, handletextpad=handletextpad,
    )  # fmt: skip


def remove_box(ax: AnyAxes) -> AnyAxes:
    """The axes without the lines at the top and at the right."""
    ax.spines[["top", "right"]].set_visible(False)
    return ax
