"""model.engine.held_contact."""

from __future__ import annotations

from math import sqrt

from ..compiled import compiled, inner
from .flight import lever_arm, table_acceleration, table_height, table_velocity
from .log import energy_per_mass, lowest_face_row
from .types import (
    FORCE_I,
    NONE,
    ROUNDING_BOUND,
    RUNGE_KUTTA_A,
    RUNGE_KUTTA_B,
    RUNGE_KUTTA_C,
    STANDING_HEIGHT,
    Array,
    Body,
    Indices,
    Plane,
)


@compiled
def clearance(vertex: Array, state: Array, z_table: float) -> float:
    """Height [m] of a vertex above the table."""
    return float(state[2] + lever_arm(vertex, state)[2] - z_table)


@inner
def centripetal_acceleration(state: Array, arm: tuple[float, float, float]) -> float:
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
    a = lever_arm(body.vertices[i], state)
    free_i = weight - centripetal_acceleration(state, a)
    a_ii = 1.0 + (a[0] * a[0] + a[1] * a[1]) / k
    if j < 0:
        n = free_i / a_ii
        return n, 0.0, n * a[1] / k, -n * a[0] / k
    b = lever_arm(body.vertices[j], state)
    free_j = weight - centripetal_acceleration(state, b)
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
            weight = dt * RUNGE_KUTTA_A[s, r]
            if weight != 0.0:
                after[3] += weight * rates[r, 0]
                after[4] += weight * rates[r, 1]
                after[5] += weight * rates[r, 2]
                after[6] += weight * rates[r, 3]
                after[10] += weight * rates[r, 4]
                after[11] += weight * rates[r, 5]
        pull = plane.g + table_acceleration(plane, time + RUNGE_KUTTA_C[s] * dt)
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
            after[3 + m] += dt * RUNGE_KUTTA_B[s] * rates[s, m]
    for m in range(2):
        after[10 + m] = state[10 + m]
        for s in range(12):
            after[10 + m] += dt * RUNGE_KUTTA_B[s] * rates[s, 4 + m]
    after[0] = state[0] + (state[7] + 0.5 * plane.gx * dt) * dt
    after[1] = state[1] + (state[8] + 0.5 * plane.gy * dt) * dt
    after[7], after[8] = state[7] + plane.gx * dt, state[8] + plane.gy * dt
    project_on_contact(body, plane, after, time + dt, i, j)


@inner
def project_on_contact(body: Body, plane: Plane, state: Array, time: float, i: int, j: int) -> None:
    """Put the state exactly on its contact, in place: the quaternion a unit one, the held vertices on the table and at
    rest relative to it, an edge level. All of it only takes rounding away."""
    norm = sqrt(state[3] * state[3] + state[4] * state[4] + state[5] * state[5] + state[6] * state[6])
    for m in range(3, 7):
        state[m] /= norm
    a = lever_arm(body.vertices[i], state)
    if j >= 0:
        b = lever_arm(body.vertices[j], state)
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
        a = lever_arm(body.vertices[i], state)
    state[2] = table_height(plane, time) - a[2]
    state[9] = table_velocity(plane, time) - state[10] * a[1] + state[11] * a[0]


@inner
def lay_on_face(body: Body, plane: Plane, state: Array, time: float, i: int) -> None:
    """Lay the die exactly on its lowest face, to which vertex i belongs, at rest but for its turning about the
    vertical, in place. It only takes away what is left of a tilt within which all corners count as touching."""
    face = lowest_face_row(body.normals, state)
    nx, ny, _ = lever_arm(body.normals[face], state)
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
    state[2] = table_height(plane, time) - lever_arm(body.vertices[i], state)[2]
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
        arm = lever_arm(body.vertices[i], state)
        leaving = state[9] + state[10] * arm[1] - state[11] * arm[0] - v_table
        if i == also or (state[2] + arm[2] - z_table <= near and leaving <= slow):
            touching[n] = i
            n += 1
    return n


