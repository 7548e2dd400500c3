"""Clock offsets between cameras of one frame rate.

Frame k of camera c shows the die later than frame k of the first camera, by an offset δ that is constant over the
clip. In flight a die of velocity v and angular velocity ω then appears displaced by δ v and rotated by δ ω. The pose
by the edges of camera c alone, minus that by the first alone, is on every frame

    x_c - x_0 = δ (v, ω) + a + e_c s_c - e_0 s_0 + noise,        noise ~ (0, P_c + P_0),

with x the six numbers of a pose (world axes) and P their covariance; a (six numbers with a prior) is the calibration
error between the two cameras, e the derivative of a pose by a displacement of the contour outwards, and s that
displacement in pixels. δ and its standard error follow by weighted least squares with Tukey's biweight over the
frames. δ is distinguished from a because v and ω change: by gravity a little, at an impact much.

**Use.** A camera that sees the motion x ↦ E x + u, E the rotation by δ ω, stands where

    R_c (E x + u) + t_c = (R_c E) x + (t_c + R_c u),        u = δ v + p - E p,

so the frame of a late camera is that of a synchronous camera at another pose (`CameraRig`), for the p, v and ω of
that frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from ...model.throw import State, Throw
from ..covariance import scaled_inverse
from ..picture import BIWEIGHT_CUT, CameraRig, LightPrior, PixelNoise, View, make_view, shares_in_view
from ..pose import Pose, pose_state, refine_pose
from ..throw import CONTOUR_SHARE, CONTOUR_SIGMA_PX

Array = NDArray[np.float64]

COMPARED_FRAMES = 60
"""Frames on which cameras are compared: each determines the offset to a few per cent of a frame, their mean to under
one."""
FEWEST_FRAMES = 8
"""Frames below which nothing is estimated: there are nine unknowns."""
CALIBRATION_SIGMA_M = 3e-4
"""Standard deviation of the displacement between two calibrations against one table: half a pixel, at a board of a
hand's breadth."""
CALIBRATION_SIGMA_RAD = 3e-3
"""Standard deviation of the rotation between two calibrations against one table."""
SIGNIFICANT_SIGMAS = 3.0
"""Standard errors from which an offset is applied."""
NEAR_IMPACT_FRAMES = 1.5
"""Frames from an impact within which cameras are not compared: one may show the die before it and one after."""
REWEIGHTINGS = 8
"""Iterations of the robust weights."""
VARIANCE_ITERATIONS = 3
"""Iterations of the noise variance between two of those: it weights the frames against the priors."""


@dataclass(frozen=True, eq=False)
class ClockOffsets:
    """By how much each camera exposes later than the first."""

    seconds: Array
    """(cameras,) 0 for the first, and for every one without a significant offset."""
    sigma_s: Array
    """(cameras,) standard error; NaN for the first, and where nothing could be estimated."""

    @staticmethod
    def none(cameras: int) -> ClockOffsets:
        """All cameras synchronous, as far as is known."""
        return ClockOffsets(np.zeros(cameras), np.full(cameras, np.nan))

    @property
    def any(self) -> bool:
        """Whether any camera has an offset."""
        return bool(self.seconds.any())

    def notices(self, frame_s: float) -> tuple[str, ...]:
        """One sentence for every camera with an offset; `frame_s` is the time between frames."""
        return tuple(
            f"camera {c + 1} exposes {1e6 * abs(late):.1f} ± {1e6 * sigma:.1f} µs {'later' if late > 0 else 'earlier'} than the "
            f"first ({abs(late) / frame_s:.3f} frames), which the poses take into account."
            for c, (late, sigma) in enumerate(zip(self.seconds, self.sigma_s, strict=True))
            if late
        )


def estimate_clock_offsets(
    view: View, frame: Callable[[int], NDArray[np.generic]], times_s: Array, throw: Throw
) -> ClockOffsets:
    """The offsets of the cameras of a view, from the flights of a throw.

    `frame(k)` gives the pictures (cameras, height, width) of the frame at `times_s[k]`. All offsets are 0 for one
    camera, or for fewer than FEWEST_FRAMES that show the whole die in flight to two of them.
    """
    n = len(view.cameras)
    offsets = ClockOffsets.none(n)
    if n == 1:
        return offsets
    alone = [_view_of_one(view, c) for c in range(n)]
    states, poses = [], []
    for k in _rows_in_flight(times_s, throw):
        state, pictures = throw.at(float(times_s[k])), frame(int(k))
        states.append(state)
        poses.append([_pose_by_edges(one, pictures[c], state) for c, one in enumerate(alone)])
    distance_m = float(np.linalg.norm(throw.flights[0].start.position_m - view.camera.centre_m))
    radius_px = view.die.corner_radius_m * view.camera.matrix[0, 0] / distance_m
    contour_px = float(np.hypot(CONTOUR_SIGMA_PX, CONTOUR_SHARE * radius_px))
    for c in range(1, n):
        both = ((state, of_frame[0], of_frame[c]) for state, of_frame in zip(states, poses, strict=True))
        rows = [
            _whitened_rows(state, first, late) for state, first, late in both if first is not None and late is not None
        ]
        if len(rows) < FEWEST_FRAMES:
            continue
        late_s, sigma_s = _fit_offset(np.array(rows), contour_px)
        offsets.sigma_s[c] = sigma_s
        offsets.seconds[c] = late_s if abs(late_s) > SIGNIFICANT_SIGMAS * sigma_s else 0.0
    return offsets


