"""What is known of a throw while it goes on: χ and the odds of the faces from the frames up to each bounce.

The effects are those of the whole fit, and its values are where the search begins; a parameter that the frames so far do
not tell keeps an interval as wide as what its law allows. Each estimate lengthens the shot before it by one flight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ...model.die import Die
from ...model.laws import LEVEL, Table
from ...model.throw import Throw
from ...tracking.track import Track
from ..estimation import sight
from ..free import FreeFlights, fit_flights
from ..results import Fit, Parameter
from ..throw import LEVEL_OF_INTERVALS, Physics, Shot, landing_odds, opening, through_the_bounces


@dataclass(frozen=True)
class Estimate:
    """What the frames up to the end of one flight say; what they do not is None."""

    bounces: int
    """How many of the measured bounces lie before that flight."""
    time_s: float
    """Of the last of them."""
    chi: Parameter
    face_odds: dict[int, float] | None
    """Share of the throws drawn from these frames that land on each face."""


def estimates(track: Track, measured: Throw, die: Die, fit: Fit, table: Table = LEVEL) -> tuple[Estimate, ...]:
    """One for each bounce that the fit explains and that frames follow, in the order of time; the last is the fit's own.

    `track` and `measured` are those that `fit` was made from. Flights too short to be fitted add nothing.
    """
    if not fit.bounces_fitted:
        return ()
    free = fit_flights(sight(track, measured), measured)
    first = next(k for k, flight in enumerate(free.flights) if flight is not None)
    reached = first + fit.bounces_fitted
    beam, found = [opening(free, first, physics_of_fit(fit, die, table))], []
    for last in range(first + 1, reached):
        shorter = Throw(measured.flights[: last + 1], measured.impacts[:last])
        beam = through_the_bounces(beam, shorter, free)
        if beam[0].reached == last:
            found.append(_estimate(beam[0], measured, free))
    odds = {fit.landed_face: 1.0} if fit.landed_face is not None else fit.face_odds
    return (*found, Estimate(reached, measured.impacts[reached - 1].time_s, fit.parameters["chi"], odds))


def physics_of_fit(fit: Fit, die: Die, table: Table = LEVEL) -> Physics:
    """Die, table and law with the values that a fit found."""
    values = {name: p.value for name, p in fit.parameters.items() if p.value is not None}
    held = frozenset(name for name, p in fit.parameters.items() if not p.free and name in values)
    return Physics(die, table, {"chi": 0.5}, held, fit.restitution).with_values(**values)


def _estimate(shot: Shot, measured: Throw, free: FreeFlights) -> Estimate:
    variance, tau = shot.inflation
    covariance = shot.covariance * variance * tau
    chi = shot.physics.values["chi"]
    reach = float(norm.ppf(0.5 + 0.5 * LEVEL_OF_INTERVALS)) * float(np.sqrt(covariance[12, 12]))
    low, high = np.clip([chi - reach, chi + reach], *shot.physics.bounds("chi"))
    parameter = Parameter(chi, float(low), float(high), LEVEL_OF_INTERVALS, True, False)
    _, odds, _ = landing_odds(shot.physics, shot.state, covariance, shot.vertices)
    return Estimate(shot.reached, measured.impacts[shot.reached - 1].time_s, parameter, odds)
