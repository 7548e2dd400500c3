"""Foretelling a throw: the state from frames before some instant, and from there on nothing but the model.

`simulated_poses` gives the poses of a model's throw at the times of a track, compiled for dice that are spherical tops;
`foretell` starts it from an `Outset`. What the frames leave open is told by draws: states from their covariance, and
parameters from their intervals, each thrown until its face is decided. `decided_at` asks that again after every bounce
of the track that a flight of three frames follows: the outcome is decided at the first of them after which one face has
at least `SURE` of the draws, there and at all later ones. Draws know of the errors of frames and parameters, not of a
law that does not hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from ...model import engine
from ...model.die import Die
from ...model.ensembles import ThrowSetup
from ...model.rotations import matrix_from_quat
from ...model.throw import (
    BOUNCING_CAP,
    IMPACT_CAP,
    Precision,
    State,
    Until,
    kernel_states,
    packed_state,
    touching_vertices,
    world_poses,
)
from ...tracking.track import ABSENT, TRACKED, Track
from ..free import moved_state
from ..results import Parameter
from ..throw import QUICK, Physics, in_true_units, kernel_body, resting_face
from .release_state import FEWEST, Outset, flight_length, outset_before, outset_of, usable_rows

Array = NDArray[np.float64]

SURE = 0.95

DRAWS = 100
"""With 100 draws on one face another still has odds below 3 % (95 %)."""


@dataclass(frozen=True, eq=False)
class Odds:
    """What frames up to some instant say of the face that the die will land on."""

    bounces: int
    """Bounces of the track before these frames."""
    time_s: float
    """Of the last of them."""
    frames: int
    odds: dict[int, float]
    """Share of the draws on each face."""
    undecided: float
    """Share of the draws that landed on none: tops, or bouncing on."""

    @property
    def likeliest(self) -> int:
        """The face with most draws."""
        return max(self.odds, key=lambda face: self.odds[face])


@dataclass(frozen=True, eq=False)
class Decision:
    """The odds bounce by bounce, and when they were settled."""

    steps: tuple[Odds, ...]
    face: int | None
    """The face decided on; None where the frames leave it open to the end."""
    bounces: int | None
    """Bounces after which it was decided: 0, before the first."""
    time_s: float | None


def simulated_poses(
    physics: Physics, state: State, times_s: Array, precision: engine.Precision = QUICK
) -> tuple[Array, Array]:
    """Positions (n, 3) [m] and quaternions (n, 4) at `times_s` (n,), in order, of the throw that begins with `state`.

    All on the track's clock and in its metres. A corner that begins below the table, as errors of frames may put it
    there, is lifted onto it. Raises ValueError for times before the state's.
    """
    return simulated_throws(physics, [state], [np.asarray(times_s, float)], precision=precision)


def simulated_throws(
    physics: Physics,
    states: Sequence[State],
    times_s: Sequence[Array],
    pool: ThreadPoolExecutor | None = None,
    precision: engine.Precision = QUICK,
) -> tuple[Array, Array]:
    """`simulated_poses` of many throws, one below the other: (Σ n, 3) and (Σ n, 4). The pool's threads share them out."""
    for state, times in zip(states, times_s, strict=True):
        if len(times) and times[0] < state.time_s - 1e-12:
            raise ValueError(f"times_s from {times[0]:g}: wanted none before the state's, {state.time_s:g} s")
    clock, length = physics.clock, physics.length
    starts = [lifted(physics, in_true_units(physics, state)) for state in states]
    firsts = np.concatenate([[0], np.cumsum([len(times) for times in times_s])]).astype(np.int64)
    times = clock * np.concatenate([np.empty(0), *times_s])
    poses = np.empty((len(times), 7))
    if physics.body.isotropic_inertia_kg_m2 is None:
        for start, low, high in zip(starts, firsts, firsts[1:], strict=False):
            if high > low:
                throw = physics.throw(start, Until(time_s=float(times[high - 1]))).throw
                poses[low:high] = np.hstack(throw.poses(times[low:high]))
        return length * poses[:, :3], poses[:, 3:]
    packed = kernel_states(physics.body, physics.plane, np.array([packed_state(start) for start in starts]))
    begins = np.array([start.time_s for start in starts])
    law = engine.law_of(physics.law.code, physics.law.parameters)
    cap = BOUNCING_CAP if physics.values["chi"] >= 1.0 or physics.plane.moves else IMPACT_CAP
    fixed = (kernel_body(physics.body), law, physics.plane.plane, precision)

    def part(low: int, high: int) -> None:
        engine.poses_of_throws(*fixed, packed[low:high], begins[low:high], times, firsts[low : high + 1], cap, poses)

    if pool is None:
        part(0, len(starts))
    else:
        # Small parts, since throws differ in how long they take; not one each, or handing over takes as long.
        cuts = np.unique(np.linspace(0, len(starts), 17).astype(int))
        list(pool.map(part, cuts[:-1], cuts[1:]))
    positions, quaternions = world_poses(physics.body, physics.plane, poses)
    return length * positions, quaternions


@lru_cache(maxsize=64)
def _corners(die: Die) -> Array:
    """As `touching_vertices`, likewise."""
    return touching_vertices(die)


