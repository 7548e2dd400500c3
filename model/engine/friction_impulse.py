"""The impulse of an impact with Coulomb friction, integrated along the normal impulse.

The impact takes no time; the normal impulse p is its independent variable (Routh 1905; Darboux 1880; Keller, J. Appl.
Mech. 53, 1, 1986). The contact velocity c = (s ŝ, w), with slip s along the unit vector ŝ and normal velocity w, obeys

    dc/dp = M (ẑ - μ ŝ),    M = [[T, b], [bᵀ, a]]    (contact matrix: an impulse S changes c by M S)

    dw/dp = a - μ b·ŝ = h,    ds/dp = ŝ·b - μ ŝᵀT ŝ = f,    s dφ/dp = t̂·b - μ t̂ᵀT ŝ = g    (φ the angle of ŝ, t̂ ⊥ ŝ).

**Turning slip.** The last equation is singular at s = 0. With dp = s dτ the slip vector v = s ŝ obeys
v' = |v| b - μ T v, which is nearly linear, and analytic as long as v ≠ 0. It is solved by Taylor series in τ of order
`TAYLOR_ORDER`. A step covers a fixed part of the distance to the nearest singularity, so that only rounding limits the accuracy,
and the same polynomials locate every event. Steps in φ would be fewer, but they divide by g, which is zero in every
planar impact.

**Straight slip.** Once s |g| is below rounding, the direction of slip is treated as constant. A displacement v⊥ across an
invariant direction (g = 0) obeys v⊥' = -μ (t̂ᵀT t̂) v⊥, so v⊥ never exceeds s g/(μ t̂ᵀT t̂), whether the direction is stable
or not. From there on, and from the beginning in planar impacts, everything has a closed form. If the slip grows (f > 0),
the direction is that of the unique solution below, because an error along ŝ itself would grow with the slip.

**Towards a stop.** τ goes to infinity while p stays finite. Within a dozen degrees of the direction in which the slip
stops, the remainder is one power series in the angle, used whole if no event lies on it. With steps in τ alone an
impact that sticks takes twice the time.

**After a stop.** The contact sticks if the impulse that holds it, -T⁻¹b per unit p, lies within the friction cone,
|T⁻¹b| ≤ μ. Otherwise it slides on along the ŝ with (μT + f) ŝ = b and f > 0. |(μT + f)⁻¹ b| falls with f from
|T⁻¹b|/μ > 1 to 0, so there is exactly one.

**Jamming.** h < 0 (friction drives the contact into the table) does not last. T a ≥ b bᵀ makes f < 0 wherever h < 0, so
the slip stops, and from then on h is positive, whether the contact sticks (a - bᵀT⁻¹b) or slides (f > 0).

**End of the impact.** Newton: w = -χ w(0). Poisson: the impulse of restitution is χ times that of compression. Stronge
(Proc. R. Soc. A 431, 169, 1990): the work of the normal force in restitution is -χ² times that in compression. Friction
only removes energy, so Stronge's restitution never creates any, whatever the slip does; `benchmarks/impact_energy.py`
counts how often Newton's does. If w passes zero more than once, every part with w < 0 counts as compression and every
other part as restitution.

**Without a course.** The algebraic law (Chatterjee & Ruina, J. Appl. Mech. 65, 939, 1998) says what the impulse is as a whole:
that of the normal restitution, and of what would stop the slip as much as the friction cone allows (`algebraic_impulse`).
"""

from __future__ import annotations

from math import hypot, inf, nan, sqrt
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, inner, int64
from .types import ALGEBRAIC, FALSE, NEWTON, POISSON, STRONGE, Array, Matrix6, Vector

TAYLOR_ORDER = 20
"""Of the series in τ: an accuracy of e^-35 costs e^(35/N) steps of N² operations each, least at N = 17."""

NEGLIGIBLE_SLIP = 1e-16
"""Slip, or turn of it, as a part of the velocities at hand, below which it is rounding."""

MAX_SLIP_STEPS = 10_000
"""Steps of a slip that turns, after which the impulse is NaN. None of 3 · 10⁶ random impacts needed as many."""

STOPPED, STRAIGHT, TURNS = 0, 1, 2
"""What the slip does next. STOPPED: it has ended, or sets out along the one direction in which it grows. STRAIGHT: it keeps its
direction until it stops. TURNS: neither."""

