"""The contact between two flights: an impact at a vertex, any other jump, several contacts, or none.

Neighbouring flights are joined at one instant each and fitted together (`flight_chain`): first with free jumps, then with impacts
at the vertex that explains each best, under the conditions of an impact. The shared errors (`shared_bias`) and the error model of
the frames (`error_model`) are estimated on the way. A link that no single impact explains may be a cluster of contacts within
some frames (`contact_clusters`); if these cannot be separated either, it stays open. If the motion before it, continued, stays
clear of the table, nothing was struck: such an impact is spurious and is removed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, inner_vertices
from ...model.rotations import angle_between
from ...model.throw import Flight, State
from ..covariance import scaled_inverse
from ..flights import (
    JOINT,
    ErrorModel,
    FlightChain,
    Link,
    VertexImpact,
    WeightedPoses,
    estimate_error_model,
    fit_chain,
    fit_flight,
    rms_residuals,
    vertex_impact_cost,
)
from .contact_clusters import instant_limit_s, resolve_cluster
from .flight_segmentation import MIN_FRAMES, contact_reach_m
from .rest import lowest_heights_m

Array = NDArray[np.float64]

OPEN_RATIO = 5.0
"""Residual of the frames beside a link, over the usual one, from which no single instant joins its flights."""
FAULTY_RATIO = 2.0
"""The same for a link that does not look like an impact either."""
ENOUGH_FRAMES_OF_FLIGHT = 40
"""Frames of each flight that suffice to judge a contact between them."""
FRAMES_BESIDE_LINK = 4
"""Frames on either side of a link whose residuals judge it."""
GROSS_RAD = 0.2
"""Angle [rad] between two flights at their nearest from which they are not joined at one instant."""
GROSS_CIRCUMRADII = 0.3
"""Distance between two flights at their nearest, in circumradii, from which they are not joined at one instant."""
OUTLIER_RATIO = 5.0
"""Residual of a frame, over the median of its flight, from which it is left out of the flight's own fit."""
LEAST_USUAL_SIGMAS = 0.5
"""Least usual residual [sigmas]: frames with overstated sigmas lie nearer than one sigma."""
TURN_LENGTH_M = 5e-3
"""Length [m] that an angle of one radian counts as, where the nearest approach of two motions is looked for."""
MAX_IMPACT_COST = 40.0
"""Squared sigmas over its four conditions beyond which a contact is no impact at one point: chi-square exceeds 18 in a thousandth
of the cases; correlated errors of the frames account for the rest."""
MAX_FIRST_ORDER_COST = 1000.0
"""Squared sigmas to first order beyond which an impact is not fitted at all: the neglected curvature of the flights within the
uncertainty of the instant amounts to some tens."""
LEAST_GAIN = 25.0
"""Least squared sigmas that a link must explain. It has seven parameters, three of which the conditions leave free; chance gives
those more than that once in 70 000 cases, and a clip has fewer places for a link than that."""
PENALTY = LEAST_GAIN / 3.0
"""The same for each free parameter, where chains are compared."""
IMPACT_CONDITIONS = 4
"""Parameters of a link that the conditions of an impact determine."""
PLAIN_FACTOR = 4.0
"""A link that explains this many times LEAST_GAIN to first order needs no trial without it."""
KNOWN_FLIGHT_SHARE = 0.7
"""Least share of its frames that lie on a flight which counts as known."""
LIKELY_COST = 9.5
"""Squared sigmas that four conditions cost by chance in one case of twenty."""
REBOUND_SIGMAS = 2.0
"""Standard errors by which a normal velocity may have the wrong sign and still be that of a rebound."""
NEAR_SHARE = 0.1
"""Height above the lowest vertex, as a share of the spread of heights, up to which a vertex may be the one that strikes."""
CLEAR_SHARE = 0.03
"""Height above the table, as a share of an edge, from which a motion has touched nothing."""
TOUCH_SAMPLES = 200
"""Instants at which the height of a motion is evaluated to find its first touch: some twenty frames at most lie between."""
CLEAR_SAMPLES = 24
"""Instants at which the height of a motion behind an open link is evaluated."""
UNKNOWN_TABLE_M = 3e-3
"""Prior standard deviation [m] of the table's height if poses come without a camera, and with its depth error: half a per cent of
the distance."""
SAME_INSTANT_FRAMES = 1e-3
"""Contacts nearer in time than this, in frames, are one: no instant is known as well."""
INCONSISTENT_SIGMAS = 5.0
"""Deviation of a shared parameter, in units of its prior, that shows a calibration worse than assumed."""
INLIER_WEIGHT = 0.5
"""Weight from which a frame counts as lying on its flight."""


