"""Throws of a die with any inertia tensor, and a centre of mass anywhere inside: a loaded die, a truncated dipyramid.

Such a die does not turn at a constant rate in flight, so that its kernels stand apart from those of `engine` for one moment of
inertia. Positions are those of the **centre of mass**, body axes are the principal axes of inertia, and states have the angular
momentum L in place of ω. `throw.asymmetric_throw` converts states from and to those of the centroid.

**Motion.** Only the table changes L. In flight the centre moves on a parabola, and the attitude obeys q' = q ω/2 with
ω = I⁻¹ Rᵀ L in body axes. It is integrated by the method of order 8 of `runge_kutta`, in steps of at most MAX_TURN_RAD. An
instant inside a step is reached by a shorter step from the same beginning, so that it is as accurate as the whole.

**Touch.** As in `throw.touch`: with u the vertical in body axes, vertex r has the height h = z + u·r above the table s(t), and
|h''| ≤ M = g + |s''| + |r| (ω² + |ω'|). In flight ω² ≤ 2T/I₁, with the rotational energy T and the least moment I₁, and
|ω'| ≤ c ω²/√3 with c the largest |Iⱼ - Iₖ|/Iᵢ (each product of two components of ω is at most as large as in Euler's
equations, and Σ ωⱼ²ωₖ² ≤ ω⁴/3). Stepping by the root of the parabola h + h' s - M s²/2 passes no touch.

**Impact.** Smooth: the vertical velocity v of the vertex relative to the table becomes -χ v by the impulse
S = -(1 + χ) v/(1/m + t·I⁻¹ t) with t = r × ẑ; then Δv_z = S/m and ΔL = S t. With friction the impulse is that of
`friction_impulse` with the contact matrix of W = R I⁻¹ Rᵀ, one vertex after the other where several touch, and lasting contact is
that of `sliding_contact`, between whose impulses the die turns by Euler's equations.

**Held contact without friction.** Bounces slower than `Precision.slowest_bounce` √(g R) end on the table. The vertical forces N
on one or two held vertices obey A N = -b, where Aᵢⱼ = 1/m + tᵢ·I⁻¹ tⱼ, and b are the vertical accelerations of the vertices
without forces. Of all vertices on the table those are held for which N ≥ 0 and the accelerations ≥ 0 are complementary, found by
trying none, one and two of them. If no such choice exists, the die lies on a face. A vertex is released when its force would
pull. Between, the same integration runs with N in its right side, and each step ends with a projection on the contact. To bound
|h''|: complementary forces are the smallest change of acceleration (in the metric of mass, by Gauss' principle) that presses no
vertex into the table. Lifting the die by b is another such change, so that |Δz''| ≤ b and |Δω'| ≤ b √(m/I₁).

**Rest.** Without friction L_z is constant, and with u the vertical in body axes T ≥ L_z²/(2 u·I u). On a table at rest the energy
E = m g z + m v_z²/2 + T never grows. To leave the face that the plumb line from the centre of mass pierces, the die must pass
an attitude where that line goes through one of its edges. The centre is then at least as high as the edge is far from it, d, and
u lies on the arc over that edge. So the face is decided once E < m g d + L_z²/(2 max u·I u) for each of its edges. A die that
lies on a face and is pressed there at rest is decided too, however fast it spins. With friction L_z is not constant, and the face
is decided once all of the energy, that of the horizontal velocity too, is less than m g d.

**Spinning.** Where a vertex lies on an axis of symmetry of the inertia, as the tip of a dipyramid does, its forces have no moment
about that axis, and the angular momentum along it, L_a, is constant while no other vertex touches. With the moments I along the
axis and I' across it, and with u the cosine of its tilt, every state satisfies

    E ≥ m g |r| u + L_a²/(2I) + (L_z - L_a u)²/(2 I' (1 - u²)),

and the proof of `throw.simulate` holds as it stands. About other vertices nothing is known to be constant, and no spin is called
endless: a die that stays in contact for 1000 √(R/g) without an impact is given up.
"""

from .event_loop import asymmetric_states_at as asymmetric_states_at
from .event_loop import run_asymmetric_throw as run_asymmetric_throw
from .tangent import run_asymmetric_tangent as run_asymmetric_tangent
from .torque_free import EvenTurning as EvenTurning
from .torque_free import TorqueFree as TorqueFree
from .torque_free import TurnInFlight as TurnInFlight
from .torque_free import begin_turn as begin_turn
from .torque_free import carry_turn as carry_turn
from .torque_free import momentum_of_turn as momentum_of_turn
from .torque_free import omega_of_momentum as omega_of_momentum
from .torque_free import torque_free_turns as torque_free_turns
from .torque_free import turn_transition as turn_transition
from .torque_free import turned_omega as turned_omega
from .torque_free import turned_quaternion as turned_quaternion
