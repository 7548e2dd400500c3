"""The bounces of a track: flights found, joined, and each contact named.

What lies behind the last flight on the table is set aside (`rest`), the rest of the track is parted into flights
(`parting`), and what stands between them is found out (`links`), in two ways where one leaves a doubt. Each contact is then
named, with its instant, its vertices and the restitution that it shows; what cannot be told apart is an unresolved contact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, inner_vertices, lowest_face
from ...model.throw import Flight, Impact, State, Throw, energy_J
from ..camera import Camera
from ..track import Track
from .contact_clusters import instant_s
from .contacts import (
    FAR_SIGMAS,
    MOST_FRAMES,
    UNKNOWN_TABLE_M,
    Priors,
    ResolvedChain,
    explains_better,
    join_flights,
    normal_velocity,
    normal_velocity_rows,
    resolve_contacts,
)
from .flight_chain import TABLE_SIGMA_M, FlightChain, Link
from .flights import Observations
from .rest import SupportedMotion, first_low_row, first_supported_row, on_table, resting_vertices
from .segmentation import FEWEST, decimation_factor, rows_without_outliers, segment_flights
from .shared_bias import CONTOUR_FLOOR_PX, shared_bias_jacobian, shared_bias_sigma, without_shared_bias

Array = NDArray[np.float64]

UNMODELLED_SHARE = 0.1
"""Of the usual slack, where the scatter of the frames is measured: what keeps a frame that states no error in bounds."""
WIDER = 4.0
"""Factor on the sigmas of frames with which a track is parted into flights once more. Contacts close to each other are opened,
joined and removed one after the other, and a little decides which: where that leads astray with sigmas of one size, it may not
with another."""
MANY = 12
"""Links of a chain beyond which it is not asked for twice: a die that bounces on until it rattles to rest leaves doubts whatever
the sigmas, and stories of what happened there take most of the time."""
FEW_LOST = 0.05
"""Share of frames on no flight that leaves no doubt about a chain: some lie beside impacts."""
BORNE_OUT = 0.5
"""Share of its frames that a flight must go through."""
SAMPLES, SEED = 2000, 20120404
"""Draws behind the interval of a restitution."""


class NoFlightError(ValueError):
    """The track holds no flight that could be measured."""


@dataclass(frozen=True, eq=False)
class MeasuredThrow:
    """A throw as the frames have it, and what was learnt of the frames on the way."""

    throw: Throw
    frames: Track
    """The single frames with the error that they share taken out."""
    on_table: Track
    """The same with those that the table carries put on it."""
    joined: FlightChain
    rows: NDArray[np.int64]
    """(n,) rows of the track that the flights were fitted to."""
    floor: Array
    """(track rows, 6, 6) covariance of what the pose of each frame errs along with all others and no motion shows; already
    in the throw's."""
    own: Throw
    """The throw as sure as if there were no such errors."""

    @property
    def independent(self) -> Track:
        """The same as `on_table` with covariances as wide as a fit needs that takes the frames for independent of each other: a
        mean over a flight is then as sure as it is. What a model is fitted to."""
        return _independent(self.on_table, self.throw, self.joined, self.floor)

    @property
    def alone(self) -> NDArray[np.bool_]:
        """(track rows,) the frames at contacts that could not be told apart which lie on neither flight, and those of flights
        that they do not bear out."""
        out, sure = np.zeros(len(self.frames), bool), np.flatnonzero(self.joined.weights > 0.0)
        time_s = self.frames.time_s[self.rows]
        for part, true in zip(self.joined.parts(time_s), _believed(time_s, self.joined), strict=True):
            out[self.rows[part]] = not true
        for link in self.joined.links:
            at = np.searchsorted(time_s[sure], link.time_s)
            if link.is_open and 0 < at < len(sure):
                out[self.rows[sure[at - 1] + 1 : sure[at]]] = True
        return out


