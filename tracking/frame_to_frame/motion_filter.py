"""Tracking from frame to frame in flight, compiled: a Kalman filter on the rigid motion, with the refinement of each
frame as its measurement.

The state is position, rotation, velocity and angular velocity of a die in free fall, whose spin is taken as constant
from one frame to the next. Its covariance (12, 12) is that of (δp, δθ, δv, δω) in world axes, R_true = exp(δθ) R. Each
step predicts the motion for the next frame, refines the pose there, and updates the motion with it. The filter stops at
the first frame that the motion does not explain: a bounce, an occluder, a die out of view. What then happens is decided
in `frame_to_frame`.

The innovation is z = (p - p_pred, log(Q R_predᵀ)) with covariance S = P + P_pose; zᵀ S⁻¹ z, the normalised innovation
squared (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001), decides whether
a pose lies on the predicted path.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import compiled, inner_nogil
from ..picture import (
    BACKGROUND_SHARE,
    CLEAR_PX,
    CONTOUR_PX,
    EXPECTED_CLEAR_PX,
    NARROW_WINDOW_PX,
    OCCLUDED_SHARE,
    WINDOW_PX,
    CameraRig,
    OccluderMask,
    PictureModel,
    PoseRows,
    PoseState,
    RefinementSettings,
    Shape,
    Workspace,
    crop_windows,
    exposure_delay,
    inverse_positive,
    keep_light,
    new_equations,
    product,
    reach_of_die,
    rotation_exp,
    rotation_log,
    scale_px,
    turn,
    turn_from,
    update_occluder_mask,
)
from ..pose import LEAST_CONTOUR_PX, WELL_SEEN, refine_uncertain, seen_distance_m, store_frame
from .acceptance import (
    ACCEPTED_EXCESS_COST,
    BOUNCE_REACH,
    HEIGHT_SIGMAS,
    MAX_EXCESS_COST,
    MIN_POSES_OF_FLIGHT,
    MIN_SUPPORT,
    NEW_FLIGHT_RAD,
    NEW_FLIGHT_REACH,
    ON_PATH_CHI2,
    ON_PATH_SUPPORT,
    PRIOR_SIGMAS,
    SAME_FLIGHT_CHI2,
    USUAL_COST_FRAMES,
    YOUNG_FLIGHT_CHI2,
    YOUNG_FLIGHT_POSES,
)

COVARIANCE_GROWTH = 1.06
"""Factor on a motion's covariance per frame: about twenty frames count."""
POSE_INFORMATION_SHARE = 0.25
"""Factor on the information of a pose: the effect of shading on single poses lasts for many frames."""
POSITION_FLOOR_PARTS = 25.0
"""The tight prior of a position over the least standard deviation of a measured one."""
ROTATION_FLOOR_PARTS = 12.0
"""The same of rotations."""
NO_INNOVATION = 1e9
"""Squared innovation if a covariance cannot be inverted."""
ANY_COST = 1e9
"""Excess cost that no pose reaches. It is accepted on the predicted path if the contour is well seen: a changed light
does not move a pose onto the path by chance."""
FIRST_POSES_REACH = 0.28
"""Distance between prediction and pose, in units of the die's reach, that is accepted while the velocities of a flight
are not yet known: twice that of a known one."""
FIRST_POSES_RAD = 0.157
"""Rotation [rad] between them that is accepted there: 9 degrees. Well-filmed dice turn by 7 to 10 degrees a frame after
a hard impact."""
FOUR_COARSE_PX = 1.5
"""Standard deviation of a prediction [px] above which a refinement begins with four coarse steps."""
TWO_COARSE_PX = 0.6
"""The same for two coarse steps."""
ONE_COARSE_PX = 0.3
"""The same for one coarse step."""
ENOUGH_EXCESS_COST = 0.1
"""Cost above the usual, or that of the frame before if it is larger, up to which a pose of a well-rounded die is not compared
with others (`refine_uncertain`). Costs rise as other faces come into view, and a pose that begins without light was then often
taken for the better one: what many frames had shown of the light was lost."""
LIGHT_FRAMES = 8
"""One in so many poses of a flight is compared in any case: the usual cost follows that of a pose that leads away."""
DELAY_ITERATIONS = 3
"""Iterations for the instant at which a rolling shutter exposes a moving die."""


