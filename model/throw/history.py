"""From the event log of the kernels to a `Throw`: flights, spans of held contact, and the impacts between them.

The kernels work in the table's axes, follow the centre of mass, and count heights from the radius of rounded corners. A
`Throw` is in world axes and of the centroid. A row of the log (`engine.types.LOG_COLUMNS`) holds an event: time, vertex
or -1, the pose, the velocities before and after, two numbers for the contact from then on, and the bits of the vertices that
struck together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import engine
from ..die import Die
from ..laws import LEVEL, Table
from ..rotations import matrix_from_quat, quat_multiply
from .asymmetric_throw import AsymmetricThrow
from .body import body_of, centre_of_mass_state, centroid_state, packed_state, touching_vertices, unpacked_state
from .held_contact import HeldContact
from .motion import Flight, Impact, SampledFlight, State, Throw, energy_J, rotated_state, turning_of

Array = NDArray[np.float64]
Pair = tuple[int, int]

HELD_FACE = -2
"""Second contact number of a row from which on the lowest face is held; the first is one of its vertices."""

HELD_WITH_FRICTION = int(engine.SLIDING)
"""Second contact number of a row from which on vertices are held with friction; the first has a bit set for each of them."""

FREE: Pair = (-1, -1)
"""Contact numbers of a row from which on nothing is held. A held vertex has one of them, two held vertices both."""

_NO_KNOTS = np.empty((0, 15))


@dataclass(frozen=True, eq=False)
class _Setup:
    """What all events of one throw have in common."""

    die: Die
    body: engine.Body
    table: Table
    drag_per_m: float
    vertices: Array
    quaternion: Array
    """(4,) from the table's axes to the world's."""
    matrix: Array
    """(3, 3) the same."""


@dataclass(frozen=True, eq=False, kw_only=True)
class AsymmetricMotion(SampledFlight):
    """Motion of an asymmetric die between two events, in flight or on the table."""

    motion: AsymmetricThrow
    """The whole throw, in the table's axes."""
    table: Table

    def at(self, time_s: float) -> State:
        """The state at any instant of the span; before and after it, that of its nearer end."""
        state = self.motion.at(min(max(time_s, self.start.time_s), self.end_s))
        return rotated_state(state, self.table.world_from_table) if self.table.tilt_rad else state


@dataclass(frozen=True, eq=False, kw_only=True)
class DraggedFlight(Flight):
    """Flight of a spherical top with quadratic drag; before and after it the same motion is extrapolated."""

    drag_per_m: float

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        return self._trajectory(times_s)[:, :3], super().poses(times_s)[1]

    def rates(self, times_s: ArrayLike) -> Array:
        """Velocities [m/s] and angular velocities [rad/s] (n, 6), world axes, at times (n,) [s]."""
        return np.hstack([self._trajectory(times_s)[:, 3:], super().rates(times_s)[:, 3:]])

    def _trajectory(self, times_s: ArrayLike) -> Array:
        """Positions and velocities (n, 6) at times (n,) [s]."""
        delays = np.atleast_1d(np.asarray(times_s, float)) - self.start.time_s
        return engine.drag_trajectory(self.drag_per_m, self.gravity_m_s2, packed_state(self.start), delays)


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadedMotion(SampledFlight):
    """Motion of the centroid of a die whose centre of mass lies beside it."""

    of_mass: Flight
    """The motion of the centre of mass."""
    centre_of_mass_m: Array
    """(3,) from the centroid, body axes."""

    @staticmethod
    def beside(of_mass: Flight, die: Die) -> LoadedMotion:
        """That of the centroid, from that of the centre of mass."""
        return LoadedMotion(
            start=centroid_state(die, of_mass.start), end_s=of_mass.end_s, gravity_m_s2=of_mass.gravity_m_s2,
            turning=of_mass.turning, of_mass=of_mass, centre_of_mass_m=die.centre_of_mass_offset_m,
        )  # fmt: skip

    def at(self, time_s: float) -> State:
        """The state at any instant."""
        state = self.of_mass.at(time_s)
        arm = state.rotation @ self.centre_of_mass_m
        velocity = state.velocity_m_s - np.cross(state.omega_rad_s, arm)
        return replace(state, position_m=state.position_m - arm, velocity_m_s=velocity)

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        positions, quaternions = self.of_mass.poses(times_s)
        return positions - matrix_from_quat(quaternions) @ self.centre_of_mass_m, quaternions


def free_flight(die: Die, start: State, end_s: float, gravity_m_s2: float) -> Flight:
    """The free flight of a die, from the state of its centroid."""
    if die.centre_of_mass_m is None:
        return Flight(start, end_s, gravity_m_s2=gravity_m_s2, turning=turning_of(die))
    of_mass = Flight(
        centre_of_mass_state(die, start), end_s, gravity_m_s2=gravity_m_s2, turning=turning_of(die)
    )  # fmt: skip
    return LoadedMotion.beside(of_mass, die)


