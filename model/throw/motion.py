"""The values of a throw: states, flights, impacts, and the throw itself.

A throw is a list of flights joined by impacts, whether a camera saw it or the model made it. In flight the motion is
exact: a parabola for the centre and a constant angular velocity in world axes, because the dice are spherical tops
(Kapitaniak et al., Chaos 22, 047504, 2012, Eqs 1 to 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..die import Die
from ..rotations import matrix_from_quat, quat_from_rotvec, quat_multiply
from ..world import GRAVITY_M_S2

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """A die at one instant, in world axes (z up, the table at rest is z = 0)."""

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


@dataclass(frozen=True, eq=False)
class Flight:
    """Exact motion under gravity alone from the instant of `start` until `end_s`; its counterpart is `contact.HeldContact`."""

    start: State
    end_s: float
    covariance: Array | None = None
    """(12, 12) of `start` where it was measured: position [m], rotation vector [rad], velocity [m/s] and angular
    velocity [rad/s], world axes, R_true = exp(δ) R. None for a modelled flight."""

    def at(self, time_s: float) -> State:
        """The state at any instant; outside the flight, where the same motion would lead."""
        dt = time_s - self.start.time_s
        positions, quaternions = self.poses(np.array([time_s]))
        velocity = self.start.velocity_m_s - np.array([0.0, 0.0, GRAVITY_M_S2 * dt])
        return State(time_s, positions[0], quaternions[0], velocity, self.start.omega_rad_s)

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        dt = np.asarray(times_s, float) - self.start.time_s
        positions = self.start.position_m + np.outer(dt, self.start.velocity_m_s)
        positions[:, 2] -= 0.5 * GRAVITY_M_S2 * dt**2
        turns = quat_from_rotvec(np.outer(dt, self.start.omega_rad_s))
        return positions, quat_multiply(turns, self.start.quaternion)

    def rates(self, times_s: ArrayLike) -> Array:
        """Velocities [m/s] and angular velocities [rad/s] (n, 6), world axes, at times (n,) [s]."""
        dt = np.asarray(times_s, float) - self.start.time_s
        rates = np.tile(np.concatenate([self.start.velocity_m_s, self.start.omega_rad_s]), (len(dt), 1))
        rates[:, 2] -= GRAVITY_M_S2 * dt
        return rates


@dataclass(frozen=True, eq=False)
class Impact:
    """One bounce on the table, measured or modelled. What is not known is NaN."""

    time_s: float
    contact: str
    """`vertex`, `edge`, `face`, or `unresolved`; and `held` where nothing strikes and the die only begins to press on
    other vertices than before, or on none (modelled throws alone)."""
    vertices: tuple[int, ...]
    """Indices of the vertices that touch; empty when unresolved. Of `held`: those held from then on."""
    point_m: Array
    """(2,) x and y of the contact on the table."""
    impulse_N_s: Array
    """(3,) on the die, world axes."""
    normal_velocity_before_m_s: float
    """Of the contact point, along +z: negative."""
    normal_velocity_after_m_s: float
    energy_before_J: float
    """Kinetic and potential, the table as zero height."""
    energy_after_J: float
    lowest_face_before: int
    """Number (1, 2, …) of the face that looked down most half-way through the flight that led here."""
    lowest_face_after: int
    """The same, half-way through the flight that follows."""
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
            raise ValueError(
                f"{len(self.flights)} flights and {len(self.impacts)} impacts: wanted one flight more than impacts"
            )

    @property
    def bounces(self) -> tuple[Impact, ...]:
        """The impacts in which something strikes."""
        return tuple(impact for impact in self.impacts if impact.contact != "held")

    def flight_at(self, time_s: float) -> int:
        """Index of the flight that holds this instant; before the release the first, after the end the last."""
        return int(self.flights_at(time_s))

    def flights_at(self, times_s: ArrayLike) -> NDArray[np.int64]:
        """(n,) the same of many instants."""
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
            mine = which == k
            positions[mine], quaternions[mine] = self.flights[k].poses(times[mine])
        return positions, quaternions

    def rates(self, times_s: ArrayLike) -> Array:
        """Velocities [m/s] and angular velocities [rad/s] (n, 6), world axes, at times (n,) [s]."""
        times = np.asarray(times_s, float)
        which, rates = self.flights_at(times), np.empty((len(times), 6))
        for k in np.unique(which):
            mine = which == k
            rates[mine] = self.flights[k].rates(times[mine])
        return rates


def energy_J(die: Die, state: State) -> float:
    """Kinetic plus potential energy [J], zero for a die whose centre of mass rests at the height of the table."""
    position, v, w = state.position_m, state.velocity_m_s, state.omega_rad_s
    if die.is_spherical_top:
        turning = die.inertia_kg_m2 * float(w @ w)
    else:
        spin = state.rotation.T @ w
        turning = float(spin @ np.asarray(die.inertia_tensor_kg_m2) @ spin)
        arm = state.rotation @ (np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m)
        position, v = position + arm, v + np.cross(w, arm)
    return 0.5 * (die.mass_kg * float(v @ v) + turning) + die.mass_kg * GRAVITY_M_S2 * float(position[2])
