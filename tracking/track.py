"""The pose of the die on every frame of a clip, with its covariance: the result of tracking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.throw import EVEN, Turning
from ..model.world import GRAVITY_M_S2

Array = NDArray[np.float64]

TRACKED = "tracked"
"""Status of a frame whose pose is known."""
LOST = "lost"
"""Status of a frame on which the die is in view and its pose unknown."""
ABSENT = "absent"
"""Status of a frame without the die in view."""


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """Errors that all frames of a clip share, because cameras, die and clock are known only so far. They are independent of each
    other, and each counts in its own standard deviation."""

    jacobian: Array
    """(n, 6, m) change of each frame's pose [m, rad], world axes, by one standard deviation of each; NaN without a pose."""
    sources: tuple[str, ...]
    """(m,) what each comes from: CALIBRATION, DIE or CLOCK."""
    subtracted: Array
    """(m,) how much of each the poses have had subtracted [standard deviations]."""

    def rows(self, which: NDArray[np.int64] | NDArray[np.bool_] | slice) -> SharedErrors:
        """Those of some of the frames."""
        return SharedErrors(self.jacobian[which], self.sources, self.subtracted)


CALIBRATION, DIE, CLOCK = "calibration", "die", "clock"
"""Sources of shared errors: cameras, the edge of the die, the frame rate."""


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
    bias_jacobian: Array | None = None
    """(n, 6, k) change of each pose [m, rad], world axes, by errors common to all frames: per pixel that the contour is drawn too
    far out all round, and where the cameras' response is not known (k = 2), per unit of its exponent. NaN where it is unknown,
    None where no frame has it."""
    shared_covariance: Array | None = None
    """(n, 6, 6) covariance of the error common to all frames because the marks on the faces were learned; not part of
    `covariance`. None where no marks were used."""
    pixel_covariance: Array | None = None
    """(n, 6, 6) covariance from the pixels of each frame alone, by which flights are segmented. None where `covariance` is that
    and was not calibrated by the residuals of the flights (`tracking.throw.with_calibrated_covariance`). In no file."""
    contour_sigma_px: float = 0.0
    """Standard error of the contour's place common to all frames, from a corner radius that was estimated from the pictures, or
    that nobody has stated."""
    response_sigma: float = 0.0
    """Standard deviation of the exponent of the response, grey = light ** exponent, from that with which the poses were found."""
    shared_errors: SharedErrors | None = None
    """Those that a fit of the whole throw integrates out; None where they are part of `covariance`, or cameras, die and clock are
    exact."""
    unexplained: NDArray[np.bool_] | None = None
    """(n,) frames that no flight explains, to which no model is fitted. None where no flights were measured."""
    gravity_m_s2: float = GRAVITY_M_S2
    """Of the place where the die was filmed, along -z. In no file: the scene says it."""
    turning: Turning = EVEN
    """How the die turns in flight. In no file: it follows from the die."""

    @property
    def tracked(self) -> NDArray[np.bool_]:
        """(n,) where the pose is known."""
        return np.asarray(self.status == TRACKED)

    def __len__(self) -> int:
        return len(self.frame)
