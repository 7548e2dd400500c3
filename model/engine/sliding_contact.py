"""Held contact with friction: vertices that stick or slide, each within its own Coulomb cone.

The motion is followed by steps of half the old and half the new velocities, the new ones from `friction_step` (Moreau; Jean,
Comput. Methods Appl. Mech. Eng. 177, 235, 1999; Stewart & Trinkle, Int. J. Numer. Meth. Eng. 39, 2673, 1996). Sticking is
exact, and the impulses create no energy. The order is low, so that a step is FRICTION_STEP_PART of the turn that
`Precision.step_turn` allows without friction. The drag of the air acts within a step as gravity does, at the velocity at its
begin. Equations and accuracy: `throw.held_contact`.
"""

from __future__ import annotations

from math import hypot, inf, nan, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ..compiled import compiled, inner
from .flight import clearance, lever_arm, spin_rate, table_height, table_velocity
from .friction_impulse import slide_direction
from .inertia import TURN_SIZE, EvenInertia, TensorInertia, apply_impulse, carry_freely, inertia_of, matrix_at
from .log import copy_to, with_knot
from .rest import decided_with_friction
from .types import (
    BALANCED,
    NOT_ENDED,
    RESTED,
    ROUNDING_BOUND,
    TIME_REACHED,
    Array,
    Knots,
    Matrix6,
    Plane,
    PlaneInAir,
    RoughLaw,
    Setup,
    has_friction,
)

MAX_SWEEPS = 1000
"""Of the Gauss-Seidel method in `friction_step`. Four corners of a sliding die need some 30, of a rocking one 100."""

UNDAMPED_SWEEPS = 100
"""Sweeps after which each impulse goes only DAMPING of its way, because impulses that answer each other in a circle do not
converge."""
DAMPING = 0.7

LIGHTLY_DAMPED_SWEEPS = 500
"""Sweeps after which each impulse goes only STRONG_DAMPING of its way."""
STRONG_DAMPING = 0.4

VELOCITY_ROUNDING = 4.4e-16
"""Normal velocity after an impulse, as a part of those that cancel in it, at which the search for the impulse ends."""

MAX_SECANTS = 100
"""Steps of that search."""

JAMMING_MARGIN = 2.0
"""Least ratio of the normal compliance to what friction takes from it at which the sliding direction is looked for alone."""

MAX_DIRECTION_STEPS = 20
"""Steps of the search for that direction; Newton's method takes few."""

LARGEST_TURN = 0.5
"""[rad] of one of them."""

STICKING_SPEED = 1e-9
"""Speed below which a corner has stopped, as a part of the velocities in the step: above the tolerance of the sweeps."""

COLLINEAR = 1e-6
"""Sine of the angle between two edges below which three corners count as lying in a line."""

FRICTION_STANDING_HEIGHT = 1e-6
"""As STANDING_HEIGHT, for contact with friction, whose steps leave errors of a low order."""

FRICTION_STEP_PART = 0.1
"""Part of `Precision.step_turn` that a step with friction takes."""

MAX_TOUCH_STEPS = 90
"""Of the search for the instant within a step at which another vertex touches."""

FALSE_POSITIONS = 12
"""Steps of it after which every third halves the bracket."""

TOUCH_TOLERANCE = 1e-12
"""Width of the bracket of that instant, as a part of the step, at which the search ends."""


