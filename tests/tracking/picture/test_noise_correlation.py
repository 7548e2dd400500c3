"""Errors that neighbouring pixels share: what the edges then say of a pose."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from footage_of_throws import DICE, photograph, studio
from random_throws import random_quaternion

from diethrow.model.throw.motion import State
from diethrow.tracking.picture import (
    LINE_LAGS,
    LINE_PAIRS,
    LINE_PRODUCTS,
    LINE_SQUARES,
    LINES,
    STATISTICS,
    independent_share,
)
from diethrow.tracking.pose import pose_state, refine_pose

FRAMES = 24
NOISE_GREY = 3.0


def statistics_of(shifts: np.ndarray) -> np.ndarray:
    """(n, STATISTICS) of frames whose edges have these shifts (n, lines) in their standard errors."""
    out = np.zeros((len(shifts), STATISTICS))
    out[:, LINES], out[:, LINE_SQUARES] = shifts.shape[1], (shifts**2).sum(1)
    for lag in range(1, LINE_LAGS + 1):
        out[:, LINE_PAIRS + lag - 1] = shifts.shape[1] - lag
        out[:, LINE_PRODUCTS + lag - 1] = (shifts[:, lag:] * shifts[:, :-lag]).sum(1)
    return out


@pytest.mark.parametrize("reach", [1, 2, 4])
def test_the_share_is_that_of_the_variance_of_a_mean(reach: int) -> None:
    """Moving means over so many lines, times two."""
    rng = np.random.default_rng(5)
    white = rng.standard_normal((400, 300 + reach))
    shifts = 2.0 * np.mean([white[:, k : k + 300] for k in range(reach)], axis=0)
    variance_of_mean = shifts.shape[1] * float(np.var(shifts.mean(axis=1)))
    assert independent_share(statistics_of(shifts)) == pytest.approx(1.0 / variance_of_mean, rel=0.15)


def test_no_frame_or_too_few_lines_say_nothing() -> None:
    few = np.full((5, 8), 3.0)
    assert independent_share(statistics_of(few)) == 1.0
    assert independent_share(np.zeros((0, STATISTICS))) == 1.0


def test_edges_are_never_surer_than_their_pixels() -> None:
    """Smaller shifts than noise explains, as priors leave them, are no information."""
    shifts = 0.3 * np.random.default_rng(6).standard_normal((20, 300))
    assert independent_share(statistics_of(shifts)) == 1.0


@pytest.mark.parametrize("blur_px", [0.0, 1.2])
def test_covariances_are_honest_whether_errors_are_correlated_or_not(blur_px: float) -> None:
    setting, die = replace(studio(), noise_grey=0.3), DICE["cube"]
    view, nees, statistics = replace(setting.view(die), noise_grey=NOISE_GREY), [], []
    for seed in range(FRAMES):
        rng = np.random.default_rng([31, seed])
        state = State(0.0, np.array([0.0, 0.0, 0.02]), random_quaternion(rng), np.zeros(3), np.zeros(3))
        noise = rng.standard_normal(setting.table.shape)
        if blur_px > 0.0:
            noise = cv2.GaussianBlur(noise, (0, 0), blur_px)
        picture = photograph(setting, die, state, rng) + (NOISE_GREY * noise / noise.std()).astype(np.float32)
        pose = refine_pose(view, picture, pose_state(state.position_m, state.rotation), coarse=0)
        assert pose.covariance is not None
        off = pose.position_m - state.position_m
        nees.append(off @ np.linalg.solve(pose.covariance[:3, :3], off))
        statistics.append(pose.statistics)
    share = independent_share(np.array(statistics))
    # Of three numbers: 3 is the mean where the covariance is right, and its standard error over so many frames is 0.5.
    assert 1.5 < share * np.mean(nees) < 5.0
    if blur_px > 0.0:
        assert share < 0.4
