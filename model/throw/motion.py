"""The values of a throw: states, flights, impacts, and the throw itself.

A throw is a list of flights joined by impacts, whether it was measured or simulated. The flight of a spherical top is
exact: its centre moves on a parabola, and its angular velocity is constant in world axes (Kapitaniak et al., Chaos 22,
047504, 2012, Eqs 1 to 4). That of a body with several moments of inertia turns by Euler's equations
(`engine.asymmetric.torque_free`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..die import Die
from ..engine.asymmetric import EvenTurning, TorqueFree, torque_free_turns
from ..errors import InputError
from ..rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, quat_multiply
from ..world import GRAVITY_M_S2

Array = NDArray[np.float64]
Turning = EvenTurning | TorqueFree

EVEN = EvenTurning(1.0)
"""How any spherical top turns."""

CACHED_DICE = 16
"""Dice whose principal axes are kept, because flights of one die are made again and again."""


@dataclass(frozen=True, eq=False)
class State:
    """A die at one instant, in world axes: z is up, and a level table at rest is z = 0."""

    time_s: float
    position_m: Array
    """(3,) centre of the die."""
    quaternion: Array
    """(4,) wxyz, unit; takes body axes to world axes."""
    velocity_m_s: Array
    """(3,) of the centre."""
    omega_rad_s: Array
    """(3,) angular velocity, world axes."""

    @property
    def rotation(self) -> Array:
        """(3, 3) body to world."""
        return matrix_from_quat(self.quaternion)


@lru_cache(maxsize=CACHED_DICE)
def turning_of(die: Die) -> Turning:
    """How a die turns in flight, about its centre of mass."""
    if die.isotropic_inertia_kg_m2 is not None:
        return EVEN
    moments, axes = np.linalg.eigh(die.tensor_kg_m2)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    return TorqueFree(moments, quat_from_matrix(axes))


class Turns(NamedTuple):
    """Attitudes of a body that turns without torque, at n instants."""

    quaternions: Array
    """(n, 4)."""
    omegas_rad_s: Array
    """(n, 3) world axes."""
    transitions: Array
    """(n, 6, 6) derivatives of attitude and angular velocity by those at the start."""


def turns_in_flight(turning: TorqueFree, start: State, delays_s: Array) -> Turns:
    """The attitudes `delays_s` (n,) after a state, of either sign."""
    n = len(delays_s)
    found = Turns(np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 6, 6)))
    quaternion, omega = np.ascontiguousarray(start.quaternion), np.ascontiguousarray(start.omega_rad_s)
    torque_free_turns(turning, quaternion, omega, np.ascontiguousarray(delays_s), *found)
    return found


@dataclass(frozen=True, eq=False)
class Flight:
    """Motion between two impacts, from the instant of `start` until `end_s`: free flight under gravity of a body whose centre of
    mass is its centroid.

    Subclasses move otherwise: `HeldContact` on the table, `AsymmetricMotion` with any inertia there too, `LoadedMotion`
    with its centre of mass elsewhere, `DraggedFlight` in air.
    """

    start: State
    end_s: float
    covariance: Array | None = None
    """(12, 12) of a measured `start`: position [m], rotation vector [rad], velocity [m/s] and angular velocity [rad/s],
    world axes, R_true = exp(δ) R. None for a simulated flight."""
    gravity_m_s2: float = GRAVITY_M_S2
    """Along -z."""
    turning: Turning = EVEN
    """How the body turns: `turning_of` its die."""

    def at(self, time_s: float) -> State:
        """The state at any instant; before and after the flight its motion is extrapolated."""
        positions, quaternions = self.poses(np.array([time_s]))
        rates = self.rates(np.array([time_s]))[0]
        return State(time_s, positions[0], quaternions[0], rates[:3], rates[3:])

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        dt = np.asarray(times_s, float) - self.start.time_s
        positions = self.start.position_m + np.outer(dt, self.start.velocity_m_s)
        positions[:, 2] -= 0.5 * self.gravity_m_s2 * dt**2
        if isinstance(self.turning, TorqueFree):
            return positions, turns_in_flight(self.turning, self.start, dt).quaternions
        turns = quat_from_rotvec(np.outer(dt, self.start.omega_rad_s))
        return positions, quat_multiply(turns, self.start.quaternion)

    def rates(self, times_s: ArrayLike) -> Array:
        """Velocities [m/s] and angular velocities [rad/s] (n, 6), world axes, at times (n,) [s]."""
        dt = np.asarray(times_s, float) - self.start.time_s
        rates = np.tile(np.concatenate([self.start.velocity_m_s, self.start.omega_rad_s]), (len(dt), 1))
        rates[:, 2] -= self.gravity_m_s2 * dt
        if isinstance(self.turning, TorqueFree):
            rates[:, 3:] = turns_in_flight(self.turning, self.start, dt).omegas_rad_s
        return rates


class SampledFlight(Flight):
    """Motion without a closed form: poses and rates are those of the states at the given times."""

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        states = [self.at(float(t)) for t in np.asarray(times_s, float)]
        positions = np.array([s.position_m for s in states]).reshape(-1, 3)
        return positions, np.array([s.quaternion for s in states]).reshape(-1, 4)

    def rates(self, times_s: ArrayLike) -> Array:
        """Velocities [m/s] and angular velocities [rad/s] (n, 6), world axes, at times (n,) [s]."""
        states = [self.at(float(t)) for t in np.asarray(times_s, float)]
        return np.array([[*s.velocity_m_s, *s.omega_rad_s] for s in states]).reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class Impact:
    """One impact on the table, measured or simulated. Unknown numbers are NaN."""

    time_s: float
    contact: str
    """`vertex`, `edge`, `face` or `unresolved`. In simulated throws also `held`: nothing strikes, and the set of vertices that
    carry the die changes, or becomes empty."""
    vertices: tuple[int, ...]
    """Indices of the vertices that touch; empty when unresolved. For `held`, the vertices held from then on."""
    point_m: Array
    """(2,) x and y of the contact on the table."""
    impulse_N_s: Array
    """(3,) on the die, world axes."""
    normal_velocity_before_m_s: float
    """Of the contact point, relative to the table along its normal: negative."""
    normal_velocity_after_m_s: float
    energy_before_J: float
    """Kinetic and potential energy, zero at the height of the table."""
    energy_after_J: float
    lowest_face_before: int
    """Number (1, 2, …) of the face that points down most, half-way through the flight before."""
    lowest_face_after: int
    """The same, half-way through the flight after."""
    sigma_time_s: float = np.nan
    chi: float = np.nan
    """Apparent restitution: -(normal velocity after) / (normal velocity before)."""
    chi_low: float = np.nan
    chi_high: float = np.nan
    """Bounds of its 95 % interval."""


@dataclass(frozen=True, eq=False)
class Throw:
    """Flights joined by impacts: `impacts[k]` ends `flights[k]` and begins `flights[k + 1]`."""

    flights: tuple[Flight, ...]
    impacts: tuple[Impact, ...]

    def __post_init__(self) -> None:
        if len(self.flights) != len(self.impacts) + 1:
            raise InputError(
                f"{len(self.flights)} flights and {len(self.impacts)} impacts: wanted one flight more than impacts"
            )

    @property
    def bounces(self) -> tuple[Impact, ...]:
        """The impacts in which a vertex, edge or face strikes the table."""
        return tuple(impact for impact in self.impacts if impact.contact != "held")

    def flight_at(self, time_s: float) -> int:
        """Index of the flight at this instant: the first before the release, the last after the end."""
        return int(self.flights_at(time_s))

    def flights_at(self, times_s: ArrayLike) -> NDArray[np.int64]:
        """Indices (n,) of the flights at times (n,) [s]."""
        return np.searchsorted([impact.time_s for impact in self.impacts], times_s, side="right")

    def at(self, time_s: float) -> State:
        """The state at any instant."""
        return self.flights[self.flight_at(time_s)].at(time_s)

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        times = np.asarray(times_s, float)
        which = self.flights_at(times)
        positions, quaternions = np.empty((len(times), 3)), np.empty((len(times), 4))
        for k in np.unique(which):
            rows = which == k
            positions[rows], quaternions[rows] = self.flights[k].poses(times[rows])
        return positions, quaternions

    def rates(self, times_s: ArrayLike) -> Array:
        """Velocities [m/s] and angular velocities [rad/s] (n, 6), world axes, at times (n,) [s]."""
        times = np.asarray(times_s, float)
        which, rates = self.flights_at(times), np.empty((len(times), 6))
        for k in np.unique(which):
            rows = which == k
            rates[rows] = self.flights[k].rates(times[rows])
        return rates


def rotated_state(state: State, rotation: Array) -> State:
    """The same state in other axes. `rotation` (4,) wxyz takes the old axes to the new."""
    matrix = matrix_from_quat(rotation)
    return State(
        state.time_s,
        matrix @ state.position_m,
        quat_multiply(rotation, state.quaternion),
        matrix @ state.velocity_m_s,
        matrix @ state.omega_rad_s,
    )


def energy_J(die: Die, state: State, gravity_m_s2: float = GRAVITY_M_S2) -> float:
    """Kinetic plus potential energy [J], zero for a die at rest with its centre of mass at the height of the table."""
    position, v, w = state.position_m, state.velocity_m_s, state.omega_rad_s
    if die.is_spherical_top:
        rotational = die.inertia_kg_m2 * float(w @ w)
    else:
        spin = state.rotation.T @ w
        rotational = float(spin @ die.tensor_kg_m2 @ spin)
        arm = state.rotation @ die.centre_of_mass_offset_m
        position, v = position + arm, v + np.cross(w, arm)
    return 0.5 * (die.mass_kg * float(v @ v) + rotational) + die.mass_kg * gravity_m_s2 * float(position[2])
