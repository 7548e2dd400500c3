"""One labelling throughout: a symmetric die draws the same picture with other faces in their places.

The first pass labels each frame like the one before it. Flights know better where it lost the die for some frames, or got one
wrong; what is left beside contacts that could not be told apart may be no flight, and leads anywhere.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import nearest_equivalent_rotation
from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ..picture import View
from ..pose import ClipPoses

Array = NDArray[np.float64]

ASTRAY_RAD = 0.2
"""How far from its flight, in any labelling, a frame lies that no flight tells how to label."""


def with_consistent_labels(view: View, seen: ClipPoses, throw: Throw, times_s: Array) -> ClipPoses:
    """The sightings with one labelling throughout: where contacts follow each other too fast for the poses between them
    to be sure, each flight takes the labelling that turns least from the flight before. Where one leads astray at the contact,
    frames beside it that follow each other tell it by themselves."""
    rotation, known = seen.rotation.copy(), np.flatnonzero(seen.known)
    relabel = np.eye(3)
    for k, impact in enumerate(throw.impacts):
        flights = throw.flights[k : k + 2]
        before, after = (flight.at(impact.time_s).rotation for flight in flights)
        behind = int(np.searchsorted(times_s[known], impact.time_s, side="right"))
        beside = known[max(behind - 1, 0) : behind + 1]
        if len(beside) == 2 and beside[1] - beside[0] == 1:
            flown = matrix_from_quat(
                np.array(
                    [flight.at(float(times_s[row])).quaternion for flight, row in zip(flights, beside, strict=True)]
                )
            )
            if _are_astray(view, seen.rotation[beside], flown).any():
                before, after = seen.rotation[beside]
        relabel = after.T @ nearest_equivalent_rotation(after, before @ relabel, view.symmetries)
        end = throw.impacts[k + 1].time_s if k + 1 < len(throw.impacts) else np.inf
        mine = (times_s > impact.time_s) & (times_s <= end)
        rotation[mine] = rotation[mine] @ relabel
    return replace(seen, rotation=rotation)


def with_labels_of_flights(view: View, seen: ClipPoses, flown: ClipPoses, first: ClipPoses) -> ClipPoses:
    """The sightings in the labelling of flights, which are `flown` on every frame, and where these lead ASTRAY_RAD away, in that
    of a first pass."""
    rows, rotation = np.flatnonzero(seen.known), seen.rotation.copy()
    rotation[rows] = nearest_equivalent_rotation(rotation[rows], flown.rotation[rows], view.symmetries)
    astray = rows[first.known[rows] & _are_astray(view, rotation[rows], flown.rotation[rows])]
    rotation[astray] = nearest_equivalent_rotation(rotation[astray], first.rotation[astray], view.symmetries)
    return replace(seen, rotation=rotation)


def _are_astray(view: View, rotation: Array, flown: Array) -> NDArray[np.bool_]:
    """(n,) where frames (n, 3, 3) lie too far from where they are flown (n, 3, 3)."""
    return np.asarray(angles(nearest_equivalent_rotation(rotation, flown, view.symmetries), flown) > ASTRAY_RAD)


def angles(a: Array, b: Array) -> Array:
    """(n,) [rad] between rotations (n, 3, 3); NaN where one is not known."""
    cosine = 0.5 * (np.einsum("nij,nij->n", a, b) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
