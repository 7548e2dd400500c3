"""Where the throw leads: seen in the track, or simulated on from the fit.

A landing counts as decided only when every throw drawn from the fit ends on the same face: with 100 draws, another face
then has odds below 3 % (95 %). A bounce law that failed on the way is not asked what comes next.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, lowest_face
from ...model.rotations import matrix_from_quat, rotation_between
from ...model.throw import State, Throw, Until
from ...tracking.track import Track
from ..free import moved_state
from .physics import QUICK, Physics

Array = NDArray[np.float64]

DRAWS = 100

_MOST_IMPACTS = 5000
"""A throw near χ = 1 hardly loses energy; one that bounces on for longer is left undecided."""

_STILL_FRAMES = 8
_STILL_RAD = np.deg2rad(0.5)
_FLAT_RAD = np.deg2rad(3.0)


def resting_face(track: Track, die: Die) -> int | None:
    """Number of the face that the die lies on at the end of the track; None unless it lies there flat and still.

    Still: the last eight frames turn by less than 0.5° and shift by less than 1 % of the inscribed radius; flat: the
    face within 3° of the table and the centre at its height within 5 %.
    """
    last = np.flatnonzero(track.tracked)[-_STILL_FRAMES:]
    if len(last) < _STILL_FRAMES or last[-1] - last[0] >= 2 * _STILL_FRAMES:
        return None
    position, quaternion = track.position_m[last], track.quaternion[last]
    size = die.solid.inradius
    # Halves are compared, so that the noise of single frames does not pass for motion.
    half = _STILL_FRAMES // 2
    shift = position[half:].mean(0) - position[:half].mean(0)
    turn = rotation_between(quaternion[:half], quaternion[half:]).mean(0)
    if np.linalg.norm(shift) > 0.01 * size or np.linalg.norm(turn) > _STILL_RAD:
        return None
    rotation = matrix_from_quat(quaternion[-1])
    face = lowest_face(die.solid, rotation)
    down = -float(rotation[2] @ die.solid.normals[face - 1])
    flat = down > np.cos(_FLAT_RAD) and abs(position[:, 2].mean() - die.solid.offsets[face - 1]) < 0.05 * size
    return face if flat else None


def continued(physics: Physics, throw: Throw, end_s: float) -> Throw:
    """The throw simulated on from its last flight until `end_s` on the track's clock.

    Unchanged where the last flight begins with a corner below the table, as a fit through prescribed vertices may.
    """
    last = throw.flights[-1].start
    until_s = physics.clock * end_s
    if until_s <= last.time_s or not physics.can_release(last):
        return throw
    on = physics.throw(last, Until(time_s=until_s)).throw
    return Throw(throw.flights[:-1] + on.flights, throw.impacts + on.impacts)


def landing_odds(
    physics: Physics, initial: State, covariance: Array, vertices: tuple[int, ...]
) -> tuple[int | None, dict[int, float] | None, tuple[str, ...]]:
    """Face on which throws drawn from the fit come to rest, the odds of every face, and what to say of them.

    `covariance` (12 + k, 12 + k) is that of `initial` and the free parameters, `vertices` the impacts through which the
    fit runs.
    """
    rng = np.random.default_rng(0)
    values, axes = np.linalg.eigh(covariance)
    spread = axes * np.sqrt(np.clip(values, 0.0, None))
    landed: Counter[int] = Counter()
    undecided = 0
    for _ in range(DRAWS):
        x = spread @ rng.standard_normal(len(spread))
        start = moved_state(initial, x[:12])
        face = _landing(physics.moved(x[12:]), start, vertices)
        if face is None:
            undecided += 1
        else:
            landed[face] += 1
    faces = len(physics.die.solid.faces)
    if undecided > 0.1 * DRAWS:
        words = (
            f"The landed face is not known: {undecided} of {DRAWS} throws drawn from the fit begin their last flight "
            "below the table, or never come to rest on a face."
        )
        return None, None, (words,)
    odds = {face: landed[face] / landed.total() for face in range(1, faces + 1)}
    likely = max(odds, key=lambda face: odds[face])
    if odds[likely] < 1.0 or undecided:
        words = f"The landed face is not decided by the fit: the likeliest, {likely}, has odds of {odds[likely]:.2f}."
        return None, odds, (words,)
    return likely, odds, ()


def _landing(physics: Physics, start: State, vertices: tuple[int, ...]) -> int | None:
    """The face of one throw, through the fitted impacts and then by itself; None where it is not decided."""
    run = physics.run(physics.after(start, vertices), impacts=_MOST_IMPACTS, keep=False, precision=QUICK)
    return None if run is None else run.landed_face
