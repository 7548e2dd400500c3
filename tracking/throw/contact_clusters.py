"""Contact clusters: impacts that follow each other within a few frames; which vertices struck, and when.

A fast die strikes again before it has flown for three frames, and no flight in between can be fitted alone. A die that lands
nearly flat strikes twice between two frames: one impact then explains the frames badly, and yet leaves none of them off its
flight. But a flight that is known up to the first contact determines, for each coefficient of restitution, all that follows. The
model (`model.throw`) is run for several restitutions, with friction if the other impacts of the throw show any, and with the die
tilted by its errors. Each sequence of vertices that results is a hypothesis. It starts from the model's own motion and is then
fitted as a chain of impacts (`flight_chain.VertexImpact`), under the conditions of any impact only: restitution may differ from
contact to contact, and friction may act.

The sequence that explains the frames best is accepted if it explains them as well as two unrelated flights do, if no other
sequence comes near it, and if every instant is known (`instant_limit_s`). Otherwise the link stays open, and one that counted as
one impact is opened where all that come near have several.

The tracker may resume behind such contacts with another labelling of the die's faces. The model determines the labelling: frames
are relabelled by the symmetry that rotates them nearest to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, inner_vertices, nearest_equivalent_rotation, symmetry_rotations
from ...model.laws import CoulombImpact, ImpactLaw, SmoothImpact
from ...model.rotations import angle_between, matrix_from_quat, quat_from_matrix
from ...model.throw import Flight, State, Throw, Until, throw_die
from ..flights import CUTOFF_SIGMAS, FlightChain, Link, VertexImpact, WeightedPoses, perturbed, transition_matrix
from .flight_segmentation import SHORTEST_WINDOW_S, WINDOW

Array = NDArray[np.float64]
Fit = Callable[[WeightedPoses, Sequence[State], Sequence[Link]], FlightChain]

INLIER_WEIGHT = 0.5
"""Weight from which a frame counts as lying on its flight."""
FRAMES_BESIDE_LINK = 3
"""Frames on either side of a link that are examined for unexplained ones."""
OUTLIER_WEIGHT = 0.1
"""Weight below which a frame lies on no flight."""
MIN_INLIERS = 8
"""Inliers from which a flight can start or end a cluster."""
RESTITUTIONS = np.linspace(0.05, 0.95, 19)
"""Coefficients of restitution that are tried. Neighbours differ by 0.05: two contacts later by as much of the speed, some
millimetres a second in ten."""
LEAST_FRICTION = 0.03
"""Least ratio of tangential to normal impulse at the throw's other impacts for which friction is tried."""
MAX_IMPACTS = 6
"""Most impacts of a hypothesis."""
MAX_FITTED = 6
"""Hypotheses that are fitted, those nearest to the frames first."""
DECISIVE = 9.0
"""Squared sigmas by which the best sequence must beat the next."""
INSTANT_FRAMES = 0.4
"""Standard error of an instant, in frames, beyond which it counts as unknown."""
MISLABELLED_RAD = 0.35
"""Angle [rad] from the model, under every labelling, beyond which a frame is an outlier and keeps its labelling."""
STRIKES_AGAIN_FRAMES = 1.5
"""Time, in frames, within which a second contact need not show as frames that lie on no flight."""
TILT_SIGMAS = (-1.5, 1.5)
"""Standard errors by which a release is tilted."""
ROUGH_STRIDE = 4
"""One law in so many is tried on each of these."""
LIFTS = (0.0, 0.02, 0.05, 0.1)
"""Heights, as shares of an edge, by which a release is raised until it lies above the table: depth error puts a die into it."""


def instant_limit_s(time_s: Array) -> float:
    """Standard error [s] of an instant beyond which it counts as unknown, for frames at some times (n,).

    On a film so fast that segmentation uses windows of fixed duration, that duration sets the limit, not the frames: they may
    follow each other faster than any instant is known."""
    return INSTANT_FRAMES * _resolvable_s(time_s)


def _resolvable_s(time_s: Array) -> float:
    """Time [s] from one frame to the next, but no less than segmentation goes by."""
    return max(float(np.median(np.diff(time_s))), SHORTEST_WINDOW_S / WINDOW)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """What may have happened at an open link."""

    vertices: tuple[int, ...]
    """Those that strike, in order."""
    throw: Throw
    distance: float
    """Mean distance of the frames between from the throw, in edges and radians."""


