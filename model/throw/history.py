"""From the log of the kernels to a `Throw`: flights, stretches of held contact, and the impacts between them.

The kernels work in the table's axes and count heights from the radius of rounded corners; a `Throw` is in world axes.
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
from ..world import GRAVITY_M_S2
from .asymmetric_throw import AsymmetricThrow, centroid_state
from .body import body_of, touching_vertices
from .held_contact import HeldContact
from .motion import Flight, Impact, State, Throw, energy_J
from .touch import packed_state, unpacked_state

Array = NDArray[np.float64]

_NO_KNOTS = np.empty((0, 15))


@dataclass(frozen=True, eq=False)
class _Stage:
    """What every event of one throw has in common."""

    die: Die
    body: engine.Body
    table: Table
    vertices: Array
    turned: Array
    """(4,) quaternion from the table's axes to the world's."""
    turn: Array
    """(3, 3) the same."""


def throw_from_log(
    die: Die, start: Array, begin_s: float, log: Array, end_s: float, knots: Array = _NO_KNOTS, table: Table = LEVEL
) -> Throw:
    """The Throw of a packed start (13,) and its logged events (k, `kernels.LOG_COLUMNS`); the last flight ends at `end_s`.

    `knots` (m, 15) are those of `kernels.run_throw`. Times are absolute.
    """
    turned = table.world_from_table
    stage = _Stage(die, body_of(die), table, touching_vertices(die), turned, matrix_from_quat(turned))
    starts = np.vstack([start, *(_after(row) for row in log)])
    times = [begin_s, *(float(t) for t in log[:, 0]), float(end_s)]
    held = [(-1, -1), *((int(row[21]), int(row[22])) for row in log)]
    split = np.searchsorted(knots[:, 0], np.arange(-1, len(log) + 1))
    flights = tuple(
        _flight(stage, starts[k], times[k], times[k + 1], held[k], knots[split[k] : split[k + 1], 1:])
        for k in range(len(starts))
    )
    faces = [_lowest_half_way(die, flight) for flight in flights] if len(log) else []
    return Throw(flights, tuple(_impact(stage, row, faces[k], faces[k + 1]) for k, row in enumerate(log)))


@dataclass(frozen=True, eq=False, kw_only=True)
class AsymmetricMotion(Flight):
    """Motion of a die that is no spherical top, in flight or on the table, between two events."""

    motion: AsymmetricThrow
    """The whole throw, in the table's axes."""
    table: Table

    def at(self, time_s: float) -> State:
        """The state at any instant of the stretch; outside it, at its nearer end."""
        state = self.motion.at(min(max(time_s, self.start.time_s), self.end_s))
        return rotated_state(state, self.table.world_from_table) if self.table.tilt_rad else state

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        states = [self.at(float(t)) for t in np.asarray(times_s, float)]
        positions = np.array([s.position_m for s in states]).reshape(-1, 3)
        return positions, np.array([s.quaternion for s in states]).reshape(-1, 4)


def rotated_state(state: State, turn: Array) -> State:
    """The same state in other axes, to which the quaternion `turn` (4,) wxyz takes."""
    matrix = matrix_from_quat(turn)
    return State(
        state.time_s,
        matrix @ state.position_m,
        quat_multiply(turn, state.quaternion),
        matrix @ state.velocity_m_s,
        matrix @ state.omega_rad_s,
    )


def throw_from_asymmetric(motion: AsymmetricThrow, release: State, table: Table) -> Throw:
    """The Throw of a die that is no spherical top; `release` in world axes."""
    die, turned = motion.die, table.world_from_table
    events = [(float(row[0]), row) for row in motion.log]
    starts = [release]
    for time, row in events:
        state = centroid_state(die, unpacked_state(_after(row), time))
        starts.append(rotated_state(state, turned) if table.tilt_rad else state)
    ends = [*(time for time, _ in events), motion.end_s]
    flights = tuple(
        AsymmetricMotion(start=start, end_s=end, motion=motion, table=table)
        for start, end in zip(starts, ends, strict=True)
    )
    return Throw(flights, asymmetric_impacts(die, table, motion.log, flights))


def asymmetric_impacts(die: Die, table: Table, log: Array, flights: Sequence[Flight]) -> tuple[Impact, ...]:
    """The logged events between the flights of a die that is no spherical top; states of the log as in `AsymmetricThrow`."""
    faces = [_lowest_half_way(die, flight) for flight in flights] if len(log) else []
    impacts = []
    for k, row in enumerate(log):
        before = centroid_state(die, unpacked_state(row[2:15], float(row[0])))
        before = rotated_state(before, table.world_from_table) if table.tilt_rad else before
        impacts.append(_asymmetric_impact(die, table, row, before, flights[k + 1].start, (faces[k], faces[k + 1])))
    return tuple(impacts)