@dataclass(frozen=True, eq=False)
class _Part:
    """A flight fitted by itself."""

    rows: NDArray[np.int64]
    residual: Array
    """(n,) distance of its frames, in sigmas."""
    inliers: NDArray[np.int64]
    """Its rows without outliers."""
    state: State
    """Of the inliers."""

    @staticmethod
    def of(observations: WeightedPoses, rows: NDArray[np.int64]) -> _Part:
        """The flight through some rows."""
        state, _, _ = fit_flight(observations.rows(rows))
        residual = rms_residuals(observations.rows(rows), state)
        inliers = rows[residual < OUTLIER_RATIO * max(float(np.median(residual)), LEAST_USUAL_SIGMAS)]
        if not MIN_FRAMES <= len(inliers) < len(rows):
            return _Part(rows, residual, rows, state)
        return _Part(rows, residual, inliers, fit_flight(observations.rows(inliers))[0])

    @property
    def span(self) -> tuple[int, int]:
        """Its first row and its last."""
        return int(self.rows[0]), int(self.rows[-1])


def join_flights(observations: WeightedPoses, parts: list[NDArray[np.int64]], die: Die) -> FlightChain:
    """All flights fitted together, given the rows of each.

    Links that one instant cannot explain are open. Each link is judged on its own two flights, because one that is joined wrongly
    spoils the fit of all. Links that cannot be impacts are removed, of neighbours the weaker first. Open links stay, since one
    motion through both flights would be neither.
    """
    judged: dict[tuple[tuple[int, int], tuple[int, int]], float] = {}
    alone = [_Part.of(observations, rows) for rows in parts]
    while True:
        ratios = []
        for a, b in itertools.pairwise(alone):
            pair = a.span, b.span
            if pair not in judged:
                is_gross = _are_far_apart(observations, a, b, die)
                judged[pair] = np.inf if is_gross else _residual_ratio(observations, a, b)
            ratios.append(judged[pair])
        opened = [ratio > OPEN_RATIO for ratio in ratios]
        chain = _fit_parts(observations, alone, opened)
        impossible = [not o and not can_be_impact(observations, chain, k, die) for k, o in enumerate(opened)]
        faulty = [bad and ratio > FAULTY_RATIO for bad, ratio in zip(impossible, ratios, strict=True)]
        if any(faulty):
            # Several contacts taken for one need not look like an impact; the misfit of a single instant shows them.
            opened = [o or bad for o, bad in zip(opened, faulty, strict=True)]
            chain = _fit_parts(observations, alone, opened)
        jumps = {
            k: _jump(chain, k, die)
            for k, o in enumerate(opened)
            if not o and not can_be_impact(observations, chain, k, die)
        }
        if not jumps:
            return chain
        weakest = {k for k, jump in jumps.items() if jump <= min(jumps.get(j, np.inf) for j in (k - 1, k + 1))}
        merged = [alone[0]]
        for k, part in enumerate(alone[1:]):
            if k in weakest:
                merged[-1] = _Part.of(observations, np.concatenate([merged[-1].rows, part.rows]))
            else:
                merged.append(part)
        alone = merged


