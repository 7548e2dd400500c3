"""The whole throw at once: χ and the twelve initial conditions whose exact throw lies nearest to the frames.

The model is a throw with smooth impacts at prescribed vertices (`model.tangent.propagate`, with exact derivatives), and
the fit a weighted least squares over the poses of all frames (`sightings`), with a loss that bad frames cannot bend
(`robust`). Three things make it converge although the motion is chaotic, an error growing about twenty-fold a bounce:

- the window grows bounce by bounce, and into each new flight by few frames first, so that the state is always known
  well enough for the next step to be nearly linear;
- the unknowns are u with x = x₀ + T⁻¹ u, where Tᵀ T is the information of the step before: directions that the bounces
  stretch a million-fold and directions that they leave alone become alike;
- which vertices touch is not left to the model while it is fitted. The measured vertex is tried first; where that is
  unknown, not explained, or followed by too few frames to tell, the sequences that throws drawn from the fit make by
  themselves are tried as well, and the best few are kept until later frames decide.

The fit ends at the first bounce that the model cannot explain: where the frames lie more than `MISFIT` times as far
from every such throw as they scatter about free flights. A wrong vertex or a law that does not hold (friction) misses
by tens; errors that tracking repeats from frame to frame, which a flight can absorb and a throw cannot, stay below.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from ..model.motion import Impact, State, Throw
from ..model.solids import Die
from ..model.tangent import Propagation, propagate
from ..tracking.track import Track
from .corners import raised_state, raised_throw, raised_track, sharp_equivalent
from .flights import FEWEST_FRAMES, FreeFlights, fit_flights, left_jacobian, moved_state
from .impulses import Bounce, common_restitution, measure_bounces
from .intervals import chi_interval, variance_inflation
from .landing import continued, landing_odds, resting_face
from .results import Effect, Fit, Parameter
from .robust import CLEAN_FRAME, condensed, huber, triangle
from .sightings import Sightings, pose_errors, sight, whitened, whitened_jacobian

Array = NDArray[np.float64]

MISFIT = 2.5
"""Largest ratio of the residuals of a throw to those of free flights at which the throw still counts as explained."""

LEVEL = 0.95

_TELLING = 8
"""Frames of a flight that tell one vertex from another; with fewer, rival sequences are carried along."""

_HOPELESS = 20.0
"""Times the allowed mean square at which a sequence is given up before all frames of a flight are in."""

_BEAM = 3
_DRAWS = 32

_FIRST_CHI_SIGMA = 0.3
"""Scale of the steps of χ before any bounce; it has no weight in a fit."""

_WINDOWS = (4, 12, 40)
"""Frames of a new flight in the first fits of it; the last takes all."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One model throw fitted to the frames of the first flights."""

    state: State
    chi: float
    vertices: tuple[int, ...]
    reached: int
    """The last measured flight whose frames are in the fit."""
    sightings: Sightings
    """The frames in the fit."""
    residuals: Array
    """(n, 6) whitened."""
    root: Array
    """(13, 13) upper triangular T, Tᵀ T the information on state and χ."""
    throw: Throw

    @property
    def mean_square(self) -> float:
        """Of the whitened residuals."""
        return float((self.residuals**2).mean())


def fit_throw(track: Track, measured: Throw, die: Die) -> Fit:
    """χ and the initial conditions of a tracked throw, with intervals, from all bounces that the model explains.

    `track` holds the poses of single frames (not smoothed: their errors must be independent), `measured` the flights
    and impacts found in them. What the data do not carry is None in the result, with a message.
    Raises ValueError for a track whose columns do not fit together.
    """
    radius = die.corner_radius_m
    lowered = raised_track(track, -radius), raised_throw(die, measured, -radius)
    fit = _fit_sharp(*lowered, sharp_equivalent(die))
    rested = resting_face(track, die)
    return replace(
        fit,
        initial=None if fit.initial is None else raised_state(fit.initial, radius),
        chosen=fit.chosen if radius == 0.0 or not fit.chosen else (*fit.chosen, "rounded corners"),
        landed_face=fit.landed_face if rested is None else rested,
        throw=None if fit.throw is None else raised_throw(die, fit.throw, radius),
    )


