"""Prediction of a throw: the state from the frames before some instant, and the model alone from there on.

`simulated_throws` returns the poses of modelled throws at the times of tracks, compiled for spherical tops. `predict_track`
starts from a `ReleaseState`. Errors of the state and of the parameters become face odds by draws: states from their
covariance and parameters from their intervals, each simulated until its face is decided.

`decide` repeats this after every bounce that a flight of three frames follows. The outcome is decided at the first of these
flights from which on one face has at least `DECISION_SHARE` of the draws. Draws include the errors of frames and
parameters, not those of a law that does not hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model import engine
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
from ...tracking.covariance import covariance_root
from ...tracking.flights import perturbed
from ...tracking.track import ABSENT, TRACKED, Track
from ..estimation import normal_quantile
from ..results import Parameter
from ..throw import COARSE, INTERVAL_LEVEL, Physics, in_true_units, kernel_body, resting_face
from .release_state import (
    MIN_FLIGHT_FRAMES,
    ReleaseState,
    flight_length,
    release_before,
    release_from,
    usable_rows,
)

Array = NDArray[np.float64]

DECISION_SHARE = 0.95
"""Share of the draws on one face at which the outcome is decided."""

DRAWS = 100
"""With all of 100 draws on one face, another still has odds below 3 % (95 %)."""

_POOL_PARTS = 16
"""Parts that a pool shares out. Throws take different times, so parts are small; one part per throw would spend as long on
handing over."""

_TIME_ROUNDING_S = 1e-12
"""Rounding of times that begin with the state's own."""


@dataclass(frozen=True, eq=False)
class FaceOdds:
    """The odds of the landing face from the frames up to some instant."""

    bounces: int
    """Bounces of the track before these frames."""
    time_s: float
    """Of the last of them."""
    frames: int
    odds: dict[int, float]
    """Share of the draws on each face."""
    undecided: float
    """Share of the draws that landed on none, such as those that never stopped bouncing."""

    @property
    def likeliest(self) -> int:
        """The face with the most draws."""
        return max(self.odds, key=lambda face: self.odds[face])


@dataclass(frozen=True, eq=False)
class Decision:
    """The odds bounce by bounce, and when the outcome was decided."""

    steps: tuple[FaceOdds, ...]
    face: int | None
    """The face; None if it is not decided before the last frame."""
    bounces: int | None
    """Bounces after which it was decided; 0 is before the first."""
    time_s: float | None


def simulated_poses(
    physics: Physics, state: State, times_s: Array, precision: engine.Precision = COARSE
) -> tuple[Array, Array]:
    """Positions (n, 3) [m] and quaternions (n, 4), at `times_s` (n,) in order, of the throw that begins with `state`.

    All on the track's clock and in its metres. A state with a corner below the table, where errors of frames may put it,
    is lifted onto the table. Raises ValueError for times before the state's.
    """
    return simulated_throws(physics, [state], [np.asarray(times_s, float)], precision=precision)


def simulated_throws(
    physics: Physics,
    states: Sequence[State],
    times_s: Sequence[Array],
    pool: ThreadPoolExecutor | None = None,
    precision: engine.Precision = COARSE,
) -> tuple[Array, Array]:
    """`simulated_poses` of many throws, one after the other: (Σ n, 3) and (Σ n, 4), computed by the threads of the pool."""
    for state, times in zip(states, times_s, strict=True):
        if len(times) and times[0] < state.time_s - _TIME_ROUNDING_S:
            raise ValueError(f"times_s from {times[0]:g}: wanted none before the state's, {state.time_s:g} s")
    starts = [lifted(physics, in_true_units(physics, state)) for state in states]
    firsts = np.concatenate([[0], np.cumsum([len(times) for times in times_s])]).astype(np.int64)
    times = physics.clock * np.concatenate([np.empty(0), *times_s])
    if physics.body.isotropic_inertia_kg_m2 is None:
        positions, quaternions = _asymmetric_poses(physics, starts, times, firsts)
    else:
        positions, quaternions = _kernel_poses(physics, starts, times, firsts, pool, precision)
    return physics.length * positions, quaternions