def lifted(physics: Physics, state: State) -> State:
    """The state with no corner below the table."""
    up = matrix_from_quat(physics.plane.world_from_table)[:, 2]
    height = _corners(physics.body) @ matrix_from_quat(state.quaternion).T @ up
    of_table = engine.table_height(physics.plane.plane, state.time_s)
    lowest = float(height.min() + up @ state.position_m - physics.body.corner_radius_m - of_table)
    return state if lowest >= 0.0 else replace(state, position_m=state.position_m - lowest * up)


def foretell(physics: Physics, track: Track, outset: Outset, precision: engine.Precision = QUICK) -> Track:
    """The poses at all times of the track: of the outset's flight before its end, simulated from it afterwards.

    Rows before the first frame of the outset are ABSENT: it says nothing of them.
    """
    times, n = track.time_s, len(track)
    covered = np.isfinite(times) & (times >= outset.begin_s - 1e-9)
    position, quaternion = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
    flown = covered & (times <= outset.state.time_s)
    position[flown], quaternion[flown] = outset.poses(times[flown])
    later = covered & ~flown
    position[later], quaternion[later] = simulated_poses(physics, outset.state, times[later], precision)
    status = np.where(covered & np.isfinite(position).all(1), TRACKED, ABSENT)
    return Track(track.frame, times, position, quaternion, np.full((n, 6, 6), np.nan), status)


def face_odds(
    physics: Physics, parameters: dict[str, Parameter], outset: Outset, *, draws: int = DRAWS, seed: int = 0
) -> tuple[dict[int, float], float]:
    """Odds of every face, and the share of draws that landed on none, given the outset's covariance and the intervals."""
    rng = np.random.default_rng(seed)
    values, axes = np.linalg.eigh(outset.covariance)
    spread = axes * np.sqrt(np.clip(values, 0.0, None))
    landed = [
        _landing(_drawn(physics, parameters, rng), moved_state(outset.state, spread @ rng.standard_normal(12)))
        for _ in range(draws)
    ]
    odds = {face: landed.count(face) / draws for face in range(1, len(physics.die.solid.faces) + 1)}
    return odds, landed.count(0) / draws


def decided_at(
    physics: Physics,
    parameters: dict[str, Parameter],
    track: Track,
    row: int,
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> Decision:
    """The odds from the frames before `row`, then from those of every later flight of at least three frames, and what the
    last frames show where the die lies still in them."""
    steps, flights = [], _flights_from(track, physics, row)
    for bounces, outset in flights:
        odds, none = face_odds(physics, parameters, outset, draws=draws, seed=seed)
        steps.append(Odds(bounces, outset.state.time_s, len(outset.rows), odds, none))
    rested = resting_face(track, physics.die)
    if rested is not None:
        lies = {face: float(face == rested) for face in range(1, len(physics.die.solid.faces) + 1)}
        end_s = float(track.time_s[usable_rows(track, physics.die)[-1]])
        steps.append(Odds(flights[-1][0] + 1, end_s, 0, lies, 0.0))
    settled = None
    for step in reversed(steps):
        if step.odds[step.likeliest] < SURE or (settled and step.likeliest != settled.likeliest):
            break
        settled = step
    if settled is None:
        return Decision(tuple(steps), None, None, None)
    return Decision(tuple(steps), settled.likeliest, settled.bounces, settled.time_s)


def _flights_from(track: Track, physics: Physics, row: int) -> list[tuple[int, Outset]]:
    """The flight before `row` and those after it, each with the number of bounces seen since the first of them.

    A flight ends where its frames no longer foretell the next one. The last is followed by frames that scatter far more
    about any flight: there the die rolls or lies on the table.
    """
    first = outset_before(track, physics.body, row)
    found = [(0, first)]
    rows = usable_rows(track, physics.die)
    begin, bounces = int(np.searchsorted(rows, row)), 1
    while len(rows) - begin >= FEWEST:
        end = begin + flight_length(track, physics.die, rows[begin:])
        outset = outset_of(track, rows[begin:end])
        if not outset.scatters_like(first):
            break
        found.append((bounces, outset.of_die(physics.body)))
        begin, bounces = end, bounces + 1
    return found


def _drawn(physics: Physics, parameters: dict[str, Parameter], rng: np.random.Generator) -> Physics:
    """The physics with every free parameter drawn from its interval, taken for that of a normal number."""
    values = {}
    for name, parameter in parameters.items():
        value, low, high, level = parameter.value, parameter.low, parameter.high, parameter.level
        if name not in physics.values or not parameter.free or value is None or low is None or high is None:
            continue
        side = rng.standard_normal()
        reach = high - value if side > 0.0 else value - low
        values[name] = value + side * reach / float(norm.ppf(0.5 + (level or 0.95) / 2.0))
    return physics.with_values(**values)


def _landing(physics: Physics, state: State) -> int:
    """The face on which one throw lands; 0 for none."""
    start = lifted(physics, in_true_units(physics, state))
    stage = ThrowSetup(
        physics.body,
        physics.law,
        physics.plane,
        Precision(slowest_bounce=QUICK.slowest_bounce, step_turn_rad=QUICK.step_turn),
    )
    return int(stage.throw(packed_state(start)[None]).face[0])