def _fit_sharp(track: Track, measured: Throw, die: Die) -> Fit:
    """The fit of a die with sharp corners."""
    free = fit_flights(sight(track, measured), measured)
    messages = list(_frame_messages(free))
    first = next((k for k, flight in enumerate(free.flights) if flight is not None), None)
    if first is None:
        return _nothing(messages, "no flight has two frames with a pose: neither the start nor chi can be determined.")
    if first > 0:
        messages.append(f"The fit begins after bounce {first}: the frames before it do not make a flight.")
    bounces = measure_bounces(die, free, measured.impacts)
    beam = [_opening(free, first, chi) for chi in _first_chi(bounces, first)]
    if len(measured.flights) == first + 1:
        messages.append("chi cannot be determined: the track shows no bounce after the first flight.")
        return _unbounded(track, die, beam[0], free, messages)
    if not _can_go_on(free, first):
        messages.append("chi cannot be determined: no flight after the first bounce has two frames clear of impacts.")
        return _unbounded(track, die, beam[0], free, messages)
    shots = _through_the_bounces(die, beam, measured, free)
    if not shots[0].vertices and shots[0].reached > first:
        messages.append("chi cannot be determined: the frames make one flight, through every bounce that was measured.")
        return _unbounded(track, die, shots[0], free, messages)
    if shots[0].reached == first:
        return _unexplained(track, die, shots[0], measured, free, bounces, messages)
    return _explained(track, die, shots, measured, free, messages, first)


def shoot(
    die: Die,
    sightings: Sightings,
    start: Shot,
    vertices: tuple[int, ...],
    k2: float,
    *,
    hold_chi: bool = False,
) -> Shot:
    """The throw through `vertices` nearest to the frames, started from another shot. `k2` as in `robust.huber`."""
    free = 12 if hold_chi else 13
    to_change = solve_triangular(start.root[:free, :free], np.eye(free))

    def change(u: Array) -> Array:
        full = np.zeros(13)
        full[:free] = to_change @ u
        return full

    def run(u: Array) -> tuple[Array, Array, Propagation]:
        x = change(u)
        chi = float(np.clip(start.chi + x[12], 0.0, 1.0))
        model = propagate(die, moved_state(start.state, x[:12]), chi, sightings.time_s, vertices=vertices)
        errors = pose_errors(sightings, model.positions_m, model.quaternions)
        jacobian = model.jacobian.copy()
        jacobian[:, :, 3:6] = jacobian[:, :, 3:6] @ left_jacobian(x[3:6])
        return whitened(sightings, errors), whitened_jacobian(sightings, errors, jacobian), model

    last: dict[bytes, tuple[Array, Array, Propagation]] = {}

    def cached(u: Array) -> tuple[Array, Array, Propagation]:
        # least_squares asks for residuals and derivatives one after the other; both come from one run.
        if u.tobytes() not in last:
            last.clear()
            last[u.tobytes()] = run(u)
        return last[u.tobytes()]

    def scaled(u: Array) -> Array:
        residuals, jacobian, _ = cached(u)
        residuals, jacobian = huber(residuals, jacobian, k2)
        return condensed(residuals.ravel(), jacobian.reshape(-1, 13)[:, :free])

    def residual(u: Array) -> Array:
        return scaled(u)[:, free]

    def derivative(u: Array) -> Array:
        return scaled(u)[:, :free] @ to_change

    low, high = np.full(free, -np.inf), np.full(free, np.inf)
    if not hold_chi:  # χ is the last unknown and T is triangular, so its bounds are those of the last u alone
        low[12], high[12] = -start.chi * start.root[12, 12], (1.0 - start.chi) * start.root[12, 12]
    solution = least_squares(
        residual,
        np.zeros(free),
        jac=derivative,
        bounds=(low, high),
        ftol=1e-8,
        xtol=1e-9,
        max_nfev=40,
    )
    x = change(solution.x)
    residuals, jacobian, model = cached(solution.x)
    jacobian = huber(residuals, jacobian, k2)[1]
    jacobian[:, :, 3:6] = jacobian[:, :, 3:6] @ np.linalg.inv(left_jacobian(x[3:6]))
    return replace(
        start,
        state=moved_state(start.state, x[:12]),
        chi=float(np.clip(start.chi + x[12], 0.0, 1.0)),
        vertices=vertices,
        sightings=sightings,
        residuals=residuals,
        root=_root(jacobian.reshape(-1, 13)),
        throw=model.throw,
    )


