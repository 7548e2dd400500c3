"""One frame: the pose of the die that explains its pixels, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..picture import (
    BLUR,
    CONTOUR,
    CONTOUR_PX,
    LOG_NOISE,
    PIXELS,
    RESPONSE,
    ROBUST_COST,
    Array,
    Image,
    NormalEquations,
    PoseState,
    View,
    Workspace,
    clear_shares,
    costs_with_edge_noise,
    new_equations,
    new_workspace,
    supports,
    whole_frame_windows,
)
from .refine_kernels import isotropic_prior, loose_prior, refine_and_score

CONVERGED_STEPS = 12
"""Most steps of a refinement that is run until it converges."""
CONVERGED_GAIN = 1e-4
"""Gain [squared sigmas] of its last step: it leaves no more than a hundredth of a sigma."""
BLUR_STEPS = 4
"""Gauss-Newton steps of the pose before the blur is estimated."""
SCALE_M = 1e-3
"""Unit of positions in which an information matrix is tested: millimetres and hundredths of a radian are of one
size."""
SCALE_RAD = 1e-2
"""Unit of rotations there."""
LEAST_EIGENVALUE_RATIO = 1e-9
"""Least over largest eigenvalue of an information matrix below which a direction counts as open."""


@dataclass(frozen=True, eq=False)
class Pose:
    """The pose of the die on one frame, and how well the pixels of this frame determine it."""

    position_m: Array
    """(3,) of the centre, world axes."""
    rotation: Array
    """(3, 3) body to world."""
    information: Array
    """(6, 6) inverse covariance from the pixels of this frame alone: position [m], rotation vector [rad], world
    axes."""
    bias_jacobian: Array
    """(6, k) change of the pose by errors that all frames share, see `bias_jacobians`."""
    unexplained: float
    """Mean truncated cost of an edge pixel, 0 to 1: the share that the edge model does not explain."""
    support: float
    """Length of contour that shows a clear step, over that which does in the mean if the pose is right; about 1 then."""
    clear_share: float
    """Share of the visible contour that shows a clear step, 0 to 1."""
    contour_px: float
    """Length of visible contour inside the image."""
    log_noise: float
    """Mean logarithm of the noise [grey] that the edge model leaves."""
    cost: float
    """Pose cost, see `tracking.picture.pose_costs`; comparable between poses of one frame only."""
    H: Array
    """(9, 9) normal equations of pose, contour error, blur and response."""
    statistics: Array
    """(STATISTICS,) counts of the kernels, see `ROBUST_COST` and those beside it."""

    @property
    def cost_with_edge_noise(self) -> float:
        """See `costs_with_edge_noise`."""
        return float(costs_with_edge_noise(np.array([self.cost]), self.statistics[None])[0])

    @property
    def covariance(self) -> Array | None:
        """(6, 6), or None if the pixels leave a direction open."""
        found = covariances(self.information[None])[0]
        return None if np.isnan(found[0, 0]) else found


def covariances(information: Array) -> Array:
    """Inverse (n, 6, 6) of each information (n, 6, 6); NaN if a direction is left open."""
    scale = np.array([SCALE_M] * 3 + [SCALE_RAD] * 3)
    scaled = information * np.outer(scale, scale)
    good = np.asarray(np.isfinite(scaled).all(axis=(1, 2)))
    values = np.linalg.eigvalsh(np.where(good[:, None, None], scaled, np.eye(6)))
    good = good & (values[:, 0] > LEAST_EIGENVALUE_RATIO * values[:, -1]) & (values[:, -1] > 0)
    inverse = np.linalg.inv(np.where(good[:, None, None], scaled, np.eye(6))) * np.outer(scale, scale)
    return np.where(good[:, None, None], inverse, np.nan)


def bias_jacobians(view: View, H: Array, positions_m: Array) -> Array:
    """(n, 6, k) change of each pose [m, rad] by errors that all frames share, from normal equations (n, 9, 9) at positions
    (n, 3): per pixel of contour error, and where the response is not known, per unit of its exponent. Zero if nothing was solved.
    The refinement's loose prior holds directions that the pixels leave open, and so their bias."""
    columns = [CONTOUR, RESPONSE] if view.response_sigma > 0.0 else [CONTOUR]
    return np.asarray(np.linalg.solve(H[:, :6, :6] + weak_priors(view, positions_m), H[:, :6, columns]))


def weak_priors(view: View, positions_m: Array) -> Array:
    """(n, 6, 6) information of the loose prior about poses at positions (n, 3), which holds what the pixels of a frame leave open
    if nothing is known of the motion."""
    return np.array([weak_prior(view, position) for position in positions_m]).reshape(-1, 6, 6)