def measure_throw(track: Track, die: Die, camera: Camera | None = None, *, every: int = 1) -> Throw:
    """Flights with covariance and impacts with their uncertainty, from the poses of single frames.

    With the camera that saw them, the errors that all poses share are looked for. What comes after the last flight, where
    the die rolls or rests, is an impact `held` and a flight without covariance (`SupportedMotion`). The flights are fitted to
    one in `every` tracked frames. Raises NoFlightError where fewer than three of those in a row are tracked.
    """
    return measure(track, die, camera, every=every).throw


def measure(track: Track, die: Die, camera: Camera | None = None, *, every: int = 1) -> MeasuredThrow:
    """As `measure_throw`, with what was learnt of the frames, of all of them."""
    use = np.flatnonzero(track.tracked)[::every]
    if len(use) < FEWEST:
        raise NoFlightError(f"{_frames(len(use))} tracked: wanted at least three in a row to measure a flight")
    tracked, use = len(use), use[rows_without_outliers(observations_of(track, use), die)]
    if len(use) < FEWEST:
        raise NoFlightError(
            f"{_frames(tracked)} tracked, and {len(use)} of them move as a die can: wanted at least three in a row to measure "
            "a flight"
        )
    lean = np.zeros((len(track), 6, 0))
    seen = observations_of(track, use, UNMODELLED_SHARE)
    # Whether a die falls is asked with covariances as calibrated, where they are: unlike the fits, that finds no scatter itself.
    as_stated = seen if track.own is None else observations_of(replace(track, own=None), use, UNMODELLED_SHARE)
    flying = first_supported_row(as_stated, die)
    prior = sigma = np.zeros(0)
    if camera is not None:
        lean, sigma = shared_bias_jacobian(track, camera, die), shared_bias_sigma(track, camera, die)
        seen, prior = seen.leaning(lean[use, :, :1]), sigma[:1]
    if flying < FEWEST:
        raise NoFlightError(f"{flying} frames show the die in flight: wanted at least three in a row")
    limit_s = instant_s(seen.time_s)
    low = first_low_row(seen, die) if flying < len(use) else len(use)
    while True:
        # Where flights part is looked for on fewer frames than they are then fitted to, where so many show it.
        ahead = slice(0, flying)
        some = observations_of(track, use[ahead][:: decimation_factor(track, die, use[ahead])])
        joined = _settled(some, seen.rows(ahead), die, Priors(prior, TABLE_SIGMA_M if camera else UNKNOWN_TABLE_M))
        flights, impacts = joined.flights, _impacts(joined, _believed(seen.time_s[ahead], joined), die, limit_s)
        told = _last_told(impacts, float(seen.time_s[max(low, FEWEST)]) if max(low, FEWEST) < flying else np.inf)
        if told == len(impacts):
            break
        flying = int(np.searchsorted(seen.time_s, impacts[told].time_s))
    floor = _floor(track, lean, sigma, use, flying)
    straight = without_shared_bias(track, lean[:, :, : len(joined.shared)], joined.shared)
    resting = straight
    if flying < len(use):
        if camera is not None and determines_table_height(joined):
            carried = track.tracked & (track.time_s >= track.time_s[use[flying]])
            resting = on_table(straight, np.flatnonzero(carried), die, joined.table_m, TABLE_SIGMA_M)
        poses, last_s = observations_of(resting, use[flying:]), float(seen.time_s[flying - 1])
        flights, impacts = _at_rest(flights, impacts, poses, last_s, die)
    own = Throw(flights, impacts)
    throw = _with_floors(own, track.time_s[use[:flying]], floor[use[:flying]])
    return MeasuredThrow(throw, straight, resting, joined, use[:flying], floor, own)


def _settled(some: Observations, seen: Observations, die: Die, rules: Priors) -> FlightChain:
    """The chain of flights through frames, which are parted on `some` of them. Where it leaves a doubt, a chain that wider sigmas
    lead to is asked for as well, and the one that explains the frames better is taken."""
    found = resolve_contacts(seen, join_flights(some, segment_flights(some, die), die), die, rules)
    if _is_beyond_doubt(found, die) or len(found.joined.links) > MANY:
        return found.joined
    wide = replace(some, whitener=some.whitener / WIDER)
    other = resolve_contacts(seen, join_flights(wide, segment_flights(wide, die), die), die, rules)
    return other.joined if explains_better(seen, other, found) else found.joined