def _through_the_bounces(die: Die, beam: list[Shot], measured: Throw, free: FreeFlights) -> list[Shot]:
    """Lengthen the fit flight by flight while the model explains them: the best shots, the best first."""
    for target in range(beam[0].reached + 1, len(measured.flights)):
        few = free.sightings.count(target)
        longer = _lengthened(die, beam, target, measured, free) if few >= FEWEST_FRAMES else []
        if longer:
            beam = longer
        elif few >= _TELLING:
            break
        # A short flight may belong to a contact that was not resolved: pass over its frames and try the next.
    return beam


def _can_go_on(free: FreeFlights, reached: int) -> bool:
    """Whether any flight after this one has frames enough to be fitted."""
    return any(free.sightings.count(k) >= FEWEST_FRAMES for k in range(reached + 1, len(free.flights)))


def _lengthened(die: Die, beam: list[Shot], target: int, measured: Throw, free: FreeFlights) -> list[Shot]:
    """The shots that explain the frames up to flight `target` too, best first; none if no sequence does."""
    found: list[tuple[bool, float, Shot]] = []
    telling = free.sightings.count(target) >= _TELLING
    for shot in beam:
        impacts = measured.impacts[shot.reached : target]
        tried: set[tuple[int, ...]] = set()
        for source in (_measured_sequences, _listed_sequences, _simulated_sequences, _no_sequence):
            for sequence in source(die, shot, impacts, target, free):
                if sequence not in tried:
                    tried.add(sequence)
                    longer = _reach(die, shot, sequence, target, free)
                    if longer is not None and _is_explained(longer, free):
                        found.append((_own_sequence(die, longer) != longer.vertices, longer.mean_square, longer))
            if telling and any(not forced for forced, _, _ in found):
                break
    # Throws that take those vertices by themselves come before throws that have to be told.
    distinct = {shot.vertices: shot for _, _, shot in sorted(found, key=lambda f: f[:2], reverse=True)}
    return list(reversed(distinct.values()))[:_BEAM]


def _reach(
    die: Die, shot: Shot, sequence: tuple[int, ...], target: int, free: FreeFlights, *, patient: bool = False
) -> Shot | None:
    """The shot fitted on through more impacts to the end of flight `target`; None if one of them never happens.

    Unless `patient`, None as well as soon as the fit is hopelessly far from the frames.
    """
    vertices = shot.vertices + sequence
    mine = np.flatnonzero(free.sightings.flight == target)
    old = np.flatnonzero(np.isin(free.sightings.flight, np.unique(shot.sightings.flight)))
    k2 = CLEAN_FRAME * max(1.0, free.variance)
    for count in [*(n for n in _WINDOWS if n < len(mine)), len(mine)]:
        # Few frames say little of χ and the state, so the preconditioner of the step before stands in for them.
        shot = shoot(die, free.sightings.where(np.concatenate([old, mine[:count]])), shot, vertices, k2)
        if not patient and max(_mean_squares(shot).values()) > _HOPELESS * MISFIT**2 * max(1.0, free.variance):
            return None
    clear = _clear_of_impacts(shot)
    if not clear.all():
        shot = shoot(die, shot.sightings.where(clear), shot, vertices, k2)
    happened = len(shot.throw.impacts) == len(vertices) and shot.sightings.count(target) >= FEWEST_FRAMES
    return replace(shot, reached=target) if happened else None