def _are_far_apart(observations: WeightedPoses, a: _Part, b: _Part, die: Die) -> bool:
    """Whether two flights, each fitted alone, come nowhere near each other: several contacts lie between them, or the track was
    lost and resumed with another labelling. Joining them would spoil both."""
    before, after = observations.flight(a.state), observations.flight(b.state)
    t = _nearest_approach(before, after, float(observations.time_s[a.rows[-1]]), float(observations.time_s[b.rows[0]]))
    p, q = before.at(t), after.at(t)
    angle = float(angle_between(p.quaternion, q.quaternion))
    distance = float(np.linalg.norm(p.position_m - q.position_m))
    return angle > GROSS_RAD or distance > GROSS_CIRCUMRADII * die.solid.circumradius


def _residual_ratio(observations: WeightedPoses, before: _Part, after: _Part) -> float:
    """Residual of the frames beside a contact from two flights joined at one instant, over the usual residual. The worst frame is
    left out: the contact may lie within its exposure."""
    enough = ENOUGH_FRAMES_OF_FLIGHT
    a = before if len(before.rows) <= enough else _Part.of(observations, before.rows[-enough:])
    b = after if len(after.rows) <= enough else _Part.of(observations, after.rows[:enough])
    chain = _fit_parts(observations, [a, b], [False], observations.rows(np.concatenate([a.rows, b.rows])))
    usual = float(np.median(np.concatenate([a.residual, b.residual])))
    near = slice(max(len(a.rows) - FRAMES_BESIDE_LINK, 0), len(a.rows) + FRAMES_BESIDE_LINK)
    beside = chain.errors.scale[0] * chain.residual[near]
    return float(np.mean(np.sort(beside)[:-1])) / max(usual, LEAST_USUAL_SIGMAS)


def can_be_impact(observations: WeightedPoses, chain: FlightChain, k: int, die: Die) -> bool:
    """Whether a link is what a table does to a die: it pushes upwards, on a corner near the table that came down before and goes
    up after. Slow drifts of the pose, as marks and shading move over the edges, do none of this.

    A weak impact may do so within its errors only: the corner of a fast die accelerates at 1500 m/s², and within the uncertainty
    of the instant changes its speed by as much as a weak impact does. Then the jumps of velocity and spin together must be those
    of an impact at one corner, which no drift has by chance."""
    t = float(chain.link_times_s[k])
    a, b = chain.flights[k].at(t), chain.flights[k + 1].at(t)
    arms = die.solid.vertices @ a.rotation.T
    low = int(np.argmin(arms[:, 2]))
    is_low = abs(arms[low, 2] + a.position_m[2]) <= contact_reach_m(die)
    if not is_low or b.velocity_m_s[2] <= a.velocity_m_s[2]:
        return False
    if normal_velocity(a, arms[low]) < 0.0 < normal_velocity(b, arms[low]):
        return True
    if chain.sigma_time_s[k] > instant_limit_s(observations.time_s):
        return False
    return any(
        vertex_impact_cost(chain, k, impact, UNKNOWN_TABLE_M) < MAX_IMPACT_COST and _can_rebound(chain, k, impact)
        for impact in _lowest(chain, k, vertex_impacts(die))
    )


def _can_rebound(chain: FlightChain, k: int, impact: VertexImpact) -> bool:
    """Whether the contact came down before and goes up after, within REBOUND_SIGMAS."""
    t = float(chain.link_times_s[k])
    a, b = chain.flights[k].at(t), chain.flights[k + 1].at(t)
    arm = impact.arm(a.rotation)
    rows = normal_velocity_jacobian(a, b, arm, chain.flights[k].gravity_m_s2)
    sigma = np.sqrt(np.maximum(np.diag(rows @ chain.joint_covariance[k] @ rows.T), 0.0))
    return normal_velocity(a, arm) < REBOUND_SIGMAS * sigma[0] and normal_velocity(b, arm) > -REBOUND_SIGMAS * sigma[1]


