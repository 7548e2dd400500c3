"""Contacts that follow each other within a few frames: which vertices struck, and when.

A fast die strikes again before it has flown for three frames, and no flight between can be fitted alone. But a flight
that is known up to the first contact says, for each coefficient of restitution, all that follows: the model is asked
(`model.simulate`), restitution by restitution, and friction by friction where the other bounces of the throw show any.
Each order of vertices that comes out is a hypothesis, which begins at the model's own motion and is then fitted as a
chain of impacts with nothing of the model left in it but what any impact obeys (`joined.VertexImpact`): the restitution may
differ from contact to contact, and friction may act.

The order of vertices that explains the frames best is taken if it explains them as well as two unrelated flights do, if no
other order comes near it, and if every instant is known (`instant_s`). Otherwise the link stays open.

A die may be taken up behind such contacts under another labelling of its faces. The model says which is its own: frames
are relabelled by the symmetry that turns them nearest to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, nearest_equivalent_rotation, symmetry_rotations
from ...model.laws import CoulombImpact, ImpactLaw, SmoothImpact
from ...model.rotations import matrix_from_quat, quat_from_matrix, rotation_between
from ...model.throw import State, Throw, Until, throw_die
from .flight_chain import CUT_SIGMA, FlightChain, Link, VertexImpact
from .flights import Observations
from .segmentation import BRIEFEST_S, WINDOW

Array = NDArray[np.float64]
Fit = Callable[[Observations, Sequence[State], Sequence[Link]], FlightChain]

SOUND = 0.5
"""Weight from which a frame is taken to lie on its flight."""
BESIDE, LOST_WEIGHT = 3, 0.1
"""Frames on either side of a link that are looked at, and the weight of one that lies on no flight."""
ANCHOR = 8
"""Sound frames that make a flight one to start from, or to arrive at."""
CHIS = np.linspace(0.05, 0.95, 19)
"""Neighbours part by 0.05: two contacts later by as much of their speed, some millimetres a second in ten."""
SLIPS = 0.03
"""Share of the normal impulse that the others' tangential one must reach for friction to be tried."""
MOST_IMPACTS = 6
TRIED = 6
"""Orders of vertices that are fitted, those nearest to the frames first."""
SURE = 9.0
"""Squared sigmas by which the best order must beat the next."""
INSTANT_FRAMES = 0.4
"""Sigma of an instant, in frames, beyond which it is none."""
FAR_RAD = 0.35
"""A frame further than this from the model under every labelling is wrong, and keeps its own."""


def instant_s(time_s: Array) -> float:
    """Sigma [s] of an instant beyond which it is none, for frames at some times (n,). On a film so fast that flights are parted
    by what a given time shows, that counts and not its frames, which may follow each other faster than any instant is known."""
    return INSTANT_FRAMES * max(float(np.median(np.diff(time_s))), BRIEFEST_S / WINDOW)


@dataclass(frozen=True, eq=False)
class _Story:
    """What may have happened at an open link."""

    order: tuple[int, ...]
    throw: Throw
    miss: float
    """Typical distance from the frames between, in edges and radians."""


def resolved(
    seen: Observations, joined: FlightChain, k: int, die: Die, strikes: Sequence[VertexImpact], fit: Fit
) -> tuple[Observations, FlightChain, int] | None:
    """The frames (relabelled where need be), the chain with link k and its neighbours resolved into impacts, and the first
    of these; None where that cannot be."""
    before = _anchor(seen, joined, range(k, -1, -1))
    after = _anchor(seen, joined, range(k + 1, len(joined.flights)))
    if before is None or after is None or not die.is_spherical_top:
        return None
    first, last = _sound(seen, joined, before)[-1], _sound(seen, joined, after)[0]
    stories = _stories(seen, joined, before, (int(first), int(last)), die)
    found = []
    for story in stories[:TRIED]:
        own = _relabelled(seen, joined, story, (int(first), int(last)), die)
        starts, links = _chain(joined, before, after, story, own, strikes, die)
        if links:
            found.append((own, fit(own, starts, links), story, len(links)))
    found.sort(key=lambda one: one[1].cost)
    if not found:
        return None
    own, best, story, _ = found[0]
    new = slice(before, before + len(story.order))
    unsure = bool((best.sigma_time_s[new] > instant_s(seen.time_s)).any())
    # The same story with another impact in it that explains no more is no other one.
    rivals = [other.cost for _, other, told, _ in found[1:] if not _holds(told.order, story.order)]
    # An open link has more freedom than impacts and may cost less; one that is taken for a single impact has less.
    allowed = joined.cost + (2.0 * CUT_SIGMA**2 if joined.links[k].is_open else -SURE)
    if unsure or (rivals and rivals[0] - best.cost < SURE) or best.cost > allowed:
        return None
    return own, best, before


def _holds(order: tuple[int, ...], part: tuple[int, ...]) -> bool:
    """Whether an order of vertices is another, or that with more in between."""
    rest = iter(order)
    return all(vertex in rest for vertex in part)


def is_crowded(seen: Observations, joined: FlightChain, k: int) -> bool:
    """Whether some frames beside a link lie on neither of its flights: one may straddle an impact, more of them have
    seen another one."""
    row = int(np.searchsorted(seen.time_s, joined.links[k].time_s))
    return int((joined.weights[max(row - BESIDE, 0) : row + BESIDE] < LOST_WEIGHT).sum()) > 1


def _sound(seen: Observations, joined: FlightChain, flight: int) -> NDArray[np.int64]:
    """Rows of a flight that lie on it."""
    ends = [-np.inf, *joined.links_s, np.inf]
    inside = (seen.time_s > ends[flight]) & (seen.time_s <= ends[flight + 1])
    return np.flatnonzero(inside & (joined.weights > SOUND))


