"""Compiled kernels of the event loop: touch, impact, flight, held contact, and derivatives, on plain numbers and arrays.

They stand in one file because they call each other (the cache of a kernel sees edits of its own file only). The
methods are explained where the friendly functions are: `touch` (the first root), `impacts` (the laws), `tables`,
`contact` (chatter and held contact), `simulate` (the loop and its ends), `tangent` (derivatives).

A state is an array (13,): position [m], quaternion wxyz, velocity [m/s], angular velocity [rad/s], all in the axes of
the table: z along its normal.
"""

from __future__ import annotations

from math import ceil, cos, hypot, inf, nan, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray
from scipy.integrate import DOP853

from .compiled import compiled, inner, int64, truth
from .motion import GRAVITY_M_S2

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Matrix6 = tuple[float, float, float, float, float, float]
"""A symmetric 3 × 3 matrix: xx, xy, xz, yy, yz, zz."""


class Body(NamedTuple):
    """A spherical top, as the kernels have it."""

    vertices: Array
    """(n, 3) [m] from the centre, body axes."""
    normals: Array
    """(faces, 3) outward."""
    feet: Array
    """(faces, 3) normals over the distances of their planes: the plumb line from the centre goes through the face for
    which this points down most; `bodies.plumb_normals`."""
    barriers: Array
    """(faces,) [m]: what the centre must climb to leave each face, `bodies.edge_barriers_m`."""
    mass: float
    inertia: float
    radius: float
    """[m] of the circumscribed sphere."""
    leans: Array
    """(n,) the cosine of how far the line from each vertex to the centre may lean from the vertical, before another
    vertex can be the lower one; `bodies.safe_leans`."""
    rounding: float
    """[m] radius of the corners; heights count from it."""


class SmoothLaw(NamedTuple):
    """An impact law without friction."""

    code: int
    parameters: Array
    """(k,), the restitution first."""


class RoughLaw(NamedTuple):
    """An impact law with friction: a type of its own, so that a throw without it does not even compile it."""

    code: int
    parameters: Array
    """(k,), the restitution first, then the coefficient of friction."""


Law = SmoothLaw | RoughLaw


class Plane(NamedTuple):
    """The table in its own axes: gravity is (gx, gy, -g), and its height A sin(rate t + phase)."""

    gx: float
    gy: float
    g: float
    amplitude: float
    rate: float
    phase: float


class Precision(NamedTuple):
    """Where speed is traded for accuracy."""

    root: float
    """[m] a vertex this near the table touches; 0 for what rounding allows."""
    switch: float
    """Slowest bounce that is still simulated, in units of √(g R); see `contact`."""
    turn: float
    """[rad] by which a die in held contact turns in one step of the integration."""
    sweep: float = 1e-12
    """Change of a contact velocity in a sweep over contacts with friction, as a part of the velocities at hand, after
    which no other sweep is made."""


SMOOTH, COULOMB, SMOOTH_BY_SPEED, COULOMB_BY_SPEED, COULOMB_FADING = 0, 1, 2, 3, 4
"""Codes of the laws. Parameters: (χ), (χ, μ, ending), (χ₀, speed scale, exponent), (χ₀, μ, ending, scale, exponent), and
of the last (χ₀, μ₀, ending, scale and exponent of χ, scale and exponent of μ)."""

NEWTON, POISSON, STRONGE = 0, 1, 2
"""What ends an impact with friction."""

RESTED, TIME_REACHED, IMPACTS_REACHED, CHATTER, IMPACT_CAP, NO_TOUCH, SPINNING, SPUN_LONG, BALANCED = range(9)
"""How the kernels end; `simulate.Ending` says the same in sentences. CHATTER and NO_TOUCH are of the tangent alone."""

FLIES = int64(-1)
"""How held contact ends that goes on in flight."""

ROW = 23
"""Columns of a logged event: time, vertex (-1: nothing strikes), position (3), quaternion (4), velocities before (6)
and after (6), and what is held from then on: (-1, -1) nothing, (i, -1) a vertex, (i, j) two, (i, -2) a face, and
(bits, -3) the vertices with those bits set, with friction."""

PATIENCE = 1000.0
"""A throw is given up as a top after this many √(R/g), where it is not proved to be one for ever; at χ above 0.9, where
every die takes long to calm down, 0.1/(1 - χ) times as late."""

_NEAR = 1e-10
"""Part of the circumradius within which a slow vertex counts as standing on the table: far above the height of the
slowest bounces that are simulated, and no more than 1e-10 of the energy."""

_ROUNDING = 16.0 * 2.220446049250313e-16
"""A height is a sum of some ten products, each off by half a unit in the last place of its largest term."""

_ORDER = 20
"""Of the Taylor series: e^-35 of accuracy costs e^(35/N) steps of N² operations each, least at N = 17."""

_TINY = 1e-16
"""Part of the velocities at hand below which a slip, or its turning, is rounding."""

_MOST_STEPS = 10_000
"""None of 3 · 10⁶ random impacts came to it; the answer then is NaN, rather than none."""

_STOPPED, _STRAIGHT, _TURNS = 0, 1, 2
"""Courses of a slip: none, or along the one direction in which it grows, as if it had just set out; straight to its stop;
neither."""

_VX, _VY, _SPEED, _NORMAL, _GIVEN = int64(0), int64(1), int64(2), int64(3), int64(4)
"""Rows of the series: slip, its size, the normal velocity w, and what restitution is measured by (∫dp or ∫w dp)."""

_NONE = int64(-1)
"""No vertex, no event."""

_FORCE_I, _FORCE_J, _NO_EVENT = int64(-1), int64(-2), int64(-3)
"""Events of held contact besides the touch of a vertex, which goes by its number: a vertex is let go."""

_ZERO, _ONE, _TWELVE, NO_LIMIT = int64(0), int64(1), int64(12), int64(9223372036854775807)
YES, NO = truth(True), truth(False)
"""Numbers that kernels hand on; see `compiled`."""

_MOST_SWEEPS = 1000
"""Of the Gauss-Seidel method in `friction_step`. Four corners of a die that slides need some 30, rocking ones 100."""

_FULL_SWEEPS, _LONG_SWEEPS = 100, 500
"""After so many sweeps without an end, each goes 0.7, then 0.4 of its way."""

_NEAR_RUBBED, _RUBBED_PART = 1e-6, 0.1
"""With friction, held contact is followed by a method of low order: part of the circumradius within which its vertices
count as standing on the table, and part of `Precision.turn` that it takes as a step."""

LEVEL = Plane(0.0, 0.0, GRAVITY_M_S2, 0.0, 0.0, 0.0)
"""A level table at rest."""

FINE = Precision(0.0, 1e-6, 0.3)
"""What is used unless something else is asked for; measured in `benchmarks/throws.py`."""

_A, _B, _C = np.ascontiguousarray(DOP853.A[:12, :12]), DOP853.B.copy(), DOP853.C[:12].copy()
"""Tableau of Dormand and Prince's method of order 8 (Hairer, Norsett, Wanner, Solving ODEs I, II.5), 12 stages."""


def law_of(code: int, parameters: Array) -> Law:
    """A law by its code and parameters; friction of nothing is none, where a law by speed has none either."""
    if code in (COULOMB, COULOMB_BY_SPEED, COULOMB_FADING) and parameters[1] > 0.0:
        return RoughLaw(code, parameters)
    if code == COULOMB:
        return SmoothLaw(SMOOTH, parameters[:1].copy())
    if code in (COULOMB_BY_SPEED, COULOMB_FADING):
        return SmoothLaw(SMOOTH_BY_SPEED, parameters[[0, 3, 4]])
    return SmoothLaw(code, parameters)


# --- the table ---------------------------------------------------------------------------------------------------


@compiled
def table_height(plane: Plane, time: float) -> float:
    """Height [m] of the table."""
    return 0.0 if plane.amplitude == 0.0 else plane.amplitude * sin(plane.rate * time + plane.phase)


@compiled
def table_velocity(plane: Plane, time: float) -> float:
    """Vertical velocity [m/s] of the table."""
    return 0.0 if plane.amplitude == 0.0 else plane.amplitude * plane.rate * cos(plane.rate * time + plane.phase)


@inner
def table_acceleration(plane: Plane, time: float) -> float:
    """Vertical acceleration [m/s²] of the table."""
    return -plane.rate * plane.rate * table_height(plane, time)


# --- flight and touch --------------------------------------------------------------------------------------------


@compiled
def spin_of(state: Array) -> float:
    """|ω| [rad/s]; scaled, so that 1e-200 is not lost in its square."""
    largest = max(abs(state[10]), abs(state[11]), abs(state[12]))
    if largest == 0.0:
        return 0.0
    x, y, z = state[10] / largest, state[11] / largest, state[12] / largest
    return float(largest * sqrt(x * x + y * y + z * z))


@inner
def axis_of(state: Array, spin: float) -> tuple[float, float, float]:
    """Unit axis of the spin; any axis serves where there is none."""
    if spin == 0.0:
        return 0.0, 0.0, 1.0
    return state[10] / spin, state[11] / spin, state[12] / spin