def _jump(chain: FlightChain, k: int, die: Die) -> float:
    """Size [m/s] of the change of motion at a link, at the die's surface."""
    t = float(chain.link_times_s[k])
    a, b = chain.flights[k].at(t), chain.flights[k + 1].at(t)
    spin = die.solid.circumradius * np.linalg.norm(b.omega_rad_s - a.omega_rad_s)
    return float(np.linalg.norm(b.velocity_m_s - a.velocity_m_s) + spin)


def _fit_parts(
    observations: WeightedPoses, parts: list[_Part], opened: list[bool], fitted: WeightedPoses | None = None
) -> FlightChain:
    """The joint fit of all frames, or of those given, from each flight's own fit."""
    links = []
    for before, after, is_open in zip(parts[:-1], parts[1:], opened, strict=True):
        if is_open:
            # Between the inliers of both flights; no single instant exists.
            t = 0.5 * float(observations.time_s[before.inliers[-1]] + observations.time_s[after.inliers[0]])
        else:
            low, high = float(observations.time_s[before.rows[-1]]), float(observations.time_s[after.rows[0]])
            t = _nearest_approach(observations.flight(before.state), observations.flight(after.state), low, high)
        links.append(Link(t, is_open))
    return fit_chain(observations if fitted is None else fitted, [part.state for part in parts], links)


def _nearest_approach(before: Flight, after: Flight, low_s: float, high_s: float) -> float:
    """The instant near [low, high] at which two motions come closest, angles counting as TURN_LENGTH_M a radian."""
    duration = max(high_s - low_s, 1e-9)
    times = np.linspace(low_s - 1.0 * duration, high_s + 1.0 * duration, 121)
    pa, qa = before.poses(times)
    pb, qb = after.poses(times)
    distance = np.linalg.norm(pa - pb, axis=1) + TURN_LENGTH_M * angle_between(qa, qb)
    return float(times[int(np.argmin(distance))])


# --- from links to impacts ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Priors:
    """Prior standard deviations that hold for all fits of a clip: of the shared errors (m,) [px], and of the table's height
    [m]."""

    shared_sigma: Array
    table_sigma_m: float

    def fit(
        self,
        observations: WeightedPoses,
        starts: Sequence[State],
        links: Sequence[Link],
        errors: ErrorModel | None = None,
    ) -> FlightChain:
        """`fit_chain` with these priors."""
        return fit_chain(
            observations,
            starts,
            links,
            errors=errors,
            shared_sigma=self.shared_sigma,
            table_sigma_m=self.table_sigma_m,
        )

    def refit(
        self, observations: WeightedPoses, chain: FlightChain, links: Sequence[Link], errors: ErrorModel | None
    ) -> FlightChain:
        """The same flights with other links, or with another error model."""
        return self.fit(observations, [flight.start for flight in chain.flights], links, errors)


@dataclass(frozen=True, eq=False)
class ResolvedChain:
    """A chain of flights whose contacts are identified."""

    observations: WeightedPoses
    """The frames, relabelled where necessary."""
    chain: FlightChain
    priors: Priors
    """Those that were given, or wider ones if the clip contradicts them."""

    def without_undetermined_errors(self, count: int) -> ResolvedChain:
        """Itself if two of its flights meet in a contact. Otherwise refitted without the first `count` shared errors: they vary
        as the die turns, and a single flight cannot separate them from its motion."""
        if not len(self.chain.shared) or not all(link.is_open for link in self.chain.links):
            return self
        priors = replace(self.priors, shared_sigma=self.priors.shared_sigma[count:])
        observations = self.observations.with_bias_jacobian(self.observations.bias_jacobian[:, :, count:])
        chain = priors.refit(observations, self.chain, self.chain.links, self.chain.errors)
        chain = priors.refit(observations, chain, chain.links, _error_model_of(observations, chain))
        return ResolvedChain(observations, chain, priors)