VX, VY, SPEED, NORMAL, RESTITUTION = int64(0), int64(1), int64(2), int64(3), int64(4)
"""Rows of the series: the slip, its size, the normal velocity w, and what measures restitution (∫dp, or ∫w dp)."""

TURNING = 1e-3
"""Turn of the slip, as a part of the stiffness across it, from which the slip is followed by the series. A straighter one is
so followed only where its turn is above rounding by TURNS_ABOVE_ROUNDING."""
TURNS_ABOVE_ROUNDING = 30.0

MAX_STOP_ANGLE = 0.25
"""[rad] between the slip and the direction in which it stops, up to which the series in the angle converges fast enough."""

STOP_TERMS = 10.0
"""Last term of that series, in units of rounding, up to which it counts as converged."""


@compiled
def coefficient_at_speed(slowest: float, speed: float, speed_scale: float, exponent: float) -> float:
    """χ or μ of an impact at `speed` ≥ 0 [m/s], from that of the slowest: χ₀ (1 + speed/scale)^-exponent."""
    return float(slowest * (1.0 + speed / speed_scale) ** -exponent)


@inner
def slide_direction(xx: float, xy: float, yy: float, radius: float, dx: float, dy: float) -> tuple[float, float, float]:
    """The unit vector ŝ, and σ ≥ 0, with (radius T + σ) ŝ = d, for |T⁻¹d| > radius.

    Newton's method on 1/|ŝ(σ)|, which is concave and rises: from a σ too small it reaches the root monotonically.
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


@inner
def algebraic_impulse(
    matrix: Matrix6, chi: float, mu: float, cx: float, cy: float, cz: float
) -> tuple[float, float, float]:
    """Impulse of the law of Chatterjee and Ruina with a tangential restitution of 0, on an approaching contact.

    With P = -(w/a) ẑ, which stops the approach, and P + D = -M⁻¹ c, which stops the slip as well, it is (1 + χ) P + κ D with
    κ = 1, or less so that it lies on the friction cone. D does not change w, which becomes -χ w. D and P are orthogonal in the
    metric of M, in which the energy grows with the distance from P + D: the impact creates none, since χ ≤ 1 and κ ≤ 1.
    """
    xx, xy, xz, yy, yz, zz = matrix
    normal = -(1.0 + chi) * cz / zz
    # The slip that P leaves, and what T becomes for impulses that do not change w.
    sx, sy = cx - xz * cz / zz, cy - yz * cz / zz
    a, b, c = xx - xz * xz / zz, xy - xz * yz / zz, yy - yz * yz / zz
    det = a * c - b * b
    dx, dy = (b * sy - c * sx) / det, (b * sx - a * sy) / det
    dz = -(xz * dx + yz * dy) / zz
    size = hypot(dx, dy)
    if size <= mu * (normal + dz):
        return dx, dy, normal + dz
    kappa = mu * normal / (size - mu * dz)
    # Its normal part by the cone: with much friction the sum of the two cancels.
    return kappa * dx, kappa * dy, kappa * size / mu


@compiled(shared=True)
def friction_impulse(
    matrix: Matrix6, chi: float, mu: float, ending: int, cx: float, cy: float, cz: float
) -> tuple[float, float, float]:
    """Impulse [N s] of the table on the contact with velocity (cx, cy, cz) [m/s] before, z the normal.

    `matrix` from `contact_matrix`; `ending` NEWTON, POISSON, STRONGE or ALGEBRAIC. Zero for a contact that does not approach, NaN
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
    if ending == ALGEBRAIC:
        sx, sy, p = algebraic_impulse(matrix, chi, mu, vx, vy, w)
        return size * sx, size * sy, size * p
    goal = -chi * w if ending == NEWTON else 0.0
    sx, sy, p, restituting, ended = 0.0, 0.0, 0.0, False, False
    course = _slip_regime(matrix, mu, vx, vy, abs(w))
    if course == TURNS:
        sx, sy, p, vx, vy, w, restituting, goal, ended, course = _turning_slip(
            ContactLaw(matrix, chi, mu, ending), vx, vy, w, goal
        )
    if not ended and course == STRAIGHT:
        slip = hypot(vx, vy)
        ux, uy = vx / slip, vy / slip
        f = ux * xz + uy * yz - mu * (xx * ux * ux + 2.0 * xy * ux * uy + yy * uy * uy)
        h = zz - mu * (xz * ux + yz * uy)
        dp, w, restituting, goal, ended = _straight_slip(w, h, -slip / f, ending, chi, restituting, goal)
        sx, sy, p = sx - mu * ux * dp, sy - mu * uy * dp, p + dp
    if not ended:
        det = xx * yy - xy * xy
        tx, ty = (xy * yz - yy * xz) / det, (xy * xz - xx * yz) / det
        if hypot(tx, ty) > mu:
            ux, uy, _ = slide_direction(xx, xy, yy, mu, xz, yz)
            tx, ty = -mu * ux, -mu * uy
        dp, w, restituting, goal, ended = _straight_slip(w, zz + xz * tx + yz * ty, inf, ending, chi, restituting, goal)
        sx, sy, p = sx + tx * dp, sy + ty * dp, p + dp
    return size * sx, size * sy, size * p


