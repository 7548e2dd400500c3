"""tracking.sequence.motion_filter."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from ...model.compiled import compiled, inner_no_memory, inner_nogil
from ...model.world import GRAVITY_M_S2
from ..picture import (
    ACCEPTED_EXCESS_COST,
    ACCEPTED_EXCESS_COST_ON_PATH,
    COVARIANCE_GROWTH,
    NARROW_WINDOW_PX,
    OCCLUDED_SHARE,
    OCCLUDER_CHANGED_SIGMAS,
    OCCLUDER_HALF_WIDTH_PX,
    OCCLUDER_RMS_SIGMAS,
    ON_PATH_CHI2,
    PARAMETERS,
    WINDOW_PX,
    CameraRig,
    FrameWindows,
    OccluderMask,
    RefinementSettings,
    Shape,
    Workspace,
    inverse_positive,
    new_workspace,
    outline_hull,
    place_die,
    product,
    reach_of_die,
    rotation_exp,
    rotation_log,
    scale_px,
    turn,
    turn_from,
    within_hull,
)
from ..pose import crop_windows, refine_and_score, store_frame

GRAVITY = GRAVITY_M_S2


@compiled(nogil=True)
def predict_motion(x: Any, R: Any, P: Any, dt: float) -> Any:
    """Carry a motion on by dt [s], also backwards: x (9,) is position, velocity, angular velocity; P (12, 12) the
    covariance of position, turn, velocity, angular velocity. Returns the rotation.

    δp' = δp + dt δv, δθ' = E δθ + dt (1 + W/2) δω with E = exp(ω dt) and W the cross matrix of ω dt: the left Jacobian
    to second order, enough for a covariance.
    """
    w = np.zeros(3)
    for a in range(3):
        w[a] = x[6 + a] * dt
        x[a] += x[3 + a] * dt
    x[2] -= 0.5 * GRAVITY * dt * dt
    x[5] -= GRAVITY * dt
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


@inner_nogil
def _innovation(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, settings: RefinementSettings, S: Any, z: Any) -> bool:
    """What a pose (p, Q) with information H adds to a motion: the difference z (6,), and the inverse S (6, 6) of its
    covariance; False where there is none.

    The pose's covariance is taken four times too large, and no smaller than a small part of the tight prior: what shading
    does to single poses goes on for many frames.
    """
    A = np.zeros((6, 6))
    for a in range(6):
        for b in range(6):
            A[a, b] = 0.25 * H[a, b]
        A[a, a] += 1.0 / (settings.loose_m**2 if a < 3 else settings.loose_rad**2)
    if not inverse_positive(A, np.int64(6), S):
        return False
    for a in range(6):
        for b in range(6):
            A[a, b] = S[a, b] + P[a, b]
    for a in range(3):
        z[a] = p[a] - x[a]
        A[a, a] += (settings.tight_m / 25.0) ** 2
        A[3 + a, 3 + a] += (settings.tight_rad / 12.0) ** 2
    rotation_log(turn_from(R, Q), z[3:])
    return inverse_positive(A, np.int64(6), S)


@inner_nogil
def innovation_squared(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, settings: RefinementSettings) -> float:
    """Squared distance of a pose from a motion, in the sigmas of both."""
    S, z = np.zeros((6, 6)), np.zeros(6)
    if not _innovation(x, R, P, p, Q, H, settings, S, z):
        return 1e9
    total = 0.0
    for a in range(6):
        for b in range(6):
            total += z[a] * S[a, b] * z[b]
    return total


@compiled(nogil=True)
def update_motion(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, settings: RefinementSettings) -> Any:
    """Let a motion learn from a pose (p, Q) with information H: the Kalman filter on positions and turns. Returns the
    rotation. P grows by FADE a frame, so that some twenty frames count.
    """
    S, gain, z = np.zeros((6, 6)), np.zeros((12, 6)), np.zeros(6)
    if not _innovation(x, R, P, p, Q, H, settings, S, z):
        return R
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


@inner_no_memory
def update_occluder_mask(
    windows: FrameWindows,
    backgrounds: Any,
    occluders: OccluderMask,
    rig: CameraRig,
    shape: Shape,
    settings: RefinementSettings,
    pos: Any,
    R: Any,
    work: Workspace,
) -> None:
    """Learn from one frame whose pose (pos, R) is known what stands before the die: pixels well inside the outline whose
    neighbourhood shows the background alone, and goes on to do so: what changes later was no screen, but a face as grey as
    the table. `backgrounds` become NaN there and SCREEN_PX beyond the whole neighbourhood, for a blurred border belongs to
    neither."""
    far = 2 * OCCLUDER_HALF_WIDTH_PX
    for view in range(rig.camera.shape[0]):
        c = rig.camera[view]
        mirrored = rig.partner[view] >= 0 and rig.partner[view] < view
        if mirrored or windows.size[c, 0] == 0 or not place_die(shape, rig, view, pos, R, work):
            continue
        count = outline_hull(shape, work)
        x0, y0 = windows.corner[c, 0], windows.corner[c, 1]
        width, height = windows.size[c, 0], windows.size[c, 1]
        still, image = occluders.still[c], windows.pixels[c]
        fresh = np.int64(0)
        for i in range(height):
            for j in range(width):
                if abs(image[i, j] - still[y0 + i, x0 + j]) > OCCLUDER_CHANGED_SIGMAS * settings.noise:
                    occluders.changed[c, y0 + i, x0 + j] = 1
                    if occluders.core[c, y0 + i, x0 + j] == 1:
                        occluders.core[c, y0 + i, x0 + j] = 0
                        occluders.found[0] -= 1
                        fresh += 1
        for i in range(OCCLUDER_HALF_WIDTH_PX, height - OCCLUDER_HALF_WIDTH_PX):
            for j in range(OCCLUDER_HALF_WIDTH_PX, width - OCCLUDER_HALF_WIDTH_PX):
                x, y = x0 + j, y0 + i
                if occluders.core[c, y, x] == 1 or not within_hull(
                    work.hull, count, float(x), float(y), -float(OCCLUDER_HALF_WIDTH_PX)
                ):
                    continue
                total, steady = 0.0, True
                for a in range(-OCCLUDER_HALF_WIDTH_PX, OCCLUDER_HALF_WIDTH_PX + 1):
                    for b in range(-OCCLUDER_HALF_WIDTH_PX, OCCLUDER_HALF_WIDTH_PX + 1):
                        steady = steady and occluders.changed[c, y + a, x + b] == 0
                        total += (image[i + a, j + b] - still[y + a, x + b]) ** 2
                    if not steady:
                        break
                if steady and total < (OCCLUDER_RMS_SIGMAS * settings.noise * (2 * OCCLUDER_HALF_WIDTH_PX + 1)) ** 2:
                    occluders.core[c, y, x] = 1
                    occluders.found[0] += 1
                    fresh += 1
        if fresh == 0:
            continue
        low_y, high_y = max(y0 - far, 0), min(y0 + height + far, still.shape[0])
        low_x, high_x = max(x0 - far, 0), min(x0 + width + far, still.shape[1])
        for y in range(low_y, high_y):
            for x in range(low_x, high_x):
                backgrounds[c, y, x] = still[y, x]
        for y in range(max(low_y - far, 0), min(high_y + far, still.shape[0])):
            for x in range(max(low_x - far, 0), min(high_x + far, still.shape[1])):
                if occluders.core[c, y, x] == 1:
                    for a in range(max(y - far, 0), min(y + far + 1, still.shape[0])):
                        for b in range(max(x - far, 0), min(x + far + 1, still.shape[1])):
                            backgrounds[c, a, b] = np.nan


@compiled(nogil=True)
def track_frames(
    frames: Any, times: Any, backgrounds: Any, occluders: OccluderMask, rig: CameraRig, shape: Shape,
    settings: RefinementSettings, x: Any, R: Any, P: Any, clock: Any, surprising: float, positions: Any,
    rotations: Any, H: Any, stats: Any, motions: Any, costs: Any,
) -> int:  # fmt: skip
    """Follow a die in flight over frames (n, cameras, height, width) at `times` (n,), as long as picture and motion tell
    the same story. Returns how many frames it did; the rows of the outputs are filled that far. A pose that lies
    `surprising` squared sigmas from where the motion led belongs to another story in any case.

    x (9,), R (3, 3), P (12, 12) are the motion at clock[0] [s], and are carried along with it; clock[1] is the usual cost
    of a pose, clock[2] how many poses of this flight have been seen. What turns out to stand before the die is put in
    `occluders`, and `backgrounds` become NaN there.
    """
    work = new_workspace(shape, rig)
    h, g, row = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS), np.zeros(8)
    reach, moved = reach_of_die(shape), np.zeros(3)
    for k in range(frames.shape[0]):
        ahead, P_ahead = x.copy(), P.copy()
        R_ahead = predict_motion(ahead, R, P_ahead, times[k] - clock[0])
        # Carried back to where they were known, variances cancel, and rounding may leave less than nothing.
        sigma_m = sqrt(max(P_ahead[0, 0], P_ahead[1, 1], P_ahead[2, 2], 0.0))
        sigma_rad = sqrt(max(P_ahead[3, 3], P_ahead[4, 4], P_ahead[5, 5], 0.0))
        off = scale_px(rig, ahead[:3]) * (sigma_m + sigma_rad * reach)
        coarse = 4 if off > 1.5 else (2 if off > 0.6 else (1 if off > 0.3 else 0))
        windows = crop_windows(
            frames[k], rig, shape, ahead[:3], R_ahead, WINDOW_PX if coarse > 0 else NARROW_WINDOW_PX, work
        )
        if windows.pixels.shape[1] == 0:
            return k
        prior_m = min(max(4.0 * sigma_m, settings.tight_m), settings.loose_m)
        prior_rad = min(max(4.0 * sigma_rad, settings.tight_rad), settings.loose_rad)
        p, Q, cost = refine_and_score(
            windows, backgrounds, rig, shape, settings, ahead[:3], R_ahead, ahead[3:6], ahead[6:9], prior_m, prior_rad,
            coarse, work, h, g, row,
        )  # fmt: skip
        new = clock[2] < 3.0
        far_m, far_rad = (0.28 * reach, 0.157) if new else (0.14 * reach, 0.035)
        rotation_log(turn_from(R_ahead, Q), moved)
        turned = sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2)
        gone = sqrt((p[0] - ahead[0]) ** 2 + (p[1] - ahead[1]) ** 2 + (p[2] - ahead[2]) ** 2)
        usual = clock[1] if clock[2] > 0.0 else cost
        seen_enough = row[3] >= 20.0 and row[4] > 0.45 * row[3] and h[0, 0] > 0.0
        # Where the pose is where the motion leads, a dearer picture only means that the light has changed; and what the
        # pixels leave open, as the distance of a face seen alone, may be far off.
        allowed = ACCEPTED_EXCESS_COST
        if not new and seen_enough and turned < far_rad:
            off = innovation_squared(ahead, R_ahead, P_ahead, p, Q, h, settings)
            if off > surprising:
                return k
            if off < ON_PATH_CHI2:
                allowed, far_m = 1e9 if row[4] > 0.6 * row[3] else ACCEPTED_EXCESS_COST_ON_PATH, 0.28 * reach
        if not (seen_enough and turned < far_rad and gone < far_m and cost < usual + allowed):
            return k
        for a in range(3):
            x[a], x[3 + a], x[6 + a] = ahead[a], ahead[3 + a], ahead[6 + a]
        for a in range(12):
            for b in range(12):
                P[a, b] = P_ahead[a, b]
        for a in range(6):
            motions[k, a] = ahead[3 + a]
        corrected = update_motion(x, R_ahead, P, p, Q, h, settings)
        for a in range(3):
            for b in range(3):
                R[a, b] = corrected[a, b]
        clock[0] = times[k]
        clock[1] = usual + (cost - usual) / min(clock[2] + 1.0, 8.0)
        clock[2] += 1.0
        store_frame(k, p, Q, h, row, cost, positions, rotations, H, stats, costs)
        if row[7] > OCCLUDED_SHARE or occluders.found[0] > 0:
            update_occluder_mask(windows, backgrounds, occluders, rig, shape, settings, p, Q, work)
    return frames.shape[0]
