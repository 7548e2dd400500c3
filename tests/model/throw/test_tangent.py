"""Derivatives of a throw through its bounces: against differences, and as a smooth model for a fit."""

import numpy as np
import pytest
from random_throws import DICE, disturbed, random_release

from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import State
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.model.throw.tangent import propagate

CHI = 0.6
IMPACTS = 4
each_die = pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())


def a_throw(die, seed: int) -> tuple[State, list[int], np.ndarray]:
    """A release, the vertices of its first bounces, and times before, between and after them, not next to any."""
    release = random_release(np.random.default_rng(seed), die)
    throw = throw_die(die, release, SmoothImpact(CHI), until=Until(impacts=IMPACTS)).throw
    vertices = [impact.vertices[0] for impact in throw.impacts]
    times = [release.time_s - 0.02]
    for flight in throw.flights:
        if flight.end_s - flight.start.time_s > 0.001:
            times += list(np.linspace(flight.start.time_s, flight.end_s, 7)[2:-2])
    return release, vertices, np.array(times)


def differences(die, start, times, vertices, column, size) -> tuple[np.ndarray, np.ndarray]:
    """Fourth-order central differences of poses (n, 6) and instants of impact (k,) by one column."""
    step = np.zeros(13)
    step[column] = size
    runs = {
        k: propagate(die, disturbed(start, k * step), CHI + k * step[12], times, vertices=vertices)
        for k in (-2, -1, 1, 2)
    }

    def half(k: int) -> tuple[np.ndarray, np.ndarray]:
        a, b = runs[k], runs[-k]
        turned = rotation_between(b.quaternions, a.quaternions)
        instants = [p.time_s - q.time_s for p, q in zip(a.throw.impacts, b.throw.impacts, strict=True)]
        return np.hstack([a.positions_m - b.positions_m, turned]), np.array(instants)

    near, far = half(1), half(2)
    return tuple((8 * n - f) / (12 * size) for n, f in zip(near, far, strict=True))


@each_die
@pytest.mark.parametrize("seed", [61, 62])
def test_derivatives_through_four_bounces_agree_with_differences(die, seed):
    start, vertices, times = a_throw(die, seed)
    result = propagate(die, start, CHI, times, vertices=vertices)
    assert len(result.throw.impacts) == IMPACTS
    for column in range(13):
        # Four bounces may magnify a step ten-thousandfold: it is chosen to move no pose by more than 0.3 mrad or
        # 0.3 mm, where the fourth order leaves 1e-10, and the rounding of 1e-15 in the poses grows to 1e-7.
        size = 3e-4 / max(1.0, np.abs(result.jacobian[:, :, column]).max())
        poses, instants = differences(die, start, times, vertices, column, size)
        np.testing.assert_allclose(result.jacobian[:, :, column], poses, atol=1e-6 * np.abs(poses).max(), rtol=1e-6)
        limit = 1e-6 * np.abs(instants).max() + 1e-16 / size
        np.testing.assert_allclose(result.impact_jacobian[:, column], instants, atol=limit, rtol=1e-6)


@each_die
def test_poses_equal_the_simulated_throw_and_prescribing_its_vertices_changes_nothing(die):
    start, vertices, times = a_throw(die, 63)
    throw = throw_die(die, start, SmoothImpact(CHI), until=Until(impacts=IMPACTS)).throw
    positions, quaternions = throw.poses(times)
    for result in (propagate(die, start, CHI, times), propagate(die, start, CHI, times, vertices=vertices)):
        reached = sum(i.time_s < times.max() for i in throw.impacts)
        assert [i.vertices[0] for i in result.throw.impacts][:reached] == vertices[:reached]
        np.testing.assert_allclose(result.positions_m, positions, atol=1e-12)
        np.testing.assert_allclose(rotation_between(result.quaternions, quaternions), 0, atol=1e-10)
        mine = result.throw.poses(times)
        np.testing.assert_allclose(mine[0], result.positions_m, atol=1e-13)
    free, prescribed = propagate(die, start, CHI, times), propagate(die, start, CHI, times, vertices=vertices)
    np.testing.assert_allclose(free.jacobian, prescribed.jacobian, rtol=1e-9, atol=1e-9)


def test_times_may_come_in_any_order_and_before_the_start():
    die = DICE["cube"]
    start, vertices, times = a_throw(die, 64)
    mixed = np.random.default_rng(0).permutation(len(times))
    one = propagate(die, start, CHI, times, vertices=vertices)
    two = propagate(die, start, CHI, times[mixed], vertices=vertices)
    np.testing.assert_array_equal(two.positions_m, one.positions_m[mixed])
    np.testing.assert_array_equal(two.jacobian, one.jacobian[mixed])
    before = one.throw.flights[0].poses(times[:2])
    np.testing.assert_allclose(one.positions_m[:2], before[0], atol=1e-15)


