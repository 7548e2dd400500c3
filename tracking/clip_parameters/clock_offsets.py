"""The clocks of several cameras set to that of the first.

Cameras that run at one rate need not expose at one instant: the frame k of camera c shows the die a little later than that
of the first one, by an offset δ that stays the same over the clip. In flight the die of velocity v and spin ω is then seen
displaced by δ v and turned by δ ω. So what the edges of camera c alone say of the pose, less what those of the first alone say,
is on every frame

    x_c - x_0 = δ (v, ω) + a + e_c s_c - e_0 s_0 + noise,        noise ~ (0, P_c + P_0),

with x the six numbers of a pose (world axes) and P their covariance. a (six numbers with a prior) is what the calibration gets
wrong between the two cameras, e the change of a pose for a contour that is taken a pixel too far out and s by how many it is
(`lean`). Weighted least squares, frames far from the others left out by Tukey's biweight, gives δ with its standard error.
What tells δ from a is that v and ω change: by gravity a little, at a bounce much.

**Used** it is by way of the cameras. One that sees the motion x ↦ E x + u, E the rotation by δ ω, stands where

    R_c (E x + u) + t_c = (R_c E) x + (t_c + R_c u),        u = δ v + p - E p,

so the frame of a late camera is that of a synchronised camera in another place (`CameraRig`), for the p, v and ω of that frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from ...model.throw import State, Throw
from ..picture import CameraRig, View, make_view, shares_in_view
from ..pose import Pose, refine_pose
from ..throw import CONTOUR_SHARE, CONTOUR_SIGMA_PX

Array = NDArray[np.float64]
Image = NDArray[np.float32]

LOOKS = 60
"""Frames on which the cameras are compared: each tells a few per cent of a frame, and their mean under one per cent."""
FEWEST = 8
"""Frames below which nothing is said: there are nine numbers to be told apart."""
ASTRAY_M, ASTRAY_RAD = 3e-4, 3e-3
"""One sigma of what two calibrations against one table disagree in: half a pixel, seen at a hand's breadth of board."""
SIGNIFICANT = 3.0
"""Sigmas from which an offset is taken for one."""
NEAR_BOUNCE = 1.5
"""Frames from an impact within which the cameras are not compared: one may show the die before it and one behind."""
CUT_SIGMA = 4.685
"""Tukey's biweight: frames beyond carry no weight."""
ROUNDS = 8


