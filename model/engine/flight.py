"""Free flight of a die with one moment of inertia, in closed form, and its first touch.

The centre moves on a parabola and the angular velocity ω stays constant, so that vertex i has the height

    h(t) = z + v t - g t²/2 + A cos ωt + B sin ωt + C

above the height zero; the height of a table that moves is subtracted. `throw.touch` explains why stepping by the root of a
bounding parabola misses no touch.
"""

from __future__ import annotations

from math import cos, inf, sin, sqrt
from typing import NamedTuple

from ..compiled import compiled, inner
from .types import ROUNDING_BOUND, STANDING_HEIGHT, Array, Body, Plane

LEAST_BOUND = 1e-3
"""Bound of an upward acceleration, in units of g, where it would be zero or less: kept above 0 for the division."""

BELOW_TABLE = -1e-12
"""Height in units of the circumradius from which a vertex counts as below the table: more than rounding."""

LARGEST = 1e13
"""Velocities and height, in SI units, beyond which a state is out of range: those of a release are smaller (`throw.body`)."""


# --- The table ---


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


# --- A state ---


@inner
def is_in_range(state: Array) -> bool:
    """Whether the velocities of a state (13,), and its height, are ones from which a touch can be found: not NaN, and below
    LARGEST. The search takes steps that shrink with the velocity, and would not end."""
    size = 0.0
    for k in range(7, 13):
        size += abs(state[k])
    return bool(size + abs(state[2]) < LARGEST)


@compiled
def spin_rate(state: Array) -> float:
    """|ω| [rad/s]. The components are scaled, because the square of 1e-200 underflows."""
    largest = max(abs(state[10]), abs(state[11]), abs(state[12]))
    if largest == 0.0:
        return 0.0
    x, y, z = state[10] / largest, state[11] / largest, state[12] / largest
    return float(largest * sqrt(x * x + y * y + z * z))


@inner
def spin_axis(state: Array, spin: float) -> tuple[float, float, float]:
    """Unit axis of the spin; an arbitrary one where there is none."""
    if spin == 0.0:
        return 0.0, 0.0, 1.0
    return state[10] / spin, state[11] / spin, state[12] / spin


