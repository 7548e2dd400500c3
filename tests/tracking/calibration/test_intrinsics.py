"""Laws of a calibration: the camera lies within its standard errors, these are consistent with the errors, and impossible input
is refused."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from pictures_of_boards import (
    CHARUCO_BOARD,
    DISTORTION,
    HEIGHT,
    MATRIX,
    PLAIN_BOARD,
    WIDTH,
    corner_views,
    on_table,
    picture,
    poses,
    table_pose_of,
)

from diethrow.model.rotations import quat_from_matrix, rotation_between
from diethrow.tracking.calibration.boards import Board, BoardView, find_boards, make_board
from diethrow.tracking.calibration.intrinsics import Calibration, calibrate
from diethrow.tracking.calibration.table_board import JOINT, table_pose
from diethrow.tracking.camera import Camera

TRUTH = np.array([MATRIX[0, 0], MATRIX[1, 1], MATRIX[0, 2], MATRIX[1, 2], *DISTORTION])


def rendered(board: Board, count: int = 8, **how: object) -> list[BoardView | None]:
    pictures = [(f"{k}.png", picture(board, *pose, **how)) for k, pose in enumerate(poses(count, board))]
    return find_boards(pictures, board)


def seen(views: list[BoardView | None]) -> list[BoardView]:
    return [view for view in views if view is not None]


@pytest.mark.parametrize("board", [CHARUCO_BOARD, PLAIN_BOARD], ids=lambda board: board.kind)
def test_corners_of_a_rendered_board_are_found_where_they_are(board: Board) -> None:
    for view, (R, t) in zip(rendered(board, 3, noise_grey=2.0), poses(3, board), strict=True):
        assert view is not None
        truth = Camera(WIDTH, HEIGHT, MATRIX, DISTORTION, R, t).project(view.corners_m)
        error = view.pixels - truth
        if board is PLAIN_BOARD and np.abs(error).max() > 5:
            error = view.pixels - truth[::-1]  # boards with even numbers of squares are symmetric
        # Detectors reach some hundredths of a pixel at this noise; half a pixel of offset would be another convention.
        assert np.abs(error.mean(0)).max() < 0.04
        assert error.std() < 0.1


def test_a_camera_comes_back_from_rendered_pictures() -> None:
    views = seen(rendered(CHARUCO_BOARD, 8, noise_grey=2.0))
    found = calibrate(views, WIDTH, HEIGHT)
    assert found.rms_px < 0.12
    # Errors of detected corners are correlated (blur, neighbouring squares): some sigmas more than for white noise are allowed.
    off = (found.values - TRUTH)[:4] / found.sigmas[:4]
    assert np.abs(off).max() < 6.0


@pytest.mark.parametrize("truth", [np.zeros(5), DISTORTION], ids=["no distortion", "distortion"])
def test_only_the_distortion_that_the_corners_bear_out_is_fitted(truth: np.ndarray) -> None:
    free = [
        len(calibrate(corner_views(PLAIN_BOARD, poses(10, PLAIN_BOARD), 0.1, s, truth), WIDTH, HEIGHT).free)
        for s in range(6)
    ]
    # Four are those of a pinhole. BIC takes a term too many in few per cent of the cases.
    assert np.median(free) == (4 if not truth.any() else max(5, np.median(free)))


def test_the_covariance_of_the_camera_is_honest() -> None:
    """NEES over seeds, chi-square with as many degrees of freedom as numbers: its mean over m draws has the standard
    deviation sqrt(2 k / m), and four of those are allowed."""
    where, m = poses(8, PLAIN_BOARD), 40
    truth = np.array([-0.25, 0.0, 0.0, 0.0, 0.0])
    values = np.concatenate([TRUTH[:4], truth])
    camera, pose = [], []
    for s in range(m):
        found = calibrate(corner_views(PLAIN_BOARD, where, 0.1, s, truth), WIDTH, HEIGHT)
        if found.free != ("fx", "fy", "cx", "cy", "k1"):
            continue
        error = (found.values - values)[:5]
        camera.append(error @ np.linalg.solve(found.covariance[:5, :5], error))
        R, t = where[2]
        first = found.boards[2]
        delta = np.concatenate(
            [rotation_between(*(quat_from_matrix(r) for r in (first.rotation, R))), t - first.translation_m]
        )
        pose.append(delta @ np.linalg.solve(first.covariance, delta))
    assert len(camera) > 0.7 * m
    for nees, k in ((camera, 5), (pose, 6)):
        assert abs(np.mean(nees) - k) < 4.0 * np.sqrt(2.0 * k / len(nees))


def test_standard_errors_are_those_of_another_implementation() -> None:
    views = corner_views(PLAIN_BOARD, poses(8, PLAIN_BOARD), 0.1, 1)
    found = calibrate(views, WIDTH, HEIGHT)
    given = [[getattr(v, name).astype(np.float32) for v in views] for name in ("corners_m", "pixels")]
    fixed = {"k1": cv2.CALIB_FIX_K1, "k2": cv2.CALIB_FIX_K2, "p1": cv2.CALIB_ZERO_TANGENT_DIST, "k3": cv2.CALIB_FIX_K3}
    flags = sum(flag for name, flag in fixed.items() if name not in found.free)
    theirs = cv2.calibrateCameraExtended(*given, (WIDTH, HEIGHT), None, None, flags=flags)[5].ravel()[:9]
    np.testing.assert_allclose(found.sigmas, theirs, rtol=0.02)  # theirs stops earlier, and counts its terms otherwise


def test_a_picture_that_does_not_fit_and_single_bad_corners_are_left_out_and_named() -> None:
    views = corner_views(CHARUCO_BOARD, poses(9, CHARUCO_BOARD), 0.05, 2)
    clean = calibrate(views, WIDTH, HEIGHT)
    bent = views[4].pixels + 0.002 * (views[4].pixels - views[4].pixels.mean(0)) ** 2
    views[4] = replace(views[4], pixels=bent)
    views[6].pixels[3] += 4.0
    found = calibrate(views, WIDTH, HEIGHT)
    assert [name for name, _ in found.left_out] == ["4.png"]
    assert found.corners_left_out == 1
    assert any("4.png" in notice for notice in found.notices)
    assert np.abs((found.values - clean.values)[:4] / clean.sigmas[:4]).max() < 3.0


def test_too_few_pictures_and_boards_seen_face_on_are_refused_or_reported() -> None:
    views = corner_views(CHARUCO_BOARD, poses(3, CHARUCO_BOARD), 0.05, 2)
    with pytest.raises(ValueError, match=r"3 pictures; wanted 4"):
        calibrate(views, WIDTH, HEIGHT)
    face_on = [(np.eye(3), np.array([0.002 * k, 0.0, 0.36]) - CHARUCO_BOARD.centre_m) for k in range(5)]
    try:
        notices = calibrate(corner_views(CHARUCO_BOARD, face_on, 0.05, 2), WIDTH, HEIGHT).notices
    except ValueError as error:
        notices = (str(error),)
    assert any("tilted" in notice for notice in notices)


def test_an_older_print_of_the_pattern_is_read_too() -> None:
    board = make_board("charuco", 7, 6, 0.009, 0.0065)
    for legacy in (False, True):
        views = rendered(board, 4, legacy=legacy)
        assert all(view is not None and len(view.ids) >= 25 for view in views)


def test_a_mirrored_picture_is_refused() -> None:
    R, t = poses(1, CHARUCO_BOARD)[0]
    with pytest.raises(ValueError, match=r"0\.png: .*mirrored"):
        find_boards([("0.png", np.ascontiguousarray(picture(CHARUCO_BOARD, R, t)[:, ::-1]))], CHARUCO_BOARD)


def test_a_board_is_found_on_a_dark_deep_picture_and_not_on_an_empty_one() -> None:
    R, t = poses(1, CHARUCO_BOARD)[0]
    dark = picture(CHARUCO_BOARD, R, t).astype(np.uint16) * 2
    views = find_boards([("dark.tif", dark), ("empty.tif", np.full_like(dark, 90))], CHARUCO_BOARD)
    assert views[0] is not None
    assert views[1] is None


def calibrated(where: list, noise_px: float = 0.05, seed: int = 2) -> Calibration:
    return calibrate(corner_views(CHARUCO_BOARD, where, noise_px, seed), WIDTH, HEIGHT)


@pytest.mark.parametrize("thickness_m", [0.0, 0.003])
def test_the_pose_of_the_camera_lies_within_its_covariance(thickness_m: float) -> None:
    rotation, shift = table_pose_of()
    where = [*poses(10, CHARUCO_BOARD), on_table(CHARUCO_BOARD, rotation, shift, thickness_m)]
    nees = []
    for seed in range(12):
        found = table_pose(calibrated(where, seed=seed), CHARUCO_BOARD, "10.png", thickness_m)
        turned = rotation_between(quat_from_matrix(found.camera.rotation), quat_from_matrix(rotation))
        error = np.concatenate([turned, shift - found.camera.translation_m])
        nees.append(error @ np.linalg.solve(found.covariance, error))
        assert found.tilt_sigma_rad < np.radians(0.2)
        assert np.linalg.norm(turned) < 5.0 * np.sqrt(np.trace(found.covariance[:3, :3]))
    # Mean of 12 draws of chi-square with six degrees of freedom: 6 ± 1. Distortion terms that BIC drops bias it a little.
    assert 3.0 < np.mean(nees) < 10.0


def test_the_joint_covariance_of_camera_table_and_board_is_honest() -> None:
    """Over draws of the corners' noise and of the size of the print. Where a point of the table appears is known to some
    hundredths of a pixel, for the board was seen there: focal length and distance err together."""
    rotation, shift = table_pose_of()
    lens = np.array([-0.25, 0.0, 0.0, 0.0, 0.0])
    where, names = [*poses(10, PLAIN_BOARD), on_table(PLAIN_BOARD, rotation, shift)], ("fx", "fy", "cx", "cy", "k1")
    used = [JOINT.index(name) for name in (*names, *JOINT[9:])]
    points = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [-0.01, 0.02, 0.0]])
    pixels = Camera(WIDTH, HEIGHT, MATRIX, lens, rotation, shift).project(points)
    nees, squares, shared, apart = [], [], [], []
    for seed in range(40):
        scale = 1.0 + PLAIN_BOARD.scale_sigma * np.random.default_rng(100 + seed).normal()
        # The board that was printed; what is stated are the squares of PLAIN_BOARD.
        true = replace(PLAIN_BOARD, square_m=scale * PLAIN_BOARD.square_m)
        seen_as = [*where[:-1], on_table(true, rotation, shift)]
        views = [replace(v, corners_m=v.corners_m / scale) for v in corner_views(true, seen_as, 0.1, seed, lens)]
        found = calibrate(views, WIDTH, HEIGHT)
        if found.free != names:
            continue
        placed = table_pose(found, PLAIN_BOARD, "10.png")
        turned = rotation_between(quat_from_matrix(placed.camera.rotation), quat_from_matrix(rotation))
        off = np.concatenate([TRUTH[:4], lens[:1]]) - found.values[:5]
        error = np.concatenate([off, turned, shift - placed.camera.translation_m, [scale - 1.0]])
        C = placed.joint_covariance[np.ix_(used, used)]
        nees.append(error @ np.linalg.solve(C, error))
        J = pixel_slopes(placed.camera, points)
        squares.append((placed.camera.project(points) - pixels).ravel() ** 2)
        shared.append(np.diag(J @ C[:-1, :-1] @ J.T))
        C[:5, 5:], C[5:, :5] = 0.0, 0.0
        apart.append(np.diag(J @ C[:-1, :-1] @ J.T))
    assert len(nees) > 28
    assert abs(np.mean(nees) - 12.0) < 4.0 * np.sqrt(2.0 * 12.0 / len(nees))
    # Mean squares of 40 draws: four standard deviations.
    assert np.abs(np.mean(squares, axis=0) / np.mean(shared, axis=0) - 1.0).max() < 4.0 * np.sqrt(2.0 / len(nees))
    assert np.mean(apart) > 10.0 * np.mean(shared)


def pixel_slopes(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(2 n, 11) derivatives of pixels by fx, fy, cx, cy, k1 and (δθ, δt), by central differences."""

    def seen_with(change: np.ndarray) -> np.ndarray:
        matrix, lens = camera.matrix.copy(), camera.distortion.copy()
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
        lens[0] += change[4]
        turn = cv2.Rodrigues(change[5:8])[0]
        moved = Camera(WIDTH, HEIGHT, matrix, lens, turn @ camera.rotation, camera.translation_m + change[8:])
        return moved.project(points).ravel()

    steps = np.diag([0.1] * 4 + [1e-4] * 4 + [1e-5] * 3)
    return np.stack([(seen_with(s) - seen_with(-s)) / (2.0 * s.max()) for s in steps], axis=1)


