"""The world's axes from one picture of a board on the table: the place of the camera, and the vertical.

World axes: the origin is on the table under the middle of the board, x along its columns as printed, y against its rows, z up.
Board axes have z into the board, so the rotation from board to world is a half turn about x, and the printed side lies
`thickness_m` above the table.

A plane in perspective has two poses with nearly the same picture, mirror images of each other in tilt. Only the foreshortening of
the squares with distance distinguishes them (Collins and Bartoli, "Infinitesimal plane-based pose estimation", Int. J. Comput.
Vis. 109, 252, 2014). Both are refined and compared. A picture with sums of squares that differ by less than MIN_DIFFERENCE is
refused.

**One covariance.** The pose of the table shares the errors of the intrinsics: a focal length that is too long puts the table
too far away. It shares the error of the printed squares, too: where they are larger by the factor 1 + s, so are all distances,
and no picture of the board tells. Intrinsics, pose and s have one covariance, `TablePose.joint_covariance`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from ...model.rotations import angle_between, cross_matrix
from ..camera import Camera
from .boards import Board
from .intrinsics import INTRINSICS, Calibration, PosedBoard

Array = NDArray[np.float64]

JOINT = (*INTRINSICS, "rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "x_m", "y_m", "z_m", "board_scale")
"""What the joint covariance is of, by name: the intrinsics; (δθ, δt) in camera axes, rotation_true = exp(δθ) rotation; and s."""
HALF_TURN = np.diag([1.0, -1.0, -1.0])
"""(3, 3) rotation from world to board axes."""
MIN_DIFFERENCE = 25.0
"""Least difference of the two poses' sums of squares [squared sigmas]: the wrong pose fits better only by a five-sigma error."""
SAME_POSE_RAD = 2e-3
"""Poses nearer than this are the same: the board is seen face on, or there is only one minimum."""
MIN_ELEVATION_RAD = np.radians(5.0)
"""Least angle of the camera above the table: from lower down a board is seen too much from the side."""


@dataclass(frozen=True, eq=False)
class TablePose:
    """A camera with its pose over the table."""

    camera: Camera
    joint_covariance: Array
    """(16, 16) in the order of JOINT."""
    board: PosedBoard
    other_rotation: Array | None
    """(3, 3) world to camera of the other planar pose; None where there is none."""
    other_rms_px: float | None
    """Root mean square residual of the other pose."""

    @property
    def covariance(self) -> Array:
        """(6, 6) of (δθ [rad], δt [m]) in camera axes: rotation_true = exp(δθ) rotation, and translation_m."""
        pose = slice(len(INTRINSICS), len(INTRINSICS) + 6)
        return self.joint_covariance[pose, pose]

    @property
    def tilt_sigma_rad(self) -> float:
        """Standard error of the vertical's direction."""
        up = self.camera.rotation[:, 2]
        across = np.eye(3) - np.outer(up, up)
        return float(np.sqrt(np.linalg.eigvalsh(across @ self.covariance[:3, :3] @ across)[-1]))


def table_pose(calibration: Calibration, board: Board, name: str, thickness_m: float = 0.0) -> TablePose:
    """The pose of the camera from the picture `name` of the calibration.

    Raises ValueError where that picture was left out, does not distinguish the two planar poses, or shows the board from below.
    """
    posed = next((each for each in calibration.boards if each.view.name == name), None)
    if posed is None:
        raise InputError(
            f"{name}: the picture with the board on the table does not fit the others; take it again, sharp, with "
            "the same lens setting as for the others and the clips"
        )
    poses = _planar_poses(calibration, posed)
    (R, t, squares), others = poses[0], poses[1:]
    other = next((pose for pose in others if angle_between(pose[0], R) > SAME_POSE_RAD), None)
    if other is not None:
        _check_distinguished(calibration, name, squares, other)
    camera = _camera(calibration, board, R, t, thickness_m)
    _check_above_table(camera, name)
    n = len(posed.view.ids)
    return TablePose(
        camera,
        _joint_covariance(calibration, board, posed, camera, thickness_m),
        posed,
        None if other is None else other[0] @ HALF_TURN,
        None if other is None else float(np.sqrt(other[2] / n)),
    )