@compiled
def inelastic_impulse(matrix: Matrix6, mu: float, cx: float, cy: float, cz: float) -> tuple[float, float, float]:
    """The impulse S of an inelastic contact within Coulomb's cone; c is the contact velocity without it, c + M S with it.

    The contact lifts off (S = 0), sticks (c + M S = 0), or slides along ŝ with S = p (-μ ŝ, 1). Newton's method finds the
    direction; where it fails, secants find p, with a bracket. A given p leaves the slip the least kinetic energy where
    (μ p T + σ) ŝ = c_t + b p, and the normal velocity w has w(0) < 0 and rises for large p.
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
    slides, sx, sy, p = _sliding_impulse(matrix, mu, cx, cy, cz)
    if slides:
        return sx, sy, p
    low, w_low, high = 0.0, cz, -2.0 * cz / zz
    sx, sy, w_high = _held_slide(matrix, mu, cx, cy, cz, high)
    while w_high < 0.0:
        low, w_low, high = high, w_high, 2.0 * high
        sx, sy, w_high = _held_slide(matrix, mu, cx, cy, cz, high)
    stayed = 0
    for _ in range(MAX_SECANTS):
        p = (low * w_high - high * w_low) / (w_high - w_low)
        if not low < p < high:
            break
        sx, sy, w = _held_slide(matrix, mu, cx, cy, cz, p)
        if abs(w) <= VELOCITY_ROUNDING * (zz * p - cz):
            return sx, sy, p
        # Illinois: an end that stays a second time weighs half, so that neither end stays for good.
        if w < 0.0:
            low, w_low, stayed = p, w, max(stayed, 0) + 1
            w_high *= 0.5 if stayed > 1 else 1.0
        else:
            high, w_high, stayed = p, w, min(stayed, 0) - 1
            w_low *= 0.5 if stayed < -1 else 1.0
    sx, sy, _ = _held_slide(matrix, mu, cx, cy, cz, high)
    return sx, sy, high


@inner
def _sliding_impulse(matrix: Matrix6, mu: float, cx: float, cy: float, cz: float) -> tuple[bool, float, float, float]:
    """Whether Newton's method finds the direction in which the contact slides, and the impulse.

    With p = -c_z/(a - μ b·ŝ) the normal velocity vanishes. The slip v = c_t + p (b - μ T ŝ) that is left must lie along ŝ: the
    angle of ŝ is a root of t̂·v, with t̂ ⊥ ŝ. It counts where ŝ·v ≥ 0, which says that friction opposes the slip.
    """
    xx, xy, xz, yy, yz, zz = matrix
    # Where friction may change the sign of a - μ b·ŝ, the contact may jam, and there may be several directions.
    if zz <= JAMMING_MARGIN * mu * hypot(xz, yz):
        return False, 0.0, 0.0, 0.0
    ux, uy = cx - xz * cz / zz, cy - yz * cz / zz
    size = hypot(ux, uy)
    if size == 0.0:
        return False, 0.0, 0.0, 0.0
    ux, uy = ux / size, uy / size
    for _ in range(MAX_DIRECTION_STEPS):
        tx, ty = -uy, ux
        stiffness = zz - mu * (xz * ux + yz * uy)
        p = -cz / stiffness
        ax, ay = xz - mu * (xx * ux + xy * uy), yz - mu * (xy * ux + yy * uy)
        vx, vy = cx + p * ax, cy + p * ay
        along, across = ux * vx + uy * vy, tx * vx + ty * vy
        if abs(across) <= VELOCITY_ROUNDING * (abs(cx) + abs(cy) + p * (abs(ax) + abs(ay))):
            return along >= 0.0, -mu * p * ux, -mu * p * uy, p
        dp = p * mu * (xz * tx + yz * ty) / stiffness
        slope = dp * (tx * ax + ty * ay) - mu * p * (xx * tx * tx + 2.0 * xy * tx * ty + yy * ty * ty) - along
        if slope >= 0.0:
            break
        turn = min(max(-across / slope, -LARGEST_TURN), LARGEST_TURN)
        ux, uy = ux + turn * tx, uy + turn * ty
        size = hypot(ux, uy)
        ux, uy = ux / size, uy / size
    return False, 0.0, 0.0, 0.0


@inner
def _held_slide(matrix: Matrix6, mu: float, cx: float, cy: float, cz: float, p: float) -> tuple[float, float, float]:
    """Tangential impulse within the disk μp that leaves the slip the least energy, and the normal velocity with it."""
    xx, xy, xz, yy, yz, zz = matrix
    dx, dy, radius = cx + xz * p, cy + yz * p, mu * p
    det = xx * yy - xy * xy
    sx, sy = (xy * dy - yy * dx) / det, (xy * dx - xx * dy) / det
    if hypot(sx, sy) > radius:
        ux, uy, _ = slide_direction(xx, xy, yy, radius, dx, dy)
        sx, sy = -radius * ux, -radius * uy
    return sx, sy, cz + zz * p + xz * sx + yz * sy


class FrictionalCorners(NamedTuple):
    """The corners that touch the table in one step of contact with friction."""

    arms: Array
    """(n, 3) [m] from the centre of mass."""
    impulses: Array
    """(n, 3) [N s] of the table on each."""
    mu: float
    table_velocity: float
    """[m/s], vertical."""


class SlidingBody(NamedTuple):
    """A die with corners that stick or slide on the table."""

    body: Any
    """Body or AsymmetricBody."""
    mu: float
    plane: Any
    """Plane or PlaneInAir."""
    active: NDArray[np.bool_]
    """(vertices,) which of them are in contact."""


class SlidingRoom(NamedTuple):
    """Room for the corners in one step; n of its rows are used."""

    arms: Array
    """(vertices, 3) [m]."""
    guess: Array
    """(vertices, 3) [N] first guess of the forces."""
    impulses: Array
    """(vertices, 3) [N s] that were found."""
    stages: Array
    """(14, TURN_SIZE) of the free rotation."""


@inner
def room_to_slide(vertices: int) -> SlidingRoom:
    """Room for a step of a die with so many vertices."""
    corners = np.zeros((3, vertices, 3))
    return SlidingRoom(corners[0], corners[1], corners[2], np.empty((14, TURN_SIZE)))


@compiled
def friction_step(
    velocity: Array,
    corners: FrictionalCorners,
    inertia: EvenInertia | TensorInertia,
    push: Array,
    sweep_tolerance: float = 1e-12,
) -> int:
    """One time step of held contact: changes `velocity` (6,) [m/s, rad/s] of centre and spin in place.

    Gravity and drag act first, as the change of velocity `push` (3,) [m/s]. Then the corners get the impulses with
    which each obeys `inelastic_impulse` in the presence of the others, for the velocities at the end of the step. So energy
    is lost, never gained, and a corner that sticks has no velocity at all. The impulses of `corners` are a first guess, zero or
    those of the step before, and the result afterwards. No corner is slower than the table at the end, but for rounding.

    Vertices are solved in turn (Gauss-Seidel) until no contact velocity changes by more than `sweep_tolerance`, a part of
    push and velocities. Returns the number of sweeps, MAX_SWEEPS where they were cut off.
    """
    arms, impulses, mu, table_velocity = corners
    n = arms.shape[0]
    for k in range(3):
        velocity[k] += push[k]
    size = abs(table_velocity) + hypot(hypot(push[0], push[1]), push[2])
    for i in range(n):
        cx, cy, cz = _velocity_at(velocity, arms[i])
        size = max(size, abs(cx) + abs(cy) + abs(cz))
    for i in range(n):
        apply_impulse(velocity, arms[i], inertia, impulses[i, 0], impulses[i, 1], impulses[i, 2])
    sweeps, changed = 0, inf
    while changed > sweep_tolerance * size and sweeps < MAX_SWEEPS:
        changed = 0.0
        part = 1.0 if sweeps < UNDAMPED_SWEEPS else (DAMPING if sweeps < LIGHTLY_DAMPED_SWEEPS else STRONG_DAMPING)
        for i in range(n):
            matrix = matrix_at(inertia, arms[i, 0], arms[i, 1], arms[i, 2])
            xx, xy, xz, yy, yz, zz = matrix
            x, y, z = impulses[i]
            cx, cy, cz = _velocity_at(velocity, arms[i])
            cx, cy = cx - xx * x - xy * y - xz * z, cy - xy * x - yy * y - yz * z
            cz = cz - table_velocity - xz * x - yz * y - zz * z
            sx, sy, sz = inelastic_impulse(matrix, mu, cx, cy, cz)
            sx, sy, sz = x + part * (sx - x), y + part * (sy - y), z + part * (sz - z)
            impulses[i, 0], impulses[i, 1], impulses[i, 2] = sx, sy, sz
            apply_impulse(velocity, arms[i], inertia, sx - x, sy - y, sz - z)
            changed = max(changed, max(xx, yy, zz) * max(abs(sx - x), abs(sy - y), abs(sz - z)))
        sweeps += 1
    if _sticks(velocity, corners, STICKING_SPEED * size):
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
def _sticks(velocity: Array, corners: FrictionalCorners, slow: float) -> bool:
    """Whether three pressing corners that do not lie in a line are slower than `slow`: then the die moves as the table does."""
    arms, impulses, _, table_velocity = corners
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
            if abs(ax * by - ay * bx) > COLLINEAR * hypot(ax, ay) * hypot(bx, by):
                return True
    return False


@inner
def push_of_step_in_air(plane: PlaneInAir, state: Array, dt: float) -> tuple[float, float, float]:
    """`push_of_step` against drag, by the closed form of drag alone, |v| = v₀/(1 + k v₀ t), which turns no die back."""
    vx, vy, vz = state[7], state[8], state[9]
    slowed = plane.drag * sqrt(vx * vx + vy * vy + vz * vz) * dt
    part = slowed / (1.0 + slowed)
    return plane.gx * dt - part * vx, plane.gy * dt - part * vy, -plane.g * dt - part * vz


def push_of_step(plane: Plane | PlaneInAir, state: Array, dt: float) -> tuple[float, float, float]:
    """Change of the velocity [m/s] in a step of dt [s] by all but the table: gravity, and the drag."""
    if isinstance(plane, PlaneInAir):
        push: tuple[float, float, float] = push_of_step_in_air(plane, state, dt)
        return push
    return plane.gx * dt, plane.gy * dt, -plane.g * dt


@overload(push_of_step, strict=False)
def _push_of_step_of(plane: Any, state: Any, dt: Any) -> Any:
    """The branch of `push_of_step` that the type of the plane asks for, chosen when it is compiled."""
    if plane.instance_class is PlaneInAir:
        return push_of_step_in_air.py_func
    return lambda plane, state, dt: (plane.gx * dt, plane.gy * dt, -plane.g * dt)


@inner
def least_weight_in_air(plane: PlaneInAir) -> float:
    """`least_weight` against drag: the minimum over φ of g - A ω² sin φ - k A² ω² cos² φ, where the table sinks."""
    swing = plane.drag * plane.amplitude
    if 2.0 * swing <= 1.0:
        return plane.g - plane.amplitude * plane.rate * plane.rate
    return plane.g - plane.amplitude * plane.rate * plane.rate * (swing + 0.25 / swing)


def least_weight(plane: Plane | PlaneInAir) -> float:
    """The least that presses a die that rides on the table onto it, per mass [m/s²]."""
    if isinstance(plane, PlaneInAir):
        return float(least_weight_in_air(plane))
    return plane.g - plane.amplitude * plane.rate * plane.rate


@overload(least_weight, strict=False)
def _least_weight_of(plane: Any) -> Any:
    """The branch of `least_weight` that the type of the plane asks for, chosen when it is compiled."""
    if plane.instance_class is PlaneInAir:
        return least_weight_in_air.py_func
    return lambda plane: plane.g - plane.amplitude * plane.rate * plane.rate


@inner
def sliding_step(
    sliding: SlidingBody, state: Array, time: float, dt: float, room: SlidingRoom, after: Array, sweep_tolerance: float
) -> int:
    """Carry a state over dt [s] of contact with friction into `after`; returns how many of the active vertices press.

    The die goes half the way with the old velocities, gets the impulses there, and goes the other half with the new ones.
    """
    body, mu, plane, active = sliding
    arms, guess, impulses, stages = room
    copy_to(after, state)
    carry_freely(body, after, 0.5 * dt, stages)
    n = 0
    for k in range(active.shape[0]):
        if active[k]:
            x, y, z = lever_arm(body.vertices[k], after)
            arms[n, 0], arms[n, 1], arms[n, 2] = x, y, z - body.corner_radius
            n += 1
    velocity, push = np.empty(6), np.empty(3)
    for k in range(6):
        velocity[k] = after[7 + k]
    push[0], push[1], push[2] = push_of_step(plane, state, dt)
    for k in range(n):
        for m in range(3):
            impulses[k, m] = guess[k, m] * dt
    corners = FrictionalCorners(arms[:n], impulses[:n], mu, table_velocity(plane, time + dt))
    friction_step(velocity, corners, inertia_of(body, after), push, sweep_tolerance)
    for k in range(6):
        after[7 + k] = velocity[k]
    carry_freely(body, after, 0.5 * dt, stages)
    pressing = 0
    lowest, z_table = inf, table_height(plane, time + dt)
    for k in range(n):
        pressing += impulses[k, 2] > 0.0
    for k in range(active.shape[0]):
        if active[k]:
            lowest = min(lowest, clearance(body.vertices[k], after, z_table))
    if pressing > 0:
        # The arms turn within the step, which lifts the vertices off the table in third order of dt.
        after[2] -= lowest
    return pressing


@inner
def rides_forever(sliding: SlidingBody, state: Array, time: float, dt: float, sweep_tolerance: float) -> bool:
    """Whether a die that moves as its table does will always do so.

    The table presses it least where it accelerates downwards most. If the die neither slips nor tips there within a step of
    dt [s], it does so nowhere.
    """
    body, mu, plane, active = sliding
    if state[9] != table_velocity(plane, time) or state[7:9].any() or state[10:13].any():
        return False
    least = least_weight(plane)
    if least <= 0.0:
        return False
    resting, after, room = state.copy(), np.empty(13), room_to_slide(body.vertices.shape[0])
    resting[9] = 0.0
    at_rest = SlidingBody(body, mu, Plane(plane.gx, plane.gy, least, 0.0, 0.0, 0.0), active)
    pressing = sliding_step(at_rest, resting, time, dt, room, after, sweep_tolerance)
    return pressing >= 3 and not after[7:13].any()


@inner
def follow_frictional_contact(
    setup: Setup,
    active: NDArray[np.bool_],
    state: Array,
    time: float,
    limit: float,
    open_end: bool,
    stop_when_decided: bool,
    knots: Knots,
) -> tuple[int, float, int, Knots]:
    """`follow_sliding_contact` for a law with friction."""
    body, law, plane, precision = setup
    sliding, tolerance = SlidingBody(body, law.parameters[1], plane, active), precision.sweep_tolerance
    begin, after, room = time, np.empty(13), room_to_slide(body.vertices.shape[0])
    guess, impulses = room.guess, room.impulses
    fixed = plane.amplitude == 0.0
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    while True:
        knots = with_knot(knots, time, state)
        if stop_when_decided and fixed and decided_with_friction(body, plane, state) >= 0:
            return RESTED, time - begin, -1, knots
        rate = (
            spin_rate(state) + sqrt((plane.g + peak_table_acceleration) / body.radius) + (0.0 if fixed else plane.rate)
        )
        dt = min(FRICTION_STEP_PART * precision.step_turn / rate, begin + limit - time)
        pressing = sliding_step(sliding, state, time, dt, room, after, tolerance)
        if fixed and pressing > 0 and not after[7:13].any() and not state[7:13].any():
            # Nothing moves, and nothing will.
            if open_end:
                return (RESTED if pressing >= 3 else BALANCED), time - begin, -1, knots
            return TIME_REACHED, limit, -1, knots
        if open_end and not fixed and pressing >= 3 and rides_forever(sliding, after, time + dt, dt, tolerance):
            copy_to(state, after)
            return RESTED, time + dt - begin, -1, knots
        hit = deepest_free_vertex(sliding, state, after, time, dt)
        if hit >= 0:
            # False position (Illinois) takes five to eleven steps where halving takes forty. The bracket is halved after another
            # vertex has become the deepest, whose height before is unknown, and where false position has not closed it for long.
            low, high, stayed, near = 0.0, dt, 0, ROUNDING_BOUND * body.radius
            guess[:] = impulses / dt
            h_low = clearance(body.vertices[hit], state, table_height(plane, time))
            h_high = clearance(body.vertices[hit], after, table_height(plane, time + dt))
            weigh_low, weigh_high = 1.0, 1.0
            for k in range(MAX_TOUCH_STEPS):
                if high - low <= TOUCH_TOLERANCE * dt or h_high >= -near:
                    break
                middle = 0.5 * (low + high)
                if h_low > 0.0 and (k < FALSE_POSITIONS or k % 3 < 2):
                    middle = low + (high - low) * weigh_low * h_low / (weigh_low * h_low - weigh_high * h_high)
                sliding_step(sliding, state, time, middle, room, after, tolerance)
                guess[:] = impulses / middle
                found = deepest_free_vertex(sliding, state, after, time, middle)
                if found >= 0:
                    h_low, stayed = h_low if found == hit else nan, max(stayed, 0) + 1
                    h_high = clearance(body.vertices[found], after, table_height(plane, time + middle))
                    high, hit, weigh_high = middle, found, 1.0
                    weigh_low *= 0.5 if stayed > 1 else 1.0
                else:
                    h_low = clearance(body.vertices[hit], after, table_height(plane, time + middle))
                    if h_low <= near:  # it touches
                        high = middle
                        break
                    low, stayed, weigh_low = middle, min(stayed, 0) - 1, 1.0
                    weigh_high *= 0.5 if stayed < -1 else 1.0
            sliding_step(sliding, state, time, high, room, after, tolerance)
            copy_to(state, after)
            return NOT_ENDED, time + high - begin, hit, knots
        copy_to(state, after)
        time += dt
        # The limit comes first: within no time nothing presses, and a die at rest would fly and touch without end.
        if time >= begin + limit:
            return TIME_REACHED, limit, -1, knots
        if pressing == 0:
            return NOT_ENDED, time - begin, -1, knots
        guess[:] = impulses / dt
        n, z_table = 0, table_height(plane, time)
        for k in range(active.shape[0]):
            if active[k]:
                if (
                    impulses[n, 2] <= 0.0
                    and clearance(body.vertices[k], state, z_table) > FRICTION_STANDING_HEIGHT * body.radius
                ):
                    active[k] = False
                    guess[:] = 0.0
                n += 1


def follow_sliding_contact(
    setup: Setup,
    active: NDArray[np.bool_],
    state: Array,
    time: float,
    limit: float,
    open_end: bool,
    stop_when_decided: bool,
    knots: Knots,
) -> tuple[int, float, int, Knots]:
    """Carry the state in place through contact with friction of the `active` vertices, as `follow_held_contact` does without.

    Returns NOT_ENDED or another ending, the duration [s], the vertex that touches (-1: all are off the table, or the limit
    came), and the knots. `open_end` says that the throw has no limit of time.
    """
    assert has_friction(setup.law)
    return follow_frictional_contact(setup, active, state, time, limit, open_end, stop_when_decided, knots)


@overload(follow_sliding_contact, strict=False)
def _follow_sliding_contact_of(
    setup: Any, active: Any, state: Any, time: Any, limit: Any, open_end: Any, stop_when_decided: Any, knots: Any
) -> Any:
    """For a law without friction, which never gets here, a function that does nothing."""
    if setup[1].instance_class is RoughLaw:
        return follow_frictional_contact.py_func
    return lambda setup, active, state, time, limit, open_end, stop_when_decided, knots: (NOT_ENDED, 0.0, -1, knots)


@inner
def deepest_free_vertex(sliding: SlidingBody, state: Array, after: Array, time: float, dt: float) -> int:
    """The deepest vertex below the table after dt [s] of those that are not active and sink; -1 where there is none.

    A vertex sinks that is lower at the end of the step than at its beginning. Its velocity at the end is too large by half of the
    step's centripetal acceleration, because the second half of the step is free of forces."""
    body, _, plane, active = sliding
    deepest, hit = 0.0, -1
    z_before, z_after = table_height(plane, time), table_height(plane, time + dt)
    for k in range(body.vertices.shape[0]):
        if not active[k]:
            h = clearance(body.vertices[k], after, z_after)
            if h < deepest and h < clearance(body.vertices[k], state, z_before):
                deepest, hit = h, k
    return hit
