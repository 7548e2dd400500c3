"""Calibration boards with a known camera with distortion: corners alone, and rendered pictures."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from diethrow.tracking.calibration.boards import CHARUCO, Board, BoardView, make_board
from diethrow.tracking.camera import Camera

Array = NDArray[np.float64]

CHARUCO_BOARD = make_board(CHARUCO, 7, 5, 0.010, 0.0075)
PLAIN_BOARD = make_board("chessboard", 8, 6, 0.009)
WIDTH, HEIGHT = 480, 400
MATRIX = np.array([[1500.0, 0.0, 246.0], [0.0, 1496.0, 193.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.25, 0.4, 8e-4, -5e-4, 0.0])
FINER = 3
"""Rays along each side of a pixel."""
PRINT_PX = 60
"""Resolution of the print, for each square."""


def poses(count: int, board: Board, seed: int = 3) -> list[tuple[Array, Array]]:
    """Board poses, tilted by 15 to 45 degrees to all sides, with the board near the middle or towards a corner."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        side, tilt = 2.0 * np.pi * (k * 0.618 + 0.1), np.radians(rng.uniform(15.0, 45.0))
        R = cv2.Rodrigues(tilt * np.array([np.cos(side), np.sin(side), 0.0]))[0]
        R = R @ cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-0.4, 0.4)]))[0]
        place = np.array([rng.uniform(-0.012, 0.012), rng.uniform(-0.010, 0.010), rng.uniform(0.33, 0.4)])
        found.append((R, place - R @ board.centre_m))
    return found


def corner_views(
    board: Board, where: list[tuple[Array, Array]], noise_px: float, seed: int, distortion: Array = DISTORTION
) -> list[BoardView]:
    """The corners of a board as a detector with white noise would give them."""
    rng = np.random.default_rng(seed)
    ids = np.arange((board.columns - 1) * (board.rows - 1))
    corners = board.corner_m(ids)
    views = []
    for k, (R, t) in enumerate(where):
        pixels = Camera(WIDTH, HEIGHT, MATRIX, distortion, R, t).project(corners)
        views.append(BoardView(f"{k}.png", ids, corners, pixels + noise_px * rng.normal(size=pixels.shape)))
    return views


def picture(board: Board, R: Array, t: Array, *, legacy: bool = False, noise_grey: float = 0.0) -> NDArray[np.uint8]:
    """A picture of a board with white border on a grey table, averaged over each pixel's area, with a little lens blur."""
    printed = _print(board, legacy)
    rays = _rays()
    depth = (R[:, 2] @ t) / (rays @ R[:, 2])
    on_board = (rays * depth[:, None] - t) @ R
    # A point at x metres lies at x / square · PRINT_PX - ½ in the print, behind a border of one square.
    at = (on_board[:, :2] / board.square_m + 1.0) * PRINT_PX - 0.5
    at = at.reshape(FINER * HEIGHT, FINER * WIDTH, 2).astype(np.float32)
    rendered = cv2.remap(
        printed, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110
    )
    levels = rendered.reshape(HEIGHT, FINER, WIDTH, FINER).mean((1, 3))
    levels = 25.0 + 0.75 * cv2.GaussianBlur(levels, (0, 0), 0.6)
    levels = levels + noise_grey * np.random.default_rng(5).normal(size=levels.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


@cache
def _rays() -> Array:
    """(n, 3) through every sample of every pixel."""
    fine = (np.arange(FINER) + 0.5) / FINER - 0.5
    u = (np.arange(WIDTH)[:, None] + fine).ravel()
    v = (np.arange(HEIGHT)[:, None] + fine).ravel()
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(pixels, MATRIX, DISTORTION, criteria=(cv2.TERM_CRITERIA_COUNT, 20, 1e-12)).reshape(-1, 2)
    return np.column_stack([rays, np.ones(len(rays))])


def _print(board: Board, legacy: bool) -> NDArray[np.float32]:
    """The board with a white border of one square, PRINT_PX pixels a square."""
    size = (board.columns * PRINT_PX, board.rows * PRINT_PX)
    if board.kind == CHARUCO:
        names = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        printed = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, names)
        printed.setLegacyPattern(legacy)
        picture = printed.generateImage(size)
    else:
        odd = np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2
        picture = np.kron(255 * odd, np.ones((PRINT_PX, PRINT_PX))).astype(np.uint8)
    return np.pad(picture, PRINT_PX, constant_values=255).astype(np.float32)


def table_pose_of(pitch_deg: float = 40.0, distance_m: float = 0.36) -> tuple[Array, Array]:
    """World to camera: from the side of -y, looking down at the origin."""
    pitch = np.radians(pitch_deg)
    ahead = np.array([0.2, np.cos(pitch), -np.sin(pitch)])
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(ahead, right), ahead])
    return rotation, np.array([0.0, 0.0, distance_m])


def on_table(board: Board, rotation: Array, shift: Array, thickness_m: float = 0.0) -> tuple[Array, Array]:
    """Board to camera, for a board that lies face up on the table, its middle above the origin."""
    R = rotation @ np.diag([1.0, -1.0, -1.0])
    return R, shift + rotation @ np.array([0.0, 0.0, thickness_m]) - R @ board.centre_m
