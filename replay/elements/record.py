"""The input of a replay: the measured throw and, with a fit, the simulated one.

A `Motion` is one of the two, ready to draw: poses on frames, and the impacts between them. Residuals are the differences
of the two poses of a frame. No physics is computed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, Solid
from ...model.errors import InputError
from ...model.rotations import continuous_sign, matrix_from_quat, rotation_between
from ...model.throw import Impact, Throw
from ...tracking.track import TRACKED, Track

if TYPE_CHECKING:
    from ...fitting.predict import Estimate
    from ...fitting.results import Fit
    from ...tracking.camera import Camera
    from ...tracking.check import Finding
    from ...tracking.footage import Clip

Array = NDArray[np.float64]

FRAME_ROUNDING = 1e-9
"""Frames. Keeps the last frame of a throw whose duration is a whole number of frames up to rounding."""


@dataclass(frozen=True, eq=False)
class Record:
    """One analysed throw, from clip to fit. Fields that are None are left out of every picture."""

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
    """Results of fits to the frames up to the end of each flight, in the order of time; the last is `fit`."""
    notices: tuple[str, ...] = ()
    """Reservations about the footage and the tracking, one sentence each."""


@dataclass(frozen=True, eq=False)
class ReportDetails:
    """What a report shows of a run besides the throw. Fields that are empty or None are left out."""

    frames: Track | None = None
    """Poses of single frames, as the fit used them: their residuals show noise as noise."""
    findings: tuple[Finding, ...] = ()
    """Checks of timing and calibration on the finished throw."""
    origin: Mapping[str, Any] | None = None
    """Version, command, inputs with their SHA-256, packages and timings, by the keys of `provenance.json`."""
    tables: Mapping[str, str] = field(default_factory=dict)
    """Contents of tables that the page offers to save, by the names of their files."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One throw, `measured` or `simulated`, ready to draw."""

    name: str
    frame: NDArray[np.int64]
    """(n,) numbers of the frames with a pose, increasing."""
    time_s: Array
    """(n,)."""
    position_m: Array
    """(n, 3)."""
    quaternion: Array
    """(n, 4) wxyz, body to world."""
    missing_frame: NDArray[np.int64]
    """(m,) numbers of the frames without a pose; no die is drawn there."""
    missing_time_s: Array
    """(m,)."""
    throw: Throw | None
    """Flights and impacts; None if only poses are known."""

    @property
    def impacts(self) -> tuple[Impact, ...]:
        """Its bounces; none if only poses are known."""
        return self.throw.bounces if self.throw else ()

    @property
    def runs(self) -> list[slice]:
        """Runs of rows without a missing frame between them."""
        if not len(self.frame):
            return []
        missing_before = np.searchsorted(self.missing_frame, self.frame)
        cuts = np.flatnonzero(np.diff(missing_before)) + 1
        return [slice(int(a), int(b)) for a, b in zip([0, *cuts], [*cuts, len(self.frame)], strict=True)]

    def corners_m(self, solid: Solid) -> Array:
        """World positions (n, vertices, 3) [m] of the vertices."""
        rotations = matrix_from_quat(self.quaternion)
        return np.asarray(np.einsum("nij,vj->nvi", rotations, solid.vertices) + self.position_m[:, None])


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured minus simulated pose on the frames where both are known."""

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
    """(n,) root mean square of the six whitened components, near 1 if model and covariances are right; NaN where the frame
    has no covariance."""


def motion_of(name: str, track: Track, throw: Throw | None) -> Motion:
    """A track and its throw as a motion with this name."""
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
    """The measured motion and, if there is one, the simulated one."""
    motions = [motion_of("measured", record.track, record.measured)]
    if record.simulated is not None:
        motions.append(motion_of("simulated", record.simulated, record.fit.throw if record.fit else None))
    return motions


def track_of(throw: Throw, fps: float) -> Track:
    """The poses of a modelled throw on the frames of a camera at `fps` [Hz], from its first instant to its last.

    Frame k is at the time k / fps. Raises ValueError if fps is not positive or the throw contains no frame.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(f"fps = {fps}: wanted a finite number above 0")
    begin, end = throw.flights[0].start.time_s, throw.flights[-1].end_s
    frames = np.arange(int(np.ceil(begin * fps - FRAME_ROUNDING)), int(np.floor(end * fps + FRAME_ROUNDING)) + 1)
    if not len(frames):
        raise InputError(f"fps = {fps}: no frame falls between the {begin} s and {end} s of the throw; raise fps")
    times = frames / fps
    positions, quaternions = throw.poses(times)
    unknown = np.full((len(frames), 6, 6), np.nan)
    return Track(frames, times, positions, continuous_sign(quaternions), unknown, np.full(len(frames), TRACKED))


def residuals(track: Track, simulated: Track) -> Residuals:
    """The differences of the two poses on each frame that both tracks know."""
    _, row, simulated_row = np.intersect1d(
        track.frame[track.tracked], simulated.frame[simulated.tracked], return_indices=True
    )
    row, simulated_row = np.flatnonzero(track.tracked)[row], np.flatnonzero(simulated.tracked)[simulated_row]
    shift = track.position_m[row] - simulated.position_m[simulated_row]
    turn = rotation_between(simulated.quaternion[simulated_row], track.quaternion[row])
    whitened = _whitened_rms(np.hstack([shift, turn]), track.covariance[row])
    turn_deg = np.rad2deg(turn)
    variances = np.einsum("nii->ni", track.covariance[row])
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.where(variances > 0.0, variances, np.nan)) * ([1e3] * 3 + [np.rad2deg(1.0)] * 3)
    angle = np.linalg.norm(turn_deg, axis=1)
    return Residuals(track.frame[row], track.time_s[row], 1e3 * shift, turn_deg, errors, angle, whitened)


def _whitened_rms(errors: Array, covariances: Array) -> Array:
    """Root mean square (n,) of errors (n, 6) whitened by covariances (n, 6, 6); NaN where a covariance has no inverse."""
    rms = np.full(len(errors), np.nan)
    known = np.flatnonzero(np.isfinite(covariances).all((1, 2)))
    known = known[np.linalg.matrix_rank(covariances[known], hermitian=True) == 6]
    weighted = np.linalg.solve(covariances[known], errors[known, :, None])[..., 0]
    rms[known] = np.sqrt(np.maximum(np.einsum("ni,ni->n", errors[known], weighted), 0.0) / 6.0)
    return rms
