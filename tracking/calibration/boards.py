"""Calibration boards: their patterns, and the pixels of their corners on a picture.

The corners of a chessboard are the points where four squares meet. A ChArUco board has markers in its white squares that number
the corners, so part of it may be out of view. Board axes: x along the columns and y along the rows, both as printed, so z points
into the board; the origin is the outer corner at the upper left.

The corners are found by OpenCV (ChArUco: `CharucoDetector`; chessboards: the sector-based detector of Duda and Frese,
"Accurate detection and localization of checkerboard corners for calibration", BMVC 2018). Boards with an even number of
rows were printed the other way round before OpenCV 4.6; both patterns are tried, and the one that shows more corners is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from ..footage import Frame

Array = NDArray[np.float64]

CHARUCO = "charuco"
CHESSBOARD = "chessboard"
MIN_CORNERS = 6
"""Fewest corners of a picture: the pose of a plane and its homography need four, and two more check them."""
MIN_SQUARES = 3
"""Fewest squares along one side."""
MAX_SQUARES = 100
"""Most squares along one side: no camera resolves finer boards."""
PRINTED_SHARE = 1e-3
"""Standard error of the size of a printed board that was measured with a ruler, as a share of it."""
MOST_UNSURE = 0.1
"""A larger standard error of a square, as a share of its side, is in another unit."""
MAX_SQUARE_M = 1.0
"""Largest side of a square; a larger one is in another unit."""
BLACK_PERCENTILE = 0.1
"""Of the grey levels; it becomes 0 in the eight bits that the detectors take."""
WHITE_PERCENTILE = 99.9
"""Of the grey levels; it becomes 255."""
REFINED_SHARE = 0.75
"""Of the marker-free distance around a corner, used to refine it; on rendered boards this halves the detectors' error."""
CHESSBOARD_CLEAR_SHARE = 0.25
"""Of a square: distance around the corner of a chessboard that is used likewise, with a margin for perspective."""
SMALL_SQUARE_PERCENTILE = 10
"""Of the distances between neighbouring corners: the size of the smallest squares on the picture, less outliers."""
MIN_REFINED_PX = 2
"""Smallest half-width of a window for the refinement; with a smaller one the detector's corners stay."""
REFINEMENT_STEPS = 100
"""Most steps of the refinement of a corner; it usually takes five."""
REFINEMENT_PX = 1e-4
"""Step at which the refinement of a corner stops: far below its error."""
MAX_OFF_PLANE = 0.2
"""Largest distance of a corner from the homography of its board, in squares; one further away is not a corner of the board."""