@dataclass(frozen=True, eq=False)
class ClockOffsets:
    """By how much each camera exposes later than the first."""

    seconds: Array
    """(cameras,) 0 for the first, and for every one that shows no offset."""
    sigma_s: Array
    """(cameras,) standard error; NaN for the first, and where nothing could be told."""

    @staticmethod
    def none(cameras: int) -> ClockOffsets:
        """All cameras synchronised, as far as is known."""
        return ClockOffsets(np.zeros(cameras), np.full(cameras, np.nan))

    @property
    def any(self) -> bool:
        """Whether a camera is late or early at all."""
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

    `frame(k)` gives the pictures (cameras, height, width) of the frame at `times_s[k]`. One camera, or a throw without
    frames enough that several of them show whole, has none.
    """
    n = len(view.cameras)
    offsets = ClockOffsets.none(n)
    if n == 1:
        return offsets
    alone = [_alone(view, c) for c in range(n)]
    rows = _rows_in_flight(times_s, throw)
    looks = [_Look.at(alone, frame(int(k)), throw.at(float(times_s[k]))) for k in rows]
    radius_px = view.die.corner_radius_m * view.camera.matrix[0, 0] / _distance_m(view, throw)
    size_px = float(np.hypot(CONTOUR_SIGMA_PX, CONTOUR_SHARE * radius_px))
    for c in range(1, n):
        pairs = [(look, look.poses[0], look.poses[c]) for look in looks]
        rows_of_c = list(_rows(pairs))
        if len(rows_of_c) < FEWEST:
            continue
        late_s, sigma_s = _fitted(np.array(rows_of_c), size_px)
        offsets.sigma_s[c] = sigma_s
        offsets.seconds[c] = late_s if abs(late_s) > SIGNIFICANT * sigma_s else 0.0
    return offsets


def rig_at(rig: CameraRig, seconds: Array, position_m: Array, motion: Array) -> CameraRig:
    """Cameras that see, at the instant of the first one, what the late ones will see: for a die at `position_m` (3,) with
    `motion` (6,), velocity and angular velocity."""
    rotations, translations = rig.rotation.copy(), rig.translation.copy()
    for e, late_s in enumerate(seconds[rig.camera]):
        turn = matrix_from_quat(quat_from_rotvec(late_s * motion[3:]))
        shift = late_s * motion[:3] + position_m - turn @ position_m
        translations[e] += rotations[e] @ shift
        rotations[e] = rotations[e] @ turn
    return rig._replace(rotation=rotations, translation=translations)


def _alone(view: View, c: int) -> View:
    """The view of one of the cameras."""
    camera = view.cameras[c]
    background = view.backgrounds[c, : camera.height_px, : camera.width_px]
    mirror = bool((view.rig.partner >= 0).any())
    alone = make_view(
        camera, view.die, background, view.noise_grey, view.exposure_s, view.blur_px, rounding_grey=view.rounding_grey,
        mirror=mirror, quality=view.quality,
    )  # fmt: skip
    return replace(alone, light=view.light[view.rig.camera == c])


def _rows_in_flight(times_s: Array, throw: Throw) -> NDArray[np.int64]:
    """Some frames spread over those that surely lie on a flight."""
    spacing = float(np.median(np.diff(times_s)))
    known = np.array([flight.covariance is not None for flight in throw.flights])
    flying = known[throw.flights_at(times_s)]
    bounces = np.array([impact.time_s for impact in throw.impacts])
    if len(bounces):
        flying &= np.abs(times_s[:, None] - bounces).min(1) > NEAR_BOUNCE * spacing
    rows = np.flatnonzero(flying)
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(LOOKS, len(rows))).round().astype(int))]


def _distance_m(view: View, throw: Throw) -> float:
    return float(np.linalg.norm(throw.flights[0].start.position_m - view.camera.centre_m))


@dataclass(frozen=True, eq=False)
class _Look:
    """One instant as each camera alone sees it."""

    state: State
    poses: tuple[Pose | None, ...]
    """None where the camera does not show the whole die, or leaves a direction open."""

    @staticmethod
    def at(alone: list[View], pictures: NDArray[np.generic], state: State) -> _Look:
        return _Look(state, tuple(_pose(view, pictures[c], state) for c, view in enumerate(alone)))


def _pose(view: View, picture: NDArray[np.generic], state: State) -> Pose | None:
    if shares_in_view(view, state.position_m[None], state.rotation[None])[0] < 1.0:
        return None
    image = np.asarray(picture[: view.camera.height_px, : view.camera.width_px], np.float32)
    pose = refine_pose(
        view, image, state.position_m, state.rotation, velocity_m_s=state.velocity_m_s, omega_rad_s=state.omega_rad_s
    )
    return pose if pose.covariance is not None else None


def _rows(pairs: list[tuple[_Look, Pose | None, Pose | None]]) -> Iterator[Array]:
    """What each frame says, in sigmas: (6, 10), the derivatives with respect to δ, a, s_0 and s_c, and the difference."""
    for look, first, late in pairs:
        if first is None or late is None:
            continue
        assert first.covariance is not None
        assert late.covariance is not None
        turned = rotation_between(quat_from_matrix(first.rotation), quat_from_matrix(late.rotation))
        difference = np.concatenate([late.position_m - first.position_m, turned])
        moving = np.concatenate([look.state.velocity_m_s, look.state.omega_rad_s])
        columns = [
            moving[:, None],
            np.eye(6),
            -first.contour_bias_jacobian[:, None],
            late.contour_bias_jacobian[:, None],
        ]
        L = np.linalg.cholesky(first.covariance + late.covariance)
        yield np.linalg.solve(L, np.hstack([*columns, difference[:, None]]))


def _fitted(rows: Array, size_px: float) -> tuple[float, float]:
    """δ [s] and its standard error from rows (n, 6, 10), the errors as wide as they scatter but no less than stated."""
    prior = 1.0 / np.array([np.inf, *[ASTRAY_M] * 3, *[ASTRAY_RAD] * 3, size_px, size_px])
    weights = np.ones(len(rows))
    for _ in range(ROUNDS):
        A, b = rows[:, :, :9], rows[:, :, 9]
        normal = np.einsum("n,nij,nik->jk", weights, A, A)
        pull = np.einsum("n,nij,ni->j", weights, A, b)
        variance = 1.0
        for _ in range(3):  # the scale of the noise weighs the frames against the priors
            held = normal / variance + np.diag(prior**2)
            unit = 1.0 / np.sqrt(np.diag(held))
            inverse = np.linalg.inv(held * np.outer(unit, unit)) * np.outer(unit, unit)
            found = inverse @ (pull / variance)
            squares = ((b - A @ found) ** 2).mean(1)
            variance = max(1.0, float((weights * squares).sum() / max(weights.sum(), 1.0)))
        ratio = np.sqrt(squares / max(float(np.median(squares)), 1e-12)) / CUT_SIGMA
        weights = np.where(ratio < 1.0, (1.0 - ratio**2) ** 2, 0.0)
    return float(found[0]), float(np.sqrt(inverse[0, 0]))
