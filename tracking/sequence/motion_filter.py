"""tracking.sequence.motion_filter."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from ...model.compiled import compiled
from ...model.world import GRAVITY_M_S2
from ..picture import (
    CHANGED_SIGMAS,
    COLUMNS,
    DEARER,
    FADE,
    MUCH_DEARER,
    NARROW_PX,
    NEAR,
    SCREEN_PX,
    SCREEN_SIGMAS,
    SCREENED,
    WINDOW_PX,
    Desk,
    Eyes,
    Lens,
    Screen,
    Shape,
    Sight,
    inner_no_memory,
    inner_nogil,
    inverse_positive,
    new_desk,
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
from ..pose import look, sight_of, write

GRAVITY = GRAVITY_M_S2


@compiled(nogil=True)
def coast(x: Any, R: Any, P: Any, dt: float) -> Any:
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
def _innovation(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, lens: Lens, S: Any, z: Any) -> bool:
    """What a pose (p, Q) with information H adds to a motion: the difference z (6,), and the inverse S (6, 6) of its
    covariance; False where there is none.

    The pose's covariance is taken four times too large, and no smaller than a small part of the tight prior: what shading
    does to single poses goes on for many frames.
    """
    A = np.zeros((6, 6))
    for a in range(6):
        for b in range(6):
            A[a, b] = 0.25 * H[a, b]
        A[a, a] += 1.0 / (lens.loose_m**2 if a < 3 else lens.loose_rad**2)
    if not inverse_positive(A, np.int64(6), S):
        return False
    for a in range(6):
        for b in range(6):
            A[a, b] = S[a, b] + P[a, b]
    for a in range(3):
        z[a] = p[a] - x[a]
        A[a, a] += (lens.tight_m / 25.0) ** 2
        A[3 + a, 3 + a] += (lens.tight_rad / 12.0) ** 2
    rotation_log(turn_from(R, Q), z[3:])
    return inverse_positive(A, np.int64(6), S)


@inner_nogil
def surprise(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, lens: Lens) -> float:
    """Squared distance of a pose from a motion, in the sigmas of both."""
    S, z = np.zeros((6, 6)), np.zeros(6)
    if not _innovation(x, R, P, p, Q, H, lens, S, z):
        return 1e9
    total = 0.0
    for a in range(6):
        for b in range(6):
            total += z[a] * S[a, b] * z[b]
    return total


@compiled(nogil=True)
def correct(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, lens: Lens) -> Any:
    """Let a motion learn from a pose (p, Q) with information H: the Kalman filter on positions and turns. Returns the
    rotation. P grows by FADE a frame, so that some twenty frames count.
    """
    S, gain, z = np.zeros((6, 6)), np.zeros((12, 6)), np.zeros(6)
    if not _innovation(x, R, P, p, Q, H, lens, S, z):
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
            P[i, j] *= FADE
    for a in range(3):
        x[a] += change[a]
        x[3 + a] += change[6 + a]
        x[6 + a] += change[9 + a]
    return turn(R, change[3:6])


@inner_no_memory
def note_screen(
    sight: Sight, backgrounds: Any, screen: Screen, eyes: Eyes, shape: Shape, lens: Lens, pos: Any, R: Any, desk: Desk
) -> None:
    """Learn from one frame whose pose (pos, R) is known what stands before the die: pixels well inside the outline whose
    neighbourhood shows the background alone, and goes on to do so: what changes later was no screen, but a face as grey as
    the table. `backgrounds` become NaN there and SCREEN_PX beyond the whole neighbourhood, for a blurred border belongs to
    neither."""
    far = 2 * SCREEN_PX
    for view in range(eyes.camera.shape[0]):
        c = eyes.camera[view]
        mirrored = eyes.partner[view] >= 0 and eyes.partner[view] < view
        if mirrored or sight.size[c, 0] == 0 or not place_die(shape, eyes, view, pos, R, desk):
            continue
        count = outline_hull(shape, desk)
        x0, y0 = sight.corner[c, 0], sight.corner[c, 1]
        width, height = sight.size[c, 0], sight.size[c, 1]
        still, image = screen.still[c], sight.pixels[c]
        fresh = np.int64(0)
        for i in range(height):
            for j in range(width):
                if abs(image[i, j] - still[y0 + i, x0 + j]) > CHANGED_SIGMAS * lens.noise:
                    screen.changed[c, y0 + i, x0 + j] = 1
                    if screen.core[c, y0 + i, x0 + j] == 1:
                        screen.core[c, y0 + i, x0 + j] = 0
                        screen.found[0] -= 1
                        fresh += 1
        for i in range(SCREEN_PX, height - SCREEN_PX):
            for j in range(SCREEN_PX, width - SCREEN_PX):
                x, y = x0 + j, y0 + i
                if screen.core[c, y, x] == 1 or not within_hull(
                    desk.hull, count, float(x), float(y), -float(SCREEN_PX)
                ):
                    continue
                total, steady = 0.0, True
                for a in range(-SCREEN_PX, SCREEN_PX + 1):
                    for b in range(-SCREEN_PX, SCREEN_PX + 1):
                        steady = steady and screen.changed[c, y + a, x + b] == 0
                        total += (image[i + a, j + b] - still[y + a, x + b]) ** 2
                    if not steady:
                        break
                if steady and total < (SCREEN_SIGMAS * lens.noise * (2 * SCREEN_PX + 1)) ** 2:
                    screen.core[c, y, x] = 1
                    screen.found[0] += 1
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
                if screen.core[c, y, x] == 1:
                    for a in range(max(y - far, 0), min(y + far + 1, still.shape[0])):
                        for b in range(max(x - far, 0), min(x + far + 1, still.shape[1])):
                            backgrounds[c, a, b] = np.nan


@compiled(nogil=True)
def chase(
    frames: Any, times: Any, backgrounds: Any, screen: Screen, eyes: Eyes, shape: Shape, lens: Lens, x: Any, R: Any,
    P: Any, clock: Any, surprising: float, positions: Any, rotations: Any, H: Any, stats: Any, motions: Any, costs: Any,
) -> int:  # fmt: skip
    """Follow a die in flight over frames (n, cameras, height, width) at `times` (n,), as long as picture and motion tell
    the same story. Returns how many frames it did; the rows of the outputs are filled that far. A pose that lies
    `surprising` squared sigmas from where the motion led belongs to another story in any case.

    x (9,), R (3, 3), P (12, 12) are the motion at clock[0] [s], and are carried along with it; clock[1] is the usual cost
    of a pose, clock[2] how many poses of this flight have been seen. What turns out to stand before the die is put in
    `screen`, and `backgrounds` become NaN there.
    """
    desk = new_desk(shape, eyes)
    h, g, row = np.zeros((COLUMNS, COLUMNS)), np.zeros(COLUMNS), np.zeros(8)
    reach, moved = reach_of_die(shape), np.zeros(3)
    for k in range(frames.shape[0]):
        ahead, P_ahead = x.copy(), P.copy()
        R_ahead = coast(ahead, R, P_ahead, times[k] - clock[0])
        # Carried back to where they were known, variances cancel, and rounding may leave less than nothing.
        sigma_m = sqrt(max(P_ahead[0, 0], P_ahead[1, 1], P_ahead[2, 2], 0.0))
        sigma_rad = sqrt(max(P_ahead[3, 3], P_ahead[4, 4], P_ahead[5, 5], 0.0))
        off = scale_px(eyes, ahead[:3]) * (sigma_m + sigma_rad * reach)
        coarse = 4 if off > 1.5 else (2 if off > 0.6 else (1 if off > 0.3 else 0))
        sight = sight_of(frames[k], eyes, shape, ahead[:3], R_ahead, WINDOW_PX if coarse > 0 else NARROW_PX, desk)
        if sight.pixels.shape[1] == 0:
            return k
        prior_m = min(max(4.0 * sigma_m, lens.tight_m), lens.loose_m)
        prior_rad = min(max(4.0 * sigma_rad, lens.tight_rad), lens.loose_rad)
        p, Q, cost = look(
            sight, backgrounds, eyes, shape, lens, ahead[:3], R_ahead, ahead[3:6], ahead[6:9], prior_m, prior_rad,
            coarse, desk, h, g, row,
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
        allowed = DEARER
        if not new and seen_enough and turned < far_rad:
            off = surprise(ahead, R_ahead, P_ahead, p, Q, h, lens)
            if off > surprising:
                return k
            if off < NEAR:
                allowed, far_m = 1e9 if row[4] > 0.6 * row[3] else MUCH_DEARER, 0.28 * reach
        if not (seen_enough and turned < far_rad and gone < far_m and cost < usual + allowed):
            return k
        for a in range(3):
            x[a], x[3 + a], x[6 + a] = ahead[a], ahead[3 + a], ahead[6 + a]
        for a in range(12):
            for b in range(12):
                P[a, b] = P_ahead[a, b]
        for a in range(6):
            motions[k, a] = ahead[3 + a]
        corrected = correct(x, R_ahead, P, p, Q, h, lens)
        for a in range(3):
            for b in range(3):
                R[a, b] = corrected[a, b]
        clock[0] = times[k]
        clock[1] = usual + (cost - usual) / min(clock[2] + 1.0, 8.0)
        clock[2] += 1.0
        write(k, p, Q, h, row, cost, positions, rotations, H, stats, costs)
        if row[7] > SCREENED or screen.found[0] > 0:
            note_screen(sight, backgrounds, screen, eyes, shape, lens, p, Q, desk)
    return frames.shape[0]