def test_the_right_one_of_the_two_poses_of_a_plane_is_chosen_and_the_other_reported() -> None:
    rotation, shift = table_pose_of(pitch_deg=65.0)
    found = table_pose(
        calibrated([*poses(10, CHARUCO_BOARD), on_table(CHARUCO_BOARD, rotation, shift)]), CHARUCO_BOARD, "10.png"
    )
    assert np.abs(found.camera.rotation - rotation).max() < 0.01
    assert found.other_rotation is not None
    assert found.other_rms_px is not None
    assert found.other_rms_px > 2.0 * found.board.rms_px
    assert np.abs(found.other_rotation - rotation).max() > 0.1


def test_a_picture_that_both_poses_explain_is_refused() -> None:
    small = make_board("charuco", 5, 4, 0.0025, 0.0018)
    rotation, shift = table_pose_of(pitch_deg=70.0)
    where = [*poses(10, small), on_table(small, rotation, shift)]
    views = corner_views(small, where, 0.3, 4)
    with pytest.raises(ValueError, match=r"10\.png: two poses"):
        table_pose(calibrate(views, WIDTH, HEIGHT), small, "10.png")


def test_a_board_numbered_as_in_a_mirror_puts_the_camera_below_the_table_and_is_refused() -> None:
    rotation, shift = table_pose_of()
    where = [*poses(10, CHARUCO_BOARD), on_table(CHARUCO_BOARD, rotation, shift)]
    views = corner_views(CHARUCO_BOARD, where, 0.05, 2)
    width = CHARUCO_BOARD.columns * CHARUCO_BOARD.square_m
    mirrored = [replace(v, corners_m=v.corners_m * [-1, 1, 1] + [width, 0, 0]) for v in views]
    with pytest.raises(ValueError, match="below the table"):
        table_pose(calibrate(mirrored, WIDTH, HEIGHT), CHARUCO_BOARD, "10.png")


def test_a_table_picture_that_was_left_out_is_named() -> None:
    found = calibrated(poses(6, CHARUCO_BOARD))
    with pytest.raises(ValueError, match=r"table\.png: "):
        table_pose(found, CHARUCO_BOARD, "table.png")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("circles", 7, 5, 0.01, 0.007), "board = circles"),
        (("chessboard", 7, 5, 0.01, None, "DICT_4X4_50", 0.02), "square_sigma_mm = 20; wanted"),
        (("charuco", 2, 5, 0.01, 0.007), "squares = 2x5"),
        (("charuco", 7, 5, 0.0, 0.007), "square_mm = 0"),
        (("charuco", 7, 5, 0.01, 0.01), "marker_mm = 10"),
        (("charuco", 7, 5, 0.01, None), "marker_mm = missing"),
        (("charuco", 7, 5, 0.01, 0.007, "DICT_9X9"), "dictionary = DICT_9X9"),
        (("charuco", 17, 15, 0.01, 0.007), "it has 50 markers and a board of 17x15 needs 127"),
    ],
)
def test_an_impossible_board_is_refused(given: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_board(*given)
