"""Records, codes and constants of the compiled kernels.

A state is an array (13,): position [m], quaternion wxyz, velocity [m/s], angular velocity [rad/s]. All of them are in the
axes of the table, z along its normal, and of the centre of mass. Heights count from the radius of rounded corners.

A contact is a pair of numbers (i, j): (-1, -1) nothing is held, (i, -1) one vertex, (i, j) two, (i, -2) a face, and with
friction (., -3) the set of vertices in `active`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ..compiled import int64, truth
from ..world import GRAVITY_M_S2

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Vector = tuple[float, float, float]
Matrix6 = tuple[float, float, float, float, float, float]
"""A symmetric 3 × 3 matrix: xx, xy, xz, yy, yz, zz."""


# --- Dice ---


class Body(NamedTuple):
    """A die with the same moment of inertia about every axis through its centre of mass."""

    vertices: Array
    """(n, 3) [m] from the centre of mass, body axes; of the inner solid where corners are rounded."""
    normals: Array
    """(faces, 3) outward."""
    plumb_normals: Array
    """(faces, 3) normals over the distances of their planes. The plumb line from the centre of mass goes through the face
    for which this points down most."""
    barrier_heights: Array
    """(faces,) [m] height of the centre of mass above which the die can leave each face."""
    mass: float
    """[kg]."""
    inertia: float
    """[kg m²]."""
    radius: float
    """[m] of the farthest vertex."""
    safe_tilt_cosines: Array
    """(n,) cosine of the largest tilt from the vertical, of the line from each vertex to the centre of mass, at which no
    other vertex can be as low."""
    corner_radius: float
    """[m] of the rounded corners."""


class AsymmetricBody(NamedTuple):
    """A die with any inertia tensor, in its principal axes about the centre of mass."""

    vertices: Array
    """(n, 3) [m]; of the inner solid where corners are rounded."""
    normals: Array
    """(faces, 3) outward."""
    offsets: Array
    """(faces,) [m] of the planes from the centre of mass."""
    corners: Indices
    """(faces, most) vertices of each face, counter-clockwise from outside, -1 beyond its last."""
    edge_faces: Indices
    """(e, 2) the faces that meet in each edge."""
    edge_heights: Array
    """(e,) [m] distance of the nearest point of each edge."""
    edge_inertias: Array
    """(e,) [kg m²] the largest moment of inertia about a line from the centre of mass through a point of the edge."""
    mass: float
    """[kg]."""
    moments: Array
    """(3,) [kg m²], ascending."""
    radius: float
    """[m] of the farthest vertex."""
    safe_tilt_cosines: Array
    """(n,) as of `Body`; above 1 for a vertex that lies on no axis of symmetry of the inertia."""
    corner_radius: float
    """[m] by which the touching point lies below a vertex; 0 for a sharp die."""


# --- Impact laws ---


class SmoothLaw(NamedTuple):
    """An impact law without friction."""

    code: int
    parameters: Array
    """(k,), the restitution first."""


class RoughLaw(NamedTuple):
    """An impact law with friction: a type of its own, so that a throw without it does not compile it."""

    code: int
    parameters: Array
    """(k,), the restitution first, then the coefficient of friction."""


Law = SmoothLaw | RoughLaw

SMOOTH, COULOMB, SMOOTH_BY_SPEED, COULOMB_BY_SPEED, COULOMB_FADING = 0, 1, 2, 3, 4
"""Codes of the laws. Parameters: (χ), (χ, μ, ending), (χ₀, speed scale, exponent), (χ₀, μ, ending, scale, exponent), and
of the last (χ₀, μ₀, ending, scale and exponent of χ, scale and exponent of μ)."""

LAW_CODES = (SMOOTH, COULOMB, SMOOTH_BY_SPEED, COULOMB_BY_SPEED, COULOMB_FADING)

NEWTON, POISSON, STRONGE, ALGEBRAIC = 0, 1, 2, 3
"""What ends an impact with friction: the ratio of normal velocities, of impulses, or of works; or the impulse as a whole, which
no course of the slip leads to (`friction_impulse.algebraic_impulse`)."""


def law_of(code: int, parameters: Array) -> Law:
    """A law by its code and parameters; a friction of zero gives the law without friction, by speed or not."""
    if code in (COULOMB, COULOMB_BY_SPEED, COULOMB_FADING) and parameters[1] > 0.0:
        return RoughLaw(code, parameters)
    if code == COULOMB:
        return SmoothLaw(SMOOTH, parameters[:1].copy())
    if code in (COULOMB_BY_SPEED, COULOMB_FADING):
        return SmoothLaw(SMOOTH_BY_SPEED, parameters[[0, 3, 4]])
    return SmoothLaw(code, parameters)


def has_friction(law: Law) -> bool:
    """Whether the law has friction."""
    return isinstance(law, RoughLaw)


@overload(has_friction, strict=False)
def _has_friction(law: Any) -> Any:
    """A constant of the type of the law, so that the compiler drops the branch that is not taken."""
    rough = law.instance_class is RoughLaw
    return lambda law: rough


# --- The table ---


class Plane(NamedTuple):
    """The table in its own axes: gravity is (gx, gy, -g) [m/s²], and its height is A sin(rate t + phase)."""

    gx: float
    gy: float
    g: float
    amplitude: float
    """A [m]."""
    rate: float
    """[rad/s]."""
    phase: float
    """[rad]."""


class PlaneInAir(NamedTuple):
    """A table in air, which slows the centre of mass by -k |v| v: a type of its own, so that a throw in vacuum does not compile
    it."""

    gx: float
    gy: float
    g: float
    amplitude: float
    rate: float
    phase: float
    """These six as of `Plane`."""
    drag: float
    """k [1/m], above 0."""


LEVEL = Plane(0.0, 0.0, GRAVITY_M_S2, 0.0, 0.0, 0.0)
"""A level table at rest."""


def has_air(plane: Plane | PlaneInAir) -> bool:
    """Whether the die moves against drag."""
    return isinstance(plane, PlaneInAir)


@overload(has_air, strict=False)
def _has_air(plane: Any) -> Any:
    """A constant of the type of the plane, as that of `has_friction`."""
    in_air = plane.instance_class is PlaneInAir
    return lambda plane: in_air


# --- Precision ---


class Precision(NamedTuple):
    """Where speed is traded for accuracy."""

    contact_tolerance: float
    """[m] a vertex this near the table touches; 0 for what rounding allows."""
    slowest_bounce: float
    """Speed of the slowest bounce that is simulated before the vertex is held, in units of √(g R)."""
    step_turn: float
    """[rad] by which a die in held contact turns in one step of the integration."""
    sweep_tolerance: float = 1e-12
    """Change of a contact velocity in one sweep over contacts with friction, as a part of the largest contact velocity,
    below which the sweeps end."""


FINE = Precision(0.0, 1e-6, 0.3)
"""The default, as exact as double precision allows; measured in `benchmarks/throws.py`."""

ROUNDING_BOUND = 16.0 * 2.220446049250313e-16
"""Rounding of a height as a part of its largest term: it is a sum of some ten products, each off by half a unit in the
last place."""

STANDING_HEIGHT = 1e-10
"""Height of a slow vertex below which it counts as standing on the table, as a part of the circumradius: far above the
height of the slowest bounces that are simulated, and no more than 1e-10 of the energy."""


# --- Endings and the log ---

RESTED, TIME_REACHED, IMPACTS_REACHED, CHATTER, IMPACT_CAP, NO_TOUCH, SPINNING, TIMED_OUT, BALANCED = range(9)
"""How the kernels end; `throw.Ending` says the same in sentences. Only derivatives of a throw end with CHATTER (bounces
follow one another without end) or NO_TOUCH (the prescribed vertex never comes down)."""

NOT_ENDED = int64(-1)
"""Code where nothing has ended the throw: it goes on."""

LOG_COLUMNS = 24
"""Columns of a logged event: time, vertex (-1: no impact), position (3), quaternion (4), velocities before (6) and after
(6), the contact (i, j) that is held from then on, and the bits of the vertices that struck at this instant, 0 where that was
one, and negative where they strike one after the other. With friction i has the bits of the held vertices set, and j = -3. A
face of an asymmetric body is held as (row of the face, -2), that of another as (a vertex of it, -2)."""

APPROACHING = 1e-9
"""Speed of approach, as a part of the fastest, from which a vertex that touches at the same instant strikes too: rounding."""

KNOT_COLUMNS = 15
"""Columns of a knot, the state at the beginning of a step in held contact: event that began the contact, time, state."""


# --- A throw ---


class Setup(NamedTuple):
    """What the throws of one kind have in common."""

    body: Any
    """Body or AsymmetricBody."""
    law: Law
    plane: Any
    """Plane or PlaneInAir."""
    precision: Precision


class Limits(NamedTuple):
    """What ends a throw before the die rests."""

    duration: float
    """[s]."""
    impacts: int
    """Number of impacts."""
    impact_cap: int
    """The same, reported as an end of its own."""
    stop_when_decided: bool
    """Whether the throw ends once its face is decided."""


class Contact(NamedTuple):
    """A die and the table that it touches, by the contact (i, j)."""

    body: Any
    """Body or AsymmetricBody."""
    plane: Any
    """Plane or PlaneInAir."""
    i: int
    j: int


class Knots(NamedTuple):
    """The knots that are recorded of a throw; `log.with_knot` adds one."""

    rows: Array
    """(most, KNOT_COLUMNS), of which the first `used` count."""
    used: int
    event: int
    """The event that began the present motion; -1: the release."""
    keep: bool
    """Whether any knot is recorded."""


# --- Constants that kernels hand on; see `compiled` ---

NONE = int64(-1)
"""No vertex, no event."""

SLIDING = int64(-3)
"""The j of a contact with friction."""

FORCE_I, FORCE_J, NO_EVENT = int64(-1), int64(-2), int64(-3)
"""Events of held contact besides the touch of a vertex, which goes by its number: the force on vertex i or j vanishes."""

ZERO, ONE, TANGENT_ROWS = int64(0), int64(1), int64(12)
"""TANGENT_ROWS is the number of rows of a derivative: of position, rotation vector, velocity and angular velocity."""

NO_LIMIT = int64(9223372036854775807)
"""As a number of impacts: no limit."""

TRUE, FALSE = truth(True), truth(False)
