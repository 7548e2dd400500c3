"""The corner radius that the impacts of a throw show, of a die that looks sharp.

Pictures of small dice, and of codecs, do not show corners rounded by less than about three pixels. The table does. The contour of
a rounded die lies within that of a sharp one: it seems farther away, and strikes below the table. A rounded corner also strikes
later, and the impulse acts at another place of the die: with its radius a contact is an impact at one corner; with another its
flights do not meet so, or turn otherwise.

Where flights do not meet as those of a sharp die, the throw is measured with the place of the contour left open, and with one
radius after another. The chain of flights that explains the frames best counts (`gain_over`). The poses remain those of a
sharp die, at the distance that the impacts show.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ...model.die import Die
from ...model.throw import turning_of
from ..camera import Camera
from ..throw import PENALTY, MeasuredThrow, NoFlightError, gain_over, measure
from ..track import Track
from .corner_radius import CornerRadius, largest_radius_m

OPEN_CONTOUR_PX = 0.6
"""Standard deviation of the place of the contour where it is left open: that of a cube whose corners are rounded by two pixels
lies up to 0.8 px within that of a sharp one."""
LONE_FRAMES = 4
"""Least frames on each of the flights beside a contact that judges the corners: two impacts within a few frames have other
reasons not to be resolved."""
FIRST_SHARE = 0.04
"""Least radius that is tried, as a share of the inscribed one: 0.3 mm of a die of 16 mm."""
IMPACT_RATIO = 1.5
"""Ratio of successive radii."""
IMPACT_SIGMA_SHARE = 0.4
"""Standard deviation of the radius found, as a share of it. With the place of the contour and the frames of a contact above it
rests on one seed of random clips and on simulated throws."""
SUFFICIENT_FRAMES = 0.95
"""Share of the frames tracked with another radius, or none, below which a radius is rejected."""


def radius_by_impacts(track: Track, die: Die, camera: Camera, every: int = 1) -> tuple[CornerRadius | None, float]:
    """The radius of corners that impacts show, and the standard deviation [px] with which the place of the contour is left open;
    (None, 0) if the contacts are impacts of a sharp die, or neither explains them clearly better.

    `track` is that of a die with sharp corners, of which one in `every` frames is used."""
    sharp = _measured(track, die, camera, every)
    if sharp is None or not unexplained_contacts(sharp):
        return None, 0.0
    open_contour = replace(track, contour_sigma_px=OPEN_CONTOUR_PX)
    first_m, largest_m = FIRST_SHARE * die.solid.inradius, largest_radius_m(die)
    tried_m = [0.0, *first_m * IMPACT_RATIO ** np.arange(np.log(largest_m / first_m) / np.log(IMPACT_RATIO))]
    best, better_m, least = sharp, [], 2.0 * PENALTY
    for radius_m in map(float, tried_m):
        found = _measured(open_contour, replace(die, corner_radius_m=radius_m), camera, every)
        if found is None or unexplained_contacts(found) >= unexplained_contacts(sharp):
            continue
        # More frames count as in flight with some radii: these are not compared.
        if np.array_equal(found.rows, sharp.rows) and gain_over(found.resolved, best.resolved) > least:
            best, least = found, 0.0
            better_m.append(radius_m)
    if not better_m or better_m == [first_m]:
        # What the least radius shows, and neither larger ones nor none, is no effect of a radius.
        return None, 0.0
    radius_m = better_m[-1]
    if radius_m == 0.0:
        return None, OPEN_CONTOUR_PX
    return CornerRadius(radius_m, IMPACT_SIGMA_SHARE * radius_m, by_impacts=True), OPEN_CONTOUR_PX


def open_contour_notice(sigma_px: float) -> str:
    """One sentence for the reader of a result whose contour is left open by so much, without a radius."""
    return (
        f"the flights meet on the table only if the contour of the die lies some {sigma_px:.1f} px from where it is seen, as "
        "that of slightly rounded corners does, which the distances take into account; if you have measured the radius of the "
        "corners, write it as die.corner_radius_m."
    )


def flies_as_before(again: Track, before: Track, die: Die, camera: Camera, every: int = 1) -> bool:
    """Whether a die that was tracked again with the radius that impacts showed is tracked on nearly all frames of the track
    `before` (SUFFICIENT_FRAMES), and meets the table as there: at one corner as often, and no more often in other ways."""
    flights, anew = _measured(before, die, camera, every), _measured(again, die, camera, every)
    if flights is None or anew is None or again.tracked.sum() < SUFFICIENT_FRAMES * before.tracked.sum():
        return False
    then, now = (sum(link.impact is not None for link in one.chain.links) for one in (flights, anew))
    return now >= then and unexplained_contacts(anew) <= unexplained_contacts(flights)


def _measured(track: Track, die: Die, camera: Camera, every: int) -> MeasuredThrow | None:
    """The throw with a die; None without a flight."""
    try:
        return measure(replace(track, turning=turning_of(die)), die, camera, every=every)
    except NoFlightError:
        return None


def unexplained_contacts(found: MeasuredThrow) -> int:
    """Number of contacts between flights of LONE_FRAMES or more that are no impact at one corner."""
    parts = found.chain.parts(found.frames.time_s[found.rows])
    known = pairwise(bool((found.chain.weights[part] > 0.0).sum() >= LONE_FRAMES) for part in parts)
    return sum(link.impact is None and all(both) for link, both in zip(found.chain.links, known, strict=True))