@compiled
def arm_of(vertex: Array, state: Array) -> tuple[float, float, float]:
    """The vertex (3,) of the body frame, seen from the centre, in world axes."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    bx, by, bz = vertex[0], vertex[1], vertex[2]
    # v + 2 w (q × v) + 2 q × (q × v)
    tx, ty, tz = 2.0 * (y * bz - z * by), 2.0 * (z * bx - x * bz), 2.0 * (x * by - y * bx)
    return bx + w * tx + y * tz - z * ty, by + w * ty + z * tx - x * tz, bz + w * tz + x * ty - y * tx


@compiled
def swing(vertices: Array, state: Array, spin: float, terms: Array) -> None:
    """Fill `terms` (n, 4) with A, B, C and √(A² + B²): a vertex stands A cos ωt + B sin ωt + C above the centre."""
    ux, uy, uz = axis_of(state, spin)
    for i in range(vertices.shape[0]):
        x, y, z = arm_of(vertices[i], state)
        along = (x * ux + y * uy + z * uz) * uz
        a, b = z - along, ux * y - uy * x
        terms[i, 0], terms[i, 1], terms[i, 2], terms[i, 3] = a, b, along, sqrt(a * a + b * b)


@compiled
def first_touch(
    terms: Array,
    height: float,
    velocity: float,
    spin: float,
    radius: float,
    plane: Plane,
    clock: float,
    tolerance: float,
    limit: float,
) -> tuple[float, int, float, float]:
    """The first instant at which a vertex of `terms` meets the table from above, no later than `limit` [s].

    `clock` [s] is the time of the start of the flight, for a table that moves. Returns the time [s] from the start of
    the flight, the row of the vertex (-1: the limit came first), and its vertical velocity (0 where it is only
    rounding) and acceleration there, relative to the table. Of vertices that touch together the fastest is returned,
    the first of equals. See `touch` for why no touch can be missed.
    """
    t = 0.0
    g = plane.g
    moving = plane.amplitude != 0.0
    shake = plane.amplitude * plane.rate * plane.rate  # the table's largest acceleration
    z_table, v_table, a_table, j_table = 0.0, 0.0, 0.0, 0.0
    v_table_tol, a_table_tol = 0.0, 0.0
    while True:
        c, s = cos(spin * t), sin(spin * t)
        centre, rise = height + (velocity - 0.5 * g * t) * t, velocity - g * t
        turned = 1.0 + spin * t  # the phase ωt is rounded as well
        h_tol = tolerance + _ROUNDING * (abs(height) + (abs(velocity) + g * t) * t + radius * turned)
        if moving:
            phase = plane.rate * (clock + t) + plane.phase
            z_table, v_table = plane.amplitude * sin(phase), plane.amplitude * plane.rate * cos(phase)
            a_table, j_table = -plane.rate * plane.rate * z_table, -plane.rate * plane.rate * v_table
            rounded = _ROUNDING * plane.amplitude * (1.0 + abs(phase))
            h_tol += rounded
            v_table_tol, a_table_tol = rounded * plane.rate, rounded * plane.rate * plane.rate
        v_tol = v_table_tol + _ROUNDING * (abs(velocity) + g * t + spin * radius * turned)
        a_tol = a_table_tol + _ROUNDING * (g + spin * spin * radius * turned)
        hit, hit_v, hit_a, step = -1, 0.0, 0.0, inf
        for i in range(terms.shape[0]):
            a, b, amplitude = terms[i, 0], terms[i, 1], terms[i, 3]
            h = centre + a * c + b * s + terms[i, 2] - z_table
            v = rise + spin * (b * c - a * s) - v_table
            bound = g + spin * spin * amplitude + shake
            if h > h_tol:
                root = sqrt(v * v + 2.0 * bound * h)
                # Two forms of one root: each free of cancellation for its sign of v.
                ahead = (v + root) / bound if v > 0.0 else 2.0 * h / (root - v)
                if moving and h + z_table > plane.amplitude:
                    # Nor before the highest that the table reaches; longer far up, where `shake` is large.
                    bound, v, h = bound - shake, v + v_table, h + z_table - plane.amplitude
                    root = sqrt(v * v + 2.0 * bound * h)
                    ahead = max(ahead, (v + root) / bound if v > 0.0 else 2.0 * h / (root - v))
            elif v > v_tol:
                ahead = 2.0 * v / bound
            else:
                acceleration = -g - spin * spin * (a * c + b * s) - a_table
                jerk = spin * spin * spin * (a * s - b * c) - j_table
                third = spin * spin * spin * amplitude + shake * plane.rate
                fourth = spin * spin * spin * spin * amplitude + shake * plane.rate * plane.rate
                if v >= -v_tol and acceleration >= -a_tol and jerk > _ROUNDING * third:
                    ahead = max(3.0 * max(acceleration, 0.0) / third, 4.0 * jerk / fourth)
                elif v < -v_tol or acceleration <= a_tol:
                    v = v if v < -v_tol else 0.0
                    if hit < 0 or v < hit_v:
                        hit, hit_v, hit_a = i, v, acceleration
                    continue
                else:
                    ahead = 3.0 * acceleration / third
            step = min(step, ahead)
        if hit >= 0:
            return t, hit, hit_v, hit_a
        free = centre - radius - plane.amplitude
        if free > 0.0:
            # No vertex reaches farther down than the circumscribed sphere: fall with it.
            step = max(step, (rise + sqrt(rise * rise + 2.0 * g * free)) / g)
        if t + step > limit:
            return limit, -1, 0.0, 0.0
        t += step


@inner
def touch_of_vertex(
    terms: Array, height: float, velocity: float, spin: float, radius: float, plane: Plane, clock: float
) -> tuple[float, bool, float, float]:
    """The next touch of the one vertex in `terms` (1, 4), whatever the others do: time, found, velocity, acceleration.

    A vertex that is already below the table and sinking touched a little before the flight began, and the time is
    negative: so the time stays a smooth function of the state when two touches change their order. It may lie as far
    back as the die takes to fall its own circumradius. A vertex that never rises above the table again has no touch.
    """
    below = -1e-12 * radius
    h = height + terms[0, 0] + terms[0, 2] - table_height(plane, clock)
    v = velocity + spin * terms[0, 1] - table_velocity(plane, clock)
    if h < below and v < 0.0:
        return _touch_before(terms, height, velocity, spin, radius, plane, clock)
    t, _, v, acceleration = first_touch(terms, height, velocity, spin, radius, plane, clock, 0.0, inf)
    return t, _height(terms, height, velocity, spin, plane, clock, t) >= below, v, acceleration


@inner
def _height(terms: Array, height: float, velocity: float, spin: float, plane: Plane, clock: float, t: float) -> float:
    """Height [m] of the one vertex of `terms` (1, 4) above the table."""
    swung = terms[0, 0] * cos(spin * t) + terms[0, 1] * sin(spin * t) + terms[0, 2]
    return float(height + (velocity - 0.5 * plane.g * t) * t + swung - table_height(plane, clock + t))


@inner
def _touch_before(
    terms: Array, height: float, velocity: float, spin: float, radius: float, plane: Plane, clock: float
) -> tuple[float, bool, float, float]:
    """Backwards from a vertex below the table to the instant at which it crossed; as `touch_of_vertex`."""
    t, g = 0.0, plane.g
    shake = plane.amplitude * plane.rate * plane.rate
    bound = max(spin * spin * terms[0, 3] + shake - g, 1e-3 * g)  # h'' is no larger; kept above 0 for the division
    while t > -sqrt(2.0 * radius / g):
        swung, swept = cos(spin * t), sin(spin * t)
        h = _height(terms, height, velocity, spin, plane, clock, t)
        v = velocity - g * t + spin * (terms[0, 1] * swung - terms[0, 0] * swept) - table_velocity(plane, clock + t)
        size = abs(height) + abs(velocity * t) + radius * (1.0 - spin * t)
        if plane.amplitude != 0.0:
            size += plane.amplitude * (1.0 + abs(plane.rate * (clock + t) + plane.phase))
        if h >= -_ROUNDING * size:
            acceleration = -g - spin * spin * (terms[0, 0] * swung + terms[0, 1] * swept)
            return t, True, v, acceleration - table_acceleration(plane, clock + t)
        root = sqrt(v * v - 2.0 * bound * h)
        t -= 2.0 * h / (v - root) if v < 0.0 else (v + root) / bound
    return t, False, 0.0, 0.0


@compiled
def advance(state: Array, spin: float, dt: float, plane: Plane) -> None:
    """Move the state along its exact flight, in place."""
    state[0] += (state[7] + 0.5 * plane.gx * dt) * dt
    state[1] += (state[8] + 0.5 * plane.gy * dt) * dt
    state[2] += (state[9] - 0.5 * plane.g * dt) * dt
    state[7] += plane.gx * dt
    state[8] += plane.gy * dt
    state[9] -= plane.g * dt
    ux, uy, uz = axis_of(state, spin)
    c, s = cos(0.5 * spin * dt), sin(0.5 * spin * dt)
    x, y, z = s * ux, s * uy, s * uz
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    w1 = c * qw - x * qx - y * qy - z * qz
    x1 = c * qx + x * qw + y * qz - z * qy
    y1 = c * qy - x * qz + y * qw + z * qx
    z1 = c * qz + x * qy - y * qx + z * qw
    norm = sqrt(w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1)
    state[3], state[4], state[5], state[6] = w1 / norm, x1 / norm, y1 / norm, z1 / norm


# --- impacts with friction (`impacts` has the equations) ---------------------------------------------------------


@compiled
def contact_matrix_of_top(mass: float, inertia: float, x: float, y: float, z: float) -> Matrix6:
    """Contact matrix M [1/kg] of a spherical top with the contact at (x, y, z) from its centre: xx, xy, xz, yy, yz, zz."""
    free = 1.0 / mass
    return (
        free + (y * y + z * z) / inertia,
        -x * y / inertia,
        -x * z / inertia,
        free + (x * x + z * z) / inertia,
        -y * z / inertia,
        free + (x * x + y * y) / inertia,
    )


@compiled
def contact_matrix(mass: float, inverse_inertia: Array, x: float, y: float, z: float) -> Matrix6:
    """The same for any body; `inverse_inertia` (3, 3) [1/(kg m²)] in world axes: M = 1/m - [r]× I⁻¹ [r]×."""
    i = inverse_inertia
    # The columns A, B, C of I⁻¹ [r]×, as far as [r]× in front of them asks for them.
    ay, az = i[1, 1] * z - i[1, 2] * y, i[1, 2] * z - i[2, 2] * y
    bx, by, bz = i[0, 2] * x - i[0, 0] * z, i[1, 2] * x - i[0, 1] * z, i[2, 2] * x - i[0, 2] * z
    cx, cy, cz = i[0, 0] * y - i[0, 1] * x, i[0, 1] * y - i[1, 1] * x, i[0, 2] * y - i[1, 2] * x
    free = 1.0 / mass
    return (
        free + z * ay - y * az,
        z * by - y * bz,
        z * cy - y * cz,
        free + x * bz - z * bx,
        x * cz - z * cx,
        free + y * cx - x * cy,
    )


@compiled
def faded_at_speed(slowest: float, speed: float, speed_scale: float, exponent: float) -> float:
    """χ or μ of an impact at `speed` ≥ 0 [m/s], from that of the slowest: χ₀ (1 + speed/scale)^-exponent."""
    return float(slowest * (1.0 + speed / speed_scale) ** -exponent)


@inner
def slide_direction(xx: float, xy: float, yy: float, radius: float, dx: float, dy: float) -> tuple[float, float, float]:
    """The unit vector ŝ, and σ ≥ 0, with (radius T + σ) ŝ = d; None needs one where |T⁻¹d| ≤ radius.

    Newton's method on 1/|ŝ(σ)|, which is concave and rises: from a σ too small it comes up to the root monotonically.
    """
    sigma = max(0.0, hypot(dx, dy) - radius * (xx + yy))  # no eigenvalue of T exceeds its trace
    ux, uy = 0.0, 0.0
    for _ in range(100):
        a, b, c = radius * xx + sigma, radius * xy, radius * yy + sigma
        det = a * c - b * b
        ux, uy = (c * dx - b * dy) / det, (a * dy - b * dx) / det
        size = hypot(ux, uy)
        if size - 1.0 <= 1e-15:
            break
        curved = (c * ux * ux - 2.0 * b * ux * uy + a * uy * uy) / det
        raised = sigma + size * size / curved * (size - 1.0)
        if raised <= sigma:
            break
        sigma = raised
    size = hypot(ux, uy)
    return ux / size, uy / size, sigma


@compiled
def friction_impulse(
    matrix: Matrix6, chi: float, mu: float, ending: int, cx: float, cy: float, cz: float
) -> tuple[float, float, float]:
    """Impulse [N s] of the table on the contact that comes in with velocity (cx, cy, cz) [m/s], z the normal.

    `matrix` from `contact_matrix`; `ending` NEWTON, POISSON or STRONGE. Zero for a contact that does not approach, NaN
    where c is not finite. One small array is allocated where the slip turns, none elsewhere.
    """
    xx, xy, xz, yy, yz, zz = matrix
    if not cz < 0.0:
        return 0.0, 0.0, 0.0
    if mu == 0.0:
        return 0.0, 0.0, -(1.0 + chi) * cz / zz
    size = abs(cx) + abs(cy) - cz
    if not size < inf:
        return nan, nan, nan
    # Nothing depends on the unit of velocity; in this one the work of the slowest impact does not underflow.
    vx, vy, w = cx / size, cy / size, cz / size
    goal = -chi * w if ending == NEWTON else 0.0
    sx, sy, p, returning, ended = 0.0, 0.0, 0.0, False, False
    course = _course(matrix, mu, vx, vy, abs(w))
    if course == _TURNS:
        sx, sy, p, vx, vy, w, returning, goal, ended, course = _turning_slip(matrix, chi, mu, ending, vx, vy, w, goal)
    if not ended and course == _STRAIGHT:
        slip = hypot(vx, vy)
        ux, uy = vx / slip, vy / slip
        f = ux * xz + uy * yz - mu * (xx * ux * ux + 2.0 * xy * ux * uy + yy * uy * uy)
        h = zz - mu * (xz * ux + yz * uy)
        dp, w, returning, goal, ended = _straight(w, h, -slip / f, ending, chi, returning, goal)
        sx, sy, p = sx - mu * ux * dp, sy - mu * uy * dp, p + dp
    if not ended:
        det = xx * yy - xy * xy
        tx, ty = (xy * yz - yy * xz) / det, (xy * xz - xx * yz) / det
        if hypot(tx, ty) > mu:
            ux, uy, _ = slide_direction(xx, xy, yy, mu, xz, yz)
            tx, ty = -mu * ux, -mu * uy
        dp, w, returning, goal, ended = _straight(w, zz + xz * tx + yz * ty, inf, ending, chi, returning, goal)
        sx, sy, p = sx + tx * dp, sy + ty * dp, p + dp
    return size * sx, size * sy, size * p


@inner
def _course(matrix: Matrix6, mu: float, vx: float, vy: float, size: float) -> int:
    """What the slip (vx, vy) does next, to rounding of velocities of the given `size`."""
    xx, xy, xz, yy, yz, _ = matrix
    slip = hypot(vx, vy)
    if slip <= _TINY * size:
        return _STOPPED
    ux, uy = vx / slip, vy / slip
    g = ux * yz - uy * xz - mu * ((yy - xx) * ux * uy + xy * (ux * ux - uy * uy))
    across = mu * (xx * uy * uy - 2.0 * xy * ux * uy + yy * ux * ux)
    # A direction off by g/across changes f by rate g/across, and so s for a given p by as much again.
    rate = _rate(matrix, mu)
    turns = abs(g) > 1e-3 * across or slip * abs(g) * rate > 30.0 * _TINY * across * across * size
    if turns and abs(g) > 30.0 * _TINY * rate:  # a smaller g is rounding itself
        return _TURNS
    f = ux * xz + uy * yz - mu * (xx * ux * ux + 2.0 * xy * ux * uy + yy * uy * uy)
    return _STRAIGHT if f < 0.0 else _STOPPED


@inner
def _rate(matrix: Matrix6, mu: float) -> float:
    """How fast the slip vector changes with τ [1/kg], at most (up to 2)."""
    return float(hypot(matrix[2], matrix[4]) + mu * max(matrix[0], matrix[3]))


@inner
def _straight(
    w: float, slope: float, limit: float, ending: int, chi: float, returning: bool, goal: float
) -> tuple[float, float, bool, float, bool]:
    """Go on while dw/dp = `slope` stays, at most by `limit`: the dp gone, then w, returning, goal, and whether it ended.

    `goal`: for NEWTON the w to reach; else what restitution may still give back, impulse (POISSON) or work (STRONGE).
    """
    gone = 0.0
    while True:
        zero = -w / slope if w * slope < 0.0 else inf
        if ending == NEWTON:
            ahead, final = (goal - w) / slope if slope > 0.0 else inf, True
        elif not returning:
            ahead, final = (0.0 if w == 0.0 and slope > 0.0 else zero), False
        else:
            release = goal
            if ending == STRONGE and goal > 0.0:
                square = w * w + 2.0 * slope * goal
                release = 2.0 * goal / (w + sqrt(square)) if square > 0.0 else inf
            ahead, final = min(release, zero), release <= zero
            if not final and w == 0.0 and slope < 0.0:
                ahead = 0.0
        stopped = ahead >= limit - gone
        step = limit - gone if stopped else ahead
        after = w + slope * step
        if not stopped and not final:
            after = 0.0
        if ending == POISSON:
            goal += -step if returning else chi * step
        elif ending == STRONGE:
            goal += (-1.0 if returning else -chi * chi) * step * 0.5 * (w + after)
        gone, w = gone + step, after
        if stopped or final:
            return gone, w, returning, goal, not stopped
        returning = not returning


@inner
def _turning_slip(
    matrix: Matrix6, chi: float, mu: float, ending: int, vx: float, vy: float, w: float, goal: float
) -> tuple[float, float, float, float, float, float, bool, float, bool, int]:
    """Slide until the slip stops, no longer turns, or the impact ends.

    Returns the impulse (3), the contact velocity (3), the state of `_straight`, and what `_course` says last.
    """
    sx, sy, p, returning = 0.0, 0.0, 0.0, NO
    largest, rate = max(matrix[0], matrix[3], matrix[5]), _rate(matrix, mu)
    series = np.empty((5, _ORDER + 1))
    ends = False
    for _ in range(_MOST_STEPS):
        size = p * largest + abs(w)
        course = _course(matrix, mu, vx, vy, size)
        if course != _TURNS:
            return sx, sy, p, vx, vy, w, returning, goal, False, course
        if not ends:
            found, dp = _way_to_stop(series, matrix, mu, vx, vy, size)
            if found:
                stops, tx, ty, w_stop, left = _stop_before_event(
                    series, matrix, mu, ending, chi, vx, vy, w, dp, returning, goal
                )
                if stops:
                    return sx + tx, sy + ty, p + dp, 0.0, 0.0, w_stop, returning, left, False, _STOPPED
                ends = returning or ending == NEWTON
        # Towards a stop the slip must keep its direction as well, or the steps would be longer than it lasts.
        allowed = min(3.0 * _TINY * size, 1e-5 * hypot(vx, vy))
        unit = largest / max(size, 1e-200) if ending == STRONGE else largest  # makes work, or impulse, a velocity
        h = _expand(series, matrix, mu, ending, rate, vx, vy, w, allowed, unit)
        t, returning, goal, ended = _walk(series, h, ending, chi, returning, goal)
        sx -= mu * _integral(series, _VX, t) / rate
        sy -= mu * _integral(series, _VY, t) / rate
        p += _integral(series, _SPEED, t) / rate
        vx, vy, w = _value(series, _VX, t), _value(series, _VY, t), _value(series, _NORMAL, t)
        if ended:
            return sx, sy, p, vx, vy, w, returning, goal, True, course
    return nan, nan, nan, nan, nan, nan, returning, goal, True, _TURNS


@inner
def _way_to_stop(series: Array, matrix: Matrix6, mu: float, vx: float, vy: float, size: float) -> tuple[bool, float]:
    """Whether the slip comes near enough to the direction in which it will stop, and the dp until then.

    With axes along and across that direction and the slope ε = v⊥/v∥ of the slip, v∥' = F(ε) v∥ and ε' = G(ε), so the
    dp left is v∥ P(ε) with F P + G P' = -|v|/v∥ = -√(1 + ε²): a power series, where steps in τ would come ever nearer.
    Leaves F, G, √, P in rows 0 to 3 of `series`, v∥ and ε in row 4.
    """
    xx, xy, xz, yy, yz, zz = matrix
    slip = hypot(vx, vy)
    ux, uy = vx / slip, vy / slip
    along, across, skew, f = 0.0, 0.0, 0.0, 0.0
    for step in range(8):
        along = mu * (xx * ux * ux + 2.0 * xy * ux * uy + yy * uy * uy)
        across = mu * (xx * uy * uy - 2.0 * xy * ux * uy + yy * ux * ux)
        skew = mu * ((yy - xx) * ux * uy + xy * (ux * ux - uy * uy))
        f = ux * xz + uy * yz - along
        turn = (ux * yz - uy * xz - skew) / (f + across)  # dg/dφ = -(f + across)
        # Attracting, a stop, and not far: more than a dozen degrees away the series would need too many terms.
        if f >= 0.0 or f + across <= 0.0 or abs(turn) > 0.25:
            return False, 0.0
        ux, uy = ux - turn * uy, uy + turn * ux
        length = hypot(ux, uy)
        ux, uy = ux / length, uy / length
        if abs(turn) < 1e-12:
            break
        if step == 7:
            return False, 0.0
    ahead = ux * vx + uy * vy
    slope = (ux * vy - uy * vx) / ahead
    pull = ux * yz - uy * xz
    F, G, root, P = series[0], series[1], series[2], series[3]
    total, power, term = 0.0, 1.0, 0.0
    for k in range(_ORDER + 1):
        root[k] = 0.0 if k % 2 == 1 else (1.0 if k == 0 else root[k - 2] * (3.0 - k) / k)
        F[k] = (f + along) * root[k] - (along if k == 0 else (skew if k == 1 else 0.0))
        G[k] = 0.0 if k == 0 else pull * root[k] - F[k - 1] - (across if k == 1 else 0.0)
        known = root[k]
        for j in range(1, k + 1):
            known += F[j] * P[k - j]
        for j in range(2, k + 1):
            known += G[j] * (k - j + 1) * P[k - j + 1]
        P[k] = -known / (F[0] + k * G[1])
        term = P[k] * power
        total += term
        power *= slope
    series[4, 0], series[4, 1] = ahead, slope
    return ahead * abs(term) * max(xx, yy, zz) <= 10.0 * _TINY * size, ahead * total


@inner
def _stop_before_event(
    series: Array,
    matrix: Matrix6,
    mu: float,
    ending: int,
    chi: float,
    vx: float,
    vy: float,
    w: float,
    dp: float,
    returning: bool,
    goal: float,
) -> tuple[bool, float, float, float, float]:
    """What `_way_to_stop` leads to: whether w meets no event on the way, the tangential impulse, w and goal then."""
    xx, xy, xz, yy, yz, zz = matrix
    det = xx * yy - xy * xy
    # 0 = v + b dp + T S at the stop.
    dx, dy = vx + xz * dp, vy + yz * dp
    tx, ty = (xy * dy - yy * dx) / det, (xy * dx - xx * dy) / det
    w_stop = w + zz * dp + xz * tx + yz * ty
    # h changes little and steadily; unless its sign does, w is between its ends.
    ahead, slope = series[4, 0], series[4, 1]
    slip = hypot(vx, vy)
    h = zz - mu * (xz * vx + yz * vy) / slip
    h_stop = zz - mu * (xz * (vx + slope * vy) + yz * (vy - slope * vx)) / (slip * sqrt(1.0 + slope * slope))
    if h * h_stop <= 0.0:
        return False, tx, ty, w_stop, goal
    if ending == NEWTON:
        return w_stop < goal, tx, ty, w_stop, goal
    if (w_stop <= 0.0) if returning else (w_stop >= 0.0):
        return False, tx, ty, w_stop, goal
    given = dp
    if ending == STRONGE:
        # w = w_stop - (a - b·e) (dp left) + e·v with e = T⁻¹ b; the last gives v∥² Q(ε), 2 F Q + G Q' = -(e·v/v∥) √.
        ex, ey = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det
        ux, uy = (
            (vx + slope * vy) / (ahead * (1.0 + slope * slope)),
            (vy - slope * vx) / (ahead * (1.0 + slope * slope)),
        )
        e_along, e_across = ex * ux + ey * uy, ey * ux - ex * uy
        F, G, root, Q = series[0], series[1], series[2], series[3]
        total, power = 0.0, 1.0
        for k in range(_ORDER + 1):
            known = e_along * root[k] + (e_across * root[k - 1] if k > 0 else 0.0)
            for j in range(1, k + 1):
                known += 2.0 * F[j] * Q[k - j]
            for j in range(2, k + 1):
                known += G[j] * (k - j + 1) * Q[k - j + 1]
            Q[k] = -known / (2.0 * F[0] + k * G[1])
            total += Q[k] * power
            power *= slope
        given = (w_stop - 0.5 * (zz - xz * ex - yz * ey) * dp) * dp + ahead * ahead * total
    if returning:
        return given < goal, tx, ty, w_stop, goal - given
    return True, tx, ty, w_stop, goal + (chi if ending == POISSON else -chi * chi) * given


@inner
def _expand(
    series: Array,
    matrix: Matrix6,
    mu: float,
    ending: int,
    rate: float,
    vx: float,
    vy: float,
    w: float,
    allowed: float,
    unit: float,
) -> float:
    """Fill the Taylor coefficients of v' = (|v| b - μTv)/rate and of what follows it; returns how far they hold.

    That is where the last terms of velocities reach `allowed` [m/s].
    """
    xx, xy, xz, yy, yz, zz = matrix
    a, b = series[_VX], series[_VY]
    n, normal, given = series[_SPEED], series[_NORMAL], series[_GIVEN]
    a[0], b[0], n[0], normal[0], given[0] = vx, vy, hypot(vx, vy), w, 0.0
    for k in range(_ORDER):
        if k > 0:
            # |v|² = vx² + vy², term by term, each pair of equal products once.
            pairs = 0.0
            for j in range(1, (k + 1) // 2):
                pairs += a[j] * a[k - j] + b[j] * b[k - j] - n[j] * n[k - j]
            if k % 2 == 0:
                i = k // 2
                pairs += 0.5 * (a[i] * a[i] + b[i] * b[i] - n[i] * n[i])
            n[k] = (pairs + vx * a[k] + vy * b[k]) / n[0]
        scale = 1.0 / (rate * (k + 1))
        a[k + 1] = scale * (n[k] * xz - mu * (xx * a[k] + xy * b[k]))
        b[k + 1] = scale * (n[k] * yz - mu * (xy * a[k] + yy * b[k]))
        normal[k + 1] = scale * (n[k] * zz - mu * (xz * a[k] + yz * b[k]))
        if ending == POISSON:
            given[k + 1] = scale * n[k]
        elif ending == NEWTON:
            given[k + 1] = 0.0
        else:
            work = 0.0
            for j in range(k + 1):
                work += normal[j] * n[k - j]
            given[k + 1] = scale * work
    n[_ORDER] = 0.0
    last = max(abs(a[_ORDER]), abs(b[_ORDER]), abs(normal[_ORDER]), unit * abs(given[_ORDER]))
    before = max(abs(a[_ORDER - 1]), abs(b[_ORDER - 1]), abs(normal[_ORDER - 1]), unit * abs(given[_ORDER - 1]))
    reach = 100.0  # of e-foldings: where both vanish by chance or underflow
    if last > 0.0:
        reach = min(reach, (allowed / last) ** (1.0 / _ORDER))
    if before > 0.0:
        reach = min(reach, (allowed / before) ** (1.0 / (_ORDER - 1)))
    return float(max(reach, 1e-30))  # where the ratio of a graze underflows


@inner
def _walk(
    series: Array, h: float, ending: int, chi: float, returning: bool, goal: float
) -> tuple[float, bool, float, bool]:
    """Follow the series up to h for the end of the impact: the t reached, and the state of `_straight`."""
    if ending == NEWTON:
        t = _first_rise(series, 1.0, goal, 0.0, h)
        return (t, True, goal, True) if t >= 0.0 else (h, returning, goal, False)
    t, given = 0.0, 0.0
    while True:
        crossing = _first_rise(series, -1.0 if returning else 1.0, 0.0, t, h)
        to = crossing if crossing >= 0.0 else h
        reached = _value(series, _GIVEN, to)
        if not returning:
            goal += (chi if ending == POISSON else -chi * chi) * (reached - given)
        elif reached - given >= goal:
            return _root(series, _GIVEN, 1.0, given + goal, t, to), returning, goal, True
        else:
            goal -= reached - given
        if crossing < 0.0:
            return h, returning, goal, False
        t, given, returning = to, reached, not returning
        if returning and goal <= 0.0:
            return t, returning, goal, True


@inner
def _first_rise(series: Array, sign: float, level: float, start: float, end: float) -> float:
    """The first t in (start, end] at which sign · w rises to sign · level, from below; -1 if it does not.

    w' = s h changes its sign at two angles of the slip at most, so not twice in a step that would matter.
    """
    top = end
    if sign * (_value(series, _NORMAL, end) - level) < 0.0:
        if sign * _slope(series, _NORMAL, start) <= 0.0 or sign * _slope(series, _NORMAL, end) >= 0.0:
            return -1.0
        low = start
        for _ in range(60):
            middle = 0.5 * (low + top)
            if sign * _slope(series, _NORMAL, middle) > 0.0:
                low = middle
            else:
                top = middle
        if sign * (_value(series, _NORMAL, top) - level) < 0.0:
            return -1.0
    return _root(series, _NORMAL, sign, level, start, top)


@inner
def _root(series: Array, row: int, sign: float, level: float, low: float, high: float) -> float:
    """Where a row takes the value `level`, which sign · row exceeds at `high`: Newton's steps, halved where they stray."""
    t = high
    for _ in range(80):
        excess = sign * (_value(series, row, t) - level)
        if excess > 0.0:
            high = t
        elif excess < 0.0:
            low = t
        else:
            return t
        slope = sign * _slope(series, row, t)
        new = t - excess / slope if slope > 0.0 else low
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - t) <= 2e-16 * t:
            return new
        t = new
    return t


@inner
def _value(series: Array, row: int, t: float) -> float:
    """A row at t."""
    total = series[row, _ORDER]
    for k in range(_ORDER - 1, -1, -1):
        total = total * t + series[row, k]
    return float(total)


@inner
def _slope(series: Array, row: int, t: float) -> float:
    """Derivative of a row at t."""
    total = _ORDER * series[row, _ORDER]
    for k in range(_ORDER - 1, 0, -1):
        total = total * t + k * series[row, k]
    return float(total)


@inner
def _integral(series: Array, row: int, t: float) -> float:
    """Integral of a row from 0 to t; its last term belongs to the next order and is left out."""
    total = 0.0
    for k in range(_ORDER - 1, -1, -1):
        total = total * t + series[row, k] / (k + 1)
    return float(total * t)


# --- impacts -----------------------------------------------------------------------------------------------------


