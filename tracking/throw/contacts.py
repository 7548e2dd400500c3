"""What stands between two flights: an impact at a vertex, a jump of any kind, several contacts, or nothing.

Neighbouring flights are joined at one instant each and all are fitted together (`joined`): first with any jump between
them, then as impacts at the vertex that explains them best, each obeying what impacts obey, with the errors that the
whole clip shares (`lean`) and the frames' own scatter and its memory (`scatter`) found on the way. A link that no single
impact explains may be a few that follow each other within some frames (`quick`); where they cannot be told apart either,
it stays open. Where the motion before, followed on, stays clear of the table, nothing struck: such a parting is undone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, inner_vertices
from ...model.rotations import matrix_from_quat, rotation_between
from ...model.throw import Flight, State
from ...model.world import GRAVITY_M_S2
from .contact_clusters import instant_s, is_crowded, resolved
from .error_model import estimate_error_model
from .flight_chain import FlightChain, Link, VertexImpact, fit_chain, vertex_impact_cost
from .flights import ErrorModel, Observations, fit_flight, misfits, scaled_inverse
from .segmentation import TABLE_REACH

Array = NDArray[np.float64]

OPEN_STRAIN = 5.0
"""Frames beside a link that lie this many times further off than usual say that no single instant joins its flights."""
FAULTY_STRAIN = 2.0
"""The same, for a link that on top of it does not look like a bounce."""
LONGEST = 40
"""Frames of each flight that are enough to judge a contact between them."""
GROSS_RAD = 0.2
"""Flights whose orientations stay further apart than this at their nearest are not joined at one instant."""
STRIKE_STRAIN = 40.0
"""Squared sigmas over its four rules beyond which a contact is no impact at one point (chi-square exceeds 18 in a
thousandth of the cases; slow errors of the frames take the rest)."""
HOPELESS = 1000.0
"""Squared sigmas, to the first order, beyond which a contact is not tried at all: what that leaves out, how flights curve
within the uncertainty of the instant, makes some tens."""
SLIGHT = 25.0
"""Squared sigmas that a link must explain. It has seven numbers, of which the rules leave three free; chance gives those more
than that once in 70 000 cases, and there are not as many places for a link in a clip."""
PRICE = SLIGHT / 3.0
"""The same for each number that the rules leave free, where chains are compared."""
STRIKE_ROWS = 4
"""Numbers of a link that a strike tells."""
PLAIN = 4.0
"""A link that explains so many times as much to the first order needs no trial."""
MOST_FRAMES = 0.7
"""Share of its frames that a flight which is known has."""
LIKELY_STRAIN = 9.5
"""Squared sigmas that four rules cost by chance in one case of twenty."""
REBOUND_SIGMAS = 2.0
"""Normal velocities of the wrong sign by more than so many of their standard errors are no rebound's."""
NEAR_SHARE = 0.1
"""Vertices no higher than this above the lowest, as a share of an edge, may be the one that strikes."""
CLEAR_SHARE = 0.03
"""A motion that stays this share of an edge above the table has touched nothing."""
TOUCH_STEPS = 200
"""Instants at which a motion is asked whether it has come down to the table: some twenty frames at the most lie between."""
UNKNOWN_TABLE_M = 3e-3
"""Height of the table where poses come without a camera, and with its depth error: half a per cent of the distance."""
SAME_FRAMES = 1e-3
"""Contacts nearer in time than this, in frames, are not two: no instant is known as well."""
FAR_SIGMAS = 5.0
"""A table found this many sigmas from where it should be was not calibrated as well as is taken for granted."""


