"""Vectors between the axes of the table and the principal axes of an asymmetric body, and its angular velocity.

The state of an asymmetric body has the angular momentum L in place of ω. With the rotation R from body axes to table axes and
the principal moments I, ω = W L with W = R I⁻¹ Rᵀ.
"""

from __future__ import annotations

from ..compiled import inner
from .types import Array, AsymmetricBody


@inner
def to_table_axes(y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """A vector of body axes in table axes, by the quaternion of a state (13,)."""
    w, x, z, v = y[3], y[4], y[5], y[6]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    return a + w * tx + z * tz - v * ty, b + w * ty + v * tx - x * tz, c + w * tz + x * ty - z * tx


@inner
def to_body_axes(y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """A vector of table axes in body axes, by the quaternion of a state (13,)."""
    w, x, z, v = y[3], -y[4], -y[5], -y[6]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    return a + w * tx + z * tz - v * ty, b + w * ty + v * tx - x * tz, c + w * tz + x * ty - z * tx


@inner
def vertical_in_body(y: Array) -> tuple[float, float, float]:
    """The vertical in body axes: third row of the rotation."""
    w, a, b, c = y[3], y[4], y[5], y[6]
    return 2.0 * (a * c - w * b), 2.0 * (b * c + w * a), 1.0 - 2.0 * (a * a + b * b)


@inner
def body_angular_velocity(body: AsymmetricBody, y: Array) -> tuple[float, float, float]:
    """ω [rad/s] in body axes: I⁻¹ Rᵀ L."""
    a, b, c = to_body_axes(y, y[10], y[11], y[12])
    return a / body.moments[0], b / body.moments[1], c / body.moments[2]


@inner
def angular_velocity_of(body: AsymmetricBody, y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """W x, in table axes: the angular velocity that an angular momentum x = (a, b, c) makes."""
    p, q, r = to_body_axes(y, a, b, c)
    return to_table_axes(y, p / body.moments[0], q / body.moments[1], r / body.moments[2])


@inner
def to_angular_velocity(body: AsymmetricBody, y: Array, out: Array) -> None:
    """The state with ω [rad/s, table axes] in place of L, into `out` (13,)."""
    p, q, r = body_angular_velocity(body, y)
    out[:] = y
    out[10], out[11], out[12] = to_table_axes(y, p, q, r)


@inner
def to_angular_momentum(body: AsymmetricBody, state: Array) -> Array:
    """The inverse of `to_angular_velocity`, as a new state."""
    y = state.copy()
    p, q, r = to_body_axes(y, y[10], y[11], y[12])
    y[10], y[11], y[12] = to_table_axes(state, body.moments[0] * p, body.moments[1] * q, body.moments[2] * r)
    return y