class MotionEstimate(NamedTuple):
    """The motion of a die with its covariance, updated in place."""

    x: Any
    """(9,) position [m], velocity [m/s], angular velocity [rad/s]."""
    rotation: Any
    """(3, 3) body to world."""
    P: Any
    """(12, 12) covariance of position, rotation, velocity, angular velocity."""
    gravity: float
    """[m/s²] along -z."""
    clock: Any
    """(3,) the time [s] of the estimate, the usual cost of a pose, and the number of poses of this flight."""


@compiled(nogil=True)
def predict_motion(x: Any, R: Any, P: Any, dt: float, gravity: float) -> Any:
    """Move a motion (9,) and its covariance (12, 12) in place by dt [s], which may be negative; return the rotation.

    δp' = δp + dt δv, δθ' = E δθ + dt (1 + W/2) δω with E = exp(ω dt) and W the cross matrix of ω dt: the left Jacobian
    to second order, enough for a covariance.
    """
    w = np.zeros(3)
    for a in range(3):
        w[a] = x[6 + a] * dt
        x[a] += x[3 + a] * dt
    x[2] -= 0.5 * gravity * dt * dt
    x[5] -= gravity * dt
    E = rotation_exp(w)
    M = np.eye(12)
    for a in range(3):
        M[a, 6 + a] = dt
        M[3 + a, 9 + a] = dt
        for b in range(3):
            M[3 + a, 3 + b] = E[a, b]
    M[3, 10] -= 0.5 * dt * w[2]
    M[3, 11] += 0.5 * dt * w[1]
    M[4, 9] += 0.5 * dt * w[2]
    M[4, 11] -= 0.5 * dt * w[0]
    M[5, 9] -= 0.5 * dt * w[1]
    M[5, 10] += 0.5 * dt * w[0]
    half = np.zeros((12, 12))
    for i in range(12):
        for j in range(12):
            s = 0.0
            for k in range(12):
                if M[i, k] != 0.0:
                    s += M[i, k] * P[k, j]
            half[i, j] = s
    for i in range(12):
        for j in range(i + 1):
            s = 0.0
            for k in range(12):
                if M[j, k] != 0.0:
                    s += half[i, k] * M[j, k]
            P[i, j] = s
            P[j, i] = s
    return product(E, R)


@compiled(nogil=True)
def predicted_delay(rig: CameraRig, x: Any, dt: float, gravity: float) -> float:
    """`exposure_delay` of a die whose motion (9,) leads for dt [s] to the time of a frame, and on until its row is
    exposed."""
    late = 0.0
    if rig.row_s[0] != 0.0:
        p = np.zeros(3)
        for _ in range(DELAY_ITERATIONS):
            t = dt + late
            for a in range(3):
                p[a] = x[a] + x[3 + a] * t
            p[2] -= 0.5 * gravity * t * t
            late = exposure_delay(rig, p)
    return late


@compiled(nogil=True)
def motion_prior(P: Any, settings: RefinementSettings) -> Any:
    """(6, 6) information of the prior on a pose from the covariance (12, 12) of the predicted motion.

    Its standard deviations are PRIOR_SIGMAS of the motion's, no less than the tight ones, and no more than the loose ones. What a
    picture leaves open, as the distance of a small die together with its tilt, the motion holds, and only that.
    """
    spread, prior = np.zeros((6, 6)), np.zeros((6, 6))
    for a in range(6):
        for b in range(6):
            spread[a, b] = PRIOR_SIGMAS**2 * P[a, b]
        spread[a, a] += settings.tight_m**2 if a < 3 else settings.tight_rad**2
    if not inverse_positive(spread, np.int64(6), prior):
        prior[:] = 0.0
    for a in range(6):
        prior[a, a] += 1.0 / (settings.loose_m**2 if a < 3 else settings.loose_rad**2)
    return prior


@inner_nogil
def _innovation(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, settings: RefinementSettings) -> tuple[bool, Any, Any]:
    """Whether a pose (p, Q) with information H has an innovation, the innovation z (6,), and the inverse S (6, 6) of
    its covariance."""
    S, z, A = np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6))
    for a in range(6):
        for b in range(6):
            A[a, b] = POSE_INFORMATION_SHARE * H[a, b]
        A[a, a] += 1.0 / (settings.loose_m**2 if a < 3 else settings.loose_rad**2)
    if not inverse_positive(A, np.int64(6), S):
        return False, S, z
    for a in range(6):
        for b in range(6):
            A[a, b] = S[a, b] + P[a, b]
    for a in range(3):
        z[a] = p[a] - x[a]
        A[a, a] += (settings.tight_m / POSITION_FLOOR_PARTS) ** 2
        A[3 + a, 3 + a] += (settings.tight_rad / ROTATION_FLOOR_PARTS) ** 2
    rotation_log(turn_from(R, Q), z[3:])
    return inverse_positive(A, np.int64(6), S), S, z


