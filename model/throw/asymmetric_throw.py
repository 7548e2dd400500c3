"""Throws of dice with any inertia tensor, from release to end; `engine.asymmetric` has the method.

The kernels work in the table's axes and in the principal axes of the die, and follow its centre of mass. Here states of
the centroid, in the die's own body axes, go in and come out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..die import Die
from ..engine import FINE, LAW_CODES, LEVEL, NO_LIMIT, AsymmetricBody, Law, Limits, Plane, Precision, Setup
from ..engine.asymmetric import asymmetric_states_at, run_asymmetric_throw
from ..errors import InputError
from ..rotations import matrix_from_quat, quat_conjugate, quat_multiply
from .body import (
    asymmetric_body_of,
    centre_of_mass_state,
    centroid_state,
    check_above_table,
    packed_state,
    unpacked_state,
)
from .motion import State

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AsymmetricThrow:
    """A throw of an asymmetric die, in the table's axes; its states are computed when they are asked for."""

    die: Die
    plane: Plane
    code: int
    """How it ended: RESTED, TIME_REACHED, IMPACTS_REACHED, IMPACT_CAP, SPINNING, TIMED_OUT or BALANCED of `engine.types`."""
    impact_count: int
    landed_face: int | None
    """Number of the face that the die can no longer leave; None if it is not decided."""
    end_s: float
    log: Array
    """(events, engine.types.LOG_COLUMNS), states of the centre of mass, quaternions of the die's body axes."""
    knots: Array
    """(k, 15) steps of the integration: event that began the motion (-1: the release), time [s], state as in the log."""

    @property
    def impacts(self) -> Array:
        """The rows of the log in which a vertex strikes."""
        return self.log[self.log[:, 1] >= 0.0]

    def at(self, time_s: float) -> State:
        """The state of the centroid at an instant between release and end."""
        state = self.packed_states([time_s])[0]
        return centroid_state(self.die, unpacked_state(state, time_s))

    def packed_states(self, times_s: ArrayLike) -> Array:
        """States (n, 13) of the centre of mass at times (n,) [s], quaternions of the die's body axes."""
        body, body_from_principal, knots = self._principal
        states = asymmetric_states_at(body, self.plane, self.log[:, 21:23], knots, np.asarray(times_s, float))
        states[:, 2] += self.die.corner_radius_m
        states[:, 3:7] = quat_multiply(states[:, 3:7], quat_conjugate(body_from_principal))
        return states

    @cached_property
    def _principal(self) -> tuple[AsymmetricBody, Array, Array]:
        """The die's record, the quaternion from its principal to its body axes, and the knots in principal axes.

        Cached, because the flights of a throw ask for one state each: a thousand flights took 40 s without.
        """
        body, body_from_principal = asymmetric_body_of(self.die)
        knots = self.knots.copy()
        knots[:, 4] -= self.die.corner_radius_m
        knots[:, 5:9] = quat_multiply(knots[:, 5:9], body_from_principal)
        return body, body_from_principal, knots


def throw_asymmetric_die(
    die: Die,
    release: State,
    law: Law,
    *,
    plane: Plane = LEVEL,
    precision: Precision = FINE,
    duration_s: float = inf,
    impacts: int | None = None,
    stop_when_decided: bool = True,
    impact_cap: int = 100_000,
) -> AsymmetricThrow:
    """Follow any die, spherical top or not, from its release until its face is decided or a limit is reached.

    `release` has position and velocity of the centroid, in the table's axes. `duration_s` counts from the release. Raises
    ValueError as `packed_state` does, for a release below the table, and for a law that no code names.
    """
    if law.code not in LAW_CODES:
        raise InputError(f"law {law.code} by the kernels of asymmetric dice: wanted one of the codes {LAW_CODES}")
    plane = Plane(*(float(value) for value in plane))  # kernels are compiled for floats
    body, body_from_principal = asymmetric_body_of(die)
    start = packed_state(centre_of_mass_state(die, release))
    start[2] -= die.corner_radius_m
    start[3:7] = quat_multiply(start[3:7], body_from_principal)
    lowest = start[2] + float((body.vertices @ matrix_from_quat(start[3:7])[2]).min())
    check_above_table(release, lowest, body.radius, plane)
    limits = Limits(duration_s, NO_LIMIT if impacts is None else impacts, impact_cap, stop_when_decided)
    code, count, face, end, _, log, knots = run_asymmetric_throw(
        Setup(body, law, plane, precision), start, release.time_s, limits, True
    )
    for rows in (log, knots):
        rows[:, 4] += die.corner_radius_m
        rows[:, 5:9] = quat_multiply(rows[:, 5:9], quat_conjugate(body_from_principal))
    return AsymmetricThrow(die, plane, code, count, face + 1 if face >= 0 else None, end, log, knots)