@inner
def _slip_regime(matrix: Matrix6, mu: float, vx: float, vy: float, size: float) -> int:
    """Which of STOPPED, STRAIGHT and TURNS the slip (vx, vy) does next; `size` is that of the velocities that are rounded."""
    xx, xy, xz, yy, yz, _ = matrix
    slip = hypot(vx, vy)
    if slip <= NEGLIGIBLE_SLIP * size:
        return STOPPED
    ux, uy = vx / slip, vy / slip
    g = ux * yz - uy * xz - mu * ((yy - xx) * ux * uy + xy * (ux * ux - uy * uy))
    across = mu * (xx * uy * uy - 2.0 * xy * ux * uy + yy * ux * ux)
    # A direction off by g/across changes f by rate g/across, and so s for a given p by as much again.
    rate = _rate(matrix, mu)
    turns = (
        abs(g) > TURNING * across
        or slip * abs(g) * rate > TURNS_ABOVE_ROUNDING * NEGLIGIBLE_SLIP * across * across * size
    )
    if turns and abs(g) > TURNS_ABOVE_ROUNDING * NEGLIGIBLE_SLIP * rate:  # a smaller g is rounding itself
        return TURNS
    f = ux * xz + uy * yz - mu * (xx * ux * ux + 2.0 * xy * ux * uy + yy * uy * uy)
    return STRAIGHT if f < 0.0 else STOPPED


@inner
def _rate(matrix: Matrix6, mu: float) -> float:
    """Bound [1/kg] of the rate at which the slip vector changes with τ, up to a factor of 2."""
    return float(hypot(matrix[2], matrix[4]) + mu * max(matrix[0], matrix[3]))


@inner
def _straight_slip(
    w: float, slope: float, limit: float, ending: int, chi: float, restituting: bool, goal: float
) -> tuple[float, float, bool, float, bool]:
    """Integrate at constant dw/dp = `slope`, by `limit` at most; returns dp, w, restituting, goal, and whether the impact ended.

    `goal`: for NEWTON the w to reach; else what restitution may still give back, impulse (POISSON) or work (STRONGE).
    """
    gone = 0.0
    while True:
        zero = -w / slope if w * slope < 0.0 else inf
        if ending == NEWTON:
            ahead, final = (goal - w) / slope if slope > 0.0 else inf, True
        elif not restituting:
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
            goal += -step if restituting else chi * step
        elif ending == STRONGE:
            goal += (-1.0 if restituting else -chi * chi) * step * 0.5 * (w + after)
        gone, w = gone + step, after
        if stopped or final:
            return gone, w, restituting, goal, not stopped
        restituting = not restituting


class ContactLaw(NamedTuple):
    """What governs the impact of one contact."""

    matrix: Matrix6
    """[1/kg], from `contact_matrix`."""
    chi: float
    mu: float
    ending: int
    """NEWTON, POISSON or STRONGE."""


