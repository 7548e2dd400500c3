"""The next impact: the first instant at which a vertex meets the table, found so that none can be missed.

In flight the angular velocity ω is constant, so the height of vertex i above the table is

    h(t) = z + v t - g t²/2 + A cos ωt + B sin ωt + C

(less the height of a table that moves), where z, v are height and vertical velocity of the centre and A, B, C follow
from where the vertex stands. Its acceleration is bounded: h'' ≥ -M with M = g + ω² √(A² + B²) (and, of a table that
moves, its largest acceleration besides). Hence from an instant with h ≥ 0 the curve stays above the parabola
h + h' s - M s²/2, and no root lies before the parabola's own,

    s = (h' + √(h'² + 2 M h)) / M.

All vertices advance together by the smallest of these steps. Nothing can be stepped over, the instants rise
monotonically towards the root, close to it the step is h/|h'| (Newton's: quadratic convergence), and where a vertex
only grazes the table the step stays finite. While the centre is higher than the circumscribed sphere, the fall of that
sphere gives a longer step that is just as safe.

The end is set by rounding, not by a chosen tolerance. A height is a sum of a few terms, so it is known to 16 ε times
the sum of their sizes, |z| + |v| t + g t²/2 + R (1 + ωt), about 1e-15 m for a thrown die; velocity and acceleration
have limits of the same kind. A looser tolerance would cost landed faces: every impact multiplies it.
A vertex no higher than its limit counts as standing at h = 0 (also slightly below the table, where an impact may leave
it), and

- with h' > 0 it has just bounced and moves on by 2 h'/M;
- with h' < 0 it touches;
- with h' = 0 its acceleration decides: upwards it moves on by 3 h''/(ω³ √(A² + B²)), since that is the bound of
  the third derivative; with none but a third derivative j > 0, as where held contact has just let it go, by
  4 j/(ω⁴ √(A² + B²)); otherwise it touches, with velocity 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..die import Die
from ..laws import ImpactLaw
from .motion import State

Array = NDArray[np.float64]


LARGEST = {"position_m": 9e12, "velocity_m_s": 1e8, "omega_rad_s": 1e10}
"""What a state may hold: beyond, rounding of a height or of the turn in a flight is larger than a die."""


@dataclass(frozen=True, eq=False)
class Touch:
    """A vertex that meets the table at the end of a flight."""

    state: State
    """Of the die at that instant, before the impact."""
    vertex: int
    """Index of the vertex; of several the one that comes down fastest, the first of equals."""
    arm_m: Array
    """(3,) from the centre to the vertex, world axes."""
    normal_velocity_m_s: float
    """Of the vertex along +z: negative, or 0 where it is lost in rounding."""


def next_touch(die: Die, state: State, *, after_s: float = 0.0, until_s: float = np.inf) -> Touch | None:
    """The first touch of the flight that begins with `state`, or None if there is none by the time `until_s` [s].

    `after_s` [s] leaves out the first part of the flight. Corners are taken as sharp. A vertex below the table touches
    at once where it sinks and is waited for where it rises. Raises ValueError for a state that no die has.
    """
    packed = packed_state(state)
    spin = engine.spin_rate(packed)
    engine.advance(packed, spin, after_s, engine.LEVEL)
    begin = state.time_s + after_s
    if until_s < begin:
        return None
    terms = np.empty((len(die.solid.vertices), 4))
    engine.height_terms(die.solid.vertices, packed, spin, terms)
    dt, vertex, velocity, _ = engine.first_touch(
        terms,
        packed[2],
        packed[9],
        spin,
        die.solid.circumradius,
        engine.LEVEL,
        begin,
        0.0,
        until_s - begin,
    )
    if vertex < 0:
        return None
    engine.advance(packed, spin, dt, engine.LEVEL)
    arm = np.array(engine.lever_arm(die.solid.vertices[vertex], packed))
    return Touch(unpacked_state(packed, begin + dt), int(vertex), arm, float(velocity))


def impulse_N_s(die: Die, touch: Touch, law: ImpactLaw) -> Array:
    """Impulse (3,) [N s] of the table on the die, world axes."""
    state = touch.state
    packed = np.concatenate([state.position_m, state.quaternion, state.velocity_m_s, state.omega_rad_s])
    arm = (float(touch.arm_m[0]), float(touch.arm_m[1]), float(touch.arm_m[2]))
    return np.array(
        engine.impulse(engine.law_of(law.code, law.parameters), die.mass_kg, die.inertia_kg_m2, arm, 0.0, packed)
    )


def packed_state(state: State) -> Array:
    """The state as the kernels have it (13,): position, unit quaternion, velocity, angular velocity.

    Raises ValueError, naming the field, for a wrong shape, a number that is not finite, a quaternion not of length 1.
    """
    fields = (("position_m", 3), ("quaternion", 4), ("velocity_m_s", 3), ("omega_rad_s", 3))
    parts = []
    for name, size in (("time_s", 0), *fields):
        value = np.asarray(getattr(state, name), float)
        if value.shape != ((size,) if size else ()) or not np.isfinite(value).all():
            raise ValueError(f"{name} = {value.tolist()}: wanted {size or 1} finite numbers")
        if name in LARGEST and float(np.abs(value).max()) > LARGEST[name]:
            raise ValueError(
                f"{name} = {value.tolist()}: wanted no more than {LARGEST[name]:g}, where doubles still tell"
            )
        parts.append(value)
    length = float(np.linalg.norm(parts[2]))
    if abs(length - 1.0) > 1e-6:
        raise ValueError(f"quaternion of length {length:.9g}: wanted a unit quaternion wxyz; divide it by its length")
    parts[2] = parts[2] / length
    return np.concatenate(parts[1:])


def unpacked_state(packed: Array, time_s: float) -> State:
    """The State of an array (13,) at an instant."""
    return State(float(time_s), packed[0:3].copy(), packed[3:7].copy(), packed[7:10].copy(), packed[10:13].copy())
