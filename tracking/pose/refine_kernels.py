"""tracking.pose.refine_kernels."""

from __future__ import annotations

from math import isnan, sqrt
from typing import Any

import numpy as np

from ...model.compiled import compiled, inner_no_memory, inner_nogil
from ..picture import (
    COARSE_BLUR_AND_BAND_PX,
    COARSE_RESTART_PX,
    NARROW_WINDOW_PX,
    PARAMETERS,
    STEP_FACTOR,
    WINDOW_PX,
    CameraRig,
    FrameWindows,
    RefinementSettings,
    Shape,
    Workspace,
    cholesky_factor,
    new_workspace,
    place_die,
    reach_of_die,
    region_cost,
    rotation_log,
    share_greys,
    solve_factored,
    turn,
    turn_from,
    view_equations,
)


@inner_no_memory
def _moved_px(rig: CameraRig, pos: Any, step: Any, turned: float, reach: float) -> float:
    """How far in the picture a step (3,) [m] of the centre and a turn by `turned` [m] at the die's `reach` move its farthest
    points, in the view that shows most of it: a step along the line of sight moves them little."""
    most = 0.0
    for view in range(rig.camera.shape[0]):
        x, y, z, depth = 0.0, 0.0, 0.0, rig.translation[view, 2]
        for b in range(3):
            x += rig.rotation[view, 0, b] * step[b]
            y += rig.rotation[view, 1, b] * step[b]
            z += rig.rotation[view, 2, b] * step[b]
            depth += rig.rotation[view, 2, b] * pos[b]
        if depth > 1e-6:
            aside = sqrt(x * x + y * y) + reach * abs(z) / depth + turned
            most = max(most, rig.matrix[view, 0, 0] / depth * aside)
    return most


@compiled(nogil=True)
def refine_and_score(
    windows: FrameWindows, backgrounds: Any, rig: CameraRig, shape: Shape, settings: RefinementSettings, pos: Any, R: Any,
    vel: Any, omega: Any, sigma_m: float, sigma_rad: float, coarse: int, work: Workspace, H: Any, g: Any, stats: Any,
) -> tuple[Any, Any, float]:  # fmt: skip
    """Refine a pose by Gauss-Newton, `coarse` steps at larger blurs first, and judge it: position (3,), rotation (3, 3)
    and cost.

    The prior is isotropic about the start: `sigma_m` and `sigma_rad` are its standard deviations. H (8, 8), g (8,) and
    `stats` (8,) are those of the pixels alone before the last step, see `view_equations`; the last of `stats` is the
    share of the die that shows nothing but the background. H is zero where the pixels and the prior leave no solution.

    The intensities that stretches share are those of the step before, and of the first step what the desk holds: those of the
    frame before where its user knows one, which takes two steps less, or nothing.
    """
    p, Q = pos.copy(), R.copy()
    away, step = np.zeros(6), np.zeros(6)
    A, L, y = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
    wp, wr = 1.0 / sigma_m**2, 1.0 / sigma_rad**2
    reach, six = reach_of_die(shape), np.int64(6)
    work.greys[:] = 0.0
    work.which[:] = 0
    for it in range(coarse + settings.fine_steps):
        fine = it >= coarse
        sigma, band = (
            (settings.blur, max(settings.band, 4.0 * settings.blur))
            if fine
            else COARSE_BLUR_AND_BAND_PX[len(COARSE_BLUR_AND_BAND_PX) - coarse + it]
        )
        H[:] = 0.0
        g[:] = 0.0
        stats[:] = 0.0
        for view in range(rig.camera.shape[0]):
            if rig.weight[view] > 0.0 and windows.size[rig.camera[view], 0] > 0:
                view_equations(
                    view, windows, backgrounds, rig, shape, p, Q, vel, omega, settings.exposure, sigma, band, settings.stride,
                    settings.floor_grey, settings.rounding_grey, settings.strip_share, settings.light, settings.full and fine,
                    work, H, g, stats,
                )  # fmt: skip
        for a in range(PARAMETERS):
            for b in range(a):
                H[b, a] = H[a, b]
        for a in range(6):
            for b in range(6):
                A[a, b] = H[a, b]
            w = wp if a < 3 else wr
            A[a, a] += w
            y[a] = g[a] - w * away[a]
        if not cholesky_factor(A, six, L, 1e-13):
            H[:] = 0.0
            break
        solve_factored(L, six, y, step)
        gain = 0.0
        for a in range(6):
            gain += step[a] * y[a]
        # One step may move the die by a third of its reach or turn it by 8 degrees at the most: edges of other faces
        # come into the band beyond that.
        lp = sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        lr = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
        shrink = min(STEP_FACTOR if fine else 1.0, reach / 3.0 / max(lp, 1e-300), 0.14 / max(lr, 1e-300))
        for a in range(6):
            step[a] *= shrink
            away[a] += step[a]
        for a in range(3):
            p[a] += step[a]
        Q = turn(Q, step[3:])
        share_greys(work, step)
        if fine and (
            gain < settings.enough or _moved_px(rig, pos, step, shrink * lr * reach, reach) < settings.settled_px
        ):
            break
    cost = 0.0
    if settings.samples > 0:
        cost, differs = region_cost(windows, backgrounds, rig, shape, p, Q, settings.noise, settings.samples, 8.0, work)
        stats[7] = 1.0 - differs
        cost += 2.0 * (1.0 - stats[4] / max(stats[3], 1e-9)) + 10.0 * stats[0] / max(stats[2], 1.0)
    return p, Q, cost