def weak_prior(view: View, position_m: Array) -> Array:
    """The same (6, 6) about one pose."""
    return np.asarray(loose_prior(view.rig, view.settings, np.ascontiguousarray(position_m, float), view.reach_m))


def tracking_prior(view: View) -> Array:
    """(6, 6) information of the loose prior while the die is searched and tracked from frame to frame: as tight along the line of
    sight as across it. A tetrahedron that shows one face has no distance of its own, and was lost; another was taken inside out,
    since a depth reversal fits better if its distance is free."""
    return pose_prior(view.settings.loose_m, view.settings.loose_rad)


def pose_prior(sigma_m: float, sigma_rad: float) -> Array:
    """(6, 6) information of an isotropic prior: standard deviations of each coordinate of the centre, and of the rotation about
    each axis. It keeps directions that the pixels leave open near the initial pose. The distance of a small die is nearly open:
    it is pulled to the initial one."""
    return np.asarray(isotropic_prior(sigma_m, sigma_rad))


def pose_state(
    position_m: Array, rotation: Array, velocity_m_s: Array | None = None, omega_rad_s: Array | None = None
) -> PoseState:
    """A pose (3,), (3, 3), and the motion that blurs it; at rest unless velocities are given."""
    still = np.zeros(3)
    return PoseState(
        np.asarray(position_m, float),
        np.ascontiguousarray(rotation, float),
        still if velocity_m_s is None else velocity_m_s,
        still if omega_rad_s is None else omega_rad_s,
    )


def refine_pose(
    view: View,
    image: Image,
    start: PoseState,
    *,
    coarse: int = 2,
    prior: Array | None = None,
    roughly: bool = False,
    edges_alone: bool = False,
    work: Workspace | None = None,
) -> Pose:
    """The pose near an initial one, `start`, that explains a frame best, by its edges or its whole surface.

    `image` is the whole frame as float32, (height, width), or (cameras, height, width) for several cameras. `coarse` steps are
    done at larger blurs before those at the lens blur. `prior` (6, 6) is the information of the prior about the initial pose,
    `tracking_prior` if it is None. `roughly` stops where the view's quality says, not at convergence. `edges_alone` compares the
    edges of a well-rounded die instead of its whole surface, which takes a small part of the time: for many trials, the best of
    which are refined once more.
    """
    converged = view.settings._replace(fine_steps=CONVERGED_STEPS, min_gain=CONVERGED_GAIN, min_step_px=0.0)
    settings = view.tracking_settings if roughly else converged
    settings = settings._replace(whole_surface=not edges_alone)
    work = new_workspace(view.shape, view.rig) if work is None else work
    work.shared_grey[:] = 0.0
    equations = new_equations()
    if prior is None:
        prior = tracking_prior(view)
    p, Q, cost = refine_and_score(
        whole_frame_windows(view, image), view.model(settings), start, prior, coarse, work, equations
    )
    return _pose_from(view, p, Q, cost, equations)


def _pose_from(view: View, position_m: Array, rotation: Array, cost: float, equations: NormalEquations) -> Pose:
    """A pose from what the kernels return."""
    H, statistics = equations.H, equations.statistics
    pixels = max(statistics[PIXELS], 1.0)
    return Pose(
        position_m.copy(),
        rotation.copy(),
        H[:6, :6].copy(),
        bias_jacobians(view, H[None], position_m[None])[0],
        unexplained=float(statistics[ROBUST_COST] / pixels),
        support=float(supports(statistics)),
        clear_share=float(clear_shares(statistics)),
        contour_px=float(statistics[CONTOUR_PX]),
        log_noise=float(statistics[LOG_NOISE] / pixels),
        cost=float(cost),
        H=H.copy(),
        statistics=statistics.copy(),
    )


def blur_step(view: View, image: Image, start: PoseState) -> tuple[float, float]:
    """The Newton step of the lens blur [px] on one frame, with the pose eliminated, and its information [1/px²]; (0, 0)
    if there is none."""
    settings = view.settings._replace(
        fine_steps=BLUR_STEPS,
        min_gain=CONVERGED_GAIN,
        min_step_px=0.0,
        with_blur=True,
        with_response=False,
        region_pixels=0,
    )
    equations, prior = new_equations(), weak_prior(view, start.position)
    refine_and_score(
        whole_frame_windows(view, image), view.model(settings), start, prior, 0,
        new_workspace(view.shape, view.rig), equations,
    )  # fmt: skip
    H, g = equations.H, equations.g
    A = H[:6, :6] + prior
    moved = np.linalg.solve(A, np.stack([H[:6, BLUR], g[:6]], axis=1))
    information = float(H[BLUR, BLUR] - H[:6, BLUR] @ moved[:, 0])
    right = float(g[BLUR] - H[:6, BLUR] @ moved[:, 1])
    return (right / information, information) if information > 0.0 else (0.0, 0.0)