@compiled
def smooth_impulse(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], v_table: float, state: Array
) -> tuple[float, float, float]:
    """`impulse` of a law without friction."""
    x, y, _ = arm
    u = state[9] + state[10] * y - state[11] * x - v_table
    chi = law.parameters[0]
    if law.code == SMOOTH_BY_SPEED:
        chi = faded_at_speed(chi, max(-u, 0.0), law.parameters[1], law.parameters[2])
    return 0.0, 0.0, -(1.0 + chi) * u / (1.0 / mass + (x * x + y * y) / inertia)


@compiled
def rough_impulse(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], v_table: float, state: Array
) -> tuple[float, float, float]:
    """`impulse` of a law with friction."""
    x, y, z = arm
    u = state[9] + state[10] * y - state[11] * x - v_table
    chi = law.parameters[0]
    mu = law.parameters[1]
    if law.code != COULOMB:
        chi = faded_at_speed(chi, max(-u, 0.0), law.parameters[3], law.parameters[4])
    if law.code == COULOMB_FADING:
        mu = faded_at_speed(mu, max(-u, 0.0), law.parameters[5], law.parameters[6])
    cx, cy = state[7] + state[11] * z - state[12] * y, state[8] + state[12] * x - state[10] * z
    matrix = contact_matrix_of_top(mass, inertia, x, y, z)
    return friction_impulse(matrix, chi, mu, int(law.parameters[2]), cx, cy, u)


def impulse(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], v_table: float, state: Array
) -> tuple[float, float, float]:
    """Impulse [N s] of the table on a touching point at `arm` from the centre of a spherical top."""
    if isinstance(law, RoughLaw):
        return rough_impulse(law, mass, inertia, arm, v_table, state)
    return smooth_impulse(law, mass, inertia, arm, v_table, state)


@overload(impulse, strict=False)
def _impulse_of(law: Any, mass: Any, inertia: Any, arm: Any, v_table: Any, state: Any) -> Any:
    """The branch of `impulse` that the type of the law asks for, chosen when it is compiled."""
    chosen = rough_impulse if law.instance_class is RoughLaw else smooth_impulse
    return chosen.py_func


@inner
def bounce(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], v_table: float, state: Array
) -> None:
    """Apply the law to the velocities of the state, in place: Δv = S/m, Δω = (r × S)/J."""
    sx, sy, sz = impulse(law, mass, inertia, arm, v_table, state)
    x, y, z = arm
    state[7] += sx / mass
    state[8] += sy / mass
    state[9] += sz / mass
    state[10] += (y * sz - z * sy) / inertia
    state[11] += (z * sx - x * sz) / inertia
    state[12] += (x * sy - y * sx) / inertia