def resolve_contacts(observations: WeightedPoses, chain: FlightChain, die: Die, priors: Priors) -> ResolvedChain:
    """The chain with each joined link an impact at the vertex that explains it best, or free if none does, and with the error
    model of the frames.

    The error model is estimated about flights joined by free jumps: a wrong impact must show as a cost, not as larger errors.
    """
    found = priors.refit(observations, chain, chain.links, None)
    if (np.abs(found.shared) > INCONSISTENT_SIGMAS * priors.shared_sigma).any():
        # No contour is off by as much: the size of the die, the clock or the camera is not that of this clip. A track that hides
        # this would be worth less than one that shows it (`gravity`).
        priors = replace(priors, shared_sigma=np.zeros(0))
        observations = observations.with_bias_jacobian(observations.bias_jacobian[:, :, :0])
        found = priors.refit(observations, chain, chain.links, None)
    found = priors.refit(observations, found, found.links, _error_model_of(observations, found))
    found = _with_vertex_impacts(observations, found, die, priors)
    found = _without_insignificant_links(observations, found, priors)
    found = _without_spurious_impacts(observations, found, die, priors)
    observations, found = _with_resolved_clusters(observations, found, die, priors)
    if found.links and abs(found.table_m) > INCONSISTENT_SIGMAS * priors.table_sigma_m:
        priors = replace(priors, table_sigma_m=UNKNOWN_TABLE_M)
        found = priors.refit(observations, found, found.links, found.errors)
    found = priors.refit(observations, found, found.links, _error_model_of(observations, found))
    found = _with_merged_contacts(observations, found, priors)
    return ResolvedChain(observations, _with_links_at_first_touch(observations, found, die, priors), priors)


def explains_better(observations: WeightedPoses, one: ResolvedChain, other: ResolvedChain) -> bool:
    """Whether the first of two chains of flights explains some frames better, each with its own labelling of them.

    Both are fitted with the wider priors of the two and the error model with the smaller errors, at a PENALTY for each free
    parameter."""
    errors = _smaller_errors(one, other)
    table_sigma_m = max(one.priors.table_sigma_m, other.priors.table_sigma_m)
    shared_sigma = min(one.priors.shared_sigma, other.priors.shared_sigma, key=len)
    priors = Priors(shared_sigma, table_sigma_m)
    bias_jacobian = observations.bias_jacobian[:, :, : len(shared_sigma)]
    costs = []
    for each in (one, other):
        frames = replace(observations, quaternion=each.observations.quaternion).with_bias_jacobian(bias_jacobian)
        costs.append(_penalised_cost(priors.refit(frames, each.chain, each.chain.links, errors)))
    return costs[0] < costs[1]


def gain_over(one: ResolvedChain, other: ResolvedChain) -> float:
    """By how many squared sigmas the first of two chains of flights through the same frames costs less than the second, each with
    its own priors and its own contacts, with the smaller errors of both and a PENALTY for each free parameter.

    The cost of a chain with its own error model says nothing: a wrong chain shows larger errors."""
    errors = _smaller_errors(one, other)
    cost, others = (
        _penalised_cost(each.priors.refit(each.observations, each.chain, each.chain.links, errors))
        for each in (one, other)
    )
    return others - cost


def _smaller_errors(one: ResolvedChain, other: ResolvedChain) -> ErrorModel:
    """The error model of the two with the smaller errors."""
    return min((one.chain.errors, other.chain.errors), key=lambda each: float(np.log(each.variance).sum()))


def _penalised_cost(chain: FlightChain) -> float:
    """The cost of a chain, with a PENALTY for each parameter that its links leave free."""
    determined = sum(IMPACT_CONDITIONS for link in chain.links if link.impact is not None)
    return chain.cost + PENALTY * (sum(link.size for link in chain.links) - determined)