def resolve_cluster(
    observations: WeightedPoses, chain: FlightChain, k: int, die: Die, impacts: Sequence[VertexImpact], fit: Fit
) -> tuple[WeightedPoses, FlightChain, int] | None:
    """The frames (relabelled where necessary), the chain with link k and its neighbours resolved into impacts, or opened where
    several are certain but not known, and the index of the first of these; None if the link stays as it is. `impacts` are those
    at each vertex.

    An open link and one with unexplained frames beside it hide something; any other only where the model strikes twice."""
    if not die.is_nearly_centred:
        return None
    hides_more = chain.links[k].is_open or _is_crowded(observations, chain, k)
    if not hides_more and not _may_strike_twice(observations, chain, k, die):
        return None
    before = _known_flight(observations, chain, range(k, -1, -1))
    after = _known_flight(observations, chain, range(k + 1, len(chain.flights)))
    if before is None or after is None:
        return None
    ends = int(_inliers(observations, chain, before)[-1]), int(_inliers(observations, chain, after)[0])
    fitted = []
    for hypothesis in _hypotheses(observations, chain, before, ends, die, least=1 if hides_more else 2)[:MAX_FITTED]:
        own = _relabelled(observations, hypothesis, ends, die)
        starts, links = _chain_with(chain, before, after, hypothesis, own, impacts, die)
        if links:
            fitted.append((own, fit(own, starts, links), hypothesis))
    fitted.sort(key=lambda one: one[1].cost)
    if not fitted:
        return None
    own, best, hypothesis = fitted[0]
    new = slice(before, before + len(hypothesis.vertices))
    is_unknown = bool((best.sigma_time_s[new] > instant_limit_s(observations.time_s)).any())
    # The same sequence with another impact in it that explains no more does not compete.
    competitors = [
        third.vertices
        for _, other, third in fitted[1:]
        if other.cost - best.cost < DECISIVE and not _contains(third.vertices, hypothesis.vertices)
    ]
    # An open link, and free jumps, have more freedom than impacts and may cost less; a link taken for a single impact has less.
    is_impact = chain.links[k].impact is not None
    allowed = chain.cost + (2.0 * CUTOFF_SIGMAS**2 if chain.links[k].is_open else -DECISIVE if is_impact else 0.0)
    if best.cost > allowed:
        return None
    if not is_unknown and not competitors:
        return own, best, before
    is_one = any(len(vertices) == 1 for vertices in (hypothesis.vertices, *competitors))
    if chain.links[k].is_open or is_one:
        return None
    # There were several, and neither they nor the motion through them are known.
    links = [replace(link, is_open=True, impact=None) if j == k else link for j, link in enumerate(chain.links)]
    return observations, fit(observations, [flight.start for flight in chain.flights], links), k


def _contains(vertices: tuple[int, ...], part: tuple[int, ...]) -> bool:
    """Whether a sequence of vertices contains another, in order, possibly with more in between."""
    rest = iter(vertices)
    return all(vertex in rest for vertex in part)


def _is_crowded(observations: WeightedPoses, chain: FlightChain, k: int) -> bool:
    """Whether several frames beside a link lie on neither of its flights: an impact may fall within the exposure of one frame;
    several show another impact."""
    row = int(np.searchsorted(observations.time_s, chain.links[k].time_s))
    near = slice(max(row - FRAMES_BESIDE_LINK, 0), row + FRAMES_BESIDE_LINK)
    return int((chain.weights[near] < OUTLIER_WEIGHT).sum()) > 1


def _may_strike_twice(observations: WeightedPoses, chain: FlightChain, k: int, die: Die) -> bool:
    """Whether another vertex may strike within STRIKES_AGAIN_FRAMES after the first at a link that counts as one impact: no frame
    need show it then.

    A smooth impact of any restitution on the lowest vertex sends the others down no faster than one of 0 or of 1."""
    flight, time_s = chain.flights[k], chain.links[k].time_s
    state, tilts = flight.at(time_s), _covariance_at(flight, time_s)[3:5, 3:5]
    if not np.isfinite(tilts).all():
        return False
    R = state.rotation
    arms = inner_vertices(die.solid, die.corner_radius_m) @ R.T
    low = int(np.argmin(arms[:, 2]))
    torques = np.cross(arms, [0.0, 0.0, 1.0])
    speeds = state.velocity_m_s[2] + torques @ state.omega_rad_s
    answers = 1.0 / die.mass_kg + torques @ np.linalg.solve(R @ die.tensor_kg_m2 @ R.T, torques[low])
    stopped = speeds - speeds[low] * answers / answers[low]
    slowest = np.minimum(stopped, 2.0 * stopped - speeds)
    within_s = STRIKES_AGAIN_FRAMES * _resolvable_s(observations.time_s)
    tilt_rad = np.sqrt(float(np.linalg.eigvalsh(tilts)[-1]))
    higher = np.linalg.norm((arms - arms[low])[:, :2], axis=1) * TILT_SIGMAS[-1] * tilt_rad
    reached = arms[:, 2] - arms[low, 2] - higher < np.maximum(-slowest, 0.0) * within_s
    return bool(speeds[low] < 0.0 and np.delete(reached, low).any())


