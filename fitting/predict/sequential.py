"""Sequential estimates of a throw: χ and the face odds from the frames up to each bounce.

The effects are those of the whole fit, and its values start the search. Intervals are made as those of the whole fit; where
the frames so far leave all of its range open, χ has no value. Each estimate extends the trajectory before it by one flight.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...model.die import Die
from ...model.laws import Table
from ...model.throw import Throw
from ...tracking.track import Track
from ..estimation import flight_observations
from ..free import FreeFlights, fit_flights
from ..results import Fit, Parameter
from ..throw import (
    Trajectory,
    extend_through_bounces,
    first_flight_trajectory,
    inflated_covariance,
    landing_odds,
    parameters_of,
    physics_of_fit,
    table_under,
    weighted_as_inflated,
)


@dataclass(frozen=True)
class Estimate:
    """What the frames up to the end of one flight determine; None for the rest."""

    bounces: int
    """How many of the measured bounces lie before that flight."""
    time_s: float
    """Of the last of them."""
    chi: Parameter
    face_odds: dict[int, float] | None
    """Share of the throws drawn from these frames that land on each face."""


def sequential_estimates(
    track: Track,
    measured: Throw,
    die: Die,
    fit: Fit,
    table: Table | None = None,
) -> tuple[Estimate, ...]:
    """One estimate for each bounce that the fit explains and that frames follow, in order of time; the last is the fit's own.

    `track`, `measured` and `table` are those that `fit` was made from. Flights too short for a fit are skipped.
    """
    if not fit.bounces_fitted:
        return ()
    free = fit_flights(flight_observations(track, measured), measured, fit.choices)
    first = next(k for k, flight in enumerate(free.flights) if flight is not None)
    reached = first + fit.bounces_fitted
    beam, found = [first_flight_trajectory(free, first, physics_of_fit(fit, die, table_under(track, table)))], []
    for last in range(first + 1, reached):
        shorter = Throw(measured.flights[: last + 1], measured.impacts[:last])
        beam = extend_through_bounces(beam, shorter, free)
        if beam[0].reached == last:
            found.append(_estimate(beam[0], measured, free))
    odds = {fit.landed_face: 1.0} if fit.landed_face is not None else fit.face_odds
    return (*found, Estimate(reached, measured.impacts[reached - 1].time_s, fit.parameters["chi"], odds))


def _estimate(trajectory: Trajectory, measured: Throw, free: FreeFlights) -> Estimate:
    """The estimate from one trajectory, as the whole fit makes its own."""
    trajectory = weighted_as_inflated(trajectory, free.huber_threshold)
    chi = parameters_of([trajectory], free, ["chi"])["chi"]
    covariance = inflated_covariance(trajectory, free.huber_threshold)
    _, odds, _ = landing_odds(trajectory.physics, trajectory.state, covariance, trajectory.vertices)
    return Estimate(trajectory.reached, measured.impacts[trajectory.reached - 1].time_s, chi, odds)