def _is_beyond_doubt(found: ResolvedChain, die: Die) -> bool:
    """Whether every link is an impact, at a vertex where the die lets that be told, and most frames of each flight lie on it, and
    few on none. Of a flight without frames that is not known."""
    joined = found.joined
    if any(link.is_open or (die.is_spherical_top and link.strike is None) for link in joined.links):
        return False
    borne_out = bool((joined.borne_out(found.seen.time_s) >= MOST_FRAMES).all())
    return borne_out and float((joined.weights == 0.0).mean()) < FEW_LOST


def _floor(track: Track, lean: Array, sigma: Array, use: NDArray[np.int64], flying: int) -> Array:
    """(track rows, 6, 6) covariance of what poses err alike, of frames that are used, `flying` of them in flight, and the nearest
    one's of the others: by edges, whose `lean` (track rows, 6, m) has priors `sigma` (m,), none without a camera, or by marks."""
    floor = np.zeros((len(track), 6, 6))
    if len(sigma):
        left = np.tile(np.append(CONTOUR_FLOOR_PX, sigma[1:]), (len(use), 1))
        # How far out the contour of a die seems that the table carries, amid its shadow, flights do not tell.
        left[flying:, 0] = sigma[0]
        floor[use] = (lean[use] * left[:, None] ** 2) @ np.swapaxes(lean[use], 1, 2)
    if track.shared is not None and np.isfinite(track.shared[use]).any():
        # Poses that rest on marks do not share the errors of edges but those of the places of the marks. Of a die that the
        # table carries they rest on edges.
        by_edges = np.isnan(track.shared[use]).any((1, 2)) & (np.arange(len(use)) >= flying)
        floor[use[~by_edges]] = track.shared[use[~by_edges]]
    return _filled(floor, use)


def determines_table_height(joined: FlightChain) -> bool:
    """Whether impacts tell the height of the table, and it is about where the scene has it."""
    struck = any(link.strike is not None for link in joined.links)
    return struck and abs(joined.table_m) < FAR_SIGMAS * TABLE_SIGMA_M


def _last_told(impacts: tuple[Impact, ...], low_s: float) -> int:
    """How many impacts there are until those at the end, behind `low_s`, of which none is surely a rebound, one that loses
    something or as much as the others do: a die that tips over seems to hop on and on. What comes behind is part of coming to
    rest."""
    usual = float(np.nanmedian([impact.chi for impact in impacts])) if any(i.chi_low > 0.0 for i in impacts) else np.nan
    count = len(impacts)
    while count and impacts[count - 1].time_s >= low_s:
        last = impacts[count - 1]
        if last.chi_low > 0.0 and (last.chi_high < 1.0 or last.chi_low < usual < last.chi_high):
            break
        count -= 1
    return count


def _frames(count: int) -> str:
    return "1 frame is" if count == 1 else f"{count} frames are"


def with_calibrated_covariance(track: Track, die: Die, camera: Camera | None = None, *, every: int = 1) -> Track:
    """The track with its covariances scaled to how the poses scatter about their own flights, slow errors included, and
    with what all poses err alike added. The poses stay as they are; without a flight, all does."""
    try:
        found = measure(track, die, camera, every=every)
    except NoFlightError:
        return track
    use = np.flatnonzero(track.tracked)
    root = np.linalg.inv(observations_of(track, use, UNMODELLED_SHARE).whitener)
    covariance = track.covariance.copy()
    covariance[use] = (root * found.joined.scatter.variance) @ np.swapaxes(root, 1, 2) + found.floor[use]
    return replace(track, covariance=covariance, own=track.covariance if track.own is None else track.own)


