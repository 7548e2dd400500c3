"""The camera's intrinsics and distortion from pictures of a board, with their covariance.

Zhang's method (IEEE Trans. Pattern Anal. Mach. Intell. 22, 1330, 2000) as OpenCV implements it: corners X of a known plane,
measured at x with independent errors of one sigma, give camera and board poses by least squares,

    sum over pictures and corners |x - project(K, distortion, R_i X + t_i)|²  = min.

The Bayesian information criterion n ln(S/n) + k ln n decides how many of k1, k2, (p1, p2), k3 the corners support, with S the sum
of squares, n its number of terms and k the number of free parameters. A parameter without support would only add noise at the
border of the picture.

At the minimum the covariance is sigma² (JᵀJ)⁻¹ with sigma² = S / (n - k). JᵀJ is an arrow, intrinsics A, poses E_i and
B_i between them, so that with C = (A - sum B_i E_i⁻¹ B_iᵀ)⁻¹

    cov(intrinsics) = sigma² C,    cov(pose i) = sigma² (E_i⁻¹ + E_i⁻¹ B_iᵀ C B_i E_i⁻¹),
    cov(intrinsics, pose i) = -sigma² C B_i E_i⁻¹:

uncertain intrinsics make the poses uncertain too. Pose increments are (δθ, δt) in camera axes, R_true = exp(δθ) R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from ..covariance import scaled_inverse
from .boards import MIN_CORNERS, BoardView

Array = NDArray[np.float64]

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Names, in the order of every vector and covariance here."""
MIN_PICTURES = 4
"""Fewest pictures: three determine focal length and centre, and one more checks them."""
DISTORTION_MODELS = ((), ("k1",), ("k1", "k2"), ("k1", "k2", "p1", "p2"), ("k1", "k2", "p1", "p2", "k3"))
"""Sets of distortion parameters that are compared."""
MAX_CORNER_SIGMAS = 5.0
"""Largest residual of a corner in one coordinate; of a thousand good corners none lies beyond."""
MAX_PICTURE_RATIO = 3.0
"""Largest residual of a picture, in medians of the others'; beyond it the board is blurred or bent."""
MIN_RESIDUAL_PX = 1e-3
"""Smallest scale of residuals in both decisions: rendered corners without noise have smaller ones."""
NOISE_FLOOR_PX = 1e-4
"""Smallest residual in the information criterion: without noise, rounding would decide."""
SIGMA_PER_MEDIAN = 1.4826
"""Standard deviation of a normal distribution, in medians of its absolute value."""
MAX_BAD_SHARE = 0.2
"""Largest share of bad corners in a picture; with more of them the picture is left out."""
MAX_FOCAL_ERROR = 0.01
"""Relative standard error of the focal length up to which the scale counts as known."""
MIN_COVERED_SHARE = 0.5
"""Share of the picture, by width and by height, that the corners must span to determine the distortion."""
MAX_STEPS = 200
"""Most steps of the least squares; most calibrations take 30."""
RELATIVE_STEP = 1e-12
"""Relative step at which the least squares stop: its error then lies in the last digits."""


@dataclass(frozen=True, eq=False)
class PosedBoard:
    """One picture of the board with its pose."""

    view: BoardView
    rotation: Array
    """(3, 3) board to camera."""
    translation_m: Array
    """(3,) position of the board's origin in camera axes."""
    covariance: Array
    """(6, 6) of (δθ [rad], δt [m]) in camera axes, including the uncertainty of the intrinsics."""
    with_intrinsics: Array
    """(9, 6) covariance of the intrinsics, in the order of INTRINSICS, with (δθ, δt)."""
    residuals_px: Array
    """(n, 2) measured minus projected corners."""

    @property
    def rms_px(self) -> float:
        """Root mean square distance between measured and projected corners."""
        return _rms(self.residuals_px)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera without its pose: intrinsics and distortion, with the boards that they were fitted to."""

    width_px: int
    height_px: int
    matrix: Array
    """(3, 3) [px]."""
    distortion: Array
    """(5,) k1 k2 p1 p2 k3; those that the corners do not support are 0."""
    free: tuple[str, ...]
    """Names of the fitted parameters; the others are 0 without error."""
    covariance: Array
    """(9, 9) in the order of INTRINSICS; 0 for parameters that were not fitted."""
    sigma_px: float
    """Standard error of one coordinate of a corner, from the residuals."""
    boards: tuple[PosedBoard, ...]
    left_out: tuple[tuple[str, float], ...]
    """Pictures that do not fit the others: name, and residual [px] to them."""
    corners_left_out: int
    notices: tuple[str, ...]
    """Problems of the calibration, one sentence each."""

    @property
    def values(self) -> Array:
        """(9,) in the order of INTRINSICS."""
        K = self.matrix
        return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *self.distortion])

    @property
    def sigmas(self) -> Array:
        """(9,) standard errors; 0 for parameters that were not fitted."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rms_px(self) -> float:
        """Root mean square distance between all measured and projected corners."""
        return _rms(np.concatenate([board.residuals_px for board in self.boards]))


