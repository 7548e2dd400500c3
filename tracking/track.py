"""The table of poses: what tracking knows about the die on every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TRACKED, LOST, ABSENT = "tracked", "lost", "absent"
"""Status of a frame: the pose is known; the die is in view but its pose is not known; no die is in view."""


@dataclass(frozen=True, eq=False)
class Track:
    """Poses of the die in world axes, one row a frame."""

    frame: NDArray[np.int64]
    """(n,) frame numbers, counted from the first frame of the file."""
    time_s: Array
    """(n,) mid-exposure."""
    position_m: Array
    """(n, 3) of the centre; NaN unless tracked."""
    quaternion: Array
    """(n, 4) wxyz, body to world, sign continuous; NaN unless tracked."""
    covariance: Array
    """(n, 6, 6) of position [m] and rotation vector [rad], world axes: R_true = exp(δ) R_est; NaN unless tracked."""
    status: NDArray[np.str_]
    """(n,) TRACKED, LOST or ABSENT."""
    lean: Array | None = None
    """(n, 6) change of each pose [m/px, rad/px], world axes, for a contour that is taken a pixel too far out all round;
    NaN where it is not known, None where no frame has it."""
    shared: Array | None = None
    """(n, 6, 6) covariance of what all frames err alike because the marks on the faces lie where they were learned; part of
    no frame's own. None where no marks were used."""
    own: Array | None = None
    """(n, 6, 6) covariance from the pixels of each frame alone, by which flights are found, where `covariance` has come to say
    more (`bounces.calibrated`); None where `covariance` is that. In no file."""
    contour_sigma_px: float = 0.0
    """One sigma of what the contour may lie too far out on all frames besides: of a radius of the corners that is not known
    but estimated from the pictures."""

    @property
    def tracked(self) -> NDArray[np.bool_]:
        """(n,) where the pose is known."""
        return np.asarray(self.status == TRACKED)

    def __len__(self) -> int:
        return len(self.frame)
