"""The whole throw at once: χ, the twelve initial conditions, and the effects that the throw shows.

A weighted least squares over the poses of all frames (`sightings`), through as many bounces as the model explains
(`lengthening`), with no more physics than pays (`selection`). What a track does not carry is None in the result, with a
sentence that says why.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from ...model.die import Die
from ...model.laws import LEVEL, Table
from ...model.throw import Throw
from ...tracking.track import Track
from ..estimation import profile_interval, sight, variance_inflation
from ..free import Bounce, FreeFlights, common_restitution, fit_flights, measure_bounces, moved_state
from ..results import Effect, Fit, Parameter
from .bootstrap import bootstrap_intervals
from .clock_and_scale import as_tracked
from .effects import Trial, no_longer_pays, try_effects, try_effects_at_a_loss
from .extension import at_its_limit, best_attempt, can_go_on, loss_scale, through_the_bounces, ways_of_friction
from .landing import continued, landing_odds, resting_face
from .messages import bounce_words, frame_words, inflation_words, missed_words
from .physics import Physics
from .shooting import Shot, mean_squares, opening, shoot, with_physics

Array = NDArray[np.float64]

LEVEL_OF_INTERVALS = 0.95

IntervalMethod = Literal["profile", "covariance", "bootstrap"]
INTERVAL_METHODS: tuple[IntervalMethod, ...] = ("profile", "covariance", "bootstrap")
"""Where the cost rises by so much with all else fitted anew; ±1.96 σ, cut at what the law allows; percentiles of fits to
residuals drawn anew in blocks. The first needs no straight cost and no bell, and is 2 to 3 times as long as the second;
the third is longer by far."""

_Z = float(norm.ppf(0.5 + 0.5 * LEVEL_OF_INTERVALS))
"""Sigmas to either side that hold as much of a normal distribution."""

_MOST_SHOTS, _SETTLED = 6, 0.02
"""Shots of one point of a profile, and the fall of the cost that ends them: a hundredth of what an interval is told by."""

_MOST_EFFECTS = 4
"""Effects taken in, one after the other; more than any scene was seen to show."""


@dataclass(frozen=True, eq=False)
class _Work:
    """What a fit has before it looks at any bounce."""

    track: Track
    measured: Throw
    free: FreeFlights
    first: int
    """The first flight that two frames show."""
    intervals: IntervalMethod

    def bounces(self, die: Die, begin: int, end: int | None = None) -> tuple[Bounce | None, ...]:
        """Of the measured impacts, those from `begin` up to `end`, looked at one by one."""
        return measure_bounces(die, self.free, self.measured.impacts, begin, end)


def fit_throw(
    track: Track, measured: Throw, die: Die, table: Table = LEVEL, intervals: IntervalMethod = "profile"
) -> Fit:
    """χ and the initial conditions of a tracked throw, with intervals, from all bounces that the model explains.

    `track` holds the poses of single frames (not smoothed: their errors must be independent), `measured` the flights
    and impacts found in them. What the data do not carry is None in the result, with a message.
    Raises ValueError for a track whose columns do not fit together.
    """
    fit = _fit(track, measured, Physics(die, table, {"chi": 0.5}), intervals)
    rested = resting_face(track, die)
    return fit if rested is None else replace(fit, landed_face=rested)


def _fit(track: Track, measured: Throw, physics: Physics, intervals: IntervalMethod) -> Fit:
    free = fit_flights(sight(track, measured), measured)
    messages = frame_words(free)
    first = next((k for k, flight in enumerate(free.flights) if flight is not None), None)
    if first is None:
        return _nothing(messages, "no flight has two frames with a pose: neither the start nor chi can be determined.")
    if first > 0:
        messages.append(f"The fit begins after bounce {first}: the frames before it do not make a flight.")
    work = _Work(track, measured, free, first, intervals)
    if len(measured.flights) == first + 1:
        messages.append("chi cannot be determined: the track shows no bounce after the first flight.")
        return _unbounded(work, opening(free, first, physics), messages)
    if not can_go_on(free, first):
        messages.append("chi cannot be determined: no flight after the first bounce has two frames clear of impacts.")
        return _unbounded(work, opening(free, first, physics), messages)
    shots, ways, trials = _with_effects(work, physics)
    if not shots[0].vertices and shots[0].reached > first:
        messages.append("chi cannot be determined: the frames make one flight, through every bounce that was measured.")
        return _unbounded(work, shots[0], messages)
    if shots[0].reached == first:
        return _unexplained(work, shots[0], trials, messages)
    return _explained(work, shots, ways, trials, messages)


def _with_effects(work: _Work, physics: Physics) -> tuple[list[Shot], list[Shot], list[Trial]]:
    """The best shots with as many effects as pay, the ways in which friction makes the first of them, and the trials of
    the other effects."""
    shots = through_the_bounces(_openings(work, physics), work.measured, work.free)
    ways = shots[:1]
    trials = _trials(work, shots[0])
    for _ in range(_MOST_EFFECTS):
        longer = _best_with_one_more(work, shots, trials)
        if longer is None:
            break
        shots = _without_what_no_longer_pays(work, longer)
        ways = ways_of_friction(shots[0], work.free)
        shots = [ways[0], *shots[1:]]
        trials = _trials(work, shots[0])
    return shots, ways, trials


def _without_what_no_longer_pays(work: _Work, shots: list[Shot]) -> list[Shot]:
    """The shots without an effect that a later one has made needless."""
    needless = no_longer_pays(shots[0], work.free) if len(shots[0].physics.effects) > 1 else None
    if needless is None:
        return shots
    plainer = through_the_bounces(_openings(work, shots[0].physics.without_effect(needless)), work.measured, work.free)
    return plainer if plainer[0].reached >= shots[0].reached else shots


def _best_with_one_more(work: _Work, shots: list[Shot], trials: list[Trial]) -> list[Shot] | None:
    """The shots with the one effect, of those that pay, that leads through most bounces; None if none does.

    At one bounce a tilt of the table can pass for friction; at the next it no longer can. Where two lead equally far the
    one that gains more is taken.
    """
    best, found = (shots[0].reached - 1, 0.0), None
    for trial in sorted((t for t in trials if t.pays), key=lambda t: t.worth, reverse=True):
        assert trial.shot is not None
        longer = _led_through(work, trial.shot.physics)
        if longer[0].reached >= shots[0].reached and (longer[0].reached, trial.worth) > best:
            best, found = (longer[0].reached, trial.worth), longer
        if not can_go_on(work.free, best[0]) or (found is not None and at_its_limit(found[0])):
            break  # nothing can lead farther, and what follows gains less
    return found


def _led_through(work: _Work, physics: Physics) -> list[Shot]:
    """The shots from the first flight on; what was held at first is set free where the fit stops, and it goes on."""
    shots = through_the_bounces(_openings(work, physics), work.measured, work.free)
    k2 = loss_scale(work.free)
    while (held := shots[0].physics.held) and shots[0].vertices:
        freed = replace(shots[0].physics, held=held - {max(held)})
        wider = with_physics(shots[0], freed, k2)
        shots = through_the_bounces([shoot(wider.sightings, wider, wider.vertices, k2)], work.measured, work.free)
    return shots


def _trials(work: _Work, shot: Shot) -> list[Trial]:
    """Every effect that is not in use, tried on the frames explained so far and, where there is one, on the flight that
    is not."""
    if can_go_on(work.free, shot.reached) and not at_its_limit(shot):
        return try_effects_at_a_loss(shot, work.measured, work.free)
    return try_effects(shot, work.measured, work.free) if shot.vertices else []


def _openings(work: _Work, physics: Physics) -> list[Shot]:
    """The first flight alone, with several χ to begin with where no bounce says which."""
    starts = [0.55, 0.85, 0.25]
    if physics.effects:
        starts = [physics.values["chi"]]
    else:
        seen = work.bounces(physics.die, work.first, work.first + 1)
        starts = [bounce.chi for bounce in seen if bounce is not None and 0.02 < bounce.chi < 0.98] or starts
    return [opening(work.free, work.first, physics.with_values(chi=chi)) for chi in starts]


def _explained(work: _Work, shots: list[Shot], ways: list[Shot], trials: list[Trial], messages: list[str]) -> Fit:
    """The result of a fit through one bounce or more."""
    shot = shots[0]
    total, explained = len(work.measured.impacts) - work.first, shot.reached - work.first
    messages += bounce_words(shots, work.free, total, explained)
    variance, tau = shot.inflation
    messages += inflation_words(variance, tau)
    parameters = _parameters(ways, work, variance * tau, messages)
    covariance = shot.covariance * variance * tau
    throw = as_tracked(shot.physics, continued(shot.physics, shot.throw, float(work.track.time_s[-1])))
    face, odds, landing_words = landing_odds(shot.physics, shot.state, covariance, shot.vertices)
    return Fit(
        parameters=parameters,
        initial=shot.state,
        initial_covariance=covariance[:12, :12],
        chosen=_chosen(shot.physics),
        considered=_left_out(trials),
        bounces_fitted=explained,
        residual_rms=float(np.sqrt(shot.mean_square)),
        landed_face=face,
        face_odds=odds,
        messages=(*messages, *landing_words),
        throw=throw,
        restitution=shot.physics.restitution,
        covariance=covariance,
    )


def _unexplained(work: _Work, start: Shot, trials: list[Trial], messages: list[str]) -> Fit:
    """The result where no throw runs through the first bounce: the first flight, and χ from the bounces one by one."""
    attempt = best_attempt(start, work.measured, work.free)
    rms = None if attempt is None else float(np.sqrt(attempt.mean_square))
    worst = None if attempt is None else np.sqrt(max(mean_squares(attempt).values()))
    later = work.bounces(start.physics.die, start.reached)
    messages.append(missed_words(len(work.measured.impacts) - start.reached, worst, later))
    fit = replace(_unbounded(work, start, messages), considered=_left_out(trials), residual_rms=rms)
    common = common_restitution(later, level=LEVEL_OF_INTERVALS)
    if common is None:
        messages.append("chi cannot be determined: no bounce has two flights that fix its normal velocities.")
        return replace(fit, messages=tuple(messages))
    chi = _bounded(*common, bounds=(0.0, 1.0))
    if chi.value is None:
        messages.append(
            "chi cannot be determined: the ratios of normal velocities at the bounces contradict each other."
        )
        return replace(fit, messages=tuple(messages))
    count = sum(b is not None for b in later)
    messages.append(
        f"chi is the ratio of normal velocities at {count} bounce{'s' if count > 1 else ''}, which needs no law of "
        "impact; its interval includes their scatter."
    )
    physics = start.physics.with_values(chi=chi.value)
    throw = continued(physics, start.throw, float(work.track.time_s[-1]))
    return replace(fit, parameters={"chi": chi}, messages=tuple(messages), throw=throw)


def _unbounded(work: _Work, start: Shot, messages: Sequence[str]) -> Fit:
    """The result without any bounce: the first flight; χ stays unknown."""
    freedom = max(6 * len(start.sightings) - 12, 1)
    variance, tau = variance_inflation(start.residuals, freedom, start.sightings.flight)
    first = work.free.flights[start.reached]
    assert first is not None
    assert first.flight.covariance is not None
    return Fit(
        parameters={"chi": Parameter(None, None, None, None, True, False)},
        initial=start.state,
        initial_covariance=first.flight.covariance * variance * tau,
        chosen=_chosen(start.physics),
        considered=(),
        bounces_fitted=0,
        residual_rms=float(np.sqrt(start.mean_square)),
        landed_face=None,
        face_odds=None,
        messages=tuple(messages),
        throw=start.throw,
    )


def _nothing(messages: list[str], why: str) -> Fit:
    """The result where not even one flight is known."""
    unknown = Parameter(None, None, None, None, True, False)
    words = (*messages, why[:1].upper() + why[1:])
    return Fit({"chi": unknown}, None, None, (), (), 0, None, None, None, words, None)


def _chosen(physics: Physics) -> tuple[str, ...]:
    """The effects in the model, those that the scene states among them."""
    law = () if "friction" in physics.effects else ("smooth impact",)
    rounded = ("rounded corners",) if physics.body.corner_radius_m > 0.0 else ()
    moving = ("oscillating table",) if physics.plane.moves else ()
    listed = ("rounded corners", "oscillating table")
    return (*law, *rounded, *moving, *(name for name in physics.effects if name not in listed))


def _left_out(trials: list[Trial]) -> tuple[Effect, ...]:
    """The effects that did not pay."""
    return tuple(trial.in_words for trial in trials if not trial.pays)


def _parameters(ways: list[Shot], work: _Work, scale: float, messages: list[str]) -> dict[str, Parameter]:
    """Every free parameter with its interval, which holds those of all ways to make the throw; None, and a message, where
    the data leave all of its range open."""
    found, shot = {}, ways[0]
    covariance, drawn = shot.covariance * scale, {}
    if work.intervals == "bootstrap":
        drawn = bootstrap_intervals(shot, loss_scale(work.free), level=LEVEL_OF_INTERVALS)
    for k, name in enumerate(shot.physics.free, start=12):
        sigma = float(np.sqrt(covariance[k, k]))
        value, bounds = shot.physics.values[name], shot.physics.bounds(name)
        if work.intervals == "profile":
            ends = [_profile(way, name, ways[0], scale, work.free) for way in ways]
            low, high = min(end[0] for end in ends), max(end[1] for end in ends)
        else:
            low, high = drawn.get(name, (value - _Z * sigma, value + _Z * sigma))
        found[name] = _bounded(value, low, high, bounds=bounds, near=0.01 * sigma)
        if found[name].value is None:
            messages.append(
                f"{name} cannot be determined: every value from {bounds[0]:g} to {bounds[1]:g} agrees with the frames."
            )
    return found


def _profile(shot: Shot, name: str, best: Shot, scale: float, free: FreeFlights) -> tuple[float, float]:
    """The interval of one parameter from the profile of the likelihood about a shot that is as good as the best."""
    k2 = loss_scale(free)
    least = best.cost(k2)
    column = shot.covariance[:, 12 + shot.physics.free.index(name)]
    variance = column[12 + shot.physics.free.index(name)]
    along, sigma = column / variance, float(np.sqrt(variance * scale))

    def excess(value: float) -> float:
        # All else where a straight valley would have it: from the fit itself the way leads round bends of a valley a
        # thousand times longer than wide, in which a descent may stop.
        x = along * (value - shot.physics.values[name])
        start = replace(shot, state=moved_state(shot.state, x[:12]), physics=shot.physics.moved(x[12:]))
        return (_settled(with_physics(start, start.physics.holding(name, value), k2), k2) - least) / scale

    value, bounds = shot.physics.values[name], shot.physics.bounds(name)
    return profile_interval(value, sigma, bounds, excess, level=LEVEL_OF_INTERVALS)


def _settled(shot: Shot, k2: float) -> float:
    """The cost where shooting on from a shot no longer lowers it: each begins with the scales of where the last ended."""
    cost = np.inf
    for _ in range(_MOST_SHOTS):
        shot = shoot(shot.sightings, shot, shot.vertices, k2)
        before, cost = cost, shot.cost(k2)
        if before - cost < _SETTLED:
            break
    return cost


def _bounded(value: float, low: float, high: float, *, bounds: tuple[float, float], near: float = 0.0) -> Parameter:
    """A parameter kept within its bounds; one beyond a bound, or within `near` of it, stands on it."""
    if low <= bounds[0] and high >= bounds[1]:
        return Parameter(None, None, None, None, True, False)
    value = bounds[0] if value <= bounds[0] + near else bounds[1] if value >= bounds[1] - near else value
    low, high = float(np.clip(low, bounds[0], value)), float(np.clip(high, value, bounds[1]))
    return Parameter(value, low, high, LEVEL_OF_INTERVALS, True, value in bounds)
