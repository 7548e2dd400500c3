"""The landing face: observed at the end of the track, or simulated onward from the fit.

A landing counts as decided only if every throw drawn from the fit ends on the same face: with 100 draws, any other face
then has odds below 3 % (95 %). Draws continue from the fitted impacts, with the law that explained them. `throw_of_fit` makes
the model's throw again from the numbers of a fit, which is all that a saved one holds.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, lowest_face
from ...model.laws import Table
from ...model.rotations import matrix_from_quat, rotation_between
from ...model.throw import State, Throw, Until, propagate
from ...tracking.covariance import covariance_root
from ...tracking.flights import perturbed
from ...tracking.track import Track
from ..results import Fit
from .clock_and_scale import as_tracked
from .physics import COARSE, Physics

Array = NDArray[np.float64]

DRAWS = 100
"""Throws drawn from a fit."""

_MAX_IMPACTS = 5000
"""Impacts after which a throw is left undecided: near χ = 1 it hardly loses energy."""

_MAX_UNDECIDED = 0.1
"""Share of undecided draws above which no odds are given."""

_REST_FRAMES = 8
"""Last frames in which a die at rest must neither turn nor shift."""

_REST_TURN_RAD = np.deg2rad(0.5)
"""Turn over these frames below which the die is at rest."""

_REST_SHIFT = 0.01
"""The same of its shift, in inscribed radii."""

_FLAT_RAD = np.deg2rad(3.0)
"""Angle between face and table below which the die lies flat."""

_FLAT_HEIGHT = 0.05
"""Departure of the centre's height from that of a die on its face, in inscribed radii, below which it lies flat."""


def resting_face(track: Track, die: Die) -> int | None:
    """Number of the face that the die lies on at the end of the track; None unless it lies there flat and at rest.

    At rest: the last eight frames turn by less than 0.5° and shift by less than 1 % of the inscribed radius. Flat: the
    face is within 3° of the table and the centre at its height within 5 % of the inscribed radius.
    """
    last = np.flatnonzero(track.tracked)[-_REST_FRAMES:]
    if len(last) < _REST_FRAMES or last[-1] - last[0] >= 2 * _REST_FRAMES:
        return None
    position, quaternion = track.position_m[last], track.quaternion[last]
    size = die.solid.inradius
    # The means of halves are compared, so that the noise of single frames does not count as motion.
    half = _REST_FRAMES // 2
    shift = position[half:].mean(0) - position[:half].mean(0)
    turn = rotation_between(quaternion[:half], quaternion[half:]).mean(0)
    if np.linalg.norm(shift) > _REST_SHIFT * size or np.linalg.norm(turn) > _REST_TURN_RAD:
        return None
    rotation = matrix_from_quat(quaternion[-1])
    face = lowest_face(die.solid, rotation)
    down = -float(rotation[2] @ die.solid.normals[face - 1])
    flat = down > np.cos(_FLAT_RAD) and abs(position[:, 2].mean() - die.solid.offsets[face - 1]) < _FLAT_HEIGHT * size
    return face if flat else None


def continued(physics: Physics, throw: Throw, end_s: float) -> Throw:
    """The throw simulated onward from its last flight until `end_s` on the track's clock.

    Unchanged if the last flight begins with a corner below the table, as a fit through prescribed vertices may.
    """
    last = throw.flights[-1].start
    until_s = physics.clock * end_s
    if until_s <= last.time_s or not physics.can_release(last):
        return throw
    on = physics.throw(last, Until(time_s=until_s)).throw
    return Throw(throw.flights[:-1] + on.flights, throw.impacts + on.impacts)


def physics_of_fit(fit: Fit, die: Die, table: Table) -> Physics:
    """Die, table and law with the values that a fit found."""
    values = {name: p.value for name, p in fit.parameters.items() if p.value is not None}
    held = frozenset(name for name, p in fit.parameters.items() if not p.free and name in values)
    return Physics(die, table, {"chi": 0.5}, held, fit.restitution).with_values(**values)


def throw_of_fit(fit: Fit, die: Die, table: Table, until_s: float) -> Throw | None:
    """The throw through the fitted bounces and on to `until_s` on the track's clock; None for a fit without one.

    `die` and `table` are those that the fit was made with. Poses agree with those of `Fit.throw` to rounding.
    """
    if fit.initial is None or fit.fitted_until_s is None:
        return None
    physics = physics_of_fit(fit, die, table)
    throw = propagate(
        physics.body,
        fit.initial,
        physics.law,
        [fit.fitted_until_s],
        vertices=fit.vertices,
        table=physics.plane,
        parameters=(),
        drag_per_m=physics.drag_per_m,
    ).throw
    if fit.parameters["chi"].value is None:
        return throw
    return as_tracked(physics, continued(physics, throw, until_s))


def landing_odds(
    physics: Physics, initial: State, covariance: Array, vertices: tuple[int, ...]
) -> tuple[int | None, dict[int, float] | None, tuple[str, ...]]:
    """Landing face of throws drawn from the fit, the odds of every face, and messages.

    `covariance` (12 + k, 12 + k) is that of `initial` and the free parameters; `vertices` are the fitted impacts.
    """
    rng = np.random.default_rng(0)
    spread = covariance_root(covariance)
    landed: Counter[int] = Counter()
    undecided = 0
    for _ in range(DRAWS):
        x = spread @ rng.standard_normal(len(spread))
        start = perturbed(initial, x[:12])
        face = _landing(physics.moved(x[12:]), start, vertices)
        if face is None:
            undecided += 1
        else:
            landed[face] += 1
    faces = len(physics.die.solid.faces)
    if undecided > _MAX_UNDECIDED * DRAWS:
        unknown_message = (
            f"Landing face unknown: {undecided} of {DRAWS} throws drawn from the fit begin their last flight below the "
            "table, or never come to rest on a face."
        )
        return None, None, (unknown_message,)
    odds = {face: landed[face] / landed.total() for face in range(1, faces + 1)}
    likeliest = max(odds, key=lambda face: odds[face])
    if odds[likeliest] < 1.0 or undecided:
        undecided_message = (
            f"Landing face undecided: of throws drawn from the fit, a share of {odds[likeliest]:.2f} lands on the likeliest "
            f"face, {likeliest}."
        )
        return None, odds, (undecided_message,)
    return likeliest, odds, ()


def _landing(physics: Physics, start: State, vertices: tuple[int, ...]) -> int | None:
    """The face of one throw, through the fitted impacts and then without prescription; None if it is undecided."""
    run = physics.run(physics.after(start, vertices), impacts=_MAX_IMPACTS, keep=False, precision=COARSE)
    return None if run is None else run.landed_face
