"""The next impact: the first instant at which a vertex meets the table, found so that none can be missed.

In flight the angular velocity ω is constant, so the height of vertex i above the table is

    h(t) = z + v t - g t²/2 + A cos ωt + B sin ωt + C

(less the height of an oscillating table). Here z and v are height and vertical velocity of the centre, and A, B, C
follow from the position of the vertex. The acceleration is bounded, h'' ≥ -M with M = g + ω² √(A² + B²), to which an
oscillating table adds its largest acceleration. From an instant with h ≥ 0 the curve therefore stays above the parabola
h + h' s - M s²/2, and no root lies before the parabola's own,

    s = (h' + √(h'² + 2 M h)) / M.

All vertices advance together by the smallest of these steps. Nothing can be stepped over, and the instants increase
monotonically towards the root. Near it the step is h/|h'| (Newton's, with quadratic convergence), and for a vertex that
only grazes the table the step stays finite. While the centre is higher than the circumscribed sphere, the fall of that
sphere gives a longer step that is equally safe.

Rounding ends the search, not a chosen tolerance. A height is a sum of a few terms, so it is known to 16 ε times the sum
of their magnitudes, |z| + |v| t + g t²/2 + R (1 + ωt), about 1e-15 m for a thrown die. Velocity and acceleration have
limits of the same kind. A larger tolerance would change landed faces, because every impact multiplies the error. A
vertex no higher than its limit counts as standing at h = 0, also if an impact leaves it slightly below the table:

- With h' > 0 it has just bounced and advances by 2 h'/M.
- With h' < 0 it touches.
- With h' = 0 its acceleration decides. With h'' > 0 it advances by 3 h''/(ω³ √(A² + B²)), where the denominator bounds
  the third derivative. With h'' = 0 and a third derivative j > 0, as when held contact has just released it, it
  advances by 4 j/(ω⁴ √(A² + B²)). Otherwise it touches, with velocity 0.

**Several vertices at one instant.** A die that falls flat, or on an edge along its length, touches with several vertices
at instants that rounding does not distinguish: all within 1e-10 R of the table. Impacts in any order would turn the die
one way or the other, by the numbers of its vertices. Without friction they strike at once (Moreau, in Nonsmooth
Mechanics and Applications, CISM 302, 1988): with their normal velocities u before and u' after, and impulses S,

    S ≥ 0,   u' + χ u ≥ 0,   S (u' + χ u) = 0   at each of them.

With S = (1 + χ) P this is the impact with χ = 0 of all of them, 0 ≤ P ⊥ u + A P ≥ 0, whose velocities are unique: the
change of the motion is 1 + χ times that. It never adds energy, keeps it at χ = 1, and depends on no numbering. Where χ
fades with the speed, that of the fastest vertex counts. Vertices that rest on the table, or leave it, take no part; what
the impact drives into the table strikes next. With friction there is no such law, and the fastest vertex is struck
first, of equals the one with the lowest number; `ThrowResult.depends_on_numbering` says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..die import Die
from ..laws import ImpactLaw
from .body import packed_state, unpacked_state
from .motion import State

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Touch:
    """A vertex that meets the table at the end of a flight."""

    state: State
    """At that instant, before the impact."""
    vertex: int
    """Index of the vertex; of several the one that comes down fastest, of equals the first."""
    arm_m: Array
    """(3,) from the centre to the vertex, world axes."""
    normal_velocity_m_s: float
    """Of the vertex along +z: negative, or 0 if it is below rounding."""


def next_touch(die: Die, state: State, *, after_s: float = 0.0, until_s: float = np.inf) -> Touch | None:
    """The first touch on a level table of the flight that begins with `state`; None if there is none by `until_s` [s].

    `after_s` [s] skips the first part of the flight. Corners are taken as sharp. A vertex below the table touches at once
    if it sinks, and not before it has risen above the table otherwise. Raises ValueError as `packed_state` does.
    """
    packed = packed_state(state)
    spin = engine.spin_rate(packed)
    engine.advance(packed, spin, after_s, engine.LEVEL)
    begin = state.time_s + after_s
    if until_s < begin:
        return None
    terms = np.empty((len(die.solid.vertices), 4))
    engine.height_terms(die.solid.vertices, packed, spin, terms)
    falling = engine.FallingDie(packed[2], packed[9], spin, die.solid.circumradius)
    dt, vertex, velocity, _, _ = engine.first_touch(terms, falling, engine.LEVEL, begin, 0.0, until_s - begin)
    if vertex < 0:
        return None
    engine.advance(packed, spin, dt, engine.LEVEL)
    arm = np.array(engine.lever_arm(die.solid.vertices[vertex], packed))
    return Touch(unpacked_state(packed, begin + dt), int(vertex), arm, float(velocity))


def impulse_N_s(die: Die, touch: Touch, law: ImpactLaw) -> Array:
    """Impulse (3,) [N s] of the table on a spherical top, world axes."""
    state, arm = touch.state, touch.arm_m
    matrix = engine.spherical_contact_matrix(die.mass_kg, die.inertia_kg_m2, *arm.tolist())
    velocity = state.velocity_m_s + np.cross(state.omega_rad_s, arm)
    return np.array(engine.impulse(engine.law_of(law.code, law.parameters), matrix, tuple(velocity.tolist())))