@compiled(nogil=True)
def innovation_squared(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, settings: RefinementSettings) -> float:
    """Normalised innovation squared of a pose: its squared distance from a predicted motion in the sigmas of both."""
    exists, S, z = _innovation(x, R, P, p, Q, H, settings)
    if not exists:
        return NO_INNOVATION
    total = 0.0
    for a in range(6):
        for b in range(6):
            total += z[a] * S[a, b] * z[b]
    return total


@compiled(nogil=True)
def same_flight_chi2(poses: float) -> float:
    """Normalised innovation squared below which a turned pose belongs to a flight of so many poses."""
    return YOUNG_FLIGHT_CHI2 if poses < YOUNG_FLIGHT_POSES else SAME_FLIGHT_CHI2


@compiled(nogil=True)
def update_motion(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, settings: RefinementSettings) -> Any:
    """Update a predicted motion (9,) and its covariance (12, 12) in place with a pose (p, Q) of information H; return
    the rotation.

    The covariance grows by COVARIANCE_GROWTH a frame, so that the filter forgets.
    """
    exists, S, z = _innovation(x, R, P, p, Q, H, settings)
    if not exists:
        return R
    gain = np.zeros((12, 6))
    for i in range(12):
        for a in range(6):
            for b in range(6):
                gain[i, a] += P[i, b] * S[b, a]
    change = np.zeros(12)
    for i in range(12):
        for a in range(6):
            change[i] += gain[i, a] * z[a]
    top = P[:6].copy()
    for i in range(12):
        for j in range(12):
            for a in range(6):
                P[i, j] -= gain[i, a] * top[a, j]
            P[i, j] *= COVARIANCE_GROWTH
    for a in range(3):
        x[a] += change[a]
        x[3 + a] += change[6 + a]
        x[6 + a] += change[9 + a]
    return turn(R, change[3:6])


