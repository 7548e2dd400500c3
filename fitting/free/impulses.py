"""Single bounces: what two neighbouring flights show of the impact between them, with no impact law.

The vertex that touches is at r from the centre, and its vertical velocity is u = v_z + ω_x r_y - ω_y r_x. With u before
and u' after, at the instant when the first flight brings the vertex to the table, the apparent restitution is

    χ = -u'/u.

A ratio of two measured numbers has no standard error if the denominator may be zero. Its interval is Fieller's (J. R.
Stat. Soc. B 16, 175, 1954): all χ for which u' + χ u does not differ from zero at the given level. It may be unbounded,
and is then reported as NaN.

The impulse is S = m Δv for any law. It gives the ratio of tangential to normal impulse, |S_t|/S_z, which Coulomb
friction limits to μ and sliding makes equal to μ, and the energy lost, E - E'. The interval of the ratio is Fieller's
along the measured direction of S_t, and begins at 0 where S_t may vanish. That of the energy is by linear propagation,
since the energy is a smooth function of both states.

The smooth impact (Kapitaniak et al., Chaos 22, 047504, 2012, Eqs 6 to 8) adds that the impulse is vertical: v_x, v_y
and ω_z stay, and J Δω = m Δv_z (r × ẑ). These five numbers, in sigmas, test it.

With rounded corners the contact is the lowest point of a sphere inscribed at the corner, and r ends there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, stdtrit

from ...model.die import Die
from ...model.errors import InputError
from ...model.rotations import matrix_from_quat
from ...model.throw import Flight, Impact, State, energy_J, touching_vertices
from ...tracking.flights import perturbed, transition_matrix
from ..estimation import normal_quantile
from .flights import FreeFlights

Array = NDArray[np.float64]

_SMOOTH = slice(2, 7)
"""Of `_impact_numbers`: what a smooth impact sets to zero."""

_CHANGE = [2, 3, 7]
"""Of `_impact_numbers`: the change of velocity."""

_LOST = 8
"""Of `_impact_numbers`: the energy lost."""

_STEPS = np.repeat([1e-7, 1e-6, 1e-4, 1e-2], 3)
"""[m, rad, m/s, rad/s] steps of the central differences over a state: far above rounding, far below curvature."""

_PLAUSIBLE_CHI = (-0.5, 1.5)
"""χ of a bounce beyond which its vertex or its flights are wrong."""

_MAX_TOUCH_SHIFT_S = 2e-3
"""Largest distance of the computed touch from the measured instant: a few frames."""

_NEWTON_STEPS = 8
"""Steps to the touch; each squares the error."""

_TOUCH_TOLERANCE_S = 1e-12
"""Step at which the touch is found."""


@dataclass(frozen=True, eq=False)
class Bounce:
    """One impact between two flights. Sigmas and bounds are NaN for flights without covariance."""

    time_s: float
    """When the flight before brings the contact point to the table."""
    vertex: int
    chi: float
    """Apparent restitution."""
    chi_low: float
    chi_high: float
    """Fieller's interval; NaN where it is unbounded."""
    chi_sigma: float
    """By linear propagation."""
    normal_velocity_before_m_s: float
    normal_velocity_after_m_s: float
    impulse_N_s: Array
    """(3,) on the die, world axes: m Δv."""
    impulse_covariance: Array
    """(3, 3) [N² s²]."""
    impulse_ratio: float
    """Tangential impulse over normal impulse; NaN where the normal one does not point up."""
    impulse_ratio_low: float
    impulse_ratio_high: float
    energy_lost_J: float
    energy_lost_low_J: float
    energy_lost_high_J: float
    energy_before_J: float
    energy_after_J: float
    smooth_sigmas: float
    """Root mean square of the five numbers that the smooth impact sets to zero, each in sigmas, decorrelated."""