@dataclass(frozen=True)
class Board:
    """A printed board."""

    kind: str
    """CHARUCO or CHESSBOARD."""
    columns: int
    """Squares along x."""
    rows: int
    """Squares along y."""
    square_m: float
    square_sigma_m: float
    """Standard error of the size of all squares."""
    marker_m: float = 0.0
    """Side of a marker; unused for a chessboard."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the markers' dictionary."""

    @property
    def scale_sigma(self) -> float:
        """Standard error of the board's size, as a share of it."""
        return self.square_sigma_m / self.square_m

    @property
    def centre_m(self) -> Array:
        """(3,) [m] centre of the printed squares, in board axes."""
        return 0.5 * self.square_m * np.array([self.columns, self.rows, 0.0])

    def corner_m(self, ids: NDArray[np.int64]) -> Array:
        """(n, 3) [m] inner corners in board axes, by their numbers (n,), which run along the rows."""
        inner = self.columns - 1
        return self.square_m * np.stack([ids % inner + 1, ids // inner + 1, 0 * ids], axis=1).astype(float)


@dataclass(frozen=True, eq=False)
class BoardView:
    """The corners of the board on one picture."""

    name: str
    """Name of the picture."""
    ids: NDArray[np.int64]
    """(n,) numbers of the corners."""
    corners_m: Array
    """(n, 3) in board axes."""
    pixels: Array
    """(n, 2) in the picture; pixel centres at integers."""

    def without(self, bad: NDArray[np.bool_]) -> BoardView:
        """The view without some of its corners, `bad` (n,)."""
        return BoardView(self.name, self.ids[~bad], self.corners_m[~bad], self.pixels[~bad])


def make_board(
    kind: str, columns: int, rows: int, square_m: float, marker_m: float | None = None, dictionary: str = "DICT_4X4_50",
    square_sigma_m: float | None = None,
) -> Board:  # fmt: skip
    """A board; without `square_sigma_m` its size is known to PRINTED_SHARE. Raises ValueError for one that cannot be printed or
    detected."""
    if kind not in (CHARUCO, CHESSBOARD):
        raise InputError(f"board = {kind}; wanted {CHARUCO} or {CHESSBOARD}")
    if not (MIN_SQUARES <= columns <= MAX_SQUARES and MIN_SQUARES <= rows <= MAX_SQUARES):
        raise InputError(
            f"squares = {columns}x{rows}; wanted {MIN_SQUARES} to {MAX_SQUARES} along each side, as in 7x5"
        )
    if not 0 < square_m <= MAX_SQUARE_M:
        raise InputError(
            f"square_mm = {1e3 * square_m:g}; wanted the side of a square in millimetres, above 0, at most {1e3 * MAX_SQUARE_M:g}"
        )
    sigma_m = PRINTED_SHARE * square_m if square_sigma_m is None else square_sigma_m
    if not 0.0 <= sigma_m < MOST_UNSURE * square_m:
        raise InputError(
            f"square_sigma_mm = {1e3 * sigma_m:g}; wanted the standard error of the side in millimetres, 0 or more, below "
            f"{1e3 * MOST_UNSURE * square_m:g}"
        )
    if kind == CHESSBOARD:
        return Board(kind, columns, rows, square_m, sigma_m)
    if marker_m is None or not 0 < marker_m < square_m:
        given = "missing" if marker_m is None else f"{1e3 * marker_m:g}"
        raise InputError(
            f"marker_mm = {given}; wanted the side of a marker in millimetres, above 0 and below the square's "
            f"{1e3 * square_m:g}"
        )
    if not (dictionary.startswith("DICT_") and hasattr(cv2.aruco, dictionary)):
        raise InputError(
            f"dictionary = {dictionary}; wanted a dictionary of OpenCV, for example DICT_4X4_50 or DICT_5X5_100"
        )
    markers, known = (columns * rows) // 2, len(_dictionary(dictionary).bytesList)
    if markers > known:
        raise InputError(
            f"dictionary = {dictionary}: it has {known} markers and a board of {columns}x{rows} needs {markers}; "
            "give the dictionary that the board was printed with"
        )
    return Board(kind, columns, rows, square_m, sigma_m, marker_m, dictionary)


def find_boards(pictures: Sequence[tuple[str, Frame]], board: Board) -> list[BoardView | None]:
    """The corners of the board on each named grey picture (height, width); None where it is not found.

    Raises ValueError where it is found only in the mirror image of a picture.
    """
    greys = [(name, eight_bits(picture)) for name, picture in pictures]
    if board.kind == CHESSBOARD:
        return [_find_chessboard(name, grey, board) for name, grey in greys]
    detectors = [_charuco_detector(board, legacy) for legacy in ((False, True) if board.rows % 2 == 0 else (False,))]
    found = [[_find_charuco(name, grey, board, detector) for name, grey in greys] for detector in detectors]
    totals = [sum(len(view.ids) for view in views if view is not None) for views in found]
    best = int(np.argmax(totals))
    _check_not_mirrored(greys, found[best], board, detectors[best])
    return found[best]


def eight_bits(picture: Frame) -> NDArray[np.uint8]:
    """Grey levels stretched to 0 ... 255, for dark pictures of cameras with many bits."""
    low, high = np.percentile(picture[::2, ::2], [BLACK_PERCENTILE, WHITE_PERCENTILE])
    scaled = (picture.astype(np.float32) - low) * (255.0 / max(high - low, 1.0))
    return np.clip(np.rint(scaled), 0, 255).astype(np.uint8)


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _charuco_detector(board: Board, legacy: bool) -> cv2.aruco.CharucoDetector:
    printed = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square_m, board.marker_m, _dictionary(board.dictionary)
    )
    printed.setLegacyPattern(legacy)
    return cv2.aruco.CharucoDetector(printed)


def _find_charuco(
    name: str, grey: NDArray[np.uint8], board: Board, detector: cv2.aruco.CharucoDetector
) -> BoardView | None:
    pixels, ids, _, _ = detector.detectBoard(grey)
    if ids is None or len(ids) < MIN_CORNERS:
        return None
    found = np.asarray(pixels, float).reshape(-1, 2)
    clear_share = 0.5 * (1.0 - board.marker_m / board.square_m)
    return _view(name, np.asarray(ids, np.int64).ravel(), _refined(grey, found, clear_share), board)


def _find_chessboard(name: str, grey: NDArray[np.uint8], board: Board) -> BoardView | None:
    size = (board.columns - 1, board.rows - 1)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not found:
        return None
    grid = np.asarray(corners, float).reshape(size[1], size[0], 2)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[:, ::-1]  # a chessboard looks the same from either end; no picture shows it from behind
    return _view(name, np.arange(size[0] * size[1]), _refined(grey, grid.reshape(-1, 2), CHESSBOARD_CLEAR_SHARE), board)


def _refined(grey: NDArray[np.uint8], pixels: Array, clear_share: float) -> Array:
    """Corners (n, 2) refined to the point where the gradients of the grey level meet (`cv2.cornerSubPix`).

    `clear_share` of a square around a corner is free of markers. The smallest squares on the picture decide the window.
    """
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2) + 1e9 * np.eye(len(pixels))
    half = int(REFINED_SHARE * clear_share * float(np.percentile(apart.min(1), SMALL_SQUARE_PERCENTILE)))
    if half < MIN_REFINED_PX:
        return pixels
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, REFINEMENT_STEPS, REFINEMENT_PX)
    start = pixels.astype(np.float32).reshape(-1, 1, 2)
    moved = np.asarray(cv2.cornerSubPix(grey, start, (half, half), (-1, -1), criteria), float).reshape(-1, 2)
    near = np.linalg.norm(moved - pixels, axis=1) < half
    return np.where(near[:, None], moved, pixels)


