"""What a person tells the tracker: where the die is on one frame, and which frames are of no use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_CLICKS = 4
"""Three corners leave up to four poses; the fourth decides."""


@dataclass(frozen=True, eq=False)
class Click:
    """A corner of the die, shown on a frame."""

    px: Array
    """(2,) x, y; pixel centres at integers."""
    vertex: int | None = None
    """Its number in vertices.csv; None where it is to be found out."""


@dataclass(frozen=True, eq=False)
class ManualInitialisation:
    """Where a person says that the die is: a pose, or clicks."""

    frame: int
    """Number in the file, as in track.csv."""
    position_m: Array | None = None
    """(3,) of the centre, in the world."""
    quaternion: Array | None = None
    """(4,) wxyz, body to world."""
    clicks: tuple[Click, ...] = ()
    """Four at least where no pose is given; named all or none."""


def excluded_rows(ranges: Sequence[tuple[int, int]], first_frame: int, count: int) -> frozenset[int]:
    """Rows (0 ... count - 1) of a clip that begins at frame `first_frame` whose frame numbers lie in ranges (first, stop)."""
    left_out = np.zeros(count, bool)
    for first, stop in ranges:
        left_out[max(first - first_frame, 0) : max(stop - first_frame, 0)] = True
    return frozenset(int(k) for k in np.flatnonzero(left_out))