def _with_merged_contacts(observations: WeightedPoses, chain: FlightChain, priors: Priors) -> FlightChain:
    """The chain with indistinguishable contacts merged into one open link: two of which one is open with no inlier between them,
    so that the flight between is unknown; and two that a fit has drawn to one instant."""
    while True:
        is_known = chain.inlier_share(observations.time_s)[1:-1] > 0.0
        opened = [a.is_open or b.is_open for a, b in itertools.pairwise(chain.links)]
        same_instant = np.diff(chain.link_times_s) < SAME_INSTANT_FRAMES * usual_spacing_s(observations)
        k = next((k for k, same in enumerate(same_instant) if same or (opened[k] and not is_known[k])), None)
        if k is None:
            return chain
        middle_s = 0.5 * (chain.links[k].time_s + chain.links[k + 1].time_s)
        links = [*chain.links[:k], Link(middle_s, is_open=True), *chain.links[k + 2 :]]
        starts = [flight.start for j, flight in enumerate(chain.flights) if j != k + 1]
        chain = priors.fit(observations, starts, links, chain.errors)


def _with_links_at_first_touch(
    observations: WeightedPoses, chain: FlightChain, die: Die, priors: Priors
) -> FlightChain:
    """The chain with each open link at the instant of the first of its contacts: where the motion before, continued from its last
    inlier, comes down to the table. If it does not before the next flight begins, the link stays where it is."""
    parts = chain.parts(observations.time_s)
    links = list(chain.links)
    for k, link in enumerate(chain.links):
        inliers = np.flatnonzero(chain.weights > INLIER_WEIGHT)
        before = inliers[(inliers >= parts[k].start) & (inliers < parts[k].stop)]
        behind = inliers[inliers >= parts[k].stop]
        if not link.is_open or not len(before) or not len(behind):
            continue
        times = np.linspace(
            float(observations.time_s[before[-1]]), float(observations.time_s[behind[0]]), TOUCH_SAMPLES
        )
        p, q = chain.flights[k].poses(times)
        below = np.flatnonzero(lowest_heights_m(die, p, q) < chain.table_m)
        if len(below):
            links[k] = replace(link, time_s=float(times[below[0]]))
    has_moved = any(a.time_s != b.time_s for a, b in zip(links, chain.links, strict=True))
    return priors.refit(observations, chain, links, chain.errors) if has_moved else chain


def _with_vertex_impacts(observations: WeightedPoses, chain: FlightChain, die: Die, priors: Priors) -> FlightChain:
    """The chain with its joined links as impacts at the low vertex of least cost.

    Links with one likely vertex become impacts at once, if that holds; the others one by one. Links that cost more than
    MAX_IMPACT_COST stay free: two simultaneous contacts, or an edge that struck along its length, push at no single vertex."""
    impacts = vertex_impacts(die)
    candidates = [
        _candidates(observations, chain, k, _lowest(chain, k, impacts), priors) for k in range(len(chain.links))
    ]
    single = [k for k, found in enumerate(candidates) if len(found) == 1]
    for chosen in (single, [k for k in single if candidates[k][0][0] < LIKELY_COST]):
        replaced = {k: replace(chain.links[k], impact=candidates[k][0][1]) for k in chosen}
        links = [replaced.get(k, link) for k, link in enumerate(chain.links)]
        trial = priors.refit(observations, chain, links, chain.errors) if chosen else chain
        if trial.cost < chain.cost + LIKELY_COST * len(chosen):
            chain = trial
            break
    for k, found in enumerate(candidates):
        if chain.links[k].impact is not None:
            continue
        trials = []
        for _, impact in found:
            links = list(chain.links)
            links[k] = replace(links[k], impact=impact)
            trials.append(priors.refit(observations, chain, links, chain.errors))
        best = min(trials, key=lambda trial: trial.cost, default=chain)
        chain = best if best.cost < chain.cost + MAX_IMPACT_COST else chain
    return chain


