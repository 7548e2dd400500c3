"""Laws of the edges of a sharp die: what saturated pixels say of where an edge lies, and what the shadow beside one does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, photograph, softly_shaded, studio
from random_throws import random_quaternion

from diethrow.model.throw.motion import State
from diethrow.tracking.picture.shade import error_of_step_by_slope
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


@pytest.mark.parametrize("shape", ["cube", "octahedron"])
@pytest.mark.parametrize("paint", [0.15, 1.0])
def test_a_soft_shadow_beside_the_die_does_not_move_it(shape: str, paint: float) -> None:
    """Beside a dark die, a table that darkens towards it looks like more of the die. With one shade for the pixels beside an edge
    dark dice were 1 mm off and light ones 0.4 mm, a dozen times the stated errors."""
    setting, die, errors = replace(studio(), noise_grey=1.0), DICE[shape], []
    for seed in range(8):
        rng = np.random.default_rng([29, seed])
        place = np.array([0.0, 0.0, die.solid.inradius])
        state = State(0.0, place, random_quaternion(rng), np.zeros(3), np.zeros(3))
        on_black, on_white = (
            photograph(replace(setting, noise_grey=0.0, table=np.full_like(setting.table, grey)), die, state)
            for grey in (0.0, 255.0)
        )
        shaded = softly_shaded(setting, die.solid.vertices @ state.rotation.T + place)
        table = shaded.table * (on_white - on_black) / 255.0
        picture = np.asarray(paint * on_black + table + rng.normal(size=table.shape), np.float32)
        pose = refine_pose(setting.view(die), picture, pose_state(state.position_m, state.rotation), coarse=0)
        assert pose.covariance is not None
        off = pose.position_m - state.position_m
        errors.append([1e3 * np.linalg.norm(off), off @ np.linalg.solve(pose.covariance[:3, :3], off)])
    off_mm, nees = np.median(errors, axis=0)
    assert off_mm < (0.35 if paint < 1.0 else 0.15)
    # 2.4 is right: the shadow is no straight line. Without the slope it was 150 to 200.
    assert nees < 16.0


def test_an_unknown_slope_of_the_shade_makes_the_step_less_certain_by_what_linear_algebra_says() -> None:
    rng, base = np.random.default_rng(5), 0.7
    for sigma in (1e-3, 0.1, 10.0):
        rows = np.column_stack([rng.uniform(size=(40, 2)), rng.normal(size=40)])
        normal = rows.T @ rows + np.diag([0.0, 0.0, 1.0 / sigma**2])
        step, inverse = np.array([-1.0, base]), np.linalg.inv(normal)[:2, :2]
        expected = np.sqrt(step @ inverse @ step / (step @ np.linalg.inv(normal[:2, :2]) @ step))
        coupled, square = normal[2, :2], normal[2, 2]
        eliminated = normal[:2, :2] - np.outer(coupled, coupled) / square
        found = getattr(error_of_step_by_slope, "py_func", error_of_step_by_slope)(eliminated, base, coupled, square)
        assert found == pytest.approx(expected, rel=1e-9)