@inner
def _turning_slip(
    law: ContactLaw, vx: float, vy: float, w: float, goal: float
) -> tuple[float, float, float, float, float, float, bool, float, bool, int]:
    """Slide until the slip stops, no longer turns, or the impact ends.

    Returns the impulse (3), the contact velocity (3), the state of `_straight_slip`, and what `_slip_regime` says last.
    """
    matrix, chi, mu, ending = law
    sx, sy, p, restituting = 0.0, 0.0, 0.0, FALSE
    largest, rate = max(matrix[0], matrix[3], matrix[5]), _rate(matrix, mu)
    series = np.empty((5, TAYLOR_ORDER + 1))
    ends = False
    for _ in range(MAX_SLIP_STEPS):
        size = p * largest + abs(w)
        course = _slip_regime(matrix, mu, vx, vy, size)
        if course != TURNS:
            return sx, sy, p, vx, vy, w, restituting, goal, False, course
        if not ends:
            found, dp = _expansion_to_stop(series, matrix, mu, vx, vy, size)
            if found:
                stops, tx, ty, w_stop, left = _stop_before_event(series, law, (vx, vy, w), dp, restituting, goal)
                if stops:
                    return sx + tx, sy + ty, p + dp, 0.0, 0.0, w_stop, restituting, left, False, STOPPED
                ends = restituting or ending == NEWTON
        # Towards a stop the slip must keep its direction as well, or the steps would be longer than it lasts.
        allowed = min(3.0 * NEGLIGIBLE_SLIP * size, 1e-5 * hypot(vx, vy))
        unit = largest / max(size, 1e-200) if ending == STRONGE else largest  # makes work, or impulse, a velocity
        h = _taylor_series(series, law, (vx, vy, w), rate, allowed, unit)
        t, restituting, goal, ended = _follow_series(series, h, ending, chi, restituting, goal)
        sx -= mu * _integral(series, VX, t) / rate
        sy -= mu * _integral(series, VY, t) / rate
        p += _integral(series, SPEED, t) / rate
        vx, vy, w = _value(series, VX, t), _value(series, VY, t), _value(series, NORMAL, t)
        if ended:
            return sx, sy, p, vx, vy, w, restituting, goal, True, course
    return nan, nan, nan, nan, nan, nan, restituting, goal, True, TURNS


