"""Refinement of a pose on the edges of its frame, compiled.

Gauss-Newton on the robust normal equations of all views (`tracking.picture`), with a Gaussian prior about the start:
what the motion says of the pose, or a loose isotropic one. An uncertain start begins with steps at larger blurs, whose
wider bands see edges that are farther away.
"""

from __future__ import annotations

from math import isnan, sqrt
from typing import Any

import numpy as np

from ...model.compiled import compiled, inner_no_memory
from ..picture import (
    BACKGROUND_SHARE,
    CLEAR_PX,
    CONTOUR_PX,
    LEAST_DEPTH_M,
    NARROW_WINDOW_PX,
    PARAMETERS,
    STATISTICS,
    WINDOW_PX,
    CameraRig,
    EdgeSampling,
    FrameWindows,
    NormalEquations,
    PictureModel,
    PoseRows,
    PoseState,
    RefinementSettings,
    Workspace,
    add_edge_equations,
    add_picture_equations,
    begin_light,
    cholesky_factor,
    clear_steps_cost,
    compares_surface,
    crop_windows,
    keep_light,
    lens_blur_at,
    new_equations,
    new_workspace,
    pose_cost,
    reach_of_die,
    region_cost,
    rotation_log,
    solve_factored,
    turn,
    turn_from,
    update_light,
    update_shared_greys,
)

COARSE_BLUR_AND_BAND_PX = ((4.0, 12.0), (3.0, 10.0), (2.2, 8.0), (1.6, 6.5), (1.2, 5.0))
"""Blur and half-width of the band [px] of the coarse steps; a refinement with n of them uses the last n."""
COARSE_STEPS = len(COARSE_BLUR_AND_BAND_PX)
"""Most coarse steps of a refinement."""
BAND_BLURS = 4.0
"""Half-width of the band at the lens blur, in blurs, at the least."""
STEP_FACTOR = 1.4
"""Factor on the steps at the lens blur. With the weights of the last residuals held, the normal equations are steeper
than the robust cost: by 1.2 for Gaussian residuals and by 1.6 on grain. A plain step left 38 % of the distance on wood.
Up to a factor of 2 the iteration converges wherever the equations are steeper at all."""
LARGEST_MOVE_PARTS = 3.0
"""A step moves the die by no more than its reach over this: edges of other faces come into the band beyond that."""
LARGEST_TURN_RAD = 0.14
"""The same of rotations: 8 degrees."""
FIRST_LIGHT_STEPS = 8
"""Most further steps until the light is settled that is on a die whose whole surface is compared, if nothing was known of it."""
SETTLED_COST = 0.02
"""Relative change of the surface's cost by a step from which its light counts as settled."""
LEAST_PIVOT = 1e-13
"""Part of its diagonal that a pivot of the pose's equations keeps at the least."""
REGION_MARGIN_PX = 8.0
"""Margin about the outline of the pixels that the region cost is taken over."""
MOST_LOOSER = 4.0
"""Most that the loose prior is looser along the line of sight than across it. Of an error of the start one part in
twenty stays where a frame's standard error is a fifth of the reach; from 6 on, a tetrahedron with a face edge-on, which shows two
lines of its contour, was lost."""
COARSE_RESTART_PX = 1.0
"""A refinement that moves the die by more than this began too far off to start at the lens blur: its band missed what a
coarser one sees."""
RESTART_COARSE_STEPS = 2
"""Coarse steps of the repeated refinement."""
WELL_SEEN = 0.6
"""Share of the contour with a clear step from which it counts as well seen; below, the refinement is repeated with
coarse steps."""
LEAST_CONTOUR_PX = 20.0
"""Least length [px] of contour in view that determines a pose; below, it is repeated as well."""


@compiled(nogil=True)
def isotropic_prior(sigma_m: float, sigma_rad: float) -> Any:
    """(6, 6) information of a prior with one standard deviation for all coordinates of the centre and one for all rotations."""
    prior = np.zeros((6, 6))
    for a in range(3):
        prior[a, a] = 1.0 / sigma_m**2
        prior[3 + a, 3 + a] = 1.0 / sigma_rad**2
    return prior


