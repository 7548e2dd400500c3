"""One labelling throughout: a symmetric die draws the same picture with other faces in their places.

The first pass labels each frame like the one before it. Flights know better where it lost the die for some frames, or got one
wrong; what is left beside contacts that could not be told apart may be no flight, and leads anywhere.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..model.motion import Throw
from .pose import View, labelled_like
from .seen import Seen

Array = NDArray[np.float64]

ASTRAY_RAD = 0.2
"""How far from its flight, in any labelling, a frame lies that no flight tells how to label."""


def labelled_across(view: View, seen: Seen, throw: Throw, times_s: Array) -> Seen:
    """The sightings with one labelling throughout: where contacts follow each other too fast for the poses between them
    to be sure, each flight takes the labelling that turns least from the flight before. Frames that follow each other tell that
    by themselves; flights that could not be joined may lead anywhere."""
    rotation, known = seen.rotation.copy(), np.flatnonzero(seen.known)
    relabel = np.eye(3)
    for k, impact in enumerate(throw.impacts):
        behind = int(np.searchsorted(times_s[known], impact.time_s, side="right"))
        beside = known[max(behind - 1, 0) : behind + 1]
        if len(beside) == 2 and beside[1] - beside[0] == 1:
            before, after = seen.rotation[beside]
        else:
            before, after = throw.flights[k].at(impact.time_s).rotation, throw.flights[k + 1].at(impact.time_s).rotation
        relabel = after.T @ labelled_like(view, after, before @ relabel)
        end = throw.impacts[k + 1].time_s if k + 1 < len(throw.impacts) else np.inf
        mine = (times_s > impact.time_s) & (times_s <= end)
        rotation[mine] = rotation[mine] @ relabel
    return replace(seen, rotation=rotation)


def labelled_along(view: View, seen: Seen, flown: Seen, first: Seen) -> Seen:
    """The sightings in the labelling of flights, which are `flown` on every frame, and where these lead ASTRAY_RAD away, in that
    of a first pass."""
    rows, rotation = np.flatnonzero(seen.known), seen.rotation.copy()
    rotation[rows] = labelled_like(view, rotation[rows], flown.rotation[rows])
    astray = rows[first.known[rows] & (angles(rotation[rows], flown.rotation[rows]) > ASTRAY_RAD)]
    rotation[astray] = labelled_like(view, rotation[astray], first.rotation[astray])
    return replace(seen, rotation=rotation)


def angles(a: Array, b: Array) -> Array:
    """(n,) [rad] between rotations (n, 3, 3); NaN where one is not known."""
    cosine = 0.5 * (np.einsum("nij,nij->n", a, b) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