@dataclass(frozen=True, eq=False)
class _Part:
    """A flight fitted by itself."""

    rows: NDArray[np.int64]
    misfit: Array
    """(n,) distance of its frames, in sigmas."""
    good: NDArray[np.int64]
    """Its rows without those far off."""
    state: State
    """Of the good ones."""

    @staticmethod
    def of(seen: Observations, rows: NDArray[np.int64]) -> _Part:
        state, _, _ = fit_flight(seen.rows(rows))
        misfit = misfits(seen.rows(rows), state)
        good = rows[misfit < 5.0 * max(float(np.median(misfit)), 0.5)]
        if not 3 <= len(good) < len(rows):
            return _Part(rows, misfit, rows, state)
        return _Part(rows, misfit, good, fit_flight(seen.rows(good))[0])

    @property
    def span(self) -> tuple[int, int]:
        """Its first row and its last."""
        return int(self.rows[0]), int(self.rows[-1])


def join_flights(seen: Observations, parts: list[NDArray[np.int64]], die: Die) -> FlightChain:
    """All flights fitted together. Links that one instant cannot explain are open: each is judged on its own two
    flights, because one that is forced together where it does not hold spoils the fit of all. Links that cannot be
    bounces are removed, of neighbours the weaker first; open ones stay, since one motion through both flights would be
    neither."""
    judged: dict[tuple[tuple[int, int], tuple[int, int]], float] = {}
    alone = [_Part.of(seen, rows) for rows in parts]
    while True:
        strains = []
        for a, b in itertools.pairwise(alone):
            pair = a.span, b.span
            if pair not in judged:
                judged[pair] = np.inf if _is_gross(seen, a, b, die) else _strain(seen, a, b)
            strains.append(judged[pair])
        opened = [strain > OPEN_STRAIN for strain in strains]
        joined = _fit_parts(seen, alone, opened)
        impossible = [not o and not _can_be_bounce(seen, joined, k, die) for k, o in enumerate(opened)]
        faulty = [bad and strain > FAULTY_STRAIN for bad, strain in zip(impossible, strains, strict=True)]
        if any(faulty):
            # Several contacts taken for one need not look like a bounce; what shows them is that one instant fits ill.
            opened = [o or bad for o, bad in zip(opened, faulty, strict=True)]
            joined = _fit_parts(seen, alone, opened)
        jumps = {
            k: _jump(joined, k, die) for k, o in enumerate(opened) if not o and not _can_be_bounce(seen, joined, k, die)
        }
        if not jumps:
            return joined
        weakest = {k for k, jump in jumps.items() if jump <= min(jumps.get(j, np.inf) for j in (k - 1, k + 1))}
        merged = [alone[0]]
        for k, part in enumerate(alone[1:]):
            if k in weakest:
                merged[-1] = _Part.of(seen, np.concatenate([merged[-1].rows, part.rows]))
            else:
                merged.append(part)
        alone = merged


def _is_gross(seen: Observations, a: _Part, b: _Part, die: Die) -> bool:
    """Whether two flights, each fitted alone, come nowhere near each other: several contacts lie between them, or the
    track was lost there and taken up under another labelling. Forcing them together would spoil both."""
    before, after = Flight(a.state, np.inf), Flight(b.state, np.inf)
    t = _meeting(a.state, b.state, float(seen.time_s[a.rows[-1]]), float(seen.time_s[b.rows[0]]))
    p, q = before.at(t), after.at(t)
    turned = float(np.linalg.norm(rotation_between(p.quaternion, q.quaternion)))
    away = float(np.linalg.norm(p.position_m - q.position_m))
    return turned > GROSS_RAD or away > 0.3 * die.solid.circumradius


def _strain(seen: Observations, before: _Part, after: _Part) -> float:
    """How much further than usual the frames beside a contact lie from two flights joined at one instant. The worst is
    left out: one frame may straddle the contact in its exposure."""
    a = before if len(before.rows) <= LONGEST else _Part.of(seen, before.rows[-LONGEST:])
    b = after if len(after.rows) <= LONGEST else _Part.of(seen, after.rows[:LONGEST])
    joined = _fit_parts(seen, [a, b], [False], seen.rows(np.concatenate([a.rows, b.rows])))
    usual = float(np.median(np.concatenate([a.misfit, b.misfit])))
    beside = joined.scatter.scale[0] * joined.residual[max(len(a.rows) - 4, 0) : len(a.rows) + 4]
    return float(np.mean(np.sort(beside)[:-1])) / max(usual, 0.5)