def _candidates(
    observations: WeightedPoses, chain: FlightChain, k: int, low: list[VertexImpact], priors: Priors
) -> list[tuple[float, VertexImpact]]:
    """Of the impacts `low` that link k may be, those not excluded, with their cost to first order."""
    if chain.links[k].is_open:
        return []
    costs = [(vertex_impact_cost(chain, k, impact, priors.table_sigma_m), impact) for impact in low]
    if not _has_known_flights(observations, chain, k):
        return costs
    return [(cost, impact) for cost, impact in costs if cost < MAX_FIRST_ORDER_COST]


def _has_known_flights(observations: WeightedPoses, chain: FlightChain, k: int) -> bool:
    """Whether most frames of the flights on either side of a link lie on them. A flight that others have spoilt says nothing
    about its contact."""
    return bool((chain.inlier_share(observations.time_s)[k : k + 2] > KNOWN_FLIGHT_SHARE).all())


def vertex_impacts(die: Die) -> list[VertexImpact]:
    """An impact at each vertex; none for a die whose centre of mass is not its centroid: the conditions do not describe them."""
    if not die.is_nearly_centred:
        return []
    inner = inner_vertices(die.solid, die.corner_radius_m)
    mass_over_inertia = np.asarray(die.mass_kg * np.linalg.inv(die.tensor_kg_m2), np.float64)
    return [VertexImpact(point, die.corner_radius_m, mass_over_inertia) for point in inner]


def _lowest(chain: FlightChain, k: int, impacts: Sequence[VertexImpact]) -> list[VertexImpact]:
    """The impacts that link k may be, the lowest vertex first."""
    return low_impacts(impacts, chain.flights[k].at(chain.links[k].time_s).rotation)


def low_impacts(impacts: Sequence[VertexImpact], rotation: Array) -> list[VertexImpact]:
    """The impacts at vertices that may strike in an orientation (3, 3), the lowest first."""
    if not impacts:
        return []
    heights = np.array([impact.arm(rotation)[2] for impact in impacts])
    reach = NEAR_SHARE * float(np.ptp(heights))
    return [impacts[int(i)] for i in np.argsort(heights) if heights[i] - heights.min() < reach]


def _error_model_of(observations: WeightedPoses, chain: FlightChain) -> ErrorModel:
    """The error model of the frames about the fitted flights."""
    return estimate_error_model(
        observations,
        chain.parts(observations.time_s),
        [flight.start for flight in chain.flights],
        chain.shared,
        chain.weights,
    )


def _without_insignificant_links(observations: WeightedPoses, chain: FlightChain, priors: Priors) -> FlightChain:
    """The chain without joined links that explain no more than chance does under the error model: the weakest first."""
    while True:
        trials = []
        for k, link in enumerate(chain.links):
            if link.is_open or _first_order_gain(chain, k) > PLAIN_FACTOR * LEAST_GAIN:
                continue
            trial = _without_link(observations, chain, k, priors)
            if trial.cost < chain.cost + LEAST_GAIN:
                trials.append(trial)
        if not trials:
            return chain
        chain = min(trials, key=lambda trial: trial.cost)


def _first_order_gain(chain: FlightChain, k: int) -> float:
    """Squared sigmas that a joined link explains, to first order: its jump over the uncertainty of the jump."""
    t = float(chain.link_times_s[k])
    a, b, C = chain.flights[k].at(t), chain.flights[k + 1].at(t), chain.joint_covariance[k]
    jump = np.concatenate([b.velocity_m_s - a.velocity_m_s, b.omega_rad_s - a.omega_rad_s])
    covariance = C[6:12, 6:12] + C[18:24, 18:24] - C[6:12, 18:24] - C[18:24, 6:12]
    return float(jump @ scaled_inverse(covariance) @ jump)


def _without_link(observations: WeightedPoses, chain: FlightChain, k: int, priors: Priors) -> FlightChain:
    """The chain with the flights before and behind link k as one, initialised from the longer."""
    durations = [flight.end_s - flight.start.time_s for flight in chain.flights[k : k + 2]]
    dropped = k if durations[0] < durations[1] else k + 1
    starts = [flight.start for j, flight in enumerate(chain.flights) if j != dropped]
    links = [link for j, link in enumerate(chain.links) if j != k]
    return priors.fit(observations, starts, links, chain.errors)