@inner
def _expansion_to_stop(
    series: Array, matrix: Matrix6, mu: float, vx: float, vy: float, size: float
) -> tuple[bool, float]:
    """Whether the slip is near enough to the direction in which it will stop, and the dp until then.

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
        if f >= 0.0 or f + across <= 0.0 or abs(turn) > MAX_STOP_ANGLE:
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
    for k in range(TAYLOR_ORDER + 1):
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
    return ahead * abs(term) * max(xx, yy, zz) <= STOP_TERMS * NEGLIGIBLE_SLIP * size, ahead * total


@inner
def _stop_before_event(
    series: Array, law: ContactLaw, velocity: Vector, dp: float, restituting: bool, goal: float
) -> tuple[bool, float, float, float, float]:
    """The end of `_expansion_to_stop`: whether no event of w comes before, the tangential impulse, w and goal there."""
    matrix, chi, mu, ending = law
    vx, vy, w = velocity
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
    if (w_stop <= 0.0) if restituting else (w_stop >= 0.0):
        return False, tx, ty, w_stop, goal
    measured = dp
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
        for k in range(TAYLOR_ORDER + 1):
            known = e_along * root[k] + (e_across * root[k - 1] if k > 0 else 0.0)
            for j in range(1, k + 1):
                known += 2.0 * F[j] * Q[k - j]
            for j in range(2, k + 1):
                known += G[j] * (k - j + 1) * Q[k - j + 1]
            Q[k] = -known / (2.0 * F[0] + k * G[1])
            total += Q[k] * power
            power *= slope
        measured = (w_stop - 0.5 * (zz - xz * ex - yz * ey) * dp) * dp + ahead * ahead * total
    if restituting:
        return measured < goal, tx, ty, w_stop, goal - measured
    return True, tx, ty, w_stop, goal + (chi if ending == POISSON else -chi * chi) * measured


@inner
def _taylor_series(series: Array, law: ContactLaw, velocity: Vector, rate: float, allowed: float, unit: float) -> float:
    """Fill the Taylor coefficients of v' = (|v| b - μTv)/rate and of what follows it; returns how far they hold.

    That is where the last terms of velocities reach `allowed` [m/s].
    """
    matrix, _, mu, ending = law
    vx, vy, w = velocity
    xx, xy, xz, yy, yz, zz = matrix
    a, b = series[VX], series[VY]
    n, normal, measured = series[SPEED], series[NORMAL], series[RESTITUTION]
    a[0], b[0], n[0], normal[0], measured[0] = vx, vy, hypot(vx, vy), w, 0.0
    for k in range(TAYLOR_ORDER):
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
            measured[k + 1] = scale * n[k]
        elif ending == NEWTON:
            measured[k + 1] = 0.0
        else:
            work = 0.0
            for j in range(k + 1):
                work += normal[j] * n[k - j]
            measured[k + 1] = scale * work
    n[TAYLOR_ORDER] = 0.0
    last = max(
        abs(a[TAYLOR_ORDER]), abs(b[TAYLOR_ORDER]), abs(normal[TAYLOR_ORDER]), unit * abs(measured[TAYLOR_ORDER])
    )
    before = max(
        abs(a[TAYLOR_ORDER - 1]),
        abs(b[TAYLOR_ORDER - 1]),
        abs(normal[TAYLOR_ORDER - 1]),
        unit * abs(measured[TAYLOR_ORDER - 1]),
    )
    reach = 100.0  # of e-foldings: where both vanish by chance or underflow
    if last > 0.0:
        reach = min(reach, (allowed / last) ** (1.0 / TAYLOR_ORDER))
    if before > 0.0:
        reach = min(reach, (allowed / before) ** (1.0 / (TAYLOR_ORDER - 1)))
    return float(max(reach, 1e-30))  # where the ratio of a graze underflows


@inner
def _follow_series(
    series: Array, h: float, ending: int, chi: float, restituting: bool, goal: float
) -> tuple[float, bool, float, bool]:
    """Follow the series up to h, or to the end of the impact; returns t, and the state of `_straight_slip`."""
    if ending == NEWTON:
        t = _first_rise(series, 1.0, goal, 0.0, h)
        return (t, True, goal, True) if t >= 0.0 else (h, restituting, goal, False)
    t, measured = 0.0, 0.0
    while True:
        crossing = _first_rise(series, -1.0 if restituting else 1.0, 0.0, t, h)
        to = crossing if crossing >= 0.0 else h
        reached = _value(series, RESTITUTION, to)
        if not restituting:
            goal += (chi if ending == POISSON else -chi * chi) * (reached - measured)
        elif reached - measured >= goal:
            return _root(series, RESTITUTION, 1.0, measured + goal, t, to), restituting, goal, True
        else:
            goal -= reached - measured
        if crossing < 0.0:
            return h, restituting, goal, False
        t, measured, restituting = to, reached, not restituting
        if restituting and goal <= 0.0:
            return t, restituting, goal, True


@inner
def _first_rise(series: Array, sign: float, level: float, start: float, end: float) -> float:
    """The first t in (start, end] at which sign · w rises to sign · level, from below; -1 if it does not.

    w' = s h changes its sign at two angles of the slip at most, so not twice in a step that would matter.
    """
    upper = end
    if sign * (_value(series, NORMAL, end) - level) < 0.0:
        if sign * _slope(series, NORMAL, start) <= 0.0 or sign * _slope(series, NORMAL, end) >= 0.0:
            return -1.0
        low = start
        for _ in range(60):
            middle = 0.5 * (low + upper)
            if sign * _slope(series, NORMAL, middle) > 0.0:
                low = middle
            else:
                upper = middle
        if sign * (_value(series, NORMAL, upper) - level) < 0.0:
            return -1.0
    return _root(series, NORMAL, sign, level, start, upper)


@inner
def _root(series: Array, row: int, sign: float, level: float, low: float, high: float) -> float:
    """Where a row takes the value `level`, which sign · row exceeds at `high`: Newton's method within a bracket."""
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
    total = series[row, TAYLOR_ORDER]
    for k in range(TAYLOR_ORDER - 1, -1, -1):
        total = total * t + series[row, k]
    return float(total)


@inner
def _slope(series: Array, row: int, t: float) -> float:
    """Derivative of a row at t."""
    total = TAYLOR_ORDER * series[row, TAYLOR_ORDER]
    for k in range(TAYLOR_ORDER - 1, 0, -1):
        total = total * t + k * series[row, k]
    return float(total)


@inner
def _integral(series: Array, row: int, t: float) -> float:
    """Integral of a row from 0 to t; its last term belongs to the next order and is left out."""
    total = 0.0
    for k in range(TAYLOR_ORDER - 1, -1, -1):
        total = total * t + series[row, k] / (k + 1)
    return float(total * t)