@compiled
def lever_arm(vertex: Array, state: Array) -> tuple[float, float, float]:
    """The arm r [m] of a vertex (3,) of the body: from the centre of mass, in table axes."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    bx, by, bz = vertex[0], vertex[1], vertex[2]
    # v + 2 w (q × v) + 2 q × (q × v)
    tx, ty, tz = 2.0 * (y * bz - z * by), 2.0 * (z * bx - x * bz), 2.0 * (x * by - y * bx)
    return bx + w * tx + y * tz - z * ty, by + w * ty + z * tx - x * tz, bz + w * tz + x * ty - y * tx


@compiled
def height_terms(vertices: Array, state: Array, spin: float, terms: Array) -> None:
    """Fill `terms` (n, 4) with A, B, C and √(A² + B²) [m] of each vertex; `spin` is |ω| [rad/s]."""
    ux, uy, uz = spin_axis(state, spin)
    for i in range(vertices.shape[0]):
        x, y, z = lever_arm(vertices[i], state)
        along = (x * ux + y * uy + z * uz) * uz
        a, b = z - along, ux * y - uy * x
        terms[i, 0], terms[i, 1], terms[i, 2], terms[i, 3] = a, b, along, sqrt(a * a + b * b)


class FallingDie(NamedTuple):
    """What the heights of all vertices in a flight have in common, at its start."""

    height: float
    """z [m] of the centre."""
    velocity: float
    """v [m/s] of the centre."""
    spin: float
    """ω [rad/s]."""
    radius: float
    """[m] of the vertex farthest from the centre."""


@compiled
def first_touch(
    terms: Array, die: FallingDie, plane: Plane, clock: float, tolerance: float, limit: float
) -> tuple[float, int, float, float, int]:
    """The first instant at which a vertex of `terms` meets the table from above, no later than `limit` [s].

    `clock` [s] is the time at the start of the flight, for a table that moves; a vertex no higher than `tolerance` [m]
    touches. Returns the time [s] from the start of the flight, the row of the vertex (-1: the limit came first), its
    vertical velocity (0 where it is only rounding) and acceleration there, relative to the table, and how many come down within
    STANDING_HEIGHT. Of vertices that touch together the fastest is returned, the first of equals.
    """
    height, velocity, spin, radius = die
    t = 0.0
    g = plane.g
    moving = plane.amplitude != 0.0
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    near = tolerance + STANDING_HEIGHT * radius
    z_table, v_table, a_table, j_table = 0.0, 0.0, 0.0, 0.0
    v_table_tol, a_table_tol = 0.0, 0.0
    while True:
        c, s = cos(spin * t), sin(spin * t)
        centre, centre_velocity = height + (velocity - 0.5 * g * t) * t, velocity - g * t
        turned = 1.0 + spin * t  # the phase ωt is rounded as well
        h_tol = tolerance + ROUNDING_BOUND * (abs(height) + (abs(velocity) + g * t) * t + radius * turned)
        if moving:
            phase = plane.rate * (clock + t) + plane.phase
            z_table, v_table = plane.amplitude * sin(phase), plane.amplitude * plane.rate * cos(phase)
            a_table, j_table = -plane.rate * plane.rate * z_table, -plane.rate * plane.rate * v_table
            rounded = ROUNDING_BOUND * plane.amplitude * (1.0 + abs(phase))
            h_tol += rounded
            v_table_tol, a_table_tol = rounded * plane.rate, rounded * plane.rate * plane.rate
        v_tol = v_table_tol + ROUNDING_BOUND * (abs(velocity) + g * t + spin * radius * turned)
        a_tol = a_table_tol + ROUNDING_BOUND * (g + spin * spin * radius * turned)
        hit, hit_v, hit_a, step, together = -1, 0.0, 0.0, inf, 0
        for i in range(terms.shape[0]):
            a, b, amplitude = terms[i, 0], terms[i, 1], terms[i, 3]
            h = centre + a * c + b * s + terms[i, 2] - z_table
            v = centre_velocity + spin * (b * c - a * s) - v_table
            bound = g + spin * spin * amplitude + peak_table_acceleration
            if h <= near and v < 0.0:
                together += 1
            if h > h_tol:
                root = sqrt(v * v + 2.0 * bound * h)
                # Two forms of one root, each free of cancellation for its sign of v.
                ahead = (v + root) / bound if v > 0.0 else 2.0 * h / (root - v)
                if moving and h + z_table > plane.amplitude:
                    # No touch before the table's highest position. This step is longer far up, where the table shakes hard.
                    bound, v, h = bound - peak_table_acceleration, v + v_table, h + z_table - plane.amplitude
                    root = sqrt(v * v + 2.0 * bound * h)
                    ahead = max(ahead, (v + root) / bound if v > 0.0 else 2.0 * h / (root - v))
            elif v > v_tol:
                ahead = 2.0 * v / bound
            else:
                acceleration = -g - spin * spin * (a * c + b * s) - a_table
                jerk = spin * spin * spin * (a * s - b * c) - j_table
                third = spin * spin * spin * amplitude + peak_table_acceleration * plane.rate
                fourth = spin * spin * spin * spin * amplitude + peak_table_acceleration * plane.rate * plane.rate
                if v >= -v_tol and acceleration >= -a_tol and jerk > ROUNDING_BOUND * third:
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
            return t, hit, hit_v, hit_a, together
        free = centre - radius - plane.amplitude
        if free > 0.0:
            # No vertex reaches farther down than the circumscribed sphere: fall with it.
            step = max(step, (centre_velocity + sqrt(centre_velocity * centre_velocity + 2.0 * g * free)) / g)
        if t + step > limit:
            return limit, -1, 0.0, 0.0, 0
        t += step


@inner
def touch_of_vertex(terms: Array, die: FallingDie, plane: Plane, clock: float) -> tuple[float, bool, float, float]:
    """The next touch of the one vertex in `terms` (1, 4), whatever others do: time, found, velocity, acceleration.

    A vertex that is already below the table and sinking touched a little before the flight began, and its time is negative.
    So the time stays a smooth function of the state where two touches change their order. It may lie as far back as the die
    takes to fall its own circumradius. A vertex that never rises above the table again has no touch.
    """
    height, velocity, spin, radius = die
    below = BELOW_TABLE * radius
    h = height + terms[0, 0] + terms[0, 2] - table_height(plane, clock)
    v = velocity + spin * terms[0, 1] - table_velocity(plane, clock)
    if h < below and v < 0.0:
        return _touch_before(terms, die, plane, clock)
    t, _, v, acceleration, _ = first_touch(terms, die, plane, clock, 0.0, inf)
    return t, _height(terms, die, plane, clock, t) >= below, v, acceleration


@inner
def _height(terms: Array, die: FallingDie, plane: Plane, clock: float, t: float) -> float:
    """Height [m] of the one vertex in `terms` (1, 4) above the table."""
    height, velocity, spin, _ = die
    swung = terms[0, 0] * cos(spin * t) + terms[0, 1] * sin(spin * t) + terms[0, 2]
    return float(height + (velocity - 0.5 * plane.g * t) * t + swung - table_height(plane, clock + t))


@inner
def _touch_before(terms: Array, die: FallingDie, plane: Plane, clock: float) -> tuple[float, bool, float, float]:
    """The instant before the flight at which a vertex that is below the table crossed it; as `touch_of_vertex`."""
    height, velocity, spin, radius = die
    t, g = 0.0, plane.g
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    bound = max(spin * spin * terms[0, 3] + peak_table_acceleration - g, LEAST_BOUND * g)  # h'' is no larger
    while t > -sqrt(2.0 * radius / g):
        swung, swept = cos(spin * t), sin(spin * t)
        h = _height(terms, die, plane, clock, t)
        v = velocity - g * t + spin * (terms[0, 1] * swung - terms[0, 0] * swept) - table_velocity(plane, clock + t)
        size = abs(height) + abs(velocity * t) + radius * (1.0 - spin * t)
        if plane.amplitude != 0.0:
            size += plane.amplitude * (1.0 + abs(plane.rate * (clock + t) + plane.phase))
        if h >= -ROUNDING_BOUND * size:
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
    ux, uy, uz = spin_axis(state, spin)
    c, s = cos(0.5 * spin * dt), sin(0.5 * spin * dt)
    x, y, z = s * ux, s * uy, s * uz
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    w1 = c * qw - x * qx - y * qy - z * qz
    x1 = c * qx + x * qw + y * qz - z * qy
    y1 = c * qy - x * qz + y * qw + z * qx
    z1 = c * qz + x * qy - y * qx + z * qw
    norm = sqrt(w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1)
    state[3], state[4], state[5], state[6] = w1 / norm, x1 / norm, y1 / norm, z1 / norm


@compiled
def clearance(vertex: Array, state: Array, z_table: float) -> float:
    """Height [m] of a vertex above the table."""
    return float(state[2] + lever_arm(vertex, state)[2] - z_table)


@inner
def vertex_velocity(body: Body, plane: Plane, state: Array, time: float, k: int) -> float:
    """Vertical velocity [m/s] of vertex k relative to the table."""
    x, y, _ = lever_arm(body.vertices[k], state)
    return float(state[9] + state[10] * y - state[11] * x - table_velocity(plane, time))


@inner
def centripetal_acceleration(state: Array, arm: tuple[float, float, float]) -> float:
    """The vertical part [m/s²] of ω × (ω × r) of a vertex at `arm`."""
    along = state[10] * arm[0] + state[11] * arm[1] + state[12] * arm[2]
    square = state[10] * state[10] + state[11] * state[11] + state[12] * state[12]
    return state[12] * along - arm[2] * square
