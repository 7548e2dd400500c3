"""model.engine.types."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from ..compiled import int64, truth
from ..world import GRAVITY_M_S2

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
    plumb_normals: Array
    """(faces, 3) normals over the distances of their planes: the plumb line from the centre goes through the face for
    which this points down most; `bodies.plumb_normals`."""
    barrier_heights: Array
    """(faces,) [m]: what the centre must climb to leave each face, `bodies.edge_barriers_m`."""
    mass: float
    inertia: float
    radius: float
    """[m] of the circumscribed sphere."""
    safe_tilt_cosines: Array
    """(n,) the cosine of how far the line from each vertex to the centre may lean from the vertical, before another
    vertex can be the lower one; `bodies.safe_tilt_cosines`."""
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

RESTED, TIME_REACHED, IMPACTS_REACHED, CHATTER, IMPACT_CAP, NO_TOUCH, SPINNING, TIMED_OUT, BALANCED = range(9)
"""How the kernels end; `simulate.Ending` says the same in sentences. CHATTER and NO_TOUCH are of the tangent alone."""

NOT_ENDED = int64(-1)
"""How held contact ends that goes on in flight."""

LOG_COLUMNS = 23
"""Columns of a logged event: time, vertex (-1: nothing strikes), position (3), quaternion (4), velocities before (6)
and after (6), and what is held from then on: (-1, -1) nothing, (i, -1) a vertex, (i, j) two, (i, -2) a face, and
(bits, -3) the vertices with those bits set, with friction."""

TIMEOUT = 1000.0
"""A throw is given up as a top after this many √(R/g), where it is not proved to be one for ever; at χ above 0.9, where
every die takes long to calm down, 0.1/(1 - χ) times as late."""

STANDING_HEIGHT = 1e-10
"""Part of the circumradius within which a slow vertex counts as standing on the table: far above the height of the
slowest bounces that are simulated, and no more than 1e-10 of the energy."""

ROUNDING_BOUND = 16.0 * 2.220446049250313e-16
"""A height is a sum of some ten products, each off by half a unit in the last place of its largest term."""

TAYLOR_ORDER = 20
"""Of the Taylor series: e^-35 of accuracy costs e^(35/N) steps of N² operations each, least at N = 17."""

NEGLIGIBLE_SLIP = 1e-16
"""Part of the velocities at hand below which a slip, or its turning, is rounding."""

MAX_SLIP_STEPS = 10_000
"""None of 3 · 10⁶ random impacts came to it; the answer then is NaN, rather than none."""

STOPPED, STRAIGHT, TURNS = 0, 1, 2
"""Courses of a slip: none, or along the one direction in which it grows, as if it had just set out; straight to its stop;
neither."""

VX, VY, SPEED, NORMAL, RESTITUTION = int64(0), int64(1), int64(2), int64(3), int64(4)
"""Rows of the series: slip, its size, the normal velocity w, and what restitution is measured by (∫dp or ∫w dp)."""

NONE = int64(-1)
"""No vertex, no event."""

FORCE_I, FORCE_J, NO_EVENT = int64(-1), int64(-2), int64(-3)
"""Events of held contact besides the touch of a vertex, which goes by its number: a vertex is let go."""

ZERO, ONE, TANGENT_ROWS, NO_LIMIT = int64(0), int64(1), int64(12), int64(9223372036854775807)
TRUE, FALSE = truth(True), truth(False)
"""Numbers that kernels hand on; see `compiled`."""

MAX_SWEEPS = 1000
"""Of the Gauss-Seidel method in `friction_step`. Four corners of a die that slides need some 30, rocking ones 100."""

FULL_SWEEPS, LONG_SWEEPS = 100, 500
"""After so many sweeps without an end, each goes 0.7, then 0.4 of its way."""

FRICTION_STANDING_HEIGHT, FRICTION_STEP_PART = 1e-6, 0.1
"""With friction, held contact is followed by a method of low order: part of the circumradius within which its vertices
count as standing on the table, and part of `Precision.turn` that it takes as a step."""

LEVEL = Plane(0.0, 0.0, GRAVITY_M_S2, 0.0, 0.0, 0.0)
"""A level table at rest."""

FINE = Precision(0.0, 1e-6, 0.3)
"""What is used unless something else is asked for; measured in `benchmarks/throws.py`."""

RUNGE_KUTTA_A, RUNGE_KUTTA_B, RUNGE_KUTTA_C = (
    np.ascontiguousarray(DOP853.A[:12, :12]),
    DOP853.B.copy(),
    DOP853.C[:12].copy(),
)
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
