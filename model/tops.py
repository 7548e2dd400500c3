"""Throws of a die that is no spherical top: any inertia tensor, and a centre of mass anywhere inside.

A loaded die or a truncated dipyramid does not turn at a constant rate in flight, so its path stands apart from the one
of `kernels`, which spherical tops never leave. Here positions are those of the **centre of mass**, and body axes are
the principal axes of inertia; `top_from_die`, `centre_of_mass_state` and `body_state` change over at the door. The
friendly function is `throw_top`.

**Motion.** The angular momentum L about the centre changes only by the table. In flight it is constant, the centre
moves on a parabola, and what remains is the attitude: q' = q ω/2 with ω = I⁻¹ Rᵀ L in body axes. It is integrated with
the method of order 8 of Dormand and Prince (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, II.5;
the tableau is scipy's), in steps through which the die turns by at most `TURN_RAD`. An instant inside a step is reached by
a shorter step of the same method from the same beginning, so it is as accurate as the whole.

**Touch.** As in `touch`: with u the vertical in body axes, vertex r has the height h = z + u·r above the table s(t), and
|h''| <= M = g + |s''| + |r| (ω² + |ω'|). In flight ω² <= 2T/I₁, T the rotational energy and I₁ the least moment, and
|ω'| <= c ω²/√3 with c the largest |Iⱼ - Iₖ|/Iᵢ (each product of two components of ω is at most as large as in Euler's
equations, and Σ ωⱼ²ωₖ² <= ω⁴/3). Stepping by the root of the parabola h + h' s - M s²/2 passes no touch.

**Impact.** Smooth (the paper's, for any inertia): the vertical velocity v of the vertex relative to the table goes to
-χ v by the impulse S = -(1 + χ) v / (1/m + t·I⁻¹ t) with t = r × ẑ; then Δv_z = S/m and ΔL = S t.

**Held contact.** Bounces that have become slower than `Precision.switch` √(g R) end on the table: the vertex is held.
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

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import asin, ceil, cos, inf, nan, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import DOP853

from .compiled import compiled, inner
from .kernels import (
    BALANCED,
    CHATTER,
    FINE,
    IMPACT_CAP,
    IMPACTS_REACHED,
    LEVEL,
    NO_TOUCH,
    RESTED,
    ROW,
    SMOOTH,
    SPINNING,
    TIME_REACHED,
    Law,
    Plane,
    Precision,
    Sources,
)
from .motion import State
from .rotations import matrix_from_quat, quat_from_matrix, quat_multiply
from .solids import Die, inner_vertices
from .touch import packed_state, unpacked_state

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TURN_RAD = 0.2
"""Largest turn in one step: the energy of a flight then stays within 1e-13 of itself, as the tests measure."""

HELD_STEPS = 10_000
"""Steps in contact without an impact after which a throw with no time limit is reported as spinning for ever."""

_ROUNDING = 16.0 * 2.220446049250313e-16
"""As in `kernels`: a height is a sum of some ten products, each off by half a unit of its last place."""

_NEAR = 1e-10
"""Part of the circumradius within which a slow vertex counts as standing on the table, as in `kernels`."""

_A, _B, _C = np.ascontiguousarray(DOP853.A[:12, :12]), DOP853.B.copy(), DOP853.C[:12].copy()

_FLIGHT_STEP, _LET_GO = -1, -2
"""What ends a step that no touch ends: its length, or a held vertex that is no longer pressed."""


class Top(NamedTuple):
    """A die as the kernels have it, in principal axes about its centre of mass."""

    vertices: Array
    """(n, 3) [m], of the inner solid where corners are rounded."""
    normals: Array
    """(faces, 3) outward."""
    offsets: Array
    """(faces,) [m] from the centre of mass."""
    corners: Indices
    """(faces, most) vertices of each face, counter-clockwise from outside, -1 beyond its last."""
    edge_faces: Indices
    """(e, 2)."""
    edge_heights: Array
    """(e,) [m] of the nearest point of each edge."""
    edge_inertias: Array
    """(e,) [kg m²] the largest moment of inertia about a line from the centre through a point of the edge."""
    mass: float
    moments: Array
    """(3,) [kg m²]."""
    radius: float
    """[m] of the farthest vertex."""


@dataclass(frozen=True, eq=False)
class TopThrow:
    """A throw of a die that is no spherical top; states can be asked for at any instant of it."""

    die: Die
    plane: Plane
    code: int
    """How it ended: a code of `kernels` (RESTED, TIME_REACHED, IMPACTS_REACHED, IMPACT_CAP, SPINNING, BALANCED)."""
    impact_count: int
    landed_face: int | None
    """Number of the face that the die can no longer leave; None while that is open."""
    end_s: float
    log: Array
    """(events, kernels.ROW), states of the centre of mass, quaternions of the die's own axes."""
    knots: Array
    """(k, 15): event that began the motion (-1: the release), time [s], state as in the log."""

    @property
    def impacts(self) -> Array:
        """The rows of the log at which a vertex strikes."""
        return self.log[self.log[:, 1] >= 0.0]

    def at(self, time_s: float) -> State:
        """The state at an instant between release and end: position and velocity are those of the centroid."""
        state = self.packed_states([time_s])[0]
        return body_state(self.die, unpacked_state(state, time_s))

    def packed_states(self, times_s: ArrayLike) -> Array:
        """States (n, 13) of the centre of mass at times (n,) [s]."""
        top, turn, knots = self._prepared
        states = states_between(top, self.plane, self.log[:, 21:23], knots, np.asarray(times_s, float))
        states[:, 2] += self.die.corner_radius_m
        states[:, 3:7] = quat_multiply(states[:, 3:7], turn * [1.0, -1.0, -1.0, -1.0])
        return states

    @cached_property
    def _prepared(self) -> tuple[Top, Array, Array]:
        """The die in its principal axes, the quaternion from those to its own, and the knots as the kernels have them.

        Kept, because a long throw is asked for one state a flight: a thousand flights took 40 s without.
        """
        top, turn = top_from_die(self.die)
        knots = self.knots.copy()
        knots[:, 4] -= self.die.corner_radius_m
        knots[:, 5:9] = quat_multiply(knots[:, 5:9], turn)
        return top, turn, knots


def throw_top(
    die: Die,
    release: State,
    law: Law,
    *,
    plane: Plane = LEVEL,
    precision: Precision = FINE,
    duration_s: float = inf,
    impacts: int | None = None,
    stop_when_decided: bool = True,
    impact_cap: int = 100_000,
) -> TopThrow:
    """Follow any die, spherical top or not, from its release until its face is decided or a limit is reached.

    `release` has the centroid's position and velocity, as everywhere; `law` is the smooth impact (`kernels.SMOOTH`,
    χ first), other laws raise ValueError; `duration_s` counts from the release. Raises ValueError for a release that
    no die has or that lies below the table.
    """
    if law.code != SMOOTH:
        raise ValueError(
            f"impact law {law.code} on a {die.solid.name} that is no spherical top: wanted the smooth impact; "
            "use SmoothImpact, or a die with one moment of inertia"
        )
    plane = Plane(*(float(value) for value in plane))  # kernels are compiled for floats
    top, turn = top_from_die(die)
    start = packed_state(centre_of_mass_state(die, release))
    start[2] -= die.corner_radius_m
    start[3:7] = quat_multiply(start[3:7], turn)
    low = start[2] + float((top.vertices @ matrix_from_quat(start[3:7])[2]).min())
    low -= plane.amplitude * float(np.sin(plane.rate * release.time_s + plane.phase))
    if low < -1e-9 * top.radius:
        raise ValueError(
            f"position_m = {release.position_m.tolist()}: the lowest vertex lies {-low:.3g} m below the table; "
            "raise the die"
        )
    most = np.iinfo(np.int64).max if impacts is None else impacts
    code, count, face, end, _, log, knots = run_top(
        top, law, plane, precision, start, release.time_s, duration_s, most, stop_when_decided, impact_cap, True
    )
    back = turn * np.array([1.0, -1.0, -1.0, -1.0])
    for rows, first in ((log, 2), (knots, 2)):
        rows[:, first + 2] += die.corner_radius_m
        rows[:, first + 3 : first + 7] = quat_multiply(rows[:, first + 3 : first + 7], back)
    return TopThrow(die, plane, code, count, face + 1 if face >= 0 else None, end, log, knots)