@inner
def solve_normal_forces(
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
            x, y, _ = lever_arm(body.vertices[touching[m]], state)
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
def simultaneous_inelastic_impact(
    body: Body, plane: Plane, state: Array, time: float, touching: Indices, n: int, room: Array
) -> None:
    """Stop what slow approach the touching vertices still have, in place, as an impact with χ = 0 of all at once."""
    motion, drive, forces = room[0], room[1], room[2]
    motion[0], motion[1], motion[2] = state[9] - table_velocity(plane, time), state[10], state[11]
    for m in range(n):
        drive[m] = 0.0
    solve_normal_forces(body, state, touching, n, motion, drive, forces, 1000)
    state[9], state[10], state[11] = motion[0] + table_velocity(plane, time), motion[1], motion[2]


@inner
def remove_normal_velocity(body: Body, plane: Plane, state: Array, time: float, i: int, j: int) -> None:
    """Take from the held vertices the last of their vertical velocity, in place, along the impulses that would do it:
    a projection in the metric of the kinetic energy, which therefore cannot rise."""
    k = body.inertia / body.mass
    v_table = table_velocity(plane, time)
    a = lever_arm(body.vertices[i], state)
    u_i = state[9] + state[10] * a[1] - state[11] * a[0] - v_table
    a_ii = 1.0 + (a[0] * a[0] + a[1] * a[1]) / k
    if j < 0:
        p = -u_i / a_ii
        state[9] += p
        state[10] += p * a[1] / k
        state[11] -= p * a[0] / k
        return
    b = lever_arm(body.vertices[j], state)
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
        force, _, _, _ = contact_forces(body, state, touching[0], NONE, pull)
        return (touching[0], -1) if force > 0.0 else (-1, -1)
    motion, drive, forces = room[0], room[1], room[2]
    if n >= 3:
        motion[0], motion[1], motion[2] = -pull, 0.0, 0.0
        for m in range(n):
            drive[m] = centripetal_acceleration(state, lever_arm(body.vertices[touching[m]], state))
        solve_normal_forces(body, state, touching, n, motion, drive, forces, 1000)
        resting, first, second = 0, -1, -1
        for m in range(n):
            x, y, _ = lever_arm(body.vertices[touching[m]], state)
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
        force, _, wx, wy = contact_forces(body, state, held, NONE, pull)
        x, y, _ = lever_arm(body.vertices[other], state)
        rises = force - pull + wx * y - wy * x + centripetal_acceleration(state, lever_arm(body.vertices[other], state))
        if force > 0.0 and rises >= 0.0:
            return held, -1
    return -1, -1


@inner
def event_instant(
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
    """The instant [s] within dt at which an event function falls through zero, seen from `state`; see `event_function`.

    A force is followed to its first value not above zero, a height to its last that is. `after` is overwritten.
    """
    low, high = 0.0, dt
    f_low = event_function(body, plane, state, time, i, j, event)
    held_step(body, plane, state, time, dt, i, j, rates, after)
    f_high = event_function(body, plane, after, time + dt, i, j, event)
    if event >= 0 and f_low <= STANDING_HEIGHT * body.radius:
        # A vertex that has just been let go rises first: step back to where it is up.
        t = 0.5 * dt
        while t > 1e-12 * dt:
            held_step(body, plane, state, time, t, i, j, rates, after)
            f_low = event_function(body, plane, after, time + t, i, j, event)
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
        f = event_function(body, plane, after, time + t, i, j, event)
        if f > 0.0:
            low, f_low = t, f
            if side == 1:
                f_high *= 0.5
            side = 1
            if event >= 0 and f <= ROUNDING_BOUND * body.radius:
                break
        else:
            high, f_high = t, f
            if side == -1:
                f_low *= 0.5
            side = -1
            if f >= -ROUNDING_BOUND * (plane.g if event < 0 else body.radius):
                low = t if event >= 0 else low
                break
    return low if event >= 0 else high


@inner
def event_function(body: Body, plane: Plane, state: Array, time: float, i: int, j: int, event: int) -> float:
    """The height [m] of vertex `event`, or for FORCE_I and FORCE_J the force per mass [m/s²] on vertex i or j."""
    if event >= 0:
        return clearance(body.vertices[event], state, table_height(plane, time))
    n_i, n_j, _, _ = contact_forces(body, state, i, j, plane.g + table_acceleration(plane, time))
    return n_i if event == FORCE_I else n_j


@inner
def spins_forever(body: Body, plane: Plane, state: Array, i: int) -> bool:
    """Whether the die is a top on vertex i that can never touch the table with another one; see `simulate`."""
    x, y, z = lever_arm(body.vertices[i], state)
    size = sqrt(x * x + y * y + z * z)
    upright, limit = -z / size, body.safe_tilt_cosines[i]
    about_z, about_axis = state[12], -(state[10] * x + state[11] * y + state[12] * z) / size
    per_mass = body.inertia / body.mass
    across = about_axis - about_z * limit
    needed = plane.g * size * limit + 0.5 * per_mass * across * across / (1.0 - limit * limit)
    # A die laid on an edge has both sides equal, and rounding must not prove it a top.
    return bool(upright > limit + 1e-12 and needed > energy_per_mass(body, plane, state) * (1.0 + 1e-12))