def rig_at(rig: CameraRig, seconds: Array, position_m: Array, motion: Array) -> CameraRig:
    """The poses from which synchronous cameras would see what the cameras see `seconds` (cameras,) later.

    They hold for a die at `position_m` (3,) with `motion` (6,), velocity and angular velocity.
    """
    rotations, translations = rig.rotation.copy(), rig.translation.copy()
    for view, late_s in enumerate(seconds[rig.camera]):
        turn = matrix_from_quat(quat_from_rotvec(late_s * motion[3:]))
        shift = late_s * motion[:3] + position_m - turn @ position_m
        translations[view] += rotations[view] @ shift
        rotations[view] = rotations[view] @ turn
    return rig._replace(rotation=rotations, translation=translations)


def _view_of_one(view: View, c: int) -> View:
    """The view of camera c alone."""
    camera = view.cameras[c]
    background = view.backgrounds[c, : camera.height_px, : camera.width_px]
    mirror = bool((view.rig.partner >= 0).any())
    noise = PixelNoise(view.noise_grey, view.rounding_grey, view.level_grey)
    alone = make_view(
        camera, view.die, background, noise, view.exposure_s, view.blur_px, mirror=mirror, quality=view.quality,
        readout_s=view.readout_s, gravity_m_s2=view.gravity_m_s2,
    )  # fmt: skip
    return replace(alone, light=LightPrior(*(values[view.rig.camera == c] for values in view.light)))


def _rows_in_flight(times_s: Array, throw: Throw) -> NDArray[np.int64]:
    """COMPARED_FRAMES spread over those that certainly lie on a flight."""
    spacing = float(np.median(np.diff(times_s)))
    known = np.array([flight.covariance is not None for flight in throw.flights])
    flying = known[throw.flights_at(times_s)]
    impacts_s = np.array([impact.time_s for impact in throw.impacts])
    if len(impacts_s):
        flying &= np.abs(times_s[:, None] - impacts_s).min(1) > NEAR_IMPACT_FRAMES * spacing
    rows = np.flatnonzero(flying)
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(COMPARED_FRAMES, len(rows))).round().astype(int))]


def _pose_by_edges(view: View, picture: NDArray[np.generic], state: State) -> Pose | None:
    """The pose by one camera; None if it does not show the whole die, or leaves a direction undetermined."""
    if shares_in_view(view, state.position_m[None], state.rotation[None])[0] < 1.0:
        return None
    image = np.asarray(picture[: view.camera.height_px, : view.camera.width_px], np.float32)
    pose = refine_pose(view, image, pose_state(state.position_m, state.rotation, state.velocity_m_s, state.omega_rad_s))
    return pose if pose.covariance is not None else None


def _whitened_rows(state: State, first: Pose, late: Pose) -> Array:
    """(6, 10) equations of one frame, in sigmas: derivatives by δ, a, s_0 and s_c, and the difference of the two
    poses."""
    assert first.covariance is not None
    assert late.covariance is not None
    rotation = rotation_between(quat_from_matrix(first.rotation), quat_from_matrix(late.rotation))
    difference = np.concatenate([late.position_m - first.position_m, rotation])
    rates = np.concatenate([state.velocity_m_s, state.omega_rad_s])
    columns = [rates, -first.bias_jacobian[:, 0], late.bias_jacobian[:, 0], difference]
    by_offset, by_first, by_late, right = (column[:, None] for column in columns)
    L = np.linalg.cholesky(first.covariance + late.covariance)
    return np.asarray(np.linalg.solve(L, np.hstack([by_offset, np.eye(6), by_first, by_late, right])))


def _fit_offset(rows: Array, contour_px: float) -> tuple[float, float]:
    """δ [s] and its standard error from rows (n, 6, 10), whose noise variance is estimated, at least 1."""
    calibration = [CALIBRATION_SIGMA_M] * 3 + [CALIBRATION_SIGMA_RAD] * 3
    prior = 1.0 / np.array([np.inf, *calibration, contour_px, contour_px])
    weights = np.ones(len(rows))
    for _ in range(REWEIGHTINGS):
        A, b = rows[:, :, :9], rows[:, :, 9]
        normal = np.einsum("n,nij,nik->jk", weights, A, A)
        gradient = np.einsum("n,nij,ni->j", weights, A, b)
        variance = 1.0
        for _ in range(VARIANCE_ITERATIONS):
            covariance = scaled_inverse(normal / variance + np.diag(prior**2))
            found = covariance @ (gradient / variance)
            squares = ((b - A @ found) ** 2).mean(1)
            variance = max(1.0, float((weights * squares).sum() / max(weights.sum(), 1.0)))
        ratio = np.sqrt(squares / max(float(np.median(squares)), 1e-12)) / BIWEIGHT_CUT
        weights = np.where(ratio < 1.0, (1.0 - ratio**2) ** 2, 0.0)
    return float(found[0]), float(np.sqrt(covariance[0, 0]))
