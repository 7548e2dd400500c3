"""Held contact: the motion of a die on the table, after its bounces have shrunk to nothing.

**Chatter.** A vertex that the die presses onto the table bounces lower and lower, each flight about χ times as long as
the one before: infinitely many impacts in a finite time. The sequence is replaced by held contact once the fastest of
the touching vertices comes down slower than s √(g R) and accelerates into the table, with R the circumradius and s =
1e-6 unless `Precision.slowest_bounce` says otherwise. What is left out of the motion lasts about s √(R/g). A slow touch
of a vertex that swings up again by itself is a graze, no chatter. At χ = 1 nothing shrinks, so only a touch without any
velocity counts.

**Which vertices are held.** Vertices on the table that still come down slowly are stopped by an impact with χ = 0 of
all of them at once. Then those are held on which the die presses, with forces N ≥ 0, accelerations a ≥ 0 and N a = 0:

    a = A N + b,    A_ij = 1/m + (x_i x_j + y_i y_j)/J,    b_i = -g - z̈_table + (ω × (ω × r_i))_z.

One or two vertices have closed forms. For a face the forces are not unique, but the accelerations are.

**Motion without friction.** The horizontal velocity of the centre and ω_z are constant. A die on one vertex is
Lagrange's top on a smooth table: its inertia is the same about every axis, and therefore symmetric about the line from
the vertex to the centre. On an edge it is a rod that falls over while it turns about the vertical, and on a face it
lies. The first two are integrated by the method of order 8 of Dormand and Prince (Hairer, Nørsett, Wanner, Solving
Ordinary Differential Equations I, 1993, II.5). Steps have a fixed turn, because the motion has no other rates than ω
and √(g/R). After each step the state is projected onto its contact, exactly.

**Motion with friction.** Each touching vertex sticks or slides within its own Coulomb cone. The forces on a face or an
edge are not unique, but the velocities are. One step moves half-way with the old velocities and half-way with the new
ones, which `engine.friction_step` computes (Moreau; Jean 1999; Stewart & Trinkle, Int. J. Numer. Meth. Eng. 39, 2673,
1996). Sticking is exact, the impulses create no energy, and the error is proportional to the step, a tenth of
`Precision.step_turn_rad`. Keeping turned vertices at the table's height adds to the energy, some 1e-6 of it in a throw.
A die that no longer has the energy to turn over has landed. A die whose three corners hold stands still; on an
oscillating table it has landed if they would also hold it at the table's lowest acceleration.

**Motion in air.** The drag -k |v| v acts on the centre of mass. Along the normal it adds k |v| v_z to the weight g + z̈_table
of the contact; along the table it slows the centre, whose position and velocity are then integrated with the attitude. On a
face of a level table at rest |v| = v₀/(1 + k v₀ t). With friction, drag acts in each step at the velocity of its begin, so
its error is of first order: 0.1 % of the way of a sliding cube at 1 per m.

**End.** Either a force falls through zero and its vertex is released, or another vertex touches. That is an impact if
it comes down faster than s √(g R), otherwise one more vertex to hold. Both instants are found to rounding by steps of
the same method from the last state, so they are as exact as the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..rotations import matrix_from_quat, quat_multiply
from .motion import SampledFlight, State

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class HeldContact(SampledFlight):
    """Motion in contact with the table, from the instant of `start` until `end_s`."""

    vertices: tuple[int, ...]
    """Indices of the vertices that stay on the table; for a face, all of its vertices."""
    knots: Array
    """(k, 14) time [s] and state after each step of the integration, in the table's axes; the first is the start."""
    body: engine.Body
    plane: engine.Plane | engine.PlaneInAir
    has_friction: bool
    """Whether the motion was integrated with friction, by steps of low order."""
    world_from_table: Array
    """(4,) quaternion wxyz."""

    def at(self, time_s: float) -> State:
        """The state at any instant of the contact; before and after it, that of its nearer end."""
        return self._world(self._packed(time_s), time_s)

    def _packed(self, time_s: float) -> Array:
        """The state (13,) in the table's axes."""
        knots = self.knots
        time = min(max(time_s, float(knots[0, 0])), self.end_s)
        k = max(int(np.searchsorted(knots[:, 0], time, side="right")) - 1, 0)
        state, dt = knots[k, 1:].copy(), time - knots[k, 0]
        if self.has_friction:
            # The first half of each step has the old velocities, the second half the new ones.
            last = k + 1 == len(knots)
            if last or dt <= 0.5 * (knots[k + 1, 0] - knots[k, 0]):
                engine.move_freely(state, dt)
                return state
            state = knots[k + 1, 1:].copy()
            engine.move_freely(state, time - knots[k + 1, 0])
            return state
        if len(self.vertices) > 2:
            engine.slide_on_face(state, self.plane, knots[k, 0], dt)
            return state
        after = np.empty(13)
        contact = engine.Contact(self.body, self.plane, *(*self.vertices, -1)[:2])
        engine.contact_step(contact, state, knots[k, 0], dt, engine.step_workspace(), after)
        return after

    def _world(self, packed: Array, time_s: float) -> State:
        """The state in world axes of a packed state (13,)."""
        lifted = packed[0:3] + np.array([0.0, 0.0, self.body.corner_radius])
        turn = matrix_from_quat(self.world_from_table)
        quaternion = quat_multiply(self.world_from_table, packed[3:7])
        return State(float(time_s), turn @ lifted, quaternion, turn @ packed[7:10], turn @ packed[10:13])