def apparent_restitution(
    die: Die, before: Flight, after: Flight, time_s: float, vertex: int, *, level: float = 0.95
) -> Bounce:
    """The impact near `time_s` at a vertex, from the flights on either side and their covariances.

    Raises ValueError for a vertex that the die does not have.
    """
    if not 0 <= vertex < len(die.solid.vertices):
        raise InputError(f"vertex = {vertex}: wanted an index from 0 to {len(die.solid.vertices) - 1}")
    touch_s = _touch_time(die, before, time_s, vertex)
    values = _impact_numbers(die, before, after, touch_s, vertex)
    covariance = _covariance(die, before, after, touch_s, vertex)
    u, u_after = float(values[0]), float(values[1])
    low, high = fieller(u, u_after, covariance[:2, :2], level)
    gradient = np.array([u_after / u**2, -1.0 / u])
    z = normal_quantile(level)
    impulse, of_impulse = die.mass_kg * values[_CHANGE], die.mass_kg**2 * covariance[np.ix_(_CHANGE, _CHANGE)]
    ratio, ratio_low, ratio_high = _impulse_ratio(impulse, of_impulse, level)
    lost, lost_sigma = float(values[_LOST]), float(np.sqrt(covariance[_LOST, _LOST]))
    state, next_state = before.at(touch_s), after.at(touch_s)
    return Bounce(
        time_s=touch_s,
        vertex=vertex,
        chi=-u_after / u,
        chi_low=low,
        chi_high=high,
        chi_sigma=float(np.sqrt(gradient @ covariance[:2, :2] @ gradient)),
        normal_velocity_before_m_s=u,
        normal_velocity_after_m_s=u_after,
        impulse_N_s=impulse,
        impulse_covariance=of_impulse,
        impulse_ratio=ratio,
        impulse_ratio_low=ratio_low,
        impulse_ratio_high=ratio_high,
        energy_lost_J=lost,
        energy_lost_low_J=lost - z * lost_sigma,
        energy_lost_high_J=lost + z * lost_sigma,
        energy_before_J=energy_J(die, state, before.gravity_m_s2),
        energy_after_J=energy_J(die, next_state, after.gravity_m_s2),
        smooth_sigmas=_root_mean_square(values[_SMOOTH], covariance[_SMOOTH, _SMOOTH]),
    )


def measure_bounces(
    die: Die, free: FreeFlights, impacts: Sequence[Impact], begin: int = 0, end: int | None = None
) -> tuple[Bounce | None, ...]:
    """The impacts from `begin` up to `end`; None for each that is not at one known vertex between two fitted flights.

    The covariances are scaled up where the frames scatter more than they state. A χ that tracking has measured with its
    interval is kept: tracking joins the flights at the impact and does not need the height of the table.
    """
    bounces: list[Bounce | None] = []
    scale = max(1.0, free.variance)
    for impact, before, after in list(zip(impacts, free.flights, free.flights[1:], strict=False))[begin:end]:
        if before is None or after is None or impact.contact != "vertex" or len(impact.vertices) != 1:
            bounces.append(None)
            continue
        pair = (_scaled(before.flight, scale), _scaled(after.flight, scale))
        bounces.append(_as_measured(apparent_restitution(die, *pair, impact.time_s, impact.vertices[0]), impact))
    return tuple(bounces)


def fieller(u: float, u_after: float, covariance: Array, level: float) -> tuple[float, float]:
    """Bounds of -u_after/u from the covariance (2, 2) of both; (NaN, NaN) where the interval is unbounded.

    They solve (u' + χ u)² = z² (C₂₂ + 2 χ C₁₂ + χ² C₁₁).
    """
    z2 = normal_quantile(level) ** 2
    a = u**2 - z2 * covariance[0, 0]
    b = u * u_after - z2 * covariance[0, 1]
    c = u_after**2 - z2 * covariance[1, 1]
    discriminant = b * b - a * c
    if not (a > 0.0 and discriminant >= 0.0):
        return np.nan, np.nan
    root = np.sqrt(discriminant)
    return float((-b - root) / a), float((-b + root) / a)


