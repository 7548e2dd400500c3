"""Throws of a die that is no spherical top: any inertia tensor, and a centre of mass anywhere inside.

A loaded die or a truncated dipyramid does not turn at a constant rate in flight, so its path stands apart from the one
of `kernels`, which spherical tops never leave. Here positions are those of the **centre of mass**, and body axes are
the principal axes of inertia; `asymmetric_body_of`, `centre_of_mass_state` and `centroid_state` change over at the door. The
friendly function is `throw_asymmetric_die`.

**Motion.** The angular momentum L about the centre changes only by the table. In flight it is constant, the centre
moves on a parabola, and what remains is the attitude: q' = q ω/2 with ω = I⁻¹ Rᵀ L in body axes. It is integrated with
the method of order 8 of Dormand and Prince (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, II.5;
the tableau is scipy's), in steps through which the die turns by at most `MAX_TURN_RAD`. An instant inside a step is reached by
a shorter step of the same method from the same beginning, so it is as accurate as the whole.

**Touch.** As in `touch`: with u the vertical in body axes, vertex r has the height h = z + u·r above the table s(t), and
|h''| <= M = g + |s''| + |r| (ω² + |ω'|). In flight ω² <= 2T/I₁, T the rotational energy and I₁ the least moment, and
|ω'| <= c ω²/√3 with c the largest |Iⱼ - Iₖ|/Iᵢ (each product of two components of ω is at most as large as in Euler's
equations, and Σ ωⱼ²ωₖ² <= ω⁴/3). Stepping by the root of the parabola h + h' s - M s²/2 passes no touch.

**Impact.** Smooth (the paper's, for any inertia): the vertical velocity v of the vertex relative to the table goes to
-χ v by the impulse S = -(1 + χ) v / (1/m + t·I⁻¹ t) with t = r × ẑ; then Δv_z = S/m and ΔL = S t.

**Held contact.** Bounces that have become slower than `Precision.slowest_bounce` √(g R) end on the table: the vertex is held.
One or two held vertices are pressed by vertical forces N with A N = -b, where Aᵢⱼ = 1/m + tᵢ·I⁻¹ tⱼ and b are the
vertical accelerations that the vertices would have without them. Of all vertices that stand on the table those are
held for which N >= 0 and the accelerations >= 0 are complementary, found by trying none, one and two of them; if no
such choice serves, the die lies on a face. A vertex is let go when its force would pull. Between, the same integration
runs with N in its right side, and places and velocities are put back on the constraint after each step. For the
bound of |h''|: forces that are complementary are the smallest change of acceleration (in the metric of mass, by Gauss'
principle) that presses no vertex into the table; lifting the die by b is another, so |Δz''| <= b, |Δω'| <= b √(m/I₁).

**Rest.** With no friction L_z is constant, and with u the vertical in body axes T >= L_z²/(2 u·I u). On a table at rest
the energy E = m g z + m v_z²/2 + T never grows. To leave a face (the one that the plumb line from the centre of mass
pierces) the die must pass an attitude where that line goes through one of its edges; the centre is then at least as high
as the edge is far from it, d, and u lies on the arc over that edge. So the face is decided once
E < m g d + L_z²/(2 max u·I u) for each of its edges. A die that lies on a face and is pressed there at rest is decided
too: nothing changes any more, however fast it spins.
"""

from .event_loop import asymmetric_states_at as asymmetric_states_at
from .event_loop import run_asymmetric_throw as run_asymmetric_throw
from .tangent import attitudes_in_flight as attitudes_in_flight
from .tangent import run_asymmetric_tangent as run_asymmetric_tangent
