"""One frame: the pose of the die that explains its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..picture import (
    BLUR,
    CONTOUR,
    PARAMETERS,
    Array,
    Image,
    RefinementSettings,
    View,
    Workspace,
    new_workspace,
    whole_frame_windows,
)
from .refine_kernels import refine_and_score

EXACT_STEPS, EXACTLY = 12, 1e-4
"""Steps and gain [squared sigmas] of a refinement that leaves no more than a hundredth of a sigma."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the die is on one frame, and how well the pixels of this frame say so."""

    position_m: Array
    rotation: Array
    """(3, 3) body to world."""
    information: Array
    """(6, 6) inverse covariance from the pixels of this frame alone: position [m], rotation vector [rad], world axes."""
    contour_bias_jacobian: Array
    """(6,) [m/px, rad/px] by how much the pose is off for every pixel that the contour is taken too far out."""
    unexplained: float
    """Mean truncated cost of an edge pixel, 0 to 1: the share that the edge model does not explain."""
    support: float
    """Share of the visible contour that shows a clear step, 0 to 1."""
    contour_px: float
    """Length of visible contour that was walked."""
    log_noise: float
    """Mean logarithm of the grey noise that the edge model leaves over."""
    cost: float
    """How badly the picture as a whole is explained; comparable between poses of one frame only."""
    equations: Array
    """(8, 8) normal equations of pose, contour error and blur."""
    stats: Array
    """(8,) what the kernels counted."""

    @property
    def misfit(self) -> float:
        """How badly the picture is explained as a whole and at the edges: see `misfits`."""
        return float(misfits(np.array([self.cost]), self.stats[None])[0])

    @property
    def covariance(self) -> Array | None:
        """(6, 6), or None where the pixels leave a direction open."""
        found = covariances(self.information[None])[0]
        return None if np.isnan(found[0, 0]) else found


def misfits(cost: Array, stats: Array) -> Array:
    """(n,) how badly pictures are explained: `cost` (n,) of each as a whole, and the mean logarithm of the noise that their edges
    leave over, from what the kernels counted (n, 8). Faces of nearly one grey cost a picture little wherever they part."""
    return np.asarray(cost + stats[:, 6] / np.maximum(stats[:, 2], 1.0))


def covariances(information: Array) -> Array:
    """Inverse (n, 6, 6) of each information (n, 6, 6); NaN where a direction is left open."""
    scale = np.array([1e-3] * 3 + [1e-2] * 3)
    scaled = information * np.outer(scale, scale)
    good = np.asarray(np.isfinite(scaled).all(axis=(1, 2)))
    values = np.linalg.eigvalsh(np.where(good[:, None, None], scaled, np.eye(6)))
    good = good & (values[:, 0] > 1e-9 * values[:, -1]) & (values[:, -1] > 0)
    inverse = np.linalg.inv(np.where(good[:, None, None], scaled, np.eye(6))) * np.outer(scale, scale)
    return np.where(good[:, None, None], inverse, np.nan)


def contour_bias_jacobians(H: Array, settings: RefinementSettings) -> Array:
    """(n, 6) from normal equations (n, 8, 8): what a pixel of contour error does to each pose; zero where nothing was
    solved. Directions that the pixels leave open are held by the refinement's own loose prior, and so is their lean."""
    return np.asarray(np.linalg.solve(H[:, :6, :6] + _loose(settings), H[:, :6, CONTOUR, None])[..., 0])


def weak_prior(view: View) -> Array:
    """(6, 6) information that holds what the pixels of a frame leave open: nothing is known of the motion."""
    return _loose(view.settings)


def _loose(settings: RefinementSettings) -> Array:
    return np.diag([1.0 / settings.loose_m**2] * 3 + [1.0 / settings.loose_rad**2] * 3)


def refine_pose(
    view: View,
    image: Image,
    position_m: Array,
    rotation: Array,
    *,
    velocity_m_s: Array | None = None,
    omega_rad_s: Array | None = None,
    coarse: int = 2,
    prior_position_m: float | None = None,
    prior_rotation_rad: float | None = None,
    roughly: bool = False,
    work: Workspace | None = None,
) -> Pose:
    """The pose near a predicted one that explains the frame's edges best.

    `image` is the whole frame as float32, a stack for several cameras; `coarse` is how many steps at larger blurs come
    before the fine ones; the prior keeps directions that the pixels leave open near the prediction and is too weak to
    pull the others. `roughly` stops where the view's quality says, and not where nothing moves any more.
    """
    H, g, stats = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS), np.zeros(8)
    exact = view.settings._replace(fine_steps=EXACT_STEPS, enough=EXACTLY, settled_px=0.0)
    zero, settings = np.zeros(3), view.tracking_settings if roughly else exact
    work = new_workspace(view.shape, view.rig) if work is None else work
    work.usual[:] = 0.0
    p, Q, cost = refine_and_score(
        whole_frame_windows(view, image), view.backgrounds, view.rig, view.shape, settings, np.asarray(position_m, float),
        np.ascontiguousarray(rotation, float), zero if velocity_m_s is None else velocity_m_s,
        zero if omega_rad_s is None else omega_rad_s, prior_position_m or settings.loose_m,
        prior_rotation_rad or settings.loose_rad, coarse, work, H, g, stats,
    )  # fmt: skip
    return pose_from(p, Q, H, stats, cost, settings)


def pose_from(
    position_m: Array, rotation: Array, H: Array, stats: Array, cost: float, settings: RefinementSettings
) -> Pose:
    """A pose from what the kernels leave."""
    return Pose(
        position_m.copy(),
        rotation.copy(),
        H[:6, :6].copy(),
        contour_bias_jacobians(H[None], settings)[0],
        unexplained=float(stats[0] / max(stats[2], 1.0)),
        support=float(stats[4] / max(stats[3], 1e-9)),
        contour_px=float(stats[3]),
        log_noise=float(stats[6] / max(stats[2], 1.0)),
        cost=float(cost),
        equations=H.copy(),
        stats=stats.copy(),
    )


def blur_step(
    view: View, image: Image, position_m: Array, rotation: Array, velocity_m_s: Array, omega_rad_s: Array
) -> tuple[float, float]:
    """What one frame says of the lens blur: the change [px] that fits it best, and the information [1/px²] behind it."""
    H, g, stats = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS), np.zeros(8)
    settings = view.settings._replace(fine_steps=4, enough=EXACTLY, settled_px=0.0, full=True, samples=0)
    refine_and_score(
        whole_frame_windows(view, image), view.backgrounds, view.rig, view.shape, settings, position_m, rotation, velocity_m_s,
        omega_rad_s, settings.loose_m, settings.loose_rad, 0, new_workspace(view.shape, view.rig), H, g, stats,
    )  # fmt: skip
    A = H[:6, :6] + _loose(settings)
    reply = np.linalg.solve(A, np.stack([H[:6, BLUR], g[:6]], axis=1))
    information = float(H[BLUR, BLUR] - H[:6, BLUR] @ reply[:, 0])
    pull = float(g[BLUR] - H[:6, BLUR] @ reply[:, 1])
    return (pull / information, information) if information > 0.0 else (0.0, 0.0)