def _covariance_at(flight: Flight, time_s: float) -> Array:
    """(12, 12) of the state of a flight at an instant; NaN if it is not known."""
    if flight.covariance is None:
        return np.full((12, 12), np.nan)
    to_there = transition_matrix(flight, time_s)
    return np.asarray(to_there @ flight.covariance @ to_there.T)


def _inliers(observations: WeightedPoses, chain: FlightChain, flight: int) -> NDArray[np.int64]:
    """Rows of a flight that lie on it."""
    ends = [-np.inf, *chain.link_times_s, np.inf]
    inside = (observations.time_s > ends[flight]) & (observations.time_s <= ends[flight + 1])
    return np.flatnonzero(inside & (chain.weights > INLIER_WEIGHT))


def _known_flight(observations: WeightedPoses, chain: FlightChain, flights: range) -> int | None:
    """The first of these flights with enough inliers."""
    return next((j for j in flights if len(_inliers(observations, chain, j)) >= MIN_INLIERS), None)


def _hypotheses(
    observations: WeightedPoses, chain: FlightChain, before: int, ends: tuple[int, int], die: Die, *, least: int
) -> list[_Hypothesis]:
    """The model's continuations of the flight before, under several laws; one for each sequence of vertices, the nearest first.
    None of them if no throw of a rough search has the `least` number of impacts."""
    laws = _laws(chain, die)
    releases = _releases(chain.flights[before], float(observations.time_s[ends[0]]))
    until_s = float(observations.time_s[ends[1]])
    some = laws[::ROUGH_STRIDE]
    throws = [throw for start in releases for law in some if (throw := _simulated(die, start, law, until_s))]
    if least > 1 and all(len(_struck(throw, until_s)) < least for throw in throws):
        return []
    others = [law for law in laws if law not in some]
    throws += [throw for law in others if (throw := _simulated(die, releases[0], law, until_s))]
    nearest: dict[tuple[int, ...], _Hypothesis] = {}
    for throw in throws:
        vertices = _struck(throw, until_s)
        if 1 <= len(vertices) <= MAX_IMPACTS:
            distance = _distance(observations, throw, ends, die)
            if vertices not in nearest or distance < nearest[vertices].distance:
                nearest[vertices] = _Hypothesis(vertices, throw, distance)
    return sorted(nearest.values(), key=lambda hypothesis: hypothesis.distance)


def _struck(throw: Throw, until_s: float) -> tuple[int, ...]:
    """The vertices that strike before an instant, in order; none where several strike at once."""
    impacts = [impact for impact in throw.impacts if impact.time_s < until_s]
    at_vertices = all(impact.contact == "vertex" for impact in impacts)
    return tuple(impact.vertices[0] for impact in impacts) if at_vertices else ()


def _releases(flight: Flight, time_s: float) -> list[State]:
    """The state of a flight at an instant, and states that its errors allow, tilted about either horizontal direction: which of
    several low vertices strikes first may hang on a fraction of a degree."""
    state = flight.at(time_s)
    C = _covariance_at(flight, time_s)
    if not np.isfinite(C).all():
        return [state]
    variances, directions = np.linalg.eigh(C[3:5, 3:5])
    states = [state]
    for variance, direction in zip(variances, directions.T, strict=True):
        if variance > 0.0:
            # The likeliest change of all twelve numbers for this tilt.
            change = C[:, 3:5] @ direction / np.sqrt(variance)
            states += [perturbed(state, sigmas * change) for sigmas in TILT_SIGMAS]
    return states