def _can_be_bounce(seen: Observations, joined: FlightChain, k: int, die: Die) -> bool:
    """Whether a link is what a table does to a die: it pushes upwards, on a corner near the table that came down before
    and goes up after. Slow drifts of the pose, as marks and shading move over the edges, do none of this.

    A weak bounce may do it within its errors alone: the corner of a fast die turns by 1500 m/s², and changes its speed by
    as much as a weak impact does within the uncertainty of the instant. Then what it does to motion and spin together
    must be that of an impact at one corner, which no drift is by chance.
    """
    t = float(joined.links_s[k])
    a, b = joined.flights[k].at(t), joined.flights[k + 1].at(t)
    arms = die.solid.vertices @ a.rotation.T
    low = int(np.argmin(arms[:, 2]))
    edge = die.solid.edge_m
    if abs(arms[low, 2] + a.position_m[2]) > TABLE_REACH * edge or b.velocity_m_s[2] <= a.velocity_m_s[2]:
        return False
    if normal_velocity(a, arms[low]) < 0.0 < normal_velocity(b, arms[low]):
        return True
    if joined.sigma_time_s[k] > instant_s(seen.time_s):
        return False
    return any(
        vertex_impact_cost(joined, k, strike, UNKNOWN_TABLE_M) < STRIKE_STRAIN and _may_rebound(joined, k, strike)
        for strike in _lowest(joined, k, _strikes(die))
    )


def _may_rebound(joined: FlightChain, k: int, strike: VertexImpact) -> bool:
    """Whether the contact came down before and goes up after, within two sigmas."""
    t = float(joined.links_s[k])
    a, b = joined.flights[k].at(t), joined.flights[k + 1].at(t)
    arm = strike.arm(a.rotation)
    rows = normal_velocity_rows(a, b, arm)
    sigma = np.sqrt(np.maximum(np.diag(rows @ joined.beside[k] @ rows.T), 0.0))
    return normal_velocity(a, arm) < REBOUND_SIGMAS * sigma[0] and normal_velocity(b, arm) > -REBOUND_SIGMAS * sigma[1]


def _jump(joined: FlightChain, k: int, die: Die) -> float:
    """Size [m/s] of the change of motion at a link, at the die's surface."""
    t = float(joined.links_s[k])
    a, b = joined.flights[k].at(t), joined.flights[k + 1].at(t)
    spin = die.solid.circumradius * np.linalg.norm(b.omega_rad_s - a.omega_rad_s)
    return float(np.linalg.norm(b.velocity_m_s - a.velocity_m_s) + spin)


def _fit_parts(
    seen: Observations, parts: list[_Part], opened: list[bool], fitted: Observations | None = None
) -> FlightChain:
    """The joint fit of all frames, or of those given, from each flight's own fit."""
    links = []
    for before, after, is_open in zip(parts[:-1], parts[1:], opened, strict=True):
        if is_open:
            # Between the frames that surely lie on either flight; where exactly, no single instant says.
            t = 0.5 * float(seen.time_s[before.good[-1]] + seen.time_s[after.good[0]])
        else:
            low, high = float(seen.time_s[before.rows[-1]]), float(seen.time_s[after.rows[0]])
            t = _meeting(before.state, after.state, low, high)
        links.append(Link(t, is_open))
    return fit_chain(seen if fitted is None else fitted, [part.state for part in parts], links)