@compiled
def lowest_row(normals: Array, state: Array) -> int:
    """Row of the face normal (faces, 3) that points down most."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    # Third row of the rotation matrix.
    a, b, c = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    best, lowest = 0, inf
    for k in range(normals.shape[0]):
        down = normals[k, 0] * a + normals[k, 1] * b + normals[k, 2] * c
        if down < lowest:
            best, lowest = k, down
    return best


@compiled
def decided_face(body: Body, law: Law, plane: Plane, state: Array) -> int:
    """Row of the face that the die can no longer leave, or -1; see `simulate`."""
    energy = energy_per_mass(body, plane, state)
    if rubs(law):
        if plane.gx != 0.0 or plane.gy != 0.0:
            return -1  # the slope goes on feeding the slip, so that only a die at rest has landed
        # Friction can turn the rest of the energy into what lifts the die.
        energy += 0.5 * (state[7] * state[7] + state[8] * state[8])
        energy += 0.5 * body.inertia / body.mass * state[12] * state[12]
    if energy >= plane.g * body.radius:
        return -1  # no edge is farther from the centre than a corner
    face = lowest_row(body.feet, state)
    return face if energy < plane.g * body.barriers[face] else -1


def rubs(law: Law) -> bool:
    """Whether the law has friction."""
    return isinstance(law, RoughLaw)


@overload(rubs, strict=False)
def _rubs(law: Any) -> Any:
    rough = law.instance_class is RoughLaw
    return lambda law: rough


@inner
def energy_per_mass(body: Body, plane: Plane, state: Array) -> float:
    """The energy per mass [m²/s²] that vertical forces can change: without ω_z and the horizontal velocity."""
    turning = body.inertia / body.mass * (state[10] * state[10] + state[11] * state[11])
    return plane.g * state[2] + 0.5 * (state[9] * state[9] + turning)


@inner
def copy_to(target: Array, source: Array) -> None:
    """Give every number of `target` (n,) the value that it has in `source` (n,)."""
    for k in range(target.shape[0]):
        target[k] = source[k]


@inner
def copy_columns(target: Array, source: Array, columns: int) -> None:
    """The same of the first `columns` of arrays with twelve rows."""
    for k in range(12):
        for c in range(columns):
            target[k, c] = source[k, c]


@inner
def state_after(row: Array, state: Array) -> None:
    """Fill `state` (13,) with that after a logged event (ROW,)."""
    for k in range(7):
        state[k] = row[2 + k]
    for k in range(6):
        state[7 + k] = row[15 + k]


@inner
def note_knot(row: Array, segment: int, time: float, state: Array) -> None:
    """Write a state in held contact into a row (15,)."""
    row[0], row[1] = segment, time
    for k in range(13):
        row[2 + k] = state[k]


@inner
def grown(rows: Array) -> Array:
    """The same rows with room for as many again."""
    larger = np.empty((2 * rows.shape[0], rows.shape[1]))
    for k in range(rows.shape[0]):
        for m in range(rows.shape[1]):
            larger[k, m] = rows[k, m]
    return larger


# --- held contact ------------------------------------------------------------------------------------------------


@compiled
def clearance(vertex: Array, state: Array, z_table: float) -> float:
    """Height [m] of a vertex above the table."""
    return float(state[2] + arm_of(vertex, state)[2] - z_table)


@inner
def spun(state: Array, arm: tuple[float, float, float]) -> float:
    """The vertical part [m/s²] of ω × (ω × r), which a vertex feels without any force."""
    along = state[10] * arm[0] + state[11] * arm[1] + state[12] * arm[2]
    square = state[10] * state[10] + state[11] * state[11] + state[12] * state[12]
    return state[12] * along - arm[2] * square


@inner
def contact_forces(body: Body, state: Array, i: int, j: int, weight: float) -> tuple[float, float, float, float]:
    """Normal forces of one vertex (j = -1) or two that stay on the table, and the ω̇_x and ω̇_y that they cause.

    Forces and `weight` (g and the table's acceleration) are per mass [m/s²]. A force below 0 would have to pull.
    """
    k = body.inertia / body.mass
    a = arm_of(body.vertices[i], state)
    free_i = weight - spun(state, a)
    a_ii = 1.0 + (a[0] * a[0] + a[1] * a[1]) / k
    if j < 0:
        n = free_i / a_ii
        return n, 0.0, n * a[1] / k, -n * a[0] / k
    b = arm_of(body.vertices[j], state)
    free_j = weight - spun(state, b)
    a_jj = 1.0 + (b[0] * b[0] + b[1] * b[1]) / k
    a_ij = 1.0 + (a[0] * b[0] + a[1] * b[1]) / k
    # Two vertices never stand above each other, so that the determinant is positive.
    inverse = 1.0 / (a_ii * a_jj - a_ij * a_ij)
    n_i, n_j = (a_jj * free_i - a_ij * free_j) * inverse, (a_ii * free_j - a_ij * free_i) * inverse
    return n_i, n_j, (n_i * a[1] + n_j * b[1]) / k, -(n_i * a[0] + n_j * b[0]) / k


@compiled
def held_step(
    body: Body, plane: Plane, state: Array, time: float, dt: float, i: int, j: int, rates: Array, after: Array
) -> None:
    """Carry a state in held contact over dt [s] into `after`; `rates` (12, 6) is room for the stages.

    Only the orientation, ω_x and ω_y are integrated: ω_z and the horizontal velocity of the centre are constant (less
    what a tilt does to it), and its height follows from the contact.
    """
    for s in range(12):
        for m in range(3, 7):
            after[m] = state[m]
        after[10], after[11], after[12] = state[10], state[11], state[12]
        for r in range(s):
            weight = dt * _A[s, r]
            if weight != 0.0:
                after[3] += weight * rates[r, 0]
                after[4] += weight * rates[r, 1]
                after[5] += weight * rates[r, 2]
                after[6] += weight * rates[r, 3]
                after[10] += weight * rates[r, 4]
                after[11] += weight * rates[r, 5]
        pull = plane.g + table_acceleration(plane, time + _C[s] * dt)
        _, _, rates[s, 4], rates[s, 5] = contact_forces(body, after, i, j, pull)
        x, y, z = 0.5 * after[10], 0.5 * after[11], 0.5 * after[12]
        qw, qx, qy, qz = after[3], after[4], after[5], after[6]
        rates[s, 0] = -x * qx - y * qy - z * qz
        rates[s, 1] = x * qw + y * qz - z * qy
        rates[s, 2] = -x * qz + y * qw + z * qx
        rates[s, 3] = x * qy - y * qx + z * qw
    for m in range(4):
        after[3 + m] = state[3 + m]
        for s in range(12):
            after[3 + m] += dt * _B[s] * rates[s, m]
    for m in range(2):
        after[10 + m] = state[10 + m]
        for s in range(12):
            after[10 + m] += dt * _B[s] * rates[s, 4 + m]
    after[0] = state[0] + (state[7] + 0.5 * plane.gx * dt) * dt
    after[1] = state[1] + (state[8] + 0.5 * plane.gy * dt) * dt
    after[7], after[8] = state[7] + plane.gx * dt, state[8] + plane.gy * dt
    stand_on(body, plane, after, time + dt, i, j)


@inner
def stand_on(body: Body, plane: Plane, state: Array, time: float, i: int, j: int) -> None:
    """Put the state exactly on its contact, in place: the quaternion a unit one, the held vertices on the table and at
    rest relative to it, an edge level. All of it only takes rounding away."""
    norm = sqrt(state[3] * state[3] + state[4] * state[4] + state[5] * state[5] + state[6] * state[6])
    for m in range(3, 7):
        state[m] /= norm
    a = arm_of(body.vertices[i], state)
    if j >= 0:
        b = arm_of(body.vertices[j], state)
        ex, ey = b[0] - a[0], b[1] - a[1]
        length = sqrt(ex * ex + ey * ey)
        ex, ey = ex / length, ey / length
        # A turn about the horizontal normal (-e_y, e_x) of the edge lifts its far end by -angle × length.
        angle = 0.5 * (b[2] - a[2]) / length
        qw, qx, qy, qz = state[3], state[4], state[5], state[6]
        x, y = -ey * angle, ex * angle
        state[3] = qw - x * qx - y * qy
        state[4] = qx + x * qw + y * qz
        state[5] = qy - x * qz + y * qw
        state[6] = qz + x * qy - y * qx
        along = state[10] * ex + state[11] * ey
        state[10], state[11] = along * ex, along * ey
        a = arm_of(body.vertices[i], state)
    state[2] = table_height(plane, time) - a[2]
    state[9] = table_velocity(plane, time) - state[10] * a[1] + state[11] * a[0]


@inner
def lie_on(body: Body, plane: Plane, state: Array, time: float, i: int) -> None:
    """Lay the die exactly on its lowest face, to which vertex i belongs, at rest but for its turning about the
    vertical, in place. It only takes away what is left of a tilt within which all corners count as touching."""
    face = lowest_row(body.normals, state)
    nx, ny, _ = arm_of(body.normals[face], state)
    # The turn that brings the normal to -z, about (-n_y, n_x): its tilt is below 1e-9, so half the sine is exact.
    x, y = -0.5 * ny, 0.5 * nx
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    state[3] = qw - x * qx - y * qy
    state[4] = qx + x * qw + y * qz
    state[5] = qy - x * qz + y * qw
    state[6] = qz + x * qy - y * qx
    norm = sqrt(state[3] * state[3] + state[4] * state[4] + state[5] * state[5] + state[6] * state[6])
    for m in range(3, 7):
        state[m] /= norm
    state[2] = table_height(plane, time) - arm_of(body.vertices[i], state)[2]
    state[9], state[10], state[11] = table_velocity(plane, time), 0.0, 0.0


@inner
def touching_set(
    body: Body, plane: Plane, state: Array, time: float, near: float, slow: float, also: int, touching: Indices
) -> int:
    """Fill `touching` with the vertices on the table that do not leave it faster than `slow`, and with `also`; returns
    their number."""
    z_table, v_table = table_height(plane, time), table_velocity(plane, time)
    n = 0
    for i in range(body.vertices.shape[0]):
        arm = arm_of(body.vertices[i], state)
        leaving = state[9] + state[10] * arm[1] - state[11] * arm[0] - v_table
        if i == also or (state[2] + arm[2] - z_table <= near and leaving <= slow):
            touching[n] = i
            n += 1
    return n


@inner
def push_out(
    body: Body, state: Array, touching: Indices, n: int, motion: Array, drive: Array, forces: Array, sweeps: int
) -> None:
    """Solve 0 ≤ forces ⊥ (drive + what the forces do) ≥ 0 over the touching vertices by projected Gauss-Seidel.

    `motion` (3,) is the centre's vertical motion and ω_x, ω_y (velocities or accelerations); it takes up the forces per
    mass (n,), which start from zero. `drive` (n,) is what each vertex has besides.
    """
    k = body.inertia / body.mass
    for m in range(n):
        forces[m] = 0.0
    for _ in range(sweeps):
        largest, change = 0.0, 0.0
        for m in range(n):
            x, y, _ = arm_of(body.vertices[touching[m]], state)
            rising = motion[0] + motion[1] * y - motion[2] * x + drive[m]
            new = max(0.0, forces[m] - rising / (1.0 + (x * x + y * y) / k))
            step = new - forces[m]
            forces[m] = new
            motion[0] += step
            motion[1] += step * y / k
            motion[2] -= step * x / k
            largest, change = max(largest, new), max(change, abs(step))
        if change <= 1e-15 * largest:
            break


@inner
def stop_approach(body: Body, plane: Plane, state: Array, time: float, touching: Indices, n: int, room: Array) -> None:
    """Stop what slow approach the touching vertices still have, in place, as an impact with χ = 0 of all at once."""
    motion, drive, forces = room[0], room[1], room[2]
    motion[0], motion[1], motion[2] = state[9] - table_velocity(plane, time), state[10], state[11]
    for m in range(n):
        drive[m] = 0.0
    push_out(body, state, touching, n, motion, drive, forces, 1000)
    state[9], state[10], state[11] = motion[0] + table_velocity(plane, time), motion[1], motion[2]


@inner
def stop_on(body: Body, plane: Plane, state: Array, time: float, i: int, j: int) -> None:
    """Take from the held vertices the last of their vertical velocity, in place, along the impulses that would do it:
    a projection in the metric of the kinetic energy, which therefore cannot rise."""
    k = body.inertia / body.mass
    v_table = table_velocity(plane, time)
    a = arm_of(body.vertices[i], state)
    u_i = state[9] + state[10] * a[1] - state[11] * a[0] - v_table
    a_ii = 1.0 + (a[0] * a[0] + a[1] * a[1]) / k
    if j < 0:
        p = -u_i / a_ii
        state[9] += p
        state[10] += p * a[1] / k
        state[11] -= p * a[0] / k
        return
    b = arm_of(body.vertices[j], state)
    u_j = state[9] + state[10] * b[1] - state[11] * b[0] - v_table
    a_jj = 1.0 + (b[0] * b[0] + b[1] * b[1]) / k
    a_ij = 1.0 + (a[0] * b[0] + a[1] * b[1]) / k
    inverse = 1.0 / (a_ii * a_jj - a_ij * a_ij)
    p, q = (a_ij * u_j - a_jj * u_i) * inverse, (a_ij * u_i - a_ii * u_j) * inverse
    state[9] += p + q
    state[10] += (p * a[1] + q * b[1]) / k
    state[11] -= (p * a[0] + q * b[0]) / k


@inner
def pressed_set(
    body: Body, plane: Plane, state: Array, time: float, touching: Indices, n: int, room: Array
) -> tuple[int, int]:
    """Which of the touching vertices at rest the die presses on: (-1, -1) none, (i, -1) one, (i, j) two, (i, -2) a face.

    One or two are decided by the signs of their forces, exactly; a face by projected Gauss-Seidel, which has no unique
    forces there but unique accelerations.
    """
    pull = plane.g + table_acceleration(plane, time)
    if n == 0:
        return -1, -1
    if n == 1:
        force, _, _, _ = contact_forces(body, state, touching[0], _NONE, pull)
        return (touching[0], -1) if force > 0.0 else (-1, -1)
    motion, drive, forces = room[0], room[1], room[2]
    if n >= 3:
        motion[0], motion[1], motion[2] = -pull, 0.0, 0.0
        for m in range(n):
            drive[m] = spun(state, arm_of(body.vertices[touching[m]], state))
        push_out(body, state, touching, n, motion, drive, forces, 1000)
        resting, first, second = 0, -1, -1
        for m in range(n):
            x, y, _ = arm_of(body.vertices[touching[m]], state)
            if abs(motion[0] + motion[1] * y - motion[2] * x + drive[m]) <= 1e-9 * plane.g:
                resting += 1
            if forces[m] > 0.0:
                if first < 0 or forces[m] > forces[first]:
                    first, second = m, first
                elif second < 0 or forces[m] > forces[second]:
                    second = m
        if first < 0:
            return -1, -1
        if resting >= 3:
            return touching[first], -2
        if second < 0 or forces[second] <= 1e-9 * forces[first]:
            return touching[first], -1
        return touching[first], touching[second]
    i, j = touching[0], touching[1]
    n_i, n_j, _, _ = contact_forces(body, state, i, j, pull)
    if n_i > 0.0 and n_j > 0.0:
        return i, j
    # One leaves: it is the one that rises when only the other is held.
    for p in range(2):
        held, other = touching[p], touching[1 - p]
        force, _, wx, wy = contact_forces(body, state, held, _NONE, pull)
        x, y, _ = arm_of(body.vertices[other], state)
        rises = force - pull + wx * y - wy * x + spun(state, arm_of(body.vertices[other], state))
        if force > 0.0 and rises >= 0.0:
            return held, -1
    return -1, -1


@inner
def crossing(
    body: Body,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    i: int,
    j: int,
    event: int,
    rates: Array,
    after: Array,
) -> float:
    """The instant [s] within dt at which an event function falls through zero, seen from `state`; see `event_value`.

    A force is followed to its first value not above zero, a height to its last that is. `after` is overwritten.
    """
    low, high = 0.0, dt
    f_low = event_value(body, plane, state, time, i, j, event)
    held_step(body, plane, state, time, dt, i, j, rates, after)
    f_high = event_value(body, plane, after, time + dt, i, j, event)
    if event >= 0 and f_low <= _NEAR * body.radius:
        # A vertex that has just been let go rises first: step back to where it is up.
        t = 0.5 * dt
        while t > 1e-12 * dt:
            held_step(body, plane, state, time, t, i, j, rates, after)
            f_low = event_value(body, plane, after, time + t, i, j, event)
            if f_low > 0.0:
                low = t
                break
            high, f_high = t, f_low
            t *= 0.5
        if low == 0.0:
            return 0.0
    elif f_low <= 0.0:
        return 0.0
    side = 0
    for _ in range(100):
        if high - low <= 4e-16 * (abs(time) + high):
            break
        # Illinois: regula falsi that halves the weight of an end that stays.
        t = (low * f_high - high * f_low) / (f_high - f_low)
        t = min(max(t, low + 0.001 * (high - low)), high - 0.001 * (high - low))
        held_step(body, plane, state, time, t, i, j, rates, after)
        f = event_value(body, plane, after, time + t, i, j, event)
        if f > 0.0:
            low, f_low = t, f
            if side == 1:
                f_high *= 0.5
            side = 1
            if event >= 0 and f <= _ROUNDING * body.radius:
                break
        else:
            high, f_high = t, f
            if side == -1:
                f_low *= 0.5
            side = -1
            if f >= -_ROUNDING * (plane.g if event < 0 else body.radius):
                low = t if event >= 0 else low
                break
    return low if event >= 0 else high


@inner
def event_value(body: Body, plane: Plane, state: Array, time: float, i: int, j: int, event: int) -> float:
    """The height [m] of vertex `event`, or for _FORCE_I and _FORCE_J the force per mass [m/s²] on vertex i or j."""
    if event >= 0:
        return clearance(body.vertices[event], state, table_height(plane, time))
    n_i, n_j, _, _ = contact_forces(body, state, i, j, plane.g + table_acceleration(plane, time))
    return n_i if event == _FORCE_I else n_j


@inner
def spins_for_ever(body: Body, plane: Plane, state: Array, i: int) -> bool:
    """Whether the die is a top on vertex i that can never touch the table with another one; see `simulate`."""
    x, y, z = arm_of(body.vertices[i], state)
    size = sqrt(x * x + y * y + z * z)
    upright, limit = -z / size, body.leans[i]
    about_z, about_axis = state[12], -(state[10] * x + state[11] * y + state[12] * z) / size
    per_mass = body.inertia / body.mass
    across = about_axis - about_z * limit
    needed = plane.g * size * limit + 0.5 * per_mass * across * across / (1.0 - limit * limit)
    # A die laid on an edge has both sides equal, and rounding must not prove it a top.
    return bool(upright > limit + 1e-12 and needed > energy_per_mass(body, plane, state) * (1.0 + 1e-12))


# --- held contact with friction ----------------------------------------------------------------------------------


@compiled
def held_impulse(matrix: Matrix6, mu: float, cx: float, cy: float, cz: float) -> tuple[float, float, float]:
    """The impulse S of an inelastic contact with Coulomb's cone, exactly, where c + M S is the velocity with it.

    Either it lifts off (S = 0), or it sticks (c + M S = 0), or it slides along ŝ with S = p (-μ ŝ, 1). To find p: a
    given p leaves the slip the least kinetic energy when (μ p T + σ) ŝ = c_t + b p, and w(p) = 0 is solved by secants
    that keep a bracket; w(0) < 0, and w rises for large p as an impact that sticks or slides on does.
    """
    xx, xy, xz, yy, yz, zz = matrix
    if cz >= 0.0:
        return 0.0, 0.0, 0.0
    det = xx * yy - xy * xy
    ex, ey = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det  # T⁻¹ b
    lx, ly = (yy * cx - xy * cy) / det, (xx * cy - xy * cx) / det  # T⁻¹ c_t
    p = (xz * lx + yz * ly - cz) / (zz - xz * ex - yz * ey)
    if p >= 0.0 and hypot(lx + ex * p, ly + ey * p) <= mu * p:
        return -lx - ex * p, -ly - ey * p, p
    low, w_low, high = 0.0, cz, -2.0 * cz / zz
    sx, sy, w_high = _held_slide(matrix, mu, cx, cy, cz, high)
    while w_high < 0.0:
        low, w_low, high = high, w_high, 2.0 * high
        sx, sy, w_high = _held_slide(matrix, mu, cx, cy, cz, high)
    for _ in range(100):
        p = (low * w_high - high * w_low) / (w_high - w_low)
        if not low < p < high:
            break
        sx, sy, w = _held_slide(matrix, mu, cx, cy, cz, p)
        if abs(w) <= -1e-16 * cz:
            return sx, sy, p
        # Illinois: an end that stays twice counts half, so that neither does.
        if w < 0.0:
            low, w_low, w_high = p, w, 0.5 * w_high
        else:
            high, w_high, w_low = p, w, 0.5 * w_low
    sx, sy, _ = _held_slide(matrix, mu, cx, cy, cz, high)
    return sx, sy, high


@inner
def _held_slide(matrix: Matrix6, mu: float, cx: float, cy: float, cz: float, p: float) -> tuple[float, float, float]:
    """Tangential impulse within the disk μp that leaves the slip the least energy, and the normal velocity then."""
    xx, xy, xz, yy, yz, zz = matrix
    dx, dy, radius = cx + xz * p, cy + yz * p, mu * p
    det = xx * yy - xy * xy
    sx, sy = (xy * dy - yy * dx) / det, (xy * dx - xx * dy) / det
    if hypot(sx, sy) > radius:
        ux, uy, _ = slide_direction(xx, xy, yy, radius, dx, dy)
        sx, sy = -radius * ux, -radius * uy
    return sx, sy, cz + zz * p + xz * sx + yz * sy


@compiled
def friction_step(
    velocity: Array,
    arms: Array,
    mass: float,
    inertia: float,
    mu: float,
    push: Array,
    table_velocity: float,
    impulses: Array,
    sweep: float = 1e-12,
) -> int:
    """One time step of held contact of a spherical top: `velocity` (6,) [m/s, rad/s], centre and spin, in place.

    Gravity acts first, as the change of velocity `push` (3,) [m/s], h g. Then the touching vertices at `arms` (n, 3)
    [m] from the centre get the impulses with which each obeys `held_impulse` in the presence of the others: velocities
    at the end of the step, so that energy is lost, never gained, and a corner that sticks has no velocity instead of a
    small one. `impulses` (n, 3) [N s]: a guess, zero or those of the step before; the result afterwards.
    `table_velocity` [m/s] is the table's own, along z. No velocity of a vertex at the end is below it by more than
    rounding. Vertices are solved in turn (Gauss-Seidel); returns the number of sweeps, `_MOST_SWEEPS` where they
    were cut off before no contact velocity changed by more than `sweep`, a part of push and velocities.
    """
    n = arms.shape[0]
    for k in range(3):
        velocity[k] += push[k]
    size = abs(table_velocity) + hypot(hypot(push[0], push[1]), push[2])
    for i in range(n):
        cx, cy, cz = _velocity_at(velocity, arms[i])
        size = max(size, abs(cx) + abs(cy) + abs(cz))
    for i in range(n):
        _kick(velocity, arms[i], mass, inertia, impulses[i, 0], impulses[i, 1], impulses[i, 2])
    sweeps, changed = 0, inf
    while changed > sweep * size and sweeps < _MOST_SWEEPS:
        changed = 0.0
        # Corners that answer each other in a circle stop doing so when each goes only part of its way.
        part = 1.0 if sweeps < _FULL_SWEEPS else (0.7 if sweeps < _LONG_SWEEPS else 0.4)
        for i in range(n):
            matrix = contact_matrix_of_top(mass, inertia, arms[i, 0], arms[i, 1], arms[i, 2])
            xx, xy, xz, yy, yz, zz = matrix
            x, y, z = impulses[i]
            cx, cy, cz = _velocity_at(velocity, arms[i])
            cx, cy = cx - xx * x - xy * y - xz * z, cy - xy * x - yy * y - yz * z
            cz = cz - table_velocity - xz * x - yz * y - zz * z
            sx, sy, sz = held_impulse(matrix, mu, cx, cy, cz)
            sx, sy, sz = x + part * (sx - x), y + part * (sy - y), z + part * (sz - z)
            impulses[i, 0], impulses[i, 1], impulses[i, 2] = sx, sy, sz
            _kick(velocity, arms[i], mass, inertia, sx - x, sy - y, sz - z)
            changed = max(changed, max(xx, yy, zz) * max(abs(sx - x), abs(sy - y), abs(sz - z)))
        sweeps += 1
    if _holds_fast(velocity, arms, table_velocity, impulses, 1e-9 * size):
        for k in range(6):
            velocity[k] = 0.0
        velocity[2] = table_velocity
    return sweeps


@inner
def _velocity_at(velocity: Array, arm: Array) -> tuple[float, float, float]:
    """v + ω × r."""
    return (
        velocity[0] + velocity[4] * arm[2] - velocity[5] * arm[1],
        velocity[1] + velocity[5] * arm[0] - velocity[3] * arm[2],
        velocity[2] + velocity[3] * arm[1] - velocity[4] * arm[0],
    )


@inner
def _kick(velocity: Array, arm: Array, mass: float, inertia: float, sx: float, sy: float, sz: float) -> None:
    """Δv = S/m, Δω = r × S/J, in place."""
    velocity[0] += sx / mass
    velocity[1] += sy / mass
    velocity[2] += sz / mass
    velocity[3] += (arm[1] * sz - arm[2] * sy) / inertia
    velocity[4] += (arm[2] * sx - arm[0] * sz) / inertia
    velocity[5] += (arm[0] * sy - arm[1] * sx) / inertia


@inner
def _holds_fast(velocity: Array, arms: Array, table_velocity: float, impulses: Array, slow: float) -> bool:
    """Whether three corners that press and do not lie in a line have stopped: then the die has the table's velocity."""
    first, second = -1, -1
    for i in range(arms.shape[0]):
        cx, cy, cz = _velocity_at(velocity, arms[i])
        if impulses[i, 2] <= 0.0 or max(abs(cx), abs(cy), abs(cz - table_velocity)) > slow:
            continue
        if first < 0:
            first = i
        elif second < 0:
            second = i
        else:
            ax, ay = arms[second, 0] - arms[first, 0], arms[second, 1] - arms[first, 1]
            bx, by = arms[i, 0] - arms[first, 0], arms[i, 1] - arms[first, 1]
            if abs(ax * by - ay * bx) > 1e-6 * hypot(ax, ay) * hypot(bx, by):
                return True
    return False


@compiled
def turn_and_move(state: Array, dt: float) -> None:
    """Carry the pose along its velocities over dt [s], in place, as if nothing acted."""
    height_velocity = state[9]
    advance(state, spin_of(state), dt, Plane(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    state[9] = height_velocity


@inner
def rub_step(
    body: Body,
    mu: float,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    active: NDArray[np.bool_],
    arms: Array,
    guess: Array,
    impulses: Array,
    after: Array,
    sweep: float = 1e-12,
) -> int:
    """Carry a state over dt [s] of contact with friction into `after`; returns how many of the active vertices press.

    Half the way with the old velocities, the impulses there, the other half with the new ones (Moreau; see `contact`).
    `arms` (n, 3) and `impulses` (n, 3) are room for the active ones, `guess` (n, 3) [N] forces to begin with.
    """
    copy_to(after, state)
    turn_and_move(after, 0.5 * dt)
    n = 0
    for k in range(active.shape[0]):
        if active[k]:
            x, y, z = arm_of(body.vertices[k], after)
            arms[n, 0], arms[n, 1], arms[n, 2] = x, y, z - body.rounding
            n += 1
    velocity, push = np.empty(6), np.empty(3)
    for k in range(6):
        velocity[k] = after[7 + k]
    push[0], push[1], push[2] = plane.gx * dt, plane.gy * dt, -plane.g * dt
    for k in range(n):
        for m in range(3):
            impulses[k, m] = guess[k, m] * dt
    v_table = table_velocity(plane, time + dt)
    friction_step(velocity, arms[:n], body.mass, body.inertia, mu, push, v_table, impulses[:n], sweep)
    for k in range(6):
        after[7 + k] = velocity[k]
    turn_and_move(after, 0.5 * dt)
    pressing = 0
    lowest, z_table = inf, table_height(plane, time + dt)
    for k in range(n):
        pressing += impulses[k, 2] > 0.0
    for k in range(active.shape[0]):
        if active[k]:
            lowest = min(lowest, clearance(body.vertices[k], after, z_table))
    if pressing > 0:
        # The arms turn within the step, by which the vertices leave the table to the third order in dt.
        after[2] -= lowest
    return pressing


@inner
def rides_for_ever(
    body: Body,
    mu: float,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    active: NDArray[np.bool_],
    sweep: float,
) -> bool:
    """Whether a die that moves as its table does will always do so. It is pressed least where the table accelerates down
    most; if it neither slips nor tips there within a step of dt [s], it does so nowhere."""
    if state[9] != table_velocity(plane, time) or state[7:9].any() or state[10:13].any():
        return False
    least = plane.g - plane.amplitude * plane.rate * plane.rate
    if least <= 0.0:
        return False
    still, after, room = state.copy(), np.empty(13), np.zeros((3, body.vertices.shape[0], 3))
    still[9] = 0.0
    at_rest = Plane(plane.gx, plane.gy, least, 0.0, 0.0, 0.0)
    pressing = rub_step(body, mu, at_rest, still, time, dt, active, room[0], room[1], room[2], after, sweep)
    return pressing >= 3 and not after[7:13].any()


@inner
def rough_rub(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    state: Array,
    time: float,
    limit: float,
    active: NDArray[np.bool_],
    for_ever: bool,
    stop_when_decided: bool,
    segment: int,
    knots: Array,
    known: int,
    keep: bool,
    after: Array,
) -> tuple[int, float, int, Array, int]:
    """`rub` with friction."""
    begin, mu = time, law.parameters[1]
    room = np.zeros((3, body.vertices.shape[0], 3))
    fixed = plane.amplitude == 0.0
    shake = plane.amplitude * plane.rate * plane.rate
    while True:
        if keep:
            if known == knots.shape[0]:
                knots = grown(knots)
            note_knot(knots[known], segment, time, state)
            known += 1
        if stop_when_decided and fixed and decided_face(body, law, plane, state) >= 0:
            return RESTED, time - begin, -1, knots, known
        rate = spin_of(state) + sqrt((plane.g + shake) / body.radius) + (0.0 if fixed else plane.rate)
        dt = min(_RUBBED_PART * precision.turn / rate, begin + limit - time)
        pressing = rub_step(body, mu, plane, state, time, dt, active, room[0], room[2], room[1], after, precision.sweep)
        if fixed and pressing > 0 and not after[7:13].any() and not state[7:13].any():
            # Nothing moves, and nothing will.
            if for_ever:
                return (RESTED if pressing >= 3 else BALANCED), time - begin, -1, knots, known
            return TIME_REACHED, limit, -1, knots, known
        if (
            for_ever
            and not fixed
            and pressing >= 3
            and rides_for_ever(body, mu, plane, after, time + dt, dt, active, precision.sweep)
        ):
            copy_to(state, after)
            return RESTED, time + dt - begin, -1, knots, known
        hit = lowest_free(body, plane, after, time + dt, active)
        if hit >= 0:
            # False position (Illinois: an end that stays twice weighs half) takes five steps where halving takes forty,
            # and leaves to halving what it does not know: a vertex that is another's successor, or on its way up.
            low, high, stayed = 0.0, dt, 0
            room[2] = room[1] / dt
            h_low = clearance(body.vertices[hit], state, table_height(plane, time))
            h_high = clearance(body.vertices[hit], after, table_height(plane, time + dt))
            for k in range(90):
                if high - low <= 1e-12 * dt or h_high >= -_ROUNDING * body.radius:
                    break
                middle = 0.5 * (low + high)
                if h_low > 0.0 and k % 3 < 2:
                    weigh_low, weigh_high = 0.5 if stayed > 1 else 1.0, 0.5 if stayed < -1 else 1.0
                    middle = low + (high - low) * weigh_low * h_low / (weigh_low * h_low - weigh_high * h_high)
                rub_step(
                    body, mu, plane, state, time, middle, active, room[0], room[2], room[1], after, precision.sweep
                )
                room[2] = room[1] / middle
                found = lowest_free(body, plane, after, time + middle, active)
                if found >= 0:
                    h_low = h_low if found == hit else nan
                    h_high = clearance(body.vertices[found], after, table_height(plane, time + middle))
                    high, hit, stayed = middle, found, max(stayed, 0) + 1
                else:
                    h_low = clearance(body.vertices[hit], after, table_height(plane, time + middle))
                    low, stayed = middle, min(stayed, 0) - 1
            rub_step(body, mu, plane, state, time, high, active, room[0], room[2], room[1], after, precision.sweep)
            copy_to(state, after)
            return FLIES, time + high - begin, hit, knots, known
        copy_to(state, after)
        time += dt
        # First of all: within no time nothing presses, and a die at rest would fly and touch there without end.
        if time >= begin + limit:
            return TIME_REACHED, limit, -1, knots, known
        if pressing == 0:
            return FLIES, time - begin, -1, knots, known
        room[2] = room[1] / dt
        n, z_table = 0, table_height(plane, time)
        for k in range(active.shape[0]):
            if active[k]:
                if room[1, n, 2] <= 0.0 and clearance(body.vertices[k], state, z_table) > _NEAR_RUBBED * body.radius:
                    active[k] = False
                    room[2] = 0.0
                n += 1


def rub(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    state: Array,
    time: float,
    limit: float,
    active: NDArray[np.bool_],
    for_ever: bool,
    stop_when_decided: bool,
    segment: int,
    knots: Array,
    known: int,
    keep: bool,
    after: Array,
) -> tuple[int, float, int, Array, int]:
    """Carry the state in place through contact with friction of the `active` vertices, as `hold` does without.

    Returns FLIES or another ending, the duration [s], the vertex that touches anew (-1: all are off the table, or the
    limit came), and the knots with their number.
    """
    assert isinstance(law, RoughLaw)
    return rough_rub(
        body,
        law,
        plane,
        precision,
        state,
        time,
        limit,
        active,
        for_ever,
        stop_when_decided,
        segment,
        knots,
        known,
        keep,
        after,
    )


@overload(rub, strict=False)
def _rub(
    body: Any,
    law: Any,
    plane: Any,
    precision: Any,
    state: Any,
    time: Any,
    limit: Any,
    active: Any,
    for_ever: Any,
    stop_when_decided: Any,
    segment: Any,
    knots: Any,
    known: Any,
    keep: Any,
    after: Any,
) -> Any:
    """Nothing at all for a law without friction, which never gets here."""
    if law.instance_class is RoughLaw:
        return rough_rub.py_func

    def never(  # type: ignore[no-untyped-def]
        body,
        law,
        plane,
        precision,
        state,
        time,
        limit,
        active,
        for_ever,
        stop_when_decided,
        segment,
        knots,
        known,
        keep,
        after,
    ):
        return FLIES, 0.0, -1, knots, known

    return never


@inner
def lowest_free(body: Body, plane: Plane, state: Array, time: float, active: NDArray[np.bool_]) -> int:
    """The deepest vertex below the table of those that are not active and come down; -1 where there is none."""
    deepest, hit = 0.0, -1
    z_table, v_table = table_height(plane, time), table_velocity(plane, time)
    for k in range(body.vertices.shape[0]):
        if not active[k]:
            x, y, z = arm_of(body.vertices[k], state)
            h = state[2] + z - z_table
            if h < deepest and state[9] + state[10] * y - state[11] * x < v_table:
                deepest, hit = h, k
    return hit


# --- the event loop ----------------------------------------------------------------------------------------------


@inner
def log_event(row: Array, time: float, vertex: int, before: Array, after: Array, i: float, j: int) -> None:
    """Write one event into a row (ROW,)."""
    row[0] = time
    row[1] = vertex
    for k in range(13):
        row[2 + k] = before[k]
    for k in range(6):
        row[15 + k] = after[7 + k]
    row[21] = i
    row[22] = j


@inner
def slow_contact(law: Law, plane: Plane, precision: Precision, radius: float) -> float:
    """Speed [m/s] below which a vertex that accelerates into the table bounces on without end; see `contact`."""
    # With χ = 1 the bounces do not shrink, so nothing collapses.
    return 0.0 if law.parameters[0] >= 1.0 else precision.switch * sqrt(plane.g * radius)


@inner
def rest_on_face(plane: Plane, time: float, limit: float) -> float:
    """How long [s] a face stays pressed on the table, no longer than `limit`."""
    strongest = plane.amplitude * plane.rate * plane.rate
    if strongest <= plane.g:
        return limit
    full = 2.0 * np.pi
    ahead = (np.arcsin(plane.g / strongest) - plane.rate * time - plane.phase) % full
    # At the very instant, rounding must not make a whole period of nothing.
    return min(limit, ahead / plane.rate) if ahead < full * (1.0 - 1e-12) else 0.0


@inner
def hold(
    body: Body,
    plane: Plane,
    precision: Precision,
    state: Array,
    time: float,
    limit: float,
    i: int,
    j: int,
    for_ever: bool,
    segment: int,
    knots: Array,
    known: int,
    keep: bool,
    rates: Array,
    after: Array,
) -> tuple[int, float, int, Array, int]:
    """Carry the state in place through held contact of vertex i alone (j = -1), or i and j, to its end.

    Returns FLIES or another ending, the duration [s], the vertex that touches (-1: a held one is let go, or the limit
    came), and the knots with their number. `for_ever` asks whether the motion has no end, which costs a little.
    """
    begin = time
    fixed = plane.amplitude == 0.0
    shake = plane.amplitude * plane.rate * plane.rate
    while True:
        if keep:
            if known == knots.shape[0]:
                knots = grown(knots)
            note_knot(knots[known], segment, time, state)
            known += 1
        pull = plane.g + table_acceleration(plane, time)
        if for_ever and fixed and balanced(body, state, i, j, pull):
            return BALANCED, time - begin, -1, knots, known
        dt = precision.turn / (
            spin_of(state)
            + sqrt((plane.g + shake) * body.radius * body.mass / body.inertia)
            + (0.0 if fixed else plane.rate)
        )
        dt = min(dt, begin + limit - time)
        held_step(body, plane, state, time, dt, i, j, rates, after)
        first, event = dt, _NO_EVENT
        pull = plane.g + table_acceleration(plane, time + dt)
        n_i, n_j, _, _ = contact_forces(body, after, i, j, pull)
        if n_i <= 0.0:
            first, event = earlier(body, plane, state, time, dt, i, j, _FORCE_I, first, event, rates)
        if j >= 0 and n_j <= 0.0:
            first, event = earlier(body, plane, state, time, dt, i, j, _FORCE_J, first, event, rates)
        z_table = table_height(plane, time + dt)
        for k in range(body.vertices.shape[0]):
            if k != i and k != j:
                within = dt
                if clearance(body.vertices[k], after, z_table) > 0.0:
                    within = dip(body, plane, state, after, time, dt, i, j, k, rates)
                if within > 0.0:
                    first, event = earlier(body, plane, state, time, within, i, j, k, first, event, rates)
        if event != _NO_EVENT:
            if first > 0.0:
                held_step(body, plane, state, time, first, i, j, rates, after)
                copy_to(state, after)
            return FLIES, time + first - begin, max(event, -1), knots, known
        copy_to(state, after)
        time += dt
        if time >= begin + limit:
            return TIME_REACHED, limit, -1, knots, known


@inner
def balanced(body: Body, state: Array, i: int, j: int, pull: float) -> bool:
    """Whether a held die neither leans over nor begins to, but for rounding: it stands on its vertex or edge for ever."""
    rate = sqrt(pull / body.radius)
    if max(abs(state[10]), abs(state[11])) > _ROUNDING * rate:
        return False
    _, _, wx, wy = contact_forces(body, state, i, j, pull)
    if j < 0:
        return bool(max(abs(wx), abs(wy)) <= _ROUNDING * rate * rate)
    # An edge can only turn about itself.
    a, b = arm_of(body.vertices[i], state), arm_of(body.vertices[j], state)
    ex, ey = b[0] - a[0], b[1] - a[1]
    return bool(abs(wx * ex + wy * ey) <= _ROUNDING * rate * rate * sqrt(ex * ex + ey * ey))


@inner
def dip(
    body: Body,
    plane: Plane,
    state: Array,
    after: Array,
    time: float,
    dt: float,
    i: int,
    j: int,
    k: int,
    rates: Array,
) -> float:
    """An instant [s] within a step from `state` to `after` at which vertex k, up at its end, is below the table; 0
    where there is none. It is the lowest of a vertex that sinks and rises again."""
    h0, h1 = (
        clearance(body.vertices[k], state, table_height(plane, time)),
        clearance(body.vertices[k], after, table_height(plane, time + dt)),
    )
    v0, v1 = rise(body, plane, state, time, k), rise(body, plane, after, time + dt, k)
    if v1 <= 0.0:
        return 0.0
    trial = np.empty(13)
    if h0 <= _NEAR * body.radius:
        # It stands on the table and is not held: whatever its velocity says, look.
        for part in (0.125, 0.25, 0.5):
            held_step(body, plane, state, time, part * dt, i, j, rates, trial)
            if clearance(body.vertices[k], trial, table_height(plane, time + part * dt)) < -_ROUNDING * body.radius:
                return part * dt
        return 0.0
    # A cubic through both ends misses the lowest height by far less than a twentieth of what it spans.
    t, lowest = lowest_of_cubic(h0, v0 * dt, h1, v1 * dt)
    if lowest > 0.05 * max(h0, h1):
        return 0.0
    t *= dt
    low, high, v_low, v_high = 0.0, dt, v0, v1
    for step in range(50):
        if step > 0:
            if v_low >= 0.0:
                return 0.0
            t = (low * v_high - high * v_low) / (v_high - v_low)
            t = min(max(t, low + 0.05 * (high - low)), high - 0.05 * (high - low))
        held_step(body, plane, state, time, t, i, j, rates, trial)
        if clearance(body.vertices[k], trial, table_height(plane, time + t)) < 0.0:
            return t
        v = rise(body, plane, trial, time + t, k)
        if v < 0.0:
            low, v_low = t, v
        else:
            high, v_high = t, v
        if high - low <= 1e-7 * dt:
            break
    return 0.0


@inner
def rise(body: Body, plane: Plane, state: Array, time: float, k: int) -> float:
    """Vertical velocity [m/s] of vertex k relative to the table."""
    x, y, _ = arm_of(body.vertices[k], state)
    return float(state[9] + state[10] * y - state[11] * x - table_velocity(plane, time))


@inner
def lowest_of_cubic(h0: float, d0: float, h1: float, d1: float) -> tuple[float, float]:
    """Where the least of seven values of the cubic with these ends and slopes on [0, 1] lies, and what it is."""
    lowest, where = inf, 0.5
    for m in range(1, 8):
        t = m / 8.0
        u = 1.0 - t
        h = u * u * ((1.0 + 2.0 * t) * h0 + t * d0) + t * t * ((1.0 + 2.0 * u) * h1 - u * d1)
        if h < lowest:
            lowest, where = h, t
    return where, lowest


@inner
def earlier(
    body: Body,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    i: int,
    j: int,
    event: int,
    first: float,
    best: int,
    rates: Array,
) -> tuple[float, int]:
    """The earlier of an event and the first one known so far."""
    t = crossing(body, plane, state, time, dt, i, j, event, rates, np.empty(13))
    return (t, event) if t < first or best == _NO_EVENT else (first, best)


@compiled(nogil=True)
def run_throw(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    start: Array,
    start_time: float,
    duration: float,
    impact_limit: int,
    stop_when_decided: bool,
    impact_cap: int,
    keep: bool,
) -> tuple[int, int, int, float, Array, Array, Array]:
    """The event loop. Nothing is changed in its arguments.

    Returns the code of the ending, the number of impacts, the row of the face decided on (-1: none), the time [s] at
    which it ends, the state (13,) after the last event, the log (events, ROW), and the knots of held contact (k, 15):
    event that began it, time, state. Both stay empty unless `keep`.
    """
    state, before, after, rates = start.copy(), np.empty(13), np.empty(13), np.empty((12, 6))
    terms, room = np.empty((body.vertices.shape[0], 4)), np.empty((3, max(3, body.vertices.shape[0])))
    touching = np.empty(body.vertices.shape[0], np.int64)
    log, knots = np.empty((64 if keep else 1, ROW)), np.empty((64 if keep else 1, 15))
    slow = slow_contact(law, plane, precision, body.radius)
    fixed, rough = plane.amplitude == 0.0, rubs(law)
    active = np.zeros(body.vertices.shape[0], np.bool_)
    time, end, impacts, events, known = start_time, start_time + duration, 0, 0, _ZERO
    i, j, still = _NONE, _NONE, 0
    open_end = duration == inf
    patience = inf
    if open_end and not fixed:
        patience = PATIENCE * sqrt(body.radius / plane.g)
    elif open_end and law.parameters[0] < 1.0:
        patience = PATIENCE * max(1.0, 0.1 / (1.0 - law.parameters[0])) * sqrt(body.radius / plane.g)
    # When the die last had the energy to stand up and more; on a table that moves, when it last bounced.
    lively = start_time
    while True:
        face = decided_face(body, law, plane, state) if fixed else -1
        if fixed and energy_per_mass(body, plane, state) > 3.0 * plane.g * body.radius:
            lively = time
        ending, hit, dt = FLIES, _NONE, 0.0
        reorder = False  # whether the contact is to be found anew
        if i < 0:
            if face >= 0 and stop_when_decided and not keep:
                return RESTED, impacts, face, time, state, log[:0], knots[:0]
            spin = spin_of(state)
            swing(body.vertices, state, spin, terms)
            dt, hit, velocity, acceleration = first_touch(
                terms, state[2], state[9], spin, body.radius, plane, time, precision.root, end - time
            )
            if face >= 0 and stop_when_decided:
                ending = RESTED
            elif hit < 0:
                ending = TIME_REACHED
            elif impacts >= impact_limit:
                ending = IMPACTS_REACHED
            if ending != FLIES:
                return ending, impacts, face, time + dt, state, log[: events if keep else 0], knots[:known]
            advance(state, spin, dt, plane)
            time += dt
            reorder = velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)
        else:
            if (stop_when_decided and face >= 0) or (open_end and j == -2 and rest_on_face(plane, time, inf) == inf):
                face = lowest_row(body.feet, state)
                return RESTED, impacts, face, time, state, log[: events if keep else 0], knots[:known]
            if rough:
                ending, dt, hit, knots, known = rub(
                    body,
                    law,
                    plane,
                    precision,
                    state,
                    time,
                    min(end, lively + patience) - time,
                    active,
                    open_end,
                    stop_when_decided,
                    events - 1,
                    knots,
                    known,
                    keep,
                    after,
                )
                if keep:
                    if known == knots.shape[0]:
                        knots = grown(knots)
                    note_knot(knots[known], events - 1, time + dt, state)
                    known += 1
                if ending == RESTED:
                    face = lowest_row(body.feet, state)
                elif ending != FLIES and fixed:
                    face = decided_face(body, law, plane, state)
            elif j == -2:
                dt = rest_on_face(plane, time, end - time)
                carry_face(state, plane, time, dt)
                if time + dt >= end:
                    ending = TIME_REACHED
            else:
                ending, dt, hit, knots, known = hold(
                    body,
                    plane,
                    precision,
                    state,
                    time,
                    min(end, lively + patience) - time,
                    i,
                    j,
                    open_end,
                    events - 1,
                    knots,
                    known,
                    keep,
                    rates,
                    after,
                )
            time += dt
            if ending == TIME_REACHED and time < end:
                ending = SPUN_LONG
            if ending != FLIES:
                return ending, impacts, face, time, state, log[: events if keep else 0], knots[:known]
            # A face that the table has thrown off, and a die that no longer rubs, fly.
            reorder = hit >= 0 or not (rough or j == -2)
            if not reorder:
                i, j = _NONE, _NONE
            if hit >= 0:
                arm = arm_of(body.vertices[hit], state)
                reorder = state[9] + state[10] * arm[1] - state[11] * arm[0] - table_velocity(plane, time) >= -slow
                if not reorder and impacts >= impact_limit:
                    return IMPACTS_REACHED, impacts, face, time, state, log[: events if keep else 0], knots[:known]
        still = still + 1 if dt == 0.0 else 0
        if stop_when_decided and fixed and not rough and hit >= 0 and spins_for_ever(body, plane, state, hit):
            ending = SPINNING
        elif time > lively + patience:
            strikes = hit >= 0 and not reorder
            if energy_per_mass(body, plane, state) > 3.0 * plane.g * body.radius or (strikes and not fixed):
                lively = time
            else:
                ending = SPUN_LONG
        if ending != FLIES:
            return ending, impacts, face, time, state, log[: events if keep else 0], knots[:known]
        copy_to(before, state)
        if reorder:
            near, leaving = _NEAR * body.radius, slow
            if rough:
                # The last step of contact with friction leaves the normal velocities right to the first order only.
                near = _NEAR_RUBBED * body.radius
                rate = spin_of(state) + sqrt(plane.g / body.radius)
                leaving = max(slow, _RUBBED_PART * precision.turn * rate * body.radius)
            n = touching_set(body, plane, state, time, near, leaving, hit, touching)
            hit = -1
            if rough:
                for k in range(active.shape[0]):
                    active[k] = False
                for k in range(n):
                    active[touching[k]] = True
                i, j = (touching[0] if n > 0 else -1), -3
            else:
                stop_approach(body, plane, state, time, touching, n, room)
                i, j = pressed_set(body, plane, state, time, touching, n, room)
            if j == -2:
                lie_on(body, plane, state, time, i)
            elif i >= 0 and not rough:
                stop_on(body, plane, state, time, i, j)
                stand_on(body, plane, state, time, i, j)
            if still > 3 and j != -2 and not rough:
                # Rounding cannot tell whether the die still presses: carry it on a little, and it will be clear.
                nudge = 1e-9 * still * sqrt(body.radius / plane.g)
                if i < 0:
                    advance(state, spin_of(state), nudge, plane)
                else:
                    held_step(body, plane, state, time, nudge, i, j, rates, after)
                    copy_to(state, after)
                time += nudge
        elif hit >= 0:
            if impacts >= impact_cap:
                return IMPACT_CAP, impacts, face, time, state, log[: events if keep else 0], knots[:known]
            x, y, z = arm_of(body.vertices[hit], state)
            arm = (x, y, z - body.rounding)
            bounce(law, body.mass, body.inertia, arm, table_velocity(plane, time), state)
            i, j = _NONE, _NONE
            impacts += 1
            lively = lively if fixed else time
        if keep:
            # The pose is continuous but for what holding a vertex takes away, within which it touched.
            for k in range(7):
                before[k] = state[k]
            if events == log.shape[0]:
                log = grown(log)
            held = float(i)
            if j == -3:
                held = 0.0
                for k in range(active.shape[0]):
                    held += 2.0**k if active[k] else 0.0
            log_event(log[events], time, hit, before, state, held, j)
        events += 1


@compiled
def carry_face(state: Array, plane: Plane, time: float, dt: float) -> None:
    """Carry a die that lies on a face of the table through dt [s], in place: it drifts and turns about the vertical."""
    spin = abs(state[12])
    advance(state, spin, dt, Plane(plane.gx, plane.gy, 0.0, 0.0, 0.0, 0.0))
    state[2] += table_height(plane, time + dt) - table_height(plane, time) - state[9] * dt
    state[9] = table_velocity(plane, time + dt)


@compiled(nogil=True)
def land_many(
    body: Body, law: Law, plane: Plane, precision: Precision, starts: Array, impact_cap: int, landed: NDArray[np.int64]
) -> None:
    """Throw from every row of `starts` (n, 13) until its face is decided; fills `landed` (n, 3): face row or -1,
    impacts, ending."""
    for k in range(starts.shape[0]):
        ending, impacts, face, _, _, _, _ = run_throw(
            body, law, plane, precision, starts[k], 0.0, inf, NO_LIMIT, YES, impact_cap, NO
        )
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, ending


@inner
def poses_of_throw(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    start: Array,
    start_time: float,
    times: Array,
    impact_cap: int,
    poses: Array,
) -> tuple[int, int]:
    """Position and quaternion of a throw at `times` (n,) [s], in order and none before the start, into `poses` (n, 7).

    As `run_throw` and `history` would have them, without the objects in between: heights are those of the centre. NaN
    from the instant at which the impacts are too many. Returns how the throw ended and the number of its impacts.
    """
    last = times[times.shape[0] - 1]
    ending, impacts, _, end, _, log, knots = run_throw(
        body, law, plane, precision, start, start_time, last - start_time, NO_LIMIT, NO, impact_cap, YES
    )
    rates, state, after = np.empty((12, 6)), np.empty(13), np.empty(13)
    event, knot = -1, 0
    for k in range(times.shape[0]):
        time = times[k]
        if ending == IMPACT_CAP and time > end:
            poses[k] = nan
            continue
        while event + 1 < log.shape[0] and log[event + 1, 0] <= time:
            event += 1
        begin, i, j = start_time, -1, -1
        copy_to(state, start)
        if event >= 0:
            begin, i, j = log[event, 0], int(log[event, 21]), int(log[event, 22])
            state_after(log[event], state)
        while knot < knots.shape[0] and knots[knot, 0] < event:
            knot += 1
        while knot + 1 < knots.shape[0] and knots[knot + 1, 0] == event and knots[knot + 1, 1] <= time:
            knot += 1
        if knot < knots.shape[0] and knots[knot, 0] == event and knots[knot, 1] <= time:
            begin = knots[knot, 1]
            copy_to(state, knots[knot, 2:15])
        if j == -1 and i < 0:
            advance(state, spin_of(state), time - begin, plane)
        elif j == -3:
            # Half of each step goes with the old velocities, half with the new ones; after the last nothing is known.
            ends = knot + 1 >= knots.shape[0] or knots[knot + 1, 0] != event
            if not ends and time - begin > 0.5 * (knots[knot + 1, 1] - begin):
                begin = knots[knot + 1, 1]
                copy_to(state, knots[knot + 1, 2:15])
            turn_and_move(state, time - begin)
        elif j == -2:
            carry_face(state, plane, begin, time - begin)
        elif time > begin:
            held_step(body, plane, state, begin, time - begin, i, j, rates, after)
            copy_to(state, after)
        for m in range(7):
            poses[k, m] = state[m]
        poses[k, 2] += body.rounding
    return ending, impacts


@compiled(nogil=True)
def poses_of_throws(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    starts: Array,
    start_times: Array,
    times: Array,
    firsts: Indices,
    impact_cap: int,
    poses: Array,
) -> None:
    """`poses_of_throw` for each of `starts` (m, 13): throw k at `times[firsts[k] : firsts[k + 1]]`, into those rows."""
    for k in range(starts.shape[0]):
        rows = slice(firsts[k], firsts[k + 1])
        if firsts[k + 1] > firsts[k]:
            poses_of_throw(body, law, plane, precision, starts[k], start_times[k], times[rows], impact_cap, poses[rows])


# --- derivatives -------------------------------------------------------------------------------------------------


@inner
def flight_tangent(tangent: Array, columns: int, state: Array, spin: float, dt: float, moved: Array) -> None:
    """Carry derivatives (12, columns) of a state along `dt` [s] of its flight into `moved`; see `tangent`."""
    ux, uy, uz = axis_of(state, spin)
    angle = spin * dt
    c, s = cos(angle), sin(angle)
    half = sin(0.5 * angle)
    # sin θ/θ and (1 - cos θ)/θ keep their digits for every θ but zero itself: no series is needed.
    mean_c = s / angle if angle != 0.0 else 1.0
    mean_s = 2.0 * half * half / angle if angle != 0.0 else 0.0
    for j in range(columns):
        for k in range(3):
            moved[k, j] = tangent[k, j] + dt * tangent[6 + k, j]
            moved[6 + k, j] = tangent[6 + k, j]
            moved[9 + k, j] = tangent[9 + k, j]
        rx, ry, rz = tangent[3, j], tangent[4, j], tangent[5, j]
        wx, wy, wz = dt * tangent[9, j], dt * tangent[10, j], dt * tangent[11, j]
        along_r = (1.0 - c) * (ux * rx + uy * ry + uz * rz)
        along_w = (1.0 - mean_c) * (ux * wx + uy * wy + uz * wz)
        along = along_r + along_w
        # exp(ωt) δ by Rodrigues' formula, and the left Jacobian of exp applied to t δω.
        px, py, pz = s * rx + mean_s * wx, s * ry + mean_s * wy, s * rz + mean_s * wz
        moved[3, j] = c * rx + mean_c * wx + along * ux + uy * pz - uz * py
        moved[4, j] = c * ry + mean_c * wy + along * uy + uz * px - ux * pz
        moved[5, j] = c * rz + mean_c * wz + along * uz + ux * py - uy * px


class Around(NamedTuple):
    """Motion around the instant of an impact, besides the state's own: vertical speeds [m/s], accelerations [m/s²]."""

    table_velocity: float
    table_acceleration: float
    rise: float
    """Acceleration of the centre before the impact; more than -g where other vertices are held."""
    turn_x: float
    """[rad/s²] what the held vertices do to ω_x before the impact."""
    turn_y: float
    fall: float
    """Acceleration of the centre after the impact."""


@inner
def delay(tangent: Array, j: int, arm: tuple[float, float, float], normal_velocity: float, reach: float) -> float:
    """How much later [s] the vertex at `arm` touches for the disturbance in column j: its height stays zero there.

    No later or earlier than √(reach × height): with reach 2/a that is how long a vertex at rest would fall for that
    height, and the derivative is no use beyond. For derivatives proper `reach` is infinite.
    """
    lift = tangent[2, j] + tangent[3, j] * arm[1] - tangent[4, j] * arm[0]
    late = -lift / normal_velocity
    if reach < inf:
        longest = sqrt(reach * abs(lift))
        late = min(max(late, -longest), longest)
    return late


@inner
def bounce_tangent(
    tangent: Array,
    columns: int,
    chi: float,
    mass: float,
    inertia: float,
    arm: tuple[float, float, float],
    state: Array,
    around: Around,
    reach: float,
    dtime: Array,
) -> None:
    """Carry disturbances (12, columns) at the instant of a smooth impact through it, in place.

    `state` is the state before. `dtime` (columns,) receives the derivative of the instant of the impact; for `reach`
    see `delay`.
    """
    x, y, z = arm
    vz, wx, wy, wz = state[9], state[10], state[11], state[12]
    normal_velocity = vz + wx * y - wy * x - around.table_velocity
    softness = 1.0 / mass + (x * x + y * y) / inertia
    s = -(1.0 + chi) * normal_velocity / softness
    closing = around.rise - around.table_acceleration
    for j in range(columns):
        rx, ry, rz = tangent[3, j], tangent[4, j], tangent[5, j]
        dt = delay(tangent, j, arm, normal_velocity, reach)
        dtime[j] = dt
        # To the instant of the disturbed touch ...
        rx, ry, rz = rx + wx * dt, ry + wy * dt, rz + wz * dt
        dx, dy = ry * z - rz * y, rz * x - rx * z
        dwx, dwy = tangent[9, j] + around.turn_x * dt, tangent[10, j] + around.turn_y * dt
        dv = tangent[8, j] + closing * dt + dwx * y + wx * dy - dwy * x - wy * dx
        dsoftness = 2.0 * (x * dx + y * dy) / inertia
        ds = -(1.0 + chi) * dv / softness - s * dsoftness / softness
        dsx, dsy = (y * ds + dy * s) / inertia, -(x * ds + dx * s) / inertia
        # ... and back: between the two instants the die moved with the velocities before, not those after.
        tangent[2, j] -= s / mass * dt
        tangent[3, j] -= y * s / inertia * dt
        tangent[4, j] += x * s / inertia * dt
        tangent[8, j] += ds / mass + (around.rise - around.fall) * dt
        tangent[9, j] = dwx + dsx
        tangent[10, j] = dwy + dsy


class Sources(NamedTuple):
    """What each of the m parameters of a throw changes where: derivatives of what the kernels are given."""

    chi: Array
    """(m,) of the restitution (of the slowest impacts)."""
    mu: Array
    speed_scale: Array
    inertia: Array
    rounding: Array
    vertices: Array
    """(m, n, 3) of the body's vertices."""
    gravity: Array
    """(m, 3) [m/s²], axes of the table."""
    table: Array
    """(m, 3) of amplitude, rate and phase of the table's motion."""


SHIFT = 1e-5
"""Step of the differences through an impact with friction, in units of radius of gyration, contact velocity, or 1. Its
square, and rounding over it, are both 1e-10; a higher order would take twice the impacts, and longer steps, which
more often reach across where the course of the slip changes."""

_PLACE, _VELOCITY, _CHI, _MU, _INERTIA, _SPEED_SCALE, _INPUTS = 0, 3, 6, 7, 8, 9, 10
"""Columns of the gradient of an impulse: arm (3), contact velocity (3), and numbers of law and die."""


@inner
def fade(law: Law, at: int, u: float) -> tuple[float, float, float]:
    """χ/χ₀ of an impact with normal velocity u, and its derivatives by u and by the speed scale; that and the exponent
    stand in the law's parameters from `at` on."""
    scale, exponent = law.parameters[at], law.parameters[at + 1]
    ratio = faded_at_speed(1.0, max(-u, 0.0), scale, exponent)
    slope = exponent * ratio / (scale + max(-u, 0.0))
    return ratio, slope, -slope * u / scale


@compiled
def smooth_gradient(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], c: Array, wanted: Array, out: Array
) -> tuple[float, float, float]:
    """`impulse_gradient` of a law without friction."""
    x, y, _ = arm
    u, chi = c[2], law.parameters[0]
    ratio, by_u, by_scale = 1.0, 0.0, 0.0
    if law.code == SMOOTH_BY_SPEED:
        ratio, by_u, by_scale = fade(law, 1, u)
    softness = 1.0 / mass + (x * x + y * y) / inertia
    s = -(1.0 + chi * ratio) * u / softness
    out[:] = 0.0
    out[2, _PLACE], out[2, _PLACE + 1] = -2.0 * s * x / (inertia * softness), -2.0 * s * y / (inertia * softness)
    out[2, _VELOCITY + 2] = -(1.0 + chi * ratio + chi * by_u * u) / softness
    out[2, _CHI] = -ratio * u / softness
    out[2, _INERTIA] = s * (x * x + y * y) / (inertia * inertia * softness)
    out[2, _SPEED_SCALE] = -chi * by_scale * u / softness
    return 0.0, 0.0, s


@compiled
def rough_gradient(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], c: Array, wanted: Array, out: Array
) -> tuple[float, float, float]:
    """`impulse_gradient` of a law with friction: differences of the second order of this one impact.

    Two rules spare a quarter of them: S is proportional to c, and does not change when r grows with √J.
    """
    mu, ending = law.parameters[1], int(law.parameters[2])
    chi, ratio, by_u, by_scale = law.parameters[0], 1.0, 0.0, 0.0
    if law.code == COULOMB_BY_SPEED:
        ratio, by_u, by_scale = fade(law, 3, c[2])
        chi *= ratio
    gyration, speed = sqrt(inertia / mass), sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    matrix = contact_matrix_of_top(mass, inertia, arm[0], arm[1], arm[2])
    sx, sy, sz = friction_impulse(matrix, chi, mu, ending, c[0], c[1], c[2])
    out[:] = 0.0
    there, input_of = np.empty(8), (arm[0], arm[1], arm[2], c[0], c[1], c[2], chi, mu)
    for k in range(8):
        if k == _VELOCITY + 2 or (k == _CHI and wanted[0] == 0.0) or (k == _MU and wanted[1] == 0.0):
            continue
        step = SHIFT * (gyration if k < _VELOCITY else (speed if k < _CHI else 1.0))
        # Neither χ nor μ can be less than 0: forward from there.
        forward = k >= _CHI and input_of[k] < step
        for n in range(3):
            if forward:
                weight, at = (-1.5, 2.0, -0.5)[n] / step, n * step
            else:
                weight, at = (-0.5, 0.0, 0.5)[n] / step, (n - 1) * step
            if weight == 0.0:
                continue
            for i in range(8):
                there[i] = input_of[i]
            there[k] += at
            if k < _VELOCITY:
                matrix = contact_matrix_of_top(mass, inertia, there[0], there[1], there[2])
            else:
                matrix = contact_matrix_of_top(mass, inertia, arm[0], arm[1], arm[2])
            px, py, pz = friction_impulse(matrix, there[6], there[7], ending, there[3], there[4], there[5])
            out[0, k] += weight * px
            out[1, k] += weight * py
            out[2, k] += weight * pz
    impulse_now = (sx, sy, sz)
    for m in range(3):
        along = c[0] * out[m, _VELOCITY] + c[1] * out[m, _VELOCITY + 1]
        out[m, _VELOCITY + 2] = (impulse_now[m] - along) / c[2] + out[m, _CHI] * law.parameters[0] * by_u
        out[m, _SPEED_SCALE] = out[m, _CHI] * law.parameters[0] * by_scale
        out[m, _CHI] *= ratio
        stretched = arm[0] * out[m, _PLACE] + arm[1] * out[m, _PLACE + 1] + arm[2] * out[m, _PLACE + 2]
        out[m, _INERTIA] = -0.5 * stretched / inertia
    return sx, sy, sz