@dataclass(frozen=True, eq=False)
class _Fit:
    """One least-squares solution."""

    views: list[BoardView]
    free: tuple[str, ...]
    matrix: Array
    distortion: Array
    turns: list[Array]
    shifts: list[Array]
    residuals: list[Array]

    @property
    def terms(self) -> int:
        return 2 * sum(len(view.ids) for view in self.views)

    @property
    def numbers(self) -> int:
        return 4 + len(self.free) + 6 * len(self.views)

    @property
    def squares(self) -> float:
        return float(sum((r * r).sum() for r in self.residuals))

    @property
    def criterion(self) -> float:
        """Bayesian information criterion."""
        floor = NOISE_FLOOR_PX**2 * self.terms
        return self.terms * np.log(max(self.squares, floor) / self.terms) + self.numbers * np.log(self.terms)


def calibrate(views: Sequence[BoardView], width_px: int, height_px: int) -> Calibration:
    """Camera matrix and distortion from four or more pictures of one board.

    Raises ValueError for too few pictures, and for pictures that determine no camera.
    """
    kept, left_out, corners_out = _consistent_views(list(views), width_px, height_px)
    trials = [_solve(kept, width_px, height_px, lens) for lens in DISTORTION_MODELS]
    best = min(trials, key=lambda fit: fit.criterion)
    return _calibration(best, width_px, height_px, tuple(left_out), corners_out)


def _consistent_views(
    kept: list[BoardView], width_px: int, height_px: int
) -> tuple[list[BoardView], list[tuple[str, float]], int]:
    """The views that agree, the pictures left out with their residuals, and the number of corners left out.

    A picture that fits far worse than the others loses its worst corners one by one, since a single one biases the pose of its
    board. Where that does not help, the whole picture is left out. Single corners with large residuals are left out last.
    """
    left_out: list[tuple[str, float]] = []
    removed = {view.name: 0 for view in kept}
    max_removed = {view.name: int(MAX_BAD_SHARE * len(view.ids)) for view in kept}
    while True:
        _check_count(kept, left_out)
        full = _solve(kept, width_px, height_px, DISTORTION_MODELS[-1])
        worst, rms = _worst_picture(full)
        if worst is not None and removed[kept[worst].name] < max_removed[kept[worst].name]:
            size = np.linalg.norm(full.residuals[worst], axis=1)
            removed[kept[worst].name] += 1
            kept[worst] = kept[worst].without(size == size.max())
            continue
        if worst is not None and len(kept) > MIN_PICTURES:
            name = kept.pop(worst).name
            left_out.append((name, rms))
            removed[name] = 0
            continue
        far = [_far_corners(r, full) for r in full.residuals]
        thinned = [view.without(bad) for view, bad in zip(kept, far, strict=True)]
        if not any(bad.any() for bad in far) or min(len(view.ids) for view in thinned) < MIN_CORNERS:
            return kept, left_out, sum(removed.values())
        for view, bad in zip(kept, far, strict=True):
            removed[view.name] += int(bad.sum())
        kept = thinned


def _check_count(views: list[BoardView], left_out: list[tuple[str, float]]) -> None:
    if len(views) < MIN_PICTURES:
        names = ", ".join(name for name, _ in left_out)
        also = f" ({names} do not fit the others)" if left_out else ""
        raise InputError(
            f"the board is usable on {len(views)} pictures{also}; wanted {MIN_PICTURES} at least, better 10 to 20, "
            "with the board tilted to all sides"
        )