def _asymmetric_impact(
    die: Die, table: Table, row: Array, before: State, after: State, faces: tuple[int, int]
) -> Impact:
    """One logged event of a die that is no spherical top."""
    strikes = row[1] >= 0
    vertices = [int(row[1])] if strikes else []
    arm = after.rotation @ touching_vertices(die)[vertices[0]] if strikes else np.full(3, np.nan)
    up = matrix_from_quat(table.world_from_table)[:, 2]
    arm = arm - die.corner_radius_m * up
    of_table = engine.table_velocity(table.plane, float(row[0]))
    speeds = [float(up @ (s.velocity_m_s + np.cross(s.omega_rad_s, arm))) - of_table for s in (before, after)]
    change = die.mass_kg * (row[15:18] - row[9:12])
    return Impact(
        time_s=float(row[0]),
        contact="vertex" if strikes else "held",
        vertices=tuple(vertices),
        point_m=(after.position_m + arm)[:2],
        impulse_N_s=matrix_from_quat(table.world_from_table) @ change,
        normal_velocity_before_m_s=speeds[0],
        normal_velocity_after_m_s=speeds[1],
        energy_before_J=energy_J(die, before),
        energy_after_J=energy_J(die, after),
        lowest_face_before=faces[0],
        lowest_face_after=faces[1],
        chi=-speeds[1] / speeds[0] if strikes and speeds[0] else float("nan"),
    )


def _after(row: Array) -> Array:
    """The state (13,) after an event."""
    return np.concatenate([row[2:9], row[15:21]])


def _flight(stage: _Stage, packed: Array, begin: float, end: float, pair: tuple[int, int], knots: Array) -> Flight:
    """One stretch between two events, in world axes."""
    if pair[0] < 0:
        lifted = packed[0:3] + np.array([0.0, 0.0, stage.die.corner_radius_m])
        quaternion = quat_multiply(stage.turned, packed[3:7])
        position, velocity, omega = stage.turn @ lifted, stage.turn @ packed[7:10], stage.turn @ packed[10:13]
        return Flight(State(begin, position, quaternion, velocity, omega), end)
    vertices = _held(pair)
    if pair[1] == -2:
        vertices = stage.die.solid.faces[engine.lowest_face_row(stage.die.solid.normals, packed)]
    if not len(knots):
        knots = np.concatenate([[begin], packed])[None]
    motion = HeldContact(
        start=unpacked_state(packed, begin),
        end_s=end,
        vertices=vertices,
        knots=knots,
        body=stage.body,
        plane=stage.table.plane,
        rubs=pair[1] == -3,
        world_from_table=stage.turned,
    )
    return replace(motion, start=motion.at(begin))


def _held(pair: tuple[int, int]) -> tuple[int, ...]:
    """The vertices held from an event on, of its last two columns; of a face only one."""
    if pair[1] == -3:
        return tuple(v for v in range(pair[0].bit_length()) if pair[0] >> v & 1)
    return tuple(v for v in pair if v >= 0)


def _impact(stage: _Stage, row: Array, face_before: int, face_after: int) -> Impact:
    """One logged event as an impact; `held` where no vertex strikes and only the contact changes."""
    before, after = row[2:15], _after(row)
    strikes = row[1] >= 0
    vertices = (int(row[1]),) if strikes else _held((int(row[21]), int(row[22])))
    arm = matrix_from_quat(row[5:9]) @ stage.vertices[vertices[0]] if vertices else np.full(3, np.nan)
    arm[2] -= stage.die.corner_radius_m
    of_table = engine.table_velocity(stage.table.plane, float(row[0]))
    velocity_before, velocity_after = (_normal_velocity(arm, state) - of_table for state in (before, after))
    return Impact(
        time_s=float(row[0]),
        contact="vertex" if strikes else "held",
        vertices=vertices,
        point_m=(stage.turn @ (row[2:5] + arm))[:2],
        impulse_N_s=stage.die.mass_kg * (stage.turn @ (row[15:18] - row[9:12])),
        normal_velocity_before_m_s=velocity_before,
        normal_velocity_after_m_s=velocity_after,
        energy_before_J=_energy_J(stage, before),
        energy_after_J=_energy_J(stage, after),
        lowest_face_before=face_before,
        lowest_face_after=face_after,
        chi=-velocity_after / velocity_before if strikes and velocity_before else float("nan"),
    )


def _normal_velocity(arm: Array, state: Array) -> float:
    """Vertical velocity [m/s] of the point at `arm` (3,) of a packed state."""
    return float(state[9] + state[10] * arm[1] - state[11] * arm[0])


def _energy_J(stage: _Stage, packed: Array) -> float:
    """Energy of a packed state (13,), zero for a die whose centre rests at the world's z = 0."""
    v, w, die = packed[7:10], packed[10:13], stage.die
    height = float(stage.turn[2] @ (packed[0:3] + np.array([0.0, 0.0, die.corner_radius_m])))
    kinetic = 0.5 * die.mass_kg * float(v @ v) + 0.5 * die.inertia_kg_m2 * float(w @ w)
    return kinetic + die.mass_kg * GRAVITY_M_S2 * height


def _lowest_half_way(die: Die, flight: Flight) -> int:
    """Number of the lowest face half-way through a flight."""
    packed = packed_state(flight.at(0.5 * (flight.start.time_s + flight.end_s)))
    return int(engine.lowest_face_row(die.solid.normals, packed)) + 1