def impulse_gradient(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], c: Array, wanted: Array, out: Array
) -> tuple[float, float, float]:
    """`impulse` on a contact with velocity `c` (3,) relative to the table, and its derivatives in `out` (3, _INPUTS).

    By the arm (3), the contact velocity (3), χ₀, μ, inertia and speed scale. `wanted` (2,) is not 0 where the column of
    χ (needed by a law by speed as well) or μ is.
    """
    if isinstance(law, RoughLaw):
        return rough_gradient(law, mass, inertia, arm, c, wanted, out)
    return smooth_gradient(law, mass, inertia, arm, c, wanted, out)


@overload(impulse_gradient, strict=False)
def _impulse_gradient_of(law: Any, mass: Any, inertia: Any, arm: Any, c: Any, wanted: Any, out: Any) -> Any:
    """The branch of `impulse_gradient` that the type of the law asks for, chosen when it is compiled."""
    chosen = rough_gradient if law.instance_class is RoughLaw else smooth_gradient
    return chosen.py_func


@inner
def table_source(plane: Plane, time: float, source: Array) -> tuple[float, float]:
    """Derivatives of the table's height and velocity at a fixed time; `source` (3,) those of amplitude, rate, phase."""
    phase = plane.rate * time + plane.phase
    s, c = sin(phase), cos(phase)
    turned = source[1] * time + source[2]
    height = source[0] * s + plane.amplitude * c * turned
    velocity = plane.rate * (source[0] * c - plane.amplitude * s * turned) + plane.amplitude * c * source[1]
    return height, velocity