def _asymmetric_poses(
    physics: Physics, starts: Sequence[State], times: Array, firsts: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Poses of throws of a body with three moments of inertia, one by one, in true units."""
    poses = np.empty((len(times), 7))
    for start, low, high in zip(starts, firsts, firsts[1:], strict=False):
        if high > low:
            throw = physics.throw(start, Until(time_s=float(times[high - 1]))).throw
            poses[low:high] = np.hstack(throw.poses(times[low:high]))
    return poses[:, :3], poses[:, 3:]


def _kernel_poses(
    physics: Physics,
    starts: Sequence[State],
    times: Array,
    firsts: NDArray[np.int64],
    pool: ThreadPoolExecutor | None,
    precision: engine.Precision,
) -> tuple[Array, Array]:
    """Poses of throws of a body with one moment of inertia, by the compiled event loop, in true units."""
    poses = np.empty((len(times), 7))
    packed = kernel_states(physics.body, physics.plane, np.array([packed_state(start) for start in starts]))
    begins = np.array([start.time_s for start in starts])
    law = engine.law_of(physics.law.code, physics.law.parameters)
    cap = BOUNCING_CAP if physics.values["chi"] >= 1.0 or physics.plane.moves else IMPACT_CAP
    setup = engine.Setup(kernel_body(physics.body), law, physics.plane.plane, precision)

    def part(low: int, high: int) -> None:
        engine.poses_of_throws(setup, packed[low:high], begins[low:high], times, firsts[low : high + 1], cap, poses)

    if pool is None:
        part(0, len(starts))
    else:
        cuts = np.unique(np.linspace(0, len(starts), _POOL_PARTS + 1).astype(int))
        list(pool.map(part, cuts[:-1], cuts[1:]))
    return world_poses(physics.body, physics.plane, poses)


def lifted(physics: Physics, state: State) -> State:
    """The state with no corner below the table."""
    up = matrix_from_quat(physics.plane.world_from_table)[:, 2]
    height = touching_vertices(physics.body) @ matrix_from_quat(state.quaternion).T @ up
    of_table = engine.table_height(physics.plane.plane, state.time_s)
    lowest = float(height.min() + up @ state.position_m - physics.body.corner_radius_m - of_table)
    return state if lowest >= 0.0 else replace(state, position_m=state.position_m - lowest * up)


def predict_track(physics: Physics, track: Track, release: ReleaseState, precision: engine.Precision = COARSE) -> Track:
    """The poses at all times of the track: of the fitted flight up to the release state, simulated after it.

    Rows before the first frame of that flight are ABSENT.
    """
    times, n = track.time_s, len(track)
    covered = release.covers(times)
    position, quaternion = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
    flown = covered & (times <= release.state.time_s)
    position[flown], quaternion[flown] = release.poses(times[flown])
    later = covered & ~flown
    position[later], quaternion[later] = simulated_poses(physics, release.state, times[later], precision)
    status = np.where(covered & np.isfinite(position).all(1), TRACKED, ABSENT)
    return Track(
        track.frame, times, position, quaternion, np.full((n, 6, 6), np.nan), status, gravity_m_s2=track.gravity_m_s2
    )


def face_odds(
    physics: Physics, parameters: dict[str, Parameter], release: ReleaseState, *, draws: int = DRAWS, seed: int = 0
) -> tuple[dict[int, float], float]:
    """Odds of every face, and the share of draws that landed on none, from the covariance of the release state and the
    intervals of the parameters."""
    rng = np.random.default_rng(seed)
    root = covariance_root(release.covariance)
    landed = [
        _landing(_drawn(physics, parameters, rng), perturbed(release.state, root @ rng.standard_normal(12)))
        for _ in range(draws)
    ]
    return {face: landed.count(face) / draws for face in _faces(physics)}, landed.count(0) / draws


def _faces(physics: Physics) -> range:
    """Numbers of the faces."""
    return range(1, len(physics.die.solid.faces) + 1)


def decide(
    physics: Physics,
    parameters: dict[str, Parameter],
    track: Track,
    row: int,
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> Decision:
    """The odds from the frames before `row`, then from those of every later flight of at least three frames, and the face
    on which the last frames show the die at rest."""
    steps, flights = [], _flights_from(track, physics, row)
    for bounces, release in flights:
        odds, none = face_odds(physics, parameters, release, draws=draws, seed=seed)
        steps.append(FaceOdds(bounces, release.state.time_s, len(release.rows), odds, none))
    rested = resting_face(track, physics.die)
    if rested is not None:
        at_rest = {face: float(face == rested) for face in _faces(physics)}
        end_s = float(track.time_s[usable_rows(track, physics.die)[-1]])
        steps.append(FaceOdds(flights[-1][0] + 1, end_s, 0, at_rest, 0.0))
    decisive = None
    for step in reversed(steps):
        if step.odds[step.likeliest] < DECISION_SHARE or (decisive and step.likeliest != decisive.likeliest):
            break
        decisive = step
    if decisive is None:
        return Decision(tuple(steps), None, None, None)
    return Decision(tuple(steps), decisive.likeliest, decisive.bounces, decisive.time_s)


def _flights_from(track: Track, physics: Physics, row: int) -> list[tuple[int, ReleaseState]]:
    """The flight before `row` and those after it, each with the number of bounces since the first.

    A flight ends where its frames no longer predict the next one. Frames that scatter far more about any flight follow
    the last: there the die rolls or lies on the table.
    """
    first = release_before(track, physics.body, row)
    found = [(0, first)]
    rows = usable_rows(track, physics.die)
    begin, bounces = int(np.searchsorted(rows, row)), 1
    while len(rows) - begin >= MIN_FLIGHT_FRAMES:
        end = begin + flight_length(track, physics.die, rows[begin:])
        release = release_from(track, rows[begin:end])
        if not release.has_residuals_like(first):
            break
        found.append((bounces, release.of_die(physics.body)))
        begin, bounces = end, bounces + 1
    return found


def _drawn(physics: Physics, parameters: dict[str, Parameter], rng: np.random.Generator) -> Physics:
    """The physics with every free parameter drawn from its interval: a normal distribution with a width for each side."""
    values = {}
    for name, parameter in parameters.items():
        value, low, high, level = parameter.value, parameter.low, parameter.high, parameter.level
        if name not in physics.values or not parameter.free or value is None or low is None or high is None:
            continue
        sigmas = rng.standard_normal()
        half_width = high - value if sigmas > 0.0 else value - low
        values[name] = value + sigmas * half_width / normal_quantile(level or INTERVAL_LEVEL)
    return physics.with_values(**values)


def _landing(physics: Physics, state: State) -> int:
    """The face on which one throw lands; 0 for none."""
    start = lifted(physics, in_true_units(physics, state))
    precision = Precision(slowest_bounce=COARSE.slowest_bounce, step_turn_rad=COARSE.step_turn)
    return int(ThrowSetup(physics.body, physics.law, physics.plane, precision).throw(packed_state(start)[None]).face[0])