def _laws(chain: FlightChain, die: Die) -> list[ImpactLaw]:
    """Smooth impacts of several restitutions, and impacts with friction if those of the chain show some."""
    ratios = []
    for k, link in enumerate(chain.links):
        if link.impact is not None:
            jump = chain.flights[k + 1].start.velocity_m_s - chain.flights[k].at(link.time_s).velocity_m_s
            ratios.append(float(np.linalg.norm(jump[:2]) / max(abs(float(jump[2])), 1e-9)))
    friction = float(np.median(ratios)) if ratios else 0.0
    smooth: list[ImpactLaw] = [SmoothImpact(float(chi)) for chi in RESTITUTIONS]
    return smooth + ([CoulombImpact(float(chi), friction) for chi in RESTITUTIONS] if friction > LEAST_FRICTION else [])


def _simulated(die: Die, release: State, law: ImpactLaw, until_s: float) -> Throw | None:
    """The model's throw, raised by one of LIFTS if depth error has put the die into the table; None if no such throw begins."""
    for lift in LIFTS:
        height = np.array([0.0, 0.0, lift * die.solid.edge_m])
        raised = replace(release, position_m=release.position_m + height)
        try:
            return throw_die(die, raised, law, until=Until(time_s=until_s, impacts=MAX_IMPACTS + 1)).throw
        except ValueError:
            # Below the table: the only reason for which a release measured in flight can be refused.
            continue
    return None


def _distance(observations: WeightedPoses, throw: Throw, ends: tuple[int, int], die: Die) -> float:
    """Mean distance of the frames between from a throw, positions in edges plus angles in radians, each at most 1."""
    rows = slice(ends[0] + 1, ends[1] + 1)
    p, q = throw.poses(observations.time_s[rows])
    distance = np.linalg.norm(observations.position_m[rows] - p, axis=1) / die.solid.edge_m
    angle = angle_between(q, _nearest(observations.quaternion[rows], q, die))
    return float(np.mean(np.minimum(distance + angle, 1.0)))


def _nearest(quaternion: Array, like: Array, die: Die) -> Array:
    """Orientations (n, 4) under the labelling that brings each nearest to `like` (n, 4)."""
    symmetries = symmetry_rotations(die.solid)
    return quat_from_matrix(
        nearest_equivalent_rotation(matrix_from_quat(quaternion), matrix_from_quat(like), symmetries)
    )


def _relabelled(observations: WeightedPoses, hypothesis: _Hypothesis, ends: tuple[int, int], die: Die) -> WeightedPoses:
    """The frames under the labelling of the hypothesis: each frame between by itself, those behind with one relabelling."""
    quaternion = observations.quaternion.copy()
    rows = slice(ends[0] + 1, ends[1])
    _, q = hypothesis.throw.poses(observations.time_s[rows])
    nearest = _nearest(quaternion[rows], q, die)
    close = angle_between(q, nearest) < MISLABELLED_RAD
    quaternion[rows] = np.where(close[:, None], nearest, quaternion[rows])
    _, q = hypothesis.throw.poses(observations.time_s[ends[1] : ends[1] + 1])
    relabelling = matrix_from_quat(quaternion[ends[1]]).T @ matrix_from_quat(
        _nearest(quaternion[ends[1]][None], q, die)[0]
    )
    quaternion[ends[1] :] = quat_from_matrix(matrix_from_quat(quaternion[ends[1] :]) @ relabelling)
    return replace(observations, quaternion=quaternion)


def _chain_with(
    chain: FlightChain,
    before: int,
    after: int,
    hypothesis: _Hypothesis,
    own: WeightedPoses,
    impacts: Sequence[VertexImpact],
    die: Die,
) -> tuple[list[State], list[Link]]:
    """Initial states and links of the whole chain, with the hypothesis in place of what lay between two of its flights."""
    count = len(hypothesis.vertices)
    starts = [flight.start for flight in chain.flights[: before + 1]]
    starts += [flight.start for flight in hypothesis.throw.flights[1:count]]
    for flight in chain.flights[after:]:
        state = flight.start
        row = int(np.argmin(np.abs(own.time_s - state.time_s)))
        q = _nearest(state.quaternion[None], own.quaternion[row][None], die)[0]
        starts.append(State(state.time_s, state.position_m, q, state.velocity_m_s, state.omega_rad_s))
    new = [
        Link(impact.time_s, impact=impacts[vertex])
        for impact, vertex in zip(hypothesis.throw.impacts, hypothesis.vertices, strict=False)
    ]
    return starts, [*chain.links[:before], *new, *chain.links[after:]]
