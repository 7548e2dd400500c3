"""What a replay draws: a throw as the camera saw it and, where there is a fit, as the model makes it.

Nothing here computes physics. A `Motion` is one of the two throws made ready to draw: poses on frames and, between
them, impacts. The residuals are geometry: what lies between the two poses of one frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, Solid
from ...model.rotations import continuous_sign, matrix_from_quat, rotation_between
from ...model.throw import Impact, Throw
from ...tracking.camera import Camera
from ...tracking.footage import Clip
from ...tracking.track import TRACKED, Track

if TYPE_CHECKING:
    from ...fitting.predict import Estimate
    from ...fitting.results import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Record:
    """One analysed throw, from clip to fit. What is None was not to be had, and is left out of the picture."""

    title: str
    die: Die
    track: Track
    """Measured poses, smoothed within each flight."""
    measured: Throw
    fps: float
    """[Hz] recording rate."""
    clip: Clip | None = None
    camera: Camera | None = None
    fit: Fit | None = None
    simulated: Track | None = None
    """The fitted model's poses on the frames of `track`."""
    estimates: tuple[Estimate, ...] = ()
    """What fits of more and more of the throw say, in the order of time; the last is `fit`."""
    notices: tuple[str, ...] = ()
    """What a careful reader should know about the footage and the tracking, one sentence each."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One throw made ready to draw: `measured` or `simulated`."""

    name: str
    frame: NDArray[np.int64]
    """(n,) numbers of the frames on which the pose is known, increasing."""
    time_s: Array
    """(n,)."""
    position_m: Array
    """(n, 3)."""
    quaternion: Array
    """(n, 4) wxyz, body to world."""
    missing_frame: NDArray[np.int64]
    """(m,) frames on which the pose is not known: no die may be drawn there."""
    missing_time_s: Array
    """(m,)."""
    throw: Throw | None
    """Flights and impacts; None where there are only poses."""

    @property
    def impacts(self) -> tuple[Impact, ...]:
        """Its bounces; none where there are only poses."""
        return self.throw.bounces if self.throw else ()

    @property
    def runs(self) -> list[slice]:
        """Stretches of rows without a gap between them."""
        if not len(self.frame):
            return []
        gone_before = np.searchsorted(self.missing_frame, self.frame)
        cuts = np.flatnonzero(np.diff(gone_before)) + 1
        return [slice(int(a), int(b)) for a, b in zip([0, *cuts], [*cuts, len(self.frame)], strict=True)]

    def corners_m(self, solid: Solid) -> Array:
        """World positions (n, vertices, 3) [m] of the vertices."""
        rotations = matrix_from_quat(self.quaternion)
        return np.asarray(np.einsum("nij,vj->nvi", rotations, solid.vertices) + self.position_m[:, None])


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured minus simulated on the frames where both poses are known."""

    frame: NDArray[np.int64]
    time_s: Array
    """(n,)."""
    position_mm: Array
    """(n, 3) world axes."""
    turn_deg: Array
    """(n, 3) rotation vector that takes the simulated to the measured orientation, world axes."""
    standard_errors: Array
    """(n, 6) of the measurement: of `position_mm`, then of `turn_deg`; NaN where the frame has no covariance."""
    rotation_deg: Array
    """(n,) angle of the rotation that takes the simulated to the measured orientation."""
    sigmas: Array
    """(n,) root mean square of the six whitened components; NaN where the frame has no covariance. Near 1 when model
    and covariances are right."""


def motion_of(name: str, track: Track, throw: Throw | None) -> Motion:
    """A track and its throw, made ready to draw under `name`."""
    known = track.tracked & np.isfinite(track.position_m).all(1) & np.isfinite(track.quaternion).all(1)
    return Motion(
        name,
        track.frame[known],
        track.time_s[known],
        track.position_m[known],
        track.quaternion[known],
        track.frame[~known],
        track.time_s[~known],
        throw,
    )


def motions_of(record: Record) -> list[Motion]:
    """The measured motion and, where there is a fit, the simulated one."""
    motions = [motion_of("measured", record.track, record.measured)]
    if record.simulated is not None:
        motions.append(motion_of("simulated", record.simulated, record.fit.throw if record.fit else None))
    return motions


def track_of(throw: Throw, fps: float) -> Track:
    """The poses of a modelled throw on the frames of a camera at `fps` [Hz], from its first instant to its last.

    Frame k is at k / fps, as on film. Raises ValueError where fps is not positive or no frame falls into the throw.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"fps = {fps}: wanted a finite number above 0")
    begin, end = throw.flights[0].start.time_s, throw.flights[-1].end_s
    # A billionth of a frame keeps the last frame of a throw whose length is a whole number of frames.
    frames = np.arange(int(np.ceil(begin * fps - 1e-9)), int(np.floor(end * fps + 1e-9)) + 1)
    if not len(frames):
        raise ValueError(f"a throw from {begin} s to {end} s has no frame at {fps} frames per second: raise fps")
    times = frames / fps
    positions, quaternions = throw.poses(times)
    unknown = np.full((len(frames), 6, 6), np.nan)
    return Track(frames, times, positions, continuous_sign(quaternions), unknown, np.full(len(frames), TRACKED))


def residuals(track: Track, simulated: Track) -> Residuals:
    """What lies between the two poses of each frame that both tracks know."""
    _, mine, theirs = np.intersect1d(
        track.frame[track.tracked], simulated.frame[simulated.tracked], return_indices=True
    )
    mine, theirs = np.flatnonzero(track.tracked)[mine], np.flatnonzero(simulated.tracked)[theirs]
    shift = track.position_m[mine] - simulated.position_m[theirs]
    turn = rotation_between(simulated.quaternion[theirs], track.quaternion[mine])
    whitened = _whitened_rms(np.hstack([shift, turn]), track.covariance[mine])
    turn_deg = np.rad2deg(turn)
    variances = np.einsum("nii->ni", track.covariance[mine])
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.where(variances > 0.0, variances, np.nan)) * ([1e3] * 3 + [np.rad2deg(1.0)] * 3)
    angle = np.linalg.norm(turn_deg, axis=1)
    return Residuals(track.frame[mine], track.time_s[mine], 1e3 * shift, turn_deg, errors, angle, whitened)


def _whitened_rms(errors: Array, covariances: Array) -> Array:
    """Root mean square (n,) of errors (n, 6) in units of their covariances (n, 6, 6); NaN where that has no inverse."""
    rms = np.full(len(errors), np.nan)
    for k, (error, covariance) in enumerate(zip(errors, covariances, strict=True)):
        if not np.isfinite(covariance).all() or np.linalg.matrix_rank(covariance, hermitian=True) < 6:
            continue
        rms[k] = np.sqrt(max(float(error @ np.linalg.solve(covariance, error)), 0.0) / 6.0)
    return rms
