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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model import engine
from ...model.ensembles import ThrowSetup
from ...model.errors import InputError
from ...model.rotations import matrix_from_quat
from ...model.throw import (
    BOUNCING_CAP,
    IMPACT_CAP,
    Door,
    Precision,
    State,
    Until,
    body_kind,
    kernel_states,
    packed_state,
    refuse_unsupported,
    touching_vertices,
    unpacked_state,
    world_poses,
)
from ...tracking.covariance import covariance_root
from ...tracking.flights import perturbed
from ...tracking.track import ABSENT, TRACKED, Track
from ..estimation import normal_quantile
from ..results import Parameter, ParameterCovariance
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
    packed = np.array([packed_state(state) for state in states])
    return simulated_packed(physics, packed, np.array([state.time_s for state in states]), times_s, pool, precision)


def simulated_packed(
    physics: Physics,
    packed: Array,
    begins_s: Array,
    times_s: Sequence[Array],
    pool: ThreadPoolExecutor | None = None,
    precision: engine.Precision = COARSE,
) -> tuple[Array, Array]:
    """The same from states as `model.throw.packed_state` makes them, (m, 13) at the times (m,) [s]."""
    for begin, times in zip(begins_s, times_s, strict=True):
        if len(times) and times[0] < begin - _TIME_ROUNDING_S:
            raise InputError(f"times_s from {times[0]:g}: wanted none before the state's, {begin:g} s")
    clock, length = physics.clock, physics.length
    true = packed / np.repeat([length, 1.0, clock * length, clock], (3, 4, 3, 3))
    starts, begins = lifted(physics, true, clock * begins_s), clock * begins_s
    firsts = np.concatenate([[0], np.cumsum([len(times) for times in times_s])]).astype(np.int64)
    times = clock * np.concatenate([np.empty(0), *times_s])
    if physics.body.isotropic_inertia_kg_m2 is None:
        positions, quaternions = _asymmetric_poses(physics, starts, begins, times, firsts)
    else:
        positions, quaternions = _kernel_poses(physics, starts, begins, times, firsts, pool, precision)
    return length * positions, quaternions


def _asymmetric_poses(
    physics: Physics, starts: Array, begins_s: Array, times: Array, firsts: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Poses of throws of a body with three moments of inertia, one by one, in true units."""
    poses = np.empty((len(times), 7))
    for start, begin, low, high in zip(starts, begins_s, firsts, firsts[1:], strict=False):
        if high > low:
            throw = physics.throw(unpacked_state(start, begin), Until(time_s=float(times[high - 1]))).throw
            poses[low:high] = np.hstack(throw.poses(times[low:high]))
    return poses[:, :3], poses[:, 3:]


def _kernel_poses(
    physics: Physics,
    starts: Array,
    begins_s: Array,
    times: Array,
    firsts: NDArray[np.int64],
    pool: ThreadPoolExecutor | None,
    precision: engine.Precision,
) -> tuple[Array, Array]:
    """Poses of throws of a body with one moment of inertia, by the compiled event loop, in true units."""
    poses = np.empty((len(times), 7))
    packed = kernel_states(physics.body, physics.plane, starts)
    law = engine.law_of(physics.law.code, physics.law.parameters)
    refuse_unsupported(Door.THROW, body_kind(physics.body), law, has_drag=physics.drag_per_m > 0.0)
    cap = BOUNCING_CAP if physics.values["chi"] >= 1.0 or physics.plane.moves else IMPACT_CAP
    setup = engine.Setup(kernel_body(physics.body), law, physics.plane.plane_in_air(physics.drag_per_m), precision)

    def part(low: int, high: int) -> None:
        engine.poses_of_throws(setup, packed[low:high], begins_s[low:high], times, firsts[low : high + 1], cap, poses)

    if pool is None:
        part(0, len(starts))
    else:
        cuts = np.unique(np.linspace(0, len(starts), _POOL_PARTS + 1).astype(int))
        list(pool.map(part, cuts[:-1], cuts[1:]))
    return world_poses(physics.body, physics.plane, poses)


def lifted(physics: Physics, states: Array, times_s: Array) -> Array:
    """States (m, 13) at the times (m,) [s] with no corner below the table."""
    up = matrix_from_quat(physics.plane.world_from_table)[:, 2]
    arms = matrix_from_quat(states[:, 3:7]) @ touching_vertices(physics.body).T
    heights = np.einsum("i,mij->mj", up, arms).min(1) + states[:, :3] @ up
    of_table = np.array([engine.table_height(physics.plane.plane, time) for time in times_s])
    raised = states.copy()
    raised[:, :3] -= np.minimum(heights - physics.body.corner_radius_m - of_table, 0.0)[:, None] * up
    return raised


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
    physics: Physics,
    parameters: dict[str, Parameter],
    release: ReleaseState,
    covariance: ParameterCovariance | None = None,
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> tuple[dict[int, float], float]:
    """Odds of every face, and the share of draws that landed on none, from the covariance of the release state and that of the
    parameters or, without it, their intervals."""
    rng = np.random.default_rng(seed)
    root = covariance_root(release.covariance)
    landed = [
        _landing(
            drawn_physics(physics, parameters, covariance, rng),
            perturbed(release.state, root @ rng.standard_normal(12)),
        )
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
    covariance: ParameterCovariance | None = None,
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> Decision:
    """The odds from the frames before `row`, then from those of every later flight of at least three frames, and the face
    on which the last frames show the die at rest."""
    steps, flights = [], _flights_from(track, physics, row)
    for bounces, release in flights:
        odds, none = face_odds(physics, parameters, release, covariance, draws=draws, seed=seed)
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


def drawn_physics(
    physics: Physics, parameters: dict[str, Parameter], covariance: ParameterCovariance | None, rng: np.random.Generator
) -> Physics:
    """The physics with its parameters drawn from their joint covariance or, where that is unknown, each from its interval: a
    normal distribution with a width for each side."""
    values = {}
    if covariance is not None:
        errors = covariance_root(covariance.matrix) @ rng.standard_normal(len(covariance.names))
        values = {n: physics.values[n] + float(e) for n, e in zip(covariance.names, errors, strict=True)}
    for name, parameter in parameters.items():
        value, low, high, level = parameter.value, parameter.low, parameter.high, parameter.level
        if name in values or name not in physics.values or not parameter.free:
            continue
        if value is None or low is None or high is None:
            continue
        sigmas = rng.standard_normal()
        half_width = high - value if sigmas > 0.0 else value - low
        values[name] = value + sigmas * half_width / normal_quantile(level or INTERVAL_LEVEL)
    return physics.with_values(**values)


def _landing(physics: Physics, state: State) -> int:
    """The face on which one throw lands; 0 for none."""
    start = in_true_units(physics, state)
    packed = lifted(physics, packed_state(start)[None], np.array([start.time_s]))
    precision = Precision(slowest_bounce=COARSE.slowest_bounce, step_turn_rad=COARSE.step_turn)
    setup = ThrowSetup(physics.body, physics.law, physics.plane, precision, physics.drag_per_m)
    return int(setup.throw(packed).face[0])
