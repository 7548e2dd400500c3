"""Which of two sequences of poses of one clip explains its pictures better, and the motion of a die."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..footage import FrameSource
from ..picture import View
from ..pose import ClipPoses, log_scatter, same_picture
from .initialisation import AGREEMENT_EDGES, FULL_STAGE

Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]

FLIGHT_FRAMES = 16
"""Frames over which a motion shows that it is none of a die in flight. Eight hardly do: on one flight of a sharp
tetrahedron wrong poses had a reduced chi-square of 1.3 to 6 there, and of 2.5 to 140 over 16."""
SMALLER_COST = 0.1
"""Mean cost with the noise of edges, and the logarithm of the scatter about flights, by which other poses must be better to
replace those that do not explain their pictures or lie on no flight."""
CONTESTED_SHARE = 0.5
"""Share of the frames of other poses that had poses before, above which the others must explain the pictures better: on fewer,
beside an impact, neither decides."""


def differ(view: View, poses: ClipPoses, others: ClipPoses, rows: Rows) -> Mask:
    """(rows,) whether others show another die than the poses on some rows, or only one of the two has a pose."""
    out = poses.known[rows] != others.known[rows]
    for i in np.flatnonzero(poses.known[rows] & others.known[rows]).tolist():
        here, there = ((one.position_m[rows[i]], one.rotation[rows[i]]) for one in (poses, others))
        out[i] = not same_picture(view, here, there, AGREEMENT_EDGES)
    return out


def explain_better(
    view: View, source: FrameSource, others: ClipPoses, poses: ClipPoses, rows: Rows,
    by: float = SMALLER_COST,
) -> bool:  # fmt: skip
    """Whether others explain the pictures and the motion on some rows better than the poses by a mean cost, on the rows that both
    have."""
    # In order of time, whichever way the rows were tracked: a flight is fitted to them.
    both = np.sort(rows[others.known[rows] & poses.known[rows]])
    if not len(both):
        return False
    theirs, ours = (
        float(one.cost_with_edge_noise[both].mean()) + _usual_log_scatter(view, source, one, both)
        for one in (others, poses)
    )
    return theirs < ours - by


def _usual_log_scatter(view: View, source: FrameSource, poses: ClipPoses, rows: Rows) -> float:
    """`log_scatter` of poses on some rows: the median over windows, of which those with an impact say nothing; 0 if there are
    too few rows."""
    found = [log_scatter(view, poses, source.times_s, window) for window in windows_of(rows)]
    return float(np.median(found)) if found else 0.0


def windows_of(rows: Rows) -> list[Rows]:
    """Overlapping windows of FLIGHT_FRAMES of some rows, or all of them if there are fewer; none if these are fewer than
    FULL_STAGE."""
    if len(rows) < FULL_STAGE:
        return []
    begins = {*range(0, max(len(rows) - FLIGHT_FRAMES, 0), FLIGHT_FRAMES // 4), max(len(rows) - FLIGHT_FRAMES, 0)}
    return [rows[k : k + FLIGHT_FRAMES] for k in sorted(begins)]
