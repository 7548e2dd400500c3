"""The world's axes from one picture of a board that lies on the table: where the camera stands and what is down.

World axes: the origin is on the table under the middle of the board, x along its columns as printed, y against its rows, z up.
Board axes have z into the board, so that world from board is a half turn about x, and the printed side lies `thickness`
above the table.

A plane seen in perspective has two poses that draw nearly the same picture, mirror images of each other in tilt; which
is right shows only in how squares shrink with distance (Collins and Bartoli, "Infinitesimal plane-based pose estimation",
Int. J. Comput. Vis. 109, 252, 2014). Both are refined and compared: a difference of the sums of squares by less than
DECIDED sigmas squared decides nothing, and is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from .boards import Board
from .intrinsics import Calibration, SeenBoard

Array = NDArray[np.float64]

HALF_TURN = np.diag([1.0, -1.0, -1.0])
"""Board from world, in axes."""
DECIDED = 25.0
"""Squared sigmas between the two poses: the wrong one wins by chance as rarely as a five-sigma error."""
SAME_RAD = 2e-3
"""Poses nearer than this are one: the board is seen face on, or there is but one minimum."""
TOO_FLAT_RAD = np.radians(5.0)
"""A camera lower than this above the table sees a board too much from the side."""


@dataclass(frozen=True, eq=False)
class TablePose:
    """A camera with its place over the table."""

    camera: Camera
    covariance: Array
    """(6, 6) of (δθ [rad], δt [m]) in camera axes: rotation_true = exp(δθ) rotation, and translation_m."""
    board: SeenBoard
    rival_rotation: Array | None
    """(3, 3) world to camera of the other planar pose; None where there is none."""
    rival_rms_px: float | None
    """What the other pose leaves."""

    @property
    def tilt_sigma_rad(self) -> float:
        """Standard error of the vertical's direction."""
        up = self.camera.rotation[:, 2]
        across = np.eye(3) - np.outer(up, up)
        return float(np.sqrt(np.linalg.eigvalsh(across @ self.covariance[:3, :3] @ across)[-1]))


def table_pose(calibration: Calibration, board: Board, name: str, thickness_m: float = 0.0) -> TablePose:
    """The camera's place from the picture `name` of the calibration.

    Raises ValueError, in one sentence, where that picture was left out, cannot decide between the two planar poses, or shows
    the board from below.
    """
    seen = next((each for each in calibration.boards if each.view.name == name), None)
    if seen is None:
        raise ValueError(
            f"{name}: the picture with the board on the table does not fit the others; take it again, sharp, and with "
            "the lens as for the others and the clips"
        )
    poses = _planar_poses(calibration, seen)
    (R, t, squares), rivals = poses[0], poses[1:]
    rival = next((pose for pose in rivals if _angle(pose[0], R) > SAME_RAD), None)
    if rival is not None:
        _demand_decision(calibration, name, squares, rival)
    camera = _camera(calibration, board, R, t, thickness_m)
    _demand_above(camera, name)
    n = len(seen.view.ids)
    return TablePose(
        camera,
        _moved(seen.covariance, camera, t),
        seen,
        None if rival is None else rival[0] @ HALF_TURN,
        None if rival is None else float(np.sqrt(rival[2] / n)),
    )


def _planar_poses(calibration: Calibration, seen: SeenBoard) -> list[tuple[Array, Array, float]]:
    """Both poses of the plane, refined, best first: rotation, translation, sum of squares [px²]."""
    points, pixels = seen.view.corners_m, seen.view.pixels
    middle = points.mean(0)
    arguments = (calibration.matrix, calibration.distortion)
    _, turns, shifts, _ = cv2.solvePnPGeneric(points - middle, pixels, *arguments, flags=cv2.SOLVEPNP_IPPE)
    found = []
    for turn, shift in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(points - middle, pixels, *arguments, turn.copy(), shift.copy())
        drawn = cv2.projectPoints(points - middle, turn, shift, *arguments)[0].reshape(-1, 2)
        R = np.asarray(cv2.Rodrigues(turn)[0], float)
        found.append((R, np.asarray(shift, float).ravel() - R @ middle, float(((pixels - drawn) ** 2).sum())))
    return sorted(found, key=lambda pose: pose[2])


def _demand_decision(calibration: Calibration, name: str, squares: float, rival: tuple[Array, Array, float]) -> None:
    better = (rival[2] - squares) / calibration.sigma_px**2
    if better < DECIDED:
        raise ValueError(
            f"{name}: two poses of the table draw the board alike ({better:.2g} squared sigmas apart, wanted {DECIDED:g}); "
            "take the picture with a larger board, nearer, or from lower down"
        )


def _camera(calibration: Calibration, board: Board, R: Array, t: Array, thickness_m: float) -> Camera:
    rotation = R @ HALF_TURN
    shift = t + R @ board.centre_m - rotation @ np.array([0.0, 0.0, thickness_m])
    return Camera(
        calibration.width_px, calibration.height_px, calibration.matrix, calibration.distortion, rotation, shift
    )


def _demand_above(camera: Camera, name: str) -> None:
    centre = camera.centre_m
    height, distance = float(centre[2]), float(np.linalg.norm(centre))
    if height <= 0:
        raise ValueError(
            f"{name}: the camera would stand {-1e3 * height:.4g} mm below the table; the board lies face down, or the picture "
            "is mirrored or its corners are numbered the wrong way round, so look at --squares and take the picture again"
        )
    if height < distance * np.sin(TOO_FLAT_RAD):
        raise ValueError(
            f"{name}: the camera looks along the table, {np.degrees(np.arcsin(height / distance)):.2g} degrees above it; "
            "take the picture with the board flat on the table and the camera where it films"
        )


def _moved(covariance: Array, camera: Camera, t: Array) -> Array:
    """The covariance of (δθ, δt) of the board's origin, carried to the world's origin: x' = t + a, δt' = δt + δθ × a."""
    x, y, z = camera.translation_m - t
    M = np.eye(6)
    M[3:, :3] = -np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(M @ covariance @ M.T)


def _angle(a: Array, b: Array) -> float:
    return float(np.arccos(np.clip(0.5 * (np.trace(a @ b.T) - 1.0), -1.0, 1.0)))
