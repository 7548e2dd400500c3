"""Curves and dots as the data of SVG paths, in whole units, thinned to what a screen shows.

A unit is a tenth of a pixel. Whole numbers and relative moves make a path about a third as long as decimal coordinates do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

UNITS_PER_PX = 10
MAX_DOTS = 4000
"""Dots of one series, besides the highest and lowest of each column of pixels: more would cover each other."""


def curve(x: Array, y: Array) -> str:
    """The path through points (n,), (n,) [units]; a point that is not finite interrupts it.

    Of the points in one column of pixels, the first, the last, the highest and the lowest are kept: the rest lies between.
    """
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if not len(known):
        return ""
    run = np.cumsum(np.diff(known, prepend=known[0]) > 1, dtype=np.int64)
    points = _whole(x[known], y[known])
    kept = _outline(points, run)
    points, run = points[kept], run[kept]
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    return "".join(_run(each) for each in np.split(points, starts[1:]))


def steps_after(x: Array, y: Array) -> tuple[Array, Array]:
    """The corners (2n - 1,) of steps through points (n,), which change at each next point."""
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]


def dots(x: Array, y: Array) -> str:
    """A path of subpaths without length: with round caps, each is a dot as wide as the stroke.

    If there are more than MAX_DOTS, one is drawn for each cell of a grid, and the highest and lowest of each column.
    """
    known = np.isfinite(x) & np.isfinite(y)
    points = np.unique(_whole(x[known], y[known]), axis=0)
    if not len(points):
        return ""
    if len(points) > MAX_DOTS:
        points = points[_spread_out(points)]
    moves = np.diff(points, axis=0).tolist()
    return f"M{points[0, 0]} {points[0, 1]}h0" + "".join(f"m{_pair(dx, dy)}h0" for dx, dy in moves)


def _whole(x: Array, y: Array) -> Indices:
    return np.rint(np.stack([x, y], axis=1)).astype(np.int64)


def _outline(points: Indices, run: Indices) -> Indices:
    """Indices of the points to keep of runs of points (n, 2), in their order."""
    column = points[:, 0] // UNITS_PER_PX
    group = np.cumsum((np.diff(column, prepend=column[0]) != 0) | (np.diff(run, prepend=run[0]) != 0))
    first = np.flatnonzero(np.diff(group, prepend=-1))
    last = np.append(first[1:], len(points)) - 1
    by_height = np.lexsort((points[:, 1], group))
    return np.unique(np.concatenate([first, last, by_height[first], by_height[last]]))


def _run(points: Indices) -> str:
    """One uninterrupted path; one point alone is a dot."""
    moves = np.diff(points, axis=0)
    moves = moves[moves.any(1)]
    if not len(moves):
        return f"M{points[0, 0]} {points[0, 1]}h0"
    return f"M{points[0, 0]} {points[0, 1]}l" + " ".join(map(str, moves.ravel().tolist())).replace(" -", "-")


def _pair(dx: int, dy: int) -> str:
    return f"{dx}{dy}" if dy < 0 else f"{dx} {dy}"


def _spread_out(points: Indices) -> Indices:
    """Indices of points (n, 2), sorted by x and then y: MAX_DOTS at most, and the lowest and highest of each column."""
    cell, chosen = 1, np.arange(len(points))
    while len(chosen) > MAX_DOTS:
        cell *= 2
        chosen = np.unique(points // cell, axis=0, return_index=True)[1]
    group = np.unique(points[:, 0] // UNITS_PER_PX, return_inverse=True)[1]
    by_height = np.lexsort((points[:, 1], group))
    first = np.flatnonzero(np.diff(group, prepend=-1))
    last = np.append(first[1:], len(points)) - 1
    return np.unique(np.concatenate([chosen, by_height[first], by_height[last]]))