def _meeting(before: State, after: State, low_s: float, high_s: float) -> float:
    """The instant near [low, high] at which two motions come closest, positions and turns (times 5 mm) together."""
    spread = max(high_s - low_s, 1e-9)
    times = np.linspace(low_s - 1.0 * spread, high_s + 1.0 * spread, 121)
    pa, qa = Flight(before, np.inf).poses(times)
    pb, qb = Flight(after, np.inf).poses(times)
    distance = np.linalg.norm(pa - pb, axis=1) + 5e-3 * np.linalg.norm(rotation_between(qa, qb), axis=1)
    return float(times[int(np.argmin(distance))])


# --- from links to impacts ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Priors:
    """What holds for all fits of a clip: the priors of the shared errors (m,) and of the height of the table [m]."""

    shared_bias_sigma: Array
    table_sigma_m: float

    def fit(
        self, seen: Observations, starts: Sequence[State], links: Sequence[Link], scatter: ErrorModel | None = None
    ) -> FlightChain:
        return fit_chain(
            seen,
            starts,
            links,
            scatter=scatter,
            shared_bias_sigma=self.shared_bias_sigma,
            table_sigma_m=self.table_sigma_m,
        )

    def again(
        self, seen: Observations, joined: FlightChain, links: Sequence[Link], scatter: ErrorModel | None
    ) -> FlightChain:
        """The same flights with other links, or with another scatter."""
        return self.fit(seen, [flight.start for flight in joined.flights], links, scatter)


@dataclass(frozen=True, eq=False)
class ResolvedChain:
    """A chain of flights with its links named."""

    seen: Observations
    """The frames, relabelled where need be."""
    joined: FlightChain
    rules: Priors
    """Those that were given, or wider ones where the clip is not as they say."""


def resolve_contacts(seen: Observations, joined: FlightChain, die: Die, rules: Priors) -> ResolvedChain:
    """The chain with each joined link an impact at the vertex that explains it best, or free where none does, and with the
    frames' own scatter. The scatter is that about flights joined anyhow: what an impact that is none would do to them must
    show as a cost, not as scatter."""
    found = rules.again(seen, joined, joined.links, None)
    if (np.abs(found.shared) > FAR_SIGMAS * rules.shared_bias_sigma).any():
        # A contour is not off by as much: the size of the die, the clock or the camera is not that of this clip, and a
        # track that hid it would be worth less than one that shows it (`gravity`).
        rules, seen = replace(rules, shared_bias_sigma=np.zeros(0)), seen.leaning(seen.lean[:, :, :0])
        found = rules.again(seen, joined, joined.links, None)
    found = rules.again(seen, found, found.links, _scatter_of(seen, found))
    found = _struck(seen, found, die, rules)
    found = _without_slight_ones(seen, found, rules)
    found = _without_ghosts(seen, found, die, rules)
    seen, found = _with_quick_ones(seen, found, die, rules)
    if found.links and abs(found.table_m) > FAR_SIGMAS * rules.table_sigma_m:
        rules = replace(rules, table_sigma_m=UNKNOWN_TABLE_M)
        found = rules.again(seen, found, found.links, found.scatter)
    found = _taken_together(seen, rules.again(seen, found, found.links, _scatter_of(seen, found)), rules)
    return ResolvedChain(seen, _at_first_touches(seen, found, die, rules), rules)


def explains_better(seen: Observations, one: ResolvedChain, other: ResolvedChain) -> bool:
    """Whether a chain of flights explains some frames better than another, each with its own labelling of them: by the wider
    rules of the two, with the scatter of the one about which they scatter less, and at a price for each number."""
    scatter = min((one.joined.scatter, other.joined.scatter), key=lambda each: float(np.log(each.variance).sum()))
    table_sigma_m = max(one.rules.table_sigma_m, other.rules.table_sigma_m)
    shared_bias_sigma = min(one.rules.shared_bias_sigma, other.rules.shared_bias_sigma, key=len)
    rules = Priors(shared_bias_sigma, table_sigma_m)
    lean = seen.lean[:, :, : len(shared_bias_sigma)]
    costs = []
    for each in (one, other):
        frames = replace(seen, quaternion=each.seen.quaternion).leaning(lean)
        told = sum(STRIKE_ROWS for link in each.joined.links if link.strike is not None)
        numbers = sum(link.size for link in each.joined.links) - told
        costs.append(rules.again(frames, each.joined, each.joined.links, scatter).cost + PRICE * numbers)
    return costs[0] < costs[1]