def _clear_of_impacts(shot: Shot) -> NDArray[np.bool_]:
    """Frames (n,) of a shot at least half an interval from each of its impacts; see `sightings`."""
    instants = np.array([impact.time_s for impact in shot.throw.impacts])
    if not len(instants):
        return np.ones(len(shot.sightings), bool)
    away = np.abs(shot.sightings.time_s[:, None] - instants).min(1)
    return np.asarray(away >= 0.5 * shot.sightings.interval_s)


def _is_explained(shot: Shot, free: FreeFlights) -> bool:
    """Whether no flight lies farther from the throw than `MISFIT` times what free flights leave."""
    for k, mean_square in _mean_squares(shot).items():
        alone = free.flights[k]
        allowed = max(1.0, free.variance)
        if alone is not None and alone.frames > FEWEST_FRAMES:
            # A blurred flight scatters more than the others; one that hides a bounce far more, which excuses nothing.
            allowed = float(np.clip(alone.variance, allowed, 4.0 * allowed))
        if mean_square > MISFIT**2 * allowed:
            return False
    return True


def _mean_squares(shot: Shot) -> dict[int, float]:
    """Of the whitened residuals, flight by flight."""
    flight = shot.sightings.flight
    return {int(k): float((shot.residuals[flight == k] ** 2).mean()) for k in np.unique(flight)}


def _measured_sequences(
    die: Die, shot: Shot, impacts: Sequence[Impact], target: int, free: FreeFlights
) -> list[tuple[int, ...]]:
    """The vertices as measured, if each impact has just one."""
    single = all(impact.contact == "vertex" and len(impact.vertices) == 1 for impact in impacts)
    return [tuple(impact.vertices[0] for impact in impacts)] if single else []


def _listed_sequences(
    die: Die, shot: Shot, impacts: Sequence[Impact], target: int, free: FreeFlights
) -> list[tuple[int, ...]]:
    """Ends of a measured edge or corners of a face, one or two of them, one after the other."""
    if any(not impact.vertices for impact in impacts):
        return []
    options = [[*((v,) for v in impact.vertices), *permutations(impact.vertices, 2)] for impact in impacts]
    return [sum(parts, ()) for parts in product(*options)][:24]


def _simulated_sequences(
    die: Die, shot: Shot, impacts: Sequence[Impact], target: int, free: FreeFlights
) -> list[tuple[int, ...]]:
    """What throws drawn from the fit do by themselves until the first frame of the target flight, the commonest first.

    Each also without its last impacts: a draw may be early.
    """
    until = free.sightings.time_s[free.sightings.flight == target][0]
    spread = solve_triangular(shot.root, np.eye(13)) * np.sqrt(max(1.0, free.variance))
    rng = np.random.default_rng(0)
    seen: Counter[tuple[int, ...]] = Counter()
    done = len(shot.vertices)
    for k in range(_DRAWS):
        x = spread @ rng.standard_normal(13) if k else np.zeros(13)
        try:
            chi = float(np.clip(shot.chi + x[12], 0.0, 1.0))
            throw = propagate(die, moved_state(shot.state, x[:12]), chi, [until]).throw
        except ValueError:  # a draw that starts below the table or chatters is no throw, and says nothing
            continue
        sequence = tuple(impact.vertices[0] for impact in throw.impacts)
        if sequence[:done] == shot.vertices:
            for end in range(done + 1, len(sequence) + 1):
                seen[sequence[done:end]] += 1 if end < len(sequence) else 2
    return [sequence for sequence, _ in seen.most_common(8)]


def _no_sequence(
    die: Die, shot: Shot, impacts: Sequence[Impact], target: int, free: FreeFlights
) -> list[tuple[int, ...]]:
    """No impact at all: tracking may have taken a few bad frames for a bounce."""
    return [()]


