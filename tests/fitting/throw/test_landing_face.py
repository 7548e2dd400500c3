"""Laws of the face that a die lies on at the end of a track."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diethrow.fitting.throw.landing import resting_face
from diethrow.model.die.die import make_die
from diethrow.model.rotations import quat_from_matrix, quat_from_rotvec, quat_multiply
from diethrow.tracking.track import TRACKED, Track

CUBE = make_die("cube", 0.016, 0.0048)


def lying(rotation: np.ndarray, height_m: float, omega_rad_s: float = 0.0) -> Track:
    times = np.arange(20) / 1500.0
    turns = quat_from_rotvec(np.outer(times, [0.0, 0.0, omega_rad_s]))
    quaternions = quat_multiply(turns, quat_from_matrix(rotation))
    positions = np.tile([0.0, 0.0, height_m], (20, 1))
    return Track(np.arange(20), times, positions, quaternions, np.tile(np.eye(6), (20, 1, 1)), np.full(20, TRACKED))


def test_a_die_at_rest_on_a_face_has_landed() -> None:
    upside_down = np.diag([1.0, -1.0, -1.0])
    assert resting_face(lying(np.eye(3), 0.008), CUBE) == 6
    assert resting_face(lying(upside_down, 0.008), CUBE) == 1


def test_a_die_that_turns_or_hangs_or_has_few_frames_has_not_landed() -> None:
    assert resting_face(lying(np.eye(3), 0.008, omega_rad_s=5.0), CUBE) is None
    assert resting_face(lying(np.eye(3), 0.02), CUBE) is None
    track = lying(np.eye(3), 0.008)
    assert resting_face(replace(track, status=np.where(track.frame < 5, TRACKED, "lost")), CUBE) is None