@compiled(nogil=True)
def track_frames(
    frames: Any, times: Any, model: PictureModel, occluders: OccluderMask, motion: MotionEstimate, limits: Any,
    rows: PoseRows, work: Workspace,
) -> int:  # fmt: skip
    """Track a die in flight over frames (n, cameras, height, width) at `times` (n,) until a frame that its motion does
    not explain.

    Returns the number of frames that it explains; the `rows` (n,) are filled that far and the `motion` is moved there.
    A pose whose normalised innovation squared exceeds the first of the `limits` (2,) ends the tracking in any case. The second is
    the share that counts of what a turned pose may have (`same_flight_chi2`): 0 for a hypothesis, whose turned poses speak
    against it. Occluders that are found enter the mask, and the backgrounds of the model become NaN there. The workspace
    holds what the frames before showed of the light on the die, and gets what these show.
    """
    rig, shape, settings = model.rig, model.shape, model.settings
    x, R, P, clock = motion.x, motion.rotation, motion.P, motion.clock
    equations, A = new_equations(), np.zeros((6, 6))
    work.shared_grey[:] = 0.0
    statistics = equations.statistics
    reach, moved, last_cost = reach_of_die(shape), np.zeros(3), 0.0
    for k in range(frames.shape[0]):
        ahead, P_ahead = x.copy(), P.copy()
        late = predicted_delay(rig, x, times[k] - clock[0], motion.gravity)
        R_ahead = predict_motion(ahead, R, P_ahead, times[k] - clock[0] + late, motion.gravity)
        # Variances that are moved back to an instant where they were known cancel, and rounding may make them negative.
        sigma_m = sqrt(max(P_ahead[0, 0], P_ahead[1, 1], P_ahead[2, 2], 0.0))
        sigma_rad = sqrt(max(P_ahead[3, 3], P_ahead[4, 4], P_ahead[5, 5], 0.0))
        coarse = _coarse_steps(scale_px(rig, ahead[:3]) * (sigma_m + sigma_rad * reach))
        predicted = PoseState(ahead[:3], R_ahead, ahead[3:6], ahead[6:9])
        windows = crop_windows(frames[k], rig, shape, predicted, WINDOW_PX if coarse > 0 else NARROW_WINDOW_PX, work)
        if windows.pixels.shape[1] == 0:
            return k
        prior = motion_prior(P_ahead, settings)
        enough = max(clock[1], last_cost) + ENOUGH_EXCESS_COST if clock[2] % LIGHT_FRAMES > 0.0 else 0.0
        p, Q, cost = refine_uncertain(windows, model, predicted, prior, coarse, enough, work, equations)
        new = clock[2] < MIN_POSES_OF_FLIGHT
        far_m = FIRST_POSES_REACH * reach if new else NEW_FLIGHT_REACH * reach
        far_rad = FIRST_POSES_RAD if new else NEW_FLIGHT_RAD
        rotation_log(turn_from(R_ahead, Q), moved)
        turned = sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2)
        gone = seen_distance_m(rig, p, p - ahead[:3], reach)
        usual = clock[1] if clock[2] > 0.0 else cost
        clear_px, expected_px = statistics[CLEAR_PX], statistics[EXPECTED_CLEAR_PX]
        is_visible = statistics[CONTOUR_PX] >= LEAST_CONTOUR_PX and equations.H[0, 0] > 0.0
        seen = is_visible and clear_px > ON_PATH_SUPPORT * expected_px
        confirmed = seen and clear_px > MIN_SUPPORT * expected_px
        # On the predicted path a higher cost only means that the light has changed. A direction that the pixels leave
        # open, as the distance of a face seen alone, may be far off there; and high above the table no impact has occurred.
        allowed = ACCEPTED_EXCESS_COST
        high = lowest_m(shape, ahead, R_ahead) - HEIGHT_SIGMAS * sigma_m > BOUNCE_REACH * reach
        if not new and high:
            far_m, far_rad = FIRST_POSES_REACH * reach, FIRST_POSES_RAD
        if not new and seen and turned < FIRST_POSES_RAD:
            off = innovation_squared(ahead, R_ahead, P_ahead, p, Q, equations.H, settings)
            if turned >= far_rad:
                if off < limits[1] * same_flight_chi2(clock[2]):
                    far_rad = FIRST_POSES_RAD
            elif off > limits[0]:
                return k
            elif off < ON_PATH_CHI2:
                confirmed = True
                allowed = ANY_COST if clear_px > WELL_SEEN * statistics[CONTOUR_PX] else MAX_EXCESS_COST
                far_m = FIRST_POSES_REACH * reach
        if not (confirmed and turned < far_rad and gone < far_m and cost < usual + allowed):
            return k
        for a in range(3):
            x[a], x[3 + a], x[6 + a] = ahead[a], ahead[3 + a], ahead[6 + a]
        for a in range(12):
            for b in range(12):
                P[a, b] = P_ahead[a, b]
        for a in range(6):
            rows.motion[k, a] = ahead[3 + a]
        updated = update_motion(x, R_ahead, P, p, Q, equations.H, settings)
        for a in range(3):
            for b in range(3):
                R[a, b] = updated[a, b]
        clock[0] = times[k] + exposure_delay(rig, p)
        clock[1] = usual + (cost - usual) / min(clock[2] + 1.0, USUAL_COST_FRAMES)
        clock[2] += 1.0
        last_cost = cost
        store_frame(k, p, Q, cost, equations, rows)
        for a in range(6):
            for b in range(6):
                A[a, b] = equations.H[a, b] + prior[a, b]
        keep_light(work.light, A)
        if statistics[BACKGROUND_SHARE] > OCCLUDED_SHARE or occluders.count[0] > 0:
            pose = PoseState(p, Q, predicted.velocity, predicted.omega)
            update_occluder_mask(windows, model, occluders, pose, work)
    return frames.shape[0]


@compiled(nogil=True)
def lowest_m(shape: Shape, p: Any, R: Any) -> float:
    """Height [m] of the lowest point of a die above the table."""
    lowest = np.inf
    for v in range(shape.vertices.shape[0]):
        z = p[2] - shape.radius
        for a in range(3):
            z += R[2, a] * shape.vertices[v, a]
        lowest = min(lowest, z)
    return lowest


@inner_nogil
def _coarse_steps(error_px: float) -> int:
    """Coarse steps of a refinement whose start is off by about so much."""
    if error_px > FOUR_COARSE_PX:
        return 4
    if error_px > TWO_COARSE_PX:
        return 2
    return 1 if error_px > ONE_COARSE_PX else 0