def _without_spurious_impacts(observations: WeightedPoses, chain: FlightChain, die: Die, priors: Priors) -> FlightChain:
    """The chain without open links at which nothing can have struck: the motion before, continued to the first inlier of the next
    flight, stays clear of the table. Where no one motion explains most of the frames on both sides, the height is wrong."""
    impacts = vertex_impacts(die)
    for k, link in reversed(list(enumerate(chain.links))):
        if not link.is_open or not impacts:
            continue
        inside = np.flatnonzero((observations.time_s > link.time_s) & (chain.weights > INLIER_WEIGHT))
        until = float(observations.time_s[inside[0]]) if len(inside) else link.time_s
        times = np.linspace(link.time_s, max(until, link.time_s + 4.0 * usual_spacing_s(observations)), CLEAR_SAMPLES)
        lowest = min(_height(chain.flights[k].at(float(t)), impacts) for t in times)
        if lowest - chain.table_m < CLEAR_SHARE * die.solid.edge_m:
            continue
        starts = [flight.start for j, flight in enumerate(chain.flights) if j != k + 1]
        links = [other for j, other in enumerate(chain.links) if j != k]
        trial = priors.fit(observations, starts, links, chain.errors)
        if trial.inlier_share(observations.time_s)[k] < KNOWN_FLIGHT_SHARE:
            continue
        chain = priors.refit(observations, trial, trial.links, _error_model_of(observations, trial))
    return chain


def _with_resolved_clusters(
    observations: WeightedPoses, chain: FlightChain, die: Die, priors: Priors
) -> tuple[WeightedPoses, FlightChain]:
    """The frames and the chain, with the links that hide several impacts resolved into these where the model determines them
    (`resolve_cluster`)."""
    impacts, errors = vertex_impacts(die), chain.errors

    def fit(own: WeightedPoses, starts: Sequence[State], links: Sequence[Link]) -> FlightChain:
        return priors.fit(own, starts, links, errors)

    k = len(chain.links) - 1
    while k >= 0 and impacts:
        resolved = resolve_cluster(observations, chain, k, die, impacts, fit)
        if resolved:
            observations, chain, first = resolved
            k = first - 1
        else:
            k -= 1
    return observations, chain


def usual_spacing_s(observations: WeightedPoses) -> float:
    """Median time [s] between frames."""
    return float(np.median(np.diff(observations.time_s)))


def _height(state: State, impacts: list[VertexImpact]) -> float:
    """Height [m] of the lowest point of the die."""
    return float(state.position_m[2] + min(impact.arm(state.rotation)[2] for impact in impacts))


def normal_velocity(state: State, arm: Array) -> float:
    """Vertical velocity [m/s] of a point of the die at `arm` (3,) from its centre."""
    return float(state.velocity_m_s[2] + np.cross(state.omega_rad_s, arm)[2])


def normal_velocity_jacobian(before: State, after: State, arm: Array, gravity_m_s2: float) -> Array:
    """Derivatives (2, 25) of the normal velocity of a point of the die before and after an impact with respect to the states on
    both sides and the instant, in the order of `FlightChain.joint_covariance`."""
    rows = np.zeros((2, JOINT))
    for row, first, state in zip(rows, (0, 12), (before, after), strict=True):
        w = state.omega_rad_s
        # ẑ·(ω × (δθ × r)) = δθ·(r × (ẑ × ω)).
        row[first + 3 : first + 6] = np.cross(arm, np.cross([0.0, 0.0, 1.0], w))
        row[first + 8] = 1.0
        row[first + 9 : first + 12] = np.cross(arm, [0.0, 0.0, 1.0])
        # The corner of a spinning die accelerates within the uncertainty of the instant: 500 m/s² is usual.
        row[24] = float(np.cross(w, np.cross(w, arm))[2]) - gravity_m_s2
    return rows