@inner_nogil
def crop_windows(
    pictures: Any, rig: CameraRig, shape: Shape, pos: Any, R: Any, margin: float, work: Workspace
) -> FrameWindows:
    """The windows of one frame's pictures (cameras, height, width) round the die, and its reflection, as placed."""
    cameras, height, width = pictures.shape
    corner, size = np.zeros((cameras, 2), np.int64), np.zeros((cameras, 2), np.int64)
    low, high = np.full((cameras, 2), 1e9), np.full((cameras, 2), -1e9)
    for view in range(rig.camera.shape[0]):
        if not place_die(shape, rig, view, pos, R, work):
            continue
        c = rig.camera[view]
        for a in range(2):
            low[c, a] = min(low[c, a], work.px[:, a].min() - margin)
            high[c, a] = max(high[c, a], work.px[:, a].max() + margin)
    rows, columns = 0, 0
    for c in range(cameras):
        x0, y0 = int(max(low[c, 0], 0.0)), int(max(low[c, 1], 0.0))
        x1, y1 = int(min(high[c, 0] + 1.0, float(width))), int(min(high[c, 1] + 1.0, float(height)))
        if x1 - x0 > 4 and y1 - y0 > 4:
            corner[c, 0], corner[c, 1], size[c, 0], size[c, 1] = x0, y0, x1 - x0, y1 - y0
            rows, columns = max(rows, y1 - y0), max(columns, x1 - x0)
    pixels = np.empty((cameras, rows, columns), np.float32)
    for c in range(cameras):
        for i in range(size[c, 1]):
            there, here = pictures[c, corner[c, 1] + i, corner[c, 0] :], pixels[c, i]
            for j in range(size[c, 0]):
                here[j] = there[j]
    return FrameWindows(pixels, corner, size)


@inner_no_memory
def store_frame(
    k: int, p: Any, Q: Any, h: Any, row: Any, cost: float, positions: Any, rotations: Any, H: Any, stats: Any,
    costs: Any,
) -> None:  # fmt: skip
    """Row k of the outputs; number by number, which is compiled in a tenth of the time that slices need."""
    costs[k] = cost
    for a in range(3):
        positions[k, a] = p[a]
        for b in range(3):
            rotations[k, a, b] = Q[a, b]
    for a in range(PARAMETERS):
        for b in range(PARAMETERS):
            H[k, a, b] = h[a, b]
    for a in range(8):
        stats[k, a] = row[a]


@compiled(nogil=True)
def refine_frames(
    frames: Any, which: Any, backgrounds: Any, rig: CameraRig, shape: Shape, settings: RefinementSettings, positions: Any,
    rotations: Any, motions: Any, H: Any, stats: Any, costs: Any,
) -> None:  # fmt: skip
    """Refine the poses of frames number `which` (m,) of many (n, cameras, height, width), each from its own start, in place; a
    start whose position is NaN is left out.

    Most starts lie so near that the lens blur does at once; where the pose moves by more than NEARBY_PX, it begins again
    from the start with coarser steps.
    """
    work = new_workspace(shape, rig)
    h, g, row = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS), np.zeros(8)
    moved, reach = np.zeros(3), reach_of_die(shape)
    for k in range(which.shape[0]):
        H[k] = 0.0
        if isnan(positions[k, 0]):
            continue
        start, R = positions[k].copy(), rotations[k].copy()
        for again in range(2):
            if again:
                work.usual[:] = 0.0
            windows = crop_windows(
                frames[which[k]], rig, shape, start, R, WINDOW_PX if again else NARROW_WINDOW_PX, work
            )
            if windows.pixels.shape[1] == 0:
                break
            p, Q, cost = refine_and_score(
                windows, backgrounds, rig, shape, settings, start, R, motions[k, :3], motions[k, 3:], settings.loose_m,
                settings.loose_rad, 2 * again, work, h, g, row,
            )  # fmt: skip
            store_frame(k, p, Q, h, row, cost, positions, rotations, H, stats, costs)
            rotation_log(turn_from(R, Q), moved)
            turned = sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2)
            if (
                _moved_px(rig, start, p - start, reach * turned, reach) < COARSE_RESTART_PX
                and row[4] > 0.6 * row[3]
                and row[3] > 20.0
            ):
                break
