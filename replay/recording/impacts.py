"""The bounces in a recording: points and impulses on the table, lines in the plots, lanes of flights, and sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from ...model.die import Solid
from ...model.throw import HeldContact, Impact, Throw
from ...tracking.throw import SupportedMotion
from ..elements import BLACK, COLOURS, Colour, Motion, bounce_sentence, impulse_of, mixed
from .dice import flight_begins
from .timelines import Clock, send_instants

Array = NDArray[np.float64]

ARROW = 3.0
"""Length of the strongest impulse as drawn, in circumradii of the die: its tip stands clear of the die."""


def arrow_scale(solid: Solid, motions: Iterable[Motion]) -> float:
    """Metres drawn for one N s, the same for all motions; 0 where no impulse is known."""
    strengths = [float(np.linalg.norm(impact.impulse_N_s)) for motion in motions for impact in motion.impacts]
    strongest = max((strength for strength in strengths if np.isfinite(strength)), default=0.0)
    return ARROW * solid.circumradius / strongest if strongest > 0.0 else 0.0


def send_bounces(
    recording: rr.RecordingStream, motion: Motion, throw: Throw, clock: Clock, scale: float, height_mm: float
) -> None:
    """Lanes of flights; each bounce on the table, in the plots and in the log. `scale` is that of the arrows, and
    `height_mm` that of the lines in the plot of heights."""
    _send_lanes(recording, motion.name, throw, clock)
    if not throw.bounces:
        return
    colour = COLOURS[motion.name]
    _send_points(recording, motion.name, throw.bounces, clock, scale)
    times = [impact.time_s for impact in throw.bounces]
    line = rr.SeriesLines(
        colors=mixed(colour, BLACK, 0.35), names=f"{motion.name} bounce", widths=1.0, aggregation_policy="off"
    )
    send_vertical_lines(recording, f"plots/height/bounces/{motion.name}", times, [0.0], [height_mm], clock, line)
    said = [f"{motion.name}: {bounce_sentence(k, impact)}" for k, impact in enumerate(throw.bounces, 1)]
    send_log_lines(recording, f"events/{motion.name}", times, said, clock, colour)


def send_log_lines(
    recording: rr.RecordingStream, entity: str, times_s: ArrayLike, said: Sequence[str], clock: Clock, colour: Colour
) -> None:
    """Lines of the event log."""
    log = rr.TextLog.columns(text=said, level=["INFO"] * len(said), color=[colour] * len(said))
    send_instants(recording, entity, times_s, clock, log)


def send_vertical_lines(
    recording: rr.RecordingStream,
    entity: str,
    times_s: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    clock: Clock,
    style: rr.SeriesLines,
) -> None:
    """A vertical line in a plot at each instant, from `low` to `high`; NaN between them parts one from the next."""
    times = np.asarray(times_s, float)
    ends = np.stack(np.broadcast_arrays(low, high, np.full(len(times), np.nan)), axis=1)
    recording.log(entity, style, static=True)
    send_instants(recording, entity, np.repeat(times, 3), clock, rr.Scalars.columns(scalars=ends.ravel()))


def _send_points(
    recording: rr.RecordingStream, name: str, impacts: Sequence[Impact], clock: Clock, scale: float
) -> None:
    """A point for each bounce, and its impulse as an arrow with its number; the views show those up to the cursor."""
    colour = COLOURS[name]
    times = np.array([impact.time_s for impact in impacts])
    points = np.array([[*impact.point_m, 2e-4] for impact in impacts])
    tips = points + scale * np.array([impact.impulse_N_s for impact in impacts])
    known, struck = (np.flatnonzero(np.isfinite(rows).all(1)) for rows in (points, tips if scale > 0.0 else points[:0]))
    # Where the arrows are not known the points carry the numbers.
    silent = np.setdiff1d(known, struck)
    _send_rows(
        recording,
        f"world/{name}/impacts",
        times[known],
        clock,
        rr.Points3D.columns(positions=points[known], radii=np.full(len(known), -3.0), colors=[colour] * len(known)),
    )
    _send_rows(
        recording,
        f"world/{name}/impulses",
        times[struck],
        clock,
        rr.Arrows3D.columns(
            origins=points[struck],
            vectors=(tips - points)[struck],
            radii=np.full(len(struck), -1.2),
            colors=[colour] * len(struck),
        ),
    )
    for rows, places in ((struck, tips), (silent, points)):
        labels = [f"{k + 1}" + (f": {impulse_of(impacts[k])}" if places is tips else "") for k in rows]
        _send_rows(
            recording,
            f"world/{name}/impulses/strength",
            times[rows],
            clock,
            rr.Points3D.columns(
                positions=places[rows], radii=np.full(len(rows), -1.2), colors=[colour] * len(rows), labels=labels
            ),
        )


def _send_rows(
    recording: rr.RecordingStream, entity: str, times_s: Array, clock: Clock, columns: rr.ComponentColumnList
) -> None:
    """One row an instant, where there are any."""
    if len(times_s):
        send_instants(recording, entity, times_s, clock, columns.partition(np.ones(len(times_s), int)))


def _send_lanes(recording: rr.RecordingStream, name: str, throw: Throw, clock: Clock) -> None:
    """A lane with every stretch between two events."""
    stretches = _stretches(throw)
    names = list(dict.fromkeys(stretches))
    shades = [mixed(COLOURS[name], BLACK, 0.3 * (k % 2)) for k in range(len(names))]
    recording.log(f"phase/{name}", rr.StateConfiguration(values=names, colors=shades), static=True)
    lanes = rr.StateChange.columns(state=stretches)
    send_instants(recording, f"phase/{name}", flight_begins(throw, clock), clock, lanes)


def _stretches(throw: Throw) -> list[str]:
    """A name for every stretch between two events: the flights in their order, and what is held on the table."""
    names, flown = [], 0
    for flight in throw.flights:
        if isinstance(flight, HeldContact):
            kinds = {1: "on vertex", 2: "on edge"}
            names.append(" ".join([kinds.get(len(flight.vertices), "on face"), *map(str, flight.vertices)]))
        elif isinstance(flight, SupportedMotion):
            names.append("on the table")
        else:
            flown += 1
            names.append(f"flight {flown}")
    return names


def send_bounce_chi(recording: rr.RecordingStream, motion: Motion, clock: Clock) -> None:
    """The apparent restitution of every bounce, and its interval as an upright line."""
    known = [impact for impact in motion.impacts if np.isfinite(impact.chi)]
    if not known:
        return
    colour, entity = COLOURS[motion.name], "plots/chi/bounce"
    name = "each bounce alone"
    recording.log(entity, rr.SeriesPoints(colors=colour, markers="circle", marker_sizes=4.0, names=name), static=True)
    values = rr.Scalars.columns(scalars=[impact.chi for impact in known])
    send_instants(recording, entity, [impact.time_s for impact in known], clock, values)
    sure = [impact for impact in known if np.isfinite([impact.chi_low, impact.chi_high]).all()]
    if sure:
        style = rr.SeriesLines(colors=colour, names="95 % interval", widths=1.5, aggregation_policy="off")
        low, high = [impact.chi_low for impact in sure], [impact.chi_high for impact in sure]
        send_vertical_lines(
            recording, f"{entity}_interval", [impact.time_s for impact in sure], low, high, clock, style
        )