def test_a_flight_without_impacts_has_the_derivatives_of_a_parabola_and_a_constant_rotation():
    die = DICE["cube"]
    start = random_release(np.random.default_rng(65), die, spin_rad_s=0.0, clearance_m=1.0)
    jacobian = propagate(die, start, CHI, [start.time_s + 0.1], vertices=[]).jacobian[0]
    expected = np.zeros((6, 13))
    expected[:, :6] = np.eye(6)
    expected[:, 6:12] = 0.1 * np.eye(6)
    np.testing.assert_allclose(jacobian, expected, atol=1e-15)


def two_vertex_landing(tilt_rad: float) -> State:
    """A cube that lands on an edge, tilted so that vertex 0 (tilt above 0) or vertex 1 comes first."""
    turn = quat_multiply(quat_from_rotvec([0.0, tilt_rad, 0.0]), quat_from_rotvec([0.5, 0.0, 0.0]))
    return State(0.0, np.array([0, 0, 0.03]), turn, np.array([0.1, 0.0, -0.5]), np.array([1.0, 2.0, 0.5]))


def test_prescribed_vertices_keep_the_poses_smooth_when_two_touches_change_their_order():
    die = DICE["cube"]
    free = [
        [i.vertices[0] for i in propagate(die, two_vertex_landing(t), CHI, [0.06]).throw.impacts] for t in (-0.1, 0.1)
    ]
    assert free[0][:1] != free[1][:1]
    order = free[1][:2] if len(set(free[1][:2])) == 2 else [free[1][0], free[0][0]]
    tilts = np.linspace(-0.06, 0.06, 25)
    runs = [propagate(die, two_vertex_landing(t), CHI, [0.055, 0.06], vertices=order) for t in tilts]
    instants = np.array([[i.time_s for i in r.throw.impacts] for r in runs])
    # Both orders occur in this range, and time runs a little backwards in one of them.
    assert (np.diff(instants, axis=1) < 0).any()
    assert (np.diff(instants, axis=1) > 0).any()
    slopes = np.array([r.jacobian[:, :, 4] for r in runs])  # by a turn about y, which is what the tilt is
    positions = np.array([r.positions_m for r in runs])
    # The trapezium rule over the slopes gives the poses: no jump anywhere. 5 mrad steps of a curve that bends by 1.
    predicted = np.cumsum(0.5 * (slopes[1:, :, :3] + slopes[:-1, :, :3]) * np.diff(tilts)[:, None, None], axis=0)
    np.testing.assert_allclose(positions[1:] - positions[:1], predicted, atol=2e-6)


def test_a_vertex_that_never_touches_again_is_left_out_with_those_after_it():
    die = DICE["cube"]
    sunk = State(0.0, np.array([0, 0, -1.0]), np.array([1.0, 0, 0, 0]), np.array([0, 0, -1.0]), np.array([3.0, 1.0, 0]))
    result = propagate(die, sunk, CHI, [0.1], vertices=[0, 1])
    assert result.throw.impacts == ()
    assert result.impact_jacobian.shape == (0, 13)
    # Nor does one that the throw does not bring back up.
    rising = State(0.0, sunk.position_m, sunk.quaternion, np.array([0, 0, 1.0]), sunk.omega_rad_s)
    assert propagate(die, rising, CHI, [0.1], vertices=[0]).throw.impacts == ()


def test_after_the_last_prescribed_vertex_the_flight_continues():
    die = DICE["cube"]
    start, vertices, times = a_throw(die, 66)
    result = propagate(die, start, CHI, times, vertices=vertices[:1])
    assert len(result.throw.flights) == 2
    late = result.throw.flights[1].poses(times[-3:])
    np.testing.assert_allclose(result.positions_m[-3:], late[0], atol=1e-13)


def test_impossible_arguments_of_propagate_raise_and_name_the_value():
    die = DICE["cube"]
    start, _, times = a_throw(die, 67)
    with pytest.raises(ValueError, match=r"vertices = \[8\]"):
        propagate(die, start, CHI, times, vertices=[8])
    with pytest.raises(ValueError, match=r"chi = 1\.2"):
        propagate(die, start, 1.2, times)
    with pytest.raises(ValueError, match="times_s of shape"):
        propagate(die, start, CHI, [np.nan])
    with pytest.raises(ValueError, match="below the table"):
        propagate(die, disturbed(start, np.eye(13)[2] * -2.0), CHI, times)
    with pytest.raises(ValueError, match="bounces follow each other"):
        propagate(die, start, 0.0, [start.time_s + 3.0])