def _anchor(seen: Observations, joined: FlightChain, flights: range) -> int | None:
    """The first of these flights with enough sound frames."""
    return next((j for j in flights if len(_sound(seen, joined, j)) >= ANCHOR), None)


def _stories(seen: Observations, joined: FlightChain, before: int, ends: tuple[int, int], die: Die) -> list[_Story]:
    """What the model makes of the flight before, by law; one story for each order of vertices, the nearest first."""
    flight = joined.flights[before]
    release = flight.at(float(seen.time_s[ends[0]]))
    until_s = float(seen.time_s[ends[1]])
    told: dict[tuple[int, ...], _Story] = {}
    for law in _laws(joined, die):
        throw = _thrown(die, release, law, until_s)
        impacts = [impact for impact in throw.impacts if impact.time_s < until_s] if throw else []
        order = tuple(v for impact in impacts for v in impact.vertices[:1])
        lasting = all(impact.contact == "vertex" for impact in impacts)
        if throw is None or not 1 <= len(order) <= MOST_IMPACTS or not lasting:
            continue
        miss = _miss(seen, throw, ends, die)
        if order not in told or miss < told[order].miss:
            told[order] = _Story(order, throw, miss)
    return sorted(told.values(), key=lambda story: story.miss)


def _laws(joined: FlightChain, die: Die) -> list[ImpactLaw]:
    """Restitutions, and friction where the strikes of the chain have some."""
    slips = []
    for k, link in enumerate(joined.links):
        if link.strike is not None:
            jump = joined.flights[k + 1].start.velocity_m_s - joined.flights[k].at(link.time_s).velocity_m_s
            slips.append(float(np.linalg.norm(jump[:2]) / max(abs(float(jump[2])), 1e-9)))
    slip = float(np.median(slips)) if slips else 0.0
    smooth: list[ImpactLaw] = [SmoothImpact(float(chi)) for chi in CHIS]
    return smooth + ([CoulombImpact(float(chi), slip) for chi in CHIS] if slip > SLIPS else [])


def _thrown(die: Die, release: State, law: ImpactLaw, until_s: float) -> Throw | None:
    """The model's throw, lifted where depth error has put the die into the table; None where no such throw begins."""
    for lift in (0.0, 0.02, 0.05, 0.1):
        height = np.array([0.0, 0.0, lift * die.solid.edge_m])
        raised = replace(release, position_m=release.position_m + height)
        try:
            return throw_die(die, raised, law, until=Until(time_s=until_s, impacts=MOST_IMPACTS + 1)).throw
        except ValueError:
            # Below the table: the only thing that a release measured in flight can be refused for.
            continue
    return None


def _miss(seen: Observations, throw: Throw, ends: tuple[int, int], die: Die) -> float:
    """Median distance of the frames between from a throw, places in edges and turns in radians together."""
    rows = slice(ends[0] + 1, ends[1] + 1)
    p, q = throw.poses(seen.time_s[rows])
    away = np.linalg.norm(seen.position_m[rows] - p, axis=1) / die.solid.edge_m
    turned = np.linalg.norm(rotation_between(q, _nearest(seen.quaternion[rows], q, die)), axis=1)
    return float(np.mean(np.minimum(away + turned, 1.0)))


def _nearest(quaternion: Array, like: Array, die: Die) -> Array:
    """Orientations (n, 4) under the labelling that brings each nearest to `like` (n, 4)."""
    symmetries = symmetry_rotations(die.solid)
    return quat_from_matrix(
        nearest_equivalent_rotation(matrix_from_quat(quaternion), matrix_from_quat(like), symmetries)
    )


def _relabelled(
    seen: Observations, joined: FlightChain, story: _Story, ends: tuple[int, int], die: Die
) -> Observations:
    """The frames under the labelling that the story carries on: each frame between by itself, those behind as one."""
    quaternion = seen.quaternion.copy()
    rows = slice(ends[0] + 1, ends[1])
    _, q = story.throw.poses(seen.time_s[rows])
    nearest = _nearest(quaternion[rows], q, die)
    close = np.linalg.norm(rotation_between(q, nearest), axis=1) < FAR_RAD
    quaternion[rows] = np.where(close[:, None], nearest, quaternion[rows])
    _, q = story.throw.poses(seen.time_s[ends[1] : ends[1] + 1])
    turn = matrix_from_quat(quaternion[ends[1]]).T @ matrix_from_quat(_nearest(quaternion[ends[1]][None], q, die)[0])
    quaternion[ends[1] :] = quat_from_matrix(matrix_from_quat(quaternion[ends[1] :]) @ turn)
    return replace(seen, quaternion=quaternion)


def _chain(
    joined: FlightChain,
    before: int,
    after: int,
    story: _Story,
    own: Observations,
    strikes: Sequence[VertexImpact],
    die: Die,
) -> tuple[list[State], list[Link]]:
    """Starts and links of the whole chain with the story in the place of what lay between the two flights."""
    count = len(story.order)
    starts = [flight.start for flight in joined.flights[: before + 1]]
    starts += [flight.start for flight in story.throw.flights[1:count]]
    for flight in joined.flights[after:]:
        state = flight.start
        row = int(np.argmin(np.abs(own.time_s - state.time_s)))
        q = _nearest(state.quaternion[None], own.quaternion[row][None], die)[0]
        starts.append(State(state.time_s, state.position_m, q, state.velocity_m_s, state.omega_rad_s))
    new = [
        Link(impact.time_s, strike=strikes[vertex])
        for impact, vertex in zip(story.throw.impacts, story.order, strict=False)
    ]
    return starts, [*joined.links[:before], *new, *joined.links[after:]]