@inner
def braking(drag: float, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """Acceleration [m/s²] by quadratic drag [1/m]: -k |v| v."""
    rate = 0.0 if drag == 0.0 else -drag * sqrt(vx * vx + vy * vy + vz * vz)
    return rate * vx, rate * vy, rate * vz


@inner
def impact_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    time: float,
    vertex: int,
    state: Array,
    drag: float,
    sources: Sources,
    wanted: Array,
    tangent: Array,
    gradient: Array,
    dtime: Array,
) -> None:
    """Carry derivatives (12, 12 + m) at the instant of an impact through it, in place; see `tangent`.

    `state` is the state before, `drag` [1/m] that of the air. `dtime` (12 + m,) receives the derivative of the instant
    of the impact, `gradient` (3, _INPUTS) is room.
    """
    x, y, level = arm_of(body.vertices[vertex], state)
    z = level - body.rounding
    wx, wy, wz = state[10], state[11], state[12]
    mass, inertia = body.mass, body.inertia
    c = np.empty(3)
    c[0] = state[7] + wy * z - wz * y
    c[1] = state[8] + wz * x - wx * z
    c[2] = state[9] + wx * y - wy * x - table_velocity(plane, time)
    lift_rate = table_acceleration(plane, time)
    sx, sy, sz = impulse_gradient(law, mass, inertia, (x, y, z), c, wanted, gradient)
    kx, ky, kz = (y * sz - z * sy) / inertia, (z * sx - x * sz) / inertia, (x * sy - y * sx) / inertia
    bx, by, bz = braking(drag, state[7], state[8], state[9])
    fx, fy, fz = braking(drag, state[7] + sx / mass, state[8] + sy / mass, state[9] + sz / mass)
    given = np.zeros(_INPUTS)
    for j in range(tangent.shape[1]):
        rx, ry, rz = tangent[3, j], tangent[4, j], tangent[5, j]
        ex, ey, ez, raised, lifted, stiffer, rounder = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if j >= 12:
            p = j - 12
            ex, ey, ez = arm_of(sources.vertices[p, vertex], state)
            raised, lifted = table_source(plane, time, sources.table[p])
            stiffer, rounder = sources.inertia[p], sources.rounding[p]
            given[_CHI], given[_MU], given[_INERTIA] = sources.chi[p], sources.mu[p], stiffer
            given[_SPEED_SCALE] = sources.speed_scale[p]
        late = -(tangent[2, j] + rx * y - ry * x + ez - raised) / c[2]
        dtime[j] = late
        # To the instant of the disturbed touch: the arm, then what the contact moves at ...
        rx, ry, rz = rx + wx * late, ry + wy * late, rz + wz * late
        dx, dy = ry * level - rz * y + ex, rz * x - rx * level + ey
        dz = rx * y - ry * x + ez - rounder
        vx, vy, vz = tangent[9, j], tangent[10, j], tangent[11, j]
        given[0], given[1], given[2] = dx, dy, dz
        given[3] = tangent[6, j] + (plane.gx + bx) * late + vy * z - vz * y + wy * dz - wz * dy
        given[4] = tangent[7, j] + (plane.gy + by) * late + vz * x - vx * z + wz * dx - wx * dz
        given[5] = (
            tangent[8, j] - (plane.g - bz) * late + vx * y - vy * x + wx * dy - wy * dx - lifted - lift_rate * late
        )
        dsx, dsy, dsz = 0.0, 0.0, 0.0
        for k in range(_INPUTS):
            dsx += gradient[0, k] * given[k]
            dsy += gradient[1, k] * given[k]
            dsz += gradient[2, k] * given[k]
        # ... and back: between the two instants the die moved with the velocities before, not those after.
        for k in range(3):
            tangent[3 + k, j] -= (kx, ky, kz)[k] * late
            tangent[k, j] -= (sx, sy, sz)[k] / mass * late
        tangent[6, j] += dsx / mass + (bx - fx) * late
        tangent[7, j] += dsy / mass + (by - fy) * late
        tangent[8, j] += dsz / mass + (bz - fz) * late
        tangent[9, j] += (y * dsz - z * dsy + dy * sz - dz * sy - stiffer * kx) / inertia
        tangent[10, j] += (z * dsx - x * dsz + dz * sx - dx * sz - stiffer * ky) / inertia
        tangent[11, j] += (x * dsy - y * dsx + dx * sy - dy * sx - stiffer * kz) / inertia


class Vacuum(NamedTuple):
    """Nothing but gravity acts in flight."""

    drag: float
    """0."""


class Air(NamedTuple):
    """Quadratic drag, v' = g - k |v| v: a type of its own, so that a flight without it does not even compile it."""

    drag: float
    """k [1/m]."""
    by_drag: Array
    """(m,) derivatives of k by the parameters."""


AIR_STEP_S = 0.005
"""[s] of a step of the method of order 8 through the air, at most. A throw's velocity changes its direction in some
0.1 s, and drag is a tenth of gravity or less: an error of 1e-14 m in a flight, and of 1e-11 m where the die nearly
stands still at the top, where |v| is no smooth function of time."""

_FLOW = 49
"""Numbers that a flight through the air carries along: p, v, seven pairs of disturbances of p and of v, and the time
[s] since its start. The pairs are the derivatives by k, by v at the start (3), and by gravity (3)."""


@inner
def flow_rates(drag: float, plane: Plane, flow: Array, out: Array) -> None:
    """Fill `out` (_FLOW,) with the rates of `flow`."""
    vx, vy, vz = flow[3], flow[4], flow[5]
    speed = sqrt(vx * vx + vy * vy + vz * vz)
    out[0], out[1], out[2] = vx, vy, vz
    out[3] = plane.gx - drag * speed * vx
    out[4] = plane.gy - drag * speed * vy
    out[5] = -plane.g - drag * speed * vz
    for c in range(7):
        at = 6 + 6 * c
        dx, dy, dz = flow[at + 3], flow[at + 4], flow[at + 5]
        along = (vx * dx + vy * dy + vz * dz) / speed if speed > 0.0 else 0.0
        out[at], out[at + 1], out[at + 2] = dx, dy, dz
        out[at + 3] = -drag * (speed * dx + along * vx)
        out[at + 4] = -drag * (speed * dy + along * vy)
        out[at + 5] = -drag * (speed * dz + along * vz)
        if c == 0:
            out[9] -= speed * vx
            out[10] -= speed * vy
            out[11] -= speed * vz
        elif c >= 4:
            out[at + c - 1] += 1.0
    out[48] = 1.0


@inner
def drift(drag: float, plane: Plane, flow: Array, dt: float) -> None:
    """Carry `flow` (_FLOW,) through `dt` [s] of flight, of either sign, in place."""
    steps = max(1, ceil(abs(dt) / AIR_STEP_S))
    stages, now = np.empty((12, _FLOW)), np.empty(_FLOW)
    for _ in range(steps):
        for s in range(13):
            copy_to(now, flow)
            for n in range(s):
                weight = dt / steps * (_A[s, n] if s < 12 else _B[n])
                if weight != 0.0:
                    for k in range(_FLOW):
                        now[k] += weight * stages[n, k]
            if s < 12:
                flow_rates(drag, plane, now, stages[s])
        copy_to(flow, now)


@inner
def start_flow(state: Array, flow: Array) -> None:
    """Make `flow` (_FLOW,) that of a flight that begins with `state`."""
    for k in range(_FLOW):
        flow[k] = 0.0
    for k in range(3):
        flow[k], flow[3 + k] = state[k], state[7 + k]
    flow[15], flow[22], flow[29] = 1.0, 1.0, 1.0


@compiled
def flows(drag: float, start: Array, delays: Array) -> Array:
    """Positions and velocities (n, 6) that many seconds (n,) after a flight began with `start` (13,), world axes."""
    flow, out = np.empty(_FLOW), np.empty((delays.shape[0], 6))
    for n in range(delays.shape[0]):
        start_flow(start, flow)
        drift(drag, LEVEL, flow, delays[n])
        for k in range(6):
            out[n, k] = flow[k]
    return out


@inner
def fly_in_vacuum(
    air: Vacuum,
    plane: Plane,
    state: Array,
    spin: float,
    dt: float,
    tangent: Array,
    sources: Sources,
    flow: Array,
    pose: Array,
    moved: Array,
) -> None:
    """`fly` along a parabola; `flow` is not used."""
    copy_to(pose, state)
    advance(pose, spin, dt, plane)
    flight_tangent(tangent, tangent.shape[1], state, spin, dt, moved)
    for p in range(sources.gravity.shape[0]):
        for k in range(3):
            moved[k, 12 + p] += 0.5 * sources.gravity[p, k] * dt * dt
            moved[6 + k, 12 + p] += sources.gravity[p, k] * dt


@inner
def fly_in_air(
    air: Air,
    plane: Plane,
    state: Array,
    spin: float,
    dt: float,
    tangent: Array,
    sources: Sources,
    flow: Array,
    pose: Array,
    moved: Array,
) -> None:
    """`fly` against drag; `flow` goes on from where the last call left it."""
    drift(air.drag, plane, flow, dt - flow[48])
    copy_to(pose, state)
    advance(pose, spin, dt, plane)  # for its attitude
    for k in range(3):
        pose[k], pose[7 + k] = flow[k], flow[3 + k]
    flight_tangent(tangent, tangent.shape[1], state, spin, dt, moved)
    for j in range(tangent.shape[1]):
        for k in range(3):
            place, speed = tangent[k, j], 0.0
            for m in range(3):
                place += flow[12 + 6 * m + k] * tangent[6 + m, j]
                speed += flow[15 + 6 * m + k] * tangent[6 + m, j]
            if j >= 12:
                p = j - 12
                place += flow[6 + k] * air.by_drag[p]
                speed += flow[9 + k] * air.by_drag[p]
                for m in range(3):
                    place += flow[30 + 6 * m + k] * sources.gravity[p, m]
                    speed += flow[33 + 6 * m + k] * sources.gravity[p, m]
            moved[k, j], moved[6 + k, j] = place, speed


def fly(
    air: Vacuum | Air,
    plane: Plane,
    state: Array,
    spin: float,
    dt: float,
    tangent: Array,
    sources: Sources,
    flow: Array,
    pose: Array,
    moved: Array,
) -> None:
    """The state and its derivatives `dt` [s] after the start of a flight, into `pose` (13,) and `moved` (12, 12 + m)."""
    if isinstance(air, Air):
        fly_in_air(air, plane, state, spin, dt, tangent, sources, flow, pose, moved)
    else:
        fly_in_vacuum(air, plane, state, spin, dt, tangent, sources, flow, pose, moved)


@overload(fly, strict=False)
def _fly_of(
    air: Any, plane: Any, state: Any, spin: Any, dt: Any, tangent: Any, sources: Any, flow: Any, pose: Any, moved: Any
) -> Any:
    """The branch of `fly` that the type of the air asks for, chosen when it is compiled."""
    chosen = fly_in_air if air.instance_class is Air else fly_in_vacuum
    return chosen.py_func


@inner
def touch_in_vacuum(
    air: Vacuum, plane: Plane, state: Array, terms: Array, spin: float, radius: float, clock: float, limit: float
) -> tuple[float, int, float, float]:
    """`touch_ahead` of a parabola."""
    if limit < inf:
        return first_touch(terms, state[2], state[9], spin, radius, plane, clock, 0.0, limit)
    dt, found, velocity, acceleration = touch_of_vertex(terms, state[2], state[9], spin, radius, plane, clock)
    return dt, 0 if found else -1, velocity, acceleration