@compiled(nogil=True)
def loose_prior(rig: CameraRig, settings: RefinementSettings, pos: Any, reach: float) -> Any:
    """(6, 6) information of the loose prior about a pose at `pos` (3,): as loose along the line of sight of the first camera as
    across it, in the picture, but no more than MOST_LOOSER times as loose in metres. A step along it by a share of the distance
    changes the size of the die by this share.

    As tight in metres along it as across, the prior decided how far away a small die was: of an error of 5 mm at the start half
    or more remained in every frame.
    """
    prior = isotropic_prior(settings.loose_m, settings.loose_rad)
    sight, depth = np.zeros(3), 0.0
    for a in range(3):
        seen = rig.translation[0, a]
        for b in range(3):
            seen += rig.rotation[0, a, b] * pos[b]
        depth = seen
        for b in range(3):
            sight[b] += rig.rotation[0, a, b] * seen
    distance2 = sight[0] ** 2 + sight[1] ** 2 + sight[2] ** 2
    if depth > LEAST_DEPTH_M:
        share = min(max(reach / sqrt(distance2), 1.0 / MOST_LOOSER), 1.0)
        along = (share**2 - 1.0) / settings.loose_m**2 / distance2
        for a in range(3):
            for b in range(3):
                prior[a, b] += along * sight[a] * sight[b]
    return prior


@compiled(nogil=True)
def seen_distance_m(rig: CameraRig, pos: Any, step: Any, reach: float) -> float:
    """Distance [m] by which a step (3,) of a die's centre moves its farthest points at right angles to the line of sight,
    in the view that shows most of it.

    From a metre away, the size of a small die in the picture says only within centimetres how far it is.
    """
    most = 0.0
    for view in range(rig.camera.shape[0]):
        if rig.weight[view] > 0.0:
            depth = rig.translation[view, 2]
            for b in range(3):
                depth += rig.rotation[view, 2, b] * pos[b]
            most = max(most, _moved_px(rig, view, pos, step, 0.0, reach) * max(depth, 0.0) / rig.matrix[view, 0, 0])
    return most


@inner_no_memory
def _most_moved_px(rig: CameraRig, pos: Any, step: Any, turned: float, reach: float) -> float:
    """`_moved_px` in the view that shows most of it."""
    most = 0.0
    for view in range(rig.camera.shape[0]):
        most = max(most, _moved_px(rig, view, pos, step, turned, reach))
    return most


@inner_no_memory
def _moved_px(rig: CameraRig, view: int, pos: Any, step: Any, turned: float, reach: float) -> float:
    """Displacement in a picture [px] of the die's farthest points by a step (3,) [m] of the centre and a rotation that
    moves them by `turned` [m]; 0 behind the camera. A step along the line of sight moves them little."""
    x, y, z, depth = 0.0, 0.0, 0.0, rig.translation[view, 2]
    for b in range(3):
        x += rig.rotation[view, 0, b] * step[b]
        y += rig.rotation[view, 1, b] * step[b]
        z += rig.rotation[view, 2, b] * step[b]
        depth += rig.rotation[view, 2, b] * pos[b]
    if depth <= LEAST_DEPTH_M:
        return 0.0
    return rig.matrix[view, 0, 0] / depth * (sqrt(x * x + y * y) + reach * abs(z) / depth + turned)


