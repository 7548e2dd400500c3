"""Where a die can be on frames beside others whose poses are known. It does not jump."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..frame_to_frame import FASTEST_M_S
from ..pose import ClipPoses, Pose, covariances

Array = NDArray[np.float64]

JUMP_EDGES = 0.5
"""Error [edges] of a place beside its standard error: that of a pose beside an impact, or of one that has not converged."""
JUMP_CHI2 = 16.0
"""Squared distance of a place from one of another frame, in standard errors of both and what the die may move, beyond which it is
not that of the die."""


@dataclass(frozen=True, eq=False)
class PlacesBeside:
    """Where the die is on frames beside those in which it is looked for."""

    times_s: Array
    """(n,)"""
    positions_m: Array
    """(n, 3)"""
    covariance: Array
    """(n, 3, 3)"""

    @staticmethod
    def of(poses: ClipPoses, times_s: Array, rows: Sequence[int], edge_m: float) -> PlacesBeside:
        """The places on some rows of poses that determine them, each taken to err by JUMP_EDGES besides its standard error."""
        known = np.array(rows, np.int64)
        found = covariances(poses.H[known, :6, :6])[:, :3, :3] + (JUMP_EDGES * edge_m) ** 2 * np.eye(3)
        determined = np.isfinite(found[:, 0, 0])
        known, found = known[determined], found[determined]
        return PlacesBeside(times_s[known], poses.position_m[known], found)

    def can_lead_to(self, pose: Pose, time_s: float) -> bool:
        """Whether the die can be there at an instant, at FASTEST_M_S at the most."""
        own = covariances(pose.information[None])[0, :3, :3]
        if not np.isfinite(own).all():
            return True
        moved_m = FASTEST_M_S * np.abs(time_s - self.times_s)
        away = self.positions_m - pose.position_m
        C = self.covariance + own + moved_m[:, None, None] ** 2 * np.eye(3)
        return bool((np.einsum("ni,ni->n", away, np.linalg.solve(C, away[..., None])[..., 0]) < JUMP_CHI2).all())
