"""Laws of the edges of a sharp die: what saturated pixels say of where an edge lies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, photograph, studio
from random_throws import random_quaternion

from diethrow.model.throw.motion import State
from diethrow.tracking.pose import pose_state, refine_pose

BRIGHTEST_SHARE = 0.75
"""Full scale as a share of the brightest face."""


@pytest.mark.parametrize("shape", ["cube", "octahedron"])
def test_saturated_faces_do_not_move_the_edges(shape: str) -> None:
    """The clipped edge of a face brighter than full scale lies further out; a pixel at full scale is at least as bright."""
    setting, die, errors = replace(studio(), noise_grey=1.0), DICE[shape], []
    for seed in range(8):
        rng = np.random.default_rng([23, seed])
        state = State(0.0, np.array([0.0, 0.0, 0.02]), random_quaternion(rng), np.zeros(3), np.zeros(3))
        picture = photograph(setting, die, state, rng)
        full_grey = np.float32(BRIGHTEST_SHARE * np.percentile(picture[picture > setting.table.max()], 90))
        shown, plain = np.minimum(picture, full_grey), setting.view(die)
        views = (plain, replace(plain, saturation_grey=float(full_grey)))
        poses = [refine_pose(view, shown, pose_state(state.position_m, state.rotation), coarse=0) for view in views]
        assert all(pose.covariance is not None for pose in poses)
        off = [pose.position_m - state.position_m for pose in poses]
        errors.append(
            [
                [np.linalg.norm(d), d @ np.linalg.solve(pose.covariance[:3, :3], d)]
                for d, pose in zip(off, poses, strict=True)
            ]
        )
    (believed_m, _), (censored_m, nees) = np.median(errors, axis=0)
    assert censored_m < 0.1 * believed_m
    # Of three numbers: 2.4 is the median where the covariance is right.
    assert nees < 6.0
