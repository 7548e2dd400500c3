"""Fit of a whole throw: χ, the twelve initial conditions, and the effects that the throw shows.

A weighted least-squares fit to the poses of all frames (`FlightObservations`), through as many bounces as the model explains
(`extension`), with no more physics than the evidence supports (`effects`). What a track does not determine is None in the
result, with a message that says why.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.errors import InputError
from ...model.laws import Table
from ...model.throw import Throw
from ...tracking.flights import perturbed
from ...tracking.track import Track
from ..estimation import flight_observations, normal_quantile, profile_interval
from ..free import Bounce, FreeFlights, common_restitution, fit_flights, measure_bounces
from ..results import USUAL_CHOICES, Choices, Effect, Fit, Parameter
from .bootstrap import bootstrap_intervals
from .clock_and_scale import as_tracked
from .effects import EFFECTS, Trial, superseded_effect, try_effects, try_effects_on_next_flight
from .extension import (
    at_its_limit,
    best_attempt,
    can_go_on,
    definitions_differ,
    extend_through_bounces,
    friction_alternatives,
)
from .landing import continued, landing_odds, resting_face
from .messages import (
    bounce_messages,
    frame_messages,
    inflation_messages,
    ratio_message,
    restitution_messages,
    shared_error_messages,
    unexplained_message,
)
from .physics import Physics, table_under
from .shared_errors import variance_shares
from .shooting import (
    Trajectory,
    first_flight_trajectory,
    if_known_exactly,
    inflated_covariance,
    linearised,
    mean_squares,
    refitted,
    refitted_with,
    weighted_as_inflated,
    with_physics,
)

Array = NDArray[np.float64]

INTERVAL_LEVEL = 0.95

_START_CHI = 0.5
"""χ before any bounce is measured."""

_FIRST_CHI = (0.55, 0.85, 0.25)
"""χ of the first trajectories where no single bounce measures it: every χ lies within 0.25 of one of them."""

_PLAUSIBLE_CHI = (0.02, 0.98)
"""Bounds of a χ measured at one bounce from which a fit starts: at 0 and 1 it would start on a bound."""

_MAX_REFITS = 6
"""Refits of one point of a profile."""

_REFIT_TOLERANCE = 0.02
"""Fall of the cost that ends them: a hundredth of what decides an interval."""

_LEAST_PROFILE = 0.1
"""Width of a profile interval, as a share of that from the covariance, below which the latter counts. A contact that a throw only
just makes is lost as soon as a parameter moves. The cost then jumps by thousands, and says nothing of what frames determine."""

_AT_BOUND_SIGMAS = 0.01
"""Distance from a bound, in standard errors, within which a value is put on it."""

_MAX_EFFECTS = 4
"""Effects added, one after the other; more than any scene has been seen to show."""


@dataclass(frozen=True, eq=False)
class _Task:
    """What a fit has before it looks at any bounce."""

    track: Track
    measured: Throw
    free: FreeFlights
    first: int
    """The first flight with two frames."""

    def bounces(self, die: Die, begin: int, end: int | None = None) -> tuple[Bounce | None, ...]:
        """The measured impacts from `begin` up to `end`, each measured by the flights on either side."""
        return measure_bounces(die, self.free, self.measured.impacts, begin, end)

    def frames_beside(self, bounce: int) -> str:
        """The frames of the flights before and after a bounce, in words."""
        beside = np.isin(self.measured.flights_at(self.track.time_s), (bounce, bounce + 1)) & self.track.tracked
        frames = self.track.frame[beside]
        return f"frames {frames.min()} to {frames.max()}"


def fit_throw(
    track: Track, measured: Throw, die: Die, table: Table | None = None, choices: Choices = USUAL_CHOICES
) -> Fit:
    """χ and the initial conditions of a tracked throw, with intervals, from all bounces that the model explains.

    `track` holds the poses of single frames (not smoothed: their errors must be independent), `measured` the flights
    and impacts found in them. What the data do not determine is None in the result, with a message.
    Without a `table` it is level and at rest. Raises ValueError if the columns of the track have different lengths, and for a
    table that stands where gravity is another than the track's, and for effects on trial that are none.
    """
    unknown = [name for name in choices.effects or () if name not in EFFECTS]
    if unknown:
        raise InputError(f"effects: {unknown[0]!r} is none; wanted some of {', '.join(EFFECTS)}")
    physics = Physics(die, table_under(track, table), {"chi": _START_CHI})
    fit = replace(_fit(track, measured, physics, choices), choices=choices)
    rested = resting_face(track, die)
    return fit if rested is None else replace(fit, landed_face=rested)


def _fit(track: Track, measured: Throw, physics: Physics, choices: Choices) -> Fit:
    free = fit_flights(flight_observations(track, measured), measured, choices)
    messages = frame_messages(free)
    first = next((k for k, flight in enumerate(free.flights) if flight is not None), None)
    if first is None:
        messages.append("Neither the initial state nor chi can be determined: no flight has two frames with a pose.")
        return _empty_result(messages)
    if first > 0:
        messages.append(f"The fit begins after bounce {first}: the frames before it do not make a flight.")
    task = _Task(track, measured, free, first)
    if len(measured.flights) == first + 1:
        messages.append("chi cannot be determined: the track shows no bounce after the first flight.")
        return _first_flight_result(task, first_flight_trajectory(free, first, physics), messages)
    if not can_go_on(free, first):
        messages.append("chi cannot be determined: no flight after the first bounce has two frames clear of impacts.")
        return _first_flight_result(task, first_flight_trajectory(free, first, physics), messages)
    trajectories, alternatives, trials = _with_effects(task, physics)
    best = trajectories[0]
    if not best.vertices and best.reached > first:
        messages.append("chi cannot be determined: one flight without impact fits the frames of all measured flights.")
        return _first_flight_result(task, best, messages)
    if best.reached == first:
        return _result_without_law(task, best, trials, messages)
    return _result_with_bounces(task, trajectories, alternatives, trials, messages)


def _with_effects(task: _Task, physics: Physics) -> tuple[list[Trajectory], list[Trajectory], list[Trial]]:
    """The best trajectories with all accepted effects, the friction alternatives to the first of them, and the trials of the
    other effects."""
    trajectories = _from_first_flight(task, physics)
    alternatives = trajectories[:1]
    trials = _trials(task, trajectories[0])
    for _ in range(_MAX_EFFECTS):
        longer = _best_with_one_more(task, trajectories, trials)
        if longer is None:
            break
        trajectories, followed = _by_the_definition_that_leads_farthest(task, _without_superseded(task, longer))
        alternatives = friction_alternatives(trajectories[0], task.free, by_every_definition=True, followed=followed)
        trajectories = [alternatives[0], *trajectories[1:]]
        trials = _trials(task, trajectories[0])
    return trajectories, alternatives, trials


def _by_the_definition_that_leads_farthest(
    task: _Task, trajectories: list[Trajectory]
) -> tuple[list[Trajectory], list[Trajectory]]:
    """The trajectories by the definition of restitution that explains most bounces, and the best by each other definition that
    explains as many.

    Each is extended from the first flight: a throw of several bounces is lost before a descent leads from the χ of one definition
    to that of another.
    """
    physics = trajectories[0].physics
    if not definitions_differ(trajectories[0], task.free):
        return trajectories, []
    others = [_from_first_flight(task, kind) for kind in physics.with_other_restitutions()]
    farthest = max([trajectories, *others], key=lambda found: found[0].reached)
    followed = [found[0] for found in (trajectories, *others) if found is not farthest]
    return farthest, [one for one in followed if one.reached == farthest[0].reached]


def _from_first_flight(task: _Task, physics: Physics) -> list[Trajectory]:
    """The best trajectories through all bounces that the model explains, extended from the first flight."""
    return extend_through_bounces(_first_flight_trajectories(task, physics), task.measured, task.free)


def _without_superseded(task: _Task, trajectories: list[Trajectory]) -> list[Trajectory]:
    """The trajectories without an effect that a later one has made needless."""
    physics = trajectories[0].physics
    needless = superseded_effect(trajectories[0], task.free) if len(physics.effects) > 1 else None
    if needless is None:
        return trajectories
    plainer = _from_first_flight(task, physics.without_effect(needless))
    return plainer if plainer[0].reached >= trajectories[0].reached else trajectories


def _best_with_one_more(task: _Task, trajectories: list[Trajectory], trials: list[Trial]) -> list[Trajectory] | None:
    """The trajectories with the accepted effect that leads through most bounces; None without one.

    At one bounce a tilt of the table can pass for friction; at the next it no longer can. If two effects lead equally far,
    the one that gains more is taken.
    """
    best, found = (trajectories[0].reached - 1, 0.0), None
    accepted = [trial for trial in trials if trial.is_accepted]
    unit = min((trial.unexplained for trial in accepted), default=1.0)
    for trial in sorted(accepted, key=lambda t: t.net_gain(unit), reverse=True):
        assert trial.trajectory is not None
        longer, gain = _with_held_freed(task, trial.trajectory.physics), trial.net_gain(unit)
        if longer[0].reached >= trajectories[0].reached and (longer[0].reached, gain) > best:
            best, found = (longer[0].reached, gain), longer
        if not can_go_on(task.free, best[0]) or (found is not None and at_its_limit(found[0])):
            break  # no other effect can lead farther, and those that follow gain less
    return found


def _with_held_freed(task: _Task, physics: Physics) -> list[Trajectory]:
    """The trajectories from the first flight on; where the fit stops, a held parameter is freed and the fit continues."""
    trajectories = _from_first_flight(task, physics)
    k2 = task.free.huber_threshold
    while (held := trajectories[0].physics.held) and trajectories[0].vertices:
        freed = replace(trajectories[0].physics, held=held - {max(held)})
        trajectories = extend_through_bounces([refitted_with(trajectories[0], freed, k2)], task.measured, task.free)
    return trajectories


def _trials(task: _Task, trajectory: Trajectory) -> list[Trial]:
    """Every effect that is not in use, tried on the frames explained so far and, where there is one, on the flight that
    is not explained."""
    if can_go_on(task.free, trajectory.reached) and not at_its_limit(trajectory):
        return try_effects_on_next_flight(trajectory, task.measured, task.free)
    return try_effects(trajectory, task.measured, task.free) if trajectory.vertices else []


def _first_flight_trajectories(task: _Task, physics: Physics) -> list[Trajectory]:
    """The first flight alone, with the χ of the first bounce, or with several where that is not measured."""
    if physics.effects:
        starts: Sequence[float] = [physics.values["chi"]]
    else:
        low, high = _PLAUSIBLE_CHI
        bounces = task.bounces(physics.die, task.first, task.first + 1)
        starts = [bounce.chi for bounce in bounces if bounce is not None and low < bounce.chi < high] or _FIRST_CHI
    return [first_flight_trajectory(task.free, task.first, physics.with_values(chi=chi)) for chi in starts]


def _result_with_bounces(
    task: _Task,
    trajectories: list[Trajectory],
    alternatives: list[Trajectory],
    trials: list[Trial],
    messages: list[str],
) -> Fit:
    """The result of a fit through one bounce or more."""
    alternatives = [weighted_as_inflated(one, task.free.huber_threshold) for one in alternatives]
    best = trajectories[0] = alternatives[0]
    total, explained = len(task.measured.impacts) - task.first, best.reached - task.first
    beside = task.frames_beside(best.reached) if explained < total else ""
    messages += bounce_messages(trajectories, task.free, (explained, total), beside)
    messages += inflation_messages(best.errors)
    messages += restitution_messages(alternatives)
    parameters = _parameters(alternatives, task, messages)
    covariance = inflated_covariance(best, task.free.huber_threshold)
    shares = _variance_shares(best, tuple(parameters), task.free.huber_threshold, covariance)
    if shares:
        exact = if_known_exactly(best, task.free.huber_threshold).covariance
        messages += shared_error_messages(shares, float(np.sqrt(best.covariance[12, 12] / exact[12, 12])))
    throw = as_tracked(best.physics, continued(best.physics, best.throw, float(task.track.time_s[-1])))
    face, odds, landing_messages = landing_odds(best.physics, best.state, covariance, best.vertices)
    return Fit(
        parameters=parameters,
        initial=best.state,
        initial_covariance=covariance[:12, :12],
        chosen=_chosen(best.physics),
        considered=_refused(trials),
        bounces_fitted=explained,
        residual_rms=float(np.sqrt(best.mean_square)),
        landed_face=face,
        face_odds=odds,
        messages=(*messages, *landing_messages),
        throw=throw,
        restitution=best.physics.restitution,
        covariance=covariance,
        variance_shares=shares,
        vertices=best.vertices,
        fitted_until_s=best.physics.clock * float(best.observations.time_s.max()),
    )


def _result_without_law(task: _Task, start: Trajectory, trials: list[Trial], messages: list[str]) -> Fit:
    """The result where no trajectory explains the first bounce: the first flight, and χ from single bounces."""
    attempt = best_attempt(start, task.measured, task.free)
    rms = None if attempt is None else float(np.sqrt(attempt.mean_square))
    worst = None if attempt is None else np.sqrt(max(mean_squares(attempt).values()))
    later = task.bounces(start.physics.die, start.reached)
    total = len(task.measured.impacts) - start.reached
    messages.append(unexplained_message(total, worst, later, task.frames_beside(start.reached)))
    fit = replace(_first_flight_result(task, start, messages), considered=_refused(trials), residual_rms=rms)
    common = common_restitution(later, level=INTERVAL_LEVEL)
    chi = None if common is None else _bounded(*common, bounds=(0.0, 1.0))
    messages.append(ratio_message(common, chi, sum(bounce is not None for bounce in later)))
    if chi is None or chi.value is None:
        return replace(fit, messages=tuple(messages))
    throw = continued(start.physics.with_values(chi=chi.value), start.throw, float(task.track.time_s[-1]))
    return replace(fit, parameters={"chi": chi}, messages=tuple(messages), throw=throw)


def _first_flight_result(task: _Task, start: Trajectory, messages: Sequence[str]) -> Fit:
    """The result without any bounce: the first flight; χ stays unknown."""
    first = task.free.flights[start.reached]
    assert first is not None
    assert first.flight.covariance is not None
    return Fit(
        parameters={"chi": _UNKNOWN},
        initial=start.state,
        initial_covariance=first.flight.covariance * start.errors.scale,
        chosen=_chosen(start.physics),
        considered=(),
        bounces_fitted=0,
        residual_rms=float(np.sqrt(start.mean_square)),
        landed_face=None,
        face_odds=None,
        messages=tuple(messages),
        throw=start.throw,
        fitted_until_s=start.physics.clock * float(start.observations.time_s.max()),
    )


def _empty_result(messages: list[str]) -> Fit:
    """The result where not even one flight is known."""
    return Fit({"chi": _UNKNOWN}, None, None, (), (), 0, None, None, None, tuple(messages), None)


def _chosen(physics: Physics) -> tuple[str, ...]:
    """The effects in the model, with those that the scene states."""
    law = () if "friction" in physics.effects else ("smooth impact",)
    rounded = ("rounded corners",) if physics.body.corner_radius_m > 0.0 else ()
    moving = ("oscillating table",) if physics.plane.moves else ()
    listed = ("rounded corners", "oscillating table")
    return (*law, *rounded, *moving, *(name for name in physics.effects if name not in listed))


def _refused(trials: list[Trial]) -> tuple[Effect, ...]:
    """The effects that were not accepted."""
    return tuple(trial.as_effect for trial in trials if not trial.is_accepted)


def _parameters(alternatives: list[Trajectory], task: _Task, messages: list[str]) -> dict[str, Parameter]:
    """Every free parameter; a message for each that the data leave open."""
    physics = alternatives[0].physics
    found = parameters_of(alternatives, task.free)
    for name in (name for name, parameter in found.items() if parameter.value is None):
        low, high = physics.bounds(name)
        messages.append(f"{name} cannot be determined: every value from {low:g} to {high:g} agrees with the frames.")
    return found


def parameters_of(
    alternatives: list[Trajectory], free: FreeFlights, wanted: Sequence[str] | None = None
) -> dict[str, Parameter]:
    """The free parameters of a fit, or those that are wanted, each with an interval that covers those of all trajectories which
    fit as well as the first; a value of None where the frames leave all of its range open."""
    best, found = alternatives[0], {}
    covariance = inflated_covariance(best, free.huber_threshold)
    drawn, z = {}, normal_quantile(INTERVAL_LEVEL)
    if free.choices.intervals == "bootstrap":
        drawn = bootstrap_intervals(best, free.huber_threshold, level=INTERVAL_LEVEL)
    for k, name in enumerate(best.physics.free, start=12):
        if wanted is not None and name not in wanted:
            continue
        sigma, scale = float(np.sqrt(covariance[k, k])), float(covariance[k, k] / best.covariance[k, k])
        value, bounds = best.physics.values[name], best.physics.bounds(name)
        if free.choices.intervals == "profile":
            ends = [_profile(one, name, best, scale, free) for one in alternatives]
            low, high = min(end[0] for end in ends), max(end[1] for end in ends)
        else:
            low, high = drawn.get(name, (value - z * sigma, value + z * sigma))
        found[name] = _bounded(value, low, high, bounds=bounds, near=_AT_BOUND_SIGMAS * sigma)
    return found


def _variance_shares(
    best: Trajectory, names: tuple[str, ...], k2: float, covariance: Array
) -> dict[str, dict[str, float]]:
    """What each parameter's variance in `covariance` comes from: the stated errors of the frames (`noise`), the sources of shared
    errors, and what the residuals show beyond all of these (`impact law`). Empty where frames share no error."""
    by_source = variance_shares(best.observations, linearised(best, k2), best.covariance)
    found = {}
    for k, name in enumerate(names, start=12) if by_source else ():
        stated = float(best.covariance[k, k] / covariance[k, k])
        own = {
            source: best.observations.shared_weight * stated * float(shares[k]) for source, shares in by_source.items()
        }
        noise = stated * max(0.0, 1.0 - sum(float(shares[k]) for shares in by_source.values()))
        # Frames that are better than stated leave their covariance as it is, and the sum above 1.
        sum_of_all = max(1.0, noise + sum(own.values()))
        parts = {source: share / sum_of_all for source, share in {"noise": noise, **own}.items()}
        found[name] = {**parts, "impact law": 1.0 - sum(parts.values())}
    return found


def _profile(
    trajectory: Trajectory, name: str, best: Trajectory, scale: float, free: FreeFlights
) -> tuple[float, float]:
    """The interval of one parameter from the profile likelihood about a trajectory that fits as well as the best."""
    k2 = free.huber_threshold
    least = best.cost(k2)
    k = 12 + trajectory.physics.free.index(name)
    column = trajectory.covariance[:, k]
    along, sigma = column / column[k], float(np.sqrt(column[k] * scale))

    def excess(value: float) -> float:
        # All other unknowns start where a straight valley would have them. From the fit itself, a descent would have to
        # follow the bends of a valley a thousand times longer than wide, and may stop there.
        x = along * (value - trajectory.physics.values[name])
        displaced = replace(
            trajectory, state=perturbed(trajectory.state, x[:12]), physics=trajectory.physics.moved(x[12:])
        )
        return (
            _converged_cost(with_physics(displaced, displaced.physics.holding(name, value), k2), k2) - least
        ) / scale

    value, bounds = trajectory.physics.values[name], trajectory.physics.bounds(name)
    low, high = profile_interval(value, sigma, bounds, excess, level=INTERVAL_LEVEL)
    wide = normal_quantile(INTERVAL_LEVEL) * sigma
    if high - low < _LEAST_PROFILE * 2.0 * wide and low > bounds[0] and high < bounds[1]:
        return max(bounds[0], value - wide), min(bounds[1], value + wide)
    return low, high


def _converged_cost(trajectory: Trajectory, k2: float) -> float:
    """The cost at which refits no longer lower it: each starts with the information of the one before."""
    cost = np.inf
    for _ in range(_MAX_REFITS):
        trajectory = refitted(trajectory, k2)
        before, cost = cost, trajectory.cost(k2)
        if before - cost < _REFIT_TOLERANCE:
            break
    return cost


_UNKNOWN = Parameter(None, None, None, None, True, False)
"""A free parameter that the data do not determine."""


def _bounded(value: float, low: float, high: float, *, bounds: tuple[float, float], near: float = 0.0) -> Parameter:
    """A parameter kept within its bounds; a value beyond a bound, or within `near` of it, is put on it."""
    if low <= bounds[0] and high >= bounds[1]:
        return _UNKNOWN
    value = bounds[0] if value <= bounds[0] + near else bounds[1] if value >= bounds[1] - near else value
    low, high = float(np.clip(low, bounds[0], value)), float(np.clip(high, value, bounds[1]))
    return Parameter(value, low, high, INTERVAL_LEVEL, True, value in bounds)