@compiled(nogil=True, shared=True)
def refine_and_score(
    windows: FrameWindows, model: PictureModel, start: PoseState, prior: Any, coarse: int, work: Workspace,
    equations: NormalEquations,
) -> tuple[Any, Any, float]:  # fmt: skip
    """Refine a pose by Gauss-Newton, `coarse` steps at larger blurs first; return position (3,), rotation (3, 3) and
    pose cost.

    The prior is about the start, with information `prior` (6, 6) [1/m, 1/rad]. The equations become those of the pixels
    alone before the last step, both halves; H is zero if the pixels and the prior leave no solution. The cost is 0 where
    edges are compared and the settings ask for no region cost.

    The greys that stretches share are those of the step before. At the first step they are what the workspace holds:
    those of the frame before if the caller knows one, which saves two steps, or nothing.
    """
    rig, shape, settings = model.rig, model.shape, model.settings
    H, g, statistics = equations.H, equations.g, equations.statistics
    p, Q = start.position.copy(), start.rotation.copy()
    away, step = np.zeros(6), np.zeros(6)
    A, L, y = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
    reach, six = reach_of_die(shape), np.int64(6)
    work.grey_sums[:] = 0.0
    work.shared_faces[:] = 0
    begin_light(settings.light, work.light)
    last, before = coarse + settings.fine_steps - 1, np.inf
    is_settled = _knows_light(work) or not _compares_surface(model, start)
    for it in range(last + 1 + FIRST_LIGHT_STEPS):
        fine = it >= coarse
        if fine:
            blur, band = settings.blur_px, max(settings.band_px, BAND_BLURS * settings.blur_px)
        else:
            blur, band = COARSE_BLUR_AND_BAND_PX[COARSE_STEPS - coarse + it]
        H[:] = 0.0
        g[:] = 0.0
        statistics[:] = 0.0
        pose = PoseState(p, Q, start.velocity, start.omega)
        for view in range(rig.camera.shape[0]):
            if rig.weight[view] > 0.0 and windows.size[rig.camera[view], 0] > 0:
                lens = lens_blur_at(rig, view, p, blur)
                wide = max(band, BAND_BLURS * lens) if rig.aperture[view] > 0.0 else band
                sampling = EdgeSampling(lens, wide, settings.with_blur and fine, settings.with_response and fine)
                if settings.whole_surface:
                    add_picture_equations(view, windows, model, pose, sampling, work, equations)
                else:
                    add_edge_equations(view, windows, model, pose, sampling, work, equations)
        for a in range(PARAMETERS):
            for b in range(a):
                H[b, a] = H[a, b]
        for a in range(6):
            y[a] = g[a]
            for b in range(6):
                A[a, b] = H[a, b] + prior[a, b]
                y[a] -= prior[a, b] * away[b]
        if not cholesky_factor(A, six, L, LEAST_PIVOT):
            H[:] = 0.0
            break
        solve_factored(L, six, y, step)
        gain = 0.0
        for a in range(6):
            gain += step[a] * y[a]
        lp = sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        lr = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
        shrink = min(
            STEP_FACTOR if fine else 1.0,
            reach / LARGEST_MOVE_PARTS / max(lp, 1e-300),
            LARGEST_TURN_RAD / max(lr, 1e-300),
        )
        for a in range(6):
            step[a] *= shrink
            away[a] += step[a]
        for a in range(3):
            p[a] += step[a]
        Q = turn(Q, step[3:])
        update_shared_greys(work, step)
        update_light(work.light, step)
        moved_px = _most_moved_px(rig, start.position, step, shrink * lr * reach, reach)
        # A light of which nothing was known is found step by step, as the weights change.
        surface, _ = _surface_cost(work)
        is_settled = is_settled or abs(surface - before) <= SETTLED_COST * abs(surface)
        before = surface
        is_last = it == last or (fine and (gain < settings.min_gain or moved_px < settings.min_step_px))
        if is_settled and (is_last or it > last):
            break
    cost = 0.0
    region, differs = _surface_cost(work) if settings.whole_surface else (-1.0, 0.0)
    if region >= 0.0:
        cost = region + clear_steps_cost(statistics)
        statistics[BACKGROUND_SHARE] = 1.0 - differs
    elif settings.region_pixels > 0:
        pose = PoseState(p, Q, start.velocity, start.omega)
        region, differs = region_cost(windows, model, pose, REGION_MARGIN_PX, work)
        cost = pose_cost(region, statistics)
        statistics[BACKGROUND_SHARE] = 1.0 - differs
    return p, Q, cost


@compiled(nogil=True, shared=True)
def refine_uncertain(
    windows: FrameWindows, model: PictureModel, start: PoseState, prior: Any, coarse: int, enough: float, work: Workspace,
    equations: NormalEquations,
) -> tuple[Any, Any, float]:  # fmt: skip
    """`refine_and_score` from a start that may be far off.

    Where the whole surface is compared and the pose costs more than `enough`, it is refined with coarse steps as well, and as if
    nothing were known of the light; the pose of lowest cost counts. At a large blur marks and bevels run into each other, and its
    best pose may lie beyond another one; without it the die may be missed. A pose that is a little off and the light that
    explains it lead each other on from frame to frame."""
    if not _compares_surface(model, start):
        return refine_and_score(windows, model, start, prior, coarse, work, equations)
    p, Q, cost = refine_and_score(windows, model, start, prior, 0, work, equations)
    if cost < enough:
        return p, Q, cost
    best_coarse, is_last, known = 0, True, work.light.kept_level.copy()
    if coarse > 0:
        other_p, other_Q, other = refine_and_score(windows, model, start, prior, coarse, work, equations)
        is_last = other < cost
        if is_last:
            p, Q, cost, best_coarse = other_p, other_Q, other, coarse
    if known.max() > 0.0:
        work.light.kept_level[:] = 0.0
        other_p, other_Q, other = refine_and_score(windows, model, start, prior, 0, work, equations)
        work.light.kept_level[:] = known
        is_last = other < cost
        if is_last:
            p, Q, cost = other_p, other_Q, other
    if is_last:
        return p, Q, cost
    # Once more, for the equations and the light of this pose.
    return refine_and_score(windows, model, start, prior, best_coarse, work, equations)