def _impulse_ratio(impulse: Array, covariance: Array, level: float) -> tuple[float, float, float]:
    """|S_t|/S_z and its bounds; NaN where the impulse does not point up."""
    tangential, upward = float(np.hypot(impulse[0], impulse[1])), float(impulse[2])
    if not upward > 0.0:
        return np.nan, np.nan, np.nan
    along = np.array([impulse[0], impulse[1], 0.0]) / tangential if tangential > 0.0 else np.array([1.0, 0.0, 0.0])
    turn = np.stack([np.array([0.0, 0.0, 1.0]), -along])
    low, high = fieller(upward, -tangential, turn @ covariance @ turn.T, level)
    if np.isfinite(low):
        # Errors in two directions make a zero vector look long. Along the measured direction alone, the interval would
        # miss 0 three times as often as stated.
        squared = float(impulse[:2] @ np.linalg.pinv(covariance[:2, :2], hermitian=True) @ impulse[:2])
        low = 0.0 if squared <= chdtri(2, 1.0 - level) else max(0.0, low)
    return tangential / upward, low, high


def common_restitution(bounces: Sequence[Bounce | None], *, level: float = 0.95) -> tuple[float, float, float] | None:
    """One χ for several bounces, with its interval; None where no bounce has a bounded interval of its own.

    A weighted mean with a variance between bounces beside their own errors (DerSimonian & Laird, Control. Clin. Trials
    7, 177, 1986). Its standard error is by Knapp & Hartung (Stat. Med. 22, 2693, 2003) and Student's t, and never
    smaller than the errors of the bounces themselves allow. A single bounce keeps its own interval.
    """
    used = [
        b for b in bounces if b is not None and np.isfinite(b.chi_low) and _PLAUSIBLE_CHI[0] < b.chi < _PLAUSIBLE_CHI[1]
    ]
    if not used:
        return None
    if len(used) == 1:
        return used[0].chi, used[0].chi_low, used[0].chi_high
    chi, variance = np.array([b.chi for b in used]), np.array([b.chi_sigma**2 for b in used])
    weight = 1.0 / variance
    excess = float(weight @ (chi - weight @ chi / weight.sum()) ** 2) - (len(used) - 1)
    between = max(0.0, excess / float(weight.sum() - (weight**2).sum() / weight.sum()))
    weight = 1.0 / (variance + between)
    mean = float(weight @ chi / weight.sum())
    scatter = float(weight @ (chi - mean) ** 2) / (len(used) - 1)
    sigma = np.sqrt(max(1.0, scatter) / weight.sum())
    # A variance estimated from few bounces is itself uncertain; without one the errors are known and normal.
    reach = float(stdtrit(len(used) - 1, 0.5 + level / 2.0)) if between > 0.0 else normal_quantile(level)
    return mean, mean - reach * sigma, mean + reach * sigma


def _as_measured(bounce: Bounce, impact: Impact) -> Bounce:
    """The bounce with the χ that tracking has measured, if it has (95 %)."""
    if not np.isfinite([impact.chi, impact.chi_low, impact.chi_high]).all() or impact.chi_high <= impact.chi_low:
        return bounce
    sigma = (impact.chi_high - impact.chi_low) / (2.0 * normal_quantile(0.95))
    return replace(bounce, chi=impact.chi, chi_low=impact.chi_low, chi_high=impact.chi_high, chi_sigma=sigma)


def _scaled(flight: Flight, variance: float) -> Flight:
    covariance = None if flight.covariance is None else flight.covariance * variance
    return replace(flight, covariance=covariance)


def contact_arm(die: Die, rotation: Array, vertex: int) -> Array:
    """From the centre to the contact point (3,) [m], world axes, for a vertex turned to the table."""
    return np.asarray(rotation @ touching_vertices(die)[vertex] - np.array([0.0, 0.0, die.corner_radius_m]))


def normal_velocity(state: State, arm: Array) -> float:
    """Vertical velocity [m/s] of a point at `arm` (3,) from the centre."""
    return float(state.velocity_m_s[2] + state.omega_rad_s[0] * arm[1] - state.omega_rad_s[1] * arm[0])


