"""The bounces: points and impulses on the table, lines in the plots, lanes of flights, and lines of the event log."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...model.die import Solid
from ...model.throw import HeldContact, Impact, Throw
from ...tracking.throw import SupportedMotion
from ..elements import BLACK, COLOURS, Motion, bounce_sentence, impulse_of, mixed
from .dice import flight_begins
from .timelines import Clock, send_instants, send_log_lines, send_vertical_lines

Array = NDArray[np.float64]

ARROW_LENGTH = 3.0
"""Length of the strongest impulse as drawn, in circumradii of the die: its tip is clear of the die."""
POINT_HEIGHT_M = 2e-4
"""Height at which contact points are drawn, so that the table does not hide them."""
POINT_RADIUS = 3.0
"""Of contact points [points]."""
ARROW_RADIUS = 1.2
"""Of impulses and their labels [points]."""


def arrow_scale(solid: Solid, motions: Iterable[Motion]) -> float:
    """Length of an arrow per impulse [m/(N s)], the same for all motions; 0 if no impulse is known."""
    impulses_N_s = [float(np.linalg.norm(impact.impulse_N_s)) for motion in motions for impact in motion.impacts]
    largest = max((impulse for impulse in impulses_N_s if np.isfinite(impulse)), default=0.0)
    return ARROW_LENGTH * solid.circumradius / largest if largest > 0.0 else 0.0


def send_bounces(
    recording: rr.RecordingStream, motion: Motion, throw: Throw, clock: Clock, scale: float, height_mm: float
) -> None:
    """Send the lanes of flights, and each bounce on the table, in the plots and in the event log.

    `scale` is the length of arrows [m/(N s)], `height_mm` the height of the lines in the plot of heights.
    """
    _send_lanes(recording, motion.name, throw, clock)
    if not throw.bounces:
        return
    colour = COLOURS[motion.name]
    _send_points(recording, motion.name, throw.bounces, clock, scale)
    times = [impact.time_s for impact in throw.bounces]
    line = rr.SeriesLines(
        colors=mixed(colour, BLACK, 0.35), names=f"{motion.name} bounce", widths=1.0, aggregation_policy="off"
    )
    send_vertical_lines(recording, f"plots/height/bounces/{motion.name}", times, ([0.0], [height_mm]), clock, line)
    lines = [f"{motion.name}: {bounce_sentence(k, impact)}" for k, impact in enumerate(throw.bounces, 1)]
    send_log_lines(recording, f"events/{motion.name}", times, lines, clock, colour)


def _send_points(
    recording: rr.RecordingStream, name: str, impacts: Sequence[Impact], clock: Clock, scale: float
) -> None:
    """A point for each bounce, and its impulse as an arrow with number and size; the views show those up to the cursor."""
    colour = COLOURS[name]
    times = np.array([impact.time_s for impact in impacts])
    points = np.array([[*impact.point_m, POINT_HEIGHT_M] for impact in impacts])
    tips = points + scale * np.array([impact.impulse_N_s for impact in impacts])
    with_point = np.flatnonzero(np.isfinite(points).all(1))
    with_arrow = np.flatnonzero(np.isfinite(tips).all(1)) if scale > 0.0 else np.zeros(0, int)
    point_only = np.setdiff1d(with_point, with_arrow)  # here the point carries the bounce's number
    _send_rows(
        recording,
        f"world/{name}/impacts",
        times[with_point],
        clock,
        rr.Points3D.columns(
            positions=points[with_point],
            radii=np.full(len(with_point), -POINT_RADIUS),
            colors=[colour] * len(with_point),
        ),
    )
    _send_rows(
        recording,
        f"world/{name}/impulses",
        times[with_arrow],
        clock,
        rr.Arrows3D.columns(
            origins=points[with_arrow],
            vectors=(tips - points)[with_arrow],
            radii=np.full(len(with_arrow), -ARROW_RADIUS),
            colors=[colour] * len(with_arrow),
        ),
    )
    for rows, positions in ((with_arrow, tips), (point_only, points)):
        labels = [f"{k + 1}" + (f": {impulse_of(impacts[k])}" if positions is tips else "") for k in rows.tolist()]
        _send_rows(
            recording,
            f"world/{name}/impulses/strength",
            times[rows],
            clock,
            rr.Points3D.columns(
                positions=positions[rows],
                radii=np.full(len(rows), -ARROW_RADIUS),
                colors=[colour] * len(rows),
                labels=labels,
            ),
        )


def _send_rows(
    recording: rr.RecordingStream, entity: str, times_s: Array, clock: Clock, columns: rr.ComponentColumnList
) -> None:
    """One row per instant."""
    if len(times_s):
        send_instants(recording, entity, times_s, clock, columns.partition(np.ones(len(times_s), int)))


def _send_lanes(recording: rr.RecordingStream, name: str, throw: Throw, clock: Clock) -> None:
    """A lane with every phase between two events."""
    phases = _phases(throw)
    names = list(dict.fromkeys(phases))
    shades = [mixed(COLOURS[name], BLACK, 0.3 * (k % 2)) for k in range(len(names))]
    recording.log(f"phase/{name}", rr.StateConfiguration(values=names, colors=shades), static=True)
    lanes = rr.StateChange.columns(state=phases)
    send_instants(recording, f"phase/{name}", flight_begins(throw, clock), clock, lanes)


def _phases(throw: Throw) -> list[str]:
    """A name for every phase between two events: the number of the flight, or the contact that is held."""
    names, flights = [], 0
    for flight in throw.flights:
        if isinstance(flight, HeldContact):
            kinds = {1: "on vertex", 2: "on edge"}
            names.append(" ".join([kinds.get(len(flight.vertices), "on face"), *map(str, flight.vertices)]))
        elif isinstance(flight, SupportedMotion):
            names.append("on the table")
        else:
            flights += 1
            names.append(f"flight {flights}")
    return names


def send_bounce_chi(recording: rr.RecordingStream, motion: Motion, clock: Clock) -> None:
    """The apparent restitution of every bounce, and its interval as a vertical line."""
    known = [impact for impact in motion.impacts if np.isfinite(impact.chi)]
    if not known:
        return
    colour, entity = COLOURS[motion.name], "plots/chi/bounce"
    name = "each bounce alone"
    recording.log(entity, rr.SeriesPoints(colors=colour, markers="circle", marker_sizes=4.0, names=name), static=True)
    values = rr.Scalars.columns(scalars=[impact.chi for impact in known])
    send_instants(recording, entity, [impact.time_s for impact in known], clock, values)
    bounded = [impact for impact in known if np.isfinite([impact.chi_low, impact.chi_high]).all()]
    if bounded:
        style = rr.SeriesLines(colors=colour, names="95 % interval", widths=1.5, aggregation_policy="off")
        ends = [impact.chi_low for impact in bounded], [impact.chi_high for impact in bounded]
        times = [impact.time_s for impact in bounded]
        send_vertical_lines(recording, f"{entity}_interval", times, ends, clock, style)
