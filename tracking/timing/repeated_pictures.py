"""Frames that show the picture of the frame before them although the die moves.

Software fills dropped frames in with the last picture, and conversions of the frame rate double frames. Such a picture is equal
to the one before it, noise included, up to what a codec adds. A pose that hardly differs from the one before on a moving die,
or a frame without a pose, is a candidate; its picture around the die is then compared with the picture before it, and the
difference with that of frames beside it. Only the pictures of candidates are read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat, rotation_between
from ..camera import Camera
from ..track import LOST, Track

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Picture = Callable[[int], NDArray[Any]]
"""Reads the picture (height, width) of a frame by its row in the clip."""

NEIGHBOURS = 5
"""Frames on either side of a frame that show how far the die usually moves, and how far pictures usually differ."""
MOVING_SIGMAS = 3.0
"""Usual move from frame to frame, in standard errors of its two poses, of a die whose pictures have to differ."""
SMALL_MOVE = 0.5
"""Share of the usual move below which a pose may be that of a repeated picture."""
SAME_SHARE = 0.12
"""Share of the usual difference between neighbouring pictures below which two pictures are one: exact copies have 0, copies in
H.264 at crf 20 up to 0.03, and pictures of their own 0.3 and more, as those shortly before and after a bounce."""
MARGIN = 0.3
"""Margin around the outline of the die, as a share of its size, in which pictures are compared."""


def repeated_pictures(
    track: Track, die: Die, camera: Camera, picture: Picture, excluded: Sequence[tuple[int, int]] = ()
) -> Rows:
    """Rows (m,) of the track whose picture repeats that of the row before; ranges (first, stop) of frame numbers are
    `excluded`."""
    tracked = np.flatnonzero(track.tracked)
    if len(tracked) < 2 * NEIGHBOURS:
        return np.zeros(0, np.int64)
    candidates = _candidates(track)
    for first, stop in excluded:
        candidates &= (track.frame < first) | (track.frame >= stop)
    reader = _Differences(track, die, camera, picture)
    return np.array([row for row in np.flatnonzero(candidates) if reader.is_repeated(int(row), candidates)], np.int64)


def _candidates(track: Track) -> NDArray[np.bool_]:
    """(n,) rows that hardly moved from the row before while the die moves, and rows without a pose among such."""
    n, tracked = len(track), track.tracked
    moved = np.full(n, np.nan)
    both = np.flatnonzero(tracked[1:] & tracked[:-1]) + 1
    step = np.concatenate(
        [
            track.position_m[both] - track.position_m[both - 1],
            rotation_between(track.quaternion[both - 1], track.quaternion[both]),
        ],
        axis=1,
    )
    own = track.covariance if track.pixel_covariance is None else track.pixel_covariance
    squares = (step * np.linalg.solve(own[both] + own[both - 1], step[:, :, None])[:, :, 0]).sum(1)
    moved[both] = np.sqrt(squares / 6.0)
    out = np.zeros(n, bool)
    inside = slice(int(np.flatnonzero(tracked)[0]), int(np.flatnonzero(tracked)[-1]) + 1)
    for k in range(n)[inside]:
        near = moved[max(k - NEIGHBOURS, 0) : k + NEIGHBOURS + 1]
        near = near[np.isfinite(near)]
        if k > 0 and len(near) >= NEIGHBOURS and (usual := float(np.median(near))) > MOVING_SIGMAS:
            # A lost frame, and the first pose after one, have no step of their own.
            unknown = track.status[k] == LOST or not np.isfinite(moved[k])
            out[k] = unknown or moved[k] < SMALL_MOVE * usual
    return out


class _Differences:
    """Differences between neighbouring pictures, around the die, each picture pair read once."""

    def __init__(self, track: Track, die: Die, camera: Camera, picture: Picture) -> None:
        self._track, self._die, self._camera, self._picture = track, die, camera, picture
        self._tracked = np.flatnonzero(track.tracked)

    def is_repeated(self, row: int, candidates: NDArray[np.bool_]) -> bool:
        """Whether a picture is that of the row before."""
        near = [k for k in range(row - NEIGHBOURS, row + NEIGHBOURS + 1) if 0 < k < len(self._track)]
        others = sorted((k for k in near if not candidates[k]), key=lambda k: abs(k - row))[:NEIGHBOURS]
        box = self._box(row)
        if not others or box is None:
            return False
        usual = float(np.median([self._difference(k, box) for k in others]))
        return self._difference(row, box) < SAME_SHARE * usual

    def _difference(self, row: int, box: tuple[slice, slice]) -> float:
        """Root mean square difference of a picture from the one before it."""
        this, before = (np.asarray(self._picture(k)[box], float) for k in (row, row - 1))
        return float(np.sqrt(((this - before) ** 2).mean()))

    def _box(self, row: int) -> tuple[slice, slice] | None:
        """Rows and columns around the nearest pose; None outside the picture."""
        k = int(self._tracked[np.argmin(np.abs(self._tracked - row))])
        corners = self._die.solid.vertices @ matrix_from_quat(self._track.quaternion[k]).T + self._track.position_m[k]
        px = self._camera.project(corners)
        margin = MARGIN * float(np.ptp(px, axis=0).max())
        low = np.maximum(np.floor(px.min(0) - margin), 0).astype(int)
        high = np.minimum(np.ceil(px.max(0) + margin) + 1, [self._camera.width_px, self._camera.height_px]).astype(int)
        if (high - low < 2).any():
            return None
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