def _view(name: str, ids: NDArray[np.int64], pixels: Array, board: Board) -> BoardView | None:
    """The view without corners that are off the plane of the others; None where too few are left."""
    corners = board.corner_m(ids)
    if min(len(np.unique(corners[:, 0])), len(np.unique(corners[:, 1]))) < 2:
        return None
    plane, _ = cv2.findHomography(
        corners[:, :2], pixels, cv2.RANSAC, MAX_OFF_PLANE * _square_px(corners, pixels, board)
    )
    if plane is None:
        return None
    projected = cv2.perspectiveTransform(corners[None, :, :2], plane)[0]
    bad = np.linalg.norm(projected - pixels, axis=1) > MAX_OFF_PLANE * _square_px(corners, pixels, board)
    view = BoardView(name, ids, corners, pixels).without(bad)
    return view if len(view.ids) >= MIN_CORNERS else None


def _square_px(corners_m: Array, pixels: Array, board: Board) -> float:
    """Mean size [px] of a square on the picture, from the spread of the corners."""
    spread_m, spread_px = corners_m[:, :2].std(0).sum(), pixels.std(0).sum()
    return float(board.square_m * spread_px / spread_m)


def _check_not_mirrored(
    greys: Sequence[tuple[str, NDArray[np.uint8]]],
    views: Sequence[BoardView | None],
    board: Board,
    detector: cv2.aruco.CharucoDetector,
) -> None:
    """Raise ValueError for a mirrored picture: its markers can be read only in its mirror image."""
    for (name, grey), view in zip(greys, views, strict=True):
        if view is None and _find_charuco(name, np.ascontiguousarray(grey[:, ::-1]), board, detector) is not None:
            raise InputError(
                f"{name}: the picture is mirrored: its board can only be read in its mirror image; "
                "turn off the mirroring (flip) in the camera's software, for the clips as well"
            )