def _opening(free: FreeFlights, first: int, chi: float) -> Shot:
    """The first flight alone, as a shot that knows nothing of χ."""
    flight = free.flights[first]
    assert flight is not None
    assert flight.flight.covariance is not None
    own = free.sightings.where(free.sightings.flight == first)
    errors = pose_errors(own, *flight.flight.poses(own.time_s))
    root = np.zeros((13, 13))
    sigma = np.sqrt(np.diag(flight.flight.covariance))
    correlation = flight.flight.covariance / np.outer(sigma, sigma)
    root[:12, :12] = _root(np.linalg.cholesky(np.linalg.inv(correlation)).T / sigma)
    root[12, 12] = 1.0 / _FIRST_CHI_SIGMA
    throw = Throw((flight.flight,), ())
    return Shot(flight.flight.start, chi, (), first, own, whitened(own, errors), root, throw)


def _first_chi(bounces: Sequence[Bounce | None], first: int) -> list[float]:
    """Where χ starts: the apparent restitution of the first bounce, or several values where there is none."""
    bounce = bounces[first] if first < len(bounces) else None
    if bounce is not None and 0.02 < bounce.chi < 0.98:
        return [bounce.chi]
    return [0.55, 0.85, 0.25]


def _root(jacobian: Array) -> Array:
    """Upper triangular T with a positive diagonal and Tᵀ T = Jᵀ J."""
    root = triangle(jacobian)
    if len(root) == 13 and root[12, 12] < 1e-6:
        # Without an impact χ moves nothing, and without a diagonal there are no steps: give it that of the first ones.
        root[12, 12] = 1.0 / _FIRST_CHI_SIGMA
    return root


def _explained(
    track: Track, die: Die, shots: list[Shot], measured: Throw, free: FreeFlights, messages: list[str], first: int
) -> Fit:
    """The result of a fit through one bounce or more."""
    shot = shots[0]
    total, explained = len(measured.impacts) - first, shot.reached - first
    messages += _bounce_messages(die, shots, free, total, explained)
    scale, words = _inflation(shot)
    messages += words
    chi = _chi_parameter(die, shot, free, scale, messages)
    covariance = _covariance(shot.root) * scale
    throw = continued(die, shot.throw, shot.chi, float(track.time_s[-1]))
    face, odds, landing_words = landing_odds(die, shot.throw, shot.chi, shot.state, covariance, shot.vertices)
    messages += landing_words
    return Fit(
        parameters={"chi": chi},
        initial=shot.state,
        initial_covariance=covariance[:12, :12],
        chosen=("smooth impact",),
        considered=_left_out(shot.mean_square),
        bounces_fitted=explained,
        residual_rms=float(np.sqrt(shot.mean_square)),
        landed_face=face,
        face_odds=odds,
        messages=tuple(messages),
        throw=throw,
    )


def _unexplained(
    track: Track,
    die: Die,
    opening: Shot,
    measured: Throw,
    free: FreeFlights,
    bounces: Sequence[Bounce | None],
    messages: list[str],
) -> Fit:
    """The result where no throw runs through the first bounce: the first flight, and χ from the bounces one by one."""
    attempt = _best_attempt(die, opening, measured, free)
    rms = None if attempt is None else float(np.sqrt(attempt.mean_square))
    missed = "no throw reaches the next flight"
    if attempt is not None:
        worst = np.sqrt(max(_mean_squares(attempt).values()))
        missed = f"the best throw misses the frames of one of the two flights by {worst:.1f} sigma (rms)"
    messages.append(
        f"The model explains 0 of {len(measured.impacts) - opening.reached} bounces; {missed}: the impacts are not "
        "smooth (friction would show so), or the frames' errors are far larger than they state. The start is that of "
        "the first flight alone."
    )
    common = common_restitution(bounces[opening.reached :], level=LEVEL)
    sideways = [b.smooth_sigmas for b in bounces if b is not None and np.isfinite(b.smooth_sigmas)]
    if sideways:
        messages.append(
            f"Bounce by bounce the impulses miss those of a smooth impact by up to {max(sideways):.1f} sigma (rms)."
        )
    fit = _unbounded(track, die, opening, free, messages)
    if common is None:
        messages.append("chi cannot be determined: no bounce has two flights that fix its normal velocities.")
        return replace(fit, residual_rms=rms, messages=tuple(messages))
    count = sum(b is not None for b in bounces[opening.reached :])
    messages.append(
        f"chi is the ratio of normal velocities at {count} bounce{'s' if count > 1 else ''}, which needs no law of "
        "impact; its interval includes their scatter."
    )
    chi = _bounded(*common)
    if chi.low == 0.0 and chi.high == 1.0:
        chi = Parameter(None, None, None, None, True, False)
        messages[-1] = "chi cannot be determined: the ratios of normal velocities at the bounces contradict each other."
    throw = None if chi.value is None else continued(die, opening.throw, chi.value, float(track.time_s[-1]))
    return replace(fit, parameters={"chi": chi}, residual_rms=rms, messages=tuple(messages), throw=throw)