def _independent(track: Track, throw: Throw, joined: FlightChain, floor: Array) -> Track:
    """The track with slow errors counted as they count in a mean over many frames, and with those that all frames of a
    flight share multiplied by the number of its frames. Of a die that the table carries the table tells them."""
    use = np.flatnonzero(track.tracked)
    spacing_s = float(np.median(np.diff(track.time_s[use])))
    flight = throw.flights_at(track.time_s[use])
    is_flown = np.array([one.covariance is not None for one in throw.flights])
    count = np.where(is_flown, np.bincount(flight, minlength=len(is_flown)), 0)[flight]
    if track.own is not None:
        # A frame that the table carries belongs to no mean: it is as sure as it was said to be, or as the table makes it.
        use, count = use[count > 0], count[count > 0]
    root = np.linalg.inv(observations_of(track, use, UNMODELLED_SHARE).whitener)
    covariance = track.covariance.copy()
    slow = (root * joined.scatter.slow_variance(spacing_s)) @ np.swapaxes(root, 1, 2)
    covariance[use] = slow + count[:, None, None] * floor[use]
    return replace(track, covariance=covariance, own=None)


def observations_of(track: Track, use: NDArray[np.int64], slack: float = 1.0) -> Observations:
    """Some rows of a track as the fits want them: as sure as the pixels of each frame make it. How frames scatter, and what all
    err alike, fits find by themselves; stated beforehand, it hid weak bounces of rounded dice."""
    own = track.covariance if track.own is None else track.own
    return Observations.from_poses(
        track.time_s[use], track.position_m[use], track.quaternion[use], own[use], slack=slack
    )


def _filled(floor: Array, use: NDArray[np.int64]) -> Array:
    """Floors (n, 6, 6) of all rows of a track, given those of the rows in use, some NaN: the others take the nearest one.
    None was known of a frame that could not be refined on marks, and lost frames may yet be told by their flight."""
    known, rows = use[np.isfinite(floor[use]).all((1, 2))], np.arange(len(floor))
    right = np.minimum(np.searchsorted(known, rows), len(known) - 1)
    left = np.maximum(right - 1, 0)
    return np.asarray(floor[known[np.where(rows - known[left] < known[right] - rows, left, right)]])


def _with_floors(throw: Throw, time_s: Array, floor: Array) -> Throw:
    """The throw with the floors (n, 6, 6) of its frames at some instants (n,): each flight with the middling one of its own."""
    flight_of = throw.flights_at(time_s)
    middles = [
        _middle_one(floor[flight_of == k] if np.any(flight_of == k) else floor) for k in range(len(throw.flights))
    ]
    return replace(
        throw, flights=tuple(_with_floor(flight, middle) for flight, middle in zip(throw.flights, middles, strict=True))
    )


