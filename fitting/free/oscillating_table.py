"""An oscillating table: the motion along its normal that the bounces of a throw show, before any throw is fitted.

Where two flights meet, the corner touches the table at the height of the table and leaves it with the table's velocity
added. At the instant t of a bounce, with h the height of the contact point and u, u' its vertical velocities,

    h = a sin ωt + b cos ωt,    u' - V = -χ (u - V),    V = ω (a cos ωt - b sin ωt).

For a given ω and χ both are linear in a and b. All frequencies that a throw can distinguish are tried, and the best few
start a fit. If the heights show a table at rest, no frequency is tried.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ...model.die import Die
from ...model.rotations import rotation_between
from ...model.throw import Flight, Impact
from .flights import FreeFlights
from .impulses import contact_arm, normal_velocity

Array = NDArray[np.float64]

TABLE_MOTION = ("table_amplitude_m", "table_frequency_hz", "table_phase_rad")
"""Names of the parameters of an oscillating table."""

_AT_REST_M = 2e-4
"""Height at a touch below which the table is at rest: the error of flights of a dozen frames."""

_SIGMA_HEIGHT_M = 5e-5
"""Scale of the residuals of heights."""

_SIGMA_SPEED_M_S = 0.02
"""Scale of the residuals of velocities."""

_MIN_BOUNCES = 4
"""Two numbers each, for four unknowns: with three bounces some motion also explains what a wrong die does."""

_MAX_FREQUENCY_HZ = 200.0
"""Highest frequency tried."""

_MIN_CYCLES = 0.25
"""Lowest frequency tried, in cycles over the bounces."""

_FREQUENCY_STEP = 0.1
"""Step between frequencies, in cycles over the bounces."""

_CANDIDATES = 3
"""Motions returned."""

_MEETING_STEPS = 3
"""Gauss-Newton steps to the instant at which two flights are nearest to each other."""

_ITERATIONS = 4
"""Alternations between χ and the motion of one frequency."""


def table_motion_candidates(die: Die, free: FreeFlights, impacts: Sequence[Impact]) -> list[dict[str, float]]:
    """Values of amplitude, frequency, phase and χ from which a fit may find the motion of the table, the best first;
    none where the bounces show a table at rest, or are too few.
    """
    pairs = zip(impacts, free.flights, free.flights[1:], strict=False)
    touches = [
        _touch(die, before.flight, after.flight, impact)
        for impact, before, after in pairs
        if before is not None and after is not None and impact.contact == "vertex" and len(impact.vertices) == 1
    ]
    if len(touches) < _MIN_BOUNCES:
        return []
    times, heights, before_m_s, after_m_s = np.array(touches).T
    if np.abs(heights).max() < _AT_REST_M:
        return []
    columns, span = (times, heights, before_m_s, after_m_s), float(np.ptp(times))
    frequencies = np.arange(_MIN_CYCLES / span, _MAX_FREQUENCY_HZ, _FREQUENCY_STEP / span)
    found = [_best_motion(f, *columns) for f in frequencies]
    costs = np.array([cost for cost, _ in found])
    # Local minima, the deepest first.
    inner = np.flatnonzero((costs[1:-1] <= costs[:-2]) & (costs[1:-1] <= costs[2:])) + 1
    return [
        _best_near(frequencies[k - 1], frequencies[k + 1], columns)
        for k in inner[np.argsort(costs[inner])][:_CANDIDATES]
    ]


def _best_near(low_hz: float, high_hz: float, columns: tuple[Array, Array, Array, Array]) -> dict[str, float]:
    """The motion nearest to the touches, between two frequencies."""
    nearest = minimize_scalar(lambda f: _best_motion(f, *columns)[0], bounds=(low_hz, high_hz), method="bounded")
    return _best_motion(float(nearest.x), *columns)[1]


def _touch(die: Die, before: Flight, after: Flight, impact: Impact) -> tuple[float, float, float, float]:
    """Instant, height [m] of the contact point, and its vertical velocities before and after, where the flights
    meet.
    """
    instant = impact.time_s
    for _ in range(_MEETING_STEPS):
        one, other = before.at(instant), after.at(instant)
        apart = other.position_m - one.position_m
        turned = rotation_between(one.quaternion, other.quaternion) * die.solid.inradius
        rate = other.velocity_m_s - one.velocity_m_s
        turning = (other.omega_rad_s - one.omega_rad_s) * die.solid.inradius
        instant -= float(apart @ rate + turned @ turning) / float(rate @ rate + turning @ turning)
    one, other = before.at(instant), after.at(instant)
    arms = [contact_arm(die, state.rotation, impact.vertices[0]) for state in (one, other)]
    height = 0.5 * float(one.position_m[2] + arms[0][2] + other.position_m[2] + arms[1][2])
    return instant, height, normal_velocity(one, arms[0]), normal_velocity(other, arms[1])


def _best_motion(
    frequency_hz: float, times: Array, heights: Array, before: Array, after: Array
) -> tuple[float, dict[str, float]]:
    """The motion of one frequency nearest to the touches: its cost, and its values."""
    rate = 2.0 * np.pi * frequency_hz
    places = np.stack([np.sin(rate * times), np.cos(rate * times)], 1)
    speeds = rate * np.stack([places[:, 1], -places[:, 0]], 1)
    motion = np.linalg.lstsq(places, heights, rcond=None)[0]
    chi = 0.5
    for _ in range(_ITERATIONS):
        table = speeds @ motion
        chi = float(np.clip(-((after - table) @ (before - table)) / ((before - table) @ (before - table)), 0.0, 1.0))
        matrix = np.vstack([places / _SIGMA_HEIGHT_M, (1.0 + chi) * speeds / _SIGMA_SPEED_M_S])
        right = np.concatenate([heights / _SIGMA_HEIGHT_M, (after + chi * before) / _SIGMA_SPEED_M_S])
        motion = np.linalg.lstsq(matrix, right, rcond=None)[0]
    left = right - matrix @ motion
    values = (float(np.hypot(*motion)), frequency_hz, float(np.arctan2(motion[1], motion[0])))
    return float(left @ left), {"chi": chi, **dict(zip(TABLE_MOTION, values, strict=True))}