def _taken_together(seen: Observations, joined: FlightChain, rules: Priors) -> FlightChain:
    """The chain with contacts that nothing tells apart as one, which stays open: two of which one is open and no frame
    between, so that nothing is known of the flight between; and two that a fit has drawn to one instant."""
    while True:
        borne_out = joined.borne_out(seen.time_s)[1:-1] > 0.0
        opened = [a.is_open or b.is_open for a, b in itertools.pairwise(joined.links)]
        alike = np.diff(joined.links_s) < SAME_FRAMES * _spacing(seen)
        k = next((k for k, one in enumerate(alike) if one or (opened[k] and not borne_out[k])), None)
        if k is None:
            return joined
        middle_s = 0.5 * (joined.links[k].time_s + joined.links[k + 1].time_s)
        links = [*joined.links[:k], Link(middle_s, is_open=True), *joined.links[k + 2 :]]
        starts = [flight.start for j, flight in enumerate(joined.flights) if j != k + 1]
        joined = rules.fit(seen, starts, links, joined.scatter)


def _at_first_touches(seen: Observations, joined: FlightChain, die: Die, rules: Priors) -> FlightChain:
    """The chain with each open link where the first of its contacts must be: the motion before, followed on from its last
    sure frame, comes down to the table. Where it does not before the next flight is sure, the link stays where it is."""
    inner = inner_vertices(die.solid, die.corner_radius_m)
    parts = joined.parts(seen.time_s)
    links = list(joined.links)
    for k, link in enumerate(joined.links):
        sure = np.flatnonzero(joined.weights > 0.5)
        before = sure[(sure >= parts[k].start) & (sure < parts[k].stop)]
        behind = sure[sure >= parts[k].stop]
        if not link.is_open or not len(before) or not len(behind):
            continue
        times = np.linspace(float(seen.time_s[before[-1]]), float(seen.time_s[behind[0]]), TOUCH_STEPS)
        p, q = Flight(joined.flights[k].start, np.inf).poses(times)
        heights = (matrix_from_quat(q) @ inner.T)[:, 2].min(1) + p[:, 2] - die.corner_radius_m - joined.table_m
        below = np.flatnonzero(heights < 0.0)
        if len(below):
            links[k] = replace(link, time_s=float(times[below[0]]))
    perturbed = any(a.time_s != b.time_s for a, b in zip(links, joined.links, strict=True))
    return rules.again(seen, joined, links, joined.scatter) if perturbed else joined


def _struck(seen: Observations, joined: FlightChain, die: Die, rules: Priors) -> FlightChain:
    """The chain with its joined links as impacts at the low vertex of least cost: those with one likely vertex at once, if
    that holds, and the others one by one. Those that cost more than noise does are left free: two contacts at once, or an
    edge that struck along its length, push at no one vertex."""
    strikes = _strikes(die)
    likely = [_likely(seen, joined, k, _lowest(joined, k, strikes), rules) for k in range(len(joined.links))]
    alone = [k for k, found in enumerate(likely) if len(found) == 1]
    for sure in (alone, [k for k in alone if likely[k][0][0] < LIKELY_STRAIN]):
        struck = {k: replace(joined.links[k], strike=likely[k][0][1]) for k in sure}
        links = [struck.get(k, link) for k, link in enumerate(joined.links)]
        trial = rules.again(seen, joined, links, joined.scatter) if sure else joined
        if trial.cost < joined.cost + LIKELY_STRAIN * len(sure):
            joined = trial
            break
    for k, found in enumerate(likely):
        if joined.links[k].strike is not None:
            continue
        trials = []
        for _, strike in found:
            links = list(joined.links)
            links[k] = replace(links[k], strike=strike)
            trials.append(rules.again(seen, joined, links, joined.scatter))
        best = min(trials, key=lambda trial: trial.cost, default=joined)
        joined = best if best.cost < joined.cost + STRIKE_STRAIN else joined
    return joined