def _touch_time(die: Die, before: Flight, near_s: float, vertex: int) -> float:
    """When the flight brings the contact point to the table: Newton's method from the measured instant; that instant
    where the method leads away by more than `_MAX_TOUCH_SHIFT_S`.
    """
    t = near_s
    for _ in range(_NEWTON_STEPS):
        state = before.at(t)
        arm = contact_arm(die, state.rotation, vertex)
        u = normal_velocity(state, arm)
        if u >= 0.0:
            return near_s
        step = -(float(state.position_m[2]) + float(arm[2])) / u
        t += step
        if abs(t - near_s) > _MAX_TOUCH_SHIFT_S:
            return near_s
        if abs(step) < _TOUCH_TOLERANCE_S:
            break
    return t


def _impact_numbers(die: Die, before: Flight, after: Flight, time_s: float, vertex: int) -> Array:
    """(9,): u, u', the five numbers that a smooth impact sets to zero, the change of v_z, and the energy lost [J].

    The instant shifts to where the (varied) flight before touches; one Newton step is exact to first order.
    """
    state = before.at(time_s)
    arm = contact_arm(die, state.rotation, vertex)
    state = before.at(time_s - (float(state.position_m[2]) + float(arm[2])) / normal_velocity(state, arm))
    arm = contact_arm(die, state.rotation, vertex)
    later = after.at(state.time_s)
    # Either orientation is an estimate of the same one: each velocity is taken with the arm of its own flight.
    arm_after = contact_arm(die, matrix_from_quat(later.quaternion), vertex)
    dv, dw = later.velocity_m_s - state.velocity_m_s, later.omega_rad_s - state.omega_rad_s
    lever = np.cross(arm, [0.0, 0.0, die.mass_kg * float(dv[2])])
    pushed = state.rotation @ np.linalg.solve(die.tensor_kg_m2, state.rotation.T @ lever)
    return np.array(
        [
            normal_velocity(state, arm),
            normal_velocity(later, arm_after),
            dv[0],
            dv[1],
            *(dw - pushed),
            dv[2],
            energy_J(die, state, before.gravity_m_s2)
            - energy_J(die, replace(later, position_m=state.position_m), before.gravity_m_s2),
        ]
    )


def _covariance(die: Die, before: Flight, after: Flight, time_s: float, vertex: int) -> Array:
    """Covariance (9, 9) of `_impact_numbers`, by central differences over both states; NaN without covariances."""
    if before.covariance is None or after.covariance is None:
        return np.full((9, 9), np.nan)
    total = np.zeros((9, 9))
    at_touch = [_carried(flight, time_s) for flight in (before, after)]
    for which, flight in enumerate(at_touch):
        assert flight.covariance is not None
        gradient = np.empty((9, 12))
        for k, step in enumerate(_STEPS):
            change = np.zeros(12)
            change[k] = step
            ends = []
            for sign in (1.0, -1.0):
                pair = list(at_touch)
                pair[which] = replace(flight, start=perturbed(flight.start, sign * change))
                ends.append(_impact_numbers(die, pair[0], pair[1], time_s, vertex))
            gradient[:, k] = (ends[0] - ends[1]) / (2.0 * step)
        total += gradient @ flight.covariance @ gradient.T
    return total


def _carried(flight: Flight, time_s: float) -> Flight:
    """The same flight with state and covariance at another instant, so that small steps there stay small."""
    assert flight.covariance is not None
    carry = transition_matrix(flight, time_s)
    return replace(flight, start=flight.at(time_s), covariance=carry @ flight.covariance @ carry.T)


def _root_mean_square(values: Array, covariance: Array) -> float:
    """√(xᵀ C⁻¹ x / n)."""
    if not np.isfinite(covariance).all():
        return float("nan")
    sigma = np.sqrt(np.diag(covariance))
    scaled = np.linalg.solve(covariance / np.outer(sigma, sigma), values / sigma)
    return float(np.sqrt(max(0.0, float((values / sigma) @ scaled)) / len(values)))
