"""Throws with known truth, and their tracks with known noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diethrow.model.die.die import Die, die_from_solid, make_die
from diethrow.model.die.solid import convex_solid, inner_vertices
from diethrow.model.laws import LEVEL, ImpactLaw, SmoothImpact, Table
from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.flights.flight_chain import VertexImpact
from diethrow.tracking.flights.single_flights import WeightedPoses
from diethrow.tracking.track import TRACKED, Track

Array = NDArray[np.float64]

FPS = 1500.0
DICE = (
    make_die("cube", 0.016, 0.0048),
    make_die("tetrahedron", 0.022, 0.0015),
    make_die("icosahedron", 0.0105, 0.003),
)
"""Of the studies over many throws, taken in turn."""
BRICK = die_from_solid(
    convex_solid([(0.013 * x, 0.0156 * y, 0.0195 * z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], "brick"), 0.0048
)
"""A cuboid 1 : 1.2 : 1.5, with three moments of inertia."""


def random_release(die: Die, rng: np.random.Generator, *, spin_rad_s: float = 30.0) -> State:
    """A falling die in a random orientation, some centimetres above the table."""
    quaternion = rng.standard_normal(4)
    velocity = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-1.0, -0.6)])
    omega = rng.standard_normal(3) * spin_rad_s / np.sqrt(3.0)
    height = die.solid.circumradius + rng.uniform(0.06, 0.09)
    return State(0.0, np.array([0.0, 0.0, height]), quaternion / np.linalg.norm(quaternion), velocity, omega)


def true_throw(die: Die, release: State, chi: float, *, impacts: int, frames_after: int = 60) -> Throw:
    """The smooth throw through a number of impacts, and at most `frames_after` frames of the last flight."""
    whole = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=impacts)).throw
    last = whole.flights[-1]
    end_s = min(last.end_s, last.start.time_s + frames_after / FPS)
    return Throw((*whole.flights[:-1], replace(last, end_s=end_s)), whole.impacts)


def impact_at(die: Die, vertex: int) -> VertexImpact:
    """An impact at one vertex of that die."""
    point = inner_vertices(die.solid, die.corner_radius_m)[vertex]
    return VertexImpact(point, die.corner_radius_m, die.mass_kg * np.linalg.inv(die.tensor_kg_m2))


def frame_covariance(rng: np.random.Generator, n: int, scale: float = 1.0) -> Array:
    """Covariances (n, 6, 6) as tracking has them: 0.02 mm across the line of sight, 0.15 mm along it, 0.1 degrees."""
    depth = np.array([0.3, 0.84, -0.45])
    depth /= np.linalg.norm(depth)
    position = 0.02e-3**2 * np.eye(3) + (0.15e-3**2 - 0.02e-3**2) * np.outer(depth, depth)
    covariance = np.zeros((n, 6, 6))
    covariance[:, :3, :3] = position
    covariance[:, 3:, 3:] = np.deg2rad(0.1) ** 2 * np.eye(3)
    return covariance * (scale * rng.uniform(0.7, 1.3, n))[:, None, None] ** 2


def seen(throw: Throw, rng: np.random.Generator, *, noise: float = 1.0, stated: float = 1.0) -> Track:
    """The throw on every frame, with white noise; the covariances state `stated` times the true sigmas."""
    times = np.arange(0, int(np.floor(throw.flights[-1].end_s * FPS)) + 1) / FPS
    positions, quaternions = throw.poses(times)
    covariance = frame_covariance(rng, len(times), noise)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.standard_normal((len(times), 6)))
    return Track(
        np.arange(len(times)),
        times,
        positions + errors[:, :3],
        quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternions),
        covariance * (stated / noise) ** 2 if noise else covariance,
        np.full(len(times), TRACKED),
        turning=throw.flights[0].turning,
    )


def roughly_measured(throw: Throw, rng: np.random.Generator) -> Throw:
    """The throw with errors as tracking makes them: states slightly wrong, impacts within 0.1 frames."""
    flights = []
    for flight in throw.flights:
        s = flight.start
        start = State(
            s.time_s,
            s.position_m + 1e-4 * rng.standard_normal(3),
            quat_multiply(quat_from_rotvec(0.01 * rng.standard_normal(3)), s.quaternion),
            s.velocity_m_s + 0.01 * rng.standard_normal(3),
            s.omega_rad_s + 2.0 * rng.standard_normal(3),
        )
        flights.append(Flight(start, flight.end_s, turning=flight.turning))
    impacts = [replace(i, time_s=i.time_s + rng.uniform(-0.1, 0.1) / FPS, sigma_time_s=5e-5) for i in throw.impacts]
    return Throw(tuple(flights), tuple(impacts))


def thrown(die: Die, law: ImpactLaw, seed: int, *, table: Table = LEVEL, impacts: int = 3) -> tuple[Track, Throw]:
    """Track and measured throw of a die with any law on any table, and on for at most 60 frames."""
    rng = np.random.default_rng(seed)
    whole = throw_die(die, random_release(die, rng), law, until=Until(impacts=impacts), table=table).throw
    last = whole.flights[-1]
    end_s = min(last.end_s, last.start.time_s + 60 / FPS)
    throw = Throw((*whole.flights[:-1], replace(last, end_s=end_s)), whole.impacts)
    return seen(throw, rng), roughly_measured(throw, rng)


def blurred_in_time(track: Track, throw: Throw, rng: np.random.Generator, frames: float) -> Track:
    """The same track with errors of the same size that have a correlation time of `frames` (AR(1))."""
    positions, quaternions = throw.poses(track.time_s)
    keep = np.exp(-1.0 / frames)
    white = np.einsum("nij,nj->ni", np.linalg.cholesky(track.covariance), rng.standard_normal((len(track), 6)))
    errors = white.copy()
    for k in range(1, len(errors)):
        errors[k] = keep * errors[k - 1] + np.sqrt(1.0 - keep**2) * white[k]
    rotated = quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternions)
    return replace(track, position_m=positions + errors[:, :3], quaternion=rotated)


def later(throw: Throw, seconds: float) -> Throw:
    """The same throw with all times later by `seconds`."""
    flights = tuple(
        replace(f, start=replace(f.start, time_s=f.start.time_s + seconds), end_s=f.end_s + seconds)
        for f in throw.flights
    )
    return Throw(flights, tuple(replace(i, time_s=i.time_s + seconds) for i in throw.impacts))


def weighted_poses(track: Track, unmodelled: float = 0.0) -> WeightedPoses:
    """The poses of a track with their weights; `unmodelled` is the factor on the unmodelled errors."""
    poses = (track.time_s, track.position_m, track.quaternion, track.covariance)
    return WeightedPoses.from_poses(*poses, unmodelled=unmodelled, turning=track.turning)
