"""A throw, event by event: fly to the next touch, bounce, and so on until something ends it.

**Rest.** Without friction nothing changes the horizontal velocity or ω_z, so only the rest of the energy,
E' = m g z + m v_z²/2 + J (ω_x² + ω_y²)/2, can turn the die over. To leave its lowest face the die must lift its centre
over the nearest edge of that face, at the height d (the distance of the edge from the centre). Once E' < m g d it
never can: the landed face is decided, exactly and without a tolerance, although the die still rattles on it.

**Chatter.** Before that, a vertex that the die presses onto the table may bounce lower and lower, each flight about χ
times as long as the one before: infinitely many impacts in a finite time, after which the vertex stays on the table
and the die turns about it. That held contact is not simulated here. The collapse is recognised by its own mark: the
fastest of the touching vertices comes down slower than 1e-6 √(gR) (R the circumradius), and accelerates into the
table, so the next bounces rise less than 1e-12 R and their flights shrink geometrically. Then the throw ends and says
so. A slow touch of a vertex that swings up again by itself is a graze, no chatter; and at χ = 1 nothing shrinks, so
there chatter is only a touch whose velocity is lost in rounding.

The horizontal drift of a resting die is not stopped either: nothing rubs.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from . import kernels
from .impacts import ImpactLaw
from .motion import GRAVITY_M_S2, Flight, Impact, State, Throw
from .rotations import matrix_from_quat
from .solids import Die, Solid
from .touch import packed_state, unpacked_state

Array = NDArray[np.float64]

IMPACT_CAP = 100_000
"""More impacts than any throw below χ = 1 was seen to need; a throw that reaches them says so."""

_DEEPEST = 1e-9
"""Part of the circumradius by which a vertex may start below the table: rounding of a pose written with ten digits."""


class Ending(Enum):
    """Why a throw ended; the value says it in a sentence."""

    RESTED = "The die no longer has the energy to leave its lowest face."
    TIME_REACHED = "The time asked for was reached."
    IMPACTS_REACHED = "The number of impacts asked for was reached; the last flight leads to the next one."
    CHATTER = (
        "The bounces crowd together without end: a vertex stays on the table, and such held contact is not simulated."
    )
    IMPACT_CAP = f"The throw was stopped after {IMPACT_CAP} impacts; ask for a time or a number of impacts."


_ENDINGS = {
    kernels.RESTED: Ending.RESTED,
    kernels.TIME_REACHED: Ending.TIME_REACHED,
    kernels.IMPACTS_REACHED: Ending.IMPACTS_REACHED,
    kernels.CHATTER: Ending.CHATTER,
    kernels.IMPACT_CAP: Ending.IMPACT_CAP,
}


@dataclass(frozen=True)
class Until:
    """When to stop at the latest. With neither limit the throw runs until its face is decided."""

    time_s: float | None = None
    """[s] on the clock of the release."""
    impacts: int | None = None
    """Number of impacts."""

    def __post_init__(self) -> None:
        if self.time_s is not None and not np.isfinite(self.time_s):
            raise ValueError(f"time_s = {self.time_s}: wanted a finite time in seconds, or None for no limit")
        if self.impacts is not None and self.impacts < 0:
            raise ValueError(f"impacts = {self.impacts}: wanted 0 or more, or None for no limit")


@dataclass(frozen=True, eq=False)
class ThrowResult:
    """A simulated throw and how it ended."""

    throw: Throw
    """The last flight leads from the last impact to the next touch, or to the time asked for."""
    ending: Ending
    landed_face: int | None
    """Number of the face that the die can no longer leave; None while that is open."""

    @property
    def impact_count(self) -> int:
        """Impacts of the throw."""
        return len(self.throw.impacts)

    @property
    def end(self) -> State:
        """The state at the end of the last flight."""
        last = self.throw.flights[-1]
        return last.at(last.end_s)


def throw_die(die: Die, release: State, law: ImpactLaw, *, until: Until = Until()) -> ThrowResult:
    """Follow a die from its release, until its face is decided or a limit of `until` is reached.

    With a limit the throw goes on after its face is decided; `landed_face` then still names it. Corners are taken as
    sharp. Raises ValueError for a release that no die has: not finite, a quaternion not of length 1, below the table,
    or after the time at which the throw shall end.
    """
    start = checked_release(die, release)
    duration = np.inf if until.time_s is None else float(until.time_s - release.time_s)
    if duration < 0.0:
        raise ValueError(f"until time_s = {until.time_s}: wanted a time after the release at {release.time_s} s")
    solid = die.solid
    code, _, face, end, _, log = kernels.run_throw(
        solid.vertices,
        solid.normals,
        edge_barriers_m(solid),
        die.mass_kg,
        die.inertia_kg_m2,
        law.code,
        law.parameters,
        start,
        duration,
        np.iinfo(np.int64).max if until.impacts is None else until.impacts,
        until == Until(),
        IMPACT_CAP,
        True,
    )
    log[:, 0] += release.time_s
    throw = throw_from_log(die, unpacked_state(start, release.time_s), log, release.time_s + end)
    return ThrowResult(throw, _ENDINGS[code], int(face) + 1 if face >= 0 else None)


def checked_release(die: Die, release: State) -> Array:
    """The release as the kernels have it (13,). Raises ValueError where no die can be released so."""
    start = packed_state(release)
    lowest = lowest_vertex_m(die, unpacked_state(start, release.time_s))
    if lowest < -_DEEPEST * die.solid.circumradius:
        raise ValueError(
            f"position_m = {start[:3].tolist()}: the lowest vertex lies {-lowest:.3g} m below the table; raise the die"
        )
    return start


def lowest_vertex_m(die: Die, state: State) -> float:
    """Height [m] of the lowest vertex above the table."""
    return float((die.solid.vertices @ state.rotation[2]).min() + state.position_m[2])


def edge_barriers_m(solid: Solid) -> Array:
    """Height (faces,) [m] of the centre when the die stands on the nearest edge of each face: what it must climb."""
    a, b = solid.vertices[solid.edges[:, 0]], solid.vertices[solid.edges[:, 1]]
    along = b - a
    foot = np.clip(-np.sum(a * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
    distances = np.linalg.norm(a + foot[:, None] * along, axis=1)
    barriers = np.full(len(solid.faces), np.inf)
    np.minimum.at(barriers, solid.edge_faces, distances[:, None])
    return barriers


def throw_from_log(die: Die, start: State, log: Array, end_s: float) -> Throw:
    """The Throw of a start and its logged impacts (k, `kernels.ROW`), absolute times; the last flight ends at end_s."""
    starts = [start]
    for row in log:
        after = row[2:15].copy()
        after[7:] = row[15:21]
        starts.append(unpacked_state(after, row[0]))
    ends = [*(float(t) for t in log[:, 0]), float(end_s)]
    flights = tuple(Flight(state, end) for state, end in zip(starts, ends, strict=True))
    faces = [_lowest_half_way(die, flight) for flight in flights] if len(log) else []
    before, after = log[:, 2:15], np.hstack([log[:, 2:9], log[:, 15:21]])
    energies = zip(_energies_J(die, before), _energies_J(die, after), strict=True)
    rotations = matrix_from_quat(log[:, 5:9]) if len(log) else np.empty((0, 3, 3))
    impacts = []
    for k, (row, (energy_before, energy_after)) in enumerate(zip(log, energies, strict=True)):
        vertex = int(row[1])
        arm = rotations[k] @ die.solid.vertices[vertex]
        velocity_before = _normal_velocity(arm, before[k])
        velocity_after = _normal_velocity(arm, after[k])
        impacts.append(
            Impact(
                time_s=float(row[0]),
                contact="vertex",
                vertices=(vertex,),
                point_m=(row[2:5] + arm)[:2],
                impulse_N_s=die.mass_kg * (row[15:18] - row[9:12]),
                normal_velocity_before_m_s=velocity_before,
                normal_velocity_after_m_s=velocity_after,
                energy_before_J=float(energy_before),
                energy_after_J=float(energy_after),
                lowest_face_before=faces[k],
                lowest_face_after=faces[k + 1],
                chi=-velocity_after / velocity_before if velocity_before else float("nan"),
            )
        )
    return Throw(flights, tuple(impacts))


def _normal_velocity(arm: Array, state: Array) -> float:
    """Vertical velocity [m/s] of the point at `arm` (3,) of a packed state."""
    return float(state[9] + state[10] * arm[1] - state[11] * arm[0])


def _energies_J(die: Die, states: Array) -> Array:
    """Energies (k,) of packed states (k, 13), the table as zero height."""
    kinetic = die.mass_kg * (states[:, 7:10] ** 2).sum(1) + die.inertia_kg_m2 * (states[:, 10:13] ** 2).sum(1)
    return np.asarray(0.5 * kinetic + die.mass_kg * GRAVITY_M_S2 * states[:, 2])


def _lowest_half_way(die: Die, flight: Flight) -> int:
    """Number of the lowest face half-way through a flight."""
    packed = packed_state(flight.start)
    kernels.advance(packed, kernels.spin_of(packed), 0.5 * (flight.end_s - flight.start.time_s))
    return int(kernels.lowest_row(die.solid.normals, packed)) + 1