@inner_no_memory
def _compares_surface(model: PictureModel, pose: PoseState) -> bool:
    """Whether whole surfaces are compared in any view."""
    for view in range(model.rig.camera.shape[0]):
        if model.rig.weight[view] > 0.0 and model.settings.whole_surface and compares_surface(view, model, pose):
            return True
    return False


@inner_no_memory
def _knows_light(work: Workspace) -> bool:
    """Whether the light is known from pictures before, in all views."""
    known = True
    for view in range(work.light.kept_level.shape[0]):
        known = known and work.light.kept_level[view] > 0.0
    return known


@inner_no_memory
def _surface_cost(work: Workspace) -> tuple[float, float]:
    """The region cost of the whole surface as the last step compared it, and the share of the die's pixels that differ from the
    background; -1 where edges were compared."""
    total, pixels, inside, differs = 0.0, 0.0, 0.0, 0.0
    for view in range(work.light.surface_cost.shape[0]):
        total += work.light.surface_cost[view, 0]
        pixels += work.light.surface_cost[view, 1]
        inside += work.light.surface_cost[view, 2]
        differs += work.light.surface_cost[view, 3]
    if pixels == 0.0:
        return -1.0, 0.0
    return total / pixels, differs / max(inside, 1.0)


@inner_no_memory
def store_frame(k: int, p: Any, Q: Any, cost: float, equations: NormalEquations, rows: PoseRows) -> None:
    """Write row k of the outputs. It copies number by number, which compiles in a tenth of the time of slices."""
    rows.cost[k] = cost
    for a in range(3):
        rows.position[k, a] = p[a]
        for b in range(3):
            rows.rotation[k, a, b] = Q[a, b]
    for a in range(PARAMETERS):
        for b in range(PARAMETERS):
            rows.H[k, a, b] = equations.H[a, b]
    for a in range(STATISTICS):
        rows.statistics[k, a] = equations.statistics[a]


@compiled(nogil=True)
def refine_frames(frames: Any, which: Any, model: PictureModel, enough: float, rows: PoseRows) -> None:
    """Refine the poses of frames number `which` (m,) of many (n, cameras, height, width) in place, each from its own
    start; the whole surface of a die that still costs more than `enough` is compared from there in several ways.

    The `rows` (m,) hold the starts and the motions; a start whose position is NaN is left out. Most starts lie so near
    that the lens blur alone suffices. A pose that moves by more than COARSE_RESTART_PX, or is badly seen, begins again
    from the start with coarser steps.
    """
    rig, shape, settings = model.rig, model.shape, model.settings
    work, equations = new_workspace(shape, rig), new_equations()
    statistics = equations.statistics
    moved, reach = np.zeros(3), reach_of_die(shape)
    A = np.zeros((6, 6))
    for k in range(which.shape[0]):
        rows.H[k] = 0.0
        if isnan(rows.position[k, 0]):
            continue
        start, R = rows.position[k].copy(), rows.rotation[k].copy()
        loose = loose_prior(rig, settings, start, reach)
        for again in range(2):
            if again:
                work.shared_grey[:] = 0.0
            first = PoseState(start, R, rows.motion[k, :3], rows.motion[k, 3:])
            windows = crop_windows(frames[which[k]], rig, shape, first, WINDOW_PX if again else NARROW_WINDOW_PX, work)
            if windows.pixels.shape[1] == 0:
                break
            coarse = RESTART_COARSE_STEPS * again
            p, Q, cost = refine_uncertain(windows, model, first, loose, coarse, enough, work, equations)
            store_frame(k, p, Q, cost, equations, rows)
            seen = (
                statistics[CLEAR_PX] > WELL_SEEN * statistics[CONTOUR_PX] and statistics[CONTOUR_PX] > LEAST_CONTOUR_PX
            )
            if seen and settings.whole_surface:
                for a in range(6):
                    for b in range(6):
                        A[a, b] = equations.H[a, b] + loose[a, b]
                keep_light(work.light, A)
            rotation_log(turn_from(R, Q), moved)
            turned = sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2)
            if seen and _most_moved_px(rig, start, p - start, reach * turned, reach) < COARSE_RESTART_PX:
                break