def centre_of_mass_state(die: Die, state: State) -> State:
    """The state whose position and velocity are those of the centre of mass, from the centroid's."""
    return _shifted(die, state, 1.0)


def body_state(die: Die, state: State) -> State:
    """The state whose position and velocity are those of the centroid, from the centre of mass's."""
    return _shifted(die, state, -1.0)


def _shifted(die: Die, state: State, sign: float) -> State:
    """The state of the point that lies `sign` centre_of_mass_m from where the state's point does."""
    if die.centre_of_mass_m is None:
        return state
    arm = sign * (state.rotation @ die.centre_of_mass_m)
    return State(
        state.time_s,
        state.position_m + arm,
        state.quaternion,
        state.velocity_m_s + np.cross(state.omega_rad_s, arm),
        state.omega_rad_s,
    )


def top_from_die(die: Die) -> tuple[Top, Array]:
    """The die in its principal axes, and the quaternion (4,) that takes those axes to the die's.

    Corners are those of the inner solid; heights then count from `corner_radius_m` above the table, because a vertical
    force through the lowest point of a rounded corner passes through its centre. Raises ValueError where the centre of
    mass lies in the rounded shell.
    """
    solid = die.solid
    shift = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
    tensor = die.inertia_kg_m2 * np.eye(3) if die.is_spherical_top else np.asarray(die.inertia_tensor_kg_m2)
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    vertices = (inner_vertices(solid, die.corner_radius_m) - shift) @ axes
    offsets = solid.offsets - die.corner_radius_m - solid.normals @ shift
    if offsets.min() <= 0.0:
        raise ValueError(
            f"centre_of_mass_m = {shift.tolist()}: wanted it deeper inside the {solid.name} than its corner radius "
            f"of {die.corner_radius_m:.6g} m"
        )
    corners = np.full((len(solid.faces), max(len(face) for face in solid.faces)), -1, np.int64)
    for k, face in enumerate(solid.faces):
        corners[k, : len(face)] = face
    ends = vertices[solid.edges]
    barriers = np.array([_edge_barrier(a, b, moments) for a, b in ends])
    top = Top(
        np.ascontiguousarray(vertices),
        np.ascontiguousarray(solid.normals @ axes),
        offsets,
        corners,
        solid.edge_faces,
        np.ascontiguousarray(barriers[:, 0]),
        np.ascontiguousarray(barriers[:, 1]),
        float(die.mass_kg),
        moments,
        float(np.linalg.norm(vertices, axis=1).max()),
    )
    return top, quat_from_matrix(axes)


def _edge_barrier(a: Array, b: Array, moments: Array) -> tuple[float, float]:
    """Least distance [m] of the edge from a to b, and the largest moment of inertia about a line through it."""
    along = b - a
    foot = a + np.clip(-(a @ along) / (along @ along), 0.0, 1.0) * along
    e1 = a / np.linalg.norm(a)
    e2 = b - (b @ e1) * e1
    e2 /= np.linalg.norm(e2)
    reach = np.arctan2(b @ e2, b @ e1)
    # d = e1 cos θ + e2 sin θ has d·I d = mean + p cos 2θ + q sin 2θ: largest at 2θ = atan2(q, p), or at an end.
    best = 0.5 * np.arctan2(2.0 * (e1 @ (moments * e2)), e1 @ (moments * e1) - e2 @ (moments * e2)) % np.pi
    angles = np.array([0.0, reach, best if best < reach else 0.0])
    d = np.outer(np.cos(angles), e1) + np.outer(np.sin(angles), e2)
    return float(np.linalg.norm(foot)), float((d**2 @ moments).max())


# --- kernels: states (13,) hold the angular momentum L [kg m²/s, table axes] where others hold ω -------------------


@inner
def _height_of_table(plane: Plane, time: float) -> float:
    return 0.0 if plane.amplitude == 0.0 else plane.amplitude * sin(plane.rate * time + plane.phase)


@inner
def _velocity_of_table(plane: Plane, time: float) -> float:
    return 0.0 if plane.amplitude == 0.0 else plane.amplitude * plane.rate * cos(plane.rate * time + plane.phase)


@inner
def _up(y: Array) -> tuple[float, float, float]:
    """The vertical in body axes: third row of the rotation."""
    w, a, b, c = y[3], y[4], y[5], y[6]
    return 2.0 * (a * c - w * b), 2.0 * (b * c + w * a), 1.0 - 2.0 * (a * a + b * b)