def _best_attempt(die: Die, opening: Shot, measured: Throw, free: FreeFlights) -> Shot | None:
    """The shot nearest to the frames up to the next flight that has any, explained or not."""
    targets = range(opening.reached + 1, len(measured.flights))
    target = next((k for k in targets if free.sightings.count(k) >= FEWEST_FRAMES), None)
    if target is None:
        return None
    impacts = measured.impacts[opening.reached : target]
    sequences = [
        *_measured_sequences(die, opening, impacts, target, free),
        *_simulated_sequences(die, opening, impacts, target, free)[:2],
    ]
    reached = [_reach(die, opening, sequence, target, free, patient=True) for sequence in sequences]
    return min((shot for shot in reached if shot is not None), key=lambda s: s.mean_square, default=None)


def _unbounded(track: Track, die: Die, opening: Shot, free: FreeFlights, messages: list[str]) -> Fit:
    """The result without any bounce: the first flight; χ stays unknown."""
    freedom = max(6 * len(opening.sightings) - 12, 1)
    variance, tau = variance_inflation(opening.residuals, freedom, opening.sightings.flight)
    first = free.flights[opening.reached]
    assert first is not None
    assert first.flight.covariance is not None
    return Fit(
        parameters={"chi": Parameter(None, None, None, None, True, False)},
        initial=opening.state,
        initial_covariance=first.flight.covariance * variance * tau,
        chosen=("smooth impact",),
        considered=_left_out(None),
        bounces_fitted=0,
        residual_rms=float(np.sqrt(opening.mean_square)),
        landed_face=None,
        face_odds=None,
        messages=tuple(messages),
        throw=opening.throw,
    )


def _nothing(messages: list[str], why: str) -> Fit:
    """The result where not even one flight is known."""
    unknown = Parameter(None, None, None, None, True, False)
    words = (*messages, why[:1].upper() + why[1:])
    return Fit({"chi": unknown}, None, None, (), (), 0, None, None, None, words, None)


def _inflation(shot: Shot) -> tuple[float, list[str]]:
    """By how much the covariance is scaled for what the residuals show, and the sentence that says so."""
    freedom = 6 * len(shot.sightings) - 13
    variance, tau = variance_inflation(shot.residuals, freedom, shot.sightings.flight)
    if variance < 1.2 and tau < 1.2:
        return variance * tau, []
    words = (
        f"Residuals are {np.sqrt(variance):.2f} sigma (rms) and alike over {tau:.1f} frames: the frames' errors are "
        f"larger than stated, or the model is not quite right; sigmas and intervals are scaled up by "
        f"{np.sqrt(variance * tau):.2f}."
    )
    return variance * tau, [words]


def _covariance(root: Array) -> Array:
    """(Tᵀ T)⁻¹ (13, 13)."""
    inverse = solve_triangular(root, np.eye(13))
    return np.asarray(inverse @ inverse.T)