def _likely(
    seen: Observations, joined: FlightChain, k: int, low: list[VertexImpact], rules: Priors
) -> list[tuple[float, VertexImpact]]:
    """Of the contacts that link k may be, those that are not out of the question, with what they would cost to the first
    order."""
    if joined.links[k].is_open:
        return []
    costs = [(vertex_impact_cost(joined, k, strike, rules.table_sigma_m), strike) for strike in low]
    if not _is_borne_out(seen, joined, k):
        return costs
    return [(cost, strike) for cost, strike in costs if cost < HOPELESS]


def _is_borne_out(seen: Observations, joined: FlightChain, k: int) -> bool:
    """Whether most frames of the flights on either side of a link lie on them. What a flight that others have spoilt makes
    of a contact says nothing."""
    return bool((joined.borne_out(seen.time_s)[k : k + 2] > MOST_FRAMES).all())


def _numbered(joined: FlightChain) -> list[tuple[int, Link]]:
    return list(enumerate(joined.links))


def _strikes(die: Die) -> list[VertexImpact]:
    """A contact at each vertex. A die that is no spherical top has none that could be judged so simply."""
    if not die.is_spherical_top:
        return []
    inner = inner_vertices(die.solid, die.corner_radius_m)
    return [VertexImpact(point, die.corner_radius_m, die.mass_kg / die.inertia_kg_m2) for point in inner]


def _lowest(joined: FlightChain, k: int, strikes: list[VertexImpact]) -> list[VertexImpact]:
    """The contacts that link k may be, the lowest vertex first."""
    if not strikes:
        return []
    state = joined.flights[k].at(joined.links[k].time_s)
    heights = np.array([strike.arm(state.rotation)[2] for strike in strikes])
    reach = NEAR_SHARE * float(np.ptp(heights))
    return [strikes[int(i)] for i in np.argsort(heights) if heights[i] - heights.min() < reach]


def _scatter_of(seen: Observations, joined: FlightChain) -> ErrorModel:
    """The scatter of the frames about the fitted flights."""
    return estimate_error_model(
        seen, joined.parts(seen.time_s), [flight.start for flight in joined.flights], joined.shared, joined.weights
    )


def _without_slight_ones(seen: Observations, joined: FlightChain, rules: Priors) -> FlightChain:
    """The chain without joined links that explain no more than chance does, now that it is known how errors go together:
    the slightest first."""
    while True:
        trials = []
        for k, link in _numbered(joined):
            if link.is_open or _gained(joined, k) > PLAIN * SLIGHT:
                continue
            trial = _merged(seen, joined, k, rules)
            if trial.cost < joined.cost + SLIGHT:
                trials.append(trial)
        if not trials:
            return joined
        joined = min(trials, key=lambda trial: trial.cost)


def _gained(joined: FlightChain, k: int) -> float:
    """Squared sigmas that a joined link explains, to the first order: how surely the motion jumps there."""
    t = float(joined.links_s[k])
    a, b, C = joined.flights[k].at(t), joined.flights[k + 1].at(t), joined.beside[k]
    jump = np.concatenate([b.velocity_m_s - a.velocity_m_s, b.omega_rad_s - a.omega_rad_s])
    spread = C[6:12, 6:12] + C[18:24, 18:24] - C[6:12, 18:24] - C[18:24, 6:12]
    return float(jump @ scaled_inverse(spread) @ jump)