@inner
def _to_world(y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """A body vector in table axes."""
    w, x, z, v = y[3], y[4], y[5], y[6]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    return a + w * tx + z * tz - v * ty, b + w * ty + v * tx - x * tz, c + w * tz + x * ty - z * tx


@inner
def _spin(top: Top, y: Array) -> tuple[float, float, float]:
    """ω in body axes: I⁻¹ Rᵀ L."""
    w, x, z, v = y[3], -y[4], -y[5], -y[6]
    a, b, c = y[10], y[11], y[12]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    return (
        (a + w * tx + z * tz - v * ty) / top.moments[0],
        (b + w * ty + v * tx - x * tz) / top.moments[1],
        (c + w * tz + x * ty - z * tx) / top.moments[2],
    )


@inner
def _turning_energy(top: Top, y: Array) -> float:
    """½ ω·Iω [J]."""
    a, b, c = _spin(top, y)
    return 0.5 * (top.moments[0] * a * a + top.moments[1] * b * b + top.moments[2] * c * c)


@inner
def _lever(top: Top, y: Array, i: int) -> tuple[float, float, float]:
    """t = r × u of a vertex in body axes: the torque of a unit vertical force."""
    x, z, v = _up(y)
    a, b, c = top.vertices[i, 0], top.vertices[i, 1], top.vertices[i, 2]
    return b * v - c * z, c * x - a * v, a * z - b * x


@inner
def _response(top: Top, y: Array, i: int, j: int) -> float:
    """Aᵢⱼ: vertical acceleration of vertex i by a unit vertical force on vertex j."""
    a, b, c = _lever(top, y, i)
    d, e, f = _lever(top, y, j)
    return 1.0 / top.mass + a * d / top.moments[0] + b * e / top.moments[1] + c * f / top.moments[2]


@inner
def _clearance(top: Top, plane: Plane, y: Array, time: float, i: int) -> float:
    """Height of a vertex above the table."""
    x, z, v = _up(y)
    swung = x * top.vertices[i, 0] + z * top.vertices[i, 1] + v * top.vertices[i, 2]
    return y[2] + swung - _height_of_table(plane, time)


@inner
def _approach(top: Top, plane: Plane, y: Array, time: float, i: int) -> float:
    """Vertical velocity of a vertex relative to the table."""
    a, b, c = _lever(top, y, i)
    p, q, r = _spin(top, y)
    return y[9] + a * p + b * q + c * r - _velocity_of_table(plane, time)


@inner
def _free_acceleration(top: Top, plane: Plane, y: Array, time: float, i: int) -> float:
    """b: vertical acceleration of a vertex relative to the table with no forces from the table."""
    x, z, v = _up(y)
    p, q, r = _spin(top, y)
    i1, i2, i3 = top.moments[0], top.moments[1], top.moments[2]
    a, b, c = top.vertices[i, 0], top.vertices[i, 1], top.vertices[i, 2]
    # (u × ω) × ω · r, and ω' · t by Euler's equations.
    along = x * p + z * q + v * r
    w2 = p * p + q * q + r * r
    centripetal = (p * a + q * b + r * c) * along - w2 * (x * a + z * b + v * c)
    d, e, f = _lever(top, y, i)
    euler = d * (i2 - i3) / i1 * q * r + e * (i3 - i1) / i2 * r * p + f * (i1 - i2) / i3 * p * q
    return centripetal + euler - plane.g + plane.rate * plane.rate * _height_of_table(plane, time)


@inner
def _forces(top: Top, plane: Plane, y: Array, time: float, i: int, j: int) -> tuple[float, float]:
    """The vertical forces [N] that keep vertices i and j (-1: i alone) on the table."""
    if i < 0:
        return 0.0, 0.0
    b = _free_acceleration(top, plane, y, time, i)
    aii = _response(top, y, i, i)
    if j < 0:
        return -b / aii, 0.0
    c = _free_acceleration(top, plane, y, time, j)
    aij, ajj = _response(top, y, i, j), _response(top, y, j, j)
    det = aii * ajj - aij * aij
    return (aij * c - ajj * b) / det, (aij * b - aii * c) / det


@inner
def _rates(top: Top, plane: Plane, y: Array, time: float, i: int, j: int, out: Array) -> None:
    """Fill `out` (8,) with q' and, in held contact, z', v_z', L_x', L_y'."""
    p, q, r = _spin(top, y)
    w, a, b, c = y[3], y[4], y[5], y[6]
    out[0] = 0.5 * (-a * p - b * q - c * r)
    out[1] = 0.5 * (w * p + b * r - c * q)
    out[2] = 0.5 * (w * q + c * p - a * r)
    out[3] = 0.5 * (w * r + a * q - b * p)
    if i < 0:
        return
    n, o = _forces(top, plane, y, time, i, j)
    out[4] = y[9]
    out[5] = -plane.g + (n + o) / top.mass
    d, e, f = _lever(top, y, i)
    out[6], out[7], _ = _to_world(y, n * d, n * e, n * f)
    if j >= 0:
        d, e, f = _lever(top, y, j)
        dx, dy, _ = _to_world(y, o * d, o * e, o * f)
        out[6] += dx
        out[7] += dy


@inner
def _place(y: Array, values: Array) -> None:
    """Write the integrated components (8,) into a state."""
    y[3:7] = values[:4]
    y[2], y[9], y[10], y[11] = values[4], values[5], values[6], values[7]


@inner
def moved(top: Top, plane: Plane, y: Array, time: float, dt: float, i: int, j: int, stages: Array, out: Array) -> None:
    """The state `dt` [s] after `y`, in flight or with vertices i, j held (j = -2: on a face), into `out`.

    One step of the method, whatever `dt`; `stages` (14, 8) is room to work in.
    """
    out[:] = y
    out[0] = y[0] + (y[7] + 0.5 * plane.gx * dt) * dt
    out[1] = y[1] + (y[8] + 0.5 * plane.gy * dt) * dt
    out[7] = y[7] + plane.gx * dt
    out[8] = y[8] + plane.gy * dt
    if j == -2:
        _carry_on_face(top, plane, y, time, dt, out)
        return
    size = 4 if i < 0 else 8
    start, now = stages[12], stages[13]
    start[:4] = y[3:7]
    start[4], start[5], start[6], start[7] = y[2], y[9], y[10], y[11]
    now[:] = start
    for s in range(12):
        if s > 0:
            for k in range(size):
                total = 0.0
                for n in range(s):
                    total += _A[s, n] * stages[n, k]
                now[k] = start[k] + dt * total
            _place(out, now)
        _rates(top, plane, out, time + _C[s] * dt, i, j, stages[s])
    for k in range(size):
        total = 0.0
        for n in range(12):
            total += _B[n] * stages[n, k]
        now[k] = start[k] + dt * total
    norm = sqrt(now[0] * now[0] + now[1] * now[1] + now[2] * now[2] + now[3] * now[3])
    now[:4] /= norm
    _place(out, now)
    if i < 0:
        out[2] = y[2] + (y[9] - 0.5 * plane.g * dt) * dt
        out[9] = y[9] - plane.g * dt


@inner
def _carry_on_face(top: Top, plane: Plane, y: Array, time: float, dt: float, out: Array) -> None:
    """A die that lies on a face turns about the vertical and moves up and down with the table."""
    p, q, r = _spin(top, y)
    x, z, v = _up(y)
    half = 0.5 * dt * (p * x + q * z + r * v)
    c, s = cos(half), sin(half)
    w, a, b, d = y[3], y[4], y[5], y[6]
    # A turn about the vertical of the table multiplies from the left, and turns L with it.
    out[3], out[4], out[5], out[6] = c * w - s * d, c * a - s * b, c * b + s * a, c * d + s * w
    c, s = cos(2.0 * half), sin(2.0 * half)
    out[10], out[11] = c * y[10] - s * y[11], s * y[10] + c * y[11]
    out[2] = y[2] + _height_of_table(plane, time + dt) - _height_of_table(plane, time)
    out[9] = _velocity_of_table(plane, time + dt)


@inner
def _push(top: Top, y: Array, i: int, impulse: float) -> None:
    """A vertical impulse [N s] on a vertex, in place."""
    a, b, c = _lever(top, y, i)
    x, z, _ = _to_world(y, a, b, c)
    y[9] += impulse / top.mass
    y[10] += impulse * x
    y[11] += impulse * z


@inner
def _turn(y: Array, a: float, b: float, c: float) -> None:
    """Turn the body by a small rotation vector [rad] in its own axes, in place; L stays as it is."""
    w, x, z, v = y[3], y[4], y[5], y[6]
    a, b, c = 0.5 * a, 0.5 * b, 0.5 * c
    y[3], y[4], y[5], y[6] = (
        w - x * a - z * b - v * c,
        x + w * a + z * c - v * b,
        z + w * b + v * a - x * c,
        v + w * c + x * b - z * a,
    )
    norm = sqrt(y[3] * y[3] + y[4] * y[4] + y[5] * y[5] + y[6] * y[6])
    y[3:7] /= norm


@inner
def stand_on(top: Top, plane: Plane, y: Array, time: float, i: int, j: int) -> None:
    """Put vertices i and j (-1: i alone) at rest on the table, by the least change in the metric of mass, in place."""
    for _ in range(2):
        h = _clearance(top, plane, y, time, i)
        if j < 0:
            y[2] -= h
        else:
            k = _clearance(top, plane, y, time, j)
            aii, aij, ajj = _response(top, y, i, i), _response(top, y, i, j), _response(top, y, j, j)
            det = aii * ajj - aij * aij
            n, o = (aij * k - ajj * h) / det, (aij * h - aii * k) / det
            a, b, c = _lever(top, y, i)
            d, e, f = _lever(top, y, j)
            y[2] += (n + o) / top.mass
            _turn(
                y,
                (n * a + o * d) / top.moments[0],
                (n * b + o * e) / top.moments[1],
                (n * c + o * f) / top.moments[2],
            )
    u = _approach(top, plane, y, time, i)
    if j < 0:
        _push(top, y, i, -u / _response(top, y, i, i))
        return
    v = _approach(top, plane, y, time, j)
    aii, aij, ajj = _response(top, y, i, i), _response(top, y, i, j), _response(top, y, j, j)
    det = aii * ajj - aij * aij
    _push(top, y, i, (aij * v - ajj * u) / det)
    _push(top, y, j, (aij * u - aii * v) / det)


@inner
def lie_on(top: Top, plane: Plane, y: Array, time: float, face: int) -> None:
    """Lay the die flat on a face, turning about the vertical with the same L_z, in place."""
    for _ in range(2):
        x, z, v = _up(y)
        a, b, c = -top.normals[face, 0], -top.normals[face, 1], -top.normals[face, 2]
        # The body turns by δ, its vertical by u × δ: δ = a × u takes u to the direction a against the normal.
        _turn(y, b * v - c * z, c * x - a * v, a * z - b * x)
    y[2] = top.offsets[face] + _height_of_table(plane, time)
    _still(top, plane, y, time)


@inner
def _still(top: Top, plane: Plane, y: Array, time: float) -> None:
    """Leave only the turn about the vertical, with the same L_z, and the table's own velocity, in place."""
    x, z, v = _up(y)
    i1, i2, i3 = top.moments[0], top.moments[1], top.moments[2]
    rate = y[12] / (i1 * x * x + i2 * z * z + i3 * v * v)
    y[10], y[11], _ = _to_world(y, i1 * rate * x, i2 * rate * z, i3 * rate * v)
    y[9] = _velocity_of_table(plane, time)


@inner
def complementary(top: Top, y: Array, chosen: Indices, n: int, w: Array, tolerance: float, pushes: Array) -> bool:
    """Pushes >= 0 on the vertices `chosen` (n of them) that leave each of `w` (n,) >= 0 and 0 where pushed.

    At most two vertices are pushed; returns False where three are needed, so that all of `w` become 0. Fills `pushes`
    (n,) and changes `w` to what remains.
    """
    pushes[:n] = 0.0
    least = 0.0
    for k in range(n):
        least = min(least, w[k])
    if least >= -tolerance:
        return True
    for a in range(n):
        for b in range(a, n):
            i, j = chosen[a], chosen[b]
            aii = _response(top, y, i, i)
            if a == b:
                p, q = -w[a] / aii, 0.0
            else:
                aij, ajj = _response(top, y, i, j), _response(top, y, j, j)
                det = aii * ajj - aij * aij
                p, q = (aij * w[b] - ajj * w[a]) / det, (aij * w[a] - aii * w[b]) / det
            if p < 0.0 or q < 0.0:
                continue
            serves = True
            for k in range(n):
                left = w[k] + _response(top, y, chosen[k], i) * p + _response(top, y, chosen[k], j) * q
                serves = serves and left >= -tolerance
            if serves:
                for k in range(n):
                    w[k] += _response(top, y, chosen[k], i) * p + _response(top, y, chosen[k], j) * q
                pushes[a] += p
                pushes[b] += q
                return True
    return False


@inner
def _growth(top: Top) -> float:
    """c: the largest |Iⱼ - Iₖ|/Iᵢ."""
    a, b, c = top.moments[0], top.moments[1], top.moments[2]
    return max(abs(b - c) / a, abs(c - a) / b, abs(a - b) / c)


@inner
def settle(top: Top, plane: Plane, y: Array, time: float, slow: float, chosen: Indices, room: Array) -> tuple[int, int]:
    """End the bounces of the vertices that stand on the table, in place, and find which the die presses on.

    Returns (-1, -1) for none, (i, -1), (i, j), or (face, -2).
    """
    w, pushes = room[0], room[1]
    spin = sqrt(2.0 * _turning_energy(top, y) / top.moments[0])
    speed = abs(y[9]) + spin * top.radius + plane.amplitude * plane.rate
    # A tenth of the switch speed is rest; where nothing is switched, what rounding leaves.
    rounding = max(0.1 * slow, 4.0 * _ROUNDING * (speed + sqrt(plane.g * top.radius)))
    n = 0
    for k in range(top.vertices.shape[0]):
        if _clearance(top, plane, y, time, k) <= _NEAR * top.radius:
            u = _approach(top, plane, y, time, k)
            if abs(u) <= max(slow, rounding):
                chosen[n], w[n] = k, u
                n += 1
    if n == 0:
        return -1, -1
    if complementary(top, y, chosen, n, w, rounding, pushes):
        for k in range(n):
            _push(top, y, chosen[k], pushes[k])
    else:
        _still(top, plane, y, time)
    standing = 0
    for k in range(n):
        if _approach(top, plane, y, time, chosen[k]) <= rounding:
            chosen[standing] = chosen[k]
            standing += 1
    scale = plane.g + plane.amplitude * plane.rate * plane.rate + spin * spin * top.radius
    for k in range(standing):
        w[k] = _free_acceleration(top, plane, y, time, chosen[k])
    if complementary(top, y, chosen, standing, w, 1e-12 * scale, pushes):
        held = 0
        for k in range(standing):
            if w[k] <= 1e-12 * scale:
                chosen[held] = chosen[k]
                held += 1
    else:
        held = standing
    if held >= 3:
        return lowest_face_row(top, y), -2
    return (chosen[0] if held > 0 else -1), (chosen[1] if held > 1 else -1)


@inner
def lowest_face_row(top: Top, y: Array) -> int:
    """Row of the face normal that points down most."""
    x, z, v = _up(y)
    best, lowest = 0, inf
    for k in range(top.normals.shape[0]):
        down = top.normals[k, 0] * x + top.normals[k, 1] * z + top.normals[k, 2] * v
        if down < lowest:
            best, lowest = k, down
    return best


@inner
def decided_face(top: Top, plane: Plane, y: Array) -> int:
    """Row of the face that the die can no longer leave, or -1, on a table at rest."""
    x, z, v = _up(y)
    face, best = 0, -inf
    for k in range(top.normals.shape[0]):
        down = -(top.normals[k, 0] * x + top.normals[k, 1] * z + top.normals[k, 2] * v) / top.offsets[k]
        if down > best:
            face, best = k, down
    energy = top.mass * (plane.g * y[2] + 0.5 * y[9] * y[9]) + _turning_energy(top, y)
    for e in range(top.edge_faces.shape[0]):
        if top.edge_faces[e, 0] == face or top.edge_faces[e, 1] == face:
            kept = 0.5 * y[12] * y[12] / top.edge_inertias[e]
            if energy >= top.mass * plane.g * top.edge_heights[e] + kept:
                return -1
    return face


@inner
def leaves_face_after(top: Top, plane: Plane, y: Array, time: float, face: int) -> float:
    """Time [s] until a die that lies on a face is no longer pressed on all of it; inf for never.

    The table's force N = m (g + s'') acts where its moment about the centre is that of the spin: at the foot of the
    centre plus e/N. It must stay inside the face, which bounds N from below and above.
    """
    i1, i2, i3 = top.moments[0], top.moments[1], top.moments[2]
    p, q, r = _spin(top, y)
    nx, ny, nz = top.normals[face, 0], top.normals[face, 1], top.normals[face, 2]
    # ω × Iω, and u × of it with u = -n.
    tx, ty, tz = q * r * (i3 - i2), r * p * (i1 - i3), p * q * (i2 - i1)
    ex, ey, ez = -(ny * tz - nz * ty), -(nz * tx - nx * tz), -(nx * ty - ny * tx)
    least, most = 0.0, inf
    count = 0
    while count < top.corners.shape[1] and top.corners[face, count] >= 0:
        count += 1
    for k in range(count):
        a, b = top.vertices[top.corners[face, k]], top.vertices[top.corners[face, (k + 1) % count]]
        dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        # Inward across the edge: n × (b - a).
        ix, iy, iz = ny * dz - nz * dy, nz * dx - nx * dz, nx * dy - ny * dx
        inside = -(ix * a[0] + iy * a[1] + iz * a[2])
        drift = ix * ex + iy * ey + iz * ez
        if inside > 0.0 and drift < 0.0:
            least = max(least, -drift / inside)
        elif inside < 0.0 and drift > 0.0:
            most = min(most, -drift / inside)
    swing = plane.amplitude * plane.rate * plane.rate
    if swing == 0.0:
        return inf
    # g - swing sin θ leaves [least, most]/m where sin θ passes above `high` or below `low`; by a little more than that,
    # so that the vertices then accelerate away measurably.
    high = (plane.g - least / top.mass) / swing + 1e-7
    low = (plane.g - most / top.mass) / swing - 1e-7
    theta, after = plane.rate * time + plane.phase, inf
    if high < 1.0:
        crossing = asin(max(high, -1.0))
        after = crossing + 2.0 * pi * ceil((theta - crossing) / (2.0 * pi)) - theta
    if low > -1.0:
        crossing = pi - asin(min(low, 1.0))
        after = min(after, crossing + 2.0 * pi * ceil((theta - crossing) / (2.0 * pi)) - theta)
    return after / plane.rate


@inner
def next_event(
    top: Top,
    plane: Plane,
    precision: Precision,
    y: Array,
    time: float,
    limit: float,
    i: int,
    j: int,
    stages: Array,
    now: Array,
) -> tuple[float, int, float, float]:
    """One step of the motion, or less where something ends it first; `now` (13,) becomes the state there.

    Returns the time [s] from `y`, the vertex that touches (or _FLIGHT_STEP, _LET_GO), its velocity and acceleration
    relative to the table (0 for a velocity that is only rounding).
    """
    g, mass, radius = plane.g, top.mass, top.radius
    swing = plane.amplitude * plane.rate * plane.rate
    spin = sqrt(2.0 * _turning_energy(top, y) / top.moments[0])
    growth = _growth(top)
    if i < 0:
        push = 0.0
    else:
        # The spin changes in held contact: this step ends before it could outgrow its allowance.
        before = spin
        spin = 1.25 * spin + 0.25 * sqrt((g + swing) / radius)
        push = g + swing + radius * spin * spin * (1.0 + growth / sqrt(3.0))
        rate = push * sqrt(mass / top.moments[0]) + growth * spin * spin / sqrt(3.0)
        limit = min(limit, (spin - before) / rate)
    angular = growth * spin * spin / sqrt(3.0) + push * sqrt(mass / top.moments[0])
    longest = min(limit, min(precision.turn, TURN_RAD) / spin) if spin > 0.0 else limit
    if i >= 0 and plane.rate > 0.0 and plane.amplitude != 0.0:
        longest = min(longest, TURN_RAD / plane.rate)  # the table's motion enters the right side
    bound = g + swing + push + radius * (spin * spin + angular)
    if i < 0:
        jerk = radius * spin * ((1.0 + 2.0 * growth) * angular + 3.0 * angular + spin * spin) + swing * plane.rate
    else:
        jerk = 10.0 * (spin + sqrt((g + swing) / radius) + plane.rate) * bound
    weightless = -1e-10 * mass * bound
    t, last, safe = 0.0, 0.0, 0.0
    space = y[2] - radius - plane.amplitude
    if i < 0 and space > 0.0:
        # No vertex reaches farther down than the circumscribed sphere: fall with it.
        safe = (y[9] + sqrt(y[9] * y[9] + 2.0 * g * space)) / g
    now[:] = y
    t = min(safe, longest)
    while True:
        if t > 0.0:
            moved(top, plane, y, time, t, i, j, stages, now)
        if i >= 0:
            n, o = _forces(top, plane, now, time + t, i, j)
            if min(n, o) < weightless:
                for _ in range(60):
                    middle = 0.5 * (last + t)
                    if middle in (last, t):
                        break
                    moved(top, plane, y, time, middle, i, j, stages, now)
                    n, o = _forces(top, plane, now, time + middle, i, j)
                    if min(n, o) < weightless:
                        t = middle
                    else:
                        last = middle
                moved(top, plane, y, time, t, i, j, stages, now)
                return t, _LET_GO, 0.0, 0.0
        turned = 1.0 + spin * t
        phase = 1.0 + abs(plane.rate * (time + t)) + abs(plane.phase)
        h_tol = _ROUNDING * (abs(y[2]) + (abs(y[9]) + g * t) * t + radius * turned + plane.amplitude * phase)
        v_tol = _ROUNDING * (abs(y[9]) + g * t + spin * radius * turned + plane.amplitude * plane.rate * phase)
        h_tol = max(h_tol, precision.root)
        a_tol = (_ROUNDING * turned if i < 0 else 2e-14) * bound
        hit, hit_v, hit_a, step = -1, 0.0, 0.0, inf
        for k in range(top.vertices.shape[0]):
            if k in (i, j):
                continue
            h = _clearance(top, plane, now, time + t, k)
            v = _approach(top, plane, now, time + t, k)
            ahead = inf
            if h > h_tol:
                root = sqrt(v * v + 2.0 * bound * h)
                ahead = (v + root) / bound if v > 0.0 else 2.0 * h / (root - v)
                if v <= 0.0 or ahead > 0.1 * longest:
                    step = min(step, ahead)
                    continue
            acceleration = _free_acceleration(top, plane, now, time + t, k)
            if i >= 0:
                n, o = _forces(top, plane, now, time + t, i, j)
                acceleration += _response(top, now, k, i) * n
                if j >= 0:
                    acceleration += _response(top, now, k, j) * o
            if h <= h_tol:
                if v < -v_tol or (v <= v_tol and acceleration <= a_tol):
                    v = v if v < -v_tol else 0.0
                    if hit < 0 or v < hit_v:
                        hit, hit_v, hit_a = k, v, acceleration
                    continue
                v = max(v, 0.0)
                ahead = 2.0 * v / bound
            # Nor before the root of v s + h'' s²/2 - J s³/6: a vertex that was let go, with v and h'' small but growing,
            # so moves on by a multiple of the time since. The parabola alone took a thousand steps there.
            half = 0.5 * acceleration
            root = sqrt(half * half + 2.0 / 3.0 * v * jerk)
            ahead = max(ahead, 3.0 * (half + root) / jerk if half > 0.0 else 2.0 * v / (root - half))
            step = min(step, ahead)
        if hit >= 0:
            return t, hit, hit_v, hit_a
        if t >= longest:
            return longest, _FLIGHT_STEP, 0.0, 0.0
        last = t
        t = min(t + step, longest)


@inner
def _with_spin(top: Top, y: Array, out: Array) -> None:
    """The state as others have it, with ω [rad/s, table axes] for L, into `out` (13,)."""
    p, q, r = _spin(top, y)
    out[:] = y
    out[10], out[11], out[12] = _to_world(y, p, q, r)


@inner
def _with_momentum(top: Top, state: Array) -> Array:
    """The inverse of `_with_spin`."""
    y = state.copy()
    w, x, z, v = y[3], -y[4], -y[5], -y[6]
    a, b, c = y[10], y[11], y[12]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    y[10], y[11], y[12] = _to_world(
        state,
        top.moments[0] * (a + w * tx + z * tz - v * ty),
        top.moments[1] * (b + w * ty + v * tx - x * tz),
        top.moments[2] * (c + w * tz + x * ty - z * tx),
    )
    return y


@inner
def _room_for(rows: Array, used: int) -> Array:
    """The same rows, with room for as many again where all are used."""
    if used < rows.shape[0]:
        return rows
    larger = np.empty((2 * rows.shape[0], rows.shape[1]))
    larger[: rows.shape[0]] = rows
    return larger


@compiled
def run_top(
    top: Top,
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
    """The event loop, like `kernels.run_throw`, for smooth impacts. Nothing is changed in its arguments.

    `start` (13,) and all states have the centre of mass's position, the quaternion of the principal axes, and ω.
    Returns the code of the ending, the number of impacts, the row of the face decided on (-1: none), the time [s] at
    which it ends, the state there, the log (events, ROW), and the knots (k, 15): event that began the motion (-1: the
    release), time, state at the beginning of each step. Both stay empty unless `keep`. In the log a vertex of -1 says
    that nothing strikes; the first held vertex of a die on a face is the row of the face.
    """
    y = _with_momentum(top, start)
    now, before, shown, stages = np.empty(13), np.empty(13), np.empty(13), np.empty((14, 8))
    chosen, room = np.empty(top.vertices.shape[0], np.int64), np.empty((2, top.vertices.shape[0]))
    log, knots = np.empty((64 if keep else 1, ROW)), np.empty((64 if keep else 1, 15))
    chi = law.parameters[0]
    slow = 0.0 if chi >= 1.0 else precision.switch * sqrt(plane.g * top.radius)
    at_rest = plane.amplitude == 0.0
    time, end, impacts, events, known, steps, still = start_time, start_time + duration, 0, 0, 0, 0, 0
    i, j, face, ending = -1, -1, -1, -1
    begins = True  # whether an event has just been: only then can the face become decided
    while True:
        if begins and at_rest:
            face = decided_face(top, plane, y)
        if keep:
            knots = _room_for(knots, known)
            knots[known, 0], knots[known, 1] = events - 1, time
            _with_spin(top, y, knots[known, 2:])
            known += 1
        dt, hit, velocity, acceleration = 0.0, _FLIGHT_STEP, 0.0, 0.0
        if j == -2:
            dt = leaves_face_after(top, plane, y, time, i)
            if dt == inf:
                face = i
            if dt == inf and (stop_when_decided or end == inf):
                ending = RESTED
                dt = 0.0
            elif dt >= end - time:
                ending, dt = TIME_REACHED, end - time
            moved(top, plane, y, time, dt, i, j, stages, now)
            hit = _LET_GO
        elif face >= 0 and stop_when_decided and (i >= 0 or not keep):
            ending = RESTED
            now[:] = y
        else:
            dt, hit, velocity, acceleration = next_event(top, plane, precision, y, time, end - time, i, j, stages, now)
            if hit == _FLIGHT_STEP and time + dt >= end:
                ending = TIME_REACHED
            elif hit >= 0 and face >= 0 and stop_when_decided:
                ending = RESTED
        y[:] = now
        time += dt
        still = still + 1 if dt == 0.0 else 0
        reorder = hit == _LET_GO or (
            hit >= 0 and -velocity <= slow and (velocity == 0.0 or acceleration < 0.0 or i >= 0)
        )
        if ending < 0 and hit >= 0 and not reorder:
            if impacts >= impact_limit:
                ending = IMPACTS_REACHED
            elif impacts >= impact_cap:
                ending = IMPACT_CAP
        steps = steps + 1 if i >= 0 or reorder else 0
        if ending < 0 and steps > HELD_STEPS and end == inf:
            ending = BALANCED if _turning_energy(top, y) < 1e-9 * top.mass * plane.g * top.radius else SPINNING
        if ending >= 0:
            _with_spin(top, y, shown)
            return ending, impacts, face, time, shown, log[: events if keep else 0], knots[: known if keep else 0]
        if i >= 0 and j != -2:
            stand_on(top, plane, y, time, i, j)
        begins = hit != _FLIGHT_STEP
        if not begins:
            continue
        _with_spin(top, y, before)
        if reorder:
            hit = -1
            i, j = settle(top, plane, y, time, slow, chosen, room)
            if j == -2:
                lie_on(top, plane, y, time, i)
            elif i >= 0:
                stand_on(top, plane, y, time, i, j)
            if still > 20:
                # Rounding finds a touch where nothing presses, or the reverse, again and again: pass over the instant.
                skipped = 1e-9 * sqrt(top.radius / plane.g)
                moved(top, plane, y, time, skipped, i, j, stages, now)
                y[:] = now
                time += skipped
        else:
            approach = _approach(top, plane, y, time, hit)
            _push(top, y, hit, -(1.0 + chi) * approach / _response(top, y, hit, hit))
            i, j = -1, -1
            impacts += 1
        if keep:
            log = _room_for(log, events)
            log[events, 0], log[events, 1] = time, hit
            log[events, 2:15] = before
            _with_spin(top, y, shown)
            log[events, 15:21] = shown[7:13]
            log[events, 21], log[events, 22] = i, j
        events += 1


@compiled
def states_between(top: Top, plane: Plane, held: Array, knots: Array, times: Array) -> Array:
    """States (n, 13) at times (n,) [s] from the knots of `run_top`; `held` (events, 2) are the log's last columns."""
    out, stages, now = np.empty((times.shape[0], 13)), np.empty((14, 8)), np.empty(13)
    for n in range(times.shape[0]):
        k = max(0, np.searchsorted(knots[:, 1], times[n], side="right") - 1)
        event = int(knots[k, 0])
        i, j = (int(held[event, 0]), int(held[event, 1])) if event >= 0 else (-1, -1)
        moved(top, plane, _with_momentum(top, knots[k, 2:]), knots[k, 1], times[n] - knots[k, 1], i, j, stages, now)
        _with_spin(top, now, out[n])
    return out


# --- derivatives (`tangent` has the method, the equations of a top stand there too) ----------------------------------


@inner
def _compliance(top: Top, y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """W x = R I⁻¹ Rᵀ x of a vector in table axes: the angular velocity that an angular momentum x makes."""
    w, x, z, v = y[3], -y[4], -y[5], -y[6]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    return _to_world(
        y,
        (a + w * tx + z * tz - v * ty) / top.moments[0],
        (b + w * ty + v * tx - x * tz) / top.moments[1],
        (c + w * tz + x * ty - z * tx) / top.moments[2],
    )


@inner
def _turn_rates(top: Top, y: Array, values: Array, out: Array) -> None:
    """Fill `out` (22,) with the rates of `values`: quaternion (4), Φ (3 × 3) and Ψ (3 × 3) row by row.

    δ' = W (δL - δ × L) for a turn δ of the attitude, so Φ' = W [L]× Φ and Ψ' = W [L]× Ψ + W.
    """
    y[3:7] = values[:4]
    p, q, r = _spin(top, y)
    w, a, b, c = values[0], values[1], values[2], values[3]
    out[0] = 0.5 * (-a * p - b * q - c * r)
    out[1] = 0.5 * (w * p + b * r - c * q)
    out[2] = 0.5 * (w * q + c * p - a * r)
    out[3] = 0.5 * (w * r + a * q - b * p)
    lx, ly, lz = y[10], y[11], y[12]
    for block in (4, 13):
        for k in range(3):
            i, j, m = block + k, block + 3 + k, block + 6 + k
            dx, dy, dz = values[i], values[j], values[m]
            ux, uy, uz = ly * dz - lz * dy, lz * dx - lx * dz, lx * dy - ly * dx
            if block == 13:
                ux, uy, uz = ux + (k == 0), uy + (k == 1), uz + (k == 2)
            out[i], out[j], out[m] = _compliance(top, y, ux, uy, uz)


@inner
def _turn_with_tangent(top: Top, y: Array, dt: float, room: Array) -> None:
    """One step of the attitude in flight, in place in `y`; leaves quaternion, Φ and Ψ of the step in `room[13]`.

    `room` (14, 22).
    """
    start, now = room[12], room[13]
    start[:] = 0.0
    start[:4] = y[3:7]
    start[4], start[8], start[12] = 1.0, 1.0, 1.0
    for s in range(13):
        for k in range(22):
            total = 0.0
            for n in range(s):
                total += (_A[s, n] if s < 12 else _B[n]) * room[n, k]
            now[k] = start[k] + dt * total
        if s < 12:
            _turn_rates(top, y, now, room[s])
    norm = sqrt(now[0] * now[0] + now[1] * now[1] + now[2] * now[2] + now[3] * now[3])
    y[3:7] = now[:4] / norm


@inner
def _carry(
    top: Top, plane: Plane, y: Array, dt: float, sources: Sources, tangent: Array, pull: Array, room: Array
) -> None:
    """Carry a state in flight and its derivatives (12, 12 + m) through `dt` [s], of either sign, in place.

    `pull` (12 + m,) is where the moments of inertia change: ω is another then for the same L.
    """
    spin = sqrt(2.0 * _turning_energy(top, y) / top.moments[0])
    steps = max(1, ceil(abs(dt) * spin / TURN_RAD))
    for _ in range(steps):
        ox, oy, oz = _compliance(top, y, y[10], y[11], y[12])
        _turn_with_tangent(top, y, dt / steps, room)
        now = room[13]
        for j in range(tangent.shape[1]):
            dx, dy, dz = tangent[3, j], tangent[4, j], tangent[5, j]
            lx = tangent[9, j] - pull[j] * ox
            ly = tangent[10, j] - pull[j] * oy
            lz = tangent[11, j] - pull[j] * oz
            for k in range(3):
                i, n = 4 + 3 * k, 13 + 3 * k
                turned = now[i] * dx + now[i + 1] * dy + now[i + 2] * dz
                tangent[3 + k, j] = turned + now[n] * lx + now[n + 1] * ly + now[n + 2] * lz
    for k in range(3):
        for j in range(tangent.shape[1]):
            pulled = sources.gravity[j - 12, k] if j >= 12 else 0.0
            tangent[k, j] += (tangent[6 + k, j] + 0.5 * pulled * dt) * dt
            tangent[6 + k, j] += pulled * dt
    y[0] += (y[7] + 0.5 * plane.gx * dt) * dt
    y[1] += (y[8] + 0.5 * plane.gy * dt) * dt
    y[2] += (y[9] - 0.5 * plane.g * dt) * dt
    y[7] += plane.gx * dt
    y[8] += plane.gy * dt
    y[9] -= plane.g * dt


@inner
def _strike_tangent(
    top: Top,
    plane: Plane,
    chi: float,
    y: Array,
    time: float,
    i: int,
    sources: Sources,
    tangent: Array,
    pull: Array,
    dtime: Array,
) -> None:
    """Carry state and derivatives through the smooth impact of vertex i, in place. `dtime` (12 + m,) receives the
    derivative of its instant."""
    x, z, v = top.vertices[i, 0], top.vertices[i, 1], top.vertices[i, 2]
    rx, ry, rz = _to_world(y, x, z, v)
    lx, ly, lz = y[10], y[11], y[12]
    ox, oy, oz = _compliance(top, y, lx, ly, lz)
    phase = plane.rate * time + plane.phase
    s, c = sin(phase), cos(phase)
    u = y[9] + ox * ry - oy * rx - plane.amplitude * plane.rate * c
    # Wt with the lever t = r × ẑ = (r_y, -r_x, 0).
    ax, ay, az = _compliance(top, y, ry, -rx, 0.0)
    softness = 1.0 / top.mass + ry * ax - rx * ay
    impulse = -(1.0 + chi) * u / softness
    closing = -plane.g + plane.rate * plane.rate * plane.amplitude * s
    for j in range(tangent.shape[1]):
        bx, by, bz, raised, lifted, softer = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if j >= 12:
            p = j - 12
            vertex = sources.vertices[p, i]
            bx, by, bz = _to_world(y, vertex[0], vertex[1], vertex[2])
            by_amplitude, by_rate, by_phase = sources.table[p, 0], sources.table[p, 1], sources.table[p, 2]
            turned = by_rate * time + by_phase
            raised = by_amplitude * s + plane.amplitude * c * turned
            lifted = plane.rate * (by_amplitude * c - plane.amplitude * s * turned) + plane.amplitude * c * by_rate
            softer = sources.chi[p]
        dx, dy, dz = tangent[3, j], tangent[4, j], tangent[5, j]
        late = -(tangent[2, j] + dx * ry - dy * rx + bz - raised) / u
        dtime[j] = late
        dx, dy, dz = dx + ox * late, dy + oy * late, dz + oz * late
        ex, ey = dy * rz - dz * ry + bx, dz * rx - dx * rz + by
        kx = tangent[9, j] - (dy * lz - dz * ly) - pull[j] * ox
        ky = tangent[10, j] - (dz * lx - dx * lz) - pull[j] * oy
        kz = tangent[11, j] - (dx * ly - dy * lx) - pull[j] * oz
        wx, wy, _ = _compliance(top, y, kx, ky, kz)
        wx, wy = wx + dy * oz - dz * oy, wy + dz * ox - dx * oz
        du = tangent[8, j] + closing * late + wx * ry - wy * rx + ox * ey - oy * ex - lifted
        # δ × Wt, x and y.
        gx, gy = dy * az - dz * ay, dz * ax - dx * az
        dsoftness = 2.0 * (ey * ax - ex * ay + ry * gx - rx * gy) - pull[j] * (ax * ax + ay * ay + az * az)
        ds = -((1.0 + chi) * du + softer * u) / softness - impulse * dsoftness / softness
        tangent[2, j] -= impulse / top.mass * late
        tangent[3, j] = dx - (ox + impulse * ax) * late
        tangent[4, j] = dy - (oy + impulse * ay) * late
        tangent[5, j] = dz - (oz + impulse * az) * late
        tangent[8, j] += ds / top.mass
        tangent[9, j] += ds * ry + impulse * ey
        tangent[10, j] -= ds * rx + impulse * ex
    y[9] += impulse / top.mass
    y[10] += impulse * ry
    y[11] -= impulse * rx


@inner
def _crossed_before(top: Top, plane: Plane, y: Array, time: float, i: int, stages: Array, now: Array) -> float:
    """How long ago [s, negative] vertex i, which is below the table and sinks, came through it; NaN for longer than
    the die takes to fall its own radius. As `kernels.touch_of_vertex`."""
    spin = sqrt(2.0 * _turning_energy(top, y) / top.moments[0])
    swing = plane.amplitude * plane.rate * plane.rate
    bound = spin * spin * (1.0 + _growth(top) / sqrt(3.0)) * top.radius + swing - plane.g
    bound = max(bound, 1e-3 * plane.g)  # h'' is no larger; kept above 0 for the division
    t = 0.0
    back = y.copy()
    while t > -sqrt(2.0 * top.radius / plane.g):
        h = _clearance(top, plane, back, time + t, i)
        v = _approach(top, plane, back, time + t, i)
        phase = 1.0 + abs(plane.rate * (time + t)) + abs(plane.phase)
        size = abs(y[2]) + abs(y[9] * t) + top.radius * (1.0 - spin * t) + plane.amplitude * phase
        if h >= -_ROUNDING * size:
            return t
        root = sqrt(v * v - 2.0 * bound * h)
        step = 2.0 * h / (v - root) if v < 0.0 else (v + root) / bound
        if spin > 0.0:
            step = min(step, TURN_RAD / spin)
        moved(top, plane, back, time + t, -step, -1, -1, stages, now)
        back[:] = now
        t -= step
    return nan


@inner
def _only(top: Top, i: int) -> Top:
    """The same top, of whose vertices only one touches."""
    return Top(
        top.vertices[i : i + 1],
        top.normals,
        top.offsets,
        top.corners,
        top.edge_faces,
        top.edge_heights,
        top.edge_inertias,
        top.mass,
        top.moments,
        top.radius,
    )


@compiled
def run_top_tangent(
    top: Top,
    law: Law,
    plane: Plane,
    start: Array,
    start_time: float,
    times: Array,
    sequence: Indices,
    free: bool,
    impact_cap: int,
    seed: Array,
    sources: Sources,
) -> tuple[int, Array, Array, Array, Array]:
    """As `kernels.run_tangent`, for smooth impacts of a top. `start` (13,) as for `run_top`; `seed` (12, 12 + m) and all
    derivatives are of the centre of mass, and of L where those of a spherical top are of ω."""
    y = _with_momentum(top, start)
    n, columns = times.shape[0], seed.shape[1]
    poses, jacobian = np.empty((n, 7)), np.empty((n, 6, columns))
    log, dtimes = np.empty((16, ROW)), np.empty((16, columns))
    tangent, there, pose = seed.copy(), np.empty((12, columns)), np.empty(13)
    now, before, shown = np.empty(13), np.empty(13), np.empty(13)
    stages, room, pull = np.empty((14, 8)), np.empty((14, 22)), np.zeros(columns)
    pull[12:] = sources.inertia
    chi = law.parameters[0]
    slow = 0.0 if chi >= 1.0 else FINE.switch * sqrt(plane.g * top.radius)
    last = times[n - 1] if n > 0 else start_time
    time, done, impacts, ending, fresh = start_time, 0, 0, TIME_REACHED, True
    while True:
        hit, dt, ends = -1, inf, False
        if not free and impacts == sequence.shape[0]:
            ends = True
        elif free:
            ends = time >= last
            if not ends:
                dt, hit, velocity, acceleration = next_event(
                    top, plane, FINE, y, time, last - time, -1, -1, stages, now
                )
                if hit >= 0 and (velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)):
                    ends, ending = True, CHATTER
                elif hit >= 0 and impacts >= impact_cap:
                    ends, ending = True, IMPACT_CAP
        else:
            vertex = sequence[impacts]
            below = -1e-12 * top.radius
            sunk = _clearance(top, plane, y, time, vertex) < below
            if fresh and sunk and _approach(top, plane, y, time, vertex) < 0.0:
                dt, hit = _crossed_before(top, plane, y, time, vertex, stages, now), vertex
                ends = not dt <= 0.0
            else:
                dt, hit, velocity, _ = next_event(_only(top, vertex), plane, FINE, y, time, inf, -1, -1, stages, now)
                if hit >= 0:
                    hit = vertex
                    ends = velocity >= 0.0 or _clearance(top, plane, now, time + dt, vertex) < below
            if ends:
                ending = NO_TOUCH
        while done < n and (ends or times[done] < time + dt):
            pose[:], there[:] = y, tangent
            _carry(top, plane, pose, times[done] - time, sources, there, pull, room)
            poses[done] = pose[:7]
            jacobian[done] = there[:6]
            done += 1
        if ends:
            return ending, poses, jacobian, log[:impacts], dtimes[:impacts]
        _carry(top, plane, y, dt, sources, tangent, pull, room)
        time += dt
        fresh = hit >= 0
        if hit < 0:
            continue
        if impacts == log.shape[0]:
            log, dtimes = _room_for(log, impacts), _room_for(dtimes, impacts)
        _with_spin(top, y, before)
        _strike_tangent(top, plane, chi, y, time, hit, sources, tangent, pull, dtimes[impacts])
        _with_spin(top, y, shown)
        log[impacts, 0], log[impacts, 1] = time, hit
        log[impacts, 2:15] = before
        log[impacts, 15:21] = shown[7:13]
        log[impacts, 21], log[impacts, 22] = -1.0, -1.0
        impacts += 1


@compiled
def coasted(top: Top, start: Array, delays: Array) -> Array:
    """Quaternions (n, 4) of the principal axes `delays` (n,) [s], of either sign, after a flight began with `start`
    (13,), a state as for `run_top`."""
    y, plane, time = np.empty(13), LEVEL, 0.0
    out, stages, now = np.empty((delays.shape[0], 4)), np.empty((14, 8)), np.empty(13)
    for n in range(delays.shape[0]):
        y[:] = _with_momentum(top, start)
        spin = sqrt(2.0 * _turning_energy(top, y) / top.moments[0])
        steps = max(1, ceil(abs(delays[n]) * spin / TURN_RAD))
        for _ in range(steps):
            moved(top, plane, y, time, delays[n] / steps, -1, -1, stages, now)
            y[:] = now
        out[n] = y[3:7]
    return out