@inner
def touch_in_air(
    air: Air, plane: Plane, state: Array, terms: Array, spin: float, radius: float, clock: float, limit: float
) -> tuple[float, int, float, float]:
    """`touch_ahead` against drag: the flight is integrated step by step, none longer than the parabola that bounds the
    height of each vertex from below (or, backwards, from above) allows."""
    flow, g = np.empty(_FLOW), plane.g
    start_flow(state, flow)
    shake = plane.amplitude * plane.rate * plane.rate
    t, alone, back = 0.0, limit == inf, False
    below = -1e-12 * radius
    while True:
        c, s = cos(spin * t), sin(spin * t)
        speed = sqrt(flow[3] * flow[3] + flow[4] * flow[4] + flow[5] * flow[5]) + 2.0 * g * AIR_STEP_S
        push = air.drag * speed * speed + shake
        size = abs(flow[2]) + radius * (1.0 + spin * abs(t))
        size += plane.amplitude * (1.0 + abs(plane.rate * (clock + t) + plane.phase))
        h_tol = _ROUNDING * size
        v_tol = _ROUNDING * (speed + spin * radius * (1.0 + spin * abs(t)) + plane.amplitude * plane.rate)
        hit, hit_v, hit_a, step = -1, 0.0, 0.0, 2.0 * AIR_STEP_S
        for i in range(terms.shape[0]):
            a, b = terms[i, 0], terms[i, 1]
            h = flow[2] + a * c + b * s + terms[i, 2] - table_height(plane, clock + t)
            v = flow[5] + spin * (b * c - a * s) - table_velocity(plane, clock + t)
            if alone and t == 0.0 and h < below and v < 0.0:
                back = True
            swing_most = spin * spin * terms[i, 3]
            if back:
                if h >= -h_tol:
                    return t, i, v, -g
                bound = max(swing_most + push - g, 1e-3 * g)
                root = sqrt(v * v - 2.0 * bound * h)
                step = min(step, 2.0 * h / (v - root) if v < 0.0 else (v + root) / bound)
                continue
            bound = g + swing_most + push
            if h > h_tol:
                root = sqrt(v * v + 2.0 * bound * h)
                step = min(step, (v + root) / bound if v > 0.0 else 2.0 * h / (root - v))
            elif v > v_tol:
                step = min(step, 2.0 * v / bound)
            elif hit < 0 or v < hit_v:
                hit, hit_v = i, v if v < -v_tol else 0.0
                hit_a = -g - spin * spin * (a * c + b * s) - table_acceleration(plane, clock + t)
                if alone and h < below:
                    return t, -1, hit_v, hit_a
        if hit >= 0:
            return t, hit, hit_v, hit_a
        if back and t < -sqrt(2.0 * radius / g):
            return t, -1, 0.0, 0.0
        if t + step > limit:
            return limit, -1, 0.0, 0.0
        step = -step if back else step
        drift(air.drag, plane, flow, step)
        t += step


def touch_ahead(
    air: Vacuum | Air,
    plane: Plane,
    state: Array,
    terms: Array,
    spin: float,
    radius: float,
    clock: float,
    limit: float,
) -> tuple[float, int, float, float]:
    """The first touch of the vertices of `terms` up to `limit` [s], as `first_touch`; where that is infinite, the touch
    of the one vertex in `terms`, as `touch_of_vertex`. Time, row (-1: none), velocity, acceleration."""
    if isinstance(air, Air):
        return touch_in_air(air, plane, state, terms, spin, radius, clock, limit)
    return touch_in_vacuum(air, plane, state, terms, spin, radius, clock, limit)


@overload(touch_ahead, strict=False)
def _touch_ahead_of(
    air: Any, plane: Any, state: Any, terms: Any, spin: Any, radius: Any, clock: Any, limit: Any
) -> Any:
    """The branch of `touch_ahead` that the type of the air asks for, chosen when it is compiled."""
    chosen = touch_in_air if air.instance_class is Air else touch_in_vacuum
    return chosen.py_func


@compiled
def run_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    air: Vacuum | Air,
    start: Array,
    start_time: float,
    times: Array,
    sequence: NDArray[np.int64],
    free: bool,
    impact_cap: int,
    seed: Array,
    sources: Sources,
) -> tuple[int, Array, Array, Array, Array]:
    """The event loop with derivatives. `times` (n,) ascending; `sequence` is used unless `free`; `seed` (12, 12 + m)
    are the derivatives of the start, `sources` those of what else the m parameters change.

    Returns an ending (TIME_REACHED, CHATTER, IMPACT_CAP or NO_TOUCH), poses (n, 7), their derivatives (n, 6, 12 + m),
    the log (k, ROW) with absolute times, and the derivatives (k, 12 + m) of the impacts' instants.
    """
    n, columns = times.shape[0], seed.shape[1]
    poses, jacobian = np.empty((n, 7)), np.empty((n, 6, columns))
    log, dtimes = np.empty((16, ROW)), np.empty((16, columns))
    state, before, pose = start.copy(), np.empty(13), np.empty(13)
    tangent, moved, gradient = seed.copy(), np.empty((12, columns)), np.empty((3, _INPUTS))
    flow = np.empty(_FLOW)
    wanted = np.zeros(2)
    by_speed = law.code == SMOOTH_BY_SPEED or law.code == COULOMB_BY_SPEED
    wanted[0] = 1.0 if by_speed or np.any(sources.chi) else 0.0
    wanted[1] = 1.0 if np.any(sources.mu) else 0.0
    terms = np.empty((body.vertices.shape[0], 4))
    slow = slow_contact(law, plane, FINE, body.radius)
    last = times[n - 1] if n > 0 else start_time
    time, done, impacts, ending = start_time, 0, 0, TIME_REACHED
    while True:
        spin = spin_of(state)
        swing(body.vertices, state, spin, terms)
        start_flow(state, flow)
        hit, dt = _NONE, 0.0
        if free:
            dt, hit, velocity, acceleration = touch_ahead(
                air, plane, state, terms, spin, body.radius, time, last - time
            )
            if hit >= 0 and (velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)):
                hit, ending = -1, CHATTER
            elif hit >= 0 and impacts >= impact_cap:
                hit, ending = -1, IMPACT_CAP
        elif impacts < sequence.shape[0]:
            hit = sequence[impacts]
            dt, found, velocity, _ = touch_ahead(air, plane, state, terms[hit : hit + 1], spin, body.radius, time, inf)
            if found < 0 or velocity >= 0.0:
                hit, ending = -1, NO_TOUCH
        while done < n and (hit < 0 or times[done] < time + dt):
            fly(air, plane, state, spin, times[done] - time, tangent, sources, flow, pose, moved)
            for k in range(7):
                poses[done, k] = pose[k]
            for k in range(6):
                for m in range(columns):
                    jacobian[done, k, m] = moved[k, m]
            done += 1
        if hit < 0:
            return ending, poses, jacobian, log[:impacts], dtimes[:impacts]
        if impacts == log.shape[0]:
            log, dtimes = grown(log), grown(dtimes)
        fly(air, plane, state, spin, dt, tangent, sources, flow, before, moved)
        tangent, moved = moved, tangent
        copy_to(state, before)
        time += dt
        impact_tangent(
            body, law, plane, time, hit, state, air.drag, sources, wanted, tangent, gradient, dtimes[impacts]
        )
        strike(body, law, plane, time, hit, state)
        log_event(log[impacts], time, hit, before, state, -1.0, _NONE)
        impacts += 1


# --- derivatives of any law, through held contact, and what rounding makes of a throw ---------------------------------


MOST_COLUMNS = 40
"""Room for columns of errors; they are brought back to twelve when it is full."""

MOST_BRANCHES = 16
"""Other orders of touches that are followed before a throw is given up as undecidable."""

SAFETY = 3.0
"""How many times its estimate an error may come to where the order of touches is asked for: the estimate adds up
independent errors by their squares."""

UNCERTAIN = 0.05
"""Error, in units of `scales_of`, beyond which another outcome must be reckoned with. Of 3700 throws whose face changed
with the tolerance of touches, none had reached less than 0.23."""

SLIGHT = 1e-4
"""Difference that the order of two touches may make, in the same units, to be carried as an error; larger ones are
followed as throws of their own."""

_SMALL = 1e-5
"""Size of the differences that stand for derivatives, in the same units: their square, and rounding over it, are both
1e-10."""


@compiled
def scales_of(body: Body, plane: Plane) -> Array:
    """Units (12,) of the twelve disturbances: R, 1 rad, √(g R), √(g/R)."""
    scale = np.empty(12)
    for k in range(3):
        scale[k], scale[3 + k] = body.radius, 1.0
        scale[6 + k], scale[9 + k] = sqrt(plane.g * body.radius), sqrt(plane.g / body.radius)
    return scale


@inner
def size_of(tangent: Array, j: int, scale: Array) -> float:
    """Length of a column in units of `scale`."""
    square = 0.0
    for k in range(12):
        square += (tangent[k, j] / scale[k]) * (tangent[k, j] / scale[k])
    return sqrt(square)


@compiled
def displaced(state: Array, tangent: Array, j: int, step: float, out: Array) -> None:
    """The state moved by `step` times column j into `out`, to the second order."""
    for k in range(3):
        out[k] = state[k] + step * tangent[k, j]
        out[7 + k] = state[7 + k] + step * tangent[6 + k, j]
        out[10 + k] = state[10 + k] + step * tangent[9 + k, j]
    x, y, z = 0.5 * step * tangent[3, j], 0.5 * step * tangent[4, j], 0.5 * step * tangent[5, j]
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    norm = sqrt(1.0 + x * x + y * y + z * z)
    out[3] = (qw - x * qx - y * qy - z * qz) / norm
    out[4] = (qx + x * qw + y * qz - z * qy) / norm
    out[5] = (qy - x * qz + y * qw + z * qx) / norm
    out[6] = (qz + x * qy - y * qx + z * qw) / norm


@inner
def difference(a: Array, b: Array, weight: float, tangent: Array, j: int) -> None:
    """Write `weight` times the small disturbance that takes state b to state a into column j."""
    for k in range(3):
        tangent[k, j] = weight * (a[k] - b[k])
        tangent[6 + k, j] = weight * (a[7 + k] - b[7 + k])
        tangent[9 + k, j] = weight * (a[10 + k] - b[10 + k])
    w = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6]
    twice = 2.0 * weight if w >= 0.0 else -2.0 * weight
    tangent[3, j] = twice * (a[4] * b[3] - a[3] * b[4] + a[6] * b[5] - a[5] * b[6])
    tangent[4, j] = twice * (a[5] * b[3] - a[3] * b[5] + a[4] * b[6] - a[6] * b[4])
    tangent[5, j] = twice * (a[6] * b[3] - a[3] * b[6] + a[5] * b[4] - a[4] * b[5])


@inner
def strike(body: Body, law: Law, plane: Plane, time: float, vertex: int, state: Array) -> None:
    """Apply the law to a vertex on the table, in place."""
    x, y, z = arm_of(body.vertices[vertex], state)
    bounce(law, body.mass, body.inertia, (x, y, z - body.rounding), table_velocity(plane, time), state)


@inner
def is_held(vertex: int, i: int, j: int) -> bool:
    """Whether the columns i and j of a logged event hold a vertex; a face holds all that touch."""
    if j == -3:
        return (i >> vertex) & 1 == 1
    return i >= 0 and vertex in (i, j)


@inner
def around_impact(body: Body, plane: Plane, state: Array, time: float, i: int, j: int) -> Around:
    """What moves around an impact at `time`; i and j were held until then (-1: none)."""
    v_table, a_table = table_velocity(plane, time), table_acceleration(plane, time)
    if j == -3:
        # Friction has carried the die; it is taken to have done so with no acceleration.
        return Around(v_table, a_table, a_table, 0.0, 0.0, -plane.g)
    if i < 0 or j == -2:
        return Around(v_table, a_table, -plane.g, 0.0, 0.0, -plane.g)
    n_i, n_j, wx, wy = contact_forces(body, state, i, j, plane.g + a_table)
    return Around(v_table, a_table, n_i + n_j - plane.g, wx, wy, -plane.g)


@inner
def strike_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    time: float,
    vertex: int,
    state: Array,
    i: int,
    j: int,
    capped: bool,
    scale: Array,
    tangent: Array,
    columns: int,
    dtime: Array,
) -> None:
    """Carry disturbances (12, columns) through the impact of a vertex, in place; i and j were held until then.

    Smooth impacts have derivatives; of other laws differences are taken. `capped` bounds the delays, see `delay`.
    """
    arm = arm_of(body.vertices[vertex], state)
    around = around_impact(body, plane, state, time, i, j)
    reach = inf
    if capped:
        falling = abs(around.rise + around.turn_x * arm[1] - around.turn_y * arm[0] + spun(state, arm))
        reach = 2.0 / max(abs(falling - around.table_acceleration), plane.g)
    if law.code == SMOOTH:
        chi = law.parameters[0]
        bounce_tangent(tangent, columns, chi, body.mass, body.inertia, arm, state, around, reach, dtime)
        return
    normal_velocity = state[9] + state[10] * arm[1] - state[11] * arm[0] - around.table_velocity
    ahead, behind, after, there = np.empty(13), np.empty(13), state.copy(), np.empty((12, 1))
    strike(body, law, plane, time, vertex, after)
    for c in range(columns):
        dt = delay(tangent, c, arm, normal_velocity, reach)
        dtime[c] = dt
        for k in range(3):
            there[k, 0] = tangent[k, c] + state[7 + k] * dt
            there[3 + k, 0] = tangent[3 + k, c] + state[10 + k] * dt
            there[6 + k, 0], there[9 + k, 0] = tangent[6 + k, c], tangent[9 + k, c]
        there[6, 0] += plane.gx * dt
        there[7, 0] += plane.gy * dt
        there[8, 0] += around.rise * dt
        there[9, 0] += around.turn_x * dt
        there[10, 0] += around.turn_y * dt
        size = size_of(there, _ZERO, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, there, _ZERO, step, ahead)
            displaced(state, there, _ZERO, -step, behind)
            strike(body, law, plane, time + step * dt, vertex, ahead)
            strike(body, law, plane, time - step * dt, vertex, behind)
            difference(ahead, behind, 0.5 / step, tangent, c)
        for k in range(3):
            tangent[k, c] -= after[7 + k] * dt
            tangent[3 + k, c] -= after[10 + k] * dt
        tangent[6, c] -= plane.gx * dt
        tangent[7, c] -= plane.gy * dt
        tangent[8, c] -= around.fall * dt


@inner
def settle_tangent(
    body: Body, plane: Plane, state: Array, time: float, i: int, j: int, scale: Array, tangent: Array, columns: int
) -> None:
    """Carry disturbances into held contact of i and j, in place: what would lift or move the vertices is lost."""
    ahead, behind = np.empty(13), np.empty(13)
    for c in range(columns):
        if j == -2:
            for k in (2, 3, 4, 8, 9, 10):
                tangent[k, c] = 0.0
            continue
        size = size_of(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, ahead)
            displaced(state, tangent, c, -step, behind)
            for other in (ahead, behind):
                stop_on(body, plane, other, time, i, j)
                stand_on(body, plane, other, time, i, j)
            difference(ahead, behind, 0.5 / step, tangent, c)


@inner
def held_tangent(
    body: Body,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    i: int,
    j: int,
    scale: Array,
    tangent: Array,
    columns: int,
    rates: Array,
) -> None:
    """Carry disturbances through dt [s] of held contact, in place, by differences of the integration itself."""
    there, ahead, behind = np.empty(13), np.empty(13), np.empty(13)
    for c in range(columns):
        size = size_of(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, there)
            held_step(body, plane, there, time, dt, i, j, rates, ahead)
            displaced(state, tangent, c, -step, there)
            held_step(body, plane, there, time, dt, i, j, rates, behind)
            difference(ahead, behind, 0.5 / step, tangent, c)


@inner
def rough_rubbed_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    active: NDArray[np.bool_],
    scale: Array,
    tangent: Array,
    columns: int,
) -> None:
    """`rubbed_tangent` with friction."""
    n, mu = body.vertices.shape[0], law.parameters[1]
    there, ahead, behind = np.empty(13), np.empty(13), np.empty(13)
    arms, guess, impulses = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for c in range(columns):
        size = size_of(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, there)
            rub_step(body, mu, plane, there, time, dt, active, arms, guess, impulses, ahead, FINE.sweep)
            displaced(state, tangent, c, -step, there)
            rub_step(body, mu, plane, there, time, dt, active, arms, guess, impulses, behind, FINE.sweep)
            difference(ahead, behind, 0.5 / step, tangent, c)
    rub_step(body, mu, plane, state, time, dt, active, arms, guess, impulses, ahead, FINE.sweep)
    place, z_table = 0, table_height(plane, time + dt)
    for k in range(n):
        if active[k]:
            if impulses[place, 2] <= 0.0 and clearance(body.vertices[k], ahead, z_table) > _NEAR_RUBBED * body.radius:
                active[k] = False
            place += 1


def rubbed_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    active: NDArray[np.bool_],
    scale: Array,
    tangent: Array,
    columns: int,
) -> None:
    """As `held_tangent`, with friction: differences of its steps. Vertices that no longer press leave `active`."""
    assert isinstance(law, RoughLaw)
    return rough_rubbed_tangent(body, law, plane, state, time, dt, active, scale, tangent, columns)


@overload(rubbed_tangent, strict=False)
def _rubbed_tangent(
    body: Any, law: Any, plane: Any, state: Any, time: Any, dt: Any, active: Any, scale: Any, tangent: Any, columns: Any
) -> Any:
    """Nothing at all for a law without friction, which never gets here."""
    if law.instance_class is RoughLaw:
        return rough_rubbed_tangent.py_func
    return lambda body, law, plane, state, time, dt, active, scale, tangent, columns: None


@inner
def carried(
    body: Body,
    law: Law,
    plane: Plane,
    state: Array,
    time: float,
    until: float,
    i: int,
    j: int,
    knots: Array,
    knot: int,
    segment: int,
    own: bool,
    scale: Array,
    tangent: Array,
    moved: Array,
    columns: int,
    rates: Array,
) -> tuple[Array, Array, int, int]:
    """Carry disturbances from an event to the next, through flight or held contact.

    `knot` is the first of `knots` not passed yet, `segment` the event that began this stretch. With `own` the error of
    the integration joins as a column (not with friction, where it is that of the method, set by `Precision.turn`).
    Returns the disturbances, the spare room, the number of columns, and the knot.
    """
    if i < 0 or j == -2:
        if until > time:
            flight_tangent(tangent, columns, state, spin_of(state), until - time, moved)
            tangent, moved = moved, tangent
        return tangent, moved, columns, knot
    whole, half, halves = np.empty(13), np.empty(13), np.empty(13)
    active = np.zeros(body.vertices.shape[0], np.bool_)
    for k in range(body.vertices.shape[0]):
        active[k] = is_held(k, i, j)
    while knot < knots.shape[0] and knots[knot, 0] <= segment:
        if knots[knot, 0] == segment:
            more = knot + 1 < knots.shape[0] and knots[knot + 1, 0] == segment
            begin, end = knots[knot, 1], knots[knot + 1, 1] if more else until
            here, dt = knots[knot, 2:15].copy(), end - begin
            if own and columns == tangent.shape[1]:
                columns = compressed(tangent, columns, moved)
            if dt > 0.0 and j == -3:
                rubbed_tangent(body, law, plane, here, begin, dt, active, scale, tangent, columns)
            elif dt > 0.0:
                held_tangent(body, plane, here, begin, dt, i, j, scale, tangent, columns, rates)
                if own:
                    held_step(body, plane, here, begin, dt, i, j, rates, whole)
                    held_step(body, plane, here, begin, 0.5 * dt, i, j, rates, half)
                    held_step(body, plane, half, begin + 0.5 * dt, 0.5 * dt, i, j, rates, halves)
                    difference(whole, halves, 1.0, tangent, columns)
                    columns += 1
        knot += 1
    return tangent, moved, columns, knot


