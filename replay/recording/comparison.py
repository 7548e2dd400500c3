"""Experiment against model: the status of tracking, residuals with bands, and χ and the landing odds over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...tracking.track import ABSENT, LOST, TRACKED, Track
from ..elements import (
    ALARM,
    AXIS_COLOURS,
    FACE_COLOURS,
    IMPACT,
    MEASURED,
    SIMULATED,
    WHITE,
    Colour,
    Residuals,
    estimate_sentence,
    mixed,
)
from .timelines import Clock, on_frames, send_instants, send_log_lines

if TYPE_CHECKING:
    from ...fitting.predict import Estimate

Array = NDArray[np.float64]

BANDS = (1.0, 2.0)
"""Half widths of the bands behind residuals [standard errors]: 68 and 95 % of noise lie within them."""
NORMAL_95 = 1.96
"""Half width of a 95 % interval [standard errors]."""


def send_status(recording: rr.RecordingStream, track: Track) -> None:
    """The status of tracking on the frames where it changes."""
    changes = np.flatnonzero(np.r_[True, track.status[1:] != track.status[:-1]])
    recording.log(
        "phase/tracking",
        rr.StateConfiguration(values=[TRACKED, LOST, ABSENT], colors=[MEASURED, ALARM, IMPACT]),
        static=True,
    )
    states = rr.StateChange.columns(state=[str(s) for s in track.status[changes]])
    recording.send_columns("phase/tracking", on_frames(track.frame[changes], track.time_s[changes]), states)


# --- residuals ---


def send_residuals(recording: rr.RecordingStream, rest: Residuals) -> None:
    """Residuals in millimetres and degrees with the measurement's standard error as a band, and in standard errors."""
    index = on_frames(rest.frame, rest.time_s)
    if not len(rest.frame):
        return
    for values, errors, unit, what in (
        (rest.position_mm, rest.standard_errors[:, :3], "mm", "position"),
        (rest.turn_deg, rest.standard_errors[:, 3:], "deg", "turn"),
    ):
        for k, axis in enumerate("xyz"):
            colour = AXIS_COLOURS[k]
            _send_with_band(
                recording, f"plots/residual/{what}_{unit}/{axis}", index, axis, colour, values.T[k], errors.T[k]
            )
            style = rr.SeriesLines(colors=colour, names=axis, widths=1.2)
            recording.log(f"plots/residual/{what}_sigmas/{axis}", style, static=True)
            columns = rr.Scalars.columns(scalars=values.T[k] / errors.T[k])
            recording.send_columns(f"plots/residual/{what}_sigmas/{axis}", index, columns)
        _send_noise_bands(recording, f"plots/residual/{what}_sigmas", rest)
    recording.log(
        "plots/residual/rms_sigmas", rr.SeriesLines(colors=MEASURED, names="all six", widths=1.2), static=True
    )
    recording.send_columns("plots/residual/rms_sigmas", index, rr.Scalars.columns(scalars=rest.sigmas))


def _send_with_band(
    recording: rr.RecordingStream,
    entity: str,
    index: list[rr.TimeColumn],
    name: str,
    colour: Colour,
    values: Array,
    errors: Array,
) -> None:
    """A curve with a band of ± 1 standard error where that is known."""
    recording.log(entity, rr.Measurements.from_fields(colors=[colour], names=[name], widths=[1.2]), static=True)
    variances = np.where(np.isfinite(errors), errors**2, 0.0)
    recording.send_columns(entity, index, rr.Measurements.columns(values=values, variances=variances))


def _send_noise_bands(recording: rr.RecordingStream, origin: str, rest: Residuals) -> None:
    """The bands within which noise alone stays, in standard errors."""
    ends = [0, -1]
    for width in BANDS:
        entity = f"{origin}/band_{width:g}"
        style = rr.Measurements.from_fields(colors=[IMPACT], names=[f"± {width:g}"], widths=[0.5])
        recording.log(entity, style, static=True)
        columns = rr.Measurements.columns(values=[0.0, 0.0], variances=[width**2] * 2)
        recording.send_columns(entity, on_frames(rest.frame[ends], rest.time_s[ends]), columns)


# --- estimates over time ---


def send_estimates(recording: rr.RecordingStream, estimates: Sequence[Estimate], clock: Clock) -> None:
    """χ with its standard error and the landing odds during the flight after each bounce, and lines of the event log.

    The value during a flight is estimated from all frames to the end of that flight.
    """
    if not estimates:
        return
    times = np.array([estimate.time_s for estimate in estimates])
    lines = [f"fit {estimate_sentence(estimate)}" for estimate in estimates]
    send_log_lines(recording, "events/told", times, lines, clock, mixed(IMPACT, WHITE, 0.4))
    _send_chi(recording, [estimate for estimate in estimates if estimate.chi.value is not None], clock)
    _send_odds(recording, [estimate for estimate in estimates if estimate.face_odds], clock)


def _send_chi(recording: rr.RecordingStream, known: Sequence[Estimate], clock: Clock) -> None:
    if not known:
        return
    instants, rows = _held(known, clock)
    name = "fit to the frames so far, ± 1 standard error"
    style = rr.Measurements.from_fields(colors=[SIMULATED], names=[name], widths=[1.8], aggregation_policy="off")
    recording.log("plots/chi/estimate", style, static=True)
    values = np.array([estimate.chi.value for estimate in known], float)[rows]
    errors = np.array([_standard_error(estimate) for estimate in known])[rows]
    columns = rr.Measurements.columns(values=values, variances=errors**2)
    send_instants(recording, "plots/chi/estimate", instants, clock, columns)


def _standard_error(estimate: Estimate) -> float:
    """The standard error of a normal distribution with this 95 % interval; 0 without an interval."""
    low, high = estimate.chi.low, estimate.chi.high
    return 0.0 if low is None or high is None else (high - low) / (2.0 * NORMAL_95)


def _send_odds(recording: rr.RecordingStream, known: Sequence[Estimate], clock: Clock) -> None:
    """One curve per face; faces on which no throw landed are left out."""
    if not known:
        return
    instants, rows = _held(known, clock)
    faces = sorted({face for estimate in known for face, odds in (estimate.face_odds or {}).items() if odds > 0.0})
    for face in faces:
        entity = f"plots/odds/face_{face}"
        colour = mixed(FACE_COLOURS[(face - 1) % len(FACE_COLOURS)], WHITE, 0.25)
        recording.log(
            entity,
            rr.SeriesLines(colors=colour, names=f"face {face}", widths=2.0, aggregation_policy="off"),
            static=True,
        )
        odds = np.array([(estimate.face_odds or {}).get(face, 0.0) for estimate in known])
        send_instants(recording, entity, instants, clock, rr.Scalars.columns(scalars=odds[rows]))


def _held(known: Sequence[Estimate], clock: Clock) -> tuple[Array, NDArray[np.int64]]:
    """Instants of a step curve through the estimates, the last held to the end, and the index of each one's estimate."""
    times = np.array([estimate.time_s for estimate in known])
    end = max(float(clock.time_s[-1]), float(times[-1]))
    instants = np.concatenate([np.repeat(times, 2)[1:], [end]])
    return instants, np.repeat(np.arange(len(known)), 2)