def _planar_poses(calibration: Calibration, posed: PosedBoard) -> list[tuple[Array, Array, float]]:
    """Both poses of the plane, refined, best first: rotation, translation, sum of squares [px²]."""
    points, pixels = posed.view.corners_m, posed.view.pixels
    middle = points.mean(0)
    arguments = (calibration.matrix, calibration.distortion)
    _, turns, shifts, _ = cv2.solvePnPGeneric(points - middle, pixels, *arguments, flags=cv2.SOLVEPNP_IPPE)
    found = []
    for turn, shift in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(points - middle, pixels, *arguments, turn.copy(), shift.copy())
        projected = cv2.projectPoints(points - middle, turn, shift, *arguments)[0].reshape(-1, 2)
        R = np.asarray(cv2.Rodrigues(turn)[0], float)
        found.append((R, np.asarray(shift, float).ravel() - R @ middle, float(((pixels - projected) ** 2).sum())))
    return sorted(found, key=lambda pose: pose[2])


def _check_distinguished(
    calibration: Calibration, name: str, squares: float, other: tuple[Array, Array, float]
) -> None:
    better = (other[2] - squares) / calibration.sigma_px**2
    if better < MIN_DIFFERENCE:
        raise InputError(
            f"{name}: two poses of the table fit alike ({better:.2g} squared sigmas apart; wanted {MIN_DIFFERENCE:g}); "
            "take the picture with a larger board, nearer, or from lower down"
        )


def _camera(calibration: Calibration, board: Board, R: Array, t: Array, thickness_m: float) -> Camera:
    rotation = R @ HALF_TURN
    shift = t + R @ board.centre_m - rotation @ np.array([0.0, 0.0, thickness_m])
    return Camera(
        calibration.width_px, calibration.height_px, calibration.matrix, calibration.distortion, rotation, shift
    )


def _check_above_table(camera: Camera, name: str) -> None:
    centre = camera.centre_m
    height, distance = float(centre[2]), float(np.linalg.norm(centre))
    if height <= 0:
        raise InputError(
            f"{name}: the camera would be {-1e3 * height:.4g} mm below the table: the board lies face down, the picture is "
            "mirrored, or the corners are numbered the other way round; check --squares and take the picture again"
        )
    if height < distance * np.sin(MIN_ELEVATION_RAD):
        raise InputError(
            f"{name}: the camera looks along the table, {np.degrees(np.arcsin(height / distance)):.2g} degrees above it; "
            "take the picture with the board flat on the table and the camera at its place for the clips"
        )


def _joint_covariance(
    calibration: Calibration, board: Board, posed: PosedBoard, camera: Camera, thickness_m: float
) -> Array:
    """(16, 16) in the order of JOINT."""
    k, n = len(INTRINSICS), len(JOINT)
    # From the board's origin to the world's: t' = t + a, δt' = δt + δθ × a.
    M = np.eye(6)
    M[3:, :3] = -cross_matrix(camera.translation_m - posed.translation_m)
    joint = np.zeros((n, n))
    joint[:k, :k] = calibration.covariance
    joint[:k, k:-1] = posed.with_intrinsics @ M.T
    joint[k:-1, :k] = joint[:k, k:-1].T
    joint[k:-1, k:-1] = M @ posed.covariance @ M.T
    by_scale = np.zeros(n)
    # The board's thickness is measured by itself.
    by_scale[k + 3 : -1] = camera.translation_m + camera.rotation @ np.array([0.0, 0.0, thickness_m])
    by_scale[-1] = 1.0
    return np.asarray(joint + board.scale_sigma**2 * np.outer(by_scale, by_scale))