def _solve(views: list[BoardView], width_px: int, height_px: int, lens: tuple[str, ...]) -> _Fit:
    """Least squares by OpenCV with the distortion terms of `lens` free; raises ValueError where it finds no camera."""
    flags = 0 if "p1" in lens else cv2.CALIB_ZERO_TANGENT_DIST
    for name, flag in (("k1", cv2.CALIB_FIX_K1), ("k2", cv2.CALIB_FIX_K2), ("k3", cv2.CALIB_FIX_K3)):
        flags |= 0 if name in lens else flag
    corners = [view.corners_m.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, MAX_STEPS, RELATIVE_STEP)
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            corners, pixels, (width_px, height_px), None, None, flags=flags, criteria=criteria
        )
    except cv2.error as error:
        raise InputError(NO_CAMERA) from error
    distortion = np.asarray(distortion, float).ravel()[:5]
    rotations = [np.asarray(cv2.Rodrigues(turn)[0], float) for turn in turns]
    places = [np.asarray(shift, float).ravel() for shift in shifts]
    if not (np.isfinite(matrix).all() and np.isfinite(distortion).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise InputError(NO_CAMERA)
    residuals = [
        view.pixels - _projected(view, R, t, matrix, distortion)[0]
        for view, R, t in zip(views, rotations, places, strict=True)
    ]
    return _Fit(views, lens, np.asarray(matrix, float), distortion, rotations, places, residuals)


NO_CAMERA = (
    "these pictures of the board determine no camera; take some with the board tilted by 20 to 50 degrees to all sides, "
    "and check the number of squares and their size"
)


def _projected(
    view: BoardView, rotation: Array, shift: Array, matrix: Array, distortion: Array
) -> tuple[Array, Array, Array]:
    """Projected corners (n, 2), and their derivatives by (δθ, δt) (2n, 6) and by the intrinsics (2n, 9)."""
    turn = cv2.Rodrigues(rotation)[0]
    pixels, slopes = cv2.projectPoints(view.corners_m, turn, shift, matrix, distortion)
    by_point = slopes[:, 3:6].reshape(-1, 2, 3)
    arm = view.corners_m @ rotation.T
    # δx = δθ × arm, so column j of the derivative is e_j × arm.
    by_turn = np.einsum("nij,nkj->nik", by_point, np.cross(np.eye(3)[None], arm[:, None, :]))
    pose = np.concatenate([by_turn, by_point], axis=2).reshape(-1, 6)
    return pixels.reshape(-1, 2), pose, slopes[:, 6:15]


def _rms(residuals: Array) -> float:
    return float(np.sqrt((residuals**2).sum(axis=-1).mean()))


def _worst_picture(fit: _Fit) -> tuple[int | None, float]:
    """The picture that fits far worse than the others, None without one, and its residual.

    Medians decide, so that a single bad corner does not.
    """
    each = np.array([float(np.median(np.linalg.norm(r, axis=1))) for r in fit.residuals])
    worst = int(np.argmax(each))
    usual = float(np.median(np.delete(each, worst)))
    return (worst if each[worst] > MAX_PICTURE_RATIO * max(usual, MIN_RESIDUAL_PX) else None), _rms(
        fit.residuals[worst]
    )


def _far_corners(residuals: Array, fit: _Fit) -> NDArray[np.bool_]:
    """(n,) corners with large residuals; the scale is the median, which a few bad corners do not change."""
    sizes = np.abs(np.concatenate(fit.residuals))
    sigma = SIGMA_PER_MEDIAN * float(np.median(sizes))
    return np.asarray((np.abs(residuals) > MAX_CORNER_SIGMAS * max(sigma, MIN_RESIDUAL_PX)).any(axis=1))


def _calibration(
    fit: _Fit, width_px: int, height_px: int, left_out: tuple[tuple[str, float], ...], corners_out: int
) -> Calibration:
    used = np.array([name in (*INTRINSICS[:4], *fit.free) for name in INTRINSICS])
    blocks = []
    for view, R, t in zip(fit.views, fit.turns, fit.shifts, strict=True):
        _, pose, lens = _projected(view, R, t, fit.matrix, fit.distortion)
        lens = lens[:, used]
        blocks.append((lens.T @ lens, lens.T @ pose, np.linalg.inv(pose.T @ pose)))
    variance = fit.squares / max(fit.terms - fit.numbers, 1)
    C = scaled_inverse(np.sum([A - B @ E @ B.T for A, B, E in blocks], axis=0))
    covariance = np.zeros((9, 9))
    covariance[np.ix_(used, used)] = variance * C
    boards = []
    for view, R, t, residuals, (_, B, E) in zip(fit.views, fit.turns, fit.shifts, fit.residuals, blocks, strict=True):
        by_lens = -C @ B @ E
        with_intrinsics = np.zeros((9, 6))
        with_intrinsics[used] = variance * by_lens
        of_pose = np.asarray(variance * (E - E @ B.T @ by_lens), float)
        boards.append(PosedBoard(view, R, t, of_pose, with_intrinsics, residuals))
    found = Calibration(
        width_px, height_px, fit.matrix, fit.distortion, (*INTRINSICS[:4], *fit.free), covariance, float(np.sqrt(variance)),
        tuple(boards), left_out, corners_out, (),
    )  # fmt: skip
    return Calibration(**{**vars(found), "notices": _notices(found)})


def _notices(found: Calibration) -> tuple[str, ...]:
    notices = [
        f"{name} was left out: its corners lie {rms:.2f} px off the fit to the others (blur, or a bent board); take it again."
        for name, rms in found.left_out
    ]
    if found.corners_left_out:
        notices.append(
            f"{found.corners_left_out} single corners were left out: their residuals are far larger than the others'."
        )
    share = found.sigmas[:2] / found.values[:2]
    if share.max() > MAX_FOCAL_ERROR:
        notices.append(
            f"The focal length is known to {100 * share.max():.2g} % only; add pictures with the board tilted by 20 to 50 "
            "degrees to all sides."
        )
    reach = np.ptp(np.concatenate([board.view.pixels for board in found.boards]), axis=0)
    covered = reach / np.array([found.width_px, found.height_px])
    if covered.min() < MIN_COVERED_SHARE:
        notices.append(
            f"The corners reach over {100 * covered[0]:.0f} % of the width and {100 * covered[1]:.0f} % of the height; "
            "the distortion beyond them is extrapolated; add pictures with the board near the border."
        )
    return tuple(notices)