@inner
def compressed(errors: Array, columns: int, room: Array) -> int:
    """At most twelve columns with the same sums of squares in every direction, in place: L of the rows' E = L Q."""
    factor = np.zeros((12, 12))
    copy_columns(room, errors, columns)
    used = _ZERO
    for r in range(12):
        square, left = 0.0, 0.0
        for c in range(columns):
            square += errors[r, c] * errors[r, c]
            left += room[r, c] * room[r, c]
        if left <= 1e-26 * square or left == 0.0:
            continue  # the rest is rounding
        norm = sqrt(left)
        factor[r, used] = norm
        for c in range(columns):
            room[r, c] /= norm
        for s in range(r + 1, 12):
            along = 0.0
            for c in range(columns):
                along += room[s, c] * room[r, c]
            factor[s, used] = along
            for c in range(columns):
                room[s, c] -= along * room[r, c]
        used += 1
    copy_columns(errors, factor, used)
    return used


@inner
def event_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    row: Array,
    i: int,
    j: int,
    scale: Array,
    tangent: Array,
    columns: int,
    dtime: Array,
) -> tuple[int, int]:
    """Carry disturbances through a logged event, in place; i and j were held until then. Returns what is held after."""
    state, time, hit = row[2:15].copy(), row[0], int(row[1])
    if hit >= 0:
        strike_tangent(body, law, plane, time, hit, state, i, j, NO, scale, tangent, columns, dtime)
    elif row[21] >= 0 and row[22] != -3:
        settle_tangent(body, plane, state, time, int(row[21]), int(row[22]), scale, tangent, columns)
    return int(row[21]), int(row[22])


@compiled(nogil=True)
def run_growth(
    body: Body, law: Law, plane: Plane, start: Array, start_time: float, log: Array, knots: Array
) -> tuple[Array, Array]:
    """Derivatives of a logged throw after each of its events, by its start, in units of `scales_of`.

    Returns them (events, 12, 12), divided by 10^k, and the k (events,) that keep them within range.
    """
    scale = scales_of(body, plane)
    tangent, moved, dtime, rates = np.zeros((12, 12)), np.empty((12, 12)), np.empty(12), np.empty((12, 6))
    for k in range(12):
        tangent[k, k] = scale[k]
    maps, exponents = np.empty((log.shape[0], 12, 12)), np.zeros(log.shape[0])
    state, time, i, j, knot, exponent = start.copy(), start_time, _NONE, _NONE, _ZERO, 0.0
    for k in range(log.shape[0]):
        row = log[k]
        tangent, moved, _, knot = carried(
            body, law, plane, state, time, row[0], i, j, knots, knot, k - 1, NO, scale, tangent, moved, _TWELVE, rates
        )
        i, j = event_tangent(body, law, plane, row, i, j, scale, tangent, _TWELVE, dtime)
        time = row[0]
        state_after(row, state)
        if np.max(np.abs(tangent)) > 1e100:
            tangent *= 1e-100
            exponent += 100.0
        exponents[k] = exponent
        for c in range(12):
            maps[k, :, c] = tangent[:, c] / scale
    return maps, exponents


@inner
def orthonormalised(tangent: Array, scale: Array, logs: Array) -> None:
    """Make the columns (12, m) orthonormal in units of `scale`, in place; `logs` (m,) receives the logarithms of the
    lengths that Gram and Schmidt's method took away."""
    for c in range(tangent.shape[1]):
        tangent[:, c] /= scale
    for c in range(tangent.shape[1]):
        for _ in range(2):  # once more, for the rounding of the first time
            for b in range(c):
                tangent[:, c] -= np.dot(tangent[:, b].copy(), tangent[:, c].copy()) * tangent[:, b]
        norm = sqrt(np.sum(tangent[:, c] * tangent[:, c]))
        logs[c] = np.log(norm)
        tangent[:, c] /= norm
    for c in range(tangent.shape[1]):
        tangent[:, c] *= scale


@compiled(nogil=True)
def run_exponents(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    start: Array,
    start_time: float,
    tangent: Array,
    logs: Array,
    clock: Array,
) -> tuple[int, int, float, Array]:
    """Follow a throw and m disturbances, `tangent` (12, m), made orthonormal at every impact (Benettin et al.).

    Fills `logs` (impacts, m) with the logarithms of their growth since the impact before, `clock` (impacts,) with the
    instants [s]. Returns how the throw ended, the number of impacts reached, and the time and state after the last.
    """
    scale, columns = scales_of(body, plane), tangent.shape[1]
    moved, dtime, rates = np.empty(tangent.shape), np.empty(columns), np.empty((12, 6))
    state, time, i, j, done, code = start.copy(), start_time, _NONE, _NONE, 0, IMPACTS_REACHED
    wanted = logs.shape[0]
    while done < wanted and code == IMPACTS_REACHED:
        code, _, _, until, end, log, knots = run_throw(
            body, law, plane, precision, state, time, inf, min(256, wanted - done), NO, NO_LIMIT, YES
        )
        knot = 0
        for k in range(log.shape[0]):
            row = log[k]
            tangent, moved, _, knot = carried(
                body,
                law,
                plane,
                state,
                time,
                row[0],
                i,
                j,
                knots,
                knot,
                k - 1,
                False,
                scale,
                tangent,
                moved,
                columns,
                rates,
            )
            i, j = event_tangent(body, law, plane, row, i, j, scale, tangent, columns, dtime)
            time = row[0]
            state_after(row, state)
            if row[1] >= 0.0:
                orthonormalised(tangent, scale, logs[done])
                clock[done] = time
                done += 1
        if i >= 0 and code == IMPACTS_REACHED:
            # The block ends within held contact, where the next vertex strikes.
            tangent, moved, _, knot = carried(
                body, law, plane, state, time, until, i, j, knots, knot, log.shape[0] - 1, NO, scale, tangent, moved,
                columns, rates,
            )  # fmt: skip
            time = until
            copy_to(state, end)
    return code, done, time, state


# --- what rounding makes of a throw ----------------------------------------------------------------------------------


@inner
def add_rounding(
    body: Body, plane: Plane, state: Array, time: float, height: float, k: int, errors: Array, columns: int
) -> int:
    """Two more columns: an error `height` [m] of the touch, and one of rounding in all the rest, signs by k."""
    errors[:, columns] = 0.0
    errors[2, columns] = height
    unit, speed = 2.220446049250313e-16, 0.0
    for m in range(3):
        speed = max(speed, abs(state[7 + m]))
    spin = spin_of(state)
    bits = k * 2654435761 + 1013904223
    for m in range(12):
        bits = (bits * 1664525 + 1013904223) % 4294967296
        sign = unit if bits >= 2147483648 else -unit
        if m < 3:
            errors[m, columns + 1] = 0.0 if m < 2 else sign * (abs(state[2]) + body.radius)
        elif m < 6:
            errors[m, columns + 1] = 2.0 * sign
        elif m < 9:
            errors[m, columns + 1] = sign * speed
        else:
            errors[m, columns + 1] = sign * spin
    return columns + 2


@inner
def error_size(law: Law, errors: Array, columns: int, scale: Array) -> float:
    """Root of the sum of squares of the errors that matter, in units of `scale`: not where the die is on the table,
    nor, where nothing rubs, how fast it drifts."""
    square = 0.0
    for k in range(2, 12):
        if (k == 6 or k == 7) and law.code == SMOOTH:
            continue
        for c in range(columns):
            square += (errors[k, c] / scale[k]) * (errors[k, c] / scale[k])
    return sqrt(square)


@inner
def approach(body: Body, plane: Plane, state: Array, time: float, vertex: int) -> float:
    """Vertical velocity [m/s] of a vertex relative to the table."""
    arm = arm_of(body.vertices[vertex], state)
    return float(state[9] + state[10] * arm[1] - state[11] * arm[0] - table_velocity(plane, time))


@inner
def struck_in_turn(
    body: Body, law: Law, plane: Plane, state: Array, time: float, first: int, other: int, out: Array
) -> None:
    """The state after two vertices have struck together, `first` first, and again as long as they still come down."""
    copy_to(out, state)
    vertex = first
    for _ in range(40):
        if approach(body, plane, out, time, vertex) < 0.0:
            strike(body, law, plane, time, vertex, out)
        vertex = other if vertex == first else first
        if approach(body, plane, out, time, vertex) >= 0.0:
            break


@inner
def touch_rounding(body: Body, plane: Plane, precision: Precision, state: Array, time: float, dt: float) -> float:
    """How far [m] from the table a touch may be found, after dt [s] of motion from `state`: as in `first_touch`."""
    turned = body.radius * (1.0 + spin_of(state) * dt)
    size = abs(state[2]) + (abs(state[9]) + plane.g * dt) * dt + turned
    if plane.amplitude != 0.0:
        size += plane.amplitude * (1.0 + abs(plane.rate * (time + dt) + plane.phase))
    return precision.root + _ROUNDING * size


@inner
def other_orders(
    body: Body,
    law: Law,
    plane: Plane,
    state: Array,
    time: float,
    hit: int,
    i: int,
    j: int,
    floor: float,
    size: float,
    scale: Array,
    errors: Array,
    columns: int,
    states: Array,
    times: Array,
    seeds: Array,
    gaps: Array,
    known: int,
) -> tuple[int, int]:
    """Which other vertices may touch before `hit` does, as far as the errors tell. Where the order makes a slight
    difference, or one below the `size` that the errors have already, it joins the errors; where it makes a larger one
    it becomes a branch. i and j are held (-1: none).

    Returns the number of columns and the number of branches, more than MOST_BRANCHES where there was no room.
    """
    arm = arm_of(body.vertices[hit], state)
    u = approach(body, plane, state, time, hit)
    reach = 2.0 / plane.g
    z_table = table_height(plane, time)
    heights, tilts, delays = 0.0, 0.0, 0.0
    for c in range(columns):
        heights += errors[2, c] * errors[2, c]
        tilts += errors[3, c] * errors[3, c] + errors[4, c] * errors[4, c]
        late = delay(errors, c, arm, u, reach)
        delays += late * late
    heights, tilts, delays = sqrt(heights), sqrt(tilts), sqrt(delays)
    fresh = columns
    first, last = np.empty(13), np.empty(13)
    room, dtime = np.empty((12, MOST_COLUMNS)), np.empty(MOST_COLUMNS)
    for k in range(body.vertices.shape[0]):
        if k == hit or is_held(k, i, j):
            continue
        other = arm_of(body.vertices[k], state)
        h = state[2] + other[2] - z_table
        v = approach(body, plane, state, time, k)
        if v >= 0.0 or h > SAFETY * (heights + body.radius * tilts - v * delays) + floor:
            continue
        square = 0.0
        for c in range(columns):
            lift = errors[2, c] + errors[3, c] * other[1] - errors[4, c] * other[0]
            lift += v * delay(errors, c, arm, u, reach)
            square += lift * lift
        limit = SAFETY * sqrt(square) + floor
        if h > limit:
            continue
        struck_in_turn(body, law, plane, state, time, hit, k, first)
        struck_in_turn(body, law, plane, state, time, k, hit, last)
        if fresh == errors.shape[1]:
            return fresh, MOST_BRANCHES + 1
        difference(last, first, 1.0, errors, fresh)
        if size_of(errors, fresh, scale) <= max(SLIGHT, size):
            fresh += 1
            continue
        if known >= MOST_BRANCHES:
            return fresh, MOST_BRANCHES + 1
        copy_columns(room, errors, columns)
        strike_tangent(body, law, plane, time, k, state, i, j, YES, scale, room, columns, dtime)
        seeds[known] = 0.0
        used = compressed(room, columns, np.empty((12, MOST_COLUMNS)))
        copy_columns(seeds[known], room, used)
        states[known] = state
        strike(body, law, plane, time, k, states[known])
        times[known], gaps[known] = time, h / limit if limit > 0.0 else 0.0
        known += 1
    return fresh, known


@inner
def grazed(
    body: Body,
    law: Law,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    hit: int,
    floor: float,
    errors: Array,
    columns: int,
) -> int:
    """Look for a vertex that passed the table within its error during a flight of dt [s] from `state` and rose again.

    `errors` are those at the end of the flight. Had it touched, then no faster than it falls through its error, and what
    that impulse does to the velocities joins as a column. Returns the number of columns.
    """
    heights, tilts = 0.0, 0.0
    for c in range(columns):
        heights += errors[2, c] * errors[2, c]
        tilts += errors[3, c] * errors[3, c] + errors[4, c] * errors[4, c]
    band = SAFETY * (sqrt(heights) + body.radius * sqrt(tilts)) + floor
    spin, terms = spin_of(state), np.empty((body.vertices.shape[0], 4))
    swing(body.vertices, state, spin, terms)
    low, k, _, _ = first_touch(terms, state[2], state[9], spin, body.radius, plane, time, band, dt)
    there = state.copy()
    advance(there, spin, dt, plane)
    if k < 0 or k == hit or approach(body, plane, there, time + dt, k) < 0.0:
        return columns
    high = dt
    for _ in range(60):
        middle = 0.5 * (low + high)
        copy_to(there, state)
        advance(there, spin, middle, plane)
        if approach(body, plane, there, time + middle, k) < 0.0:
            low = middle
        else:
            high = middle
    early = np.empty((12, columns))
    end = there.copy()
    advance(end, spin, dt - high, plane)
    flight_tangent(errors, columns, end, spin, high - dt, early)
    x, y, z = arm_of(body.vertices[k], there)
    square = 0.0
    for c in range(columns):
        lift = early[2, c] + early[3, c] * y - early[4, c] * x
        square += lift * lift
    deep = SAFETY * sqrt(square) + floor - clearance(body.vertices[k], there, table_height(plane, time + high))
    if deep <= 0.0:
        return columns
    rising = abs(spun(there, (x, y, z)) - plane.g - table_acceleration(plane, time + high))
    speed = sqrt(2.0 * max(rising, plane.g) * deep)
    s = (1.0 + law.parameters[0]) * speed / (1.0 / body.mass + (x * x + y * y) / body.inertia)
    kick = np.zeros((12, 1))
    kick[8, 0], kick[9, 0], kick[10, 0] = s / body.mass, y * s / body.inertia, -x * s / body.inertia
    flight_tangent(kick, _ONE, there, spin, dt - high, early)
    for k in range(12):
        errors[k, columns] = early[k, 0]
    return columns + 1


@inner
def follow_errors(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    start: Array,
    start_time: float,
    log: Array,
    knots: Array,
    end: Array,
    face: int,
    states: Array,
    times: Array,
    seeds: Array,
    gaps: Array,
    branch: int,
    known: int,
) -> tuple[float, float, int]:
    """Carry the errors of a logged throw to its end. `states`, `times`, `seeds` and `gaps` hold its branches, of which
    this is number `branch`; new ones are added.

    Returns the error at the end in units of `scales_of`, the margin (how many times larger the errors might have been
    at least), and the number of branches. A margin of 1 or less ends the search at once.
    """
    scale = scales_of(body, plane)
    errors, moved = np.empty((12, MOST_COLUMNS)), np.empty((12, MOST_COLUMNS))
    dtime, rates = np.empty(MOST_COLUMNS), np.empty((12, 6))
    copy_columns(errors, seeds[branch], _TWELVE)
    columns = compressed(errors, _TWELVE, moved)
    state, time, i, j, knot, margin, size = start.copy(), start_time, _NONE, _NONE, _ZERO, inf, 0.0
    while knot < knots.shape[0] and knots[knot, 0] < 0.0:
        knot += 1
    for k in range(log.shape[0]):
        row = log[k]
        errors, moved, columns, knot = carried(
            body, law, plane, state, time, row[0], i, j, knots, knot, k - 1, YES, scale, errors, moved, columns, rates
        )
        floor = touch_rounding(body, plane, precision, state, time, row[0] - time if i < 0 else 0.0)
        if columns + 3 + body.vertices.shape[0] > MOST_COLUMNS:
            columns = compressed(errors, columns, moved)
        hit = int(row[1])
        if i < 0 and row[0] > time:
            columns = grazed(body, law, plane, state, time, row[0] - time, hit, floor, errors, columns)
        copy_to(state, row[2:15])
        time = row[0]
        if hit >= 0:
            # A finer tolerance finds the touch at this instant or later: the height left is the whole error.
            missed = abs(clearance(body.vertices[hit], state, table_height(plane, time))) + floor - precision.root
            own = columns
            columns = add_rounding(body, plane, state, time, -missed, k, errors, columns)
            columns, known = other_orders(
                body,
                law,
                plane,
                state,
                time,
                hit,
                i,
                j,
                floor,
                size,
                scale,
                errors,
                columns,
                states,
                times,
                seeds,
                gaps,
                known,
            )
            if known > MOST_BRANCHES:
                return size, 0.0, known
            strike_tangent(body, law, plane, time, hit, state, i, j, YES, scale, errors, columns, dtime)
            errors[2, own] += missed  # the table, not the die, is what stands too high by this
            i, j = _NONE, _NONE
        else:
            i, j = int(row[21]), int(row[22])
            columns = add_rounding(body, plane, state, time, 0.0, k, errors, columns)
            if i >= 0 and j != -3:
                settle_tangent(body, plane, state, time, i, j, scale, errors, columns)
        for m in range(6):
            state[7 + m] = row[15 + m]
        size = error_size(law, errors, columns, scale)
        margin = min(margin, UNCERTAIN / size)
        if not margin > 1.0:
            return size, margin, known
    if face >= 0 and (i < 0 or j != -2) and plane.amplitude == 0.0:
        square, per_mass = 0.0, body.inertia / body.mass
        for c in range(columns):
            change = plane.g * errors[2, c] + end[9] * errors[8, c]
            change += per_mass * (end[10] * errors[9, c] + end[11] * errors[10, c])
            if rubs(law):
                change += end[7] * errors[6, c] + end[8] * errors[7, c] + per_mass * end[12] * errors[11, c]
            square += change * change
        spare = plane.g * body.barriers[face] - energy_per_mass(body, plane, end)
        if rubs(law):
            spare -= 0.5 * (end[7] * end[7] + end[8] * end[8] + per_mass * end[12] * end[12])
        if square > 0.0 and spare > 0.0:
            margin = min(margin, spare / (SAFETY * sqrt(square)))
    return size, margin, known


@compiled(nogil=True)
def decide(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    start: Array,
    start_time: float,
    start_error: Array,
    impact_cap: int,
) -> tuple[int, int, int, float, float]:
    """A throw to its decision, with what its errors may make of it; see `chaos`. `start_error` (12,) are those of the
    start. Returns the face row (-1: none), impacts, ending, the error at the end, and the margin (above 1: decidable).
    """
    states, times, gaps = np.empty((MOST_BRANCHES + 1, 13)), np.empty(MOST_BRANCHES + 1), np.empty(MOST_BRANCHES + 1)
    seeds = np.zeros((MOST_BRANCHES + 1, 12, 12))
    for k in range(12):
        seeds[0, k, k] = start_error[k]
    states[0], times[0] = start, start_time
    face, impacts, ending, error, margin = -1, 0, -1, 0.0, inf
    branch, known = _ZERO, _ONE
    while branch < known:
        code, count, landed, _, end, log, knots = run_throw(
            body, law, plane, precision, states[branch], times[branch], inf, NO_LIMIT, YES, impact_cap, YES
        )
        if branch == 0:
            face, impacts, ending = landed, count, code
        elif landed != face or (face < 0 and code != ending):
            return face, impacts, ending, error, min(margin, gaps[branch])
        if code == BALANCED:
            return face, impacts, ending, inf, 0.0
        size, spare, known = follow_errors(
            body, law, plane, precision, states[branch], times[branch], log, knots, end, landed,
            states, times, seeds, gaps, branch, known,
        )  # fmt: skip
        if branch == 0:
            error = size
        margin = min(margin, spare)
        if not margin > 1.0:
            return face, impacts, ending, error, margin
        branch += 1
    return face, impacts, ending, error, margin


@compiled(nogil=True)
def decide_many(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    starts: Array,
    start_error: Array,
    impact_cap: int,
    landed: NDArray[np.int64],
    figures: Array,
) -> None:
    """`decide` from every row of `starts` (n, 13). Fills `landed` (n, 3): face row or -1, impacts, ending; and
    `figures` (n, 2): error at the end, margin."""
    for k in range(starts.shape[0]):
        face, impacts, ending, error, margin = decide(
            body, law, plane, precision, starts[k], 0.0, start_error, impact_cap
        )
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, ending
        figures[k, 0], figures[k, 1] = error, margin