def throw_from_log(
    die: Die,
    start: Array,
    begin_s: float,
    log: Array,
    end_s: float,
    knots: Array = _NO_KNOTS,
    table: Table = LEVEL,
    drag_per_m: float = 0.0,
) -> Throw:
    """The Throw of a die with one moment of inertia from its packed start (13,) and its logged events (k, LOG_COLUMNS).

    Start and log are those of the centre of mass. The last flight ends at `end_s`. `knots` (m, 15) are those of
    `engine.run_throw`. Times are on the clock of the release.
    """
    quaternion = table.world_from_table
    body = body_of(die)
    setup = _Setup(die, body, table, drag_per_m, body.vertices, quaternion, matrix_from_quat(quaternion))
    starts = np.vstack([start, *(state_after(row) for row in log)])
    times = [begin_s, *(float(t) for t in log[:, 0]), float(end_s)]
    contacts = [FREE, *(_contact(row) for row in log)]
    split = np.searchsorted(knots[:, 0], np.arange(-1, len(log) + 1))
    flights: tuple[Flight, ...] = tuple(
        _flight(setup, starts[k], times[k], times[k + 1], contacts[k], knots[split[k] : split[k + 1], 1:])
        for k in range(len(starts))
    )
    faces = [_lowest_face_halfway(die, flight) for flight in flights] if len(log) else []
    if die.centre_of_mass_m is not None:
        flights = tuple(LoadedMotion.beside(flight, die) for flight in flights)
    return Throw(flights, tuple(_impact(setup, row, faces[k], faces[k + 1]) for k, row in enumerate(log)))


def throw_from_asymmetric(motion: AsymmetricThrow, release: State, table: Table) -> Throw:
    """The Throw of an asymmetric die; `release` in world axes."""
    starts, turning = [release, *states_after_events(motion.die, table, motion.log)], turning_of(motion.die)
    ends = [*(float(time) for time in motion.log[:, 0]), motion.end_s]
    flights = tuple(
        AsymmetricMotion(
            start=start, end_s=end, gravity_m_s2=table.gravity_m_s2, turning=turning, motion=motion, table=table
        )
        for start, end in zip(starts, ends, strict=True)
    )
    return Throw(flights, asymmetric_impacts(motion.die, table, motion.log, flights))


def state_after(row: Array) -> Array:
    """The packed state (13,) after a logged event."""
    return np.concatenate([row[2:9], row[15:21]])


def states_after_events(die: Die, table: Table, log: Array) -> list[State]:
    """States of the centroid in world axes after each event in the log of an asymmetric die, as `AsymmetricThrow` has it."""
    states = [centroid_state(die, unpacked_state(state_after(row), float(row[0]))) for row in log]
    return [rotated_state(state, table.world_from_table) for state in states] if table.tilt_rad else states


def asymmetric_impacts(die: Die, table: Table, log: Array, flights: Sequence[Flight]) -> tuple[Impact, ...]:
    """The logged events between the flights of an asymmetric die; the log as `AsymmetricThrow` has it."""
    faces = [_lowest_face_halfway(die, flight) for flight in flights] if len(log) else []
    impacts = []
    for k, row in enumerate(log):
        before = centroid_state(die, unpacked_state(row[2:15], float(row[0])))
        before = rotated_state(before, table.world_from_table) if table.tilt_rad else before
        impacts.append(_asymmetric_impact(die, table, row, before, flights[k + 1].start, (faces[k], faces[k + 1])))
    return tuple(impacts)


def _asymmetric_impact(die: Die, table: Table, row: Array, before: State, after: State, faces: Pair) -> Impact:
    """One logged event of an asymmetric die, from its states in world axes and the lowest faces before and after."""
    strikes = row[1] >= 0
    vertices = _struck(row) if strikes else ()
    arm = after.rotation @ touching_vertices(die)[list(vertices)].mean(axis=0) if strikes else np.full(3, np.nan)
    world_from_table = matrix_from_quat(table.world_from_table)
    up = world_from_table[:, 2]
    arm = arm - die.corner_radius_m * up
    table_speed = engine.table_velocity(table.plane, float(row[0]))
    speeds = [float(up @ (s.velocity_m_s + np.cross(s.omega_rad_s, arm))) - table_speed for s in (before, after)]
    momentum = die.mass_kg * (row[15:18] - row[9:12])
    return Impact(
        time_s=float(row[0]),
        contact=_contact_name(len(vertices)) if strikes else "held",
        vertices=vertices,
        point_m=(after.position_m + arm)[:2],
        impulse_N_s=world_from_table @ momentum,
        normal_velocity_before_m_s=speeds[0],
        normal_velocity_after_m_s=speeds[1],
        energy_before_J=energy_J(die, before, table.gravity_m_s2),
        energy_after_J=energy_J(die, after, table.gravity_m_s2),
        lowest_face_before=faces[0],
        lowest_face_after=faces[1],
        chi=-speeds[1] / speeds[0] if strikes and speeds[0] else float("nan"),
    )


