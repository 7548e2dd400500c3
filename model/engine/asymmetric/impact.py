"""An impact on a body with any inertia tensor: that of `engine.impact`, with W = R I⁻¹ Rᵀ for 1/J."""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from ...compiled import inner
from ..flight import lever_arm
from ..impact import impulse, restitution_at
from ..inertia import angular_velocity_of, tensor_inertia, tensor_matrix
from ..types import NONE, Array, Contact, Indices, RoughLaw, Setup
from .contact import simultaneous_impact


@inner
def smooth_strike(
    setup: Setup, y: Array, time: float, hit: int, velocity: float, chosen: Indices, n: int, room: Array
) -> None:
    """`strike` of a law without friction: all n at once."""
    body, law, plane, _ = setup
    contact = Contact(body, plane, hit, NONE)
    simultaneous_impact(contact, y, time, velocity, restitution_at(law, velocity), chosen, n, room)


@inner
def rough_strike(
    setup: Setup, y: Array, time: float, hit: int, velocity: float, chosen: Indices, n: int, room: Array
) -> None:
    """`strike` of a law with friction: the one vertex, and the others after it."""
    body, law, _, _ = setup
    x, r, level = lever_arm(body.vertices[hit], y)
    z = level - body.corner_radius
    ox, oy, oz = angular_velocity_of(body, y, y[10], y[11], y[12])
    c = (y[7] + oy * z - oz * r, y[8] + oz * x - ox * z, velocity)
    sx, sy, sz = impulse(law, tensor_matrix(tensor_inertia(body, y), x, r, z), c)
    y[7] += sx / body.mass
    y[8] += sy / body.mass
    y[9] += sz / body.mass
    y[10] += r * sz - z * sy
    y[11] += z * sx - x * sz
    y[12] += x * sy - r * sx


def strike(
    setup: Setup, y: Array, time: float, hit: int, velocity: float, chosen: Indices, n: int, room: Array
) -> None:
    """The impact, in place, of vertex `hit`, which comes down with `velocity` [m/s], on a state y (13,) with L.

    `chosen` has the n vertices that touch at that instant, of which no law with friction strikes more than one."""
    if isinstance(setup.law, RoughLaw):
        rough_strike(setup, y, time, hit, velocity, chosen, n, room)
    else:
        smooth_strike(setup, y, time, hit, velocity, chosen, n, room)


@overload(strike, strict=False)
def _strike_of(setup: Any, y: Any, time: Any, hit: Any, velocity: Any, chosen: Any, n: Any, room: Any) -> Any:
    """The branch of `strike` that the type of the law asks for, chosen when it is compiled."""
    return (rough_strike if setup[1].instance_class is RoughLaw else smooth_strike).py_func
