"""Rotations: quaternions, matrices, rotation vectors and the paper's Euler angles agree."""

import numpy as np
import pytest
from random_throws import random_quaternion
from scipy.spatial.transform import Rotation

from diethrow.model.rotations import (
    angle_between,
    continuous_sign,
    cross_matrix,
    euler_from_quat,
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_from_matrix,
    quat_from_rotvec,
    quat_multiply,
    rotation_between,
    rotvec_from_quat,
)

ANGLES_RAD = (0.0, 1e-12, 1e-7, 1e-3, 1.0, np.pi - 1e-7, np.pi)
"""Zero, where sin θ/θ needs care, small turns, and both sides of the angle at which the rotation vector reverses."""


def some_quaternions(n: int = 50) -> np.ndarray:
    rng = np.random.default_rng(11)
    return np.array([random_quaternion(rng) for _ in range(n)])


def test_matrices_of_quaternions_are_rotations_and_convert_back():
    q = some_quaternions()
    m = matrix_from_quat(q)
    # A few products of numbers of size one.
    np.testing.assert_allclose(m @ m.transpose(0, 2, 1), np.broadcast_to(np.eye(3), m.shape), atol=1e-15 * 8)
    np.testing.assert_allclose(np.linalg.det(m), 1.0, atol=1e-14)
    back = quat_from_matrix(m)
    np.testing.assert_allclose(back * np.sign(np.sum(back * q, axis=1))[:, None], q, atol=1e-14)
    assert (back[:, 0] >= 0).all()


def test_products_of_quaternions_are_products_of_matrices():
    a, b = some_quaternions()[:25], some_quaternions()[25:]
    np.testing.assert_allclose(
        matrix_from_quat(quat_multiply(a, b)), matrix_from_quat(a) @ matrix_from_quat(b), atol=1e-14
    )
    identity = quat_multiply(a, quat_conjugate(a))
    np.testing.assert_allclose(identity, np.tile([1.0, 0, 0, 0], (25, 1)), atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES_RAD)
def test_rotation_vectors_convert_back(angle):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    back = rotvec_from_quat(quat_from_rotvec(angle * axis))
    # At π both ends of the axis mean the same rotation.
    sign = np.sign(back @ axis) if angle == np.pi else 1.0
    # Relative, so that a turn of 1e-12 keeps its digits too.
    np.testing.assert_allclose(sign * back, angle * axis, rtol=1e-8 if angle > 3 else 1e-14, atol=1e-300)


def test_rotation_vectors_are_those_of_scipy_from_no_turn_to_several():
    rng = np.random.default_rng(12)
    vectors = rng.normal(size=(2000, 3)) * 10.0 ** rng.uniform(-200.0, 1.5, (2000, 1))
    by_scipy = Rotation.from_rotvec(vectors)
    # Products of a few numbers of size one; half of 60 rad is known to 4e-15.
    np.testing.assert_allclose(quat_from_rotvec(vectors), by_scipy.as_quat(scalar_first=True), atol=8e-15)
    quaternions = some_quaternions(2000)
    shorter = Rotation.from_quat(quaternions, scalar_first=True).as_rotvec()
    np.testing.assert_allclose(rotvec_from_quat(quaternions), shorter, atol=4e-15)
    np.testing.assert_array_equal(rotvec_from_quat(-quaternions), rotvec_from_quat(quaternions))


def test_the_rotation_vector_of_an_unknown_rotation_is_nan():
    known_and_not = np.array([[1.0, 0.0, 0.0, 0.0], [np.nan] * 4])
    np.testing.assert_array_equal(rotvec_from_quat(known_and_not), [[0.0] * 3, [np.nan] * 3])


@pytest.mark.parametrize("angle", ANGLES_RAD[:-1])
def test_rotation_between_takes_the_start_to_the_end_in_world_axes(angle):
    start = some_quaternions(1)[0]
    turn = angle * np.array([0.0, 0.6, 0.8])
    end = quat_multiply(quat_from_rotvec(turn), start)
    np.testing.assert_allclose(rotation_between(start, end), turn, atol=1e-15 * 8)


@pytest.mark.parametrize("angle", [*ANGLES_RAD, np.pi - 1e-9])
def test_the_angle_between_rotations_is_exact_to_rounding_near_zero_and_pi(angle):
    start = some_quaternions(1)[0]
    end = quat_multiply(quat_from_rotvec(angle * np.array([0.0, 0.6, 0.8])), start)
    assert angle_between(start, end) == pytest.approx(angle, abs=1e-15)
    assert angle_between(matrix_from_quat(start), matrix_from_quat(end)) == pytest.approx(angle, abs=1e-15)


def test_the_angle_to_an_unknown_rotation_is_nan():
    some = np.stack([np.eye(3), np.full((3, 3), np.nan)])
    np.testing.assert_array_equal(angle_between(some, np.eye(3)), [0.0, np.nan])


def test_euler_angles_are_turns_about_z_then_x_then_z_of_the_turned_body():
    for psi, theta, phi in np.random.default_rng(3).uniform(-np.pi, np.pi, (20, 3)):
        z = matrix_from_quat(quat_from_rotvec([[0, 0, psi], [0, 0, phi]]))
        x = matrix_from_quat(quat_from_rotvec([theta, 0, 0]))
        np.testing.assert_allclose(matrix_from_quat(quat_from_euler([psi, theta, phi])), z[0] @ x @ z[1], atol=1e-14)


@pytest.mark.parametrize("theta", [0.0, 1e-9, 1e-7, 1e-3, 1.2, np.pi / 2, np.pi - 1e-7, np.pi])
def test_euler_angles_convert_back_to_the_orientation_even_at_the_gimbal(theta):
    q = quat_from_euler([0.3, theta, -2.1])
    back = quat_from_euler(euler_from_quat(q))
    # Within 1e-7 of the gimbal scipy may fold ϑ into it: then the orientation is off by up to that angle.
    np.testing.assert_allclose(rotation_between(q, back), 0.0, atol=2e-7)
    if 1e-3 <= theta <= np.pi - 1e-3:
        np.testing.assert_allclose(euler_from_quat(q), [0.3, theta, -2.1], atol=1e-12)


def test_at_a_gimbal_the_undetermined_angle_is_zero_without_a_warning():
    np.testing.assert_allclose(euler_from_quat(quat_from_euler([0.3, 0.0, 0.4])), [0.7, 0.0, 0.0], atol=1e-12)


def test_continuous_sign_changes_no_rotation_and_never_flips_even_across_nan_rows():
    times = np.linspace(0.0, 2.0, 60)
    q = quat_from_rotvec(np.outer(times, [3.0, -7.0, 5.0]))
    flipped = q * np.where(np.arange(60) % 3 == 0, -1.0, 1.0)[:, None]
    flipped[[10, 11, 30]] = np.nan
    steady = continuous_sign(flipped)
    known = np.isfinite(steady[:, 0])
    assert known.sum() == 57
    assert (np.sum(steady[known][1:] * steady[known][:-1], axis=1) > 0).all()
    np.testing.assert_array_equal(np.abs(steady[known]), np.abs(flipped[known]))


def test_the_cross_matrix_of_a_vector_takes_another_to_their_cross_product():
    rng = np.random.default_rng(9)
    v, w = rng.normal(size=(2, 5, 4, 3))
    np.testing.assert_allclose((cross_matrix(v) @ w[..., None])[..., 0], np.cross(v, w), atol=1e-15)