def _flight(setup: _Setup, packed: Array, begin: float, end: float, contact: Pair, knots: Array) -> Flight:
    """The motion between two events, in world axes."""
    if contact[0] < 0:
        lifted = packed[0:3] + np.array([0.0, 0.0, setup.die.corner_radius_m])
        quaternion = quat_multiply(setup.quaternion, packed[3:7])
        position, velocity, omega = setup.matrix @ lifted, setup.matrix @ packed[7:10], setup.matrix @ packed[10:13]
        state, gravity_m_s2 = State(begin, position, quaternion, velocity, omega), setup.table.gravity_m_s2
        if setup.drag_per_m > 0.0:
            return DraggedFlight(start=state, end_s=end, gravity_m_s2=gravity_m_s2, drag_per_m=setup.drag_per_m)
        return Flight(state, end, gravity_m_s2=gravity_m_s2)
    vertices = _held_vertices(contact)
    if contact[1] == HELD_FACE:
        vertices = setup.die.solid.faces[engine.lowest_face_row(setup.die.solid.normals, packed)]
    if not len(knots):
        knots = np.concatenate([[begin], packed])[None]
    motion = HeldContact(
        start=unpacked_state(packed, begin),
        end_s=end,
        vertices=vertices,
        knots=knots,
        body=setup.body,
        gravity_m_s2=setup.table.gravity_m_s2,
        plane=setup.table.plane_in_air(setup.drag_per_m),
        has_friction=contact[1] == HELD_WITH_FRICTION,
        world_from_table=setup.quaternion,
    )
    return replace(motion, start=motion.at(begin))


def _struck(row: Array) -> tuple[int, ...]:
    """The vertices that an impact strikes: one, or all that touch at its instant."""
    return _vertices_of_bits(int(row[23])) if row[23] > 0.0 else (int(row[1]),)


def _contact_name(count: int) -> str:
    """Of so many vertices that strike at once."""
    return {1: "vertex", 2: "edge"}.get(count, "face")


def _vertices_of_bits(bits: int) -> tuple[int, ...]:
    return tuple(v for v in range(bits.bit_length()) if bits >> v & 1)


def _contact(row: Array) -> Pair:
    """The two contact numbers of a logged event."""
    return int(row[21]), int(row[22])


def _held_vertices(contact: Pair) -> tuple[int, ...]:
    """The vertices held from an event on; of a face only one."""
    if contact[1] == HELD_WITH_FRICTION:
        return _vertices_of_bits(contact[0])
    return tuple(v for v in contact if v >= 0)


def _impact(setup: _Setup, row: Array, face_before: int, face_after: int) -> Impact:
    """One logged event as an impact; `held` if no vertex strikes and only the contact changes."""
    before, after = row[2:15], state_after(row)
    strikes = row[1] >= 0
    vertices = _struck(row) if strikes else _held_vertices(_contact(row))
    at = list(vertices) if strikes else list(vertices[:1])
    arm = matrix_from_quat(row[5:9]) @ setup.vertices[at].mean(axis=0) if vertices else np.full(3, np.nan)
    arm[2] -= setup.die.corner_radius_m
    table_speed = engine.table_velocity(setup.table.plane, float(row[0]))
    velocity_before, velocity_after = (_normal_velocity(arm, state) - table_speed for state in (before, after))
    return Impact(
        time_s=float(row[0]),
        contact=_contact_name(len(vertices)) if strikes else "held",
        vertices=vertices,
        point_m=(setup.matrix @ (row[2:5] + arm))[:2],
        impulse_N_s=setup.die.mass_kg * (setup.matrix @ (row[15:18] - row[9:12])),
        normal_velocity_before_m_s=velocity_before,
        normal_velocity_after_m_s=velocity_after,
        energy_before_J=_energy_J(setup, before),
        energy_after_J=_energy_J(setup, after),
        lowest_face_before=face_before,
        lowest_face_after=face_after,
        chi=-velocity_after / velocity_before if strikes and velocity_before else float("nan"),
    )


def _normal_velocity(arm: Array, state: Array) -> float:
    """Velocity [m/s] along the table's normal of the point at `arm` (3,) of a packed state."""
    return float(state[9] + state[10] * arm[1] - state[11] * arm[0])


def _energy_J(setup: _Setup, packed: Array) -> float:
    """Energy [J] of a packed state (13,), zero for a die at rest with its centre of mass at the world's z = 0."""
    v, w, die = packed[7:10], packed[10:13], setup.die
    height = float(setup.matrix[2] @ (packed[0:3] + np.array([0.0, 0.0, die.corner_radius_m])))
    kinetic = 0.5 * die.mass_kg * float(v @ v) + 0.5 * setup.body.inertia * float(w @ w)
    return kinetic + die.mass_kg * setup.table.gravity_m_s2 * height


def _lowest_face_halfway(die: Die, flight: Flight) -> int:
    """Number of the lowest face half-way through a flight."""
    packed = packed_state(flight.at(0.5 * (flight.start.time_s + flight.end_s)))
    return int(engine.lowest_face_row(die.solid.normals, packed)) + 1