def _chi_parameter(die: Die, shot: Shot, free: FreeFlights, scale: float, messages: list[str]) -> Parameter:
    """χ with its interval; None, and a message, where the data leave all of [0, 1] open."""
    k2 = CLEAN_FRAME * max(1.0, free.variance)

    def cost(held: Shot) -> float:
        scaled, _ = huber(held.residuals, np.empty((len(held.residuals), 6, 0)), k2)
        return float((scaled**2).sum())

    def excess(chi: float) -> float:
        held = shoot(die, shot.sightings, replace(shot, chi=chi), shot.vertices, k2, hold_chi=True)
        return (cost(held) - least) / scale

    least = cost(shot)
    sigma = float(np.sqrt(scale)) / float(shot.root[12, 12])
    low, high = chi_interval(shot.chi, sigma, excess, level=LEVEL)
    if low == 0.0 and high == 1.0:
        messages.append("chi cannot be determined: every value from 0 to 1 agrees with the frames.")
        return Parameter(None, None, None, None, True, False)
    return _bounded(shot.chi, low, high, 0.01 * sigma)


def _bounded(chi: float, low: float, high: float, near: float = 0.0) -> Parameter:
    """χ kept in [0, 1]; a value beyond a bound, or within `near` of it, stands on it."""
    value = 0.0 if chi <= near else 1.0 if chi >= 1.0 - near else chi
    low, high = float(np.clip(low, 0.0, value)), float(np.clip(high, value, 1.0))
    return Parameter(value, low, high, LEVEL, True, value in (0.0, 1.0))


def _left_out(mean_square: float | None) -> tuple[Effect, ...]:
    """What the model here does not have."""
    fits = mean_square is not None and mean_square < MISFIT
    reason = "the smooth impact already leaves residuals near the frames' errors" if fits else "it is not modelled"
    return (Effect("table friction", None, f"Not tried: {reason}."),)


def _frame_messages(free: FreeFlights) -> list[str]:
    """What to say of the frames before any law of impact is tried."""
    words = []
    if free.noise_estimated is not None:
        count, sigma_m, sigma_rad = free.noise_estimated
        told = (
            f"their noise was estimated from flights: {1e3 * sigma_m:.3g} mm and {np.rad2deg(sigma_rad):.3g} degrees"
            if np.isfinite(sigma_m)
            else "no flight is long enough to estimate their noise, so they were left out"
        )
        words.append(f"{count} frames have no usable covariance; {told}.")
    if free.outliers:
        words.append(f"{free.outliers} frames contradict the flight that their neighbours make, and were left out.")
    if free.variance > 1.5:
        words.append(
            f"Within free flights the frames scatter {np.sqrt(free.variance):.2f} times as much as they state."
        )
    return words


def _bounce_messages(die: Die, shots: list[Shot], free: FreeFlights, total: int, explained: int) -> list[str]:
    """What to say of the bounces that the fit runs through, and of the one that stopped it."""
    words, shot = [], shots[0]
    if explained < total:
        why = (
            f"after bounce {explained + 1} every throw that was tried misses the frames by more than {MISFIT:g} times "
            "their scatter"
            if _can_go_on(free, shot.reached)
            else "the flights that follow have fewer than two frames clear of impacts"
        )
        words.append(f"The model explains {explained} of {total} bounces; {why}.")
    if len(shot.vertices) != explained:
        words.append(
            f"The fitted throw has {len(shot.vertices)} impacts where {explained} bounces were measured: "
            f"vertices {', '.join(map(str, shot.vertices))}."
        )
    if len(shots) > 1:
        rivals = "; ".join(" ".join(map(str, s.vertices)) for s in shots[1:])
        words.append(f"Other sequences of vertices agree with the frames too: {rivals}.")
    free_throw = _own_sequence(die, shot)
    if free_throw != shot.vertices:
        words.append(
            "Left to itself the fitted throw touches with other vertices than those fitted: "
            f"{', '.join(map(str, free_throw)) or 'none'} instead of {', '.join(map(str, shot.vertices))}."
        )
    return words


def _own_sequence(die: Die, shot: Shot) -> tuple[int, ...]:
    """The vertices that the fitted throw touches with when none is prescribed, over the frames in the fit."""
    try:
        throw = propagate(die, shot.state, shot.chi, [shot.sightings.time_s[-1]]).throw
    except ValueError:  # it begins below the table or chatters: no such throw exists
        return ()
    return tuple(impact.vertices[0] for impact in throw.impacts)