def _middle_one(covariances: Array) -> Array:
    """The covariance (6, 6) of middling size among several (n, 6, 6).

    The median number by number would be no covariance: it can have negative eigenvalues.
    """
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    size = (variances / np.maximum(np.median(variances, axis=0), 1e-300)).sum(1)
    return np.asarray(covariances[np.argsort(size)[len(covariances) // 2]])


def _with_floor(flight: Flight, floor: Array) -> Flight:
    """The flight with a pose error that stays the same all through: turned poses turn the spin with them. What the table
    carries has no covariance, and is left as it is."""
    if flight.covariance is None:
        return flight
    x, y, z = flight.start.omega_rad_s
    spread = np.zeros((12, 6))
    spread[:6] = np.eye(6)
    spread[9:, 3:] = -np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return replace(flight, covariance=flight.covariance + spread @ floor @ spread.T)


def _at_rest(
    flights: tuple[Flight, ...], impacts: tuple[Impact, ...], seen: Observations, last_s: float, die: Die
) -> tuple[tuple[Flight, ...], tuple[Impact, ...]]:
    """Flights and impacts with the end that the table carries, from between the last frame in flight and the next."""
    begin, end = 0.5 * (last_s + float(seen.time_s[0])), float(seen.time_s[-1])
    carried = SupportedMotion(
        start=State(begin, seen.position_m[0], seen.quaternion[0], np.zeros(3), np.zeros(3)),
        end_s=end,
        times_s=seen.time_s,
        positions_m=seen.position_m,
        quaternions=seen.quaternion,
    )
    struck = sum(impact.time_s < begin for impact in impacts)
    flights, impacts = flights[: struck + 1], impacts[:struck]
    before, after = flights[-1].at(begin), carried.at(begin)
    held = Impact(
        begin, "held", resting_vertices(die, carried.at(end).rotation), before.position_m[:2], np.full(3, np.nan),
        np.nan, np.nan, energy_J(die, before), energy_J(die, after),
        lowest_face(die.solid, before.rotation), lowest_face(die.solid, carried.at(end).rotation),
    )  # fmt: skip
    return (*flights[:-1], replace(flights[-1], end_s=begin), carried), (*impacts, held)


def _believed(time_s: Array, joined: FlightChain) -> NDArray[np.bool_]:
    """(flights,) which flights BORNE_OUT of their frames, at instants (n,), lie on. What they miss another contact may be, or a
    die that rolls: such a flight is where the fit had to put it."""
    return ~(joined.borne_out(time_s) <= BORNE_OUT)


def _impacts(joined: FlightChain, believed: NDArray[np.bool_], die: Die, limit_s: float) -> tuple[Impact, ...]:
    """What each link says about its bounce; nothing where a flight beside it is none, or its instant is less sure than
    `limit_s`."""
    return tuple(
        _impact(joined, die, k, limit_s, told=bool(believed[k] and believed[k + 1])) for k in range(len(joined.links))
    )


def _impact(joined: FlightChain, die: Die, k: int, limit_s: float, *, told: bool) -> Impact:
    """One bounce: contact, velocities of the contact point on both sides, apparent restitution with its interval."""
    link, before, after = joined.links[k], joined.flights[k], joined.flights[k + 1]
    t = link.time_s
    a, b = before.at(t), after.at(t)
    touching, arm = _contact(link, die, a)
    v_before, v_after = normal_velocity(a, arm), normal_velocity(b, arm)
    known = joined.sigma_time_s[k] < limit_s
    is_resolved = told and not link.is_open and known and v_before < 0.0 < v_after
    contact = {1: "vertex", 2: "edge"}.get(len(touching), "face") if is_resolved else "unresolved"
    chi, low, high = np.nan, np.nan, np.nan
    if is_resolved:
        chi = -v_after / v_before
        low, high = _chi_interval(joined.beside[k], a, b, arm)
    middle_before = before.at(0.5 * (before.start.time_s + before.end_s))
    middle_after = after.at(0.5 * (after.start.time_s + after.end_s))
    return Impact(
        t,
        contact,
        touching if is_resolved else (),
        (a.position_m + arm)[:2],
        die.mass_kg * (b.velocity_m_s - a.velocity_m_s),
        v_before,
        v_after,
        energy_J(die, a),
        energy_J(die, b),
        lowest_face(die.solid, middle_before.rotation),
        lowest_face(die.solid, middle_after.rotation),
        sigma_time_s=float(joined.sigma_time_s[k]),
        chi=chi,
        chi_low=low,
        chi_high=high,
    )


def _contact(link: Link, die: Die, state: State) -> tuple[tuple[int, ...], Array]:
    """The vertices that touch, and the contact point (3,) from the centre."""
    inner = inner_vertices(die.solid, die.corner_radius_m)
    if link.strike is not None:
        vertex = int(np.argmin(np.linalg.norm(inner - link.strike.point_m, axis=1)))
        return (vertex,), link.strike.arm(state.rotation)
    touching = resting_vertices(die, state.rotation)
    arms = inner[list(touching)] @ state.rotation.T
    return touching, np.asarray(arms.mean(0) - np.array([0.0, 0.0, die.corner_radius_m]))


def _chi_interval(beside: Array, before: State, after: State, arm: Array) -> tuple[float, float]:
    """95 % interval of the apparent restitution, by drawing both velocities from their joint covariance: that of the states
    on both sides and of the instant (25, 25)."""
    rows = normal_velocity_rows(before, after, arm)
    values, vectors = np.linalg.eigh(rows @ beside @ rows.T)
    draws = np.random.default_rng(SEED).standard_normal((SAMPLES, 2)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    v_before, v_after = (np.array([normal_velocity(state, arm) for state in (before, after)]) + draws).T
    low, high = np.percentile(-v_after / v_before, [2.5, 97.5])
    return float(low), float(high)