def _merged(seen: Observations, joined: FlightChain, k: int, rules: Priors) -> FlightChain:
    """The chain with the flights before and behind link k as one, begun from the longer."""
    lasts = [flight.end_s - flight.start.time_s for flight in joined.flights[k : k + 2]]
    dropped = k if lasts[0] < lasts[1] else k + 1
    starts = [flight.start for j, flight in enumerate(joined.flights) if j != dropped]
    links = [link for j, link in enumerate(joined.links) if j != k]
    return rules.fit(seen, starts, links, joined.scatter)


def _without_ghosts(seen: Observations, joined: FlightChain, die: Die, rules: Priors) -> FlightChain:
    """The chain without open links at which nothing can have struck: the motion before, followed on to where the next
    flight is sure, stays clear of the table."""
    strikes = _strikes(die)
    for k, link in reversed(_numbered(joined)):
        if not link.is_open or not strikes:
            continue
        inside = np.flatnonzero((seen.time_s > link.time_s) & (joined.weights > 0.5))
        until = float(seen.time_s[inside[0]]) if len(inside) else link.time_s
        times = np.linspace(link.time_s, max(until, link.time_s + 4.0 * _spacing(seen)), 24)
        lowest = min(_height(joined.flights[k].at(float(t)), strikes) for t in times)
        if lowest - joined.table_m < CLEAR_SHARE * die.solid.edge_m:
            continue
        starts = [flight.start for j, flight in enumerate(joined.flights) if j != k + 1]
        links = [other for j, other in enumerate(joined.links) if j != k]
        joined = rules.fit(seen, starts, links, joined.scatter)
        joined = rules.again(seen, joined, joined.links, _scatter_of(seen, joined))
    return joined


def _with_quick_ones(
    seen: Observations, joined: FlightChain, die: Die, rules: Priors
) -> tuple[Observations, FlightChain]:
    """The frames and the chain with open links, and such as leave frames beside them unexplained, resolved where the
    model tells what may have happened there."""
    strikes, scatter = _strikes(die), joined.scatter

    def fit(own: Observations, starts: Sequence[State], links: Sequence[Link]) -> FlightChain:
        return rules.fit(own, starts, links, scatter)

    k = len(joined.links) - 1
    while k >= 0 and strikes:
        told = None
        if joined.links[k].is_open or is_crowded(seen, joined, k):
            told = resolved(seen, joined, k, die, strikes, fit)
        seen, joined, k = (told[0], told[1], told[2] - 1) if told else (seen, joined, k - 1)
    return seen, joined


def _spacing(seen: Observations) -> float:
    return float(np.median(np.diff(seen.time_s)))


def _height(state: State, strikes: list[VertexImpact]) -> float:
    """Of the lowest point of the die."""
    return float(state.position_m[2] + min(strike.arm(state.rotation)[2] for strike in strikes))


def normal_velocity(state: State, arm: Array) -> float:
    """Vertical velocity [m/s] of a point of the die at `arm` from its centre."""
    return float(state.velocity_m_s[2] + np.cross(state.omega_rad_s, arm)[2])


def normal_velocity_rows(before: State, after: State, arm: Array) -> Array:
    """Derivatives (2, 25) of the normal velocity of a point of the die before and after an impact with respect to the states
    on both sides and the instant, as `FlightChain.beside` has them."""
    rows = np.zeros((2, 25))
    for row, first, state in zip(rows, (0, 12), (before, after), strict=True):
        w = state.omega_rad_s
        # ẑ·(ω × (δθ × r)) = δθ·(r × (ẑ × ω)).
        row[first + 3 : first + 6] = np.cross(arm, np.cross([0.0, 0.0, 1.0], w))
        row[first + 8] = 1.0
        row[first + 9 : first + 12] = np.cross(arm, [0.0, 0.0, 1.0])
        # The corner of a spinning die changes its speed within the uncertainty of the instant: 500 m/s² is usual.
        row[24] = float(np.cross(w, np.cross(w, arm))[2]) - GRAVITY_M_S2
    return rows
