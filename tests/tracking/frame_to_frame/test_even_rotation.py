"""Laws of the spin of a symmetric die that turns far from one frame to the next."""

from __future__ import annotations

import numpy as np
import pytest
from footage_of_throws import DICE, studio
from random_throws import random_quaternion

from diethrow.model.die.solid import SHAPES
from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply
from diethrow.tracking.frame_to_frame.even_rotation import even_rotation


@pytest.mark.parametrize("shape", SHAPES)
def test_a_few_frames_show_the_spin_of_a_die_that_turns_by_more_than_its_symmetry(shape: str) -> None:
    """66 degrees a frame about axes of no symmetry, in any labellings, with errors of a tenth of a degree; backwards as well."""
    rng, view = np.random.default_rng(31), studio().view(DICE[shape])
    for direction in (1.0, -1.0):
        for _ in range(10):
            axis, times_s = rng.normal(size=3), direction * np.arange(5) / 240.0
            spin = np.radians(66.0) * 240.0 * axis / np.linalg.norm(axis)
            q = random_quaternion(rng)
            turns = quat_from_rotvec(times_s[:, None] * spin + rng.normal(scale=1.7e-3, size=(5, 3)))
            true = matrix_from_quat(quat_multiply(turns, q))
            seen = true @ view.symmetries[rng.integers(len(view.symmetries), size=5)]
            found = even_rotation(seen, times_s, view.symmetries, np.radians(1.0))
            assert found is not None
            labelled, spin_rad_s = found
            np.testing.assert_allclose(labelled[0], seen[0])
            np.testing.assert_allclose(labelled, true @ (true[0].T @ seen[0]), atol=1e-6)
            assert np.linalg.norm(spin_rad_s - spin) < 0.02 * np.linalg.norm(spin)


@pytest.mark.parametrize("shape", SHAPES)
def test_orientations_that_follow_no_even_rotation_have_no_spin(shape: str) -> None:
    rng, view = np.random.default_rng(37), studio().view(DICE[shape])
    rotations = matrix_from_quat(np.array([random_quaternion(rng) for _ in range(6)]))
    assert even_rotation(rotations, np.arange(6) / 240.0, view.symmetries, np.radians(1.0)) is None
