"""A die does not jump between frames, however well a picture elsewhere is explained."""

from __future__ import annotations

import numpy as np
import pytest

from diethrow.tracking.picture import PARAMETERS, STATISTICS
from diethrow.tracking.pose import ClipPoses, Pose
from diethrow.tracking.sequence.places import PlacesBeside

EDGE_M = 0.016
FPS = 1500.0
ACROSS_M, ALONG_M = 2e-5, 4e-3
"""Standard errors of a place across the line of sight, which is x here, and along it."""
HERE = np.array([0.1, 0.2, 0.05])


def information() -> np.ndarray:
    return np.diag([ALONG_M**-2, ACROSS_M**-2, ACROSS_M**-2, 1e4, 1e4, 1e4])


def pose_at(position_m: np.ndarray, known: np.ndarray) -> Pose:
    H = np.zeros((PARAMETERS, PARAMETERS))
    H[:6, :6] = known
    return Pose(
        position_m, np.eye(3), known, np.zeros((6, 1)), 0.1, 0.9, 0.9, 100.0, 0.0, 1.0, H, np.zeros(STATISTICS)
    )  # fmt: skip


@pytest.fixture
def beside() -> PlacesBeside:
    """Frames 0 and 10 have poses."""
    poses = ClipPoses.empty(11)
    for k in (0, 10):
        poses.put(k, pose_at(HERE, information()), np.zeros(6))
    return PlacesBeside.of(poses, np.arange(11) / FPS, [0, 10], EDGE_M)


def test_a_place_that_no_speed_leads_to_is_refused(beside: PlacesBeside) -> None:
    """Two frames behind one it may have moved by 6.7 mm, and its distance may be off by some standard errors of 4 mm."""
    across, along = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    for away_m, allowed in ((0.0, True), (0.015, True), (0.08, False)):
        assert beside.can_lead_to(pose_at(HERE + away_m * across, information()), 2 / FPS) is allowed
    assert beside.can_lead_to(pose_at(HERE + 0.045 * along, information()), 2 / FPS)
    assert not beside.can_lead_to(pose_at(HERE + 0.045 * across, information()), 2 / FPS)


def test_time_lets_it_go_farther_but_only_as_far_as_every_side_allows() -> None:
    poses = ClipPoses.empty(101)
    for k in (0, 100):
        poses.put(k, pose_at(HERE, information()), np.zeros(6))
    times_s = np.arange(101) / FPS
    far = pose_at(HERE + np.array([0.0, 0.1, 0.0]), information())
    both, first = (PlacesBeside.of(poses, times_s, rows, EDGE_M) for rows in ([0, 100], [0]))
    assert [one.can_lead_to(far, times_s[k]) for one in (both, first) for k in (3, 50, 98)] == [
        False, True, False, False, True, True,
    ]  # fmt: skip


def test_poses_that_leave_a_direction_open_forbid_nothing(beside: PlacesBeside) -> None:
    """Neither the place itself, nor those beside."""
    nothing = np.zeros((6, 6))
    assert beside.can_lead_to(pose_at(HERE + 1.0, nothing), 2 / FPS)
    poses = ClipPoses.empty(2)
    poses.put(0, pose_at(HERE, nothing), np.zeros(6))
    assert PlacesBeside.of(poses, np.arange(2) / FPS, [0], EDGE_M).can_lead_to(pose_at(HERE + 1.0, information()), 0.0)
