"""Held contact: what a die does after its bounces have shrunk to nothing.

**Chatter.** A vertex that the die presses onto the table bounces lower and lower, each flight about χ times as long as
the one before: infinitely many impacts in a finite time. The collapse is recognised by its own mark: the fastest of the
touching vertices comes down slower than s √(g R) (R the circumradius; s = 1e-6 unless asked for otherwise) and
accelerates into the table, so that what is left out of the motion lasts about s √(R/g). A slow touch of a vertex that
swings up again by itself is a graze, no chatter; and at χ = 1 nothing shrinks, so that there only a touch without any
velocity counts.

**What is held.** Of the vertices on the table those that still come down slowly are stopped as an impact with χ = 0 of
all of them at once, and then those are held on which the die presses: forces N ≥ 0, accelerations a ≥ 0, N a = 0,

    a = A N + b,    A_ij = 1/m + (x_i x_j + y_i y_j)/J,    b_i = -g - z̈_table + (ω × (ω × r_i))_z.

One or two vertices have closed forms; for a face the forces are not unique but the accelerations are.

**How it moves.** Nothing rubs, so the horizontal velocity of the centre and ω_z stay as they are. A die on one vertex
is Lagrange's top on a smooth table (its inertia is the same about every axis, hence symmetric about the line from the
vertex to the centre); on an edge it is a rod that falls over while it turns about the vertical; on a face it lies. The
first two are integrated by the method of order 8 of Dormand and Prince (Hairer, Nørsett, Wanner, Solving Ordinary
Differential Equations I, 1993, II.5), with steps of a fixed turn, since the motion knows no other rates than ω and
√(g/R). After each step the state is put back on its contact, exactly.

**With friction** the vertices that touch stick or slide, each within its own Coulomb cone, and what a face or an edge
does is not unique but for its velocities. There the motion is followed by steps of half the old and half the new
velocities, the new ones from `kernels.friction_step` (Moreau; Jean 1999; Stewart & Trinkle, Int. J. Numer. Meth. Eng.
39, 2673, 1996): sticking is exact, the impulses create no energy, and the error falls with the step, of which
`Precision.step_turn_rad` sets the tenfold. (Keeping turned vertices at the table's height adds to the energy, some 1e-6 of it
in a throw.) A die that has lost what energy could turn it over has landed; one whose three corners hold stands still,
and on a table that moves it has landed if they would hold it at the table's lowest acceleration, too.

**How it ends.** A force falls through zero and its vertex is let go, or another vertex touches: an impact where it
comes down faster than s √(g R), otherwise one more vertex to hold. Both instants are found to rounding by steps of the
same method from the last state, so that they are as exact as the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import engine
from ..rotations import matrix_from_quat, quat_multiply
from .motion import Flight, State

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class HeldContact(Flight):
    """Motion in contact with the table, from the instant of `start` until `end_s`."""

    vertices: tuple[int, ...]
    """Indices of the vertices that stay on the table; of a face, all of it."""
    knots: Array
    """(k, 14) time [s] and state of the steps of the integration, in the table's axes; the first is the start."""
    body: engine.Body
    plane: engine.Plane
    rubs: bool
    """Whether it was followed with friction, by steps of low order."""
    world_from_table: Array
    """(4,) quaternion wxyz."""

    def at(self, time_s: float) -> State:
        """The state at any instant of the contact; outside it, at its nearer end."""
        return self._world(self._packed(time_s), time_s)

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        states = [self.at(float(t)) for t in np.asarray(times_s, float)]
        positions = np.array([s.position_m for s in states]).reshape(-1, 3)
        return positions, np.array([s.quaternion for s in states]).reshape(-1, 4)

    def _packed(self, time_s: float) -> Array:
        """The state (13,) in the table's axes."""
        knots = self.knots
        time = min(max(time_s, float(knots[0, 0])), self.end_s)
        k = max(int(np.searchsorted(knots[:, 0], time, side="right")) - 1, 0)
        state, dt = knots[k, 1:].copy(), time - knots[k, 0]
        if self.rubs:
            # Half of each step goes with the old velocities, half with the new ones.
            last = k + 1 == len(knots)
            if last or dt <= 0.5 * (knots[k + 1, 0] - knots[k, 0]):
                engine.move_freely(state, dt)
                return state
            state = knots[k + 1, 1:].copy()
            engine.move_freely(state, time - knots[k + 1, 0])
            return state
        if len(self.vertices) > 2:
            engine.carry_on_face(state, self.plane, knots[k, 0], dt)
            return state
        after = np.empty(13)
        i, j = (*self.vertices, -1)[:2]
        engine.held_step(self.body, self.plane, state, knots[k, 0], dt, i, j, engine.step_workspace(), after)
        return after

    def _world(self, packed: Array, time_s: float) -> State:
        lifted = packed[0:3] + np.array([0.0, 0.0, self.body.corner_radius])
        turn = matrix_from_quat(self.world_from_table)
        quaternion = quat_multiply(self.world_from_table, packed[3:7])
        return State(float(time_s), turn @ lifted, quaternion, turn @ packed[7:10], turn @ packed[10:13])
